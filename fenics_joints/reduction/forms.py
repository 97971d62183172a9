"""Models by forms of your own on a basis: exact sums over the constants that are parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.reduction.affine import CONSTANT, AffinePencil, RegionTerm
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.prediction import ways_of
from fenics_joints.structure import FormModel, Sensors
from fenics_joints.structure.points import PlaceRows
from fenics_joints.structure.sparse import as_columns, project

#: Step, over the size of the model, of derivatives by a sensor's place. [numerical: chosen]
_STEP = 1e-4


class ProjectedModel(ArrayModel):
    """A model on a fixed basis, which reads its sensors from the full one.

    Args:
        model: The full model.
        basis: Vectors of the basis, linearly independent.
        pencil: K(p) and M(p) on it.

    Attributes:
        full: The full model.
    """

    def __init__(self, model, basis: Sequence[PETSc.Vec], pencil: AffinePencil):
        super().__init__(pencil, model.dilation_frequency())
        self.full, self.basis, self._seen = model, basis, dict[tuple, np.ndarray]()

    def observe(self, shapes: np.ndarray, sensors: Sensors) -> np.ndarray:
        """Displacement of shapes at sensors, (n_sensors, n_shapes). Collective at first."""
        key = sensors.points.tobytes(), sensors.directions.tobytes()
        if key not in self._seen:
            self._seen[key] = self.full.observe(self.basis, sensors)
        return self._seen[key] @ shapes

    def loads(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """Loads of one newton on the basis, and what sensors read of it, (n_dofs, n_sensors)."""
        return self.observe(np.eye(self.n_dofs), sensors).T

    def arrays(self, *places: Sensors, sensors: Sensors | None = None) -> ArrayModel:
        """The same model as plain arrays, which need no mesh. Collective.

        Args:
            places: Excitations and sensors for which it shall carry the displacements.
            sensors: Sensors of its ``sensor_rows``.
        """
        gdim = self.full.gdim
        found = ArrayModel(self.pencil, self.scale_hz)
        if sensors is not None:
            found.sensor_rows = self.observe(np.eye(self.n_dofs), sensors)
            found.shift_rows = self._by_place(sensors)
        if places:
            points = np.unique(np.vstack([s.points[:, :gdim] for s in places]), axis=0)
            ways = np.tile(np.eye(gdim), (len(points), 1))
            every = Sensors(np.repeat(points, gdim, axis=0), ways)
            rows = self.observe(np.eye(self.n_dofs), every)
            found.places = PlaceRows(points, rows.reshape(len(points), gdim, -1))
        return found

    def _by_place(self, sensors: Sensors) -> np.ndarray:
        """Derivatives of the sensors' readings by their places, see ``ArrayModel.shift_rows``, by
        differences: (n_ways, n_sensors, n_dofs). Collective."""
        gdim, found = self.full.gdim, []
        step = _STEP * float(np.max(self.full.size_m))
        for way in ways_of(sensors, gdim):
            ends = (Sensors(sensors.points + s * step * way, sensors.directions) for s in (1, -1))
            high, low = (self.full.observe(self.basis, end) for end in ends)
            found.append((high - low) / (2 * step))
        return np.array(found)


def on_basis(full, basis: Sequence[PETSc.Vec]) -> ProjectedModel:
    """A model by forms, or one that can put itself on a basis, on that basis. Collective."""
    return ReducedForms(full, basis) if isinstance(full, FormModel) else full.on_basis(basis)


class ReducedForms(ProjectedModel):
    """A `FormModel` on a fixed basis. Making one is collective; its sensors need the mesh.

    Args:
        model: The full model.
        basis: Vectors of the basis, linearly independent.

    Raises:
        InputError: If K or M is not linear in a parameter.
    """

    def __init__(self, model: FormModel, basis: list[PETSc.Vec]):
        bent = model.not_linear()
        if bent:
            raise InputError(
                f"{', '.join(bent)}: a or m is not linear in it: expected parameters in which both "
                "are, such as Lame's instead of Poisson's ratio, or the full model"
            )
        nominal = model.values()
        dense, n = as_columns(basis), len(basis)
        terms = {name: np.zeros((2, n, n)) for name in nominal}
        names = list(nominal)
        for p, kind, _, form in model.slopes():
            terms[names[p]]["KM".index(kind)] += project(form.A, dense)
            form.destroy()
        weigh = model.total_mass if model.has_displacement else lambda given=None: 0.0
        weight = weigh()
        regions = []
        for name, (K, M) in terms.items():
            step = nominal[name] or 1.0
            volume = (weigh({name: nominal[name] + step}) - weight) / step
            regions.append(RegionTerm(name, CONSTANT, {"value": name}, K[None], M, volume))
        pencil = AffinePencil(model.parameters, regions)
        K, M = pencil.assemble(nominal) if regions else (np.zeros((n, n)),) * 2
        whole = (model.stiffness(), model.mass())
        fixed = tuple(project(A, dense) - B for A, B in zip(whole, (K, M), strict=True))
        for A in whole:
            A.destroy()
        known = float(pencil.total_mass(nominal)) if regions else 0.0
        pencil = AffinePencil(model.parameters, regions, (), fixed, weight - known)
        super().__init__(model, basis, pencil)

    @property
    def layers(self) -> tuple[str, ...]:
        """See `FormModel.layers`."""
        return self.full.layers

    def region_stiffness(self, name: str, given: Mapping[str, float] | None = None) -> np.ndarray:
        """All of K, (n_dofs, n_dofs), which is the only layer."""
        if name not in self.layers:
            raise InputError(f"damping: {name!r}: expected 'all', the whole of a.")
        return self.stiffness(given)

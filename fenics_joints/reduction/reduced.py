"""Parametric reduced models: a structure projected on modes from samples of its parameters.

The stiffness and mass of every region with uniform properties are linear in a few scalars
(`structure.laws.Law.stiffness_terms`), so their projections are found once and the reduced
K(p) and M(p) are exact sums, at any p, without the mesh. What is approximate is the basis alone;
by the Rayleigh-Ritz theorem reduced frequencies are never below the full ones. `check` measures
the error at parameters that were not sampled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.projection import Projection
from fenics_joints.reduction.snapshots import SNAPSHOT, Snapshots
from fenics_joints.reduction.terms import RegionTerm
from fenics_joints.structure import Region, Sensors, Structure
from fenics_joints.structure.rows import PlaceRows


class ReducedStructure(ArrayModel):
    """A structure on a fixed basis; an `ArrayModel`, but that graded joints need the mesh.

    Args:
        structure: The full model.
        basis: Vectors of the basis, linearly independent; held DOFs are zero.
        travel: Range (low, high), m, over which a point mass with a parameter for its travel
            moves, by the mass's name.
        known: The model on the first of these vectors, where it is known: what is new alone is
            projected then. It has to have no graded joints.

    Attributes:
        full: The full model.
        basis: The basis.
    """

    def __init__(
        self,
        structure: Structure,
        basis: list[PETSc.Vec],
        travel: Mapping[str, tuple[float, float]] | None = None,
        known: ArrayModel | None = None,
    ):
        self.full, self.basis = structure, basis
        self.projection = on = Projection(structure, basis, known.n_dofs if known else 0)
        terms = {r.name: r for r in known.regions} if known else {}
        volumes, n = structure.volumes(), len(basis)
        self._graded = [i for i, region in enumerate(structure.regions) if _is_graded(region)]
        uniform = [i for i in range(len(structure.regions)) if i not in self._graded]
        regions = [self._region_term(i, volumes[i], terms) for i in uniform]
        regions += [
            on.support(i, s.properties, terms.get(s.name))
            for i, s in enumerate(structure.elastic_supports)
        ]
        regions += [on.change(c, terms.get(c.name)) for c in on.changes]
        pencil = AffinePencil(
            structure.parameters,
            regions,
            [on.spring(s) for s in structure.springs],
            [on.mass(m, (travel or {}).get(m.name)) for m in structure.masses],
            (np.zeros((n, n)), np.zeros((n, n))) if self._graded else None,
        )
        super().__init__(pencil, structure.dilation_frequency())
        self.resolved = structure.resolved
        self._sensor_rows: dict[tuple, np.ndarray] = {}

    def _region_term(self, number: int, volume: float, known: Mapping) -> RegionTerm:
        region, on = self.full.regions[number], self.projection
        samples = region.law.samples

        def new(which: int, sample: int) -> np.ndarray:
            A = self.full.law_matrix(number, which, sample)
            found = on.new(A)
            A.destroy()
            return found

        sampled = [new(0, i) for i in range(len(samples))]
        inertia = new(1, 0) / region.law.inertia_term(samples[0])
        return on.region(
            region, region.properties, sampled, inertia, volume, known.get(region.name)
        )

    # -- the calls of a model ------------------------------------------------------------------

    @property
    def regions(self) -> Sequence[Region]:
        """Parts and joints, with their laws and properties."""
        return self.full.regions

    @property
    def layers(self) -> tuple[str, ...]:
        """See `Structure.layers`."""
        return self.full.layers

    def _assemble(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        K, M = super()._assemble(values)
        for region in self._graded:
            K_region, M_region = self._varying(region, values)
            K, M = K + K_region, M + M_region
        return K, M

    def _varying(self, number: int, values) -> tuple[np.ndarray, np.ndarray]:
        """A region graded in space: assembled anew and projected."""
        self.full.field.update(values)
        K, M = self.full.region_matrices(number, None)
        return self.projection.matrix(K), self.projection.matrix(M)

    def values_of_slopes(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """See `ArrayModel.values_of_slopes`.

        Raises:
            InputError: If a region is graded, which has derivatives in the full model alone.
        """
        self._refuse_graded()
        return self.values(given)

    def observe(self, shapes: np.ndarray, sensors: Sensors) -> np.ndarray:
        """Displacement shapes at sensors, shape (n_sensors, n_shapes)."""
        key = (sensors.points.tobytes(), sensors.directions.tobytes())
        if key not in self._sensor_rows:
            self._sensor_rows[key] = self.full.observe(self.basis, sensors)
        return self._sensor_rows[key] @ shapes

    def loads(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """Loads of one newton on the basis, and what sensors read of it, (n_dofs, n_sensors).

        Raises:
            InputError: If one is outside the mesh; ``what`` is its name in the message.
        """
        self.full.rows(sensors.points, what, sensors.names)
        return self.observe(np.eye(self.n_dofs), sensors).T

    def region_stiffness(self, name: str, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Stiffness of one part, joint or elastic support alone, shape (n_dofs, n_dofs)."""
        for i in self._graded:
            if self.full.regions[i].name == name:
                return self._varying(i, self.values(given))[0]
        return super().region_stiffness(name, given)

    def arrays(self, *places: Sensors, sensors: Sensors | None = None) -> ArrayModel:
        """The same model as plain arrays, which need no mesh and no other rank. Collective.

        Args:
            places: Excitations and sensors for which it shall carry the displacements.
            sensors: What its ``sensor_rows`` see.

        Raises:
            InputError: If a region is graded, or a point outside the mesh.
        """
        self._refuse_graded()
        points = [np.asarray(s.points)[:, : self.full.gdim] for s in places]
        found = ArrayModel(self.pencil, self.scale_hz, *self.projection.sensors(sensors))
        if points:
            # Once each, in the order in which they are named.
            first = np.sort(np.unique(np.vstack(points), axis=0, return_index=True)[1])
            distinct = np.vstack(points)[first]
            found.places = PlaceRows(distinct, self.projection.points(distinct))
        return found

    def _refuse_graded(self) -> None:
        if self._graded:
            raise InputError(
                f"{self.full.regions[self._graded[0]].name}: derivatives and arrays of a graded "
                "joint need the full model; expected uniform properties in a reduced one."
            )

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg, as the full structure's."""
        return self.full.total_mass(given) if self._graded else super().total_mass(given)


def _is_graded(region: Region) -> bool:
    return any(callable(p) for p in region.properties.values())


def reduce(
    structure: Structure,
    samples: Iterable[Mapping[str, float]],
    n_modes: int,
    *,
    travel: Mapping[str, tuple[float, float]] | None = None,
    tolerance: float = 1e-8,
    more: Callable[[Modes], np.ndarray] | None = None,
) -> ReducedStructure:
    """Reduced model on the modes of the structure at samples of its parameters.

    Args:
        structure: The full model.
        samples: Parameter values at which modes are computed.
        n_modes: Modes at each sample, rigid-body ones included.
        travel: Ranges of moving masses, see `ReducedStructure`.
        tolerance: Directions with less than this share of the largest energy are left out. Of a
            structure on elastic supports 1e-10 is better: a share of 1e-8 moves frequencies on
            nearly rigid ones by some 1e-5.
        more: This rank's rows of further vectors for the basis, (n_local, k), by a sample's modes,
            whose solver has the factorisation there; none by default.

    Raises:
        InputError: Without samples.
    """
    snapshots, solver = Snapshots(structure), None
    for given in samples:
        modes = solve_modes(structure, given, n_modes=n_modes, solver=solver, tolerance=SNAPSHOT)
        solver = modes.solver
        snapshots.add(modes, more=more and more(modes))
    return ReducedStructure(structure, snapshots.basis(tolerance), travel)

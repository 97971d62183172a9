"""Parametric reduced models: a structure projected on modes from samples of its parameters.

The stiffness and mass of every region with uniform properties are linear in a few scalars
(`structure.laws.Law.stiffness_terms`), so their projections are found once and the reduced
K(p) and M(p) are exact sums, at any p, without the mesh. What is approximate is the basis alone;
by the Rayleigh-Ritz theorem reduced frequencies are never below the full ones. `check` measures
the error at parameters that were not sampled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.affine import AffinePencil, MassTerm, RegionTerm, SpringTerm
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.snapshots import (
    SNAPSHOT,
    Snapshots,
    dense_columns,
    orthonormal,
    project,
)
from fenics_joints.structure.components import PointMass, Region, Spring
from fenics_joints.structure.laws import ELASTIC_SUPPORT
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.rows import PlaceRows
from fenics_joints.structure.structure import Structure

__all__ = ["ReducedStructure", "enrich", "reduce"]

_TRAVEL_SAMPLES = 41


class ReducedStructure:
    """A structure on a fixed basis; a `fenics_joints.structure.model.Damped` with dense matrices.

    Args:
        structure: The full model.
        basis: Vectors of the basis, linearly independent; held DOFs are zero.
        travel: Range (low, high), m, over which a point mass with a parameter for its travel
            moves, by the mass's name.

    Attributes:
        parameters: The parameters by name, as the structure's.
        n_dofs: Size of the basis.
        scale_hz: The structure's dilation frequency, Hz, below which by far a mode is rigid.
    """

    def __init__(
        self,
        structure: Structure,
        basis: list[PETSc.Vec],
        travel: Mapping[str, tuple[float, float]] | None = None,
    ):
        self.full = structure
        self.parameters, self.values = structure.parameters, structure.values
        self.regions, self.layers, self.dampers = structure.regions, structure.layers, {}
        self.resolved = structure.resolved
        self.basis = basis
        self.n_dofs = len(basis)
        self._dense = dense_columns(basis)
        self.scale_hz = structure.dilation_frequency()
        volumes = structure.volumes()
        graded = [_is_graded(region) for region in structure.regions]
        self._graded = [i for i, varies in enumerate(graded) if varies]
        #: The affine terms: all that `matrices` needs, without the mesh.
        self.affine = AffinePencil(
            self.parameters,
            [
                *(self._region_term(i, v) for i, v in enumerate(volumes) if not graded[i]),
                *(self._support_term(i) for i in range(len(structure.elastic_supports))),
            ],
            [self._spring_term(s) for s in structure.springs],
            [self._mass_term(m, (travel or {}).get(m.name)) for m in structure.masses],
        )
        self._last: tuple | None = None
        self._sensor_rows: dict[tuple, np.ndarray] = {}

    # -- projection --------------------------------------------------------------------------

    def project(self, A: PETSc.Mat) -> np.ndarray:
        """Z^T A Z, shape (n_dofs, n_dofs), equal on all ranks. Collective."""
        return project(A, self._dense)

    def _region_term(self, number: int, volume: float) -> RegionTerm:
        """Projections of the law's stiffness terms and of the unit mass."""
        region = self.full.regions[number]
        law = region.law
        sampled, inertia = [], None
        for q in law.samples:
            K, M = self.full.region_matrices(number, q)
            sampled.append(self.project(K))
            if inertia is None:
                inertia = self.project(M) / law.inertia_terms(q)[0]
        theta = np.array([law.stiffness_terms(q) for q in law.samples], dtype=float)
        terms = np.linalg.solve(theta, np.array(sampled).reshape(len(sampled), -1))
        terms = terms.reshape(-1, self.n_dofs, self.n_dofs)
        return RegionTerm(region.name, law, region.properties, terms, inertia, float(volume))

    def _support_term(self, number: int) -> RegionTerm:
        """An elastic support as a region without volume: its law is linear in k_n and k_t."""
        support = self.full.elastic_supports[number]
        units = np.array([self.project(A) for A in self.full.support_matrices(number)])
        properties = {"k_n": support.k_n, "k_t": support.k_t}
        none = np.zeros_like(units[0])
        return RegionTerm(support.name, ELASTIC_SUPPORT, properties, units, none, 0.0)

    def point_rows(self, points) -> np.ndarray:
        """Displacement of the basis vectors at points, shape (n, gdim, n_dofs). Collective."""
        points = np.atleast_2d(np.asarray(points, dtype=float))
        gdim = self.full.gdim
        sensors = Sensors(
            np.repeat(points[:, :gdim], gdim, axis=0), np.tile(np.eye(gdim), (len(points), 1))
        )
        return self.full.observe(self.basis, sensors).reshape(len(points), gdim, self.n_dofs)

    def _mass_term(self, mass: PointMass, span) -> MassTerm:
        """The basis at the mass, along its travel if that is a parameter."""
        if not isinstance(mass.travel, str):
            stations = np.array([float(mass.travel)])
        elif span is None:
            raise InputError(
                f"{mass.name}.travel: a reduced model needs the range in which the mass moves; "
                "expected travel = {name: (low, high)} in metres."
            )
        else:
            stations = np.linspace(*span, _TRAVEL_SAMPLES)
        points = np.asarray(mass.point) + stations[:, None] * np.asarray(mass.direction)
        rows = self.point_rows(points)
        return MassTerm(mass.name, mass.mass, mass.travel, mass.share, stations, rows)

    def _spring_term(self, spring: Spring) -> SpringTerm:
        direction = np.asarray(spring.direction)[: self.full.gdim]
        row = direction @ self.point_rows(spring.point)[0]
        return SpringTerm(spring.name, spring.stiffness, spring.share, row)

    # -- the calls of a model ------------------------------------------------------------------

    #: See `fenics_joints.structure.model.Model`.
    is_dense, is_meshed = True, False

    def dilation_frequency(self, given: Mapping[str, float] | None = None) -> float:
        """`scale_hz`, which does not follow the parameters."""
        return self.scale_hz

    def stiffness(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Reduced K(p), shape (n_dofs, n_dofs)."""
        return self._pencil(self.values(given))[0]

    def mass(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Reduced M(p), shape (n_dofs, n_dofs)."""
        return self._pencil(self.values(given))[1]

    def _pencil(self, values):
        """(K, M); kept for the next call, since both are asked for one after the other."""
        key = tuple(values.values())
        if self._last is None or self._last[0] != key:
            self._last = (key, *self._assemble(values))
        return self._last[1:]

    def _assemble(self, values):
        K, M = self.affine.matrices(values)
        for region in self._graded:
            K_region, M_region = self._varying(region, values)
            K, M = K + K_region, M + M_region
        return K, M

    def _varying(self, number: int, values):
        """A region graded in space: assembled anew and projected."""
        self.full.field.update(values)
        K, M = self.full.region_matrices(number, None)
        return self.project(K), self.project(M)

    def pencil_gradients(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x by every parameter, shape (k, n_parameters).

        Args:
            shapes: Vectors x as columns, shape (n_dofs, k).
            eigenvalues: lambda of each, shape (k,).
            given: Values of parameters that differ from their nominal value.
        """
        self._refuse_graded()
        return self.affine.gradients(shapes, eigenvalues, self.values(given))

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
        self.full.rows(sensors.points, what)
        return self.observe(np.eye(self.n_dofs), sensors).T

    def region_stiffness(self, name: str, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Stiffness of one part, joint or elastic support alone, shape (n_dofs, n_dofs)."""
        for i in self._graded:
            if self.full.regions[i].name == name:
                return self._varying(i, self.values(given))[0]
        return self._affine_arrays.region_stiffness(name, given)

    def slopes(self, given: Mapping[str, float] | None = None, apart: Sequence[str] = ()):
        """dK/dp and dM/dp as matrices, see `ArrayModel.slopes`.

        Raises:
            InputError: If a region is graded.
        """
        self._refuse_graded()
        return self._affine_arrays.slopes(given, apart)

    @cached_property
    def _affine_arrays(self) -> ArrayModel:
        """What does not vary in space, as plain arrays."""
        return ArrayModel(self.affine, self.scale_hz)

    def arrays(self, *places: Sensors) -> ArrayModel:
        """The same model as plain arrays, which need no mesh and no other rank. Collective.

        Args:
            places: Excitations and sensors for which it shall carry the displacements.

        Raises:
            InputError: If a region is graded, or a point outside the mesh.
        """
        self._refuse_graded()
        points = [np.asarray(s.points)[:, : self.full.gdim] for s in places]
        if not points:
            return self._affine_arrays
        # Once each, in the order in which they are named.
        first = np.sort(np.unique(np.vstack(points), axis=0, return_index=True)[1])
        distinct = np.vstack(points)[first]
        return replace(self._affine_arrays, places=PlaceRows(distinct, self.point_rows(distinct)))

    def _refuse_graded(self) -> None:
        if self._graded:
            raise InputError(
                f"{self.full.regions[self._graded[0]].name}: derivatives and arrays of a graded "
                "joint need the full model; expected uniform properties in a reduced one."
            )

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg, as the full structure's."""
        if self._graded:
            return self.full.total_mass(given)
        return self.affine.total_mass(self.values(given))


def _is_graded(region: Region) -> bool:
    return any(callable(p) for p in region.properties.values())


def reduce(
    structure: Structure,
    samples: Iterable[Mapping[str, float]],
    n_modes: int,
    *,
    travel: Mapping[str, tuple[float, float]] | None = None,
    tolerance: float = 1e-8,
    keep: Callable[[Modes], np.ndarray] | None = None,
    progress: Callable[[], None] | None = None,
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
        keep: Which modes of a sample enter the basis, as indices; all by default. Leaving out
            those that a test cannot see makes the reduced model several times faster.
        progress: Called after each sample.

    Raises:
        InputError: Without samples.
    """
    snapshots, solver = Snapshots(structure), None
    for given in samples:
        modes = solve_modes(structure, given, n_modes=n_modes, solver=solver, tolerance=SNAPSHOT)
        solver = modes.solver
        snapshots.add(modes, None if keep is None else keep(modes))
        if progress:
            progress()
    return ReducedStructure(structure, snapshots.basis(tolerance), travel)


def enrich(
    structure: Structure,
    basis: list[PETSc.Vec],
    shapes: list[PETSc.Vec],
    travel: Mapping[str, tuple[float, float]] | None = None,
    tolerance: float = 1e-8,
) -> ReducedStructure:
    """A reduced model on a basis with further shapes of the full one in it.

    Args:
        structure: The full model.
        basis: The basis so far.
        shapes: Shapes to add.
        travel: Ranges of moving masses, see `ReducedStructure`.
        tolerance: As in `reduce`.
    """
    joined = orthonormal(structure, [*basis, *shapes], None, tolerance)
    return ReducedStructure(structure, joined, travel)

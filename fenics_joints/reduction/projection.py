"""Parts, joints and points of a structure on a basis, as the terms of an `AffinePencil`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.reduction.bends import bends
from fenics_joints.reduction.forward import ways_of
from fenics_joints.reduction.snapshots import bordered, cross, dense_columns, project
from fenics_joints.reduction.terms import MassTerm, RegionTerm, SpringTerm
from fenics_joints.structure import PointMass, Region, Sensors, Spring, Structure
from fenics_joints.structure.changes import Change, PlacedPoint, PlacedResonator, forms_of
from fenics_joints.structure.laws import ELASTIC_SUPPORT

_TRAVEL_SAMPLES = 41


class Projection:
    """A structure's matrices and points on a basis. All calls are collective.

    Args:
        structure: The full model.
        basis: Vectors of the basis, linearly independent; held DOFs are zero.
        n_known: Of how many of these, the first, terms are known: those of the others alone are
            looked for.
    """

    def __init__(self, structure: Structure, basis: Sequence[PETSc.Vec], n_known: int = 0):
        self.full, self.basis = structure, basis
        self._dense = dense_columns(basis)
        self._moves: dict[bytes, np.ndarray] = {}
        self._new = dense_columns(basis[n_known:]) if n_known else self._dense

    @property
    def changes(self) -> list[Change]:
        """Those of the structure without own motions (`fenics_joints.reduction.motions`)."""
        return [c for c in self.full.changes if not isinstance(c, PlacedResonator)]

    def matrix(self, A: PETSc.Mat) -> np.ndarray:
        """Z^T A Z, shape (n, n), equal on all ranks."""
        return project(A, self._dense)

    def new(self, A: PETSc.Mat) -> np.ndarray:
        """The columns of `matrix` of what is not known, shape (n, n - n_known)."""
        return cross(A, self._dense, self._new)

    def points(self, points) -> np.ndarray:
        """Displacement of the basis vectors at points, shape (n_points, gdim, n)."""
        points = np.atleast_2d(np.asarray(points, dtype=float))
        gdim = self.full.gdim
        sensors = Sensors(
            np.repeat(points[:, :gdim], gdim, axis=0), np.tile(np.eye(gdim), (len(points), 1))
        )
        return self.full.observe(self.basis, sensors).reshape(len(points), gdim, len(self.basis))

    def moves(self, change: PlacedPoint | PlacedResonator) -> np.ndarray:
        """Motion of what is attached, and its slopes along x, y and z, (4, gdim, n)."""
        key = change.points.tobytes()
        if key not in self._moves:
            self._moves[key] = np.tensordot(change.weights, self.points(change.points), 1)
        return self._moves[key]

    def sensors(self, sensors: Sensors | None) -> tuple[np.ndarray | None, np.ndarray | None]:
        """What sensors read of the basis, (n_s, n), and the same per metre that they sit further
        along each of their ways, (n_ways, n_s, n); of two ways then `bends`, per m2 and m3."""
        if sensors is None:
            return None, None
        ways = ways_of(sensors, self.full.gdim)
        rows = self.full.observe(self.basis, sensors)
        slopes = np.array([self.full.observe_slopes(self.basis, sensors, way) for way in ways])
        if len(ways) == 2:
            slopes = np.concatenate(
                [slopes, bends(self.full, self.basis, sensors, ways, rows, slopes)]
            )
        return rows, slopes

    def region(
        self,
        region: Region,
        properties: Mapping[str, float | str],
        sampled: Sequence[np.ndarray],
        inertia: np.ndarray | None = None,
        volume: float = 0.0,
        known: RegionTerm | None = None,
    ) -> RegionTerm:
        """A part or joint.

        Args:
            region: The region.
            properties: Its properties, numbers or names of parameters.
            sampled: Its projected stiffness at each of its law's samples, as `new` has it.
            inertia: Its projected mass at a unit of its law's inertia, likewise; None for none.
            volume: As meshed, m3.
            known: The term on the basis vectors of which it is known.
        """
        law, shape = region.law, np.shape(sampled[0])
        theta = np.array([law.stiffness_terms(q) for q in law.samples], dtype=float)
        terms = np.linalg.solve(theta, np.reshape(sampled, (len(theta), -1))).reshape(-1, *shape)
        heavy = np.zeros(shape) if inertia is None else inertia
        return _term(region.name, law, properties, terms, heavy, float(volume), known)

    def support(
        self, number: int, properties: Mapping[str, float | str], known: RegionTerm | None = None
    ) -> RegionTerm:
        """An elastic support as a region without volume: its law is linear in k_n and k_t."""
        name = self.full.elastic_supports[number].name
        units = np.array([self.new(A) for A in self.full.support_matrices(number)])
        return _term(name, ELASTIC_SUPPORT, properties, units, 0.0 * units[0], 0.0, known)

    def change(self, change: Change, known: RegionTerm | None = None) -> RegionTerm:
        """What else changes of the structure, as a region of its own law."""
        if isinstance(change, PlacedPoint):
            a, b = self.moves(change)[list(change.pair)]
            own = a[:, :, None] * b[:, None, :]
            own = own if change.pair[0] == change.pair[1] else own + own.transpose(0, 2, 1)
            own = own[:, :, -self._new.getSize()[1] :]
            return _term(
                change.name,
                change.law,
                change.properties,
                own,
                own.sum(axis=0),
                change.volume,
                known,
            )
        stiff, heavy = [], None
        for which in range(1 + change.has_mass):
            for form in forms_of(self.full, change, which, True):
                projected = self.new(form.A)
                form.destroy()
                if which:
                    heavy = projected
                else:
                    stiff.append(projected)
        heavy = 0.0 * stiff[0] if heavy is None else heavy
        return _term(
            change.name, change.law, change.properties, np.array(stiff), heavy, change.volume, known
        )

    def spring(self, spring: Spring) -> SpringTerm:
        """A grounding spring."""
        direction = np.asarray(spring.direction)[: self.full.gdim]
        row = direction @ self.points(spring.point)[0]
        return SpringTerm(spring.name, spring.stiffness, spring.share, row)

    def mass(self, mass: PointMass, span: tuple[float, float] | None = None) -> MassTerm:
        """A point mass, along its travel if that is a parameter.

        Args:
            mass: The mass.
            span: Range of its travel, m.

        Raises:
            InputError: If there is none and the mass moves.
        """
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
        return MassTerm(
            mass.name, mass.mass, mass.travel, mass.share, stations, self.points(points)
        )


def _term(name, law, properties, new: np.ndarray, heavy, volume, known) -> RegionTerm:
    """A region's term from its columns that are new."""
    if known is None:
        none = np.zeros((0, 0))
        before = np.zeros((len(new), 0, 0)), none
    else:
        before = known.stiffness, known.inertia
    return RegionTerm(
        name, law, properties, bordered(before[0], new), bordered(before[1], heavy), volume
    )

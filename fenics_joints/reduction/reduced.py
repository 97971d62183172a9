"""Parametric reduced models: a structure projected on modes from samples of its parameters.

The stiffness and mass of every region with uniform properties are linear in a few scalars
(`structure.laws.Law.stiffness_terms`), so their projections are found once and the reduced
K(p) and M(p) are exact sums, at any p, without the mesh. The basis is the only approximation;
by the Rayleigh-Ritz theorem reduced frequencies are never below the full ones. `check` measures
the error at parameters that were not sampled.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.modal.modes import Modes, eigen_solver, solve_modes
from fenics_joints.parallel import spread
from fenics_joints.reduction.affine import (
    AffinePencil,
    RegionTerm,
    TravellingMass,
    mass_term,
    spring_term,
)
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.basis import SNAPSHOT, Snapshots
from fenics_joints.reduction.forms import ProjectedModel, on_basis
from fenics_joints.reduction.prediction import ways_of
from fenics_joints.structure import FormModel, PointMass, Region, Sensors, Spring, Structure
from fenics_joints.structure.changes import Change, PlacedPoint, PlacedResonator, forms_of
from fenics_joints.structure.components import ElasticSupport, number
from fenics_joints.structure.laws import ELASTIC_SUPPORT
from fenics_joints.structure.points import PlaceRows
from fenics_joints.structure.sparse import as_columns, bordered, cross, project, vectors_like

#: Radius within which nodes are used, over the largest distance of two sensors: a third larger than
#: a sensor may be misplaced (`fenics_joints.diagnosis.effects.rig.misplaced_sensor`).
_REACH = 0.2
#: Height of a node over a sensor's face, over its distance, up to which it is on that face: chosen.
_FLAT = 0.25
#: Share of the largest moment of the nodes below which a curvature is not determined: chosen.
_TOLD = 1e-3
#: Nodes of a face at most; of more, some at all distances are taken: chosen, for time.
_MOST = 60
#: Exponents (i, j) of the monomials a^i b^j of degrees two and three.
_POWERS = tuple((order - k, k) for order in (2, 3) for k in range(order + 1))
#: How many these are.
N_BENDS = len(_POWERS)


def monomials(a, b) -> np.ndarray:
    """a^2, a b, b^2, a^3, a^2 b, a b^2, b^3, (7, ...).

    Args:
        a: Distances along the first way, m.
        b: Along the second, m.
    """
    return np.array([a**i * b**j for i, j in _POWERS])


def shape_curvature(
    structure: Structure,
    basis: Sequence[PETSc.Vec],
    sensors: Sensors,
    ways: np.ndarray,
    rows: np.ndarray,
    slopes: np.ndarray,
) -> np.ndarray:
    """Coefficients of `monomials` in what sensors read about their places, 1/m2 and 1/m3, (7,
    n_sensors, n), by least squares over the nodes around each. Collective.

    Args:
        structure: The full model.
        basis: Vectors, owned entries.
        sensors: The sensors.
        ways: Two directions on the face of each, (2, n_sensors, gdim).
        rows: Their readings of each vector, (n_sensors, n).
        slopes: Derivatives of the readings along each direction, (2, n_sensors, n).
    """
    gdim = structure.gdim
    points, normals = sensors.points[:, :gdim], sensors.directions[:, :gdim]
    reach = _REACH * np.max(np.linalg.norm(points[:, None] - points, axis=2), initial=0.0)
    nodes = [_round_about(structure, x, n, reach) for x, n in zip(points, normals, strict=True)]
    found = np.zeros((N_BENDS, len(points), len(basis)))
    at = np.vstack(nodes)
    if not len(at):
        return found
    of = np.repeat(np.arange(len(points)), [len(each) for each in nodes])
    read = structure.observe(basis, Sensors(at, normals[of]))
    for i, x in enumerate(points):
        off, own = at[of == i] - x, read[of == i]
        a, b = off @ ways[0, i], off @ ways[1, i]
        left = own - rows[i] - np.outer(a, slopes[0, i]) - np.outer(b, slopes[1, i])
        powers = monomials(a / reach, b / reach)
        weight = powers * (reach**2 / np.maximum(a**2 + b**2, 1e-300))
        moments = weight @ powers.T
        found[:, i] = np.linalg.pinv(moments, rcond=_TOLD, hermitian=True) @ (weight @ left)
    return found / np.array([reach ** (i + j) for i, j in _POWERS])[:, None, None]


def _round_about(structure: Structure, x: np.ndarray, normal: np.ndarray, reach: float):
    """Nodes of the mesh near a point and on its face, nearest first, (k, gdim). Collective."""
    nodes = structure.mesh.geometry.x[:, : structure.gdim]
    off = nodes - x
    along = np.linalg.norm(off - np.outer(off @ normal, normal), axis=1)
    near = (along > 0) & (along <= reach) & (np.abs(off @ normal) <= _FLAT * along)
    every = np.vstack(structure.comm.allgather(nodes[near]))
    grain = 1e-6 * max(reach, 1e-300)
    every = every[np.unique(np.round(every / grain), axis=0, return_index=True)[1]]
    away = np.round(np.linalg.norm(every - x, axis=1) / grain)
    order = np.argsort(away, kind="stable")
    return every[order[:: max(-(-len(order) // _MOST), 1)]]


#: What has a term of its own in a reduced model.
Part = Region | ElasticSupport | Change
#: Stations of the spline along the path of a mass that moves: chosen.
_TRAVEL_SAMPLES = 41


class Projection:
    """A structure's matrices and points on a basis. All calls are collective.

    Args:
        structure: The full model.
        basis: Vectors of the basis, linearly independent; held DOFs are zero.
        n_known: Number of the first vectors on which terms are known; only the columns of the
            others are computed.
        ranks: Ranks that share the components out, where each has the whole structure.
    """

    def __init__(
        self,
        structure: Structure,
        basis: Sequence[PETSc.Vec],
        n_known: int = 0,
        ranks: MPI.Intracomm = MPI.COMM_SELF,
    ):
        self.full, self.basis, self.ranks = structure, basis, ranks
        self._dense = as_columns(basis)
        self._moves: dict[bytes, np.ndarray] = {}
        self._new = self._dense[:, n_known:]

    @property
    def changes(self) -> list[Change]:
        """The structure's changes, but for oscillators: see `with_motions`."""
        return [c for c in self.full.changes if not isinstance(c, PlacedResonator)]

    def matrix(self, A: PETSc.Mat) -> np.ndarray:
        """Z^T A Z, shape (n, n), equal on all ranks."""
        return project(A, self._dense)

    def new(self, A: PETSc.Mat) -> np.ndarray:
        """The columns of `matrix` that are not known, (n, n - n_known)."""
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
        """Motion of the basis where something is attached, and its slopes along x, y and z, (4,
        gdim, n)."""
        key = change.points.tobytes()
        if key not in self._moves:
            self._moves[key] = np.tensordot(change.weights, self.points(change.points), 1)
        return self._moves[key]

    def sensors(self, sensors: Sensors | None) -> tuple[np.ndarray | None, np.ndarray | None]:
        """See ``sensor_rows`` and ``shift_rows`` of `ArrayModel`."""
        if sensors is None:
            return None, None
        ways = ways_of(sensors, self.full.gdim)
        rows = self.full.observe(self.basis, sensors)
        slopes = np.array([self.full.observe_slopes(self.basis, sensors, way) for way in ways])
        if len(ways) == 2:
            slopes = np.concatenate(
                [slopes, shape_curvature(self.full, self.basis, sensors, ways, rows, slopes)]
            )
        return rows, slopes

    def pencil(
        self,
        travel: Mapping[str, tuple[float, float]] | None = None,
        known: Mapping[str, RegionTerm] | None = None,
        free: Container[str] | None = None,
        given: Mapping[str, float] | None = None,
    ) -> AffinePencil:
        """All components that do not vary in space, as terms on the basis.

        Args:
            travel: Range of each moving mass, m, by its name.
            known: Terms on the vectors that are known, by name.
            free: Names of parameters, no places; only parts, joints, supports, springs and masses
                that name one of these are taken. None for all components.
            given: With ``free``: values of all parameters, where those masses are.

        Raises:
            InputError: If a mass moves and ``travel`` has no range for it.
        """
        full, known = self.full, known or {}

        def taken(*values: object) -> bool:
            return free is None or any(isinstance(v, str) and v in free for v in values)

        parts: list[Part] = [
            part
            for part in (*full.regions, *full.elastic_supports)
            if taken(*part.properties.values()) and not is_graded(part)
        ]
        parts += self.changes if free is None else []
        regions = self.terms(parts, known)
        masses = full.masses
        if free is not None:
            masses = [replace(m, travel=number(m.travel, given)) for m in masses if taken(m.mass)]
        points = [self.spring(spring) for spring in full.springs if taken(spring.stiffness)]
        points += [self.mass(mass, (travel or {}).get(mass.name)) for mass in masses]
        return AffinePencil(full.parameters, regions, points)

    def terms(
        self, parts: Sequence[Part], known: Mapping[str, RegionTerm] | None = None
    ) -> list[RegionTerm]:
        """Parts, joints, elastic supports and changes of the structure.

        Args:
            parts: The structure's own.
            known: Terms on the basis vectors of which they are known, by name.
        """
        known, found = known or {}, []
        meshed = zip(map(id, self.full.regions), self.full.volumes().tolist(), strict=True)
        volumes = {id(part): getattr(part, "volume", 0.0) for part in parts} | dict(meshed)
        for part, arrays in zip(parts, spread(self.ranks, parts, self._arrays), strict=True):
            law = getattr(part, "law", ELASTIC_SUPPORT)
            own = part.name, law, part.properties
            found.append(_term(*own, *arrays, volumes[id(part)], known.get(part.name)))
        return found

    def _arrays(self, part: Part) -> tuple[np.ndarray, np.ndarray]:
        """New columns of the stiffness before each of a part's scalars, and of its inertia."""
        if isinstance(part, Region):
            return self._of_region(self.full.regions.index(part))
        if isinstance(part, ElasticSupport):
            number = self.full.elastic_supports.index(part)
            units = np.array([self.new(A) for A in self.full.support_matrices(number)])
            return units, 0.0 * units[0]
        if isinstance(part, PlacedPoint):
            a, b = self.moves(part)[list(part.pair)]
            own = a[:, :, None] * b[:, None, :]
            own = own if part.pair[0] == part.pair[1] else own + own.transpose(0, 2, 1)
            own = own[:, :, -self._new.shape[1] :]
            return own, own.sum(axis=0)
        stiff, heavy = [], None
        for which in range(1 + part.has_mass):
            for form in forms_of(self.full, part, which, True):
                projected = self.new(form.A)
                form.destroy()
                if which:
                    heavy = projected
                else:
                    stiff.append(projected)
        return np.array(stiff), 0.0 * stiff[0] if heavy is None else heavy

    def _of_region(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        law, samples = self.full.regions[number].law, self.full.regions[number].law.samples

        def projected(A: PETSc.Mat) -> np.ndarray:
            found = self.new(A)
            A.destroy()
            return found

        mass = projected(self.full.law_matrix(number, 1, 0)) / law.inertia_term(samples[0])
        if (terms := self.full.law_terms(number)) is not None:
            return np.array([projected(A) for A in terms]), mass
        every = range(len(samples))
        sampled = np.array([projected(self.full.law_matrix(number, 0, i)) for i in every])
        theta = np.array([law.stiffness_terms(q) for q in samples], dtype=float)
        return np.linalg.solve(theta, sampled.reshape(len(theta), -1)).reshape(sampled.shape), mass

    def spring(self, spring: Spring) -> RegionTerm:
        """A grounding spring."""
        direction = np.asarray(spring.direction)[: self.full.gdim]
        row = direction @ self.points(spring.point)[0]
        return spring_term(spring.name, spring.stiffness, spring.share, row)

    def mass(
        self, mass: PointMass, span: tuple[float, float] | None = None
    ) -> RegionTerm | TravellingMass:
        """A point mass, along its travel if that is a parameter.

        Args:
            mass: The mass.
            span: Range of its travel, m.

        Raises:
            InputError: If there is no range and the mass moves.
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
        return mass_term(
            mass.name, mass.mass, mass.travel, mass.share, stations, self.points(points)
        )


def _term(name, law, properties, new: np.ndarray, heavy, volume, known) -> RegionTerm:
    """A region's term from its new columns and the known term."""
    if known is None:
        none = np.zeros((0, 0))
        before = np.zeros((len(new), 0, 0)), none
    else:
        before = known.stiffness, known.inertia
    return RegionTerm(
        name, law, properties, bordered(before[0], new), bordered(before[1], heavy), volume
    )


class ReducedStructure(ArrayModel):
    """A structure on a fixed basis; an `ArrayModel`, but that graded joints need the mesh.

    Args:
        structure: The full model.
        basis: Vectors of the basis, linearly independent; held DOFs are zero.
        travel: Range (low, high), m, over which a point mass with a parameter for its travel
            moves, by the mass's name.
        known: The model on the first of these vectors, if known: then only the others are
            projected. It must have no graded joints.
        ranks: See `Projection`.

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
        ranks: MPI.Intracomm = MPI.COMM_SELF,
    ):
        self.full, self.basis = structure, basis
        self.projection = Projection(structure, basis, known.n_dofs if known else 0, ranks)
        self._graded = [i for i, region in enumerate(structure.regions) if is_graded(region)]
        pencil = self.projection.pencil(travel, {r.name: r for r in known.regions} if known else {})
        if self._graded:
            zero = np.zeros((len(basis), len(basis)))
            pencil = replace(pencil, fixed=(zero, zero))
        super().__init__(pencil, structure.dilation_frequency())
        self.resolved = structure.resolved
        self._sensor_rows: dict[tuple, np.ndarray] = {}

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
        """Stiffness and mass of a region graded in space, assembled anew and projected."""
        self.full.field.update(values)
        matrices = (self.full.region_matrix(number, which, None) for which in (0, 1))
        return tuple(map(self.projection.matrix, matrices))

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
            sensors: Sensors of its ``sensor_rows``.

        Raises:
            InputError: If a region is graded, or a point outside the mesh.
        """
        self._refuse_graded()
        points = [np.asarray(s.points)[:, : self.full.gdim] for s in places]
        found = ArrayModel(self.pencil, self.scale_hz, *self.projection.sensors(sensors))
        if points:
            # Each once, in the order given.
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


def is_graded(region: Region | ElasticSupport) -> bool:
    """Whether a property of a part, joint or elastic support varies in space."""
    return any(callable(p) for p in region.properties.values())


def solve_shared(
    ranks: MPI.Intracomm,
    full: Structure,
    points: Sequence[Mapping[str, float]],
    solve: Callable[[Mapping[str, float]], Modes | None],
    solver: EigenSolver | None = None,
) -> list[Modes | None]:
    """Modes of a structure at points, each solved for on one rank, on all. Collective.

    Args:
        ranks: Ranks that have the whole structure each; one where they share its mesh.
        full: The structure.
        points: Parameter values.
        solve: Gives its modes, or None.
        solver: Named as that of the modes.
    """

    def pack(modes: Modes | None):
        if modes is None:
            return None
        return modes.eigenvalues, as_columns(modes.shapes).T, modes.n_rigid

    def unpack(values, packed) -> Modes | None:
        if packed is None:
            return None
        eigenvalues, rows, n_rigid = packed
        like = PETSc.Vec().createMPI((full.n_local, None), comm=full.comm)
        shapes = vectors_like(like, rows)
        return Modes(full, dict(values), eigenvalues, shapes, n_rigid, solver=solver)

    return spread(ranks, points, solve, pack, unpack)


def reduce(
    structure: Structure | FormModel,
    samples: Iterable[Mapping[str, float]],
    n_modes: int,
    *,
    travel: Mapping[str, tuple[float, float]] | None = None,
    tolerance: float = 1e-8,
    more: Callable[[Modes], np.ndarray] | None = None,
    ranks: MPI.Intracomm = MPI.COMM_SELF,
) -> ReducedStructure | ProjectedModel:
    """Reduced model on the modes of the structure at samples of its parameters.

    Args:
        structure: The full model: a structure, or one by forms that are linear in its parameters.
        samples: Parameter values at which modes are computed.
        n_modes: Modes at each sample, rigid-body ones included.
        travel: Ranges of moving masses, see `ReducedStructure`.
        tolerance: Directions with less than this share of the largest energy are left out. On
            nearly rigid elastic supports 1e-8 shifts frequencies by some 1e-5; take 1e-10 there.
        more: ``modes -> (n_local, k)``, this rank's rows of further vectors at a sample; the modes'
            solver holds the factorisation there. None by default; not on several ``ranks``.
        ranks: See `solve_shared`.

    Raises:
        InputError: Without samples, or of forms that are not linear in a parameter.
    """
    snapshots, samples = Snapshots(structure), list(samples)
    solver = eigen_solver(structure, samples[0], n_modes, SNAPSHOT) if samples else None

    def solve(given: Mapping[str, float]) -> Modes:
        return solve_modes(structure, given, n_modes=n_modes, solver=solver)

    solved = (solve(given) for given in samples)
    if ranks.size > 1:
        solved = solve_shared(ranks, structure, samples, solve, solver)
    for modes in solved:
        snapshots.add(modes, more=more and more(modes))
    basis = snapshots.basis(tolerance)
    if isinstance(structure, FormModel) or hasattr(structure, "on_basis"):
        return on_basis(structure, basis)
    return ReducedStructure(structure, basis, travel)


class MovingModel(ArrayModel):
    """A reduced model with an attached oscillator's motion, which can be observed anywhere.

    Args:
        reduced: The model without that motion.
    """

    def __init__(self, reduced: ReducedStructure):
        found = with_motions(reduced.arrays(), reduced.full, reduced.basis)
        super().__init__(found.pencil, found.scale_hz, hung=found.hung)
        self.reduced = reduced

    def observe(self, shapes: np.ndarray, sensors: Sensors) -> np.ndarray:
        """Displacement shapes at sensors, shape (n_sensors, n_shapes)."""
        return self.reduced.observe(shapes[: self.reduced.n_dofs], sensors)

    def points(self, points: np.ndarray) -> np.ndarray:
        """Displacement of the basis at points, shape (n_points, gdim, n_dofs)."""
        found = self.reduced.projection.points(points)
        return np.pad(found, [(0, 0), (0, 0), (0, self.n_dofs - self.reduced.n_dofs)])


def with_motions(model: ArrayModel, full: Structure, basis: Sequence[PETSc.Vec]) -> ArrayModel:
    """A reduced model with the displacement of an attached oscillator as further unknowns, one for
    each direction; the model itself if there is none. Collective.

    The oscillator's spring is stretched by the structure's displacement at its place less that
    displacement, which is in units in which its idle stiffness is 1 N/m. Sensors do not see it.

    Args:
        model: The model of plain arrays without it.
        full: The structure.
        basis: The model's basis.
    """
    hung = [c for c in full.changes if isinstance(c, PlacedResonator)]
    if not hung:
        return model
    n, gdim = model.n_dofs, full.gdim
    wider = _wider(model, gdim)
    unit = 1.0 / np.sqrt(hung[0].values(full.values())["stiffness"])
    terms, on = [], Projection(full, basis)
    for c in hung:
        still = [-unit * np.eye(gdim), *[np.zeros((gdim, gdim))] * gdim]
        a, b = (np.hstack([on.moves(c)[way], still[way]]) for way in c.pair)
        stiff = a.T @ b if c.pair[0] == c.pair[1] else a.T @ b + b.T @ a
        own = np.zeros((n + gdim, n + gdim))
        own[n:, n:] = unit**2 * c.volume * np.eye(gdim)
        terms.append(RegionTerm(c.name, c.law, c.properties, stiff[None], own, c.volume))
    pencil = replace(wider.pencil, regions=[*wider.regions, *terms])
    name = hung[0].properties["mass"]
    return replace(wider, pencil=pencil, hung=(name, unit * np.eye(gdim, n + gdim, n)))


def _wider(model: ArrayModel, more: int) -> ArrayModel:
    """A model with further unknowns, which have neither stiffness nor mass yet."""

    def rows(a: np.ndarray) -> np.ndarray:
        return np.pad(a, [*[(0, 0)] * (a.ndim - 1), (0, more)])

    def both(a: np.ndarray) -> np.ndarray:
        return np.pad(a, [*[(0, 0)] * (a.ndim - 2), *[(0, more)] * 2])

    return model.mapped(both, rows)

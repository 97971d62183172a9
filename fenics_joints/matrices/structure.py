"""K(p) and M(p) of parts by matrices, their joints, masses, springs and supports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError, wanted
from fenics_joints.matrices.faces import NodeInterface
from fenics_joints.matrices.part import MatrixPart
from fenics_joints.reduction.affine import POINT_MASS, SPRING, AffinePencil, LawScalars, RegionTerm
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.forms import ProjectedModel
from fenics_joints.reduction.frf_basis import CombinedModel
from fenics_joints.reduction.greedy import FreePencil, GreedyModel, free_pencil
from fenics_joints.reduction.surrogate import ReducedFormModel, SmallModels, tested_models
from fenics_joints.structure import Damping, Parameter, PointMass, Sensors, Spring
from fenics_joints.structure.components import by_name, number, parameter_values
from fenics_joints.structure.laws import ELASTIC_SUPPORT, LAYER_LAWS, SPRINGS, Law
from fenics_joints.structure.sparse import MatrixForm, as_columns, project

#: A part's matrices are those at E = rho = 1: K is in proportion to one, M to the other.
MATRICES = Law(
    "matrices",
    ("E", "rho"),
    None,
    lambda q: np.array([q["E"]]),
    ({"E": 1.0, "rho": 1.0},),
    lambda where, q: _positive(where, q),
    inertia_term=lambda q: q["rho"],
)
#: Half of the edge of the cube that shows a node, over the spacing of nodes.
_CUBE = 0.25


def _positive(where: str, q: Mapping[str, object]) -> None:
    for key, value in q.items():
        if not np.all(np.asarray(value) > 0):
            raise InputError(f"{where}.{key} = {np.min(value):g}: expected more than 0")


@dataclass(frozen=True)
class MatrixJoint:
    """A joint law on an interface between parts by matrices.

    Attributes:
        name: Its name.
        interface: Where the faces touch.
        properties: Values of the law's properties, or names of parameters: ``k_n`` and ``k_t``,
            Pa/m, of springs.
        law: `structure.laws.SPRINGS`, a law of the jump by `structure.joint_law`, or the uncoupled
            layer with E and G.
        thickness: Of a layer with E and G, m.
        which: Mask of the interface's points that it holds, (n,); None for all.
    """

    name: str
    interface: NodeInterface
    properties: Mapping[str, float | str]
    law: Law = SPRINGS
    thickness: float = 1.0
    which: np.ndarray | None = field(default=None, repr=False)

    def matrices(self) -> list[sp.csr_matrix]:
        """The matrix of each of the law's scalars."""
        n = self.interface.normal
        across, along = np.outer(n, n), np.eye(3) - np.outer(n, n)
        if self.law is SPRINGS:
            tensors = [across, along]
        elif self.law is LAYER_LAWS["uncoupled"]:
            # In a layer without extent only gradients across it count: E / s and G / s.
            tensors = [across / self.thickness, along / self.thickness]
            tensors += [np.zeros((3, 3))] * 2
        elif self.law.at_jump is not None:
            tensors = self.law.at_jump(n)
        else:
            raise InputError(
                f"{self.name}: law {self.law.name!r} is of a layer of cells: expected springs, or "
                "a law of the jump"
            )
        return [self.interface.matrix(tensor, self.which) for tensor in tensors]

    def all_properties(self) -> dict[str, float | str]:
        """With those that every layer has: it has no mass, and is as thick as meshed."""
        rest = {"rho": 0.0, "meshed": 1.0, "stretch": 1.0}
        return {k: self.properties.get(k, rest.get(k)) for k in self.law.properties}


@dataclass
class _Term:
    """A part, joint, mass, spring or elastic support: this rank's rows of its matrices."""

    name: str
    law: Law
    properties: Mapping[str, float | str]
    stiffness: list[sp.csr_matrix]
    inertia: sp.csr_matrix | None = None
    weight: float = 0.0
    is_layer: bool = True
    pieces: list[tuple[str, sp.csr_matrix, sp.csr_matrix]] = field(default_factory=list)

    def varies(self, free: Sequence[str], key: str | None = None) -> bool:
        """Whether some parameters are its properties, or that of one key."""
        named = self.properties.values() if key is None else [self.properties[key]]
        return any(isinstance(name, str) and name in free for name in named)

    def at(self, values: Mapping[str, float]) -> LawScalars:
        q = {key: number(self.properties[key], values) for key in self.law.properties}
        self.law.check(self.name, q)
        return LawScalars(self.law, q)


class MatrixStructure:
    """Parts by matrices, joined by joint laws; fulfils `fenics_joints.structure.Damped`.

    K and M are exact sums over the parameters. Modes, FRFs, updating, reduced models, sampling and
    diagnosis take it as they take a `Structure`. Each rank keeps its rows of the matrices.

    Args:
        parts: The parts.
        joints: The joints between them.
        parameters: Parameters that the properties name.
        properties: By region ``E`` and ``rho``, with which K and M grow in proportion: the values
            at which the matrices were made, or names of parameters whose values now are these.
        regions: Names of parts that are of one material, by the name of the region that they make;
            a part in none is one by itself.
        masses: Point masses, at nodes or near them.
        springs: Springs to the ground, likewise.
        supports: Pairs (part's name, rows) of held degrees of freedom.
        elastic: (name, interface-like matrices across and along, k_n, k_t) of elastic supports.
        damping: Viscous matrices of parts by name, N s/m, as dampers ``NAME.C``: a response has
            those that ``Damping.viscous`` names, such as ``{"NAME.C": 1.0}``; `resolved` adds all.
        comm: Communicator.

    Attributes:
        parts_of_regions: The parts that each region is made of, by its name.

    Raises:
        InputError: If names do not match, or a mass or spring is on no part.
    """

    is_dense, is_meshed = False, False
    gdim = 3
    #: What a `Structure` has and this one does not: cells with laws, changes at sites.
    regions, changes, elastic_supports = (), (), ()

    def __init__(
        self,
        parts: Sequence[MatrixPart],
        joints: Sequence[MatrixJoint] = (),
        parameters: Sequence[Parameter] = (),
        *,
        properties: Mapping[str, Mapping[str, float | str]] = MappingProxyType({}),
        regions: Mapping[str, Sequence[str]] = MappingProxyType({}),
        masses: Sequence[PointMass] = (),
        springs: Sequence[Spring] = (),
        supports: Sequence[tuple[str, np.ndarray]] = (),
        elastic: Sequence[tuple] = (),
        damping: Mapping[str, sp.csr_matrix] = MappingProxyType({}),
        comm: MPI.Intracomm = MPI.COMM_WORLD,
    ):
        self.parts, self.joints, self.comm = tuple(parts), tuple(joints), comm
        self.parameters: dict[str, Parameter] = by_name(parameters)
        self.masses, self.springs = tuple(masses), tuple(springs)
        self.held = [(name, np.asarray(rows, dtype=int)) for name, rows in supports]
        self.viscous = dict(damping)
        names = [each.name for each in (*self.parts, *self.joints)]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"{name} is the name of two parts or joints: expected each once")
        self._named = {part.name: part for part in self.parts}
        sizes = [len(part.dofs) for part in self.parts]
        self._first = dict(zip((p.name for p in parts), np.cumsum([0, *sizes]), strict=False))
        held = np.zeros(sum(sizes), dtype=bool)
        for name, own in self.held:
            if name not in self._first:
                raise wanted("supports", name, f"one of {', '.join(self._first)}")
            size = len(self._named[name].dofs)
            if own.size and not (0 <= own.min() and own.max() < size):
                raise InputError(f"supports of {name}: expected rows from 0 to {size - 1}")
            held[self._first[name] + own] = True
        self._free = np.flatnonzero(~held)
        layout = PETSc.Vec().createMPI(len(self._free), comm=comm)
        self.range = layout.getOwnershipRange()
        layout.destroy()
        self.n_dofs, self.n_local = len(self._free), self.range[1] - self.range[0]
        owned = {name for own in regions.values() for name in own}
        alone = {part.name: (part.name,) for part in self.parts if part.name not in owned}
        self.parts_of_regions = {
            name: [part for part in self.parts if part.name in own]
            for name, own in (dict(regions) | alone).items()
        }
        self._wides: dict[str, sp.csr_matrix] = {}
        self._rows: dict[bytes, sp.csr_matrix] = {}
        self._terms = list(self._all_terms(properties, masses, springs, elastic))
        self.layers = tuple(term.name for term in self._terms if term.is_layer)
        self.dampers = {f"{k}.C": self._petsc(self._own(k, C)) for k, C in damping.items()}

    def __repr__(self) -> str:
        return f"MatrixStructure({self.n_dofs} DOFs, {len(self.parameters)} parameters)"

    # -- terms ---------------------------------------------------------------------------------

    def _wide(self, part: MatrixPart) -> sp.csr_matrix:
        """Free DOFs to those of a part: (n, n_dofs)."""
        if part.name not in self._wides:
            self._wides[part.name] = self._made_wide(part.name, len(part.dofs))
        return self._wides[part.name]

    def _made_wide(self, name: str, n: int) -> sp.csr_matrix:
        rows = np.arange(n)
        columns = np.searchsorted(self._free, self._first[name] + rows)
        there = (columns < len(self._free)) & (
            self._free[np.minimum(columns, len(self._free) - 1)] == self._first[name] + rows
        )
        flat = (np.ones(there.sum()), (rows[there], columns[there]))
        return sp.csr_matrix(flat, shape=(n, self.n_dofs))

    def _mine(self, matrix) -> sp.csr_matrix:
        return sp.csr_matrix(matrix)[slice(*self.range)]

    def _own(self, name: str, matrix) -> sp.csr_matrix:
        """This rank's rows of a matrix of one part."""
        wide = self._wide(self._named[name])
        return self._mine(wide.T @ matrix @ wide)

    def _all_terms(self, properties, masses, springs, elastic) -> Iterator[_Term]:
        for name, own in self.parts_of_regions.items():
            q = {"E": 1.0, "rho": 1.0} | dict(properties.get(name, {}))
            known = {key: p.value for key, p in self.parameters.items()}
            E, rho = (float(number(q[key], known)) for key in ("E", "rho"))
            pieces = [
                (
                    part.name,
                    self._own(part.name, part.stiffness) / E,
                    self._own(part.name, part.mass) / rho,
                )
                for part in own
            ]
            K, M = (sum(each[k] for each in pieces[1:]) + pieces[0][k] for k in (1, 2))
            weight = sum(part.total_mass for part in own) / rho
            yield _Term(name, MATRICES, q, [K], M, weight, pieces=pieces)
        for joint in self.joints:
            wide = self._wide_of(joint)
            own = [self._mine(wide.T @ A @ wide) for A in joint.matrices()]
            yield _Term(joint.name, joint.law, joint.all_properties(), own)
        for name, matrices, k_n, k_t in elastic:
            own = [self._own(part, A) for part, A in matrices]
            yield _Term(name, ELASTIC_SUPPORT, {"k_n": k_n, "k_t": k_t}, own)
        for mass in masses:
            rows = self.displacement(np.atleast_2d(mass.point), f"mass {mass.name}")
            own = self._mine(mass.share * (rows.T @ rows))
            q = {"mass": mass.mass}
            yield _Term(mass.name, POINT_MASS, q, [], own, mass.share, is_layer=False)
        for spring in springs:
            rows = self.displacement(np.atleast_2d(spring.point), f"spring {spring.name}")
            row = sp.csr_matrix(np.asarray(spring.direction, dtype=float)[None] @ rows)
            own = self._mine(spring.share * (row.T @ row))
            yield _Term(spring.name, SPRING, {"stiffness": spring.stiffness}, [own], is_layer=False)

    def _wide_of(self, joint: MatrixJoint) -> sp.csr_matrix:
        """Free DOFs to those of the two parts of a joint."""
        return sp.vstack([self._wide(p) for p in joint.interface.parts])

    def jump(self, joint: MatrixJoint) -> sp.csr_matrix:
        """Jump at the points of a joint as rows over the DOFs, (3 n_points, n_dofs)."""
        return sp.csr_matrix(joint.interface.jump @ self._wide_of(joint))

    def displacement(self, points: np.ndarray, what: str = "point") -> sp.csr_matrix:
        """Displacement at points on the nearest parts, rows over the DOFs, (3 n_points, n_dofs).

        Raises:
            InputError: If a point is on no part; ``what`` names it.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        key = points.tobytes()
        if key not in self._rows:
            found = []
            for i, point in enumerate(points):
                part = min(self.parts, key=lambda p, x=point: p.distance(x))
                try:
                    rows = part.displacement(points[i])
                except InputError as error:
                    raise InputError(f"{what}: {error}") from None
                found.append(rows @ self._wide(part))
            self._rows[key] = sp.vstack(found, format="csr")
        return self._rows[key]

    def _petsc(self, rows: sp.csr_matrix) -> PETSc.Mat:
        rows.sort_indices()
        csr = tuple(a.astype(PETSc.IntType) for a in (rows.indptr, rows.indices))
        size = (self.n_local, self.n_dofs)
        A = PETSc.Mat().createAIJ((size, size), csr=(*csr, rows.data), comm=self.comm)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        A.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        return A

    # -- K and M -------------------------------------------------------------------------------

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters' values."""
        return parameter_values(self.parameters, given)

    def stiffness(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """K(p), N/m; the caller's to destroy. Collective."""
        return self._petsc(self._stiff(self._terms, self.values(given)))

    def _stiff(self, terms: Sequence[_Term], values) -> sp.csr_matrix:
        pairs = [
            (A, t)
            for term in terms
            for A, t in zip(term.stiffness, term.at(values).theta, strict=True)
        ]
        return self._sum(pairs)

    def _sum(self, pairs) -> sp.csr_matrix:
        total = sp.csr_matrix((self.n_local, self.n_dofs))
        for A, factor in pairs:
            total = total + float(factor) * A
        return total

    def mass(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """M(p), kg; the caller's to destroy. Collective."""
        values = self.values(given)
        own = [t for t in self._terms if t.inertia is not None]
        return self._petsc(self._sum([(t.inertia, t.at(values).rho) for t in own]))

    def region_stiffness(self, name: str, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """The share of K of one part, joint or elastic support, or the matrix of a damper."""
        if name in self.dampers:
            return self.dampers[name].copy()
        if name not in self.layers:
            raise wanted("damping", name, f"one of {', '.join((*self.layers, *self.dampers))}")
        own = [term for term in self._terms if term.name == name]
        return self._petsc(self._stiff(own, self.values(given)))

    def resolved(self, damping: Damping) -> Damping:
        """A damping by names of `layers`; parts with a viscous matrix have it."""
        own = dict.fromkeys(self.dampers, 1.0)
        return replace(damping, viscous={**own, **damping.viscous}) if own else damping

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg, that of held degrees of freedom included."""
        values = self.values(given)
        weighed = [t for t in self._terms if t.weight]
        return float(sum(t.weight * t.at(values).rho for t in weighed))

    def properties_of(self, region: str) -> dict[str, float]:
        """E and rho of a region, nominal."""
        term = next(t for t in self._terms if t.name == region)
        values = self.values()
        return {key: float(number(value, values)) for key, value in term.properties.items()}

    @property
    def names(self) -> list[str]:
        """Names of the matrices, as `volume` takes them, and of the joints."""
        return [each.name for each in (*self.parts, *self.joints)]

    def volume(self, names: Sequence[str]) -> float:
        """Volume of parts, m3: their mass over the density of their region; joints have none."""
        values, total = self.values(), 0.0
        for term in self._terms[: len(self.parts_of_regions)]:
            for part in self.parts_of_regions[term.name]:
                if part.name in names:
                    total += part.total_mass / term.at(values).rho
        return total

    def dilation_frequency(self, given: Mapping[str, float] | None = None) -> float:
        """Order of the frequency, Hz, of a wave that crosses the structure: a scale for shifts."""
        fastest = []
        for part in self.parts:
            rows = part.rows[part.moved, :3].ravel()
            k, m = part.stiffness.diagonal()[rows], part.mass.diagonal()[rows]
            squares = k[m > 0] / m[m > 0]
            fastest.append(np.sqrt(np.median(squares)) * part.spacing if len(squares) else 0.0)
        if not max(fastest) > 0:
            raise InputError("no degree of freedom has both stiffness and mass.")
        return float(max(fastest) / np.max(self.size_m) / (2 * np.pi))

    # -- derivatives ---------------------------------------------------------------------------

    def not_linear(self) -> list[str]:
        """Parameters in which K or M is not linear: those of a law of the user's own may be."""
        return []

    def _slopes(self, values) -> Iterator[tuple[int, _Term, np.ndarray, float]]:
        """Number of a parameter, a term that it changes, and how its scalars change."""
        for i, name in enumerate(self.parameters):
            for term in self._terms:
                keys = [k for k in term.law.properties if term.properties[k] == name]
                for key in keys:
                    theta, rho = term.at(values).slopes(key)
                    yield i, term, theta, rho

    def pencil_gradients(self, shapes, eigenvalues, given=None) -> np.ndarray:
        """Derivative of x^T (K - lambda M) x by every parameter at fixed x,
        (n_shapes, n_parameters). Collective."""
        whole = self._whole(shapes)
        own = whole[slice(*self.range)]
        gradient = np.zeros((whole.shape[1], len(self.parameters)))
        eigenvalues = np.asarray(eigenvalues)
        for i, term, theta, rho in self._slopes(self.values(given)):
            for A, slope in zip(term.stiffness, theta, strict=True):
                if slope:
                    gradient[:, i] += slope * np.einsum("dk,dk->k", own, A @ whole)
            if rho and term.inertia is not None:
                found = np.einsum("dk,dk->k", own, term.inertia @ whole)
                gradient[:, i] -= rho * eigenvalues * found
        return self.comm.allreduce(gradient)

    def slopes(
        self, given: Mapping[str, float] | None = None, apart: Sequence[str] = ()
    ) -> Iterator[tuple[int, str, str | None, MatrixForm]]:
        """dK/dp and dM/dp of all parameters that change them; see `structure.Damped`."""
        for i, term, theta, rho in self._slopes(self.values(given)):
            if np.any(theta):
                A = self._sum(zip(term.stiffness, theta, strict=True))
                layer = term.name if term.name in apart else None
                yield i, "K", layer, MatrixForm(self._petsc(A), owned=True)
            if rho and term.inertia is not None:
                yield i, "M", None, MatrixForm(self._petsc(rho * term.inertia), owned=True)

    # -- what sensors see, and pictures ----------------------------------------------------------

    def _whole(self, shapes) -> np.ndarray:
        """Vectors with the rows of all ranks, (n_dofs, k)."""
        own = as_columns(shapes) if len(shapes) else np.zeros((self.n_local, 0))
        return np.concatenate(self.comm.allgather(own))

    def observe(self, shapes, sensors: Sensors) -> np.ndarray:
        """Displacements of shapes at sensors, (n_sensors, n_shapes), equal on all ranks."""
        return self._read(sensors, "sensor") @ self._whole(shapes)

    def _read(self, sensors: Sensors, what: str) -> sp.csr_matrix:
        if sensors.points.shape[1] != 3:
            raise InputError(f"{what}s: expected points (x, y, z)")
        rows = self.displacement(sensors.points, what)
        ways = sp.block_diag([way[None] for way in sensors.directions], format="csr")
        return ways @ rows

    def loads(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """This rank's rows of the loads of one newton at points, (n_local, n)."""
        return self._read(sensors, what)[:, slice(*self.range)].toarray().T

    def cell_energies(self, x, others, given=None) -> tuple[np.ndarray, np.ndarray]:
        """x^T K y and x^T M y of each of `cells` with every vector y, both (n_cells, k).
        Collective."""
        values, own, whole = self.values(given), x.array_r, self._whole(others)
        found = []
        for term in self._terms:
            if term.pieces:
                at = term.at(values)
                for _, K, M in term.pieces:
                    stiff, heavy = at.theta[0] * (K @ whole), at.rho * (M @ whole)
                    found.append((own @ stiff, own @ heavy))
            elif term.is_layer:
                theta = term.at(values).theta
                stiff = sum(f * (A @ whole) for A, f in zip(term.stiffness, theta, strict=True))
                found.append((own @ stiff, np.zeros(whole.shape[1])))
        return tuple(self.comm.allreduce(np.array(found)).swapaxes(0, 1))

    @property
    def cells(self) -> list[tuple[str, np.ndarray]]:
        """Region and nodes' places, m, of each part, joint and elastic support: what energies are
        known of."""
        points, found = {part.name: part.points for part in self.parts}, []
        for joint in self.joints:
            every = slice(None) if joint.which is None else joint.which
            points[joint.name] = joint.interface.points[every]
        for term in self._terms:
            if term.pieces:
                found += [(term.name, points[name]) for name, *_ in term.pieces]
            elif term.is_layer:
                found.append((term.name, points.get(term.name, self.nodes)))
        return found

    @property
    def size_m(self) -> np.ndarray:
        """Extents along the axes, m, (3,)."""
        return np.ptp(self.nodes, axis=0)

    @property
    def nodes(self) -> np.ndarray:
        """Places of the nodes that have all translations, m, (n, 3)."""
        return np.vstack([part.points[part.moved] for part in self.parts])

    def rings(self) -> tuple:
        """None: matrices have no cells."""
        return ()

    def corner_motion(self, shapes) -> tuple[np.ndarray, np.ndarray]:
        """A small cube at each node: corners, m, (n_nodes, 8, 3), and how they move in shapes,
        (n_shapes, n_nodes, 8, 3); on rank 0, elsewhere none of them. Collective."""
        whole, corners, moved = self._whole(shapes), [], []
        unit = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
        for part in self.parts:
            size = _CUBE * (part.spacing or 1e-3)
            corners.append(part.points[part.moved][:, None] + size * unit)
            wide = self._wide(part) @ whole
            motion = wide[part.rows[part.moved, :3]]
            moved.append(np.repeat(motion.transpose(2, 0, 1)[:, :, None], 8, axis=2))
        if self.comm.rank:
            return np.zeros((0, 8, 3)), np.zeros((whole.shape[1], 0, 8, 3))
        return np.concatenate(corners), np.concatenate(moved, axis=1)

    # -- on a basis ------------------------------------------------------------------------------

    def on_basis(
        self, basis: Sequence[PETSc.Vec], free: Sequence[str] | None = None
    ) -> ProjectedModel:
        """The structure on the vectors of a basis: exact sums over the parameters. Collective.

        Args:
            basis: The vectors.
            free: Parameters that vary, where the rest is one sum, at nominal values; None: all.
        """
        dense, n = as_columns(basis), len(basis)

        def projected(rows: sp.csr_matrix) -> np.ndarray:
            A = self._petsc(rows)
            found = project(A, dense)
            A.destroy()
            return found

        split = [], []
        for term in self._terms:
            if free is None or term.varies(free):
                stiff = [projected(A) for A in term.stiffness]
                heavy = np.zeros((n, n)) if term.inertia is None else projected(term.inertia)
                matrices = np.array(stiff).reshape(-1, n, n), heavy, term.weight
                made = RegionTerm(term.name, term.law, term.properties, *matrices)
                split[not term.is_layer].append(made)
        return ProjectedModel(self, basis, AffinePencil(self.parameters, *split))

    def varying(self, free: Sequence[str]) -> Iterator[tuple[list[MatrixForm], MatrixForm | None]]:
        """Matrices of stiffness and mass of each term that some parameters change, in the order of
        `on_basis`; the mass only if they change it. Collective."""
        for layer in (True, False):
            for term in self._terms:
                if term.is_layer is layer and term.varies(free):
                    q = term.at(self.values())
                    named = [k for k in term.law.properties if term.varies(free, k)]
                    heavy = None
                    if term.inertia is not None and any(q.slopes(key)[1] for key in named):
                        heavy = MatrixForm(self._petsc(term.inertia), True)
                    yield [MatrixForm(self._petsc(A), True) for A in term.stiffness], heavy


class _MatrixPencil(FreePencil):
    """K(p) and M(p) of parts by matrices in some of their parameters."""

    def _take_regions(self) -> None:
        for stiff, heavy in self.full.varying(self.free):
            if stiff:
                self._stiff.append((np.eye(len(stiff)), stiff))
            self._heavy.append(heavy)

    def _take_points(self) -> None:
        """Masses and springs are terms like any other."""

    def on(self, basis: list[PETSc.Vec], sensors: Sensors | None) -> ArrayModel:
        """See `FreePencil.on`."""
        whole, pencil = self.full.on_basis(basis), self.full.on_basis(basis, self.free).pencil
        rest = [
            a - b
            for a, b in zip(
                whole.pencil.assemble(self.given), pencil.assemble(self.given), strict=True
            )
        ]
        mass = whole.pencil.total_mass(self.given) - pencil.total_mass(self.given)
        self.terms = replace(pencil, fixed=tuple(rest), fixed_mass=float(mass))
        return replace(whole.arrays(sensors=sensors), pencil=self.terms)


@free_pencil.register
def _(full: MatrixStructure, free: Sequence[str], given: Mapping[str, float]) -> FreePencil:
    return _MatrixPencil(full, free, given)


@tested_models.register
def _(full: MatrixStructure) -> SmallModels:
    return SmallModels(ReducedFormModel, GreedyModel, CombinedModel, kept=False)

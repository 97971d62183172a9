"""Full finite-element models with nonlinear layers, whose points are shared over the ranks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.interfaces.basis import as_vectors
from fenics_joints.interfaces.layers import (
    LayerPoints,
    layer_numbers,
    layer_points,
    layer_stretch,
    linear_moduli,
)
from fenics_joints.interfaces.motion import (
    FreeMotions,
    LawPoints,
    Motion,
    named,
    named_points,
    no_motions,
    unresisted,
)
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.modal.multigrid import structure_motions
from fenics_joints.modal.options import reason_of
from fenics_joints.structure.sparse import absolute, product
from fenics_joints.structure.structure import Places, Structure, place_loads

#: Modes that `SparseMotion.elastic_modes` finds, rigid ones included: chosen.
_MODES = 12
_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


@dataclass(frozen=True, repr=False)
class SparsePoints(LawPoints):
    """`LawPoints` of this rank, whose rows are a matrix, (P d, n), point by point.

    Attributes:
        n_components: Components of strain, d.
    """

    n_components: int = field(kw_only=True)


@dataclass(frozen=True, repr=False)
class FullModel:
    """A full finite-element model with nonlinear interfaces.

    Attributes:
        M: Mass, kg.
        K: Stiffness without the interfaces' stress, N/m.
        interfaces: The nonlinear interfaces.
        C: Viscous damping, N s/m; None for none.
        forces: Load per unit force at the places of forces, by name.
        sensors: Rows of displacement at sensors, by name, as vectors.
        free: Rigid motions that nothing resists; None for none.
    """

    M: PETSc.Mat
    K: PETSc.Mat
    interfaces: Sequence[SparsePoints] = ()
    C: PETSc.Mat | None = None
    forces: Mapping[str, PETSc.Vec] = field(default_factory=dict)
    sensors: Mapping[str, PETSc.Vec] = field(default_factory=dict)
    free: FreeMotions | None = None

    def __repr__(self) -> str:
        n = self.M.getSize()[0]
        return f"FullModel({n} DOFs, {named_points(self.interfaces)})"

    def motion(self) -> SparseMotion:
        """The equation of motion."""
        return SparseMotion(self)


class SparseMotion(Motion):
    """The motion of a full model, shared out over the ranks."""

    options: ClassVar[Mapping[str, object]] = {"pc_factor_mat_solver_type": "mumps"}

    def __init__(self, model: FullModel):
        super().__init__(model.interfaces, model.M.comm)
        self.model = model
        self._strains = [p.rows.createVecLeft() for p in model.interfaces]
        self._blocks = [
            point_blocks(p, np.ones((len(p.weights), p.n_components, p.n_components)))
            for p in model.interfaces
        ]
        self._work = model.M.createVecLeft()

    def vector(self) -> PETSc.Vec:
        """A vector of zeros."""
        return self.model.M.createVecLeft()

    def matrix(self) -> PETSc.Mat:
        """A matrix for `jacobian`, with room for the interfaces' tangents."""
        A = self.model.K.copy()
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        self._add(A, 1.0, self.model.M)
        if self.model.C is not None:
            self._add(A, 1.0, self.model.C)
        for p, block in zip(self.model.interfaces, self._blocks, strict=True):
            product = block.ptap(p.rows)
            self._add(A, 1.0, product)
            product.destroy()
        return A

    @staticmethod
    def _add(A: PETSc.Mat, factor: float, B: PETSc.Mat) -> None:
        A.axpy(factor, B, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)

    def free(self) -> FreeMotions:
        """Rigid motions that nothing resists."""
        n_local = self.model.M.getLocalSize()[0]
        return self.model.free or no_motions(n_local, self.comm.tompi4py())

    def place(self, kind: str, name: str) -> PETSc.Vec:
        """The row of a force or a sensor."""
        return named(getattr(self.model, kind), kind, name)

    def _strain(self, i: int, u: PETSc.Vec) -> np.ndarray:
        self.interfaces[i].rows.mult(u, self._strains[i])
        return self._strains[i].array_r.copy()

    def residual(self, u, v, a, load, states, out: PETSc.Vec) -> None:
        """M a + C v + K u + f(u, states) - load into ``out``. Collective."""
        m = self.model
        m.M.mult(a, out)
        m.K.multAdd(u, out, out)
        if m.C is not None:
            m.C.multAdd(v, out, out)
        for p, work, (_, stress, _, _) in zip(
            m.interfaces, self._strains, self.step(u, states, v), strict=True
        ):
            work.array[:] = (p.weights[:, None] * stress).ravel()
            p.rows.multTranspose(work, self._work)
            out.axpy(1.0, self._work)
        out.axpy(-1.0, load)

    def jacobian(self, u, states, shift_v: float, shift_a: float, out: PETSc.Mat, v=None) -> None:
        """K + d f/d u + shift_v C + shift_a M into ``out``, at the velocity v. Collective."""
        m = self.model
        out.zeroEntries()
        out.axpy(1.0, m.K, structure=_SUBSET)
        out.axpy(shift_a, m.M, structure=_SUBSET)
        if m.C is not None:
            out.axpy(shift_v, m.C, structure=_SUBSET)
        for p, block, (_, _, _, tangent) in zip(
            m.interfaces, self._blocks, self.step(u, states, v, shift_v), strict=True
        ):
            _fill(block, p.weights[:, None, None] * tangent)
            product = block.ptap(p.rows)
            out.axpy(1.0, product, structure=_SUBSET)
            product.destroy()
        out.assemble()

    def energy(self, u, v) -> float:
        """Kinetic energy and that of K, J: what interfaces store is not in it. Collective."""
        self.model.M.mult(v, self._work)
        kinetic = v.dot(self._work)
        self.model.K.mult(u, self._work)
        return 0.5 * float(kinetic + u.dot(self._work))

    def product(self, name: str, x: PETSc.Vec) -> PETSc.Vec:
        """See `Motion.product`."""
        found, A = self.vector(), getattr(self.model, name)
        if A is not None:
            A.mult(x, found)
        return found

    def elastic_modes(self, K: PETSc.Mat) -> tuple[np.ndarray, Callable[[int], PETSc.Vec]]:
        """See `Motion.elastic_modes`."""
        found, n = EigenSolver(_MODES).solve(K, self.model.M), len(self.free())
        return found.values[n:], lambda i: found.shapes[n + i]

    def acceleration(self, force: PETSc.Vec, u: PETSc.Vec, states, step: float) -> PETSc.Vec:
        """See `Motion.acceleration`.

        Degrees of freedom without mass, as in a layer, have no acceleration of their own; as much
        stiffness as a step of a thousandth of the first would bring ties them to the others.
        """
        a, A, share = self.vector(), self.matrix(), (1e-3 * step) ** 2
        self.jacobian(u, states, 0.0, 1.0, A)
        A.scale(share)
        A.axpy(1 - share, self.model.M, _SUBSET)
        ksp = PETSc.KSP().create(comm=self.comm)
        ksp.setOperators(A)
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        ksp.solve(force, a)
        if ksp.getConvergedReason() < 0:
            raise ConvergenceError("the acceleration at the start was not found", reason_of(ksp))
        ksp.destroy(), A.destroy()
        return a


def point_blocks(p: SparsePoints, blocks: np.ndarray) -> PETSc.Mat:
    """Matrix of one dense block, (d, d), for each of this rank's points, laid out as the rows."""
    sizes = p.rows.getSizes()[0]
    matrix = PETSc.Mat().createAIJ((sizes, sizes), nnz=(p.n_components, 0), comm=p.rows.comm)
    _fill(matrix, blocks)
    return matrix


def _fill(block: PETSc.Mat, tangents: np.ndarray) -> None:
    first, _ = block.getOwnershipRange()
    d = tangents.shape[1]
    for i, values in enumerate(tangents):
        at = np.arange(first + i * d, first + (i + 1) * d, dtype=PETSc.IntType)
        block.setValues(at, at, values)
    block.assemble()


#: Share of a layer's shear stiffness that stays beside its law: chosen; it holds inner nodes.
_LEFT = 1e-6
_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


def full_layers(
    structure: Structure,
    laws: Mapping[str, JointLaw],
    *,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
    points_degree: int | None = None,
) -> FullModel:
    """A structure whose thin layers follow nonlinear laws, not reduced. Collective.

    Arguments as `interfaces.reduce_layers`, which makes the reduced model of
    the same equations. A millionth of the layer's shear stiffness stays, which holds the nodes
    within the layer: its points do not feel them.

    Raises:
        InputError: As there.
    """
    numbers = layer_numbers(structure, laws)
    values = structure.values(given)
    K, M = structure.stiffness(given), structure.mass(given)
    interfaces = []
    for name, number in numbers.items():
        q, law = structure.field.region_values(number, values), laws[name]
        K.axpy(-1.0, _shear_stiffness(structure, number, q), structure=_SUBSET)
        found = layer_points(structure, number, points_degree)
        points = _points(name, law, found, layer_stretch(q))
        if law.coupled:
            _take_normal(K, points, linear_moduli(structure, number, q)[0])
        interfaces.append(points)
    placed = [
        dict(zip(found, as_vectors(K, loads), strict=True))
        for found, loads in (
            place_loads(structure, "forces", forces),
            place_loads(structure, "sensors", sensors),
        )
    ]
    free = _free_motions(structure, K, M, interfaces)
    return FullModel(M, K, tuple(interfaces), None, *placed, free)


def _shear_stiffness(structure: Structure, number: int, q: Mapping[str, float]) -> PETSc.Mat:
    """Stiffness of a layer's shear, but for the share that stays."""
    law, share = structure.regions[number].law.name, 1 - _LEFT
    if law == "springs":
        only = {"k_n": 0.0, "k_t": share * q["k_t"]}
    else:
        G = share * q["G"]
        # Of a constrained layer the normal modulus is lambda + 2 G, zero for E = 4 G.
        only = {"E": 4 * G if law == "constrained" else 0.0, "G": G}
    return structure.region_matrix(number, 0, {**q, **only})


def _take_normal(K: PETSc.Mat, points: SparsePoints, modulus: float) -> None:
    """Take the normal stress at the points out of K.

    Strain that varies through the thickness, which the points do not see, stays elastic: otherwise
    the nodes within the layer would be free to move so that there is no shear.
    """
    normal = np.zeros((points.n_components,) * 2)
    normal[0, 0] = modulus
    block = point_blocks(points, points.weights[:, None, None] * normal)
    taken = block.ptap(points.rows)
    K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    K.axpy(-1.0, taken, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    taken.destroy(), block.destroy()


def _free_motions(structure: Structure, K, M, interfaces: Sequence[SparsePoints]) -> FreeMotions:
    """Motions of the whole that cost no energy and strain no interface. Collective."""
    comm, rigid = structure.comm, structure_motions(structure)

    def dots(left, right) -> np.ndarray:
        return comm.allreduce(left.T @ right)

    def positive(A: PETSc.Mat) -> np.ndarray:
        magnitudes = absolute(A)
        found = product(magnitudes, np.abs(rigid))
        magnitudes.destroy()
        return found

    terms = [(dots(rigid, product(K, rigid)), dots(np.abs(rigid), positive(K)).diagonal())]
    for points in interfaces:
        root = np.sqrt(np.repeat(points.weights, points.n_components))[:, None]
        strain, most = (root * f for f in (product(points.rows, rigid), positive(points.rows)))
        terms.append((dots(strain, strain), dots(most, most).diagonal()))
    free = unresisted(rigid, terms, comm)
    inertia = product(M, free)
    factor = np.linalg.inv(np.linalg.cholesky(dots(free, inertia))).T
    return FreeMotions(free @ factor, inertia @ factor, comm)


def _points(name: str, law: JointLaw, found: LayerPoints, stretch: float) -> SparsePoints:
    """This rank's points of a layer, without the rows that the law does not ask for."""
    rows = found.rows(stretch)
    gdim = found.points.shape[1]
    first, last = (i // gdim for i in rows.getOwnershipRange())
    mine = np.argsort(found.order)[first:last]
    if law.n_points is not None:
        raise InputError(f"{law.label}: expected the same parameters at all points of a layer.")
    if not law.coupled:
        kept = np.arange(first * gdim, last * gdim, dtype=PETSc.IntType)
        index = PETSc.IS().createGeneral(kept[kept % gdim > 0], comm=rows.comm)
        rows = rows.createSubMatrix(index)
    return SparsePoints(
        name,
        law,
        rows,
        found.weights[mine] * stretch,
        law.coupled,
        found.points[mine],
        n_components=gdim - (not law.coupled),
    )

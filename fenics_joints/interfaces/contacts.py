"""Reduced models of bodies whose zero-thickness contacts are nonlinear."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interfaces.basis import (
    Basis,
    Placed,
    as_vectors,
    assemble,
    characteristic,
    check_uniform,
    energy_share,
    fixed_interface,
    free_interface,
)
from fenics_joints.interfaces.model import InterfaceModel, InterfacePoints
from fenics_joints.interfaces.reduced import ReducedInterfaceModel
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.modal.modes import SHIFT_SHARE
from fenics_joints.preload import OPEN, SLIP, LinearJoint
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.structure.faces import Interface
from fenics_joints.structure.sparse import as_columns, product, project
from fenics_joints.structure.structure import Places, place_loads

#: Most constraint modes of the model that ``shapes`` gets, and those kept if it gives none: chosen.
_MOST, _WITHOUT = 1500, 60
_METHODS = ("craig-bampton", "free-interface")


def reduce_contacts(
    joint: LinearJoint,
    laws: Mapping[str, JointLaw],
    *,
    method: str = "craig-bampton",
    n_modes: int = 20,
    interface_modes: int | None = None,
    tolerance: float | None = None,
    shapes: Callable[[InterfaceModel], Sequence[PETSc.Vec]] | None = None,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
) -> ReducedInterfaceModel:
    """Reduced model of bodies whose zero-thickness contacts follow nonlinear laws. Collective.

    The strains are the jumps of pairs, m: opening (of a coupled law) and slips; the weights are the
    pairs' areas. With a law that is not `coupled` the interface consists of the pairs that are not
    OPEN in ``joint``: they stay closed, and slip against the law. With a coupled law it consists of
    all pairs, whatever their state in ``joint``. Other contacts stay as in ``joint``.

    Args:
        joint: Bodies and contacts, about a preload state or all closed.
        laws: Law of each contact that becomes nonlinear, by name.
        method: ``"craig-bampton"``: modes with all pairs stuck, and constraint modes, or as many
            characteristic constraint modes as `interface_modes`, with the laws' tangents at rest;
            ``"free-interface"``: modes with those tangents, and interface modes.
        n_modes: Modes, rigid-body modes included.
        interface_modes: Number of interface modes; by default all constraint modes, or of a free
            interface as many as modes.
        tolerance: Instead of a number, of a free interface: the least energy of an interface mode
            under unit stress, relative to the largest.
        shapes: Gives displacements of a model that keeps all constraint modes (or 1,500 of
            them), such as by `fenics_joints.interfaces.loading_shapes`. The basis is then these
            shapes, the modes at rest, and `interface_modes` characteristic constraint modes: by
            default none, or 60 if it gives no shape. Constraint modes alone would take far more.
        forces: Position, m, and direction of each force, by name. Bolts and loads of the model are
            forces too, by their names, per newton or factor.
        sensors: Position and direction of each sensor.
        given: Parameters that differ from their nominal value; the basis is best there.

    Raises:
        InputError: For an unknown contact, one with springs or without closed pairs, an unknown
            method, or a number out of range.
    """
    if method not in _METHODS:
        raise InputError(f"method = {method!r}: expected {' or '.join(map(repr, _METHODS))}.")
    check_uniform(joint.structure)
    pairs = _Pairs(joint, laws)
    free = joint.change(_released(joint, laws), joint.springs)
    K, M = free.stiffness(given), free.mass(given)
    _hold(joint, (K, M), pairs.bubbles())
    forces, sensors = _forces(joint, forces), _jump_places(joint, "sensors", sensors)
    loads = np.hstack([forces[1], sensors[1]])
    _zero_held(joint, np.concatenate([free.held(), pairs.bubbles()]), loads)
    shift = -((2 * np.pi * SHIFT_SHARE * joint.dilation_frequency(given)) ** 2)
    solver = EigenSolver(n_modes, shift=shift)
    elastic = pairs.with_tangents(K)
    basis = pairs, (K, elastic, M), solver, loads
    if shapes is not None:
        columns = _guided(
            *basis, lambda X: shapes(_bare(pairs, (K, M), X, forces, sensors)), interface_modes or 0
        )
    elif method == "craig-bampton":
        columns = _fixed(*basis, characteristic(interface_modes, pairs.size)).columns
    else:
        columns = _free(*basis, energy_share(interface_modes, tolerance, n_modes, pairs.size))
    elastic.destroy(), solver.destroy()
    source = ReducedStructure(joint.structure, joint.displacements(as_vectors(K, columns)))
    pencil = _with_contacts(joint, source, (K, M), columns, given)
    K.destroy(), M.destroy()
    return assemble(columns, source, pairs.points(columns), pencil, {}, given, forces, sensors)


def _fixed(pairs: _Pairs, matrices, solver: EigenSolver, loads, choose: Callable) -> Basis:
    """Craig and Bampton's basis: modes with the pairs stuck, and constraint modes."""
    K, elastic, M = matrices
    held = [A.copy() for A in (K, M)]
    _hold(pairs.joint, held, pairs.numbers)
    modes = as_columns(solver.solve(*held).shapes)
    basis = fixed_interface(elastic, M, solver, modes, loads, pairs.local, choose)
    for A in held:
        A.destroy()
    return basis


def _free(
    pairs: _Pairs, matrices, solver: EigenSolver, loads, choose: Callable | None, extra=None
) -> np.ndarray:
    """Modes with the laws' tangents between the pairs, and interface modes or further columns."""
    _, elastic, M = matrices
    modes = as_columns(solver.solve(elastic, M).shapes)
    return free_interface(elastic, M, solver, modes, loads, pairs, choose, extra).columns


def _guided(
    pairs: _Pairs, matrices, solver: EigenSolver, loads, shapes: Callable, few: int
) -> np.ndarray:
    """Modes at rest, few characteristic constraint modes, displacements of a model with them all.

    Raises:
        InputError: If there are fewer constraint modes.
    """
    if few > pairs.size:
        characteristic(few, pairs.size)  # says so
    most = characteristic(min(max(_MOST, few), pairs.size), pairs.size)
    whole = _fixed(pairs, matrices, solver, loads, most)
    found, own = shapes(whole.columns), np.zeros((whole.columns.shape[1], 0))
    if len(found):
        own = as_columns(found)
    else:
        few = max(few, min(_WITHOUT, pairs.size))
    known = whole.columns @ pairs.joint.jumps.comm.bcast(own)
    return _free(pairs, matrices, solver, loads, None, np.hstack([known, whole.more[:, :few]]))


def _bare(pairs: _Pairs, matrices, columns, forces: Placed, sensors: Placed) -> InterfaceModel:
    """The model of a basis without its parameters."""
    comm = pairs.joint.jumps.comm
    K, M = (project(A, columns) for A in matrices)
    rows = [
        dict(zip(names, comm.allreduce(columns.T @ loads).T, strict=True))
        for names, loads in (forces, sensors)
    ]
    return InterfaceModel(M, K, tuple(pairs.points(columns)), forces=rows[0], sensors=rows[1])


class _Pairs:
    """The pairs that are the interfaces, and single entries of x as their `basis.Strains`.

    Attributes:
        numbers: Global numbers in x of all interfaces' components, (q,).
        local: Local row of each, or -1 where another rank owns it.
        root: Root of the area of each component's pair, m, (q,).
    """

    def __init__(self, joint: LinearJoint, laws: Mapping[str, JointLaw]):
        self.joint, self.laws = joint, laws
        self._jumps = joint.jumps
        self._kept = _kept_pairs(joint, laws)
        self._areas = {n: c.areas[kept] for n, (c, kept) in self._kept.items()}
        self._entries = {n: self._components(n) for n in laws}
        self.numbers = np.concatenate([e.ravel() for e in self._entries.values()])
        self._mine = self._jumps.owned(self.numbers)
        self.local = np.where(self._mine, self._jumps.local(self.numbers), -1)
        areas = [np.repeat(self._areas[n], e.shape[1]) for n, e in self._entries.items()]
        self.root = np.sqrt(np.concatenate(areas))

    @property
    def size(self) -> int:
        """Number of components, q."""
        return len(self.numbers)

    def _components(self, name: str) -> np.ndarray:
        """Global numbers in x of a contact's strains, (P, d)."""
        c, kept = self._kept[name]
        return self._jumps.numbers(c)[kept, 0 if self.laws[name].coupled else 1 :]

    def bubbles(self) -> np.ndarray:
        """Bubbles between pairs of an interface: its jump is piecewise linear."""
        found = [np.empty(0, dtype=np.int64)]
        for c, kept in self._kept.values():
            if len(c.edges):
                inside = np.isin(c.edges, kept).all(axis=1)
                found.append(self._jumps.bubbles(c)[inside].ravel())
        return np.concatenate(found)

    def rows(self, columns: np.ndarray) -> np.ndarray:
        """Components of columns, (q, m), equal on all ranks. Collective."""
        found = np.zeros((self.size, columns.shape[1]))
        found[self._mine] = columns[self.local[self._mine]]
        self._jumps.comm.Allreduce(MPI.IN_PLACE, found)
        return found

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        return self.root[:, None] * self.rows(columns)

    def stresses(self) -> np.ndarray:
        """Loads of unit stress in every component, (n_local, q)."""
        columns = np.zeros((self._jumps.n_local, self.size))
        columns[self.local[self._mine], np.flatnonzero(self._mine)] = self.root[self._mine]
        return columns

    def points(self, columns: np.ndarray) -> list[InterfacePoints]:
        """The interfaces in a basis. Collective."""
        rows, at, found = self.rows(columns), 0, []
        for name, numbers in self._entries.items():
            c, kept = self._kept[name]
            part = rows[at : at + numbers.size].reshape(*numbers.shape, -1)
            at += numbers.size
            found.append(self._interface(name, part, c.points[kept]))
        return found

    def _interface(self, name: str, rows, points=None) -> InterfacePoints:
        law = self.laws[name]
        return InterfacePoints(name, law, rows, self._areas[name], law.coupled, points)

    def tangent(self) -> np.ndarray:
        """Stress by strain at rest of all interfaces' components, (q, q)."""
        blocks = []
        for name, numbers in self._entries.items():
            blocks.extend(self._interface(name, np.zeros((*numbers.shape, 1))).tangent())
        return scipy.linalg.block_diag(*blocks)

    def with_tangents(self, K: PETSc.Mat) -> PETSc.Mat:
        """K with the laws' tangents at rest as springs between the pairs."""
        stiff = K.copy()
        stiff.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        blocks, numbers = self.tangent(), self.numbers.astype(PETSc.IntType)
        for i, j in np.argwhere(blocks):
            if self._mine[i]:
                value = self.root[i] * blocks[i, j] * self.root[j]
                stiff.setValue(numbers[i], numbers[j], value, PETSc.InsertMode.ADD_VALUES)
        stiff.assemble()
        return stiff


def _kept_pairs(joint: LinearJoint, laws) -> dict[str, tuple[Interface, np.ndarray]]:
    """Contact and rows of the pairs that are the interface, by name."""
    contacts = {c.name: c for c in joint.jumps.contacts}
    if not laws:
        raise InputError(f"laws: expected a law for one of the contacts {', '.join(contacts)}.")
    found = {}
    for name, law in laws.items():
        if name not in contacts:
            raise InputError(
                f"laws: there is no contact {name!r}; expected: {', '.join(contacts) or 'none'}."
            )
        if name in joint.springs:
            raise InputError(f"laws: {name} has springs already; expected one or the other.")
        closed = joint.conditions[name] > OPEN
        kept = np.flatnonzero(closed | law.coupled)
        if not len(kept):
            raise InputError(
                f"{name}: all its pairs are open; expected closed ones, or a coupled law."
            )
        found[name] = (contacts[name], kept)
    return found


def _released(joint: LinearJoint, laws) -> dict[str, np.ndarray]:
    """Conditions without the interfaces' stress: closed pairs slide, or all are open."""
    conditions = {n: c for n, c in joint.conditions.items() if n not in joint.springs}
    for name, law in laws.items():
        conditions[name] = np.where(law.coupled, OPEN, np.minimum(conditions[name], SLIP))
    return conditions


def _hold(joint: LinearJoint, pencil, numbers: np.ndarray) -> None:
    mine = numbers[joint.jumps.owned(numbers)].astype(PETSc.IntType)
    for A, diagonal in zip(pencil, (1.0, 0.0), strict=True):
        A.zeroRowsColumns(mine, diag=diagonal)


def _zero_held(joint: LinearJoint, numbers: np.ndarray, loads: np.ndarray) -> None:
    """Take loads off entries that are held, in place."""
    mine = np.union1d(numbers[joint.jumps.owned(numbers)], joint.model.supported)
    loads[joint.jumps.local(mine)] = 0.0


def _forces(joint: LinearJoint, given: Places | None) -> Placed:
    """Forces at points, bolts and loads, with their loads in x."""
    found, loads = _jump_places(joint, "forces", given)
    moved = {m.name for m in joint.model.moved}
    own = [name for name in joint.model.forces if name not in moved]
    for name in own:
        if name in found:
            raise InputError(f"forces: {name!r} is a bolt or load; expected another name.")
    bolts = [joint.model.unit_load(name).array_r for name in own]
    return {**found, **dict.fromkeys(own)}, np.column_stack([loads, *bolts])


def _jump_places(joint: LinearJoint, what: str, given: Places | None) -> Placed:
    """As `place_loads`, the loads in x."""
    found, loads = place_loads(joint.structure, what, given)
    if not found:
        return found, np.zeros((joint.jumps.n_local, 0))
    transposed = joint.jumps.T.transpose(PETSc.Mat())
    loads = product(transposed, loads)
    transposed.destroy()
    return found, loads


def _with_contacts(
    joint: LinearJoint, source: ReducedStructure, matrices, columns: np.ndarray, given
) -> AffinePencil:
    """The structure's pencil, with all that is not its own, as bolts and springs, fixed."""
    structure = joint.structure
    whole = [project(A, columns) for A in matrices]
    own = source.pencil.assemble(structure.values(given))
    return replace(
        source.pencil,
        fixed=tuple(a - b for a, b in zip(whole, own, strict=True)),
        fixed_mass=joint.total_mass(given) - structure.total_mass(given),
    )

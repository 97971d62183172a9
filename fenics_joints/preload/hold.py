"""Rigid motions that nothing resists, and how they are held without reactions (inertia relief)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.meshes.grow import groups_of
from fenics_joints.modal.rigid import rigid_motions
from fenics_joints.preload.bodies import at_blocks, body_numbers
from fenics_joints.preload.components import Obstacle
from fenics_joints.preload.model import PreloadModel
from fenics_joints.structure.faces import Interface
from fenics_joints.structure.points import node_positions
from fenics_joints.structure.sparse import product

#: Energy of a motion as a share of that of its DOFs' own stiffness below which nothing resists it:
#: round-off of K.
_FREE = 1e-11
#: Resultant of a load as a share of its sum of magnitudes below which it is balanced: round-off.
_BALANCED = 1e-9


@dataclass(frozen=True)
class Hold:
    """Motions without resistance, and entries of x that hold them.

    Attributes:
        motions: Orthonormal vectors in x, this rank's rows, (n_local, k).
        pins: As many global numbers of x; held at zero they stop exactly those motions.
        n_whole: How many of the motions move the whole structure as one.
    """

    motions: np.ndarray
    pins: np.ndarray
    n_whole: int

    def balance(self, load: PETSc.Vec, mass) -> float:
        """Make a load do no work on the motions: subtract the inertia of the free structure.

        Args:
            load: Load in x; changed.
            mass: Function without arguments that returns the mass in x; called only if needed.

        Returns:
            The largest resultant that was taken off, relative to the load.

        Raises:
            InputError: If the load pushes parts against one another along a motion that nothing
                resists.
        """
        comm = load.comm.tompi4py()
        if not self.motions.shape[1]:
            return 0.0
        scale = load.norm(PETSc.NormType.N1)
        work = dots(comm, self.motions, load.array_r)
        peak = np.abs(self.motions).max(axis=0, initial=0.0)
        comm.Allreduce(MPI.IN_PLACE, peak, op=MPI.MAX)
        share = np.abs(work) / (peak * scale) if scale > 0 else np.zeros(len(work))
        if share.max(initial=0.0) <= _BALANCED:
            return 0.0
        if share[self.n_whole :].max(initial=0.0) > _BALANCED:
            raise InputError(
                "the loads push a part along a motion that nothing resists (frictionless sliding, "
                "or opening); expected friction, a bolt that resists it, a support or a balanced "
                "load."
            )
        M, whole = mass(), self.motions[:, : self.n_whole]
        heavy = product(M, whole)
        load.array[:] -= heavy @ np.linalg.solve(dots(comm, whole, heavy), work[: self.n_whole])
        M.destroy()
        return float(share.max())


def dots(comm: MPI.Intracomm, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Inner products of columns of which each rank has its rows. Collective."""
    return comm.allreduce(left.T @ right)


def find_hold(model: PreloadModel, K: PETSc.Mat) -> Hold:
    """Motions of bodies, in contact everywhere, that cost no energy. Collective.

    Args:
        model: The model.
        K: Its stiffness in x.
    """
    motions, whole = _candidates(model)
    diagonal = K.getDiagonal().array_r[:, None]
    resisted = _contact_rows(model)
    forces = product(K, motions)
    forces[resisted] += diagonal[resisted] * motions[resisted]
    energy, scale = (dots(model.comm, motions, f) for f in (forces, diagonal * motions))
    values, vectors = scipy.linalg.eigh(0.5 * (energy + energy.T), scale)
    free = vectors[:, values < _FREE]
    free, n_whole = _whole_first(free, whole, scale)
    found = _orthonormal(model.comm, motions @ free)
    pins = _pins(model, found, resisted)
    return Hold(found, pins, n_whole)


def _candidates(model: PreloadModel):
    """Rigid motions of each group of glued bodies, (n_local, m) in x, and those that move all."""
    V = model.V
    body, n_bodies = body_numbers(V)
    x = node_positions(V)
    centre = model.comm.allreduce(x[: _own(V)].sum(axis=0)) / V.dofmap.index_map.size_global
    group = _groups(model, body, n_bodies)
    names, group_of = np.unique(group, return_inverse=True)
    local_motions = rigid_motions(x[: _own(V)] - centre, model.axisymmetric)
    # Groups on both sides of each contact, and of each spider: asked of all ranks once.
    own = body[: _own(V)]
    sides = [
        [group_of[at_blocks(V, own, nodes)] for nodes in (c.upper, c.masters)]
        for c in model.jumps.contacts
    ]
    legs = [group_of[at_blocks(V, own, s.nodes[:1])[0]] for s in model.jumps.spiders]
    motions = []
    for number in range(len(names)):
        inside = group_of[body[: _own(V)]] == number
        for k in range(len(local_motions)):
            moves = [[side == number for side in pair] for pair in sides]
            turns = [leg == number for leg in legs]
            u = local_motions[k] * inside[:, None]
            motions.append(_in_x(model, u, moves, turns, k, centre))
    whole = [np.eye(len(local_motions))] * len(names)
    for i, c in _pushed(model):
        along = model.jumps.frame(i)[0]
        motions.append(_alone(model, i, c, along))
        whole.append((rigid_motions(0 * along[None], model.axisymmetric)[:, 0] @ along)[None])
    return np.column_stack(motions), np.vstack(whole)


def _pushed(model: PreloadModel) -> list[tuple]:
    """Number and interface of obstacles that a force pushes."""
    interfaces = {c.name: c for c in model.jumps.contacts}
    return [
        (i, interfaces[m.name])
        for i, m in enumerate(model.moved)
        if isinstance(m, Obstacle) and m.force is not None
    ]


def _alone(model: PreloadModel, i: int, c: Interface, along: np.ndarray) -> np.ndarray:
    """x of an obstacle that moves along its force by one, away from the body, which rests."""
    array = np.zeros(model.jumps.n_local)
    model.jumps.put(array, model.jumps.shift(i)[:1], 1.0)
    model.jumps.put(array, model.jumps.numbers(c), -c.frames @ along)
    return array


def _own(V) -> int:
    return V.dofmap.index_map.size_local


def _groups(model: PreloadModel, body, n_bodies) -> np.ndarray:
    """Group of each body: those glued, or parted by a pretension section, are one."""
    links, own = [], body[: _own(model.V)]
    for glued in (*model.jumps.bonded, *model.jumps.sections):
        ends = [at_blocks(model.V, own, nodes[:1])[0] for nodes in (glued.lower, glued.upper)]
        links.append(ends)
    return groups_of(n_bodies, links)


def _in_x(model, u, moves, turns, k, centre) -> np.ndarray:
    """x of the motion k of one group: u where it moves, jumps where it meets others.

    Args:
        model: The model.
        u: Displacement of this rank's blocks.
        moves: Of each contact: which vertices of the upper and of the lower face move.
        turns: Which spiders move.
        k: Number of the motion.
        centre: Point about which it turns.
    """
    jumps = model.jumps
    array = np.zeros(jumps.n_local)
    array[: u.size] = u.ravel()
    for c, (upper, lower) in zip(jumps.contacts, moves, strict=True):
        jump = c.jumps_of(lambda x: rigid_motions(x - centre, model.axisymmetric)[k], upper, lower)
        turned = np.einsum("nki,ni->nk", c.frames, jump)
        jumps.put(array, jumps.numbers(c), turned)
        jumps.put(array, jumps.bubbles(c), 0.0)
    following = [
        nodes for c in jumps.bonded if c.coupling is None for nodes in (c.upper, c.upper_midsides)
    ]
    following += [section.upper for section in jumps.sections]
    following += [c.coupling.midsides for c in (*jumps.contacts, *jumps.bonded) if c.coupling]
    for c in jumps.bonded:
        if c.coupling is not None:
            jumps.put(array, jumps.entries(c.upper)[~c.coupling.free], 0.0)
    for moved in jumps.moved:
        jumps.put(array, jumps.entries(moved.nodes)[:, list(moved.directions)], 0.0)
    for nodes in (*following, *(spider.nodes for spider in jumps.spiders)):
        jumps.put(array, jumps.entries(nodes), 0.0)
    for i, spider in enumerate(jumps.spiders):
        if turns[i]:
            shift = rigid_motions(spider.centre[None] - centre)[k, 0]
            turn = np.eye(3)[k - 3] if k >= 3 else np.zeros(3)
            jumps.put(array, jumps.reference(i), np.concatenate([shift, turn]))
    return array


def _contact_rows(model: PreloadModel) -> np.ndarray:
    """Local entries of x that a closed contact resists: openings, and slips with friction."""
    jumps, rows = model.jumps, [np.empty(0, dtype=np.int64)]
    for contact, interface in zip(model.contacts, jumps.contacts, strict=True):
        numbers = jumps.numbers(interface)[:, : None if contact.friction > 0 else 1].T.ravel()
        rows.append(jumps.local(numbers[jumps.owned(numbers)]))
    return np.concatenate(rows)


def _whole_first(free: np.ndarray, whole: np.ndarray, scale: np.ndarray):
    """Combinations that move all bodies as one, then the rest of the free ones."""
    if not free.shape[1]:
        return free, 0
    # A combination of whole motions is free if it lies in the span of the free ones.
    inside = free @ (free.T @ scale @ whole)
    left = whole - inside
    size = np.sqrt(np.einsum("ij,ik,kj->j", whole, scale, whole))
    off = np.sqrt(np.maximum(np.einsum("ij,ik,kj->j", left, scale, left), 0)) / size
    kept = whole[:, off < 1e-4]
    rest = (
        free - kept @ np.linalg.lstsq(kept.T @ scale @ kept, kept.T @ scale @ free, rcond=None)[0]
        if kept.size
        else free
    )
    gram = rest.T @ scale @ rest
    values, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    rest = rest @ vectors[:, np.argsort(-values)[: free.shape[1] - kept.shape[1]]]
    return np.hstack([kept, rest]), kept.shape[1]


def _orthonormal(comm: MPI.Intracomm, columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns, of which the first ones span what the first ones did."""
    for _ in range(2 if columns.shape[1] else 0):
        gram = dots(comm, columns, columns)
        size = np.sqrt(gram.diagonal())
        factor = np.linalg.cholesky(gram / np.outer(size, size))
        columns = scipy.linalg.solve_triangular(factor, (columns / size).T, lower=True).T
    return columns


def _pins(model, motions: np.ndarray, resisted: np.ndarray) -> np.ndarray:
    """Entries of x, one for each motion, on which they are best told apart (pivoted rows).

    No jump of a contact that resists is one.
    """
    jumps, comm = model.jumps, model.comm
    rows = motions.copy()
    rows[resisted] = 0.0
    own = jumps.range[1] - jumps.range[0]
    rows[own:] = 0.0  # translations and rotations of references have other units
    pins = []
    for _ in motions.T:
        size = np.einsum("ij,ij->i", rows, rows)
        best = int(np.argmax(size)) if len(size) else 0
        sizes = comm.allgather(float(size[best]) if len(size) else -1.0)
        rank = int(np.argmax(sizes))
        row = comm.bcast(rows[best].copy() if comm.rank == rank else None, root=rank)
        pins.append(comm.bcast(best + jumps.range[0] if comm.rank == rank else None, root=rank))
        direction = row / np.linalg.norm(row)
        rows -= np.outer(rows @ direction, direction)
    return np.array(pins, dtype=np.int64)

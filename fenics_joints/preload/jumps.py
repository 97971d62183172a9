"""Displacements in terms of jumps: u = T x.

Of each pair of a contact, x holds the lower body's displacement and the *jump* (upper minus lower)
in the pair's frame: opening, then slips. The elastic energy in x is that of T^T K T, every contact
condition is one on single entries of x, and bonded, sliding and open are entries held or free.
Pretension sections and rigid spiders add a few entries at the end of x.

At degree 2 the jump of a midside is that of a linear function plus a bubble, which is an entry of
its own. A contact holds the bubbles at zero: its jump is piecewise linear, so that its forces act
on the vertices with positive weights, which quadratic facets do not give by themselves (triangles
have weight zero at the vertices, serendipity quadrilaterals a negative one).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

import numpy as np
import scipy.sparse
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError, MeshError
from fenics_joints.preload.interface import Interface

__all__ = ["Jumps", "Section", "Spider"]


@dataclass(frozen=True)
class Spider:
    """Blocks that move rigidly with a reference point of six degrees of freedom.

    Attributes:
        name: Name in messages.
        nodes: Global block numbers, (n,).
        points: Their positions, m, (n, 3).
        centre: Reference point, m, (3,).
    """

    name: str
    nodes: np.ndarray
    points: np.ndarray
    centre: np.ndarray


@dataclass(frozen=True)
class Section:
    """Pairs of blocks whose relative displacement is one number times an axis.

    Attributes:
        name: Name in messages.
        lower: Global block numbers on the lower side, (n,).
        upper: Those of their partners, (n,).
        axis: Unit vector, (gdim,).
    """

    name: str
    lower: np.ndarray
    upper: np.ndarray
    axis: np.ndarray


@dataclass
class _Rows:
    """Rows of T that differ from the identity's, as triplets."""

    rows: list = field(default_factory=list)
    columns: list = field(default_factory=list)
    values: list = field(default_factory=list)

    def add(self, rows, columns, values) -> None:
        rows, columns, values = np.broadcast_arrays(rows, columns, values)
        self.rows.append(rows.ravel())
        self.columns.append(columns.ravel())
        self.values.append(values.ravel().astype(float))

    def arrays(self):
        if not self.rows:
            return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
        return tuple(np.concatenate(a) for a in (self.rows, self.columns, self.values))


class Jumps:
    """The map from x to u, its numbering, and rigid or glued parts. Collective.

    Args:
        V: Blocked displacement space; its global numbers are the rows of T.
        contacts: Interfaces whose jumps are entries of x.
        bonded: Interfaces without jump.
        sections: Pretension sections, one entry of x each.
        spiders: Rigid spiders, six entries of x each.

    Raises:
        MeshError: If a vertex is on the upper side of two of them, or they go round in a circle.

    Attributes:
        T: Sparse matrix, u = T x.
        start: Global number of the first entry of x that is not one of u's.
        unused: Global numbers of entries of x that nothing depends on, owned ones.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        contacts: list[Interface],
        bonded: list[Interface] = (),
        sections: list[Section] = (),
        spiders: list[Spider] = (),
    ):
        self.V, self.comm, self.gdim = V, V.mesh.comm, V.mesh.geometry.dim
        self.contacts, self.sections, self.spiders = list(contacts), list(sections), list(spiders)
        self.bonded = list(bonded)
        imap = V.dofmap.index_map
        self.range = tuple(self.gdim * i for i in imap.local_range)
        self.start = self.gdim * imap.size_global
        self.n_extra = len(sections) + 6 * len(spiders)
        self._last = self.comm.rank == self.comm.size - 1
        self.n_local = self.range[1] - self.range[0] + (self.n_extra if self._last else 0)
        self._check()
        self.T = self._product()
        self.unused = self._unused()

    # -- numbering ---------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Size of x."""
        return self.start + self.n_extra

    def opening(self, contact: Interface) -> np.ndarray:
        """Global numbers in x of a contact's openings, (n,)."""
        return contact.upper * self.gdim

    def slips(self, contact: Interface) -> np.ndarray:
        """Global numbers in x of its slips, (n, gdim - 1)."""
        return contact.upper[:, None] * self.gdim + np.arange(1, self.gdim)

    def bubbles(self, contact: Interface) -> np.ndarray:
        """Global numbers in x of its midsides' bubbles, in the frame of the edge's first end.

        Shape (n_edges, gdim).
        """
        return contact.upper_midsides[:, None] * self.gdim + np.arange(self.gdim)

    def shortening(self, section: int) -> int:
        """Global number in x of a section's shortening."""
        return self.start + section

    def reference(self, spider: int) -> np.ndarray:
        """Global numbers in x of a spider's translations and rotations, (6,)."""
        return self.start + len(self.sections) + 6 * spider + np.arange(6)

    def owned(self, numbers: np.ndarray) -> np.ndarray:
        """Which global numbers of x this rank owns, as a mask."""
        low, high = self.range
        mine = (numbers >= low) & (numbers < high)
        return mine | (numbers >= self.start) if self._last else mine

    # -- building ----------------------------------------------------------------------------

    def _sets(self):
        """Every constraint: name, the blocks that it governs, those that it refers to, rows."""
        for interface in (*self.contacts, *self.bonded):
            free = any(interface is c for c in self.contacts)
            slaves = np.concatenate([interface.upper, interface.upper_midsides])
            masters = np.concatenate([interface.lower, interface.lower_midsides])
            yield interface.name, slaves, masters, self._pair_rows(interface, free)
        for i, section in enumerate(self.sections):
            yield section.name, section.upper, section.lower, self._section_rows(i, section)
        for i, spider in enumerate(self.spiders):
            yield spider.name, spider.nodes, np.empty(0, int), self._spider_rows(i, spider)

    def _pair_rows(self, c: Interface, free: bool) -> _Rows:
        rows, axes = _Rows(), np.arange(self.gdim)
        slave, master = (b[:, None] * self.gdim + axes for b in (c.upper, c.lower))
        rows.add(slave, master, 1.0)
        middle = c.upper_midsides[:, None] * self.gdim + axes
        rows.add(middle, c.lower_midsides[:, None] * self.gdim + axes, 1.0)
        if not free:
            return rows
        # u_upper = u_lower + frame^T w: component i gets frame[k, i] of jump k.
        turned = c.frames.transpose(0, 2, 1)
        rows.add(slave[:, :, None], slave[:, None, :], turned)
        first = c.edges[:, 0]
        rows.add(middle[:, :, None], middle[:, None, :], turned[first])
        for end in c.edges.T:
            rows.add(middle[:, :, None], slave[end][:, None, :], 0.5 * turned[end])
        return rows

    def _section_rows(self, i: int, section: Section) -> _Rows:
        rows, axes = _Rows(), np.arange(self.gdim)
        slave, master = (b[:, None] * self.gdim + axes for b in (section.upper, section.lower))
        rows.add(slave, master, 1.0)
        # Shortened by s, the upper half's end lies s below the lower half's: they overlap.
        rows.add(slave, self.shortening(i), -section.axis)
        return rows

    def _spider_rows(self, i: int, spider: Spider) -> _Rows:
        if self.gdim != 3:
            raise InputError(f"{spider.name}: a spider needs a three-dimensional mesh.")
        rows, columns = _Rows(), self.reference(i)
        slave = spider.nodes[:, None] * 3 + np.arange(3)
        arm = spider.points - spider.centre
        rows.add(slave, columns[:3], 1.0)
        # u = U + theta x arm
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            rows.add(slave[:, a], columns[3 + b], arm[:, c])
            rows.add(slave[:, a], columns[3 + c], -arm[:, b])
        return rows

    def _check(self) -> None:
        names: dict[int, str] = {}
        for name, slaves, _, _ in self._sets():
            for node in slaves.tolist():
                if node in names:
                    raise MeshError(
                        f"{name} and {names[node]} both govern one vertex; expected each vertex on "
                        "the upper side of one contact, section or spider. Swap lower and upper of "
                        "one of them, or make them meet less."
                    )
                names[node] = name

    def _product(self) -> PETSc.Mat:
        """T as the product of one factor for each constraint, those referred to applied last."""
        groups = _ordered([(name, set(s.tolist()), set(m.tolist()), rows)
                           for name, s, m, rows in self._sets()])  # fmt: skip
        T = self._factor(groups[0] if groups else [], whole=False)
        for group in groups[1:]:
            factor = self._factor(group, whole=True)
            previous, T = T, T.matMult(factor)
            previous.destroy(), factor.destroy()
        return T

    def _factor(self, group, whole: bool) -> PETSc.Mat:
        """The constraints of one group; rows over u or, if ``whole``, over x."""
        low, high = self.range
        n_rows, rows_total = (self.n_local, self.n) if whole else (high - low, self.start)
        governed = np.zeros(n_rows, dtype=bool)
        triplets = []
        for _, slaves, _, rows in group:
            blocks = np.array(sorted(slaves), dtype=np.int64)
            dofs = (blocks[:, None] * self.gdim + np.arange(self.gdim)).ravel()
            governed[dofs[(dofs >= low) & (dofs < high)] - low] = True
            i, j, v = rows.arrays()
            mine = (i >= low) & (i < high)
            triplets.append((i[mine] - low, j[mine], v[mine]))
        plain = np.flatnonzero(~governed)
        column = np.where(plain < high - low, plain + low, plain - (high - low) + self.start)
        triplets.append((plain, column, np.ones(len(plain))))
        i, j, v = (np.concatenate(part) for part in zip(*triplets, strict=True))
        A = scipy.sparse.csr_matrix((v, (i, j)), shape=(n_rows, self.n))
        return PETSc.Mat().createAIJ(
            ((n_rows, rows_total), (self.n_local, self.n)),
            csr=(A.indptr.astype(np.int32), A.indices.astype(np.int32), A.data),
            comm=self.comm,
        )

    def _unused(self) -> np.ndarray:
        """Owned entries of x that no displacement depends on: their columns of T are empty."""
        ones = self.T.createVecLeft()
        ones.set(1.0)
        indptr, indices, data = self.T.getValuesCSR()
        square = PETSc.Mat().createAIJ(
            self.T.getSizes(), csr=(indptr, indices, np.abs(data)), comm=self.comm
        )
        weight = self.T.createVecRight()
        square.multTranspose(ones, weight)
        empty = np.flatnonzero(weight.array_r == 0.0)
        square.destroy(), ones.destroy(), weight.destroy()
        own = self.range[1] - self.range[0]
        return np.where(empty < own, empty + self.range[0], empty - own + self.start)

    # -- use ---------------------------------------------------------------------------------

    def displacement(self, x: PETSc.Vec) -> fem.Function:
        """The displacement u = T x as a function."""
        u = fem.Function(self.V)
        self.expand(x, u)
        return u

    def expand(self, x: PETSc.Vec, u: fem.Function) -> None:
        """Put T x into a function."""
        y = self.T.createVecLeft()
        self.T.mult(x, y)
        u.x.array[: len(y.array_r)] = y.array_r
        u.x.scatter_forward()
        y.destroy()

    def gather(self, x: PETSc.Vec, numbers: np.ndarray) -> np.ndarray:
        """Entries of x by global number, the same on all ranks, in the shape of ``numbers``."""
        flat = np.asarray(numbers).ravel()
        mine = self.owned(flat)
        values = np.zeros(len(flat))
        values[mine] = x.array_r[self.local(flat[mine])]
        self.comm.Allreduce(MPI.IN_PLACE, values)
        return values.reshape(np.shape(numbers))

    def globals(self, local: np.ndarray) -> np.ndarray:
        """Global numbers of owned entries by local number."""
        own = self.range[1] - self.range[0]
        return np.where(local < own, local + self.range[0], local - own + self.start)

    def local(self, numbers: np.ndarray) -> np.ndarray:
        """Local numbers of owned entries."""
        own = self.range[1] - self.range[0]
        return np.where(
            numbers < self.start, numbers - self.range[0], own + numbers - self.start
        ).astype(np.int64)


def _ordered(sets: list) -> list[list]:
    """Constraints in groups; one whose masters another governs comes before that other."""
    sorter = TopologicalSorter(
        {i: {j for j, o in enumerate(sets) if i != j and o[2] & s[1]} for i, s in enumerate(sets)}
    )
    try:
        sorter.prepare()
    except CycleError as error:
        names = ", ".join(dict.fromkeys(sets[i][0] for i in error.args[1]))
        raise MeshError(f"{names}: each governs vertices that another refers to; expected no "
                        "circle. Swap lower and upper of one of them.") from None  # fmt: skip
    groups = []
    while sorter.is_active():
        ready = sorter.get_ready()
        groups.append([sets[i] for i in sorted(ready)])
        sorter.done(*ready)
    return groups

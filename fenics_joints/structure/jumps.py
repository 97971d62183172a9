"""Displacements in terms of jumps: u = T x.

Of each pair of a contact, x holds the lower body's displacement and the *jump* (upper minus lower)
in the pair's frame: opening, then slips. The elastic energy in x is that of T^T K T, every contact
condition is one on single entries of x, and bonded, sliding and open are entries held or free.
Pretension sections, rigid spiders, obstacles and faces that are moved add a few entries at the end
of x. Of faces that do not match, the lower body's displacement is an average
(`fenics_joints.meshes.mortar`); of an obstacle it is that of the obstacle.

At degree 2 the jump of a midside is that of a linear function plus a bubble, which is an entry of
its own. A contact holds the bubbles at zero: its jump is piecewise linear, so that its forces act
on the vertices with positive weights, which quadratic facets do not give by themselves (triangles
have weight zero at the vertices, serendipity quadrilaterals a negative one).
"""

from __future__ import annotations

from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import numpy as np
import scipy.sparse
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError, MeshError
from fenics_joints.structure.faces import Interface


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


@dataclass(frozen=True)
class Moved:
    """Blocks whose displacement in some directions is the same, an entry of x each.

    Attributes:
        name: Name in messages.
        nodes: Global block numbers, (n,).
        directions: The directions, as numbers of axes.
        frame: Directions of its entries of x as rows, (gdim, gdim); None for those of space.
    """

    name: str
    nodes: np.ndarray
    directions: tuple[int, ...]
    frame: np.ndarray | None = None


class Jumps:
    """The map from x to u, its numbering, and rigid or glued parts. Collective.

    Args:
        V: Blocked displacement space; its global numbers are the rows of T.
        contacts: Interfaces whose jumps are entries of x.
        bonded: Interfaces without jump.
        sections: Pretension sections, one entry of x each.
        spiders: Rigid spiders, six entries of x each.
        moved: Faces that are moved, and obstacles (of which ``nodes`` is empty, and the name an
            interface's), as many entries of x each as space has dimensions.

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
        moved: list[Moved] = (),
    ):
        self.V, self.comm, self.gdim = V, V.mesh.comm, V.mesh.geometry.dim
        self.contacts, self.sections, self.spiders = list(contacts), list(sections), list(spiders)
        self.bonded, self.moved = list(bonded), list(moved)
        imap = V.dofmap.index_map
        self.range = tuple(self.gdim * i for i in imap.local_range)
        self.start = self.gdim * imap.size_global
        self.n_extra = len(sections) + 6 * len(spiders) + self.gdim * len(self.moved)
        self._last = self.comm.rank == self.comm.size - 1
        self._own = self.range[1] - self.range[0]
        self.n_local = self._own + (self.n_extra if self._last else 0)
        self._check()
        self.T = self._product()
        self.unused = self._unused()

    # -- numbering ---------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Size of x."""
        return self.start + self.n_extra

    def entries(self, blocks: np.ndarray) -> np.ndarray:
        """Global numbers in x of blocks of u, (n, gdim)."""
        return np.asarray(blocks, dtype=np.int64)[:, None] * self.gdim + np.arange(self.gdim)

    def numbers(self, contact: Interface) -> np.ndarray:
        """Global numbers in x of a contact's openings and, after them, slips, (n, gdim)."""
        return self.entries(contact.upper)

    def bubbles(self, contact: Interface) -> np.ndarray:
        """Global numbers in x of its midsides' bubbles, in the frame of the edge's first end.

        Shape (n_edges, gdim).
        """
        return self.entries(contact.upper_midsides)

    def shortening(self, section: int) -> int:
        """Global number in x of a section's shortening."""
        return self.start + section

    def reference(self, spider: int) -> np.ndarray:
        """Global numbers in x of a spider's translations and rotations, (6,)."""
        return self.start + len(self.sections) + 6 * spider + np.arange(6)

    def shift(self, moved: int) -> np.ndarray:
        """Global numbers in x of the displacement of a moved face or obstacle, (gdim,)."""
        first = self.start + len(self.sections) + 6 * len(self.spiders)
        return first + self.gdim * moved + np.arange(self.gdim)

    def frame(self, moved: int) -> np.ndarray:
        """Directions of the entries `shift` as rows, (gdim, gdim)."""
        given = self.moved[moved].frame
        return np.eye(self.gdim) if given is None else given

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
            own = interface.upper_midsides
            if interface.coupling is not None:
                own = interface.coupling.midsides
            slaves = np.concatenate([interface.upper, own])
            masters = np.concatenate([interface.masters, interface.lower_midsides])
            yield interface.name, slaves, masters, self._pair_rows(interface, free)
        for i, section in enumerate(self.sections):
            yield section.name, section.upper, section.lower, self._section_rows(i, section)
        for i, spider in enumerate(self.spiders):
            yield spider.name, spider.nodes, np.empty(0, int), self._spider_rows(i, spider)
        for i, moved in enumerate(self.moved):
            yield moved.name, moved.nodes, np.empty(0, int), self._moved_rows(i, moved)

    # Rows of T that differ from the identity's: parts of rows, columns and values that broadcast.

    def _pair_rows(self, c: Interface, free: bool) -> list[tuple]:
        slave, middle = self.numbers(c), self.bubbles(c)
        if c.coupling is not None:
            return self._coupled_rows(c, free)
        if len(c.lower):
            rows = [
                (slave, self.entries(c.lower), 1.0),
                (middle, self.entries(c.lower_midsides), 1.0),
            ]
        else:
            i = [m.name for m in self.moved].index(c.name)
            shift, along = self.shift(i)[None, None, :], self.frame(i).T
            rows = [(slave[:, :, None], shift, along), (middle[:, :, None], shift, along)]
        if not free:
            return rows
        # u_upper = u_lower + frame^T w: component i gets frame[k, i] of jump k.
        turned = c.frames.transpose(0, 2, 1)
        rows.append((slave[:, :, None], slave[:, None, :], turned))
        rows.append((middle[:, :, None], middle[:, None, :], turned[c.edges[:, 0]]))
        for end in c.edges.T:
            rows.append((middle[:, :, None], slave[end][:, None, :], 0.5 * turned[end]))
        return rows

    def _coupled_rows(self, c: Interface, free: bool) -> list[tuple]:
        """Rows of faces that do not match, see `Coupling`; of midsides, half of both ends' more."""
        coupling = c.coupling
        slave, middle = self.numbers(c), self.entries(coupling.midsides)
        ends, n = coupling.edges, len(c)
        half = scipy.sparse.coo_matrix(
            (np.full(ends.size, 0.5), (np.repeat(np.arange(len(ends)), 2), ends.ravel())),
            shape=(len(ends), n),
        ).tocsr()
        bound, rows = ~coupling.free, [(slave, slave, coupling.free.astype(float))]
        nodes = self.entries(coupling.nodes)
        for factor, columns in ((coupling.weights, nodes), (-coupling.bubbles, middle)):
            entry = factor.tocoo()
            i, j, value = entry.row, entry.col, entry.data[:, None]
            rows.append((slave[i], columns[j], value * bound[i]))
            entry = (half @ factor).tocoo()
            i, j, value = entry.row, entry.col, entry.data[:, None]
            rows.append((middle[i], columns[j], value))
        rows.append((middle, middle, 1.0))
        if free:
            turned = c.frames.transpose(0, 2, 1)
            rows.append((slave[:, :, None], slave[:, None, :], turned))
            for end in ends.T:
                rows.append((middle[:, :, None], slave[end][:, None, :], 0.5 * turned[end]))
        return rows

    def _moved_rows(self, i: int, moved: Moved) -> list[tuple]:
        slave, shift = self.entries(moved.nodes), self.shift(i)
        given = np.isin(np.arange(self.gdim), moved.directions)
        return [(slave, shift, given * 1.0), (slave, slave, ~given * 1.0)]

    def _section_rows(self, i: int, section: Section) -> list[tuple]:
        slave = self.entries(section.upper)
        # Shortened by s, the upper half's end lies s below the lower half's: they overlap.
        return [
            (slave, self.entries(section.lower), 1.0),
            (slave, self.shortening(i), -section.axis),
        ]

    def _spider_rows(self, i: int, spider: Spider) -> list[tuple]:
        if self.gdim != 3:
            raise InputError(f"{spider.name}: a spider needs a three-dimensional mesh.")
        slave, columns = self.entries(spider.nodes), self.reference(i)
        arm = spider.points - spider.centre
        rows = [(slave, columns[:3], 1.0)]
        # u = U + theta x arm
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            rows.append((slave[:, a], columns[3 + b], arm[:, c]))
            rows.append((slave[:, a], columns[3 + c], -arm[:, b]))
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
        groups = _ordered(
            [(name, set(s.tolist()), set(m.tolist()), rows) for name, s, m, rows in self._sets()]
        )
        T = self._factor(groups[0] if groups else [], whole=False)
        for group in groups[1:]:
            factor = self._factor(group, whole=True)
            previous, T = T, T.matMult(factor)
            previous.destroy(), factor.destroy()
        return T

    def _factor(self, group, whole: bool) -> PETSc.Mat:
        """The constraints of one group; rows over u or, if ``whole``, over x."""
        low, high = self.range
        n_rows = self.n_local if whole else self._own
        governed = np.zeros(n_rows, dtype=bool)
        triplets = []
        for _, slaves, _, rows in group:
            dofs = self.entries(sorted(slaves))
            governed[dofs[(dofs >= low) & (dofs < high)] - low] = True
            i, j, v = _flat(rows)
            mine = (i >= low) & (i < high)
            triplets.append((i[mine] - low, j[mine], v[mine]))
        plain = np.flatnonzero(~governed)
        i, j, v = _flat([*triplets, (plain, self.globals(plain), 1.0)])
        A = scipy.sparse.csr_matrix((v, (i, j)), shape=(n_rows, self.n))
        A.eliminate_zeros()
        return self._matrix(A)

    def _unused(self) -> np.ndarray:
        """Owned entries of x that no displacement depends on: their columns of T are empty."""
        _, columns, data = self.T.getValuesCSR()
        weight = self.T.createVecRight()
        weight.set(0.0)
        weight.setValues(columns, np.abs(data), PETSc.InsertMode.ADD_VALUES)
        weight.assemble()
        empty = np.flatnonzero(weight.array_r == 0.0)
        weight.destroy()
        return self.globals(empty)

    # -- use ---------------------------------------------------------------------------------

    def project(self, A: PETSc.Mat) -> PETSc.Mat:
        """T^T A T, a matrix over x, of one over u, which is freed. Collective."""
        # T = E + G, where E is the identity and G has the rows g of governed displacements alone:
        # E^T A E + G^T A_g T + E^T A^g G takes less time than two products, and half of the memory.
        indptr, columns, values = self.T.getValuesCSR()
        T = scipy.sparse.csr_matrix((values, columns, indptr), (self._own, self.n))
        plain = self.globals(np.arange(self._own))
        G = T - scipy.sparse.csr_matrix(
            (np.ones(self._own), (np.arange(self._own), plain)), T.shape
        )
        G.eliminate_zeros()
        own = np.flatnonzero(np.diff(G.indptr))
        rows = PETSc.IS().createGeneral(plain[own].astype(PETSc.IntType), comm=self.comm)
        every = PETSc.IS().createStride(self._own, self.range[0], 1, comm=self.comm)
        G = self._matrix(G[own])
        parts = A.createSubMatrix(rows, every), A.createSubMatrix(every, rows)
        products = [parts[0].matMult(self.T), parts[1].matMult(G)]
        change = G.transposeMatMult(products[0])
        if self.n_extra:
            A, products[1] = (self._widened(part) for part in (A, products[1]))
        different = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
        change.axpy(1.0, products[1], different)
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        A.axpy(1.0, change, different)
        for owned in (rows, every, G, change, *parts, *products):
            owned.destroy()
        return A

    def _widened(self, A: PETSc.Mat) -> PETSc.Mat:
        """A matrix with rows over u, which is freed, as one over x."""
        indptr, columns, values = A.getValuesCSR()
        A.destroy()
        more = np.full(self.n_local - self._own, indptr[-1])
        rows = (values, columns, np.concatenate([indptr, more]))
        return self._matrix(scipy.sparse.csr_matrix(rows, (self.n_local, self.n)))

    def _matrix(self, A: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """This rank's rows of a matrix whose columns are x."""
        return PETSc.Mat().createAIJ(
            ((A.shape[0], None), (self.n_local, self.n)),
            csr=(A.indptr.astype(np.int32), A.indices.astype(np.int32), A.data),
            comm=self.comm,
        )

    def displacement(self, x: PETSc.Vec) -> fem.Function:
        """The displacement u = T x as a function."""
        u, y = fem.Function(self.V), self.T * x
        u.x.array[: len(y.array_r)] = y.array_r
        u.x.scatter_forward()
        y.destroy()
        return u

    def gather(self, x: PETSc.Vec, numbers: np.ndarray) -> np.ndarray:
        """Entries of x by global number, the same on all ranks, in the shape of ``numbers``."""
        flat = np.asarray(numbers).ravel()
        mine = self.owned(flat)
        values = np.zeros(len(flat))
        values[mine] = x.array_r[self.local(flat[mine])]
        self.comm.Allreduce(MPI.IN_PLACE, values)
        return values.reshape(np.shape(numbers))

    def put(self, array: np.ndarray, numbers: np.ndarray, values) -> None:
        """Set entries of this rank's part of x by global number; those of other ranks are not."""
        flat = np.ravel(numbers)
        values, mine = np.broadcast_to(values, np.shape(numbers)).ravel(), self.owned(flat)
        array[self.local(flat[mine])] = values[mine]

    def globals(self, local: np.ndarray) -> np.ndarray:
        """Global numbers of owned entries by local number."""
        return np.where(local < self._own, local + self.range[0], local - self._own + self.start)

    def local(self, numbers: np.ndarray) -> np.ndarray:
        """Local numbers of owned entries."""
        inside, extra = numbers - self.range[0], self._own + numbers - self.start
        return np.where(numbers < self.start, inside, extra).astype(np.int64)


def alone(product: PETSc.Mat, *factors: PETSc.Mat) -> PETSc.Mat:
    """A copy of a product, which is freed with its factors: it holds on to them. Collective."""
    copy = product.copy()
    for owned in (product, *factors):
        owned.destroy()
    return copy


def _flat(parts: list[tuple]) -> list[np.ndarray]:
    """Rows, columns and values of parts of each that broadcast."""
    whole = [[a.ravel() for a in np.broadcast_arrays(*part)] for part in parts]
    return [np.concatenate(arrays) for arrays in zip(*whole, strict=True)]


def _ordered(sets: list) -> list[list]:
    """Constraints in groups; one whose masters another governs comes before that other."""
    sorter = TopologicalSorter(
        {i: {j for j, o in enumerate(sets) if i != j and o[2] & s[1]} for i, s in enumerate(sets)}
    )
    try:
        sorter.prepare()
    except CycleError as error:
        names = ", ".join(dict.fromkeys(sets[i][0] for i in error.args[1]))
        raise MeshError(
            f"{names}: each governs vertices that another refers to; expected no "
            "circle. Swap lower and upper of one of them."
        ) from None
    groups = []
    while sorter.is_active():
        ready = sorter.get_ready()
        groups.append([sets[i] for i in sorted(ready)])
        sorter.done(*ready)
    return groups

"""A jointed structure on a mesh: K(p) and M(p), their derivatives, and its motion at points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from numpy.typing import ArrayLike
from petsc4py import PETSc

from fenics_joints._compat import geometry_dofmap
from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import Ring, measure_ring
from fenics_joints.meshes.rings import ring_names
from fenics_joints.meshes.tagged import limits
from fenics_joints.structure.assembly import Assembly
from fenics_joints.structure.changes import Change, change_slopes
from fenics_joints.structure.components import Parameter, Region, number, slopes
from fenics_joints.structure.damping import Damping
from fenics_joints.structure.grids import cell_grid, cell_volumes, corner_motion, pyvista
from fenics_joints.structure.points import PointRows, Sensors, observe
from fenics_joints.structure.sparse import MatrixForm, RowForm, as_columns

_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


class Structure(Assembly):
    """A finite-element model whose matrices are functions of named parameters.

    Fulfils `fenics_joints.structure.model.Model`, with PETSc matrices that are shared out over the
    ranks. The arguments are those of `Assembly`, which says more.
    """

    #: See `fenics_joints.structure.model.Model`.
    is_dense, is_meshed = False, True
    #: Dashpots, which solids have none of.
    dampers: Mapping[str, PETSc.Mat] = MappingProxyType({})

    def __repr__(self) -> str:
        return (
            f"Structure({len(self.regions)} parts and joints, {len(self.parameters)} parameters, "
            f"{self.n_dofs} DOFs)"
        )

    def coarser(
        self, regions: Sequence[Region] | None = None, more: Sequence[Parameter] = ()
    ) -> Structure:
        """The same structure with displacements of degree 1, for multigrid.

        Args:
            regions: In the place of its own, if they are to be others.
            more: Parameters that these take besides.
        """
        return self._again(1, more, regions=self.regions if regions is None else regions)

    def finer(self) -> Structure | None:
        """The same structure on the same mesh with displacements of one degree more; None beyond
        the third, or with ties beyond the second."""
        most = 3 if self.ties is None else 2
        return self._again(self.degree + 1) if self.degree < most else None

    def with_changes(self, changes: Sequence[Change], more: Sequence[Parameter]) -> Structure:
        """The same structure with further changes and their parameters."""
        return self._again(self.degree, more, changes=(*self.changes, *changes))

    def _again(self, degree: int, more: Sequence[Parameter] = (), **changed) -> Structure:
        parameters, made_of = [*self.parameters.values(), *more], self._made_of | changed
        return Structure(self.tagged, parameters=parameters, degree=degree, **made_of)

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of parts, joints and elastic supports, which may have damping of their own."""
        return tuple(c.name for c in (*self.regions, *self.elastic_supports))

    def resolved(self, damping: Damping) -> Damping:
        """A damping by names of `layers`, which are those that a user knows."""
        return damping

    # -- derivatives ---------------------------------------------------------------------------

    def cell_gradient(self, shape: PETSc.Vec, eigenvalue: float, given=None) -> np.ndarray:
        """Derivative of x^T (K - lambda M) x by every property of every cell: one assembly.

        Args:
            shape: Displacement vector x, owned entries.
            eigenvalue: lambda, (rad/s)^2.
            given: Values of parameters that differ from their nominal value.

        Returns:
            Shape (n_owned_cells, n_properties), for this rank's cells.
        """
        return self._cell_gradients([shape], [eigenvalue], given)[..., 0]

    def _cell_gradients(self, shapes, eigenvalues, given) -> np.ndarray:
        """`cell_gradient` of several shapes, (n_owned_cells, n_properties, n_shapes)."""
        self.update(given)
        form, found = self.compiled("gradient", self._energy_slope), []
        for shape, eigenvalue in zip(shapes, eigenvalues, strict=True):
            self.put_displacement(self._phi, shape)
            self._lambda.value = eigenvalue
            # Cell integrals reach no other cell's property: nothing is to be summed over ranks.
            found.append(self.field.by_cell(fem.assemble_vector(form).array))
        return np.stack(found, axis=-1)

    def _energy_slope(self) -> ufl.Form:
        """Derivative of x^T (K - lambda M) x by the property field, of `_phi` and `_lambda`."""
        self._phi, self._lambda = fem.Function(self.V), fem.Constant(self.mesh, 0.0)
        energy = self.stiffness_form(self._phi, self._phi)
        energy = energy - self._lambda * self.inertia_form(self._phi, self._phi)
        return ufl.derivative(energy, self.field.q, ufl.TestFunction(self.field.space))

    def pencil_gradients(self, shapes, eigenvalues, given=None) -> np.ndarray:
        """Derivative of x^T (K - lambda M) x by every parameter, at fixed x. Collective.

        For an M-normalised eigenvector that is the eigenvalue's derivative.

        Returns:
            Shape (len(shapes), n_parameters), in the order of `parameters`.
        """
        values, X = self.values(given), as_columns(shapes)
        lam = np.asarray(eigenvalues, dtype=float)
        if not len(lam):
            return np.empty((0, len(values)))
        gradient = self.field.contract(self._cell_gradients(shapes, lam.tolist(), given), values)
        for p, kind, _, form in self._point_slopes(values):
            energies = self.comm.allreduce(np.sum(X * (form @ X), axis=0))
            gradient[:, p] += energies if kind == "K" else -lam * energies
        return gradient

    def region_stiffness(self, name: str, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """Stiffness of one part, joint or elastic support alone; the caller's to destroy.

        Rows and columns of held DOFs are zero. Collective.
        """
        values = self.update(given)
        for i, support in enumerate(self.elastic_supports):
            if support.name == name:
                normal, tangential = self.support_matrices(i)
                A = normal.copy()
                A.scale(number(support.k_n, values))
                A.axpy(number(support.k_t, values), tangential, structure=_SUBSET)
                return A
        at = [r.name for r in self.regions].index(name)
        return self.assembled(self.compiled_region(at, 0))

    def slopes(
        self, given: Mapping[str, float] | None = None, apart: Sequence[str] = ()
    ) -> Iterator[tuple[int, str, str | None, MatrixForm | RowForm]]:
        """dK/dp and dM/dp, of all parameters that change them. Collective.

        Args:
            given: Values of parameters that differ from their nominal value.
            apart: Regions and elastic supports whose share of dK/dp is yielded with its name.

        Yields:
            Index of the parameter; ``"K"`` or ``"M"``; a name from ``apart``, or None; a share of
            the derivative, the caller's to destroy. Several may belong to one parameter.
        """
        values = self.update(given)
        yield from self._region_slopes(values, apart)
        yield from self._point_slopes(values, apart)

    def _point_slopes(self, values, apart: Sequence[str] = ()):
        """`slopes` by supports, springs and point masses."""
        position = {name: i for i, name in enumerate(self.parameters)}
        for i, support in enumerate(self.elastic_supports):
            units = self.support_matrices(i)
            for k, unit in zip(support.properties.values(), units, strict=True):
                if isinstance(k, str):
                    name = support.name if support.name in apart else None
                    yield position[k], "K", name, MatrixForm(unit)
        for spring in self.springs:
            if isinstance(spring.stiffness, str):
                at = self.loads(Sensors(spring.point, spring.direction))
                form = RowForm(at, at, spring.share, self.comm)
                yield position[spring.stiffness], "K", None, form
        for mass in self.masses:
            if isinstance(mass.mass, str) or isinstance(mass.travel, str):
                at, slope = self.mass_rows(mass, values)
            if isinstance(mass.mass, str):
                yield position[mass.mass], "M", None, RowForm(at, at, mass.share, self.comm)
            if isinstance(mass.travel, str):
                m = mass.share * number(mass.mass, values)
                left, right = np.hstack([slope, at]), np.hstack([at, slope])
                yield position[mass.travel], "M", None, RowForm(left, right, m, self.comm)
        yield from change_slopes(self, values)

    def _region_slopes(self, values, apart):
        """`slopes` by properties of parts and joints.

        Parameters whose cells have no node in common are rows of one matrix, as the columns of a
        sparse Jacobian are found together (Curtis, Powell and Reid, J. Inst. Math. Appl. 13, 1974).
        """
        position = {name: i for i, name in enumerate(self.parameters)}
        for which, dependent in enumerate(self._dependent(apart)):
            keys, regions = list(dependent), list(dependent.values())
            nodes = self.nodes_of(
                [np.concatenate([self.field.regions[i][1] for i in some]) for some in regions]
            )
            for together in self._apart(nodes):
                moved = [(keys[k][0], i) for k in together for i in regions[k]]
                A = self._slope_matrix(which, moved, values)
                for k in together:
                    rows, (name, layer) = None, keys[k]
                    if len(together) > 1:
                        own = nodes[[k]].indices
                        rows = (own[:, None] * self.gdim + np.arange(self.gdim)).ravel()
                    form = MatrixForm(A, k == together[-1], rows)
                    yield position[name], "KM"[which], layer, form

    def _dependent(self, apart) -> tuple[dict[tuple, list[int]], dict[tuple, list[int]]]:
        """Regions whose stiffness, and whose mass, depends on a parameter, by its name and by that
        of a region that is wanted apart, or None."""
        found: tuple[dict[tuple, list[int]], ...] = ({}, {})
        for i, region in enumerate(self.regions):
            names = {n for key in region.law.properties for n in self.field.named(i, key)}
            layer = region.name if region.name in apart else None
            for name in sorted(names):
                for which, moves in enumerate(self._matters(i, name)):
                    if moves:
                        found[which].setdefault((name, None if which else layer), []).append(i)
        return found

    def _slope_matrix(self, which: int, moved: list[tuple[str, int]], values) -> PETSc.Mat:
        """dK (which = 0) or dM (1) of regions, each by a parameter of its own."""
        if self._direction is None:
            self._direction = fem.Function(self.field.space)
        self._direction.x.array[:] = 0.0
        for name, i in moved:
            self.field.put(self._direction, *self.field.slopes(i, name, values))
        cells = np.concatenate([self.field.regions[i][1] for _, i in moved])
        return self.assembled(self.slope_form(which, self._direction, cells))

    def _apart(self, nodes) -> list[list[int]]:
        """Sets of cells in groups whose members have no node in common, the same on all ranks.

        Args:
            nodes: See `Assembly.nodes_of`.
        """
        if self.ties is not None:  # these pass nodes on to others
            return [[k] for k in range(nodes.shape[0])]
        common = (nodes @ nodes.T).tocoo()
        near: list[set[int]] = [set() for _ in range(nodes.shape[0])]
        for rows, columns in self.comm.allgather(common.coords):
            for k, other in zip(rows.tolist(), columns.tolist(), strict=True):
                near[k].add(other)
        groups: list[list[int]] = []
        for k, others in enumerate(near):
            free = next((group for group in groups if others.isdisjoint(group)), None)
            if free is None:
                groups.append(free := [])
            free.append(k)
        return groups

    def _matters(self, i: int, parameter: str) -> tuple[bool, bool]:
        """Whether a parameter changes a region's stiffness and its mass, by its law's scalars."""
        region, q = self.regions[i], self.field.means(i)
        keys = [key for key in region.law.properties if parameter in self.field.named(i, key)]
        terms = region.law.stiffness_terms, region.law.inertia_term
        return tuple(any(np.any(slopes(t, q, key)) for key in keys) for t in terms)

    def mass_rows(self, mass, values) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the displacement at a mass and of its slope along the travel, (n_local, gdim)."""
        place = np.array(self.place(mass, values))[: self.gdim]
        rows = self.rows(np.repeat(place[None], self.gdim, axis=0))
        along = rows.gradients @ np.asarray(mass.direction, dtype=float)[: self.gdim]
        moved = PointRows(rows.index, rows.nodes, along, rows.gradients)
        return self.point_loads(rows), self.point_loads(moved)

    # -- places --------------------------------------------------------------------------------

    def point_loads(self, rows: PointRows) -> np.ndarray:
        """This rank's rows of the displacement at a point, (n_local, gdim)."""
        return self.unit_loads(rows, np.eye(self.gdim))

    def loads(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """This rank's rows of the loads of one newton at points, (n_local, n). Collective.

        They are also the rows by which displacement there is read: held degrees of freedom, where
        both differ, do not move.

        Raises:
            InputError: If one is outside the mesh; ``what`` is its name in the message.
        """
        rows = self.rows(sensors.points, what, sensors.names)
        return self.unit_loads(rows, sensors.directions[:, : self.gdim])

    def unit_loads(self, rows: PointRows, directions: np.ndarray) -> np.ndarray:
        """This rank's rows of the loads, N, (n_local, n), of one newton along each direction.

        Args:
            rows: `rows` at the n points.
            directions: Unit directions, (n, gdim). Held degrees of freedom bear no load.
        """
        imap, gdim = self.V.dofmap.index_map, self.gdim
        loads = np.zeros((self.n_local, len(directions)))
        for column, direction in enumerate(directions):
            v = PETSc.Vec().createMPI((self.n_local, None), comm=self.comm)
            for at in np.flatnonzero(rows.index == column):
                value = np.outer(rows.values[at], direction)
                blocks = imap.local_to_global(rows.nodes[at])
                numbers = (blocks[:, None] * gdim + np.arange(gdim)).astype(PETSc.IntType)
                v.setValues(numbers.ravel(), value.ravel(), PETSc.InsertMode.ADD_VALUES)
            v.assemble()
            loads[:, column] = v.array_r
            v.destroy()
        return self.free_loads(loads)

    def free_loads(self, loads: np.ndarray) -> np.ndarray:
        """Loads on the DOFs that are free, of those on all, (n_local, k): held DOFs bear none, and
        tied ones pass them on. Collective."""
        if self.ties is not None:
            return self.ties.loads(loads)
        loads[self.held_dofs[: self.n_local]] = 0.0
        return loads

    def observe(self, shapes, sensors: Sensors) -> np.ndarray:
        """Displacement shapes at sensors, shape (n_sensors, n_shapes), equal on all ranks."""
        rows = self.rows(sensors.points, "sensor", sensors.names)
        return self._observed(rows, sensors.directions[:, : self.gdim], shapes)

    def observe_slopes(self, shapes, sensors: Sensors, directions: ArrayLike) -> np.ndarray:
        """Change of what sensors read of displacements per metre that they move. Collective.

        The sensors keep the directions in which they measure. On a face between cells, across which
        the gradient jumps, the slope is that in one of them.

        Args:
            shapes: Displacement vectors, owned entries.
            sensors: The sensors where they stand.
            directions: Where each moves, shape (n_sensors, gdim) or (gdim,); of any length.

        Returns:
            Shape (n_sensors, n_shapes), 1/m, equal on all ranks.

        Raises:
            InputError: If a direction is zero, or a sensor outside the mesh.
        """
        gdim = self.gdim
        towards = Sensors(sensors.points[:, :gdim], np.atleast_2d(directions)[:, :gdim]).directions
        rows = self.rows(sensors.points, "sensor", sensors.names)
        turned = replace(rows, values=np.einsum("pnj,pj->pn", rows.gradients, towards[rows.index]))
        return self._observed(turned, sensors.directions[:, :gdim], shapes)

    def _observed(self, rows: PointRows, directions: np.ndarray, shapes) -> np.ndarray:
        """What is read of shapes at points."""
        if self.ties is None:
            return observe(rows, directions, list(shapes), self.V)
        moved = [self.ties.displacement(shape) for shape in shapes]
        found = observe(rows, directions, moved, self.V)
        for vector in moved:  # Python's collector cannot, on several ranks
            vector.destroy()
        return found

    # -- size and mass -------------------------------------------------------------------------

    def dilation_frequency(self, given: Mapping[str, float] | None = None) -> float:
        """Frequency, Hz, at which the body would breathe if it grew evenly in all directions.

        A Rayleigh quotient, of the order of wave speed over length: a scale for spectral shifts.
        Supports and springs are left out.
        """
        self.update(given)
        u = self._evenly()
        forms = (
            self.compiled("dilation", lambda: self.stiffness_form(u, u)),
            self.compiled("dilation mass", lambda: self.inertia_form(u, u)),
        )
        stiff, heavy = (self.comm.allreduce(fem.assemble_scalar(form)) for form in forms)
        if heavy <= 0:
            raise InputError("the structure has no mass: expected a density > 0 in some part.")
        return float(np.sqrt(stiff / heavy) / (2 * np.pi))

    def _evenly(self) -> ufl.core.expr.Expr:
        """Displacement of a body that grows evenly about its middle."""
        low, high = limits(self.tagged)
        centre = 0.5 * (low + high)
        if self.axisymmetric:
            centre[0] = 0.0
        return ufl.SpatialCoordinate(self.mesh) - ufl.as_vector([float(c) for c in centre])

    def extent(self, number: int) -> float:
        """Largest extent, m, of a region's cells along its normal: a layer's thickness."""
        region, cells = self.field.regions[number]
        corners = self.mesh.geometry.x[geometry_dofmap(self.mesh)[cells]]
        normals = self.normals(number, cells)
        along = np.einsum("cki,ci->ck", corners[..., : self.gdim], normals)
        local = float(np.ptp(along, axis=1).max()) if len(cells) else 0.0
        return self.comm.allreduce(local, op=MPI.MAX)

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg, of parts, joints and point masses."""
        values = self.update(given)
        one = ufl.as_vector([1.0] + [0.0] * (self.gdim - 1))
        form = self.compiled("weight", lambda: self.inertia_form(one, one))
        attached = sum(m.share * number(m.mass, values) for m in self.masses)
        attached += sum(c.volume * c.law.inertia_term(c.values(values)) for c in self.changes)
        return self.comm.allreduce(fem.assemble_scalar(form)) + attached

    def volumes(self) -> np.ndarray:
        """Volume as meshed, m3, of every region, in the order of `regions`. Collective.

        In the plane it is that of one metre of depth, or of the whole body of revolution.
        """
        local = self.cell_volumes()
        sums = [local[cells[cells < len(local)]].sum() for _, cells in self.field.regions]
        return self.comm.allreduce(np.array(sums))

    def cell_volumes(self) -> np.ndarray:
        """Volume as meshed, m3, of every cell that this rank owns; of layers the covered share."""
        weight = self.weight if self.share is None else self.weight * self.share
        return cell_volumes(self.mesh, weight)

    # -- pictures ------------------------------------------------------------------------------

    def displacement(self, vector: PETSc.Vec) -> fem.Function:
        """A displacement vector, owned entries, as a function on the mesh. Collective."""
        u = fem.Function(self.V, name="displacement")
        self.put_displacement(u, vector)
        return u

    def put_displacement(self, u: fem.Function, vector: PETSc.Vec) -> None:
        """Put a displacement vector, owned entries, into a function. Collective."""
        if self.ties is None:
            u.x.array[: self.n_local] = vector.array_r
        else:
            moved = self.ties.displacement(vector)
            u.x.array[: self.n_local] = moved.array_r
            moved.destroy()
        u.x.scatter_forward()

    @property
    def size_m(self) -> np.ndarray:
        """Extents of the mesh along the axes, m, (gdim,). Collective."""
        low, high = limits(self.tagged)
        return high - low

    def rings(self) -> tuple[Ring, ...]:
        """The bolts' rings ``ring_1``, ... of a mesh in space, those that are flat layers."""
        found = []
        for name in ring_names(list(self.tagged.cell_names)) if self.gdim == 3 else ():
            try:
                found.append(measure_ring(self.tagged, name))
            except MeshError:
                continue  # no flat layer: its joint's law may be for any shape
        return tuple(found)

    def to_pyvista(self):
        """The cells with their ``region``, its place in `regions`, for pyvista. Collective.

        Returns:
            A ``pyvista.UnstructuredGrid`` in metres on rank 0; None on the other ranks.

        Raises:
            InputError: If pyvista is not installed: ``pip install 'fenics-joints[view]'``.
        """
        pyvista()
        region, (corners, _) = self.cell_regions(), self.corner_motion([])
        if region is None:
            return None
        tdim = self.mesh.topology.dim
        return cell_grid(corners, tdim, cells={"region": region})

    def cell_regions(self) -> np.ndarray | None:
        """Place in `regions`, or -1, of each cell of `corner_motion`; None on ranks other than 0.

        Collective.
        """
        region = np.full(self.mesh.topology.index_map(self.mesh.topology.dim).size_local, -1)
        for i, (_, cells) in enumerate(self.field.regions):
            region[cells[cells < len(region)]] = i
        every = self.comm.gather(region)
        return None if every is None else np.concatenate(every)

    def corner_motion(self, vectors: Sequence[PETSc.Vec]) -> tuple[np.ndarray, np.ndarray]:
        """Corners of all cells and how they move. Collective.

        Args:
            vectors: Displacement vectors, owned entries.

        Returns:
            On rank 0 the corners, m, shape (n_cells, n_corners, 3), and the displacements, shape
            (n_vectors, n_cells, n_corners, 3), zero in a direction that the mesh does not have;
            empty on the other ranks.
        """
        return corner_motion([self.displacement(v) for v in vectors], self.V, self.element)


#: Position, m, and direction of each place, by name; a force without a position (None) is that of a
#: base that accelerates along the direction.
Places = Mapping[str, tuple[Sequence[float] | None, Sequence[float]]]


def place_loads(
    structure: Structure, what: str, given: Places | None
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Places by name, checked, and the load of one newton at each. Collective.

    Args:
        structure: The structure.
        what: What the places are, for messages: ``"forces"`` or ``"sensors"``.
        given: Position, m, and direction, of any length, of each place.

    Returns:
        Position and unit direction by name, (2, gdim), None for a base, and this rank's rows of the
        loads, N, of a base N per m/s2, (n_local, m). Held degrees of freedom bear none.

    Raises:
        InputError: If a place has no position and direction in so many coordinates, or is outside
            the mesh.
    """
    gdim = structure.gdim
    found, loads = {}, [np.zeros((structure.n_local, 0))]
    for name, place in (given or {}).items():
        if what == "forces" and _is_base(place):
            direction = _place(gdim, what, name, (np.zeros(gdim), place[1]))[1]
            found[name] = None
            loads.append(base_load(structure, direction)[:, None])
        else:
            found[name] = _place(gdim, what, name, place)
            point, direction = found[name]
            loads.append(structure.loads(Sensors(point[None], direction[None]), what[:-1]))
    return found, np.hstack(loads)


def base_load(structure: Structure, direction: np.ndarray) -> np.ndarray:
    """This rank's rows of the load of a base that accelerates, N per m/s2, (n_local,). Collective.

    Of motion relative to the base: minus the mass times a rigid translation, held places included.

    Args:
        structure: The structure.
        direction: Unit direction, (gdim,).
    """
    values = structure.update(None)
    way = fem.Constant(structure.mesh, np.asarray(direction, dtype=PETSc.ScalarType))
    form = fem.form(structure.inertia_form(way, ufl.TestFunction(structure.V)))
    v = fem_petsc.assemble_vector(form)
    v.ghostUpdate(PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)
    load = structure.free_loads(-v.array_r[: structure.n_local, None])[:, 0]
    v.destroy()
    for mass in structure.masses:
        row = structure.unit_loads(structure.rows(structure.place(mass, values)), direction[None])
        load -= number(mass.mass, values) * mass.share * row[:, 0]
    return load


def _is_base(place) -> bool:
    """Whether a place is a base: a direction without a position."""
    try:
        return len(place) == 2 and place[0] is None
    except TypeError:
        return False


def _place(gdim: int, what: str, name: str, place) -> np.ndarray:
    """Position and unit direction, (2, gdim)."""
    try:
        point, direction = (np.asarray(part, dtype=float)[:gdim] for part in place)
        one = Sensors(point, direction)
    except (IndexError, TypeError, ValueError) as error:
        raise InputError(
            f"{what}[{name!r}] = {place}: expected (position, direction), each of {gdim} "
            f"numbers, the direction not zero."
        ) from error
    if point.shape != (gdim,):
        raise InputError(f"{what}[{name!r}] = {place}: expected {gdim} coordinates, in metres.")
    return np.array([one.points[0], one.directions[0]])


class CellForces:
    """Forces of each single cell, at its own copy of the nodes that it shares with others.

    The sum over a cell of its forces by a motion x, times a motion y, is its part of x^T K y: one
    assembly for each x, whatever the number of y.

    Args:
        structure: Whose cells they are.
    """

    def __init__(self, structure: Structure):
        self._structure, msh = structure, structure.mesh
        apart = basix.ufl.element(
            *structure.element_of, shape=(msh.geometry.dim,), discontinuous=True
        )
        self._space = fem.functionspace(msh, apart)
        self._x, v = fem.Function(structure.V), ufl.TestFunction(self._space)
        self._forms = [
            fem.form(form(self._x, v))
            for form in (structure.stiffness_form, structure.inertia_form)
        ]
        owned = msh.topology.index_map(msh.topology.dim).size_local
        size = self._space.dofmap.index_map_bs
        dofs = self._space.dofmap.list[:owned]
        self._dofs = (size * dofs[:, :, None] + np.arange(size)).reshape(owned, -1)

    def motion(self, shape: PETSc.Vec) -> np.ndarray:
        """A motion at every cell's own nodes, (n_owned_cells, k). Collective.

        Args:
            shape: Displacement vector, owned entries.
        """
        self._put(shape)
        copy = fem.Function(self._space)
        copy.interpolate(self._x)
        return copy.x.array[self._dofs]

    def of(
        self, shape: PETSc.Vec, given: Mapping[str, float] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Each cell's K x and M x, (n_owned_cells, k) both. Collective.

        Args:
            shape: Displacement vector x, owned entries.
            given: Values of parameters that differ from their nominal value.
        """
        self._structure.update(given)
        self._put(shape)
        stiff, inertia = (fem.assemble_vector(form).array[self._dofs] for form in self._forms)
        return stiff, inertia

    def _put(self, shape: PETSc.Vec) -> None:
        self._structure.put_displacement(self._x, shape)

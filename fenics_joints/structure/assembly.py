"""Parts, joints, supports, springs and masses on a mesh, assembled to K(p) and M(p).

Every material property is a field over the cells, so that one compiled form serves all values of
the parameters, and one assembly gives the derivative with respect to all of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import product
from weakref import WeakKeyDictionary

import basix
import basix.ufl
import numpy as np
import scipy.sparse
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from scipy.spatial import cKDTree
from ufl.corealg.traversal import unique_pre_traversal

from fenics_joints._compat import entity_nodes
from fenics_joints.errors import InputError, MeshError, items, real, wanted, whole
from fenics_joints.forms import circumference
from fenics_joints.machine.c_code import form_options
from fenics_joints.meshes.tagged import TaggedMesh, limits
from fenics_joints.structure.changes import (
    Change,
    LocalLoss,
    PlacedPoint,
    PlacedResonator,
    ShapeChange,
    add_changes,
)
from fenics_joints.structure.components import (
    ElasticSupport,
    Parameter,
    PointMass,
    Region,
    Spring,
    Support,
    by_name,
    number,
    parameter_values,
)
from fenics_joints.structure.laws import AXISYMMETRIC_SOLID, ELASTIC_SUPPORT, WIDE_SOLID
from fenics_joints.structure.points import PointRows, locate
from fenics_joints.structure.sparse import MOST, MatrixForm, SummedMatrices
from fenics_joints.structure.ties import Ties

#: Most point masses, and most springs: each is a search for its cell and a block in K or M.
MOST_POINTS = 10_000


def check_components(
    owners: Sequence,
    masses: Sequence[PointMass],
    springs: Sequence[Spring],
    parameters: Mapping[str, Parameter],
) -> None:
    """Refuse names that are given twice, parameters that do not exist, and too many points.

    Args:
        owners: Components with ``properties``: regions, elastic supports, changes.
        masses: Point masses.
        springs: Grounding springs.
        parameters: Parameters that the components may name.

    Raises:
        InputError: Names the component.
    """
    for what, points in (("masses", masses), ("springs", springs)):
        if len(points) > MOST_POINTS:
            raise InputError(
                f"{what}: {len(points)} of them, expected at most {MOST_POINTS}; what is "
                "spread out is a part's density, or an elastic support."
            )
    for name, count in Counter(c.name for c in (*owners, *masses, *springs)).items():
        if count > 1:
            raise InputError(f"component {name} is given twice; expected unique names.")
    for owner, key, value in _values(owners, masses, springs):
        if isinstance(value, str) and value not in parameters:
            raise InputError(
                f"{owner}.{key} names the parameter {value!r}, which does not exist; "
                f"expected a number or one of: {', '.join(parameters) or 'none'}."
            )


def _values(owners, masses, springs) -> Iterator[tuple[str, str, float | str]]:
    for owner in owners:
        for key, value in owner.properties.items():
            yield owner.name, key, value
    for mass in masses:
        yield mass.name, "mass", mass.mass
        yield mass.name, "travel", mass.travel
    for spring in springs:
        yield spring.name, "stiffness", spring.stiffness


def axisymmetric_regions(tagged: TaggedMesh, regions: Sequence[Region]) -> tuple[Region, ...]:
    """Parts with their law in a body of revolution.

    Raises:
        InputError: If one has none there.
        MeshError: If the mesh is no half section.
    """
    low, high = limits(tagged)
    if tagged.mesh.geometry.dim != 2 or low[0] < -1e-9 * np.max(high - low):
        raise MeshError("axisymmetric: expected a mesh in the plane with r = x[0] >= 0 everywhere.")
    for region in regions:
        if region.is_joint:
            raise InputError(
                f"{region.name}: a thin layer is not available in an axisymmetric structure; "
                "expected parts only."
            )
        if region.law is WIDE_SOLID:
            raise InputError(
                f"{region.name}: a width is not available in an axisymmetric structure."
            )
        if region.properties["stretch"] != 1.0 and abs(region.normal[1]) != 1.0:
            raise InputError(
                f"{region.name}.normal = {list(region.normal)}: expected the axis, (0, 1), for "
                "the stretch of a part in an axisymmetric structure."
            )
    return tuple(replace(r, law=AXISYMMETRIC_SOLID) for r in regions)


def region_cells(tagged: TaggedMesh, regions: Sequence[Region]) -> list[tuple[Region, np.ndarray]]:
    """Local cells, ghosts included, of each region. Collective.

    Raises:
        MeshError: If a cell is in no region or in two.
    """
    imap = tagged.mesh.topology.index_map(tagged.mesh.topology.dim)
    count = np.zeros(imap.size_local + imap.num_ghosts, dtype=np.int32)
    found = []
    for region in regions:
        tags = [tagged.cell_tag(name) for name in region.cells]
        cells = np.sort(np.concatenate([tagged.cell_tags.find(t) for t in tags]))
        count[cells] += 1
        found.append((region, cells))
    bad = tagged.mesh.comm.allreduce(int(np.sum(count[: imap.size_local] != 1)))
    if bad:
        used = [name for region in regions for name in region.cells]
        names = tagged.cell_names
        wrong = [name for name in names if used.count(name) != 1]
        raise MeshError(
            f"{bad} cells are in no region or in more than one: "
            f"{', '.join(wrong) or 'untagged'}; expected every cell group "
            f"({', '.join(names)}) in exactly one part or joint."
        )
    return found


#: Difference to 1 of the length of a normal that is a function: round-off.
_UNIT = 1e-6
#: Vertices as near to a point as the nearest one, up to this share of the mesh's extent, are at it:
#: bodies that touch without sharing vertices have one each.
_SAME = 1e-9


def held_entities(tagged: TaggedMesh, support: Support) -> list[tuple[int, np.ndarray]]:
    """Dimension and this rank's entities, of each dimension that the support holds. Collective.

    Raises:
        MeshError: If the mesh has no such group, or no vertex near a point.
    """
    mesh = tagged.mesh
    if support.facets:
        facets = tagged.facet_tags.find(tagged.facet_tag(support.facets))
        return [(mesh.topology.dim - 1, facets)]
    vertices = _vertices(tagged, *_points(tagged, support))
    if mesh.topology.dim == 1:
        return [(0, vertices)]
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(0, 1)
    mesh.topology.create_connectivity(1, 0)
    mesh.topology.create_connectivity(1, mesh.topology.dim)
    ends = mesh.topology.connectivity(1, 0).array.reshape(-1, 2)
    edges = np.flatnonzero(np.isin(ends, vertices).all(axis=1)).astype(np.int32)
    return [(0, vertices), (1, edges)]


def held_nodes(tagged: TaggedMesh, support: Support) -> np.ndarray:
    """This rank's geometry nodes that a support holds. Collective."""
    found = [
        entity_nodes(tagged.mesh, dim, entities).ravel()
        for dim, entities in held_entities(tagged, support)
    ]
    return np.unique(np.concatenate(found)).astype(np.int32)


def _points(tagged: TaggedMesh, support: Support) -> tuple[str, np.ndarray]:
    gdim = tagged.mesh.geometry.dim
    if isinstance(support.points, str):
        return f"points {support.points!r}", tagged.named_points(support.points)[:, :gdim]
    x = np.atleast_2d(np.asarray(support.points, dtype=float))
    if x.shape[1] < gdim:
        raise MeshError(f"support.points of {x.shape[1]} coordinates: expected {gdim}.")
    return "support.points", x[:, :gdim]


def _vertices(tagged: TaggedMesh, name: str, points: np.ndarray) -> np.ndarray:
    """This rank's vertices nearest to each point, but for those that ties govern."""
    mesh = tagged.mesh
    gdim, comm = mesh.geometry.dim, mesh.comm
    mesh.topology.create_connectivity(0, mesh.topology.dim)
    count = mesh.topology.index_map(0)
    vertices = np.arange(count.size_local + count.num_ghosts, dtype=np.int32)
    for tie in tagged.ties:
        facets = tagged.facet_tags.find(tagged.facet_tag(tie.face))
        mesh.topology.create_connectivity(mesh.topology.dim - 1, 0)
        of_facet = mesh.topology.connectivity(mesh.topology.dim - 1, 0)
        tied = [of_facet.links(facet) for facet in facets]
        vertices = np.setdiff1d(vertices, np.concatenate([np.empty(0, np.int32), *tied]))
    x = mesh.geometry.x[entity_nodes(mesh, 0, vertices).ravel()][:, :gdim]
    tree = cKDTree(x) if len(x) else None
    near = np.full(len(points), np.inf) if tree is None else tree.query(points)[0]
    comm.Allreduce(MPI.IN_PLACE, near, op=MPI.MIN)
    cells = mesh.topology.index_map(mesh.topology.dim).size_local
    sizes = mesh.h(mesh.topology.dim, np.arange(cells, dtype=np.int32))
    reach = 0.5 * comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
    if near.max(initial=0.0) > reach:
        worst = int(np.argmax(near))
        raise MeshError(
            f"{name}: {points[worst].tolist()} m is {near[worst]:.3g} m from the nearest vertex; "
            f"expected one within half a cell, {reach:.3g} m."
        )
    if tree is None:
        return vertices
    slack = _SAME * comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX)
    found = tree.query_ball_point(points, near + slack)
    return vertices[np.unique(np.concatenate([np.empty(0, int), *found])).astype(np.int32)]


class PropertyField:
    """Property slots of every cell.

    Args:
        mesh: Mesh.
        regions: Each region with its local cells, ghosts included.
        parameters: Parameters by name.

    Attributes:
        q: The field, a DG-0 function of shape (n_slots,).
        space: Its space.
    """

    def __init__(self, mesh, regions, parameters: Mapping[str, Parameter]):
        self.mesh, self.regions, self.parameters = mesh, list(regions), parameters
        self.slots = max(len(region.law.properties) for region, _ in self.regions)
        cell = mesh.topology.cell_name()
        self.space = fem.functionspace(mesh, basix.ufl.element("DG", cell, 0, shape=(self.slots,)))
        self.q = fem.Function(self.space)
        # A slot that a law leaves out must not hold zero: 1/stretch is taken of it elsewhere.
        self.q.x.array[:] = 1.0
        self._dof = self.space.dofmap.list[:, 0]
        self._symbols = {
            name: ufl.variable(fem.Constant(mesh, float(p.value))) for name, p in parameters.items()
        }
        self._expressions: dict[tuple, fem.Expression | float] = {}
        self._named: dict[tuple[int, str], list[str]] = {}

    def update(self, values: Mapping[str, float]) -> None:
        """Fill the field from the parameters' values.

        Raises:
            InputError: If a property is out of its law's range; on every rank.
        """
        self._set_symbols(values)
        table = self.q.x.array.reshape(-1, self.slots)
        for i, (region, cells) in enumerate(self.regions):
            q = {}
            for slot, key in enumerate(region.law.properties):
                q[key] = self._value(i, region, cells, key, values)
                table[self._dof[cells], slot] = q[key]
            self._check(region, q)

    def fill(self, number: int, q: Mapping[str, float]) -> None:
        """Put property values into a region's cells, unchecked."""
        region, cells = self.regions[number]
        table = self.q.x.array.reshape(-1, self.slots)
        for slot, key in enumerate(region.law.properties):
            table[self._dof[cells], slot] = q[key]

    def region_values(self, number: int, values: Mapping[str, float]) -> dict | None:
        """Property values of a region that are the same in all its cells; None if one varies."""
        region, _ = self.regions[number]
        if any(callable(region.properties[key]) for key in region.law.properties):
            return None
        return {
            key: self._value(number, region, None, key, values) for key in region.law.properties
        }

    def slopes(
        self, number: int, parameter: str, values: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of a region's properties by one parameter.

        Returns:
            This rank's cells of the region, ghosts included, (n,), and the derivatives, (n,
            n_slots).
        """
        region, cells = self.regions[number]
        found = np.zeros((len(cells), self.slots))
        for slot, key in enumerate(region.law.properties):
            prop = region.properties[key]
            if callable(prop) and parameter in self.named(number, key):
                self._set_symbols(values)
                found[:, slot] = self._evaluate(number, region, key, cells, parameter)
            elif prop == parameter:
                found[:, slot] = 1.0
        return cells, found

    def means(self, number: int) -> dict[str, float]:
        """Mean over a region's cells of each property, as last updated. Collective."""
        region, cells = self.regions[number]
        cells = cells[cells < self.mesh.topology.index_map(self.mesh.topology.dim).size_local]
        rows = self.q.x.array.reshape(-1, self.slots)[self._dof[cells]]
        total = self.mesh.comm.allreduce(np.append(rows.sum(axis=0), len(cells)))
        return dict(zip(region.law.properties, total[:-1] / max(total[-1], 1), strict=False))

    def put(self, function: fem.Function, cells: np.ndarray, table: np.ndarray) -> None:
        """Put rows of all slots, (n, n_slots), into cells of a function over `space`."""
        function.x.array.reshape(-1, self.slots)[self._dof[cells]] = table

    def _check(self, region: Region, q) -> None:
        message = None
        try:
            if all(np.size(value) for value in q.values()):
                region.law.check(region.name, q)
        except InputError as error:
            message = str(error)
        # One rank's cells may be bad alone: all must raise, or the others wait for ever.
        if any(callable(region.properties[key]) for key in region.law.properties):
            messages = [m for m in self.mesh.comm.allgather(message) if m]
            message = messages[0] if messages else None
        if message:
            raise InputError(message)

    def _set_symbols(self, values: Mapping[str, float]) -> None:
        for name, symbol in self._symbols.items():
            symbol.ufl_operands[0].value = values[name]

    def _value(self, number, region, cells, key, values):
        prop = region.properties[key]
        if callable(prop):
            return self._evaluate(number, region, key, cells, None)
        return values[prop] if isinstance(prop, str) else float(prop)

    def _evaluate(self, number, region, key, cells, parameter):
        """A property of position, or its derivative by a parameter, at the cells' middles."""
        place = (number, key, parameter)
        if place not in self._expressions:
            x = ufl.SpatialCoordinate(self.mesh)
            expr = region.properties[key](x, self._symbols)
            if parameter is not None:
                expr = ufl.diff(expr, self._symbols[parameter])
                expr = ufl.algorithms.apply_derivatives.apply_derivatives(
                    ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(expr)
                )
            self._expressions[place] = (
                float(expr) if _is_number(expr) else fem.Expression(expr, self.middle())
            )
        expression = self._expressions[place]
        if isinstance(expression, float):
            return np.full(len(cells), expression)
        return expression.eval(self.mesh, cells).reshape(len(cells))

    def middle(self) -> np.ndarray:
        """Middle of the reference cell, (1, tdim)."""
        cell = getattr(basix.CellType, self.mesh.topology.cell_name())
        return basix.geometry(cell).mean(axis=0, keepdims=True)

    def by_cell(self, array: np.ndarray) -> np.ndarray:
        """Rows of a vector over the space for the owned cells, shape (n_owned, n_slots)."""
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        return array.reshape(-1, self.slots)[self._dof[:owned]]

    def named(self, number: int, key: str) -> list[str]:
        """Parameters on which a property of a region depends."""
        prop = self.regions[number][0].properties[key]
        if not callable(prop):
            return [prop] if isinstance(prop, str) else []
        if (number, key) not in self._named:
            expr = prop(ufl.SpatialCoordinate(self.mesh), self._symbols)
            held = set() if _is_number(expr) else set(unique_pre_traversal(ufl.as_ufl(expr)))
            names = [name for name, symbol in self._symbols.items() if symbol in held]
            self._named[number, key] = names
        return self._named[number, key]

    def contract(self, cell_gradient: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Chain rule from the cells' properties to the parameters. Collective.

        Args:
            cell_gradient: Derivatives of k functions by every property of every owned cell,
                (n_owned, n_slots, k).
            values: All parameters' values.

        Returns:
            Derivatives by every parameter, shape (k, n_parameters), equal on all ranks.
        """
        self._set_symbols(values)
        position = {name: i for i, name in enumerate(self.parameters)}
        gradient = np.zeros((len(position), cell_gradient.shape[2]))
        for i, (region, cells) in enumerate(self.regions):
            cells = cells[cells < len(cell_gradient)]
            for slot, key in enumerate(region.law.properties):
                for name in self.named(i, key):
                    by_cell = cell_gradient[cells, slot]
                    if callable(region.properties[key]):
                        by_cell = by_cell * self._evaluate(i, region, key, cells, name)[:, None]
                    gradient[position[name]] += by_cell.sum(axis=0)
        self.mesh.comm.Allreduce(MPI.IN_PLACE, gradient)
        return gradient.T


def _is_number(expr) -> bool:
    """Whether UFL simplified an expression to a number, as the derivative of a linear one."""
    return isinstance(expr, ufl.constantvalue.Zero | ufl.constantvalue.ScalarValue)


def _way(region: Region) -> tuple:
    """What regions that are one integral have in common."""
    return region.law, region.normal, region.across


_SERENDIPITY_CELLS = ("quadrilateral", "hexahedron")


class Assembly:
    """Matrices of parts, joints, supports, springs and masses as functions of named parameters.

    A mesh in space is a solid. One in the plane is a section in plane strain, and all matrices,
    masses and volumes are those of one metre of depth; or, with ``axisymmetric``, the half section
    r = x[0] >= 0, z = x[1] of a body of revolution, and they are those of the whole body. Springs
    and point masses are then spread over their circle. A body that reaches the axis needs u_r = 0
    there: ``Support(facets, (0,))``.

    Args:
        tagged: Mesh with named groups of cells and facets.
        regions: Parts and joints; together they cover every cell once.
        parameters: The parameters that the components name.
        masses: Point masses.
        springs: Grounding springs.
        supports: Held facets, and ones on springs that are spread over them.
        changes: Further changes by parameters: `fenics_joints.structure.changes`.
        degree: Degree of the displacement, 1 to 3; on quadrilaterals and hexahedra degrees 2 and 3
            are the serendipity elements.
        quadrature_degree: Degree of the cell quadrature; 2 * degree by default, which is exact for
            straight-sided boxes and simplices; one more for a body of revolution.
        axisymmetric: Whether the mesh is the half section of a body of revolution, of parts only.

    Raises:
        InputError: For a name that does not exist or a value out of range.
        MeshError: If a cell is in no region or in two, or the mesh is no half section.

    Attributes:
        V: Displacement space.
        parameters: The parameters by name, in order.
        axisymmetric: Whether the mesh is the half section of a body of revolution.
        weight: Factor of every integral: 2 pi r as UFL, m, in a body of revolution, else 1.
    """

    def __init__(
        self,
        tagged: TaggedMesh,
        regions: Iterable[Region],
        parameters: Iterable[Parameter] = (),
        *,
        masses: Iterable[PointMass] = (),
        springs: Iterable[Spring] = (),
        supports: Iterable[Support | ElasticSupport] = (),
        changes: Iterable[Change] = (),
        degree: int = 2,
        quadrature_degree: int | None = None,
        axisymmetric: bool = False,
    ):
        if not isinstance(tagged, TaggedMesh):
            raise wanted("tagged", tagged, "a TaggedMesh, as the builders of meshes give it")
        self.tagged = tagged
        self.mesh = tagged.mesh
        self.comm = tagged.mesh.comm
        self.parameters = by_name(items("parameters", parameters, Parameter, "Parameter"))
        self.regions = items("regions", regions, Region, "part, joint, transition")
        self.masses = items("masses", masses, PointMass, "PointMass")
        self.springs = items("springs", springs, Spring, "Spring")
        supports = items("supports", supports, (Support, ElasticSupport), "Support, ElasticSupport")
        kinds = LocalLoss, PlacedPoint, PlacedResonator, ShapeChange
        self.changes = items("changes", changes, kinds, "changes")
        self._made_of = {
            "regions": self.regions,
            "masses": self.masses,
            "springs": self.springs,
            "supports": supports,
            "changes": self.changes,
            "axisymmetric": axisymmetric,
        }
        self.supports = tuple(s for s in supports if isinstance(s, Support))
        self.elastic_supports = tuple(s for s in supports if isinstance(s, ElasticSupport))
        check_components(
            (*self.regions, *self.elastic_supports, *self.changes),
            self.masses,
            self.springs,
            self.parameters,
        )
        self.axisymmetric, self.weight = axisymmetric, 1.0
        if axisymmetric:
            self.regions = axisymmetric_regions(tagged, self.regions)
            self.weight = circumference(ufl.SpatialCoordinate(self.mesh)[0])
        self.degree = degree = whole("degree", degree, 1, 3)
        exact = 2 * degree + bool(axisymmetric)
        self.quadrature_degree = (
            exact
            if quadrature_degree is None
            else whole("quadrature_degree", quadrature_degree, 0, 30)
        )
        self._make_spaces(degree)
        self.field = PropertyField(self.mesh, region_cells(tagged, self.regions), self.parameters)
        #: Share of each cell that counts, of degree 0; None if all do (`TaggedMesh.shares`).
        self.share: fem.Function | None = None
        if tagged.shares is not None:
            self.share = fem.Function(fem.functionspace(self.mesh, ("DG", 0)))
            self.share.x.array[self.share.function_space.dofmap.list[:, 0]] = tagged.shares
        self._check_normals()
        self.bcs = self._dirichlet()
        #: Faces of the mesh that follow others, None if there are none.
        self.ties = Ties(self, self._supported()[: self.n_local]) if tagged.ties else None
        self._forms: dict[object, fem.Form] = {}
        self._slopes: dict[object, tuple] = {}
        self._direction: fem.Function | None = None
        self._rows: dict[bytes, PointRows] = {}
        self._region_matrices: dict[tuple[int, int], PETSc.Mat] = {}
        self._summed = SummedMatrices(self)
        self._support_matrices: dict[int, tuple[PETSc.Mat, PETSc.Mat]] = {}
        self._change_matrices: WeakKeyDictionary[object, dict] = WeakKeyDictionary()

    # -- set-up ------------------------------------------------------------------------------

    def _make_spaces(self, degree: int) -> None:
        cell = self.mesh.topology.cell_name()
        family = "S" if degree > 1 and cell in _SERENDIPITY_CELLS else "Lagrange"
        #: Family, cell and degree of the displacements.
        self.element_of = family, cell, degree
        self.element = basix.ufl.element(*self.element_of)
        gdim = self.mesh.geometry.dim
        self.V = fem.functionspace(self.mesh, basix.ufl.element(*self.element_of, shape=(gdim,)))

    def _check_normals(self) -> None:
        for i, (region, cells) in enumerate(self.field.regions):
            if callable(region.normal):
                lengths = np.linalg.norm(self.normals(i, cells), axis=1)
                off = float(np.abs(lengths - 1).max(initial=0.0))
                if self.comm.allreduce(off, op=MPI.MAX) > _UNIT:
                    raise InputError(f"{region.name}.normal: expected a function of unit vectors.")

    def _dirichlet(self) -> list:
        bcs, gdim = [], self.mesh.geometry.dim
        for support in self.supports:
            held = held_entities(self.tagged, support)
            for i, (dim, entities) in product((d for d in support.directions if d < gdim), held):
                # A function, as serendipity elements take no constant.
                W, _ = self.V.sub(i).collapse()
                dofs = fem.locate_dofs_topological((self.V.sub(i), W), dim, entities)
                bcs.append(fem.dirichletbc(fem.Function(W), dofs, self.V.sub(i)))
        return bcs

    def exchange(self, changes: Iterable[Change]) -> None:
        """Put changes in the place of those of the same names, which take the same parameters.

        Args:
            changes: As a `PlacedPoint` elsewhere.
        """
        new = {change.name: change for change in changes}
        self.changes = tuple(new.get(c.name, c) for c in self.changes)
        self._made_of["changes"] = self.changes

    # -- forms -------------------------------------------------------------------------------

    def _measure(self, kind: str, data, tags) -> ufl.Measure:
        metadata = {"quadrature_degree": self.quadrature_degree}
        return ufl.Measure(kind, self.mesh, subdomain_data=data, metadata=metadata)(tags)

    def stiffness_form(self, u, v) -> ufl.Form:
        """Stiffness of all parts and joints, as UFL over the property field."""
        return self._sum(0, u, v)

    def inertia_form(self, u, v) -> ufl.Form:
        """Consistent mass of all parts and joints, as UFL over the property field."""
        return self._sum(1, u, v)

    def _sum(self, which: int, u, v) -> ufl.Form:
        """Regions that share a law and its directions are one integral."""
        forms = [
            self._form(which, region, u, v, self._measure("dx", self._alike, tag))
            for tag, region in enumerate(self._laws)
        ]
        return sum(forms[1:], forms[0])

    @cached_property
    def _laws(self) -> list[Region]:
        """A region of each law with its directions."""
        return list({_way(region): region for region in self.regions}.values())

    @cached_property
    def _alike(self) -> list[tuple[int, np.ndarray]]:
        """This rank's cells of each: the compiled form does not depend on the regions."""
        cells: dict[tuple, list[np.ndarray]] = {_way(region): [] for region in self._laws}
        for region, own in self.field.regions:
            cells[_way(region)].append(own)
        return list(enumerate(map(self._owned, map(np.concatenate, cells.values()))))

    def slope_form(self, which: int, direction: fem.Function, cells: np.ndarray) -> fem.Form:
        """Derivative of the stiffness (0) or the mass (1) along a change of the property field,
        over some cells of this rank: one compiled form for all of them."""
        key = "slope", which, direction
        if key not in self._slopes:
            whole = ufl.derivative(self._sum(which, *self.arguments), self.field.q, direction)
            form = ufl.algorithms.expand_derivatives(whole)
            compiled = fem.compile_form(self.comm, form, jit_options=form_options())
            self._slopes[key] = form, compiled
        form, compiled = self._slopes[key]
        data = [(tag, np.intersect1d(own, cells)) for tag, own in self._alike]
        return fem.create_form(
            compiled,
            [self.V, self.V],
            self.mesh,
            {fem.IntegralType.cell: data},
            {c: c for c in form.coefficients()},
            {c: c for c in form.constants()},
        )

    def nodes_of(self, cells: Sequence[np.ndarray]) -> scipy.sparse.csr_array:
        """Which nodes of this rank belong to cells of each set of cells, of whichever rank.
        Collective.

        Args:
            cells: This rank's cells of each set.

        Returns:
            Ones, (len(cells), n_owned_nodes).
        """
        imap, pairs = self.V.dofmap.index_map, [np.empty((2, 0), dtype=np.int32)]
        for i, some in enumerate(cells):
            nodes = np.unique(self.V.dofmap.list[self._owned(some)])
            pairs.append(np.stack([np.full(len(nodes), i), nodes]))
        of, node = np.hstack(pairs)
        away = node >= imap.size_local
        told = of[away], imap.local_to_global(node[away].astype(np.int32))
        first, last = imap.local_range
        sets, nodes = [of[~away]], [node[~away]]
        for others, at in self.comm.allgather(told):
            mine = (at >= first) & (at < last)
            sets.append(others[mine]), nodes.append(at[mine] - first)
        at = np.concatenate(sets), np.concatenate(nodes)
        found = scipy.sparse.coo_array(
            (np.ones(len(at[0])), at), shape=(len(cells), imap.size_local)
        ).tocsr()
        found.data[:] = 1.0
        return found

    def _owned(self, cells: np.ndarray) -> np.ndarray:
        """Those of some cells that this rank owns, ascending."""
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        return np.sort(cells[cells < owned]).astype(np.int32)

    def _form(self, which: int, region: Region, u, v, dx) -> ufl.Form:
        """Stiffness (0) or mass (1) by a region's law and directions."""
        form = self._law_form(which, region, u, v, dx)
        if self.share is None or not region.is_joint:
            return form
        return ufl.Form([i.reconstruct(self.share * i.integrand()) for i in form.integrals()])

    def _law_form(self, which: int, region: Region, u, v, dx) -> ufl.Form:
        law = region.law
        q = {name: self.field.q[i] for i, name in enumerate(law.properties)}
        if which:
            return law.inertia(u, v, q, dx)
        ways = {"normal": region.normal, "across": region.across}
        ways = {
            key: way(ufl.SpatialCoordinate(self.mesh))
            if callable(way)
            else ufl.as_vector([float(c) for c in way[: self.gdim]])
            for key, way in ways.items()
            if way is not None
        }
        return law.stiffness(u, v, q, ways.pop("normal"), dx, **ways)

    def normals(self, number: int, cells: np.ndarray) -> np.ndarray:
        """Unit normals of a region at the middles of some of its cells, (n_cells, gdim)."""
        normal = self.regions[number].normal
        if not callable(normal):
            return np.tile(np.asarray(normal[: self.gdim], dtype=float), (len(cells), 1))
        expression = fem.Expression(normal(ufl.SpatialCoordinate(self.mesh)), self.field.middle())
        return expression.eval(self.mesh, cells).reshape(len(cells), self.gdim)

    def compiled(self, key, make: Callable[[], ufl.Form]) -> fem.Form:
        """A compiled form, kept under a key."""
        if key not in self._forms:
            self._forms[key] = fem.form(make(), jit_options=form_options())
        return self._forms[key]

    @property
    def arguments(self) -> tuple:
        """Trial and test function."""
        return ufl.TrialFunction(self.V), ufl.TestFunction(self.V)

    def compiled_region(self, number: int, which: int) -> fem.Form:
        """`region_form`, compiled."""
        return self.compiled((number, which), lambda: self.region_form(number, which))

    def region_form(self, number: int, which: int) -> ufl.Form:
        """Stiffness (0) or mass (1) of one region alone, as UFL over the property field.

        The cells are data of the form: regions with one law and normal share compiled code.

        Args:
            number: Index of the region in `regions`.
            which: 0 or 1.
        """
        return self.cells_form(number, which, self.field.regions[number][1])

    def cells_form(self, number: int, which: int, cells: np.ndarray) -> ufl.Form:
        """`region_form` of some of the region's cells, as numbered on this rank."""
        region, dx = self.field.regions[number][0], self.cells_measure(cells)
        return self._form(which, region, *self.arguments, dx)

    def cells_measure(self, cells: np.ndarray) -> ufl.Measure:
        """Integration over some cells of this rank, ghosts left out."""
        return self._measure("dx", [(1, self._owned(cells))], 1)

    def region_matrix(self, number: int, which: int, q: Mapping[str, float] | None) -> PETSc.Mat:
        """Stiffness (0) or mass (1) of one region alone; rows and columns of held DOFs are zero.

        Args:
            number: Index of the region in `regions`.
            which: 0 or 1.
            q: Property values to put into its cells, unchecked; None leaves the field as it is.

        Returns:
            A matrix that the next call with the same ``number`` and ``which`` overwrites.
        """
        if q is not None:
            self.field.fill(number, q)
        key = number, which
        before = self._region_matrices.get(key)
        self._region_matrices[key] = self.assembled(self.compiled_region(*key), before)
        return self._region_matrices[key]

    def law_matrix(self, number: int, which: int, sample: int) -> PETSc.Mat:
        """A region's stiffness (0) or mass (1) at a sample of its law, the caller's to destroy.

        Its entries are kept, for bases that grow and for `stiffness` and `mass`.

        Args:
            number: Index of the region in `regions`.
            which: 0 or 1.
            sample: Index in the law's ``samples``.
        """
        return self._summed.laws[number].matrix(which, sample)

    def law_terms(self, number: int) -> Iterator[PETSc.Mat] | None:
        """A region's stiffness before each of its law's scalars, the caller's to destroy; None
        until `assemble_samples`, or for a large structure. Collective."""
        return self._summed.laws[number].terms()

    def assemble_samples(self) -> None:
        """Let `stiffness` and `mass` be the same to the last bit whatever is asked for in between.
        Collective."""
        self._summed.assemble_samples()

    def kept_form(self, change: object, key: object, make: Callable[[], PETSc.Mat]) -> MatrixForm:
        """A matrix of a change, made once, or for a large structure each time. Collective."""
        if self.n_dofs > MOST:
            return MatrixForm(make(), True)
        kept = self._change_matrices.setdefault(change, {})
        if key not in kept:
            kept[key] = make()
        return MatrixForm(kept[key])

    def support_matrices(self, number: int) -> tuple[PETSc.Mat, PETSc.Mat]:
        """Stiffness of an elastic support at k_n = 1 Pa/m and at k_t = 1 Pa/m, m2; kept.

        Rows and columns of held DOFs are zero.

        Args:
            number: Index of the support in `elastic_supports`.

        Raises:
            MeshError: If its facets are not there, or not on the surface.
        """
        if number not in self._support_matrices:
            support = self.elastic_supports[number]
            if support.facets in [tie.face for tie in self.tagged.ties]:
                raise MeshError(
                    f"{support.name}.facets = {support.facets!r}: is tied to a part; expected the "
                    "part's face."
                )
            tag = self.tagged.facet_tag(support.facets)
            ds = self._measure("ds", self.tagged.facet_tags, tag)
            area = fem.assemble_scalar(fem.form(fem.Constant(self.mesh, 1.0) * ds))
            if not self.comm.allreduce(area) > 0:
                raise MeshError(
                    f"{support.name}.facets = {support.facets!r}: expected facets on the surface."
                )
            self._support_matrices[number] = tuple(
                self._support_matrix(q, ds) for q in ELASTIC_SUPPORT.samples
            )
        return self._support_matrices[number]

    def _support_matrix(self, q: Mapping[str, float], ds) -> PETSc.Mat:
        # As constants, both unit stiffnesses are one compiled form.
        q = {key: fem.Constant(self.mesh, value) for key, value in q.items()}
        normal = ufl.FacetNormal(self.mesh)
        form = fem.form(self.weight * ELASTIC_SUPPORT.stiffness(*self.arguments, q, normal, ds))
        return self.assembled(form)

    def _add_supports(self, K: PETSc.Mat, values: Mapping[str, float]) -> None:
        for i, support in enumerate(self.elastic_supports):
            q = {key: number(value, values) for key, value in support.properties.items()}
            ELASTIC_SUPPORT.check(support.name, q)
            for k, unit in zip(q.values(), self.support_matrices(i), strict=True):
                K.axpy(k, unit, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)

    # -- matrices ----------------------------------------------------------------------------

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters' values: the nominal ones, with ``given`` put in.

        Raises:
            InputError: If ``given`` names an unknown parameter or has a value that is not finite.
        """
        return parameter_values(self.parameters, given)

    def stiffness(self, given: Mapping[str, float] | None = None, out=None) -> PETSc.Mat:
        """Stiffness matrix K(p), N/m, symmetric; rows of held DOFs are the identity's.

        Args:
            given: Values of parameters that differ from their nominal value.
            out: A matrix from an earlier call, to assemble into.
        """
        values = self.update(given)
        K = self._of_regions(0, values, out)
        for spring in self.springs:
            k = real(f"{spring.name}.stiffness", number(spring.stiffness, values), "N/m", least=0)
            k *= spring.share
            self.add_point(K, spring.point, k * np.outer(spring.direction, spring.direction))
        self._add_supports(K, values)
        K.assemble()
        add_changes(self, K, 0, values)
        return K

    def mass(self, given: Mapping[str, float] | None = None, out=None) -> PETSc.Mat:
        """Mass matrix M(p), kg, positive semi-definite; rows of held DOFs are zero."""
        values = self.update(given)
        M = self._of_regions(1, values, out)
        for mass in self.masses:
            m = real(f"{mass.name}.mass", number(mass.mass, values), "kg", least=0) * mass.share
            if m:
                self.add_point(M, self.place(mass, values), m * np.eye(3))
        M.assemble()
        add_changes(self, M, 1, values)
        return M

    def _of_regions(self, which: int, values: Mapping[str, float], out=None) -> PETSc.Mat:
        """Stiffness (0) or mass (1) of parts and joints: summed, or assembled."""
        found = self._summed.matrix(which, values) if out is None else None
        if found is None:
            make = self.inertia_form if which else self.stiffness_form
            form = self.compiled("KM"[which], lambda: make(*self.arguments))
            found = self.assembled(form, out, 0.0 if which else 1.0)
            self._summed.learn(found)
        return found

    def update(self, given: Mapping[str, float] | None) -> dict[str, float]:
        """Put parameters' values into the property field; returns all of them."""
        values = self.values(given)
        self.field.update(values)
        return values

    def assembled(self, form: fem.Form, out=None, diagonal: float = 0.0) -> PETSc.Mat:
        """A symmetric form as a matrix; rows and columns of held DOFs have the diagonal alone."""
        if self.ties is not None:
            return self._tied(form, out, diagonal)
        if out is None:
            out = fem_petsc.create_matrix(form)
            out.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            out.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
            out.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        else:
            out.zeroEntries()
        # The name of the fourth argument changed in 0.10.
        fem_petsc.assemble_matrix(out, form, self.bcs, diagonal)
        out.assemble()
        return out

    def _tied(self, form: fem.Form, out, diagonal: float) -> PETSc.Mat:
        whole = fem_petsc.create_matrix(form)
        fem_petsc.assemble_matrix(whole, form)
        whole.assemble()
        found = self.ties.matrix(whole, self.held_dofs[: self.n_local], diagonal)
        for option in ("SYMMETRIC", "SYMMETRY_ETERNAL"):
            found.setOption(getattr(PETSc.Mat.Option, option), True)
        if out is None:
            return found
        out.zeroEntries()
        out.axpy(1.0, found, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        found.destroy()
        return out

    def place(self, mass: PointMass, values) -> tuple:
        """Where a point mass is."""
        travel = number(mass.travel, values)
        return tuple(np.asarray(mass.point) + travel * np.asarray(mass.direction))

    def rows(self, points, what: str = "point", names: Sequence[str] = ()) -> PointRows:
        """Rows that evaluate the displacement at points; cached. Collective.

        Points of a test, whose ``what`` is given, are moved onto the mesh if they are near it.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))[:, : self.mesh.geometry.dim]
        key, snap = points.tobytes(), what != "point" or self.ties is not None
        if key not in self._rows:
            # What stands on a tied face is on one of the parts, not on the layer.
            cells = None if self.ties is None else self.ties.outside
            self._rows[key] = locate(
                self.V, self.element, points, what, names=names, snap=snap, cells=cells
            )
        return self._rows[key]

    def add_point(self, A: PETSc.Mat, point, block: np.ndarray) -> None:
        """Put a block, (3, 3), between the displacements at a point, in place. Collective."""
        gdim = self.gdim
        if self.ties is not None:
            place = np.atleast_2d(np.asarray(point, dtype=float))[:, :gdim]
            rows = self.unit_loads(self.rows(np.repeat(place, gdim, axis=0)), np.eye(gdim))
            return self._add_rows(A, rows, block[:gdim, :gdim])
        rows = self.rows(point)
        for nodes, N in zip(rows.nodes, rows.values, strict=True):
            dofs = (nodes[:, None] * gdim + np.arange(gdim)).ravel().astype(np.int32)
            values = np.kron(np.outer(N, N), block[:gdim, :gdim])
            free = ~self.held_dofs[dofs]
            values = values * np.outer(free, free)
            A.setValuesLocal(dofs, dofs, values, PETSc.InsertMode.ADD_VALUES)
        A.assemble()

    def _add_rows(self, A: PETSc.Mat, rows: np.ndarray, block: np.ndarray) -> None:
        """Add rows block rows^T, of this rank's rows, (n_local, gdim), in place. Collective."""
        at = np.flatnonzero(rows.any(axis=1))
        mine = (at + A.getOwnershipRange()[0]).astype(PETSc.IntType)
        columns, values = (np.concatenate(self.comm.allgather(part)) for part in (mine, rows[at]))
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        A.setValues(mine, columns, rows[at] @ block @ values.T, PETSc.InsertMode.ADD_VALUES)
        A.assemble()

    @cached_property
    def held_dofs(self) -> np.ndarray:
        """Which DOFs of this rank supports hold or ties govern, then which ghosts,
        (n_local + n_ghosts,)."""
        held = self._supported()
        if self.ties is not None:
            tied = fem.Function(self.V)
            tied.x.array[: self.n_local] = self.ties.tied
            tied.x.scatter_forward()
            held |= tied.x.array != 0.0
        return held

    def _supported(self) -> np.ndarray:
        """Which DOFs supports hold, as `held_dofs`."""
        imap, bs = self.V.dofmap.index_map, self.V.dofmap.index_map_bs
        held = np.zeros((imap.size_local + imap.num_ghosts) * bs, dtype=bool)
        for bc in self.bcs:
            held[bc.dof_indices()[0]] = True
        return held

    @property
    def n_local(self) -> int:
        """Number of displacement DOFs that this rank owns."""
        return self.V.dofmap.index_map.size_local * self.V.dofmap.index_map_bs

    @property
    def n_dofs(self) -> int:
        """Number of displacement DOFs, held ones included."""
        return self.V.dofmap.index_map.size_global * self.V.dofmap.index_map_bs

    @property
    def gdim(self) -> int:
        """Geometric dimension of the mesh."""
        return self.mesh.geometry.dim

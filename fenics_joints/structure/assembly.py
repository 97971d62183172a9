"""Parts, joints, supports, springs and masses on a mesh, assembled to K(p) and M(p).

Every material property is a field over the cells, so that one compiled form serves all values of
the parameters, and one assembly gives the derivative with respect to all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from itertools import product

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from fenics_joints.errors import MeshError, items, real, wanted, whole
from fenics_joints.forms import circumference
from fenics_joints.meshes.tagged import TaggedMesh
from fenics_joints.structure.changes import (
    Change,
    LocalLoss,
    PlacedPoint,
    PlacedResonator,
    ShapeChange,
    add_changes,
)
from fenics_joints.structure.checked import axisymmetric_regions, check_components, region_cells
from fenics_joints.structure.components import (
    ElasticSupport,
    Parameter,
    PointMass,
    Region,
    Spring,
    Support,
)
from fenics_joints.structure.held import held_entities
from fenics_joints.structure.laws import ELASTIC_SUPPORT
from fenics_joints.structure.points import PointRows, locate
from fenics_joints.structure.properties import PropertyField
from fenics_joints.structure.summed import SummedMatrices
from fenics_joints.structure.values import by_name, number, parameter_values

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
        changes: What else changes with parameters: `fenics_joints.structure.changes`.
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
        self.bcs = self._dirichlet()
        self._forms: dict[object, fem.Form] = {}
        self._direction: fem.Function | None = None
        self._rows: dict[bytes, PointRows] = {}
        self._region_matrices: dict[tuple[int, int], PETSc.Mat] = {}
        self._summed = SummedMatrices(self)
        self._support_matrices: dict[int, tuple[PETSc.Mat, PETSc.Mat]] = {}

    # -- set-up ------------------------------------------------------------------------------

    def _make_spaces(self, degree: int) -> None:
        cell = self.mesh.topology.cell_name()
        family = "S" if degree > 1 and cell in _SERENDIPITY_CELLS else "Lagrange"
        #: Family, cell and degree of the displacements.
        self.element_of = family, cell, degree
        self.element = basix.ufl.element(*self.element_of)
        gdim = self.mesh.geometry.dim
        self.V = fem.functionspace(self.mesh, basix.ufl.element(*self.element_of, shape=(gdim,)))

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
        groups: dict[tuple, list[Region]] = {}
        for region in self.regions:
            groups.setdefault((region.law, region.normal, region.across), []).append(region)
        forms = []
        for alike in groups.values():
            tags = sorted(self.tagged.cell_tag(name) for region in alike for name in region.cells)
            dx = self._measure("dx", self.tagged.cell_tags, tuple(tags))
            forms.append(self._form(which, alike[0], u, v, dx))
        return sum(forms[1:], forms[0])

    def _form(self, which: int, region: Region, u, v, dx) -> ufl.Form:
        """Stiffness (0) or mass (1) by a region's law and directions."""
        law = region.law
        q = {name: self.field.q[i] for i, name in enumerate(law.properties)}
        if which:
            return law.inertia(u, v, q, dx)
        ways = {"normal": region.normal, "across": region.across}
        ways = {
            key: ufl.as_vector([float(c) for c in way[: self.gdim]])
            for key, way in ways.items()
            if way is not None
        }
        return law.stiffness(u, v, q, ways.pop("normal"), dx, **ways)

    def compiled(self, key, make: Callable[[], ufl.Form]) -> fem.Form:
        """A compiled form, kept under a key."""
        if key not in self._forms:
            self._forms[key] = fem.form(make())
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
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        return self._measure("dx", [(1, np.sort(cells[cells < owned]).astype(np.int32))], 1)

    def region_matrices(self, number: int, q: Mapping[str, float] | None) -> tuple:
        """Stiffness and mass of one region alone; rows and columns of held DOFs are zero.

        Args:
            number: Index of the region in `regions`.
            q: Property values to put into its cells, unchecked; None leaves the field as it is.

        Returns:
            (K, M), PETSc matrices that the next call with the same ``number`` overwrites.
        """
        return tuple(self.region_matrix(number, which, q) for which in (0, 1))

    def region_matrix(self, number: int, which: int, q: Mapping[str, float] | None) -> PETSc.Mat:
        """One of `region_matrices`: stiffness (0) or mass (1)."""
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

    def place(self, mass: PointMass, values) -> tuple:
        """Where a point mass is."""
        travel = number(mass.travel, values)
        return tuple(np.asarray(mass.point) + travel * np.asarray(mass.direction))

    def rows(self, points, what: str = "point", names: Sequence[str] = ()) -> PointRows:
        """Rows that evaluate the displacement at points; cached. Collective.

        Those of a test, whose ``what`` is given, are moved onto the mesh if they are near it.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))[:, : self.mesh.geometry.dim]
        key, snap = points.tobytes(), what != "point"
        if key not in self._rows:
            self._rows[key] = locate(self.V, self.element, points, what, names=names, snap=snap)
        return self._rows[key]

    def add_point(self, A: PETSc.Mat, point, block: np.ndarray) -> None:
        """Put a block, (3, 3), between the displacements at a point, in place. Collective."""
        gdim, rows = self.gdim, self.rows(point)
        for nodes, N in zip(rows.nodes, rows.values, strict=True):
            dofs = (nodes[:, None] * gdim + np.arange(gdim)).ravel().astype(np.int32)
            values = np.kron(np.outer(N, N), block[:gdim, :gdim])
            free = ~self.held_dofs[dofs]
            values = values * np.outer(free, free)
            A.setValuesLocal(dofs, dofs, values, PETSc.InsertMode.ADD_VALUES)
        A.assemble()

    @cached_property
    def held_dofs(self) -> np.ndarray:
        """Which DOFs of this rank supports hold, then which ghosts, (n_local + n_ghosts,)."""
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

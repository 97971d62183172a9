"""A jointed structure: parts, joints, supports, springs and masses to K(p) and M(p).

Every material property is a field over the cells, so that one compiled form serves all values of
the parameters, and one assembly gives the derivative with respect to all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

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
from fenics_joints.forms import circumference
from fenics_joints.meshes.tagged import TaggedMesh, limits
from fenics_joints.structure.components import (
    ElasticSupport,
    Parameter,
    PointMass,
    Region,
    Spring,
    Support,
)
from fenics_joints.structure.laws import AXISYMMETRIC_SOLID, ELASTIC_SUPPORT, WIDE_SOLID
from fenics_joints.structure.points import PointRows, Sensors, locate, observe
from fenics_joints.structure.properties import PropertyField
from fenics_joints.structure.values import parameter_values

__all__ = ["Structure"]

_SERENDIPITY_CELLS = ("quadrilateral", "hexahedron")


class Structure:
    """A finite-element model whose matrices are functions of named parameters.

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
        degree: Degree of the displacement, 1 or 2; on quadrilaterals and hexahedra degree 2 is
            the serendipity element.
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
        degree: int = 2,
        quadrature_degree: int | None = None,
        axisymmetric: bool = False,
    ):
        self.tagged = tagged
        self.mesh = tagged.mesh
        self.comm = tagged.mesh.comm
        self.parameters: dict[str, Parameter] = {}
        for parameter in parameters:
            if parameter.name in self.parameters:
                raise InputError(f"parameter {parameter.name} is given twice; expected once.")
            self.parameters[parameter.name] = parameter
        self.regions, self.masses = tuple(regions), tuple(masses)
        supports = tuple(supports)
        self.springs = tuple(springs)
        self._made_of = {
            "regions": self.regions, "masses": self.masses, "springs": self.springs,
            "supports": supports, "axisymmetric": axisymmetric,
        }  # fmt: skip
        self.supports = tuple(s for s in supports if isinstance(s, Support))
        self.elastic_supports = tuple(s for s in supports if isinstance(s, ElasticSupport))
        self._check_names()
        self.axisymmetric, self.weight = axisymmetric, 1.0
        if axisymmetric:
            self._make_axisymmetric()
        exact = 2 * degree + axisymmetric
        self.quadrature_degree = exact if quadrature_degree is None else quadrature_degree
        self.degree = degree
        self._make_spaces(degree)
        self.field = PropertyField(self.mesh, self._region_cells(), self.parameters)
        self.bcs = self._dirichlet()
        self._stiffness = self._inertia = self._gradient = self._weight = None
        self._rows: dict[bytes, PointRows] = {}
        self._region_forms: dict[int, list] = {}
        self._support_matrices: dict[int, tuple[PETSc.Mat, PETSc.Mat]] = {}

    # -- set-up ------------------------------------------------------------------------------

    def _check_names(self) -> None:
        names = [c.name for c in self._components()]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"component {name} is given twice; expected unique names.")
        for owner, key, value in self._values():
            if isinstance(value, str) and value not in self.parameters:
                raise InputError(
                    f"{owner}.{key} names the parameter {value!r}, which does not exist; "
                    f"expected a number or one of: {', '.join(self.parameters) or 'none'}."
                )

    def _components(self) -> tuple:
        return (*self.regions, *self.masses, *self.springs, *self.elastic_supports)

    def _make_axisymmetric(self) -> None:
        """Give the parts their law in a body of revolution; refuse what has none."""
        low, high = limits(self.tagged)
        if self.gdim != 2 or low[0] < -1e-9 * np.max(high - low):
            raise MeshError(
                "axisymmetric: expected a mesh in the plane with r = x[0] >= 0 everywhere."
            )
        for region in self.regions:
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
        self.regions = tuple(replace(r, law=AXISYMMETRIC_SOLID) for r in self.regions)
        self.weight = circumference(ufl.SpatialCoordinate(self.mesh)[0])

    def _values(self):
        for region in self.regions:
            for key in region.law.properties:
                yield region.name, key, region.properties[key]
        for mass in self.masses:
            yield mass.name, "mass", mass.mass
            yield mass.name, "travel", mass.travel
        for spring in self.springs:
            yield spring.name, "stiffness", spring.stiffness
        for support in self.elastic_supports:
            yield support.name, "k_n", support.k_n
            yield support.name, "k_t", support.k_t

    def _region_cells(self) -> list[tuple[Region, np.ndarray]]:
        """Local cells, ghosts included, of each region."""
        imap = self.mesh.topology.index_map(self.mesh.topology.dim)
        count = np.zeros(imap.size_local + imap.num_ghosts, dtype=np.int32)
        found = []
        for region in self.regions:
            tags = [self.tagged.cell_tag(name) for name in region.cells]
            cells = np.sort(np.concatenate([self.tagged.cell_tags.find(t) for t in tags]))
            count[cells] += 1
            found.append((region, cells))
        owned = count[: imap.size_local]
        bad = self.comm.allreduce(int(np.sum(owned != 1)))
        if bad:
            used = [name for region in self.regions for name in region.cells]
            names = self.tagged.cell_names
            wrong = [name for name in names if used.count(name) != 1]
            raise MeshError(
                f"{bad} cells are in no region or in more than one: "
                f"{', '.join(wrong) or 'untagged'}; expected every cell group "
                f"({', '.join(names)}) in exactly one part or joint."
            )
        return found

    def _make_spaces(self, degree: int) -> None:
        if degree not in (1, 2):
            raise InputError(f"degree = {degree}: expected 1 or 2.")
        cell = self.mesh.topology.cell_name()
        family = "S" if degree == 2 and cell in _SERENDIPITY_CELLS else "Lagrange"
        self.element = basix.ufl.element(family, cell, degree)
        gdim = self.mesh.geometry.dim
        self.V = fem.functionspace(
            self.mesh, basix.ufl.element(family, cell, degree, shape=(gdim,))
        )

    def _dirichlet(self) -> list:
        fdim = self.mesh.topology.dim - 1
        bcs = []
        for support in self.supports:
            facets = self.tagged.facet_tags.find(self.tagged.facet_tag(support.facets))
            for i in support.directions:
                if i >= self.mesh.geometry.dim:
                    continue
                # A function, as serendipity elements take no constant.
                W, _ = self.V.sub(i).collapse()
                dofs = fem.locate_dofs_topological((self.V.sub(i), W), fdim, facets)
                bcs.append(fem.dirichletbc(fem.Function(W), dofs, self.V.sub(i)))
        return bcs

    def coarser(self) -> Structure:
        """The same structure with displacements of degree 1, for multigrid."""
        parameters = self.parameters.values()
        return Structure(self.tagged, parameters=parameters, degree=1, **self._made_of)

    # -- forms -------------------------------------------------------------------------------

    def _groups(self):
        """Regions that share a law and its directions, with their tags: one integral each."""
        groups: dict[tuple, list[int]] = {}
        for region in self.regions:
            tags = [self.tagged.cell_tag(name) for name in region.cells]
            key = region.law, region.normal, region.across
            groups.setdefault(key, []).extend(tags)
        for key, tags in groups.items():
            yield *key, tuple(sorted(tags))

    def _directions(self, normal, across) -> tuple[ufl.core.expr.Expr, dict]:
        """A law's normal, and what else of directions it takes."""
        n, *rest = (
            ufl.as_vector([float(c) for c in way[: self.gdim]])
            for way in (normal, across)
            if way is not None
        )
        return n, {"across": rest[0]} if rest else {}

    def _dx(self, tags):
        return ufl.Measure(
            "dx",
            domain=self.mesh,
            subdomain_data=self.tagged.cell_tags,
            metadata={"quadrature_degree": self.quadrature_degree},
        )(tags)

    def stiffness_form(self, u, v) -> ufl.Form:
        """Stiffness of all parts and joints, as UFL over the property field."""
        return self._sum(lambda law, q, n, ways, dx: law.stiffness(u, v, q, n, dx, **ways))

    def inertia_form(self, u, v) -> ufl.Form:
        """Consistent mass of all parts and joints, as UFL over the property field."""
        return self._sum(lambda law, q, n, ways, dx: law.inertia(u, v, q, dx))

    def _sum(self, make) -> ufl.Form:
        total = None
        for law, normal, across, tags in self._groups():
            q = {name: self.field.q[i] for i, name in enumerate(law.properties)}
            n, ways = self._directions(normal, across)
            form = make(law, q, n, ways, self._dx(tags))
            total = form if total is None else total + form
        return total

    def _compile(self) -> None:
        u, v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        self._stiffness = fem.form(self.stiffness_form(u, v))
        self._inertia = fem.form(self.inertia_form(u, v))

    def region_form(self, number: int, u, v) -> tuple[ufl.Form, ufl.Form]:
        """Stiffness and mass of one region alone, as UFL over the property field.

        The cells are data of the form: regions with one law and normal share compiled code.

        Args:
            number: Index of the region in `regions`.
            u: Trial function or displacement.
            v: Test function or displacement.
        """
        region, cells = self.field.regions[number]
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        dx = ufl.Measure(
            "dx",
            domain=self.mesh,
            subdomain_data=[(1, np.sort(cells[cells < owned]).astype(np.int32))],
            metadata={"quadrature_degree": self.quadrature_degree},
        )(1)
        q = {name: self.field.q[i] for i, name in enumerate(region.law.properties)}
        n, ways = self._directions(region.normal, region.across)
        return region.law.stiffness(u, v, q, n, dx, **ways), region.law.inertia(u, v, q, dx)

    def region_matrices(self, number: int, q: Mapping[str, float] | None) -> tuple:
        """Stiffness and mass of one region alone, supports not applied.

        Args:
            number: Index of the region in `regions`.
            q: Property values to put into its cells, unchecked; None leaves the field as it is.

        Returns:
            (K, M), PETSc matrices that the next call with the same ``number`` overwrites.
        """
        if number not in self._region_forms:
            u, v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
            forms = [fem.form(form) for form in self.region_form(number, u, v)]
            self._region_forms[number] = [(f, fem_petsc.create_matrix(f)) for f in forms]
        if q is not None:
            self.field.fill(number, q)
        matrices = []
        for form, A in self._region_forms[number]:
            A.zeroEntries()
            fem_petsc.assemble_matrix(A, form)
            A.assemble()
            matrices.append(A)
        return tuple(matrices)

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
            ds = ufl.Measure(
                "ds",
                domain=self.mesh,
                subdomain_data=self.tagged.facet_tags,
                metadata={"quadrature_degree": self.quadrature_degree},
            )(tag)
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
        u, v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        # As constants, both unit stiffnesses are one compiled form.
        q = {key: fem.Constant(self.mesh, value) for key, value in q.items()}
        normal = ufl.FacetNormal(self.mesh)
        form = fem.form(self.weight * ELASTIC_SUPPORT.stiffness(u, v, q, normal, ds))
        return self._assemble(form, None, 0.0)

    def _add_supports(self, K: PETSc.Mat, values: Mapping[str, float]) -> None:
        for i, support in enumerate(self.elastic_supports):
            q = {key: self.number(getattr(support, key), values) for key in ("k_n", "k_t")}
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
        values = self._update(given)
        K = self._assemble(self._stiffness, out, 1.0)
        for spring in self.springs:
            k = spring.share * self.number(spring.stiffness, values)
            self._add_point(K, spring.point, k * np.outer(spring.direction, spring.direction))
        self._add_supports(K, values)
        K.assemble()
        return K

    def mass(self, given: Mapping[str, float] | None = None, out=None) -> PETSc.Mat:
        """Mass matrix M(p), kg, positive semi-definite; rows of held DOFs are zero."""
        values = self._update(given)
        M = self._assemble(self._inertia, out, 0.0)
        for mass in self.masses:
            m = mass.share * self.number(mass.mass, values)
            if m:
                self._add_point(M, self._place(mass, values), m * np.eye(3))
        M.assemble()
        return M

    def _update(self, given) -> dict[str, float]:
        if self._stiffness is None:
            self._compile()
        values = self.values(given)
        self.field.update(values)
        return values

    def _assemble(self, form, out, diagonal: float) -> PETSc.Mat:
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

    @staticmethod
    def number(value: float | str, values: Mapping[str, float]) -> float:
        """A component's number: itself, or the value of the parameter that it names."""
        return values[value] if isinstance(value, str) else float(value)

    def _place(self, mass: PointMass, values) -> tuple:
        travel = self.number(mass.travel, values)
        return tuple(np.asarray(mass.point) + travel * np.asarray(mass.direction))

    def rows(self, points, what: str = "point") -> PointRows:
        """Rows that evaluate the displacement at points; cached. Collective."""
        points = np.atleast_2d(np.asarray(points, dtype=float))[:, : self.mesh.geometry.dim]
        key = points.tobytes()
        if key not in self._rows:
            self._rows[key] = locate(self.V, self.element, points, what)
        return self._rows[key]

    def _add_point(self, A: PETSc.Mat, point, block: np.ndarray) -> None:
        gdim = self.mesh.geometry.dim
        rows = self.rows(point)
        held = self._held()
        for nodes, N in zip(rows.nodes, rows.values, strict=True):
            dofs = (nodes[:, None] * gdim + np.arange(gdim)).ravel().astype(np.int32)
            values = np.kron(np.outer(N, N), block[:gdim, :gdim])
            free = ~held[dofs]
            values = values * np.outer(free, free)
            A.setValuesLocal(dofs, dofs, values, PETSc.InsertMode.ADD_VALUES)
        A.assemble()

    def _held(self) -> np.ndarray:
        imap, bs = self.V.dofmap.index_map, self.V.dofmap.index_map_bs
        held = np.zeros((imap.size_local + imap.num_ghosts) * bs, dtype=bool)
        for bc in self.bcs:
            held[bc.dof_indices()[0]] = True
        return held

    @property
    def n_dofs(self) -> int:
        """Number of displacement DOFs, held ones included."""
        return self.V.dofmap.index_map.size_global * self.V.dofmap.index_map_bs

    # -- derivatives and observation -----------------------------------------------------------

    def cell_gradient(self, shape: PETSc.Vec, eigenvalue: float, given=None) -> np.ndarray:
        """Derivative of x^T (K - lambda M) x by every property of every cell: one assembly.

        Args:
            shape: Displacement vector x, owned entries.
            eigenvalue: lambda, (rad/s)^2.
            given: Values of parameters that differ from their nominal value.

        Returns:
            Shape (n_owned_cells, n_properties), for this rank's cells.
        """
        self._update(given)
        if self._gradient is None:
            self._phi, self._lambda = fem.Function(self.V), fem.Constant(self.mesh, 0.0)
            energy = self.stiffness_form(self._phi, self._phi)
            energy = energy - self._lambda * self.inertia_form(self._phi, self._phi)
            direction = ufl.TestFunction(self.field.space)
            self._gradient = fem.form(ufl.derivative(energy, self.field.q, direction))
        owned = self.V.dofmap.index_map.size_local * self.V.dofmap.index_map_bs
        self._phi.x.array[:owned] = shape.array_r
        self._phi.x.scatter_forward()
        self._lambda.value = eigenvalue
        # Cell integrals reach no other cell's property: nothing is to be summed over ranks.
        vector = fem.assemble_vector(self._gradient)
        return self.field.by_cell(vector.array)

    def pencil_gradient(self, shape: PETSc.Vec, eigenvalue: float, given=None) -> np.ndarray:
        """Derivative of x^T (K - lambda M) x by every parameter, at fixed x. Collective.

        For an M-normalised eigenvector that is the eigenvalue's derivative.

        Returns:
            Shape (n_parameters,), in the order of `parameters`.
        """
        values = self.values(given)
        gradient = self.field.contract(self.cell_gradient(shape, eigenvalue, given), values)
        position = {name: i for i, name in enumerate(self.parameters)}
        for spring in self.springs:
            if isinstance(spring.stiffness, str):
                d = self._at(shape, spring.point) @ np.asarray(spring.direction)[: self.gdim]
                gradient[position[spring.stiffness]] += spring.share * d**2
        for i, support in enumerate(self.elastic_supports):
            for k, unit in zip((support.k_n, support.k_t), self.support_matrices(i), strict=True):
                if isinstance(k, str):
                    gradient[position[k]] += shape.dot(unit * shape)
        for mass in self.masses:
            self._mass_gradient(gradient, position, mass, shape, eigenvalue, values)
        return gradient

    def pencil_gradients(self, shapes, eigenvalues, given=None) -> np.ndarray:
        """`pencil_gradient` of several shapes, shape (len(shapes), n_parameters). Collective."""
        pairs = zip(shapes, eigenvalues, strict=True)
        return np.array([self.pencil_gradient(x, float(lam), given) for x, lam in pairs])

    @property
    def gdim(self) -> int:
        """Geometric dimension of the mesh."""
        return self.mesh.geometry.dim

    def _mass_gradient(self, gradient, position, mass, shape, eigenvalue, values) -> None:
        if not isinstance(mass.mass, str) and not isinstance(mass.travel, str):
            return
        place = self._place(mass, values)
        u = self._at(shape, place)
        if isinstance(mass.mass, str):
            gradient[position[mass.mass]] -= eigenvalue * mass.share * (u @ u)
        if isinstance(mass.travel, str):
            slope = self._slope_at(shape, place) @ np.asarray(mass.direction)[: self.gdim]
            m = mass.share * self.number(mass.mass, values)
            gradient[position[mass.travel]] -= 2 * eigenvalue * m * (u @ slope)

    def _at(self, vector, point) -> np.ndarray:
        points = np.repeat(np.atleast_2d(point)[:, : self.gdim], self.gdim, axis=0)
        rows = self.rows(points)
        return observe(rows, np.eye(self.gdim), [vector], self.V)[:, 0]

    def _slope_at(self, vector, point) -> np.ndarray:
        rows = self.rows(np.repeat(np.atleast_2d(point)[:, : self.gdim], self.gdim, axis=0))
        slopes = np.empty((self.gdim, self.gdim))
        for j in range(self.gdim):
            turned = PointRows(rows.index, rows.nodes, rows.gradients[:, :, j], rows.gradients)
            slopes[:, j] = observe(turned, np.eye(self.gdim), [vector], self.V)[:, 0]
        return slopes

    def observe(self, shapes, sensors: Sensors) -> np.ndarray:
        """Displacement shapes at sensors, shape (n_sensors, n_shapes), equal on all ranks."""
        rows = self.rows(sensors.points, "sensor")
        return observe(rows, sensors.directions[:, : self.gdim], list(shapes), self.V)

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
        rows = self.rows(sensors.points, "sensor")
        turned = replace(rows, values=np.einsum("pnj,pj->pn", rows.gradients, towards[rows.index]))
        return observe(turned, sensors.directions[:, :gdim], list(shapes), self.V)

    def dilation_frequency(self, given: Mapping[str, float] | None = None) -> float:
        """Frequency, Hz, at which the body would breathe if it grew evenly in all directions.

        A Rayleigh quotient, of the order of wave speed over length: a scale for spectral shifts.
        Supports and springs are left out.
        """
        self._update(given)
        low, high = limits(self.tagged)
        centre = 0.5 * (low + high)
        if self.axisymmetric:
            centre[0] = 0.0
        u = ufl.SpatialCoordinate(self.mesh) - ufl.as_vector([float(c) for c in centre])
        forms = fem.form(self.stiffness_form(u, u)), fem.form(self.inertia_form(u, u))
        stiff, heavy = (self.comm.allreduce(fem.assemble_scalar(form)) for form in forms)
        if heavy <= 0:
            raise InputError("the structure has no mass: expected a density > 0 in some part.")
        return float(np.sqrt(stiff / heavy) / (2 * np.pi))

    def extent(self, number: int) -> float:
        """Largest extent, m, of a region's cells along its normal: a layer's thickness."""
        region, cells = self.field.regions[number]
        corners = self.mesh.geometry.x[geometry_dofmap(self.mesh)[cells]]
        along = corners[..., : self.gdim] @ np.asarray(region.normal[: self.gdim])
        local = float(np.ptp(along, axis=1).max()) if len(cells) else 0.0
        return self.comm.allreduce(local, op=MPI.MAX)

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg, of parts, joints and point masses."""
        values = self._update(given)
        if self._weight is None:
            one = ufl.as_vector([1.0] + [0.0] * (self.gdim - 1))
            self._weight = fem.form(self.inertia_form(one, one))
        return self.comm.allreduce(fem.assemble_scalar(self._weight)) + self.attached_mass(values)

    def attached_mass(self, values: Mapping[str, float]) -> float:
        """Mass, kg, of the point masses, at all parameters' values."""
        return sum(m.share * self.number(m.mass, values) for m in self.masses)

    def volumes(self) -> np.ndarray:
        """Volume as meshed, m3, of every region, in the order of `regions`. Collective.

        In the plane it is that of one metre of depth, or of the whole body of revolution.
        """
        local = self.cell_volumes()
        sums = [local[cells[cells < len(local)]].sum() for _, cells in self.field.regions]
        return self.comm.allreduce(np.array(sums))

    def cell_volumes(self) -> np.ndarray:
        """Volume as meshed, m3, of every cell that this rank owns."""
        space = fem.functionspace(self.mesh, ("DG", 0))
        vector = fem.assemble_vector(fem.form(self.weight * ufl.TestFunction(space) * ufl.dx))
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        return vector.array[space.dofmap.list[:owned, 0]]

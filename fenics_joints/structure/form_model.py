"""K(p) and M(p) of any two bilinear forms: a model that modes, updating and responses take."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms import expand_derivatives

from fenics_joints.errors import InputError, items, mapping, text, wanted, whole
from fenics_joints.structure.components import Parameter, parameter_values
from fenics_joints.structure.damping import Damping
from fenics_joints.structure.grids import corner_motion
from fenics_joints.structure.points import PointRows, Sensors, all_min, locate, observe
from fenics_joints.structure.sparse import MatrixForm

#: x^T A y and y^T A x of a symmetric matrix may differ by this share of their size: round-off of
#: sums over all degrees of freedom.
_SYMMETRIC = 1e-9


class FormModel:
    """A model by two bilinear forms of yours: K(p) = a and M(p) = m.

    Fulfils `fenics_joints.structure.Damped`, so that `solve_modes`, `frf` and `update` take it.

    Args:
        a: Stiffness: a real, symmetric, positive semi-definite form of a trial and a test function
            of any function space. With displacements in metres K is in N/m.
        m: Mass: likewise, of the same functions, kg.
        bcs: Dirichlet conditions. Their degrees of freedom do not move, whatever their value.
        parameters: By name the scalar constants of the forms that are parameters. With a
            `fenics_joints.structure.Parameter` in front, as a pair, a parameter has a unit and
            bounds; otherwise its value now is its nominal one.
        displacement: Number of the subspace of a mixed space that is the displacement, which
            sensors read; None if the whole space is.

    Raises:
        InputError: If the forms are no bilinear forms of one space, or a parameter is no scalar
            constant of them.
    """

    #: See `fenics_joints.structure.model.Model`.
    is_dense, is_meshed = False, False
    dampers: Mapping[str, PETSc.Mat] = MappingProxyType({})
    #: All of K, which a damping may name; and what the suite makes: none.
    layers, regions, elastic_supports = ("all",), (), ()
    masses, changes = (), ()

    def __init__(
        self,
        a: ufl.Form,
        m: ufl.Form,
        bcs: Iterable[fem.DirichletBC] = (),
        parameters: Mapping[str, fem.Constant | tuple[Parameter, fem.Constant]] | None = None,
        displacement: int | None = None,
    ):
        self._arguments = _arguments(a, m)
        self.V: fem.FunctionSpace = self._arguments[0].ufl_function_space()
        self.mesh, self.comm = self.V.mesh, self.V.mesh.comm
        self.bcs = list(items("bcs", bcs, fem.DirichletBC, "Dirichlet conditions"))
        self._a, self._m = a, m
        self._constants: dict[str, fem.Constant] = {}
        self.parameters: dict[str, Parameter] = {}
        known = {*a.constants(), *m.constants()}
        for name, given in mapping("parameters", parameters, "constants by name").items():
            parameter, constant = given if isinstance(given, tuple) else (None, given)
            if constant not in known or constant.ufl_shape != ():
                raise wanted(f"parameters[{name!r}]", constant, "a scalar fem.Constant of a or m")
            value = float(constant.value)
            if constant in self._constants.values():
                raise InputError(f"parameters[{name!r}]: expected a constant for each name.")
            if parameter is not None and parameter.name != name:
                raise wanted(f"parameters[{name!r}]", parameter.name, "a Parameter of that name")
            self._constants[text("parameters", name)] = constant
            self.parameters[name] = parameter or Parameter(name, value, log=value > 0)
        if displacement is not None:
            most = self.V.ufl_element().num_sub_elements - 1
            displacement = whole("displacement", displacement, 0, most)
        self._displacement, self._rows = displacement, dict[bytes, PointRows]()
        self._forms: dict[object, fem.Form | None] = {}
        self._vector, self._other = fem.Function(self.V), fem.Function(self.V)
        self._by_cell: tuple | None = None
        self.n_local = self.V.dofmap.index_map.size_local * self.V.dofmap.index_map_bs

    def __repr__(self) -> str:
        return f"FormModel({self.n_dofs} DOFs, {len(self.parameters)} parameters)"

    @property
    def gdim(self) -> int:
        """Geometric dimension of the mesh."""
        return self.mesh.geometry.dim

    @property
    def n_dofs(self) -> int:
        """Size of K and M."""
        return self.V.dofmap.index_map.size_global * self.V.dofmap.index_map_bs

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters' values: the nominal ones, with ``given`` put in."""
        return parameter_values(self.parameters, given)

    def update(self, given: Mapping[str, float] | None = None) -> None:
        """Put the parameters' values into the forms' constants."""
        for name, value in self.values(given).items():
            self._constants[name].value = value

    def stiffness(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """K(p); rows of held degrees of freedom are the identity's. The caller's to destroy.
        Collective."""
        self.update(given)
        return self._assembled("a", lambda: self._a, 1.0)

    def mass(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """M(p); rows of held degrees of freedom are zero. The caller's to destroy. Collective."""
        self.update(given)
        return self._assembled("m", lambda: self._m, 0.0)

    def _compiled(self, key, make) -> fem.Form:
        if key not in self._forms:
            self._forms[key] = fem.form(make())
        return self._forms[key]

    def _assembled(self, key, make, diagonal: float) -> PETSc.Mat:
        form = self._compiled(key, make)
        A = fem_petsc.create_matrix(form)
        # The name of the fourth argument changed in 0.10.
        fem_petsc.assemble_matrix(A, form, self.bcs, diagonal)
        A.assemble()
        self._check_symmetry(key, A)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        A.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        return A

    def _check_symmetry(self, key, A: PETSc.Mat) -> None:
        x, y = A.createVecs()
        random = np.random.default_rng(self.comm.rank)
        x.array, y.array = random.standard_normal((2, self.n_local))
        other = y.duplicate()
        A.mult(y, other)
        one, size = x.dot(other), x.norm() * other.norm()
        A.mult(x, other)
        if not abs(one - y.dot(other)) <= _SYMMETRIC * size:
            raise InputError(f"{key}: expected a symmetric form, without nan.")

    # -- derivatives ---------------------------------------------------------------------------

    def _slope(self, form: ufl.Form, name: str) -> ufl.Form | None:
        """Derivative of a form by a parameter; None if it does not depend on it."""
        constant = self._constants[name]
        if constant not in form.constants():
            return None
        symbol = ufl.variable(constant)
        slope = expand_derivatives(ufl.diff(ufl.replace(form, {constant: symbol}), symbol))
        return None if slope.empty() else slope

    def not_linear(self) -> list[str]:
        """Names of the parameters in which K and M together are not linear."""
        own = set(self._constants.values())
        slopes = [(n, self._slope(f, n)) for n in self.parameters for f in (self._a, self._m)]
        bent = [name for name, slope in slopes if slope is not None and own & {*slope.constants()}]
        return list(dict.fromkeys(bent))

    def _energy(self, form: ufl.Form) -> ufl.Form:
        """x^T A x with the matrix A of a form."""
        return ufl.replace(form, dict.fromkeys(self._arguments, self._vector))

    def pencil_gradients(self, shapes, eigenvalues, given=None) -> np.ndarray:
        """Derivative of x^T (K - lambda M) x by every parameter, at fixed x. Collective.

        Returns:
            Shape (len(shapes), n_parameters), in the order of `parameters`.
        """
        self.update(given)
        gradient = np.zeros((len(shapes), len(self.parameters)))
        for i, (shape, eigenvalue) in enumerate(zip(shapes, eigenvalues, strict=True)):
            self._put(shape)
            for j, name in enumerate(self.parameters):
                for key, factor in (("a", 1.0), ("m", -eigenvalue)):
                    form = self._energy_slope(key, name)
                    if form is not None:
                        gradient[i, j] += factor * fem.assemble_scalar(form)
        return self.comm.allreduce(gradient)

    def _energy_slope(self, key: str, name: str) -> fem.Form | None:
        whole_key = "energy", key, name
        if whole_key not in self._forms:
            slope = self._slope(self._a if key == "a" else self._m, name)
            self._forms[whole_key] = None if slope is None else fem.form(self._energy(slope))
        return self._forms[whole_key]

    def coefficient_gradient(
        self, shape: PETSc.Vec, eigenvalue: float, coefficient: fem.Function, given=None
    ) -> fem.Function:
        """Derivative of x^T (K - lambda M) x by each value of a coefficient, x fixed. Collective.

        For an M-normalised eigenvector these are the derivatives of the eigenvalue.

        Args:
            shape: Vector x, owned entries.
            eigenvalue: lambda, (rad/s)^2.
            coefficient: A function in the forms, such as a modulus in a ``DG 0`` space.
            given: Values of parameters that differ from their nominal value.

        Raises:
            InputError: If the forms do not have it.
        """
        if coefficient not in (*self._a.coefficients(), *self._m.coefficients()):
            raise wanted("coefficient", coefficient, "a fem.Function in a or m")
        self.update(given)
        self._put(shape)
        energy = self._energy(self._a) - fem.Constant(self.mesh, float(eigenvalue)) * self._energy(
            self._m
        )
        space = coefficient.function_space
        slope = ufl.derivative(energy, coefficient, ufl.TestFunction(space))
        found = fem.Function(space, name=f"derivative by {coefficient.name}")
        fem.assemble_vector(found.x.array, fem.form(slope))
        found.x.scatter_reverse(la.InsertMode.add)
        found.x.scatter_forward()
        return found

    def slopes(
        self, given: Mapping[str, float] | None = None, apart: Sequence[str] = ()
    ) -> Iterator[tuple[int, str, str | None, MatrixForm]]:
        """dK/dp and dM/dp of all parameters that change them; see `structure.Damped`."""
        self.update(given)
        for i, name in enumerate(self.parameters):
            for key, form in (("a", self._a), ("m", self._m)):
                slope = self._slope(form, name)
                if slope is not None:
                    A = self._assembled(("slope", key, name), lambda slope=slope: slope, 0.0)
                    layer = "all" if key == "a" and "all" in apart else None
                    yield i, "K" if key == "a" else "M", layer, MatrixForm(A, owned=True)

    # -- damping, loads and what sensors see ---------------------------------------------------

    def resolved(self, damping: Damping) -> Damping:
        """A damping by names of `layers`."""
        return damping

    def region_stiffness(self, name: str, given=None) -> PETSc.Mat:
        """K without the rows and columns of held degrees of freedom; the caller's to destroy.

        Raises:
            InputError: If the name is not ``"all"``.
        """
        if name not in self.layers:
            raise wanted("damping", name, "'all', the whole of a")
        self.update(given)
        return self._assembled("a", lambda: self._a, 0.0)

    def _space(self):
        """The space of displacements, its degrees of freedom in the whole (None for all of them),
        and the element of a component.

        Raises:
            InputError: If it has no component along each axis of the mesh.
        """
        W, dofs = self.V, None
        if self._displacement is not None:
            W, dofs = self.V.sub(self._displacement).collapse()
        element, gdim = W.ufl_element(), self.mesh.geometry.dim
        if element.block_size != gdim or W.value_shape != (gdim,):
            raise InputError(
                f"the space of a and m, {element}: sensors, loads and pictures need a space of "
                f"displacements with values of shape ({gdim},), or displacement = the number of "
                "the subspace that is one."
            )
        return W, dofs, element.sub_elements[0]

    def observe(self, shapes, sensors: Sensors) -> np.ndarray:
        """Displacements of shapes at sensors, (n_sensors, n_shapes), equal on all ranks."""
        W, dofs, element = self._space()
        rows = self._located(W, element, sensors, "sensor")
        moved = [self._function(shape, W, dofs) for shape in shapes]
        vectors = [u.x.petsc_vec for u in moved]
        return observe(rows, sensors.directions[:, : self.mesh.geometry.dim], vectors, W)

    def loads(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """This rank's rows of the loads of one newton at points, (n_local, n). Collective."""
        W, dofs, element = self._space()
        rows, gdim = self._located(W, element, sensors, what), self.mesh.geometry.dim
        held = np.concatenate([np.empty(0, np.int32), *(bc.dof_indices()[0] for bc in self.bcs)])
        loads, load = np.zeros((self.n_local, len(sensors))), fem.Function(self.V)
        for column, direction in enumerate(sensors.directions[:, :gdim]):
            load.x.array[:] = 0.0
            for at in np.flatnonzero(rows.index == column):
                block = rows.nodes[at][:, None] * gdim + np.arange(gdim)
                where = block if dofs is None else np.asarray(dofs)[block]
                np.add.at(load.x.array, where, np.outer(rows.values[at], direction))
            load.x.scatter_reverse(la.InsertMode.add)
            load.x.array[held] = 0.0
            loads[:, column] = load.x.array[: self.n_local]
        return loads

    def _located(self, W, element, sensors: Sensors, what: str) -> PointRows:
        key = sensors.points.tobytes()
        if key not in self._rows:
            points = sensors.points[:, : self.mesh.geometry.dim]
            self._rows[key] = locate(W, element, points, what, names=sensors.names, snap=True)
        return self._rows[key]

    def _put(self, shape: PETSc.Vec, into: fem.Function | None = None) -> None:
        vector = self._vector if into is None else into
        vector.x.array[: self.n_local] = shape.array_r
        vector.x.scatter_forward()

    def _function(self, shape: PETSc.Vec, W, dofs) -> fem.Function:
        """A vector's values on a space, whose degrees of freedom in the whole are given."""
        self._put(shape)
        u = fem.Function(W, name="displacement")
        u.x.array[:] = self._vector.x.array[slice(None) if dofs is None else dofs]
        return u

    # -- cells ---------------------------------------------------------------------------------

    def cell_energies(self, x: PETSc.Vec, y: PETSc.Vec, given=None) -> tuple:
        """x^T K y and x^T M y of each cell that this rank owns, (n_owned_cells,) both. Integrals
        over facets are left out. Collective."""
        self.update(given)
        self._put(x)
        self._put(y, self._other)
        space, forms = self._cell_space()
        first = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        rows = space.dofmap.list[:first, 0]
        return tuple(
            np.zeros(first) if form is None else fem.assemble_vector(form).array[rows]
            for form in forms
        )

    def _cell_space(self):
        """Functions constant in each cell, and the forms of the cells' energies by them."""
        if self._by_cell is None:
            space = fem.functionspace(self.mesh, ("DG", 0))
            test, trial = self._arguments
            forms = []
            for form in (self._a, self._m):
                energy = ufl.replace(form, {test: self._vector, trial: self._other})
                inside = [
                    i.reconstruct(ufl.TestFunction(space) * i.integrand())
                    for i in energy.integrals()
                    if i.integral_type() == "cell"
                ]
                forms.append(fem.form(ufl.Form(inside)) if inside else None)
            self._by_cell = space, forms
        return self._by_cell

    # -- size, mass and pictures ---------------------------------------------------------------

    @property
    def has_displacement(self) -> bool:
        """Whether its space, or the named subspace, is one of displacements."""
        try:
            return self._space() is not None
        except InputError:
            return False

    def total_mass(self, given=None) -> float:
        """m(e, e) of a unit translation e along the first axis: the mass, kg. Collective."""
        self.update(given)
        W, dofs, _ = self._space()
        one = fem.Function(W)
        one.interpolate(lambda x: np.eye(self.mesh.geometry.dim)[0][:, None] + 0.0 * x[:1])
        self._vector.x.array[:] = 0.0
        self._vector.x.array[slice(None) if dofs is None else dofs] = one.x.array
        form = self._compiled("weight", lambda: self._energy(self._m))
        return self.comm.allreduce(fem.assemble_scalar(form))

    def dilation_frequency(self, given=None) -> float:
        """Order of the frequency, Hz, of a wave that crosses the mesh: a scale for shifts.

        The largest ratio of the diagonals of K and M is about the square of wave speed over cell
        size, whatever the fields are.

        Raises:
            InputError: If no degree of freedom has both stiffness and mass.
        """
        K, M = self.stiffness(given), self.mass(given)
        k, m = (A.getDiagonal().array_r.copy() for A in (K, M))
        K.destroy(), M.destroy()
        fastest = self.comm.allreduce(np.max(k[m > 0] / m[m > 0], initial=0.0), op=MPI.MAX)
        if not fastest > 0:
            raise InputError("a and m: no degree of freedom has both stiffness and mass.")
        tdim = self.mesh.topology.dim
        cells = np.arange(self.mesh.topology.index_map(tdim).size_local, dtype=np.int32)
        largest = self.mesh.h(tdim, cells).max(initial=0.0)
        size = self.comm.allreduce(float(largest), op=MPI.MAX)
        return float(np.sqrt(fastest) * size / np.max(self.size_m) / (2 * np.pi))

    @property
    def size_m(self) -> np.ndarray:
        """Extents of the mesh along the axes, m, (gdim,). Collective."""
        x = self.mesh.geometry.x[:, : self.mesh.geometry.dim]
        low, below = x.min(axis=0, initial=np.inf), (-x).min(axis=0, initial=np.inf)
        return -all_min(self.comm, below) - all_min(self.comm, low)

    def displacement(self, vector: PETSc.Vec) -> fem.Function:
        """A vector, owned entries, as a function on the mesh. Collective.

        Of a mixed space it is the displacement if `FormModel` was told which subspace is, and the
        whole otherwise.
        """
        W, dofs = self.V, None
        if self._displacement is not None:
            W, dofs = self.V.sub(self._displacement).collapse()
        return self._function(vector, W, dofs)

    def corner_motion(self, vectors: Sequence[PETSc.Vec]) -> tuple[np.ndarray, np.ndarray]:
        """Corners of all cells and how they move, see `Structure.corner_motion`. Collective."""
        W, dofs, element = self._space()
        return corner_motion([self._function(v, W, dofs) for v in vectors], W, element)


def _arguments(a: object, m: object) -> tuple:
    """Test and trial function of both forms.

    Raises:
        InputError: If they are no bilinear forms of the same two.
    """
    for name, form in (("a", a), ("m", m)):
        if not isinstance(form, ufl.Form) or len(form.arguments()) != 2:
            raise wanted(name, form, "a bilinear UFL form, of a trial and a test function")
    if a.arguments() != m.arguments():
        raise InputError("a and m: expected forms of the same trial and test function.")
    test, trial = a.arguments()
    if test.ufl_function_space() != trial.ufl_function_space():
        raise InputError("a: expected trial and test function of one space.")
    return test, trial

"""Joint laws in your own finite-element forms: thin layers of cells, or facets of no thickness.

A `JointField` holds what the joint remembers at its quadrature points, and gives the virtual work
of its stress as a UFL form; the consistent tangent is that form's ``ufl.derivative``. After every
converged step, `JointField.update` makes what is the new memory and adds up the energies. ::

    joint = JointField.layer(Iwan(backbone, 12), u, (0, 1), dx(3), normal_modulus=1e9)
    F = elasticity(u, v, E, nu, dx((1, 2))) + joint.residual - ufl.dot(load, v) * ds(4)
    J = ufl.derivative(F, u)

The memory of a layer lies in a space of quadrature elements. That of facets between two cells
cannot: DOLFINx has no functions there that forms over ``dS`` take in all versions, in 2-D and 3-D
and in parallel. It lies in a space that may jump between cells, with its nodes on the points of
the facets' own quadrature rule (Gauss-Lobatto; for tetrahedra their vertices), where it takes part
through its trace on one side: the same numbers at the same points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.forms.kinematics import layer_strain, stretched_gradient
from fenics_joints.joint_laws.law import JointLaw, check_names, is_rated


class PointValues:
    """Values of an expression at the nodes of a space that are the quadrature points of a measure.

    By a lumped projection: int e phi / int phi. Exact, since every shape function is one at its own
    point and zero at the others; a node that two facets of a cell share has their mean.

    Args:
        expression: UFL vector.
        space: Space of as many components, its nodes on the points.
        dx: Measure with those points as its quadrature rule.
        side: ``"+"`` if dx is a measure of interior facets, else None.
    """

    def __init__(
        self, expression, space: fem.FunctionSpace, dx: ufl.Measure, side: str | None = None
    ):
        self._space, comm = space, space.mesh.comm
        test = ufl.TestFunction(space)
        on = test if side is None else test(side)
        ones = ufl.as_vector([1.0] * expression.ufl_shape[0])
        self._form = fem.form(ufl.inner(expression, on) * dx)
        weights = self._assemble(fem.form(ufl.inner(ones, on) * dx))
        # Nodes away from the joint, where a shape function's trace is round-off.
        largest = comm.allreduce(float(np.abs(weights).max(initial=0.0)), op=MPI.MAX)
        self._inside = np.abs(weights) > 1e-9 * largest
        self._weights = np.where(self._inside, weights, 1.0)

    def _assemble(self, form) -> np.ndarray:
        """Assembled vector with ghosts."""
        dofmap = self._space.dofmap
        vector = la.vector(dofmap.index_map, dofmap.index_map_bs)
        vector.array[:] = 0.0
        fem.assemble_vector(vector.array, form)
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
        return vector.array.copy()

    def __call__(self) -> np.ndarray:
        """The values now, ghosts included; zero away from the measure. Collective."""
        return np.where(self._inside, self._assemble(self._form) / self._weights, 0.0)


#: Number of random sums over a joint's strains, and over its stresses, by which steps are compared;
#: and their difference, relative to the largest, up to which two steps are the same. Chosen: above
#: the tolerance of load steps, far below the difference of two steps of a cycle.
_PROJECTIONS, _SAME = 4, 1e-5


def tangents(normal, gdim: int) -> list:
    """Unit vectors in the plane of an interface: one in the plane, two in space.

    Args:
        normal: Unit normal, UFL vector of shape (gdim,).
        gdim: 2 or 3.

    Returns:
        UFL vectors of shape (gdim,); with ``normal`` first they are a right-handed frame in space.
    """
    if gdim == 2:
        return [ufl.as_vector([normal[1], -normal[0]])]
    # The axis that is not near the normal.
    along_x = ufl.gt(abs(normal[0]), 0.9)
    axis = ufl.as_vector(
        [ufl.conditional(along_x, 0.0, 1.0), ufl.conditional(along_x, 1.0, 0.0), 0]
    )
    first = axis - ufl.dot(axis, normal) * normal
    first = first / ufl.sqrt(ufl.dot(first, first))
    return [first, ufl.cross(normal, first)]


class JointField:
    """A joint law at the quadrature points of a layer or an interface; see `layer`, `interface`.

    Args:
        law: The law; its parameters are the same at all points, but for ``values``.
        u: Displacement, or what the strains depend on.
        strains: From a function like u to (normal strain, list of 1 or 2 shear strains), linear.
        dx: Measure over the joint, one subdomain, with its quadrature rule in the metadata.
        space: From a number of components to the space of what is remembered.
        side: ``"+"`` if dx is a measure of interior facets, else None.
        jacobian: Factor of the measure.
        normal_modulus: Normal stress per strain of a law that has none of its own, Pa (layer) or
            Pa/m (interface).
        unilateral: Whether that modulus meets compression only.
        values: Parameters of the law that vary in space, UFL scalars by name.
        step: Length of the steps, s, a number or UFL scalar such as a constant that changes, for a
            law with the rate of strain: that of the step.

    Attributes:
        law: The law.
        residual: Virtual work of the joint's stress, a form with the test function of u's space.
        state: What is remembered: the numbers of the first element, then those of the next.
        opening: UFL: normal strain.
        slip: UFL: shear strain, (n_slip,).
        stress: UFL: normal stress, Pa.
        traction: UFL: tangential stress, Pa, (n_slip,).
        work: Work done on the joint so far, J: of the mean of the stress before and after a step.
        dissipated: Energy turned to heat so far, J. A law without ``stored`` and ``dissipated``
            cannot tell it from what it stores: then it is the work of the cycles closed so far,
            those steps that have brought strain and stress back to where an earlier one left them.
    """

    def __init__(
        self,
        law: JointLaw,
        u: fem.Function,
        strains: Callable,
        dx: ufl.Measure,
        space: Callable,
        *,
        side: str | None = None,
        jacobian=1.0,
        normal_modulus=None,
        unilateral: bool = False,
        values: Mapping[str, object] | None = None,
        step=None,
    ):
        if law.n_points is not None:
            raise InputError(
                f"{law.label}: its parameters differ from point to point; expected numbers, with "
                "UFL expressions in `values` for those that vary."
            )
        if law.coupled and normal_modulus is not None:
            raise InputError(f"{law.label} has a normal stress of its own: expected no modulus.")
        if is_rated(law) and step is None:
            raise InputError(f"{law.label} asks for the rate of strain: expected a step, s.")
        self.law, self.u, self.dx, self.jacobian, self._step = law, u, dx, jacobian, step
        self._space = space
        self._side, self._comm = side, u.function_space.mesh.comm
        self._modulus, self._unilateral = normal_modulus, unilateral
        self.opening, slip = strains(u)
        self.slip = ufl.as_vector(slip)
        n, m = len(slip), law.state_size(len(slip))
        self._m = m
        self._parameters = self._constants(dict(values or {}))
        self.state = fem.Function(space(max(law.n_elements * m, 1)), name="state")
        self._last = fem.Function(space(2 * (1 + n)), name="last")  # strains, then stresses
        self._heat = fem.Function(space(1), name="dissipated")
        self._evaluate()
        v = ufl.TestFunction(u.function_space)
        opening, slips = strains(v)
        virtual = self.stress * opening
        virtual += sum(self.traction[i] * slips[i] for i in range(n))
        self.residual = jacobian * virtual * dx
        self.work = self.dissipated = 0.0
        self._prepare()

    # -- makers ------------------------------------------------------------------------------------

    @classmethod
    def layer(
        cls,
        law: JointLaw,
        u: fem.Function,
        normal,
        dx: ufl.Measure,
        *,
        degree: int = 2,
        stretch=None,
        **options,
    ) -> JointField:
        """A joint that is a thin layer of cells (`fenics_joints.forms.thin_layer`).

        Args:
            law: The law, of stress by strain.
            u: Displacement, m.
            normal: Unit normal of the layer: numbers, or UFL of shape (gdim,).
            dx: Cell measure over the layer, one subdomain.
            degree: Degree that the quadrature is exact for.
            stretch: Actual over meshed thickness; None is 1.
            options: ``normal_modulus`` (c33, Pa), ``unilateral``, ``values``, ``step``, see the
                class.
        """
        mesh = u.function_space.mesh
        normal = _normal(normal, mesh)
        frame = tangents(normal, mesh.geometry.dim)

        def strains(w):
            eps, gamma = layer_strain(stretched_gradient(w, normal, stretch), normal)
            return eps, [ufl.dot(gamma, t) for t in frame]

        def space(size):
            cell = mesh.topology.cell_name()
            element = basix.ufl.quadrature_element(cell, (size,), degree=degree)
            return fem.functionspace(mesh, element)

        rule = {"quadrature_degree": degree, "quadrature_rule": "default"}
        jacobian = 1.0 if stretch is None else stretch
        return cls(law, u, strains, dx(metadata=rule), space, jacobian=jacobian, **options)

    @classmethod
    def interface(
        cls, law: JointLaw, u: fem.Function, normal, dS: ufl.Measure, *, degree: int = 1, **options
    ) -> JointField:
        """A joint of no thickness on facets between cells, across which u can jump.

        Args:
            law: The law, of stress by opening and slip, m.
            u: Displacement, m, of a space that can jump at the facets.
            normal: Direction from the lower to the upper side, numbers or UFL; needed for the signs
                of opening and slip alone on plane facets.
            dS: Interior-facet measure over the interface, one subdomain. In parallel the mesh needs
                ``GhostMode.shared_facet``.
            degree: Degree of the points on a facet: 1 its vertices, 2 middles too, and so on;
                1 in tetrahedra.
            options: ``normal_modulus`` (k_n, Pa/m), ``unilateral``, ``values``, ``step``, see the
                class.

        Raises:
            InputError: For a degree that the cells do not have.
        """
        mesh = u.function_space.mesh
        cell = mesh.topology.cell_name()
        if degree < 1 or (cell == "tetrahedron" and degree != 1):
            raise InputError(
                f"degree = {degree}: expected 1{'' if cell[0] == 't' else ' or more'}."
            )
        normal = _normal(normal, mesh)
        frame = tangents(normal, mesh.geometry.dim)
        # Which side DOLFINx calls "+" differs from facet to facet.
        sign = ufl.sign(ufl.dot(ufl.FacetNormal(mesh)("+"), normal("+")))

        def strains(w):
            jump = sign * (w("-") - w("+"))
            return ufl.dot(jump, normal("+")), [ufl.dot(jump, t("+")) for t in frame]

        def space(size):
            element = basix.ufl.element(
                "Lagrange",
                cell,
                degree,
                basix.LagrangeVariant.gll_warped,
                shape=(size,),
                discontinuous=True,
            )
            return fem.functionspace(mesh, element)

        rule = {"quadrature_rule": "vertex", "quadrature_degree": 1}
        if degree > 1:
            rule = {"quadrature_rule": "GLL", "quadrature_degree": 2 * degree - 1}
        return cls(law, u, strains, dS(metadata=rule), space, side="+", **options)

    # -- forms -------------------------------------------------------------------------------------

    def _constants(self, values: dict) -> list[dict]:
        """Parameters of each element, UFL scalars; the law's numbers are constants of the mesh."""
        law, mesh = self.law, self.u.function_space.mesh
        check_names(f"values: {law.label}", values, law.parameters)
        numbers = law.values(1)[0]
        made = {
            key: fem.Constant(mesh, np.ascontiguousarray(numbers[:, i], dtype=PETSc.ScalarType))
            for i, key in enumerate(law.parameters)
        }
        fields = {key: self._on(ufl.as_ufl(value)) for key, value in values.items()}
        return [
            {key: fields.get(key, made[key][i]) for key in law.parameters}
            for i in range(law.n_elements)
        ]

    def _on(self, expression):
        """An expression at the points of the joint."""
        return expression if self._side is None else expression(self._side)

    def _at(self, expression, space: fem.FunctionSpace) -> PointValues:
        """An expression's values at the points, which are the nodes of a space."""
        return PointValues(expression, space, self.dx, self._side)

    def _slices(self, state):
        """The state of each element, UFL vectors; None for a law without memory."""
        m, state = self._m, self._on(state)
        for i in range(self.law.n_elements):
            yield ufl.as_vector([state[i * m + j] for j in range(m)]) if m else None

    def _evaluate(self) -> None:
        """Stress, new state, stored energy and heat of a step, as UFL."""
        law, n = self.law, self.slip.ufl_shape[0]
        stress, traction, new = ufl.as_ufl(0.0), [ufl.as_ufl(0.0)] * n, []
        stored, heat = [], []
        for old, p in zip(self._slices(self.state), self._parameters, strict=True):
            sigma, tau, made = law.element(self.opening, self.slip, old, p, **self._rate())
            stress += sigma
            traction = [traction[i] + tau[i] for i in range(n)]
            new += [made[i] for i in range(self._m)]
            stored.append(law.stored(self.opening, self.slip, made, p))
            heat.append(law.dissipated(self.opening, self.slip, old, made, p))
        pressure, pressed = self._pressed()
        self.stress = stress + pressure
        self.traction = ufl.as_vector(traction)
        self._new = ufl.as_vector(new or [ufl.as_ufl(0.0)])
        known = None if self._m and None in stored else [e for e in stored if e is not None]
        self._energies = {
            "work": self._work(),
            "stored": None if known is None else sum(known, pressed),
            "heat": None if None in heat else sum(heat, ufl.as_ufl(0.0)),
        }

    def _rate(self) -> dict:
        """Rate of strain of the step, for a law that asks for it."""
        if not is_rated(self.law):
            return {}
        last, step = self._on(self._last), self._on(ufl.as_ufl(self._step))
        now = [self.opening, *(self.slip[i] for i in range(self.slip.ufl_shape[0]))]
        return {"rate": ufl.as_vector([(e - last[i]) / step for i, e in enumerate(now)])}

    def _pressed(self):
        """Stress and energy of the normal modulus."""
        if self._modulus is None:
            return ufl.as_ufl(0.0), ufl.as_ufl(0.0)
        modulus, strain = self._on(ufl.as_ufl(self._modulus)), self.opening
        if self._unilateral:
            strain = ufl.min_value(strain, 0.0)
        return modulus * strain, 0.5 * modulus * strain**2

    def _present(self) -> list:
        """Strains, then stresses, of the present step."""
        n = self.slip.ufl_shape[0]
        strains = [self.opening, *(self.slip[i] for i in range(n))]
        return strains + [self.stress, *(self.traction[i] for i in range(n))]

    def _work(self):
        """Work of the step, by the trapezoidal rule, per area or volume."""
        now, last = self._present(), self._on(self._last)
        n = len(now) // 2
        return sum(0.5 * (now[n + i] + last[n + i]) * (now[i] - last[i]) for i in range(n))

    # -- steps -------------------------------------------------------------------------------------

    def _prepare(self) -> None:
        """Compile once what every update needs."""
        self._forms = {
            key: None if e is None else fem.form(self.jacobian * e * self.dx)
            for key, e in self._energies.items()
        }
        heat = self._energies["work" if self._energies["heat"] is None else "heat"]
        self._forget_steps()
        if self._energies["heat"] is None and self._energies["stored"] is None:
            self._projections = np.random.default_rng(0).standard_normal(
                (_PROJECTIONS, self._last.x.array.size)
            )
        self._points = {
            "last": self._at(ufl.as_vector(self._present()), self._last.function_space),
            "heat": self._at(ufl.as_vector([heat]), self._heat.function_space),
        }
        if self._m:
            self._points["state"] = self._at(self._new, self.state.function_space)
        self._before = self.stored() or 0.0

    def _sum(self, key: str) -> float | None:
        form = self._forms[key]
        return None if form is None else integral(self._comm, form)

    def stored(self) -> float | None:
        """Energy, J, in the joint's springs now; None for a law that does not tell. Collective."""
        return self._sum("stored")

    def update(self) -> None:
        """Take the present strain as converged: remember it, and add up the energies. Collective.

        To be called once after every converged step, and at no other time.
        """
        work, heat, stored = self._sum("work"), self._sum("heat"), self.stored()
        self.work += work
        if heat is None and stored is not None:
            heat = work - (stored - self._before)
        self.dissipated += heat or 0.0
        self._before = stored or 0.0
        # All from the old memory, then all at once.
        new = {key: points() for key, points in self._points.items()}
        self.state.x.array[:] = new["state"] if self._m else 0.0
        self._last.x.array[:] = new["last"]
        self._heat.x.array[:] += new["heat"]
        if heat is None:
            self._close_cycle()

    def _close_cycle(self) -> None:
        """Add the work since the last step that left strain and stress as they are now."""
        last, n = self._last, 2 * (1 + self.slip.ufl_shape[0])
        own = last.function_space.dofmap.index_map.size_local * n
        parts = self._projections[:, :own] * last.x.array[:own]
        now = self._comm.allreduce(parts.reshape(_PROJECTIONS, -1, 2, n // 2).sum(axis=(1, 3)))
        self._scale = np.maximum(self._scale, np.abs(now).max(axis=0))
        count = self._steps
        same = np.all(np.abs(self._reached[:count] - now) <= _SAME * self._scale, axis=(1, 2))
        if same.any():
            work, dissipated = self._sums[np.flatnonzero(same)[-1]]
            self.dissipated = max(self.dissipated, dissipated + self.work - work)
        if count == len(self._reached):  # room for as many again
            self._reached, self._sums = (
                np.concatenate([a, np.empty((count + 64, *a.shape[1:]))])
                for a in (self._reached, self._sums)
            )
        self._reached[count], self._sums[count] = now, (self.work, self.dissipated)
        self._steps += 1

    def _forget_steps(self) -> None:
        """No steps yet whose strain and stress may come back."""
        self._reached, self._sums = np.empty((0, _PROJECTIONS, 2)), np.empty((0, 2))
        self._scale, self._steps = np.zeros(2), 0

    def reset(self) -> None:
        """Forget everything: a joint that never moved."""
        for function in (self.state, self._last, self._heat):
            function.x.array[:] = 0.0
        self.work = self.dissipated = self._before = 0.0
        self._forget_steps()

    # -- outputs -----------------------------------------------------------------------------------

    def values(self, expression) -> fem.Function:
        """An expression at the joint's points, in the space of its memory. Collective.

        Args:
            expression: UFL scalar or vector at the joint, such as ``joint.slip``.
        """
        parts = (
            [expression[i] for i in range(expression.ufl_shape[0])]
            if expression.ufl_shape
            else [expression]
        )
        function = fem.Function(self._space(len(parts)))
        function.x.array[:] = self._at(ufl.as_vector(parts), function.function_space)()
        return function

    @property
    def dissipation(self) -> fem.Function:
        """Energy turned to heat so far at each point, J/m3 (layer) or J/m2 (interface).

        For a law that does not tell heat from energy, the work done.
        """
        return self._heat


def integral(comm: MPI.Intracomm, form: fem.Form) -> float:
    """Value of a scalar form. Collective."""
    return float(comm.allreduce(np.real(fem.assemble_scalar(form)), op=MPI.SUM))


def _normal(normal, mesh):
    """A unit normal as UFL; numbers become unit length."""
    gdim = mesh.geometry.dim
    if isinstance(normal, ufl.core.expr.Expr):
        shape = normal.ufl_shape
    else:
        normal = np.asarray(normal, dtype=float)
        shape, length = normal.shape, np.linalg.norm(normal)
        if shape == (gdim,) and 0 < length < np.inf:
            normal = fem.Constant(mesh, (normal / length).astype(PETSc.ScalarType))
    if shape != (gdim,) or isinstance(normal, np.ndarray):
        raise InputError(f"normal has shape {shape}: expected a vector of {gdim} numbers, not 0.")
    return normal

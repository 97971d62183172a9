"""Load steps of a structure with joints that remember, each solved by PETSc's SNES."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.joint_laws.field import JointField, integral
from fenics_joints.modal.options import given_options, petsc_defaults, reason_of

_OPTIONS = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_rtol": 1e-9,
    "snes_atol": 1e-12,
    "snes_stol": 0.0,
    "snes_max_it": 30,
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
}


@dataclass(repr=False)
class QuasiStaticHistory:
    """Results of a sequence of load steps; arrays have one entry for each step.

    Attributes:
        load: Load of each step, (n,) or in the shape of the steps.
        outputs: Values of the outputs by name, (n,).
        stored: Energy in the joints, J, (n,); nan where a law does not tell.
        work: Work done on the joints so far, J, (n,).
        dissipated: Energy that they turned to heat so far, J, (n,), which never falls. For a law
            without energies, the work of the closed cycles so far, see `JointField`.
        iterations: Newton iterations, (n,).
        residuals: Norms of the residual of each step, first to last.
    """

    load: np.ndarray
    outputs: dict[str, np.ndarray]
    stored: np.ndarray
    work: np.ndarray
    dissipated: np.ndarray
    iterations: np.ndarray
    residuals: list[np.ndarray] = field(default_factory=list)

    def __repr__(self) -> str:
        outputs = ", ".join(self.outputs) or "no outputs"
        return f"QuasiStaticHistory({len(self.load)} steps, {outputs})"


class QuasiStatic:
    """A nonlinear problem F(u) = 0 with joints, and the SNES that solves it.

    Args:
        residual: Form F with one test function, joints included.
        u: The unknown.
        bcs: Dirichlet conditions; their functions or constants may change between steps.
        joints: The joints, which are updated after each converged step.
        petsc_options: SNES, KSP and PC options without prefix, over the defaults: Newton with a
            backtracking line search, and MUMPS. ``snes_rtol`` is relative to the first residual of
            the step, or to the largest first residual of the steps before if that is larger.
        prefix: Options prefix of ``solver``.

    Attributes:
        solver: The ``PETSc.SNES``.
        residuals: Norms of the residual in the last solve.
    """

    def __init__(
        self,
        residual: ufl.Form,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC] = (),
        joints: Sequence[JointField] = (),
        *,
        petsc_options: Mapping[str, object] | None = None,
        prefix: str = "joints_quasi_static_",
    ):
        self.u, self.bcs, self.joints = u, list(bcs), list(joints)
        self._F = fem.form(residual)
        self._J = fem.form(ufl.derivative(residual, u))
        self._A = petsc.assemble_matrix(self._J, bcs=self.bcs)
        self._A.assemble()
        self._b, self._x = self._A.createVecLeft(), self._A.createVecRight()
        self.residuals: np.ndarray = np.empty(0)
        self.solver = self._snes({**_OPTIONS, **given_options(petsc_options)}, prefix)
        self._atol, self._largest = self.solver.getTolerances()[1], 0.0

    def _snes(self, options: Mapping[str, object], prefix: str) -> PETSc.SNES:
        snes = PETSc.SNES().create(self.u.function_space.mesh.comm)
        snes.setOptionsPrefix(prefix)
        snes.setFunction(self._function, self._b)
        snes.setJacobian(self._jacobian, self._A)
        with petsc_defaults(prefix, options):
            snes.setFromOptions()
        snes.setConvergenceHistory()
        return snes

    def _set(self, x: PETSc.Vec) -> None:
        """Take the solver's vector as the unknown, ghosts included."""
        owned = len(x.array_r)
        self.u.x.array[:owned] = x.array_r
        self.u.x.scatter_forward()

    def _function(self, snes, x: PETSc.Vec, b: PETSc.Vec) -> None:
        self._set(x)
        assembled = petsc.assemble_vector(self._F)
        ghosted = self.u.x.petsc_vec
        petsc.apply_lifting(assembled, [self._J], [self.bcs], [ghosted], -1.0)
        assembled.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        petsc.set_bc(assembled, self.bcs, ghosted, -1.0)
        assembled.copy(b)
        assembled.destroy()

    def _jacobian(self, snes, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._set(x)
        P.zeroEntries()
        petsc.assemble_matrix(P, self._J, bcs=self.bcs)
        P.assemble()
        if J != P:
            J.assemble()

    def solve(self) -> int:
        """Solve for u and update the joints; returns the number of iterations. Collective.

        Raises:
            ConvergenceError: If SNES stops before it converged; u is then as it was before.
        """
        before = self.u.x.array.copy()
        self._x.array[:] = before[: len(self._x.array_r)]
        # A step that hardly changes the load starts at round-off: no falling further from there.
        rtol = self.solver.getTolerances()[0]
        self.solver.setTolerances(atol=max(self._atol, rtol * self._largest))
        self.solver.solve(None, self._x)
        norms = np.array(self.solver.getConvergenceHistory()[0])
        if self.solver.getConvergedReason() < 0:
            self.u.x.array[:] = before
            raise ConvergenceError(
                "a load step did not converge: try smaller steps", reason_of(self.solver)
            )
        self._set(self._x)
        self.residuals = norms[-(self.solver.getIterationNumber() + 1) :]
        self._largest = max(self._largest, self.residuals[0])
        for joint in self.joints:
            joint.update()
        return self.solver.getIterationNumber()


def solve_quasi_static(
    residual: ufl.Form,
    u: fem.Function,
    steps: Iterable,
    apply: Callable[[object], None],
    *,
    bcs: Sequence[fem.DirichletBC] = (),
    joints: Sequence[JointField] = (),
    outputs: Mapping[str, ufl.Form] | None = None,
    petsc_options: Mapping[str, object] | None = None,
    prefix: str = "joints_quasi_static_",
) -> QuasiStaticHistory:
    """Solve a sequence of load steps, and return their history. Collective.

    Args:
        residual: Form F(u; v) = 0, joints included.
        u: The unknown, at rest.
        steps: Loads, one for each step.
        apply: Called with each load, sets constants and boundary values.
        bcs: Dirichlet conditions.
        joints: The joints in ``residual``.
        outputs: Scalar forms by name, evaluated after each step. A reaction is
            ``ufl.action(residual, phi)`` with phi the displacement that the support holds.
        petsc_options: See `QuasiStatic`.
        prefix: See `QuasiStatic`.

    Raises:
        ConvergenceError: If a step does not converge, with PETSc's reason.
        InputError: Without steps.
    """
    problem = QuasiStatic(residual, u, bcs, joints, petsc_options=petsc_options, prefix=prefix)
    forms = {name: fem.form(form) for name, form in (outputs or {}).items()}
    comm = u.function_space.mesh.comm
    rows, loads, residuals = [], [], []
    for number, load in enumerate(steps):
        apply(load)
        try:
            iterations = problem.solve()
        except ConvergenceError as error:
            raise ConvergenceError(f"load step {number} (load {load}): {error}") from error
        rows.append([iterations, *_energies(joints), *(integral(comm, f) for f in forms.values())])
        loads.append(load)
        residuals.append(problem.residuals)
    if not rows:
        raise InputError("steps is empty: expected at least one load.")
    iterations, stored, work, dissipated, *values = np.array(rows, dtype=float).T
    return QuasiStaticHistory(
        np.array(loads),
        dict(zip(forms, values, strict=True)),
        stored,
        work,
        dissipated,
        iterations.astype(int),
        residuals,
    )


def _energies(joints: Sequence[JointField]) -> tuple[float, float, float]:
    """Stored, work done, dissipated, J, in all joints."""
    stored = [joint.stored() for joint in joints]
    return (
        sum(np.nan if e is None else e for e in stored),
        sum(joint.work for joint in joints),
        sum(joint.dissipated for joint in joints),
    )

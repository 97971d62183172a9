"""Preload contact: bodies pressed together by bolts, solved by PETSc's SNES."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal.options import petsc_defaults
from fenics_joints.preload.conditions import Pairs, Penalty
from fenics_joints.preload.hold import Hold, find_hold
from fenics_joints.preload.interface import Interface
from fenics_joints.preload.jumps import Jumps
from fenics_joints.preload.model import PreloadModel
from fenics_joints.preload.newton import NewtonMatrix, NewtonPreconditioner
from fenics_joints.preload.result import PreloadResult

__all__ = ["METHODS", "PreloadSolver", "solve_preload"]

METHODS = ("semismooth", "vi", "penalty")

#: Relative to the loads; the last Newton step is exact, so it lands at round-off.
_TOLERANCE = 1e-10
#: Round-off of a residual, relative to the products of which it is the sum.
_ROUND_OFF = 10 * np.finfo(float).eps
#: Relative to the loads; never is a larger residual taken for round-off.
_LEAST_ACCURATE = 1e-6
_OPTIONS = {
    "snes_linesearch_type": "basic",
    "ksp_type": "preonly",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_14": "40",
}
_NEWTON_OPTIONS = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",
    "ksp_type": "gmres",
    "ksp_pc_side": "right",
    "ksp_rtol": "1e-9",
    # After pairs changed, the preconditioned matrix is far from normal: orthogonalise twice.
    "ksp_gmres_cgs_refinement_type": "refine_always",
    "ksp_max_it": "100",
    "ksp_gmres_restart": "100",
    # What a slow step leaves, the next one takes, with a new factorisation.
    "snes_max_linear_solve_fail": "10",
    "pc_type": "python",
}
_HELP = (
    "Try, in this order: the force in several steps, each from the result before (initial=...); "
    "no friction first; method='penalty' with a stiffness of about E over the thickness; a finer "
    "mesh where the contact ends; and check that the parts can rest against one another at all."
)


class PreloadSolver:
    """Solver for one model and material; keeps the matrix, what holds it, and the ordering.

    Args:
        model: The model.
        given: Values of the structure's parameters that differ from their nominal value.
        method: ``semismooth`` (Newton on the conditions of `fenics_joints.preload.conditions`),
            ``vi`` (SNES vinewtonrsls on bounds of the openings; no friction), ``penalty``, or None
            for ``semismooth``.
        penalty: Stiffness per area, Pa/m, of method ``penalty``.
        petsc_options: Options of SNES, KSP and PC, without prefix. Those of the symmetric system in
            each Newton step (see `fenics_joints.preload.newton`) begin with ``held_``, such as
            ``held_pc_type``; with a ``pc_type`` of your own the Newton matrix is assembled for it.
        prefix: Options prefix.

    Raises:
        InputError: For a method that is unknown or does not fit.

    Attributes:
        solver: PETSc's SNES of the last solution.
        K: The stiffness in x.
        hold: What holds the free bodies.
        newton: The Newton steps' factorisation, kept for the next solution; None before the first.
    """

    def __init__(
        self,
        model: PreloadModel,
        given: Mapping[str, float] | None = None,
        *,
        method: str | None = None,
        penalty: float | None = None,
        petsc_options: Mapping[str, object] | None = None,
        prefix: str = "preload_",
    ):
        self.model, self.given = model, dict(given or {})
        self.method = method or "semismooth"
        self.penalty = penalty
        self._check()
        self.petsc_options, self.prefix = dict(petsc_options or {}), prefix
        self.K = model.stiffness(self.given)
        self.hold: Hold = find_hold(model, self.K)
        self.fixed = self._fixed()
        self.pairs = _pairs(model, self.K, penalty if self.method == "penalty" else None)
        # Held entries: their row is x = 0. Their columns need not go, as x is zero there.
        self.held = self.K.copy()
        self.held.zeroRowsColumns(self.fixed.astype(np.int32), diag=_mean_diagonal(self.K))
        self.solver: PETSc.SNES | None = None
        self._left: PETSc.Mat | None = None
        self.newton: NewtonPreconditioner | None = None

    def _check(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"method = {self.method!r}: expected one of {', '.join(METHODS)}.")
        rough = [c.name for c in self.model.contacts if c.friction > 0]
        if self.method == "vi" and rough:
            raise InputError(
                f"method = 'vi' has no friction, but {', '.join(rough)} has; expected 'semismooth'."
            )
        if (self.method == "penalty") != (self.penalty is not None):
            raise InputError("penalty: expected a stiffness, Pa/m, exactly with method='penalty'.")
        if self.penalty is not None and not (np.isfinite(self.penalty) and self.penalty > 0):
            raise InputError(f"penalty = {self.penalty}: expected a stiffness > 0, Pa/m.")
        if not self.model.contacts:
            raise InputError("the model has no contact that can open; expected at least one.")

    def _fixed(self) -> np.ndarray:
        """Global numbers of owned entries held at zero: pins, supports, bubbles."""
        jumps = self.model.jumps
        numbers = [self.hold.pins, self.model.supported]
        numbers += [jumps.bubbles(c).ravel() for c in jumps.contacts]
        numbers = np.unique(np.concatenate(numbers))
        return numbers[jumps.owned(numbers)]

    def solve(
        self,
        forces: Mapping[str, float] | None = None,
        *,
        initial: PreloadResult | None = None,
        monitor: Callable[[int, float], None] | None = None,
    ) -> PreloadResult:
        """Find the state under these forces. Collective.

        Args:
            forces: Bolt forces, N, and factors of loads that differ from the nominal.
            initial: The state before, from which friction has its history; its contact is also
                where the iteration starts. None for the unloaded bodies.
            monitor: Called with the number of the iteration and the residual norm, N.

        Returns:
            The converged state.

        Raises:
            ConvergenceError: If SNES does not converge; says what to try.
            InputError: If the loads drive a free body.
        """
        load = self.model.load(forces)
        balance = self.hold.balance(load, lambda: self.model.mass(self.given))
        pairs = self.pairs
        if initial is not None:
            _, tangent = pairs.split(initial.x.array_r)
            pairs = replace(pairs, slip=tangent.copy())
        x = load.duplicate()
        x.set(0.0)
        if initial is not None:
            initial.x.copy(x)
        work = _Equations(self, pairs, load, start=initial is None)
        self._run(work, x, monitor)
        return PreloadResult(self, pairs, self.model.force_values(forces), x, load, work.iterations,
                             balance)  # fmt: skip

    # -- SNES --------------------------------------------------------------------------------

    def _run(self, work: _Equations, x: PETSc.Vec, monitor) -> None:
        snes = PETSc.SNES().create(self.model.comm)
        snes.setOptionsPrefix(self.prefix)
        snes.setFunction(work.function, x.duplicate())
        snes.setTolerances(rtol=0.0, atol=_TOLERANCE * work.scale(), stol=0.0, max_it=work.patience)
        snes.getKSP().setOptionsPrefix(self.prefix)
        options = dict(_OPTIONS)
        if self.method == "vi":
            # PETSc's tolerance of 1e-8 m is more than the openings under a small force.
            options |= {"snes_type": "vinewtonrsls", "pc_type": "cholesky",
                        "snes_vi_zero_tolerance": 0.0}  # fmt: skip
            snes.setJacobian(work.stiffness, self.held)
            snes.setVariableBounds(*work.bounds(x))
            work.close(x)
        elif self._assembled():
            options |= {"snes_type": "newtonls", "pc_type": "lu"}
            snes.setJacobian(work.jacobian, work.matrix())
        else:
            options = dict(_NEWTON_OPTIONS)
            snes.setJacobian(work.jacobian, work.shell())
            pc = snes.getKSP().getPC()
            pc.setType("python")
            pc.setPythonContext(self._preconditioner())
        if monitor is not None:
            snes.setMonitor(lambda _, i, norm: monitor(i, norm))
        with petsc_defaults(self.prefix, options | self.petsc_options):
            snes.setFromOptions()
            snes.setUpdate(work.allow_round_off)
            try:
                snes.solve(None, x)
            except PETSc.Error as error:
                raise ConvergenceError(f"the preload contact was not solved. {_HELP}",
                                       _last_line(error)) from error  # fmt: skip
        self._replace(snes)
        work.iterations = snes.getIterationNumber()
        reason = snes.getConvergedReason()
        if reason <= 0:
            raise ConvergenceError(
                f"the preload contact did not converge in {work.iterations} iterations (residual "
                f"{snes.getFunctionNorm():.2e} N of {work.scale():.2e} N). {_HELP}",
                _reason(reason),
            )

    def _assembled(self) -> bool:
        """Whether the user's options want a preconditioner that needs the Newton matrix itself."""
        given = self.petsc_options.get("pc_type", "python")
        return PETSc.Options(self.prefix).getString("pc_type", str(given)) != "python"

    def _preconditioner(self) -> NewtonPreconditioner:
        """That of all solutions, made with the first."""
        if self.newton is None:
            prefix = self.prefix + "held_"
            given = {k[5:]: v for k, v in self.petsc_options.items() if k.startswith("held_")}
            options = {**_OPTIONS, "pc_type": "cholesky", **given}
            self.newton = NewtonPreconditioner(self.held, prefix, options)
        return self.newton

    def combine(self, pairs: Pairs, A: np.ndarray, B: np.ndarray, out=None) -> PETSc.Mat:
        """The matrix A K + B, with blocks A and B, (n, gdim, gdim), at the pairs; A is 1 elsewhere.

        Args:
            pairs: The pairs.
            A: Blocks that combine the rows of K.
            B: Blocks that are added.
            out: The matrix of an earlier call, to assemble into.
        """
        rows = self.model.jumps.globals(pairs.numbers)
        n, gdim = rows.shape
        columns = np.repeat(rows[:, None, :], gdim, axis=1)
        csr = (
            np.arange(0, n * gdim * gdim + 1, gdim, dtype=np.int32),
            columns.ravel().astype(np.int32),
        )
        rowmap = rows.ravel().astype(np.int32)
        if self._left is None:
            self._left = self._identity(gdim)
        self._left.setValuesIJV(*csr, A.ravel(), rowmap=rowmap)
        self._left.assemble()
        out = self._left.matMult(self.held, result=out)
        out.setValuesIJV(*csr, B.ravel(), addv=PETSc.InsertMode.ADD_VALUES, rowmap=rowmap)
        out.assemble()
        return out

    def _identity(self, gdim: int) -> PETSc.Mat:
        """Identity with room for full blocks at the pairs."""
        left = PETSc.Mat().createAIJ(self.held.getSizes(), nnz=(gdim, 0), comm=self.held.comm)
        low, high = left.getOwnershipRange()
        for i in range(low, high):
            left.setValue(i, i, 1.0)
        return left

    def _replace(self, snes: PETSc.SNES) -> None:
        if self.solver is not None:
            self.solver.destroy()
        self.solver = snes

    def forget(self) -> None:
        """Free the factorisation; the next solution makes its own. Collective."""
        if self.newton is not None:
            self.newton.free()
        self.newton = None

    def destroy(self) -> None:
        """Free matrices and factorisations. Collective."""
        for owned in (self.solver, self.K, self.held, self._left):
            if owned is not None:
                owned.destroy()
        self.solver = None
        self.forget()


class _Equations:
    """Residual and Jacobian of one solution, as SNES calls them."""

    def __init__(self, solver: PreloadSolver, pairs: Pairs, load: PETSc.Vec, start: bool):
        self.solver, self.pairs, self.load = solver, pairs, load
        self.start, self.iterations = start, 0
        self.rows = load.duplicate()
        own = solver.model.jumps
        self.pins = own.local(solver.fixed)
        self._norm = self._atol = None
        # A slip front in a thin strip walks one vertex in an iteration.
        self.patience = 100 if any(c.friction > 0 for c in solver.model.contacts) else 40

    def scale(self) -> float:
        """A force, N, to which residuals are compared: loads, or what closing the gaps takes."""
        if self._norm is None:
            closing = self.load.duplicate()
            closing.set(0.0)
            closing.array[self.pairs.numbers[:, 0]] = np.minimum(self.pairs.gap, 0.0)
            force = self.solver.K * closing
            self._norm = max(self.load.norm(), force.norm(), np.finfo(float).tiny)
        return self._norm

    def allow_round_off(self, snes: PETSc.SNES, _: int) -> None:
        """Ask for no residual below round-off, which nearly rigid parts make large.

        Up to a limit, lest bodies that fly apart, whose round-off is boundless, seem to rest.
        """
        if self._atol is None:
            self._atol = snes.getTolerances()[1]
        products = self.solver.held.getDiagonal()
        products.pointwiseMult(products, snes.getSolution())
        least = min(_ROUND_OFF * products.norm(), _LEAST_ACCURATE * self.scale())
        snes.setTolerances(atol=max(self._atol, least))
        products.destroy()

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Rows of K x - f; of held entries x itself, times a stiffness."""
        self.solver.held.mult(x, r)
        r.axpy(-1.0, self.load)
        r.array[self.pins] += self.load.array_r[self.pins]

    def function(self, snes, x: PETSc.Vec, F: PETSc.Vec) -> None:
        """SNES's function."""
        self.residual(x, F)
        if self.solver.method == "vi":
            return
        values, at = F.array_r.copy(), x.array_r
        if self.start:
            left = self.pairs.closed(at, values)
        else:
            left = self.pairs.equations(at, values)
        F.array[self.pairs.numbers] = left

    def matrix(self) -> PETSc.Mat:
        """The Jacobian's matrix, A K + B, with the pattern of its rows."""
        return self._assemble(*self.pairs.closed_tangent())

    def shell(self) -> PETSc.Mat:
        """The Jacobian as a product, of which nothing is assembled."""
        return NewtonMatrix(self.solver.held, self.pairs.numbers).matrix()

    def jacobian(self, snes, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """SNES's Jacobian; the first one closes all contacts."""
        if self.start:
            A, B = self.pairs.closed_tangent()
            self.start = False
        else:
            self.residual(x, self.rows)
            A, B = self.pairs.tangent(x.array_r, self.rows.array_r)
        if P.getType() == "python":
            context = P.getPythonContext()
            context.A, context.B = A, B
            P.assemble()
        else:
            self._assemble(A, B, P)
        if J != P:
            J.assemble()

    def _assemble(self, A: np.ndarray, B: np.ndarray, out: PETSc.Mat | None = None) -> PETSc.Mat:
        return self.solver.combine(self.pairs, A, B, out)

    def stiffness(self, snes, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """SNES's Jacobian of method vi: constant."""

    def bounds(self, x: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec]:
        """Bounds of x: openings above minus the initial gap."""
        low, high = x.duplicate(), x.duplicate()
        low.set(PETSc.NINFINITY), high.set(PETSc.INFINITY)
        low.array[self.pairs.numbers[:, 0]] = -self.pairs.gap
        return low, high

    def close(self, x: PETSc.Vec) -> None:
        """Put x into the state of bilateral contact, from which vinewtonrsls starts."""
        A, B = self.pairs.closed_tangent()
        J, F = self._assemble(A, B), x.duplicate()
        self.residual(x, F)
        F.array[self.pairs.numbers] = self.pairs.closed(x.array_r, F.array_r)
        ksp = PETSc.KSP().create(self.solver.model.comm)
        ksp.setOptionsPrefix(self.solver.prefix + "close_")
        with petsc_defaults(self.solver.prefix + "close_", {**_OPTIONS, "pc_type": "lu"}):
            ksp.setFromOptions()
        ksp.setOperators(J)
        step = x.duplicate()
        ksp.solve(F, step)
        x.axpy(-1.0, step)
        x.array[self.pairs.numbers[:, 0]] = -self.pairs.gap
        ksp.destroy(), J.destroy()


def solve_preload(
    model: PreloadModel,
    forces: Mapping[str, float] | None = None,
    given: Mapping[str, float] | None = None,
    *,
    initial: PreloadResult | None = None,
    **options,
) -> PreloadResult:
    """Solve one preload; see `PreloadSolver`, whose options it takes."""
    return PreloadSolver(model, given, **options).solve(forces, initial=initial)


def _pairs(model: PreloadModel, K: PETSc.Mat, penalty: float | None) -> Pairs:
    """The pairs that this rank owns."""
    jumps = model.jumps
    diagonal = K.getDiagonal()
    columns = {key: [] for key in ("numbers", "gap", "friction", "scale", "areas")}
    for contact, c in zip(model.contacts, jumps.contacts, strict=True):
        mine = jumps.owned(jumps.opening(c))
        numbers = np.column_stack([jumps.opening(c), jumps.slips(c)])[mine]
        local = jumps.local(numbers.ravel()).reshape(numbers.shape)
        columns["numbers"].append(local)
        columns["gap"].append(c.gap[mine])
        columns["friction"].append(np.full(mine.sum(), contact.friction))
        columns["scale"].append(_stiffness_at(jumps, diagonal, c)[mine])
        columns["areas"].append(c.areas[mine])
    arrays = {key: np.concatenate(parts) for key, parts in columns.items()}
    arrays["slip"] = np.zeros((len(arrays["gap"]), jumps.gdim - 1))
    return Pairs(**arrays) if penalty is None else Penalty(**arrays, stiffness=penalty)


def _stiffness_at(jumps: Jumps, diagonal: PETSc.Vec, c: Interface) -> np.ndarray:
    """Stiffness, N/m, (n,), of the two bodies at each pair in series, from K's diagonal in x.

    An entry of the lower body moves both bodies, a jump the upper one alone.
    """
    axes = np.arange(jumps.gdim)
    both, upper = (
        jumps.gather(diagonal, nodes[:, None] * jumps.gdim + axes).mean(axis=1)
        for nodes in (c.lower, c.upper)
    )
    lower = both - upper
    return np.where(lower > 0, upper * lower / np.where(lower > 0, both, 1.0), upper)


def _mean_diagonal(K: PETSc.Mat) -> float:
    diagonal = K.getDiagonal()
    return diagonal.sum() / diagonal.getSize()


def _reason(code: int) -> str:
    names = vars(PETSc.SNES.ConvergedReason).items()
    return next((k for k, v in names if v == code and k.isupper()), str(code))


def _last_line(error: PETSc.Error) -> str:
    return str(error).strip().splitlines()[-1]

"""Preload contact: bodies pressed together by bolts, solved by PETSc's SNES."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError, member, real, wanted
from fenics_joints.modal.options import last_line, petsc_defaults, reason_of
from fenics_joints.preload.equations import Equations
from fenics_joints.preload.model import PreloadModel
from fenics_joints.preload.result import PreloadResult
from fenics_joints.preload.system import FACTOR_OPTIONS, PreloadSystem

METHODS = ("semismooth", "vi", "penalty")

#: Relative to the loads; the last Newton step is exact, so it lands at round-off.
_TOLERANCE = 1e-10
_OPTIONS = {"snes_linesearch_type": "basic", **FACTOR_OPTIONS}
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


class PreloadSolver(PreloadSystem):
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
        See `fenics_joints.preload.system.PreloadSystem` for the rest.
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
        self.method, self.penalty = "semismooth" if method is None else method, penalty
        self._check(model)
        super().__init__(model, given, penalty, petsc_options, prefix)
        self.solver: PETSc.SNES | None = None

    def _check(self, model: PreloadModel) -> None:
        if not isinstance(model, PreloadModel):
            raise wanted("model", model, "a PreloadModel")
        member("method", self.method, METHODS)
        rough = [c.name for c in model.contacts if c.friction > 0]
        if self.method == "vi" and rough:
            raise InputError(
                f"method = 'vi' has no friction, but {', '.join(rough)} has; expected 'semismooth'."
            )
        if (self.method == "penalty") != (self.penalty is not None):
            raise InputError("penalty: expected a stiffness, Pa/m, exactly with method='penalty'.")
        if self.penalty is not None:
            real("penalty", self.penalty, "Pa/m", above=0)
        if not model.contacts:
            raise InputError("the model has no contact that can open; expected at least one.")
        if not (model.forces or any(np.any(i.gap < 0) for i in model.interfaces)):
            raise InputError(
                "nothing presses the parts together: expected a bolt, a load, a displacement, or a "
                "contact with a negative gap (an interference fit)."
            )

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
        if initial is not None and not isinstance(initial, PreloadResult):
            raise wanted("initial", initial, "a PreloadResult, or None")
        load = self.model.load(forces)
        driven = self.driven(forces)
        if driven is not None:
            load.axpy(-1.0, self.K * driven)
        balance = self.hold.balance(load, lambda: self.model.mass(self.given))
        pairs = self.pairs
        if initial is not None:
            _, tangent = pairs.split(initial.x.array_r)
            pairs = replace(pairs, slip=tangent.copy())
        x = load.duplicate()
        x.set(0.0)
        if initial is not None:
            initial.x.copy(x)
            x.array[self.model.jumps.local(self.fixed)] = 0.0
        work = Equations(self, pairs, load, start=initial is None)
        self._run(work, x, monitor)
        if driven is not None:  # x is what is left beside it
            load.axpy(1.0, self.K * driven)
            x.axpy(1.0, driven)
        return PreloadResult(
            self, pairs, self.model.force_values(forces), x, load, work.iterations, balance
        )

    # -- SNES --------------------------------------------------------------------------------

    def _run(self, work: Equations, x: PETSc.Vec, monitor) -> None:
        snes = PETSc.SNES().create(self.model.comm)
        snes.setOptionsPrefix(self.prefix)
        snes.setFunction(work.forces if self.method == "vi" else work.function, x.duplicate())
        snes.setTolerances(rtol=0.0, atol=_TOLERANCE * work.scale(), stol=0.0, max_it=work.patience)
        snes.getKSP().setOptionsPrefix(self.prefix)
        options = dict(_OPTIONS)
        if self.method == "vi":
            # PETSc's tolerance of 1e-8 m is more than the openings under a small force.
            options |= {
                "snes_type": "vinewtonrsls",
                "pc_type": "cholesky",
                "snes_vi_zero_tolerance": 0.0,
            }
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
            pc.setPythonContext(self.preconditioner())
        if monitor is not None:
            snes.setMonitor(lambda _, i, norm: monitor(i, norm))
        with petsc_defaults(self.prefix, options | self.petsc_options):
            snes.setFromOptions()
            snes.setUpdate(work.allow_round_off)
            try:
                snes.solve(None, x)
            except PETSc.Error as error:
                raise ConvergenceError(
                    f"the preload contact was not solved. {_HELP}", last_line(error)
                ) from error
        if self.solver is not None:
            self.solver.destroy()
        self.solver = snes
        work.iterations = snes.getIterationNumber()
        if snes.getConvergedReason() <= 0:
            raise ConvergenceError(
                f"the preload contact did not converge in {work.iterations} iterations (residual "
                f"{snes.getFunctionNorm():.2e} N of {work.scale():.2e} N). {_HELP}",
                reason_of(snes),
            )

    def _assembled(self) -> bool:
        """Whether the user's options want a preconditioner that needs the Newton matrix itself."""
        given = self.petsc_options.get("pc_type", "python")
        return PETSc.Options(self.prefix).getString("pc_type", str(given)) != "python"

    def destroy(self) -> None:
        """Free matrices and factorisations. Collective."""
        if self.solver is not None:
            self.solver.destroy()
        self.solver = None
        super().destroy()


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

"""Preload contact: bodies pressed together by bolts, solved by PETSc's SNES."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from textwrap import shorten

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError, mapping, member, real, wanted
from fenics_joints.formatting import html_table, quantity
from fenics_joints.machine.memory import give_back
from fenics_joints.modal.options import given_options, last_line, petsc_defaults, reason_of
from fenics_joints.preload.conditions import ContactPairs
from fenics_joints.preload.contact_state import ContactState
from fenics_joints.preload.front import beyond
from fenics_joints.preload.hold import find_hold
from fenics_joints.preload.model import PreloadModel
from fenics_joints.preload.multigrid import ContactMultigrid
from fenics_joints.preload.newton import NewtonMatrix, NewtonPreconditioner
from fenics_joints.preload.stiffness import Stiffness, set_blocks
from fenics_joints.structure.faces import Interface
from fenics_joints.structure.jumps import Jumps

METHODS = ("semismooth", "vi", "penalty")

#: PETSc options of every factorisation.
_FACTOR = {"ksp_type": "preonly", "pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_14": "40"}
#: Round-off of a residual, relative to the products of which it is the sum. Chosen: ten sums'.
_ROUND_OFF = 10 * np.finfo(float).eps
#: Largest residual, relative to the loads, that is taken for round-off. Chosen: forces are known to
#: a hundredth of a per cent at best.
_LEAST_ACCURATE = 1e-6
#: Share of Coulomb's limit by which a pair may be beyond it and count as stuck when a step begins:
#: what round-off and the tolerance of the step before leave.
_AT_LIMIT = 1e-6
#: Residual, relative to the loads, at which Newton ends. The last step by a factorisation is exact,
#: so it lands at round-off, whatever the tolerance.
_TOLERANCE = 1e-10
#: Entries of x beyond which multigrid takes the place of factorisations in space. Measured: as fast
#: at 4,000, with friction three times as fast at 16,000.
_LARGE = 10_000
_OPTIONS = {"snes_linesearch_type": "basic", **_FACTOR}
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
#: Options of Newton steps by multigrid. How well the last step's equations foretold the residual
#: bounds the accuracy of the next (Eisenstat and Walker, SIAM J. Sci. Comput. 17, 1996, choice 1),
#: which is a hundredth at worst while pairs still change.
_INEXACT = {
    "snes_max_linear_solve_fail": "1",  # then factorisations take over
    "snes_ksp_ew": None,
    "snes_ksp_ew_version": "1",
    "snes_ksp_ew_rtol0": "0.01",
    "snes_ksp_ew_rtolmax": "0.01",
    "ksp_gmres_cgs_refinement_type": "refine_ifneeded",
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
            ``held_pc_type`` (``cholesky`` or ``mg``, by size if not given); with a ``pc_type`` of
            your own the Newton matrix is assembled for it.
        prefix: Options prefix.

    Raises:
        InputError: For a method that is unknown or does not fit.

    Attributes:
        solver: PETSc's SNES of the last solution.
        K: The stiffness in x, as a product: PETSc's Python matrix of ``stiffness``.
        stiffness: What it is kept as.
        hold: What holds the free bodies.
        fixed: Global numbers of owned entries held at zero: pins, supports, bubbles.
        pins: The same by local number.
        pairs: The pairs that this rank owns.
        multigrid: Coarse spaces of the bodies, for large models in space (see
            `fenics_joints.preload.multigrid`); None where Newton steps factorise, as all do after a
            step that multigrid has not solved.
        newton: The Newton steps' preconditioner, kept for the next solution; None before the first.
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
        self.model = model
        self.given = mapping("given", given, "values by the names of parameters")
        self.petsc_options, self.prefix = given_options(petsc_options), prefix
        bodies = model.structure.stiffness(self.given)
        self.multigrid: ContactMultigrid | None = None
        self._given_up = False
        if self._held_pc_type() == "mg":
            self.multigrid = ContactMultigrid(model, bodies, self.given)
        K = model.stiffness(self.given, bodies=bodies)
        if self.multigrid is not None:
            give_back()
        self.hold = find_hold(model, K)
        self.fixed = self._fixed()
        self.pairs = _pairs(model, K, penalty)
        # Held entries: their row is x = 0.
        self.pins = model.jumps.local(self.fixed)
        self.stiffness = Stiffness(K, np.union1d(self.pins, self.pairs.numbers))
        self.K = PETSc.Mat().createPython(K.getSizes(), self.stiffness, comm=K.comm)
        self.K.setUp()
        self._left: PETSc.Mat | None = None
        self.newton: NewtonPreconditioner | None = None
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
        begin, failed = x.copy(), PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
        try:
            work = self._run(ContactResidual(self, pairs, load, initial is None), x, monitor)
        except ConvergenceError:
            reason = self.solver and self.solver.getConvergedReason()
            if self.multigrid is None or reason != failed:
                raise
            self._give_up_multigrid()
            begin.copy(x)
            work = self._run(ContactResidual(self, pairs, load, initial is None), x, monitor)
        begin.destroy()
        if driven is not None:  # x is what is left beside it
            load.axpy(1.0, self.K * driven)
            x.axpy(1.0, driven)
        return PreloadResult(
            self, pairs, self.model.force_values(forces), x, load, work.iterations, balance
        )

    # -- SNES --------------------------------------------------------------------------------

    def _run(self, work: ContactResidual, x: PETSc.Vec, monitor) -> ContactResidual:
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
            options = _NEWTON_OPTIONS | ({} if self.multigrid is None else _INEXACT)
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
        return work

    def _give_up_multigrid(self) -> None:
        """Factorise from now on."""
        self.forget(), self.multigrid.destroy()
        self.multigrid, self._given_up = None, True
        self.petsc_options.pop("held_pc_type", None)

    def _assembled(self) -> bool:
        """Whether the user's options want a preconditioner that needs the Newton matrix itself."""
        given = self.petsc_options.get("pc_type", "python")
        return PETSc.Options(self.prefix).getString("pc_type", str(given)) != "python"

    # -- matrices ----------------------------------------------------------------------------

    def _fixed(self) -> np.ndarray:
        jumps = self.model.jumps
        numbers = [self.hold.pins, self.model.supported]
        numbers += [jumps.bubbles(c).ravel() for c in jumps.contacts]
        numbers = np.unique(np.concatenate(numbers))
        return numbers[jumps.owned(numbers)]

    def driven(self, forces: Mapping[str, float] | None = None) -> PETSc.Vec | None:
        """Given displacements in x, zero elsewhere; None if there are none."""
        given = self.model.moves(forces)
        if not any(np.any(value) for _, value in given):
            return None
        x = self.K.createVecRight()
        x.set(0.0)
        for numbers, value in given:
            self.model.jumps.put(x.array, numbers, value)
        return x

    def unit_load(self, name: str) -> PETSc.Vec:
        """Derivative of the load in x, given displacements included, by a force or factor."""
        unit = self.model.unit_load(name).copy()
        driven = self.driven(dict.fromkeys(self.model.forces, 0.0) | {name: 1.0})
        if driven is not None:
            unit.axpy(-1.0, self.K * driven)
            driven.destroy()
        return unit

    def _held_pc_type(self) -> str:
        """PETSc's type of preconditioner of the symmetric system in each Newton step."""
        large = self.model.structure.gdim == 3 and self.model.jumps.n > _LARGE
        fits = large and self.method == "semismooth" and not self._given_up
        ours = "mg" if fits else "cholesky"
        given = self.petsc_options.get("held_pc_type", ours)
        return PETSc.Options(self.prefix).getString("held_pc_type", str(given))

    def preconditioner(self) -> NewtonPreconditioner:
        """That of all solutions, made with the first."""
        if self.newton is None:
            prefix = self.prefix + "held_"
            given = {k[5:]: v for k, v in self.petsc_options.items() if k.startswith("held_")}
            options = {**_FACTOR, "pc_type": self._held_pc_type(), **given}
            self.newton = NewtonPreconditioner(
                self.stiffness, self.pins, prefix, options, self.multigrid
            )
        return self.newton

    @cached_property
    def held(self) -> PETSc.Mat:
        """K with the fixed entries held, assembled."""
        held = self.stiffness.A.copy()
        self.stiffness.hold(self.pins, A=held)
        return held

    def combine(self, pairs: ContactPairs, A: np.ndarray, B: np.ndarray, out=None) -> PETSc.Mat:
        """The matrix A K + B, with blocks A and B, (n, gdim, gdim), at the pairs; A is 1 elsewhere.

        Args:
            pairs: The pairs.
            A: Blocks that combine the rows of K.
            B: Blocks that are added.
            out: The matrix of an earlier call, to assemble into.
        """
        rows = self.model.jumps.globals(pairs.numbers)
        if self._left is None:
            self._left = self._identity(rows.shape[1])
        set_blocks(self._left, rows, A, PETSc.InsertMode.INSERT_VALUES)
        out = self._left.matMult(self.held, result=out)
        set_blocks(out, rows, B, PETSc.InsertMode.ADD_VALUES)
        return out

    def factorised(self, J: PETSc.Mat, name: str, options: Mapping[str, object]) -> PETSc.KSP:
        """A solver that has factorised a matrix of `combine`; ``name`` ends its options' prefix."""
        ksp, prefix = PETSc.KSP().create(self.model.comm), f"{self.prefix}{name}_"
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(J)
        with petsc_defaults(prefix, {**_FACTOR, "pc_type": "lu", **options}):
            ksp.setFromOptions()
            ksp.setUp()
        return ksp

    def _identity(self, gdim: int) -> PETSc.Mat:
        """Identity with room for full blocks at the pairs."""
        left = PETSc.Mat().createAIJ(self.held.getSizes(), nnz=(gdim, 0), comm=self.held.comm)
        low, high = left.getOwnershipRange()
        for i in range(low, high):
            left.setValue(i, i, 1.0)
        return left

    def forget(self) -> None:
        """Free the factorisation; the next solution makes its own. Collective."""
        if self.newton is not None:
            self.newton.free()
        self.newton = None

    def destroy(self) -> None:
        """Free matrices and factorisations. Collective."""
        for owned in (self.K, self.stiffness, self.__dict__.get("held"), self._left, self.solver):
            if owned is not None:
                owned.destroy()
        self.solver = None
        self.forget()
        if self.multigrid is not None:
            self.multigrid.destroy()


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


class ContactResidual:
    """Residual and Jacobian of one solution, as SNES calls them."""

    def __init__(self, system: PreloadSolver, pairs: ContactPairs, load: PETSc.Vec, start: bool):
        self.system, self.pairs, self.load = system, pairs, load
        self.start, self.first, self.iterations = start, True, 0
        self.rows = load.duplicate()
        self.closed, self.receding = np.ones(len(pairs.gap), dtype=bool), True
        self._norm = self._atol = None
        # A slip front in a thin strip walks one vertex in an iteration.
        self.patience = 100 if any(c.friction > 0 for c in system.model.contacts) else 40

    def scale(self) -> float:
        """A force, N, to which residuals are compared: loads, or what closing the gaps takes."""
        if self._norm is None:
            closing = self.load.duplicate()
            closing.set(0.0)
            closing.array[self.pairs.numbers[:, 0]] = np.minimum(self.pairs.gap, 0.0)
            force = self.system.K * closing
            self._norm = max(self.load.norm(), force.norm(), np.finfo(float).tiny)
        return self._norm

    def allow_round_off(self, snes: PETSc.SNES, _: int) -> None:
        """Ask for no residual below round-off, which nearly rigid parts make large.

        Up to a limit, lest bodies that fly apart, whose round-off is boundless, seem to rest.
        """
        if self._atol is None:
            self._atol = snes.getTolerances()[1]
        products = self.load.duplicate()
        products.pointwiseMult(self.system.stiffness.diagonal, snes.getSolution())
        least = min(_ROUND_OFF * products.norm(), _LEAST_ACCURATE * self.scale())
        atol = max(self._atol, least)
        snes.setTolerances(atol=atol)
        if self.system.multigrid is not None:
            snes.getKSP().setTolerances(atol=0.5 * atol)
        products.destroy()

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Rows of K x - f; of held entries x itself."""
        pins = self.system.pins
        self.system.K.mult(x, r)
        r.axpy(-1.0, self.load)
        r.array[pins] = x.array_r[pins]

    def function(self, snes, x: PETSc.Vec, F: PETSc.Vec) -> None:
        """SNES's function."""
        self.residual(x, F)
        rows = F.array_r.copy()
        opened, _ = self.statuses(x, rows)
        left = self.pairs.equations(x.array_r, rows, self.start, opened)
        F.array[self.pairs.numbers] = left

    def statuses(self, x: PETSc.Vec, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs that are opened beyond those that pull, and those that are closed, as masks.

        As long as no pair closes again: from there on Newton's own steps converge.
        """
        jumps, at = self.system.model.jumps, self.pairs.numbers[:, 0]
        closed = self.start | (self.pairs.trial(x.array_r, rows)[0] > 0)
        state, found = x.duplicate(), np.zeros(x.getLocalSize(), dtype=bool)
        state.array[at] = 2 * self.closed + closed
        for c in jumps.contacts if self.receding and not self.start else ():
            numbers = jumps.numbers(c)[:, 0]
            was, now = np.array(np.divmod(jumps.gather(state, numbers), 2)) > 0
            self.receding &= not np.any(now & ~was)
            jumps.put(found, numbers, beyond(c, was, now))
        state.destroy()
        opened = found[at] & self.receding
        return opened, closed & ~opened

    def matrix(self) -> PETSc.Mat:
        """The Jacobian's matrix at the start, A K + B, with the pattern of its rows."""
        at = self.load.array_r  # where does not matter: all pairs are closed
        return self.system.combine(self.pairs, *self.pairs.tangent(at, at, closed=True))

    def shell(self) -> PETSc.Mat:
        """The Jacobian as a product, of which nothing is assembled."""
        return NewtonMatrix(self.system.K, self.pairs.numbers, self.system.pins).matrix()

    def jacobian(self, snes, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """SNES's Jacobian; the first one closes all contacts."""
        self.residual(x, self.rows)
        # Where the step before ended in slip, a pair is at its limit but for round-off: whether it
        # goes on or sticks again is for the new load to say.
        slack = _AT_LIMIT if self.first else 0.0
        opened, self.closed = self.statuses(x, self.rows.array_r)
        A, B = self.pairs.tangent(x.array_r, self.rows.array_r, slack, self.start, opened)
        self.start = self.first = False
        if P.getType() == "python":
            context = P.getPythonContext()
            context.A, context.B = A, B
            P.assemble()
        else:
            self.system.combine(self.pairs, A, B, P)
        if J != P:
            J.assemble()

    def forces(self, snes, x: PETSc.Vec, F: PETSc.Vec) -> None:
        """SNES's function of method vi, whose bounds say the rest."""
        self.residual(x, F)

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
        J, F = self.matrix(), x.duplicate()
        self.residual(x, F)
        F.array[self.pairs.numbers] = self.pairs.equations(x.array_r, F.array_r, closed=True)
        ksp, step = self.system.factorised(J, "close", {}), x.duplicate()
        ksp.solve(F, step)
        x.axpy(-1.0, step)
        x.array[self.pairs.numbers[:, 0]] = -self.pairs.gap
        ksp.destroy(), J.destroy()


def _pairs(model: PreloadModel, K: PETSc.Mat, penalty: float | None) -> ContactPairs:
    """The pairs that this rank owns."""
    jumps, diagonal = model.jumps, K.getDiagonal()
    parts = []
    for contact, c in zip(model.contacts, jumps.contacts, strict=True):
        numbers = jumps.numbers(c)
        mine = jumps.owned(numbers[:, 0])
        friction, scale = np.full(len(c), contact.friction), _stiffness_at(jumps, diagonal, c)
        parts.append([a[mine] for a in (numbers, c.gap, friction, scale, c.areas)])
    numbers, gap, friction, scale, areas = map(np.concatenate, zip(*parts, strict=True))
    slip, springs = (
        np.zeros((len(gap), jumps.gdim - 1)),
        None if penalty is None else penalty * areas,
    )
    return ContactPairs(jumps.local(numbers), gap, friction, scale, slip, springs)


def _stiffness_at(jumps: Jumps, diagonal: PETSc.Vec, c: Interface) -> np.ndarray:
    """Stiffness, N/m, (n,), of the two bodies at each pair in series, from K's diagonal in x.

    An entry of the lower body moves both bodies, a jump the upper one alone; without pairs of
    vertices that of the upper one has to do.
    """
    upper = jumps.gather(diagonal, jumps.entries(c.upper)).mean(axis=1)
    if c.coupling is not None or not len(c.lower):
        return upper
    both = jumps.gather(diagonal, jumps.entries(c.lower)).mean(axis=1)
    lower = both - upper
    return np.where(lower > 0, upper * lower / np.where(lower > 0, both, 1.0), upper)


class PreloadResult:
    """A converged preload state.

    Attributes:
        model: The model.
        solver: The solver, with its matrices.
        forces: Forces of the bolts, N, and factors of the loads.
        x: Displacements and jumps, see `fenics_joints.structure.jumps`.
        load: The load f in x.
        iterations: Newton iterations.
        balance: Resultant of the loads that the inertia of the free structure took, relative.
        reactions: K x - f: contact forces at the jumps, what the supports hold elsewhere, N.
        contacts: State of every contact that can open, by name.
        complementarity: Largest violation of g >= 0, N >= 0, g N = 0, relative to the largest
            nodal force.
    """

    def __init__(
        self,
        solver: PreloadSolver,
        pairs: ContactPairs,
        forces: Mapping[str, float],
        x: PETSc.Vec,
        load: PETSc.Vec,
        iterations: int,
        balance: float,
    ):
        self.solver, self.model, self.pairs = solver, solver.model, pairs
        self.forces, self.x, self.load = dict(forces), x, load
        self.iterations, self.balance = iterations, balance
        self.reactions = self.solver.K * x
        self.reactions.axpy(-1.0, load)
        self.contacts = self._contacts()
        self.complementarity = self._complementarity()

    def __repr__(self) -> str:
        contacts = shorten(", ".join(self.contacts), 60)
        return f"PreloadResult({self.iterations} iterations, contacts {contacts})"

    def _repr_html_(self) -> str:
        rows = [
            (
                name,
                quantity(c.normal_force, "N"),
                quantity(float(c.pressure.max(initial=0)), "Pa"),
                f"{c.area * 1e6:.0f} mm²",
                f"{int(c.closed.sum())} of {len(c.status)}",
            )
            for name, c in self.contacts.items()
        ]
        head = ("contact", "force", "peak pressure", "closed area", "closed pairs")
        return html_table(f"Preload after {self.iterations} iterations", head, rows)

    def _contacts(self) -> dict[str, ContactState]:
        jumps, states = self.model.jumps, {}
        status = self.x.duplicate()
        status.set(0.0)
        at, r = self.x.array_r, self.reactions.array_r
        status.array[self.pairs.numbers[:, 0]] = self.pairs.status(at, r)
        for c in jumps.contacts:
            numbers = jumps.numbers(c)
            jump, kind = jumps.gather(self.x, numbers), jumps.gather(status, numbers[:, 0])
            states[c.name] = ContactState(
                c.name,
                c,
                jumps.gather(self.reactions, numbers),
                jump[:, 0] + c.gap,
                jump[:, 1:],
                kind.astype(int),
                self.model.axisymmetric,
            )
        status.destroy()
        return states

    def _complementarity(self) -> float:
        worst = self.pairs.complementarity(self.x.array_r, self.reactions.array_r)
        worst = self.model.comm.allreduce(float(worst.max(initial=0.0)), op=MPI.MAX)
        largest = max((np.abs(c.force).max(initial=0.0) for c in self.contacts.values()), default=0)
        return worst / largest if largest else worst

    def __getitem__(self, name: str) -> ContactState:
        if name not in self.contacts:
            names = ", ".join(self.contacts)
            raise InputError(f"there is no contact {name!r} that can open; expected: {names}.")
        return self.contacts[name]

    @cached_property
    def displacement(self) -> fem.Function:
        """Displacement of all bodies, m."""
        return self.model.jumps.displacement(self.x)

    def shortening(self, bolt: str) -> float:
        """Shortening, m, that a pretension section needs for its force."""
        names = [b.name for b in self.model.cuts]
        if bolt not in names:
            raise InputError(
                f"{bolt!r} has no pretension section; expected: {', '.join(names) or 'none'}."
            )
        number = self.model.jumps.shortening(names.index(bolt))
        return float(self.model.jumps.gather(self.x, np.array([number]))[0])

    def _shift(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Numbers in x of a moved face's or obstacle's displacement, and its directions."""
        names = [m.name for m in self.model.moved]
        if name not in names:
            raise InputError(
                f"{name!r} is no displacement or obstacle; expected: {', '.join(names) or 'none'}."
            )
        i = names.index(name)
        return self.model.jumps.shift(i), self.model.jumps.frame(i)

    def motion(self, name: str) -> np.ndarray:
        """Displacement of an obstacle or of a face that is moved, m, (gdim,); 0 where it is free.

        Raises:
            InputError: If nothing that is moved has this name.
        """
        numbers, frame = self._shift(name)
        return self.model.jumps.gather(self.x, numbers) @ frame

    def reaction(self, name: str) -> np.ndarray:
        """Force of an obstacle, or of a grip that moves a face, on the bodies, N, (gdim,).

        On a half section the first component is summed along the radius, all round.

        Raises:
            InputError: If nothing that is moved has this name.
        """
        numbers, frame = self._shift(name)
        held = self.model.jumps.gather(self.reactions, numbers)
        # What pushes an obstacle is a load in x, not a reaction.
        pushed = self.model.jumps.gather(self.model.unit_load(name), numbers)
        return (held + self.forces.get(name, 0.0) * pushed) @ frame

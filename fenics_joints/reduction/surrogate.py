"""Reduced models for fits: made from samples, checked against the full model, extended."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial, singledispatch
from types import SimpleNamespace

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.machine.memory import give_back
from fenics_joints.measurements.gap import TooFewModes, largest_difference
from fenics_joints.modal.modes import SHIFT_SHARE, Modes, eigen_solver, refine_modes, solve_modes
from fenics_joints.parallel import fail_alike
from fenics_joints.progress import Progress
from fenics_joints.reduction.arrays import ArrayModel, trimmed
from fenics_joints.reduction.basis import (
    SNAPSHOT,
    Points,
    SampledBasis,
    SmallModel,
    orthonormal,
    residual_directions,
)
from fenics_joints.reduction.files import Cache
from fenics_joints.reduction.forms import on_basis
from fenics_joints.reduction.frf_basis import CombinedModel
from fenics_joints.reduction.greedy import GreedyModel
from fenics_joints.reduction.kept import for_test, kept_modes, read_reduced, write_reduced
from fenics_joints.reduction.matched import MatchedModes, places_all_over
from fenics_joints.reduction.prediction import SPARE, ModalPrediction
from fenics_joints.reduction.reduced import (
    MovingModel,
    Projection,
    ReducedStructure,
    reduce,
    solve_shared,
    with_motions,
)
from fenics_joints.structure import FormModel, Sensors, Structure
from fenics_joints.structure.changes import Change, PlacedPoint, PlacedResonator
from fenics_joints.structure.sparse import as_columns, vectors_like

#: Share of a mode's energy at a sample that the basis may lack: 1e-4 of its frequency, well below
#: the noise of tests.
LACKING = 2e-4
#: The same for the part of the basis that one test needs: chosen; leading hypotheses are checked
#: on the full model, and the basis is extended where it errs.
_LACKING_FOR_TEST = 1e-3
#: Share of the largest energy below which a combination of the basis's vectors is round-off.
_DEPENDENT = 1e-13


class ReducedModel(MatchedModes):
    """A parametric reduced model of the modes that a test sees, which knows its error. Collective.

    Its basis holds the modes at the first few samples and the residuals of those at the others,
    which are refined from the reduced model's own modes (a weak greedy algorithm).

    Args:
        full: The full structure.
        start: See `MatchedModes`.
        samples: Gives the parameter values at which its modes make the basis.
        travel: Gives the ranges of moving masses, see `ReducedStructure`.
        by_order: Of beams, see `fenics_joints.beams.tested.ExactModes`.
        keep: Cache of the reduced model, which is then one of all modes and serves every test of
            the structure: read if it is there, otherwise written; None for neither.
        lacking: Share of a mode's energy at a sample that the basis may lack.
        still: Parameters that stay as they are at ``start``.
        progress: Told each step and sample.
        ranks: Ranks that share the solutions out, where each has the whole structure.
        given: See `MatchedModes`.
    """

    tolerance = SNAPSHOT

    def __init__(
        self,
        full: Structure,
        start: Mapping[str, float],
        *,
        samples: Callable[[], Points],
        travel: Callable[[], Mapping[str, tuple[float, float]]] | None = None,
        keep: Cache | None = None,
        lacking: float = LACKING,
        still: Collection[str] = (),
        progress: Progress | None = None,
        by_order: bool = False,
        ranks: MPI.Intracomm = MPI.COMM_SELF,
        **given,
    ):
        self.ranks = ranks
        self.samples, self.travel = samples(), travel and travel()
        self.progress, self.lacking = progress or Progress(silent=True), lacking
        self.n_samples = len(self.samples)
        self.progress.step("reduced model: sampling the parameters", self.n_samples)
        self.kept = keep
        super().__init__(full, start, **given)
        self._basis: list[PETSc.Vec] = []
        self._refined: dict[tuple, Modes] = {}
        self._unbent: list[Change] = []
        self._start, self._still = dict(start), still
        # Also if the model is read from its file, so that both give the same numbers.
        self._solver = eigen_solver(full, self.samples[0], self.n_modes, SNAPSHOT)
        found = self._kept() if self.kept else self._reduce()
        self._whole = self._with_sensors(found)
        self._condense()
        self.forward = self._forward(self._with_motions())

    def modes(self, name: str, values: Mapping[str, float]) -> Modes:
        """See `MatchedModes.modes`; they are kept if the model is."""
        return kept_modes(self.full, values, self.n_modes, self.kept, name, self._solver)

    def _with_motions(self) -> ArrayModel:
        """`_trimmed`, with an attached oscillator's motion."""
        model = with_motions(self._trimmed(), self.full, self._basis)
        model.pencil.set_reference(model.values(self._start))
        return model

    def _trimmed(self) -> ArrayModel:
        return trimmed(self._whole, self._still, self._start) if self._still else self._whole

    def _kept(self) -> ArrayModel:
        """The model in its cache, or made and kept there."""
        found = read_reduced(self.full, self.kept, self.progress)
        if found is None:
            model = self._reduce()
            write_reduced(self.full, self.kept, model, self._basis)
            return model
        model, self._basis = found
        return model

    def _condense(self) -> None:
        """Restrict the basis to the vectors that this test's modes need."""
        model = self._trimmed()
        model.pencil.set_reference(model.values(self._start))
        forward = self._forward(model)
        lacking = max(self.lacking, _LACKING_FOR_TEST)
        turn = compress_basis(forward, self.samples, self._of_test, lacking)
        if turn.shape[1] < self._whole.n_dofs:
            self._basis = vectors_like(self._basis[0], (as_columns(self._basis) @ turn).T)
            self._whole = self._whole.on(turn)

    def _of_test(self, modes: Modes) -> np.ndarray:
        return np.concatenate([np.arange(modes.n_rigid), self._seen(modes)])

    def errors(self, points: Points) -> np.ndarray:
        """Largest relative frequency error against the full model at each point, (n,).

        See `fenics_joints.measurements.gap.largest_difference`; nan where either lacks a mode that
        the test saw.
        """
        return self.errors_by(points, self.solve)

    @property
    def quick(self) -> SmallModel:
        """The same model with a check against modes refined from its own, in a third of the time.
        It misses a mode that the reduced model lacks altogether."""
        return SimpleNamespace(
            errors=partial(self.errors_by, solve=self.refined), extend=self.extend
        )

    def errors_by(self, points: Points, solve: Callable[..., Modes]) -> np.ndarray:
        """`errors` with ``solve``, which gives modes of the full model at values."""
        # Forget modes at other points: they hold vectors of the full model's size.
        wanted = {tuple(values.items()) for values in points}
        for known in (self._solved, self._refined):
            for key in set(known) - wanted:
                del known[key]
        self._solve_all(points, solve)
        errors = np.array([self._error(values, solve) for values in points])
        # All ranks must decide alike from here.
        return self.ranks.bcast(self.full.comm.bcast(errors))

    def _solve_all(self, points: Points, solve: Callable[..., Modes]) -> None:
        """Let ``solve`` remember the modes at points on all ranks, each solved for on one."""
        known = self._refined if solve == self.refined else self._solved
        keys = {tuple(values.items()): values for values in points}
        new = {key: values for key, values in keys.items() if key not in known}

        def found(values: Mapping[str, float]) -> Modes | None:
            with suppress(TooFewModes):
                return solve(values)

        modes = solve_shared(self.ranks, self.full, list(new.values()), found, self._solver)
        known |= {key: own for key, own in zip(new, modes, strict=True) if own is not None}

    def _error(self, values: Mapping[str, float], solve: Callable[..., Modes]) -> float:
        try:
            both = *self.forward.solve(values), *self._paired(values, solve)
        except TooFewModes:
            return np.nan
        return largest_difference(*both, self.sensors)

    def refined(self, values: Mapping[str, float]) -> Modes:
        """Modes of the full model, known or refined from the reduced one's; kept until they are in
        the basis. Collective."""
        key = tuple(values.items())
        if key in self._solved:
            return self._solved[key]
        if key not in self._refined:
            modes, pairing = self.forward.solve(values)
            some = int(pairing.index.max()) + 1 + SPARE
            self._refined[key] = self._near(values, modes.shapes[:, :some])
        return self._refined[key]

    def _near(self, values: Mapping[str, float], shapes: np.ndarray) -> Modes:
        """Modes of the full model near shapes of the small one, (n_dofs, k)."""
        rows = as_columns(self._basis)
        return refine_modes(self.full, values, self._solver, rows @ shapes[: rows.shape[1]])

    def extend(self, points: Points) -> None:
        """Take modes of the full model into the basis: known ones, or new solutions."""
        self._whole = self._with(points)
        self._refined.clear()
        self.forward.model = self._with_motions()
        self.forward.forget()
        give_back()

    def moves(self, points: np.ndarray) -> np.ndarray:
        """Displacement of the model's basis at points, (n_points, gdim, n_dofs). Collective."""
        found = Projection(self.full, self._basis).points(points)
        return np.pad(found, [(0, 0), (0, 0), (0, self.model.n_dofs - found.shape[2])])

    def exchange(self, changes: Sequence[Change]) -> None:
        """Replace changes of the structure, see `Structure.exchange`. Collective."""
        new = {change.name for change in changes}
        self.full.exchange(changes)
        on = Projection(self.full, self._basis)
        terms = {term.name: term for term in on.terms([c for c in on.changes if c.name in new])}
        regions = [terms.get(region.name, region) for region in self._whole.regions]
        self._whole = replace(self._whole, pencil=replace(self._whole.pencil, regions=regions))
        self._unbent = list(changes)
        # Kept modes are those of the structure before.
        self._solved.clear(), self._refined.clear()
        self.forward.model = self._with_motions()
        self.forward.forget()

    def bend(self) -> bool:
        """Add to the basis how the structure bends under forces where something was attached, which
        modes alone do not span. Returns whether there was anything to add. Collective."""
        loads = [load for load in map(self._load, self._unbent) if load is not None]
        self._unbent = []
        if not loads:
            return False
        K, M = self.full.stiffness(self._start), self.full.mass(self._start)
        self._solver.factorise(K, M)
        K.destroy(), M.destroy()
        bent = vectors_like(self._basis[0], self._solver.inverse(np.hstack(loads)).T)
        self._whole = self._on(SampledBasis(self.lacking, [*self._basis, *bent]), self._whole)
        self.forward.model = self._with_motions()
        self.forward.forget()
        return True

    def _load(self, change: Change) -> np.ndarray | None:
        """Loads of one newton in each direction where something is attached, (n_local, gdim)."""
        if not isinstance(change, PlacedPoint) or change.pair != (0, 0):
            return None
        gdim, count = self.full.gdim, len(change.points)
        sides = np.tile(np.eye(gdim), (count, 1))
        loads = self.full.loads(Sensors(np.repeat(change.points, gdim, axis=0), sides))
        return np.einsum("p,npg->ng", change.weights[0], loads.reshape(-1, count, gdim))

    def _with(self, points: Points) -> ArrayModel:
        """The reduced model with modes of the full one at points."""
        known = self._refined | self._solved
        found = [known.get(tuple(values.items())) or self.solve(values) for values in points]
        sampled = SampledBasis(min(self.lacking, LACKING), self._basis, self._whole)
        for modes in found:
            sampled.add(modes, self._of_test(modes))
        return self._on(sampled, self._whole)

    def facts(self) -> dict[str, object]:
        """Its size and use."""
        return {
            "dofs": self.full.n_dofs,
            "basis": self.model.n_dofs,
            "samples": self.n_samples,
            "reduced_solutions": self.forward.calls,
        }

    def wide(self, points: Points) -> ReducedStructure | MovingModel:
        """A reduced model of all modes, visible to the test or not. Collective.

        Args:
            points: Parameter values whose modes make the basis.
        """
        found = reduce(self.full, points, self.n_modes, travel=self.travel, ranks=self.ranks)
        hung = any(isinstance(change, PlacedResonator) for change in self.full.changes)
        return MovingModel(found) if hung else found

    def point_rows(self, model: ReducedStructure | MovingModel, points: np.ndarray) -> np.ndarray:
        """Displacement of a model's basis at points, shape (n_points, gdim, n_dofs)."""
        moving = isinstance(model, MovingModel)
        return model.points(points) if moving else model.projection.points(points)

    def everywhere(self, count: int) -> Sensors:
        """Points all over the structure, each in all directions. Collective."""
        return places_all_over(self.full, count)

    def _reduce(self) -> ArrayModel:
        """The reduced model on the modes at the samples."""
        if isinstance(self.full, Structure):
            self.full.assemble_samples()
        whole, taken = None, 0
        while taken < len(self.samples):
            sampled = SampledBasis(self.lacking, self._basis, whole)
            group = self.samples[taken : 4 * taken + 6]  # even, for two ranks
            for first in range(0, len(group), self.ranks.size):
                self._sample(sampled, group[first : first + self.ranks.size], whole)
            whole, taken = self._on(sampled, whole), taken + len(group)
        return whole

    def _sample(self, sampled: SampledBasis, points: Points, whole: ArrayModel | None) -> None:
        """Take modes at points into a basis, one after the other. Each rank solves for one, and
        finds what the basis lacks of its modes, as its solver has the matrices."""
        here, n = self.ranks.rank, self.n_modes

        def solved() -> Modes | None:
            if here >= len(points):
                return None
            if whole is None:
                return solve_modes(self.full, points[here], n_modes=n, solver=self._solver)
            own = solve_modes(whole, points[here], n_modes=min(2 * n, whole.n_dofs))
            return self._near(points[here], own.shapes)

        modes = fail_alike(self.ranks, solved)
        for rank in range(len(points)):
            # All modes, also if no file is kept, so that both give the same numbers.
            lacked = fail_alike(
                self.ranks,
                lambda rank=rank: sampled.lacked(modes, range(n), True) if rank == here else None,
            )
            sampled.take(self.nominal.shapes[0], self.ranks.bcast(lacked, root=rank))
            self.progress.advance()

    def _on(self, sampled: SampledBasis, known: ArrayModel | None = None) -> ArrayModel:
        """The reduced model on a basis, made orthonormal; ``known`` is the model on its first
        vectors."""
        n = 0 if known is None else known.n_dofs
        basis = orthonormal(self.full, sampled.vectors, self.samples[0], _DEPENDENT, n, known=known)
        # Ranks that share its projection need the same one, to the last bit.
        rows = self.ranks.bcast(as_columns(basis[n:]).T)
        self._basis = [*basis[:n], *vectors_like(basis[0], rows)]
        if known is not None and len(self._basis) == n:
            return known
        return self._projected(known)

    def _projected(self, known: ArrayModel | None) -> ArrayModel:
        """The reduced model on the basis."""
        reduced = ReducedStructure(self.full, self._basis, self.travel, known, self.ranks)
        return reduced.arrays(sensors=self.sensors)

    def _with_sensors(self, found: ArrayModel) -> ArrayModel:
        """A reduced model with the test's sensors and points."""
        return for_test(self.full, found, self._basis, self.sensors)


class ReducedFormModel(ReducedModel):
    """The same of a `FormModel`, or of another that is on a basis by `on_basis`; nothing is kept
    in files."""

    def _projected(self, known: ArrayModel | None) -> ArrayModel:
        return on_basis(self.full, self._basis).arrays(sensors=self.sensors)

    def _with_sensors(self, found: ArrayModel) -> ArrayModel:
        return found


def compress_basis(
    forward: ModalPrediction, samples: Points, keep: Callable[[Modes], np.ndarray], share: float
) -> np.ndarray:
    """Vectors that hold the modes of a model at samples, each to its own energy, (n_dofs, k).

    As `SampledBasis`, of a model of plain arrays. Orthonormal in the energy of the first sample.

    Args:
        forward: Of the model.
        samples: Parameter values; those at which the model lacks the test's modes are skipped.
        keep: ``modes -> indices`` of the modes to hold.
        share: Share of a mode's energy, in its own sample, that may be lacking.
    """
    model = forward.model
    shift = (2 * np.pi * SHIFT_SHARE * model.scale_hz) ** 2
    basis = np.zeros((model.n_dofs, 0))
    for values in samples:
        try:
            modes, _ = forward.solve(values)
        except (InputError, ConvergenceError):
            continue
        Z, n = np.hstack([basis, modes.shapes[:, keep(modes)]]), basis.shape[1]
        gram = Z.T @ (model.stiffness(values) @ Z + shift * (model.mass(values) @ Z))
        size = np.sqrt(np.diag(gram))
        combine = residual_directions(gram / np.outer(size, size), n, share) / size[:, None]
        basis = np.hstack([basis, Z @ combine])
    if not basis.shape[1]:
        return np.eye(model.n_dofs)
    energy = model.stiffness(samples[0]) + shift * model.mass(samples[0])
    values, turn = scipy.linalg.eigh(basis.T @ energy @ basis)
    kept = values > 1e-12 * values[-1]
    return basis @ (turn[:, kept] / np.sqrt(values[kept]))


@dataclass(frozen=True)
class SmallModels:
    """The classes of a structure's `fenics_joints.reduction.basis.SmallModel`s.

    Attributes:
        seen: For the modes that a test saw, see `ReducedModel`.
        free: For these modes in few parameters, see `GreedyModel`.
        combined: For data of several kinds, see `CombinedModel`.
        exact: Whether they are exact, and need no samples.
        kept: Whether they can be kept in files: nothing of forms, which have no hash.
    """

    seen: Callable[..., MatchedModes]
    free: Callable[..., MatchedModes]
    combined: Callable[..., CombinedModel]
    exact: bool = False
    kept: bool = True


@singledispatch
def tested_models(full) -> SmallModels:
    """The small models of a structure; those of solids are reduced on samples of parameters."""
    return SmallModels(ReducedModel, GreedyModel, CombinedModel)


@tested_models.register
def _(full: FormModel) -> SmallModels:
    return SmallModels(ReducedFormModel, GreedyModel, CombinedModel, kept=False)

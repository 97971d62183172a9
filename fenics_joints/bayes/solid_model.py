"""A solid model made ready for sampling: reduced, made lean, checked against the full one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_joints.bayes.model import Frequencies, ReducedCheck, check_reduced, narrow_frequencies
from fenics_joints.bayes.priors import Prior
from fenics_joints.modal.modes import Modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.free_terms import FreeTerms
from fenics_joints.reduction.greedy import GreedyModel
from fenics_joints.structure.structure import Structure

__all__ = ["SolidModel"]

#: Points that are rare in the prior are the worst, and thousands of samples will find them: the
#: first ones are so much further out than draws.
_WIDER = 1.5
#: Points of the prior in the basis at first; those of each round at which the error is estimated,
#: of the first two and of the rest; how many of them are taken at most, and rounds.
_FIRST, _FEW, _MANY, _WORST, _ROUNDS = 8, 64, 160, 8, 8
#: Share of the tolerance that the estimate is brought to, at which a point is worth adding, and
#: that of the lean model's own error.
_GOOD, _SOME, _LEAN = 0.4, 0.05, 0.25
#: Points at which the full model is solved for the check, and rounds of them.
_CHECKED, _CHECKS = 50, 3


class SolidModel:
    """Samples the full model where an estimate of the error is largest. Collective.

    Args:
        full: The full model.
        start: Values of all its parameters.
        prior: What will be sampled.
        tolerance: Largest relative error of a frequency.
        progress: Told what is being done.
        given: ``sensors``, ``n_test``, ``n_modes`` and ``shapes`` of `GreedyModel`.
    """

    def __init__(
        self,
        full: Structure,
        start: Mapping[str, float],
        prior: Prior,
        tolerance: float,
        progress: Progress,
        **given,
    ):
        self.prior, self.tolerance, self.progress = prior, tolerance, progress
        self._rng = np.random.default_rng(7)
        progress.step("reduced model: the start")
        self.model = GreedyModel(FreeTerms(full, prior.names, start), **given)

    def ready(self) -> tuple[Frequencies, ReducedCheck, float]:
        """The model, its check against the full one, and the largest error that is estimated.

        The check is at points that the model was not made of, the estimate at those and more.
        """
        bound = self._sample()
        for i in range(_CHECKS):
            frequencies, modes, at = self._frequencies(), [], []
            self.progress.step("reduced model: checking it in the prior", _CHECKED)

            def exact(points, modes=modes, at=at):
                at += points
                modes += [self._solved(values) for values in points]
                return np.array([self.model.log_f(each) for each in modes])

            # Other points each time: those that were put right say nothing of the rest.
            check = check_reduced(frequencies, exact, self.prior, _CHECKED, seed=12345 + i)
            bound = max(bound, float(np.nanmax(self.model.errors(at))))
            if check.error <= self.tolerance or i == _CHECKS - 1:
                break
            worst = np.argsort(check.errors)[::-1][:_WORST]
            self.model.add([modes[k] for k in worst if check.errors[k] > 0.1 * self.tolerance])
            bound = 0.0
        return frequencies, check, max(bound + frequencies.error, check.error)

    def _sample(self) -> float:
        """Add points to the basis until the estimate is well below the tolerance.

        Returns:
            The largest estimate at the last points, of which none was added.
        """
        picked = self._drawn(_FIRST, _WIDER)
        for i in range(_ROUNDS):
            self.progress.step("reduced model: sampling the prior", len(picked))
            self.model.add([self._solved(values) for values in picked])
            points = self._drawn(_FEW, _WIDER) if i < 2 else self._drawn(_MANY)
            # A point without the test's modes tells nothing of those that have them.
            errors = np.nan_to_num(self.model.errors(points))
            if errors.max() <= _GOOD * self.tolerance:
                break
            # A round costs as much as several points: more of them than must be.
            worst = np.argsort(errors)[::-1][:_WORST]
            picked = [points[k] for k in worst if errors[k] > _SOME * self.tolerance]
        return float(errors.max())

    def _frequencies(self) -> Frequencies:
        """The leanest model that keeps the reduced one's frequencies."""
        return narrow_frequencies(
            self.model.forward, self.prior, self.model.start, tolerance=_LEAN * self.tolerance
        )

    def _drawn(self, n: int, wider: float = 1.0) -> list[dict[str, float]]:
        """Draws of the prior, or as much further from their middle as it allows."""
        x = self.prior.sample(n, self._rng)
        middle = np.mean(x, axis=0)
        far = middle + wider * (x - middle)
        x = np.where(np.isfinite(self.prior.log_density(far))[:, None], far, x)
        rows = self.prior.values(x).tolist()
        return [dict(zip(self.prior.names, row, strict=True)) for row in rows]

    def _solved(self, values: Mapping[str, float]) -> Modes:
        self.progress.advance()
        return self.model.solve(values)

"""A small model for sampling that is checked against the full one."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count

import numpy as np

from fenics_joints.bayes.model import Frequencies, ReducedCheck, check_reduced, narrow_frequencies
from fenics_joints.bayes.priors import PriorDensity
from fenics_joints.errors import InputError
from fenics_joints.progress import Progress
from fenics_joints.reduction.basis import Points, weak_greedy
from fenics_joints.reduction.surrogate import tested_models

#: Factor by which the first points are further from the prior's middle than draws: errors are
#: largest at rare points, which thousands of samples will meet. Chosen.
_WIDER = 1.5
#: Points of the prior in the basis at first; points at which the error is estimated, in each of the
#: first two rounds and of the rest; most of them that are taken in a round; most rounds. Chosen for
#: time: the check decides whether they suffice.
_FIRST, _FEW, _MANY, _WORST, _ROUNDS = 8, 64, 160, 8, 8
#: Shares of the tolerance: to which the estimate is brought, above which a point is added, and of
#: the small model's own error where the reduced model is estimated or exact. Chosen.
_GOOD, _SOME, _LEAN, _LEAN_EXACT = 0.4, 0.05, 0.25, 0.1
#: Points at which the full model is solved for the check, most rounds of them, the seed of the
#: first, and the share of the tolerance above which a point is added. Chosen.
_CHECKED, _CHECKS, _SEED, _OFF = 50, 3, 12345, 0.1


class SampledModel:
    """A small model on a reduced one, made where an estimate of its error is largest. Collective.

    It has the calls of `fenics_joints.reduction.basis.SmallModel`; its errors are those against the
    full model.

    Args:
        full: The full model.
        start: Values of all its parameters.
        prior: What will be sampled.
        tolerance: Largest relative error of a frequency.
        progress: Told what is being done.
        given: See `fenics_joints.reduction.matched.MatchedModes`.

    Attributes:
        frequencies: Of the lean model.
        check: Of these against the full model, at points that the model was not made of.
        bound: Largest error of the reduced model that is estimated, at these points and more.
    """

    frequencies: Frequencies
    check: ReducedCheck
    bound = 0.0

    def __init__(
        self,
        full,
        start: Mapping[str, float],
        prior: PriorDensity,
        tolerance: float,
        progress: Progress,
        **given,
    ):
        self.prior, self.tolerance, self.progress = prior, tolerance, progress
        self._rng, models = np.random.default_rng(7), tested_models(full)
        self.exact = models.exact
        self.model = models.free(full, start, prior.names, progress=progress, **given)
        own = self.model.model.parameters
        self.start = {name: value for name, value in start.items() if name in own}

    def ready(self) -> tuple[Frequencies, ReducedCheck, float]:
        """The model, its check against the full one, and the largest error that is estimated."""
        if not self.exact:
            self._sample()
        # Other points each time: those that were put right say nothing of the rest.
        seeds = count(_SEED)
        weak_greedy(
            self,
            lambda: self._by_name(self.prior.sample(_CHECKED, np.random.default_rng(next(seeds)))),
            self.tolerance,
            _CHECKS,
            most=_WORST,
            least=_OFF,
        )
        found = self.frequencies, self.check
        return *found, max(self.bound + self.frequencies.error, self.check.error)

    def _sample(self) -> None:
        """Add points to the basis until the estimate is well below the tolerance."""
        self.model.extend(self._drawn(_FIRST, _WIDER))
        rounds = count()

        def points() -> Points:
            return self._drawn(_FEW, _WIDER) if next(rounds) < 2 else self._drawn(_MANY)

        # A round costs as much as several points: more of them than must be.
        errors = weak_greedy(
            self.model, points, _GOOD * self.tolerance, _ROUNDS, most=_WORST, least=_SOME / _GOOD
        )
        self.bound = float(errors.max())

    def errors(self, points: Points) -> np.ndarray:
        """Errors of the leanest model that keeps the reduced one's frequencies, (n,)."""
        share = _LEAN_EXACT if self.exact else _LEAN
        self.frequencies = narrow_frequencies(
            self.model.forward, self.prior, self.start, tolerance=share * self.tolerance
        )
        self.progress.step("reduced model: checking it in the prior", len(points))
        values = np.array([[point[name] for name in self.prior.names] for point in points])
        self.check = check_reduced(self.frequencies, self._full, values)
        if not self.exact:
            self.bound = max(self.bound, float(np.nanmax(self.model.errors(points))))
        return self.check.errors

    def extend(self, points: Points) -> None:
        """Take what was solved for the check into the basis."""
        self.model.extend(points)
        self.bound = 0.0

    def _full(self, points: Points) -> np.ndarray:
        """ln f of the full model, (n, m); nan where it lacks a mode."""
        found = np.full((len(points), self.model.n_test), np.nan)
        for row, values in zip(found, points, strict=True):
            try:
                row[:] = self.model.log_f(values)
            except InputError:
                continue
        return found

    def _drawn(self, n: int, wider: float = 1.0) -> list[dict[str, float]]:
        """Draws of the prior, or as much further from their middle as it allows."""
        x = self.prior.sample(n, self._rng)
        middle = np.mean(x, axis=0)
        far = middle + wider * (x - middle)
        x = np.where(np.isfinite(self.prior.log_density(far))[:, None], far, x)
        return self._by_name(x)

    def _by_name(self, x: np.ndarray) -> list[dict[str, float]]:
        rows = self.prior.values(x).tolist()
        return [dict(zip(self.prior.names, row, strict=True)) for row in rows]

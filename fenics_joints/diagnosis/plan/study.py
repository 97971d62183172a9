"""Before any data: which effects a planned test can tell apart.

An effect of its expected size makes a prediction; another hypothesis comes as near to it as its
parameters and the nuisances let it, within their priors. Half the whitened distance that is left,
D, is how far the two are apart: with Gaussian noise the data of the one are taken for the other's
with probability Phi(-D) (see `diagnosis.evidence.classes`). Predictions are exact, not
linearised: a joint's compliance is strongly nonlinear in its stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse.csgraph import connected_components

from fenics_joints.diagnosis.effects.effect import Effect, Silent
from fenics_joints.diagnosis.effects.rig import MISPLACED, MISSCALED
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.errors import InputError
from fenics_joints.parallel import spread

if TYPE_CHECKING:
    from mpi4py import MPI


def groups(distances: np.ndarray, seen: Sequence[bool]) -> list[list[int]]:
    """Effects in classes: those that may be taken for each other, one way round or the other.

    Args:
        distances: D of the row's effect from what the column's can make, (n, n).
        seen: Which effects the test can see at all; the others are in no class.

    Returns:
        Indices of the members, by class, in their order.
    """
    there = np.flatnonzero(seen)
    if not len(there):
        return []
    near = np.minimum(distances, distances.T)[np.ix_(there, there)] < APART
    count, label = connected_components(near, directed=False)
    return [there[label == k].tolist() for k in range(count)]


@dataclass(frozen=True, eq=False)
class Combination:
    """The changes of effects that cancel best.

    Attributes:
        index: Collinearity index of the signatures, 1/sqrt of the least eigenvalue of their
            correlation: above about 20 they cannot be told apart whatever their sizes (Brun,
            Reichert and Kuensch, Water Resour. Res. 37, 2001).
        factors: Factor on each signature of the combination, the largest of magnitude 1, (k,).
        left: Length of what they leave, standard deviations.
    """

    index: float
    factors: np.ndarray
    left: float


def combination(signatures: Sequence[np.ndarray]) -> Combination:
    """How nearly whitened signatures (N,) depend on each other, and the combination that cancels.

    Args:
        signatures: One for each effect, none of zeros.
    """
    S = np.array(signatures).T
    length = np.linalg.norm(S, axis=0)
    eigenvalues, vectors = np.linalg.eigh((S / length).T @ (S / length))
    least = max(float(eigenvalues[0]), 1e-12)
    factors = vectors[:, 0] / length
    factors = factors / factors[np.argmax(np.abs(factors))]
    return Combination(least**-0.5, factors, float(np.linalg.norm(S @ factors)))


#: Sizes of an effect that it is judged at, in prior standard deviations. [decision: one standard
#: deviation either way]
SIZES = (-1.0, 0.0, 1.0)
#: Sizes that a search for the nearest prediction starts from. [numerical: chosen]
_STARTS = (-2.0, -1.0, 0.0, 1.0, 2.0)
#: Of the starts the search goes on from this many, for so many steps at most. [numerical: chosen
#: for time]
_BEST, _STEPS = 2, 12
#: Relative fall of the cost below which the search ends; and where D is this far above `APART`.
#: [numerical: chosen for time]
_DONE, _DONE_FAR, _FAR = 3e-3, 0.3, 3.0

Predict = Callable[[Hypothesis, np.ndarray, Mapping[str, float]], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a test measures, and how well; no data.

    Attributes:
        bare: The hypothesis without effects: nuisances, scatter, conditions, modes.
        predict: ``(hypothesis, z, baseline) -> (values (N,), derivatives by z (N, d))``.
        covariance: Of the data about the prediction, noise and discrepancy, (N, N).
    """

    bare: Hypothesis
    predict: Predict
    covariance: np.ndarray

    @cached_property
    def lower(self) -> np.ndarray:
        """Cholesky factor of the covariance, (N, N)."""
        return np.linalg.cholesky(self.covariance)

    def hypothesis(self, *effects: Effect) -> Hypothesis:
        """The hypothesis of these effects for this test."""
        return replace(self.bare, effects=effects)

    def beside(self, further: Predict, covariance: np.ndarray) -> Measurement:
        """The same test with further frequencies, all at the common level.

        Args:
            further: Predicts them, of a hypothesis without damping and amplitudes.
            covariance: Of their errors, which are independent of those of the test.
        """

        def predict(hypothesis, z, baseline):
            values, slopes = self.predict(hypothesis, z, baseline)
            kept = np.ones(len(z), dtype=bool)
            for name in ("amplitudes", "dampings"):
                kept[hypothesis.places[name]] = False
            still = replace(hypothesis, damped=False, driven=(0,))
            more, by_kept = further(still, z[kept], baseline)
            by_all = np.zeros((len(more), len(z)))
            by_all[:, kept] = by_kept
            return np.append(values, more), np.vstack([slopes, by_all])

        return Measurement(self.bare, predict, block_diag(self.covariance, covariance))


@dataclass(frozen=True, eq=False)
class Signature:
    """What an effect of one size does to the test.

    Attributes:
        effect: The effect.
        own: Its parameters, in prior standard deviations, (k,).
        predicted: What the test would measure, without noise, (N,).
        d: Length of the change, whitened, that the nuisances cannot make: standard deviations.
    """

    effect: Effect
    own: np.ndarray
    predicted: np.ndarray
    d: float

    @property
    def values(self) -> dict[str, float]:
        """Its parameters, SI."""
        pairs = zip(self.effect.priors, self.own, strict=True)
        return {prior.name: float(prior.value(z)) for prior, z in pairs}


def middle(signatures: Sequence[Signature]) -> Signature:
    """Of an effect's signatures the middle one by length: its expected size."""
    return sorted(signatures, key=lambda s: s.d)[len(signatures) // 2]


def own_at(effect: Effect, size: float) -> np.ndarray:
    """The effect's parameters at a size, in prior standard deviations and within limits, (k,).

    What has a log-normal prior is a size; exponents and places, which have normal ones, stay at
    their means, unless the effect has nothing else.
    """
    sizes = [prior.log for prior in effect.priors]
    if not any(sizes):
        sizes = [True] * len(sizes)
    z = np.where(sizes, size, 0.0)
    limits = np.array([prior.limits() for prior in effect.priors]).reshape(-1, 2)
    return np.clip(z, limits[:, 0], limits[:, 1])


class Study:
    """Signatures of effects in a test and the distances between them.

    Args:
        test: The test.
        effects: The effects.
        baseline: Parameter values of the nominal model.
        beneath: Baselines of effects that are looked for in another model, by their key: slip, say,
            in a joint that is not bonded. A rival of such an effect is put into that model too.
        progress: Called after the sizes of each effect, and after each row of the distances.
        comm: Communicator that the rows of the distances are spread over; None for one process.
    """

    def __init__(
        self,
        test: Measurement,
        effects: Sequence[Effect],
        baseline: Mapping[str, float],
        *,
        beneath: Mapping[str, Mapping[str, float]] | None = None,
        progress: Callable[[], None] | None = None,
        comm: MPI.Intracomm | None = None,
    ):
        self._comm = comm
        self.test, self.effects = test, tuple(effects)
        self._baseline, self._beneath = baseline, beneath or {}
        self._progress = progress or (lambda: None)
        #: Own parameters of the column's effect where it comes nearest to the row's; filled by
        #: `distances`.
        self.near: dict[tuple[int, int], np.ndarray] = {}
        self._known: dict[tuple, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._factors: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def of(self, test: Measurement, effects: Sequence[Effect]) -> Study:
        """The same effects, or others of their keys, in another test."""
        return Study(test, effects, self._baseline, beneath=self._beneath)

    def baseline(self, effect: Effect) -> Mapping[str, float]:
        """The model that an effect is put into."""
        return self._beneath.get(effect.key, self._baseline)

    # -- signatures --------------------------------------------------------------------------

    @cached_property
    def sizes(self) -> list[list[Signature]]:
        """Signatures of every effect at `SIZES`, those left out that the model cannot have."""
        return [self._sizes(effect) for effect in self.effects]

    def _sizes(self, effect: Effect) -> list[Signature]:
        found, problem = [], None
        for size in SIZES:
            try:
                found.append(self.signature(effect, own_at(effect, size)))
            except InputError as error:
                problem = error  # such as too few modes that the test could see
        if not found:
            raise problem
        self._progress()
        return found

    @cached_property
    def expected(self) -> list[Signature]:
        """Those of each effect's expected size."""
        return [middle(some) for some in self.sizes]

    def signature(self, effect: Effect, own: np.ndarray) -> Signature:
        """What an effect with these parameters does, exactly."""
        found = self.change(effect, own)
        return replace(found, d=2 * self.distance(found, None))

    def change(self, effect: Effect, own: np.ndarray) -> Signature:
        """The same, without how much of it the nuisances cannot make."""
        hypothesis = self.test.hypothesis(effect)
        predicted = self._prediction(hypothesis, hypothesis.at(own), self.baseline(effect))[0]
        return Signature(effect, own, predicted, np.nan)

    def whitened(self, signature: Signature) -> np.ndarray:
        """Its change of the prediction in the metric of noise and nuisances together, (N,)."""
        nominal, lower = self._blurred(self.baseline(signature.effect))
        return whiten(lower, signature.predicted - nominal)

    def _blurred(self, base: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """The prediction without effects, and the Cholesky factor of noise and nuisances."""
        if id(base) not in self._factors:
            bare = self.test.hypothesis()
            nominal, slopes = self.test.predict(bare, bare.at(0.0), base)
            covariance = self.test.covariance + slopes @ slopes.T
            self._factors[id(base)] = nominal, np.linalg.cholesky(covariance)
        return self._factors[id(base)]

    # -- distances ---------------------------------------------------------------------------

    @cached_property
    def distances(self) -> np.ndarray:
        """D of the row's effect, if it is at work, from what the column's can make; (n, n)."""
        n = len(self.effects)
        rows = spread(self._comm, range(n), self._row) if self._comm else map(self._row, range(n))
        D = np.zeros((n, n))
        for i, row in enumerate(rows):
            for j, (square, own) in row.items():
                D[i, j], self.near[i, j] = np.sqrt(square) / 2, own
        return D

    @property
    def table(self) -> np.ndarray:
        """D of every pair, and from "no gap" in the last column, (n, n + 1)."""
        return np.column_stack([self.distances, [s.d / 2 for s in self.expected]])

    def _row(self, i: int) -> dict[int, tuple[float, np.ndarray]]:
        """`nearest` of every other effect to the expected size of one."""
        truth = self.expected[i]
        # What is not seen is in no class: the linear answer will do.
        steps = _STEPS if truth.d >= 2 * APART else 1
        rivals = [(j, e) for j, e in enumerate(self.effects) if j != i]
        found = {j: self.nearest(truth, rival, steps=steps) for j, rival in rivals}
        self._progress()
        return found

    def distance(
        self, truth: Signature, rival: Effect | None, start: np.ndarray | None = None
    ) -> float:
        """D: half the distance from a signature to the nearest that a rival can make.

        Args:
            truth: The signature.
            rival: The rival; None for "no gap".
            start: See `nearest`.
        """
        return float(np.sqrt(self.nearest(truth, rival, start)[0])) / 2

    def nearest(
        self,
        truth: Signature,
        rival: Effect | None,
        start: np.ndarray | None = None,
        steps: int = _STEPS,
    ) -> tuple[float, np.ndarray]:
        """Squared distance to the nearest prediction of a rival, and its own parameters there.

        Minimises |r|^2 + |z|^2, r the whitened difference and z the parameters of the rival, by
        Gauss-Newton steps. Nuisances, which the truth has at their medians, cost their |z|^2; the
        rival's own parameters what they need beyond those of the truth.

        Args:
            truth: The signature.
            rival: The rival; None for "no gap".
            start: Own parameters to start from; by default some all over their prior.
            steps: Gauss-Newton steps at most.
        """
        hypothesis = self.test.hypothesis(*([] if rival is None else [rival]))
        search = _NearestSearch(self, hypothesis, self.baseline(truth.effect), truth.predicted)
        if rival is None:
            starts = [np.zeros(0)]
        else:
            starts = [own_at(rival, s) for s in _STARTS] if start is None else [start]
        begun = [each for own in starts if (each := search.begin(own)) is not None]
        if not begun:
            raise InputError(f"{hypothesis.label}: the model has too few modes at all its sizes.")
        begun.sort(key=lambda each: each[0])
        often = begun[: _BEST if steps > 1 else 1]
        ends = [search.run(place, moved, steps) for _, place, moved in often]
        best = min(ends, key=lambda place: place.cost)
        own, others = best.z[hypothesis.own], np.delete(best.z, hypothesis.own)
        needed = own @ own - truth.own @ truth.own
        return best.misfit + float(others @ others) + max(float(needed), 0.0), own

    def _prediction(self, hypothesis, z, baseline) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What is predicted, the same whitened, and its slopes whitened.

        Remembered for what many comparisons start from: z of one effect, nuisances at rest.
        """
        key = (hypothesis.effects, tuple(z), id(baseline))
        if key in self._known:
            return self._known[key]
        predicted, slopes = self.test.predict(hypothesis, z, baseline)
        lower = self.test.lower
        found = predicted, whiten(lower, predicted), whiten(lower, slopes)
        if not np.delete(z, hypothesis.own).any():
            self._known[key] = found
        return found


@dataclass(frozen=True, eq=False)
class _Place:
    """A point of a search: whitened residual and slopes, and what they cost."""

    z: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray

    @property
    def misfit(self) -> float:
        return float(self.residual @ self.residual)

    @property
    def cost(self) -> float:
        return self.misfit + float(self.z @ self.z)


class _NearestSearch:
    """The nearest that a hypothesis can make to a prediction."""

    def __init__(self, study: Study, hypothesis: Hypothesis, baseline, target: np.ndarray):
        self._study, self._hypothesis = study, hypothesis
        self._baseline, self._target = baseline, whiten(study.test.lower, target)
        self._limits = hypothesis.limits.T

    def _place(self, z: np.ndarray) -> _Place | None:
        """None where the model has no answer, as too few modes that the test could see."""
        try:
            _, at, slopes = self._study._prediction(self._hypothesis, z, self._baseline)
        except InputError:
            return None
        return _Place(z, at - self._target, slopes)

    def begin(self, own: np.ndarray) -> tuple[float, _Place, np.ndarray] | None:
        """The cost to expect from own parameters with the nuisances refitted linearly, the point
        without that, and z with it; None where the model has no answer."""
        place = self._place(self._hypothesis.at(own))
        if place is None:
            return None
        free = np.delete(np.arange(len(place.z)), self._hypothesis.own)
        S, moved = place.slopes[:, free], place.z.copy()
        moved[free] = np.linalg.solve(S.T @ S + np.eye(len(free)), -S.T @ place.residual)
        refitted = _Place(moved, place.residual + S @ moved[free], place.slopes)
        return refitted.cost, place, moved

    def run(self, place: _Place, moved: np.ndarray, steps: int) -> _Place:
        """Gauss-Newton steps within the limits, halved where the cost would not fall."""
        refitted = self._place(np.clip(moved, *self._limits))
        if refitted is not None and refitted.cost <= place.cost:
            place = refitted
        for _ in range(steps):
            better = self._step(place)
            if better is None:
                break
            gained, place = place.cost - better.cost, better
            far = better.cost > (2 * _FAR * APART) ** 2
            if gained < (_DONE_FAR if far else _DONE) * better.cost + 1e-6:
                break
        return place

    def _step(self, place: _Place) -> _Place | None:
        z, S = place.z, place.slopes
        low, high = self._limits
        downhill = -(S.T @ place.residual + z)
        free = ~((z <= low) & (downhill < 0)) & ~((z >= high) & (downhill > 0))
        if not free.any():
            return None
        hessian = S[:, free].T @ S[:, free] + np.eye(int(free.sum()))
        way = np.zeros(len(z))
        way[free] = np.linalg.solve(hessian, downhill[free])
        for factor in (1.0, 0.5, 0.25, 0.1, 0.03):
            there = self._place(np.clip(z + factor * way, low, high))
            if there is not None and there.cost < place.cost:
                return there
        return None


#: Sensors whose faults of one kind stay. [numerical: chosen for time]
_KEPT = 4


def few_sensors(
    test: Measurement, effects: Sequence[Effect], baseline: Mapping[str, float]
) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """The effects with a few sensors for each kind of fault, and a note on the others.

    The distances of all from all others grow with the square of their number. The faults stay
    whose change, of the expected size and whitened, is the longest, the shortest and evenly
    between.

    Args:
        test: The test.
        effects: All effects.
        baseline: Parameter values of the nominal model.
    """
    study, left, silent = Study(test, effects, baseline), set(), []
    for name in (MISPLACED, MISSCALED):
        members = [effect for effect in effects if effect.name == name]
        if len(members) <= _KEPT:
            continue
        # Linear: half of the length is D.
        lengths = [np.linalg.norm(study.whitened(study.change(e, own_at(e, 1.0)))) for e in members]
        order = np.argsort(lengths, kind="stable")
        kept = order[np.round(np.linspace(0, len(order) - 1, _KEPT)).astype(int)]
        left |= {e.key for i, e in enumerate(members) if i not in kept}
        reason = (
            f"{len(members) - _KEPT} of {len(members)} sensors are left out of the plan; D of all "
            f"from the baseline is {min(lengths) / 2:.2g} to {max(lengths) / 2:.2g}, and the "
            "sensors listed are spread evenly between"
        )
        silent.append(Silent(name, reason))
    return tuple(effect for effect in effects if effect.key not in left), tuple(silent)

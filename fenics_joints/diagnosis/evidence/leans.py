"""Lean models for the fits: as few vectors and terms as the effects of one hypothesis ask for.

The reduced model holds what any effect of the library makes of the structure. A hypothesis changes
a few of its parameters and follows the test's modes alone: a basis a quarter as large, from modes
at points all over the priors of its effects, predicts these a tenth as long. It is made once for
each effect, tried at other points, and only guides: the reduced model itself has the last word
on every fit (`fenics_joints.diagnosis.evidence.inference`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.stats import qmc

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.entries import FREQUENCY, SHAPE
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.problem import Scanned
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.batch import pod
from fenics_joints.reduction.compact import merged
from fenics_joints.reduction.forward import SPARE, Forward
from fenics_joints.reduction.lean import LeanForward, batched
from fenics_joints.reduction.seen_at import SeenAt, seen_modes_at

__all__ = ["Leans", "all_over", "changed", "of_few_terms"]

#: Size of a reduced model from which a leaner one is worth its making.
_LARGE = 80
#: Points of each effect's prior and how far they reach, in standard deviations; points at which a
#: lean model is tried, and how often it takes those in.
_POINTS, _REACH, _TRIES, _ROUNDS = 16, 2.5, 6, 4
#: Points of the prior of an effect whose place is a parameter.
_PLACES = 48
#: Energy of a vector, relative to the first, below which it is left out, half of it in each further
#: round; weight of modes that are not the test's, which must be there for these to be told from
#: them; share of the reduced model's size at which a lean one is none.
_SHARE, _OTHERS, _SMALL = 1e-3, 0.1, 0.6
#: Parameters of effects of which all limits are tried together.
_CORNERS = 4
#: Error of ln f, relative to the data's standard deviation, that is good enough for a guide.
_LIMIT = 0.05

Snapshot = tuple[np.ndarray, np.ndarray]


class Leans:
    """Lean forwards by hypothesis.

    Args:
        forward: Of the reduced model.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        earlier: Those of the reduced model before it was extended, which serve on where they are as
            good for the extended one.
    """

    def __init__(
        self, forward: Forward, evidence: Evidence, baseline: dict[str, float],
        earlier: Leans | None = None,
    ):  # fmt: skip
        self.forward = forward
        self.whole = batched(forward) if isinstance(forward, Forward) else None
        self._model = forward.model
        self.evidence, self.baseline = evidence, baseline
        kinds, sizes = evidence.entries.kind[evidence.fitted], np.diag(evidence.covariance())
        self.limit, self.shape_limit = (
            _LIMIT * float(np.sqrt(np.median(sizes[own]))) if np.any(own) else 0.0
            for own in (kinds == FREQUENCY, kinds == SHAPE)
        )
        self._snapshots: dict[str, list[Snapshot]] = {}
        self._known: dict[tuple, LeanForward | None] = {}
        self._earlier = dict(earlier._known) if earlier else {}
        self._tried: dict[tuple, list[Snapshot]] = {}
        self.scanned = Scanned(evidence, baseline)

    def are_of(self, forward: Forward) -> bool:
        """Whether a forward's model is still the one that these are made from."""
        return forward is self.forward and forward.model is self._model

    @property
    def wanted(self) -> bool:
        """Whether the reduced model is one of plain arrays that is large enough."""
        if self.whole is None or not self.whole.batches:
            return False
        return self.forward.model.n_dofs >= _LARGE and self.limit > 0

    def of(self, hypothesis: Hypothesis, several: bool = False) -> LeanForward | None:
        """The lean forward of a hypothesis; None where there is none that is good enough.

        That of an effect whose place is a parameter has all of the model's terms, any of which may
        change.

        Args:
            hypothesis: The hypothesis.
            several: Whether one of several effects is worth it, as where it is fitted many times:
                a single fit takes no longer than the making.
        """
        too_many = len(hypothesis.effects) > 1 and not several
        if not self.wanted or self._misses(hypothesis) or too_many:
            return None
        own = _own(hypothesis)
        hypothesis = replace(hypothesis, effects=own)
        key = tuple(effect.key for effect in own)
        if key not in self._known:
            try:
                self._known[key] = (
                    self._still_good(hypothesis, key) or self._made(hypothesis, key)
                )
            except (InputError, ConvergenceError, np.linalg.LinAlgError):
                self._known[key] = None  # somewhere in its prior there is no model
        return self._known[key]

    def known(self, hypothesis: Hypothesis) -> LeanForward | None:
        """That of a hypothesis if there is one already: for a look or two none is worth its making.

        Args:
            hypothesis: The hypothesis.
        """
        if self._misses(hypothesis):
            return None
        return self._known.get(tuple(effect.key for effect in _own(hypothesis)))

    def for_fit(
        self, hypothesis: Hypothesis, several: bool = False
    ) -> tuple[Forward, LeanForward | None]:
        """What a fit of a hypothesis asks, and what guides it: see `of`.

        Args:
            hypothesis: The hypothesis.
            several: See `of`.
        """
        # From few points about the medians a fit takes no longer than the making of a guide. What
        # changes the sensors alone shares one with all such.
        often = several or len(self.evidence.conditions) > 1 or not _own(hypothesis)
        often = often or hypothesis.wide or any(p.scan for _, p in hypothesis.priors)
        guide = self.of(hypothesis, several) if often else self.known(hypothesis)
        return (self.whole_of(hypothesis) if guide is None else self.forward), guide

    def _misses(self, hypothesis: Hypothesis) -> bool:
        """Whether it may have a mode that the test missed, which is another model's."""
        return hypothesis.senses and self.forward.further is not None

    def whole_of(self, hypothesis: Hypothesis) -> Forward:
        """The reduced model's forward in as few terms as a hypothesis asks for: it says the same,
        and sooner where it is asked as often as by a fit without a guide.

        Args:
            hypothesis: The hypothesis.
        """
        if not self.wanted or self.forward.further is not None:
            return self.forward
        model = of_few_terms(hypothesis, self.forward.model, self.evidence, self.baseline)
        if model is self.forward.model:
            return self.forward
        model.pencil.settle(model.values())
        return LeanForward(self.forward, model)

    def _still_good(self, hypothesis: Hypothesis, key: tuple) -> LeanForward | None:
        """The lean forward of the model before, if this one says the same; else what this one says
        where that was tried is kept for the next."""
        lean = self._earlier.get(key)
        if lean is None:
            return None
        tries = self._values(hypothesis, _TRIES, _ROUNDS)
        seen = seen_modes_at(self.forward, tries)
        if self._is_good(lean, tries, seen):
            return lean
        self._tried[key] = _snapshots(seen)
        return None

    def _made(self, hypothesis: Hypothesis, key: tuple) -> LeanForward | None:
        model = of_few_terms(hypothesis, self.forward.model, self.evidence, self.baseline)
        if model is self.forward.model and not _is_placed(hypothesis):
            return None
        same = model is self.forward.model
        quick = self.forward if same else LeanForward(self.forward, model, turned=False)
        snapshots = [s for e in (None, *hypothesis.effects) for s in self._of(hypothesis, e, quick)]
        snapshots, share = snapshots + self._tried.pop(key, []), _SHARE
        for seed in range(_ROUNDS):
            lean = self._on(model, snapshots, share)
            if lean.model.n_dofs > _SMALL * model.n_dofs:
                return None
            tries = self._values(hypothesis, _TRIES, seed)
            seen = seen_modes_at(quick, tries)
            if not all(len(at.index) for at in seen):
                return None
            if self._is_good(lean, tries, seen):
                return lean
            snapshots, share = snapshots + _snapshots(seen), share / 2
        return None

    def _is_good(self, lean: LeanForward, tries, seen: Sequence[SeenAt]) -> bool:
        """Whether a lean forward says what the reduced model does where it is tried."""
        exact, found = np.array([at.log_f for at in seen]), lean.prepare(tries, slopes=False)
        # What is nan in either is no number that could be small enough.
        good = bool(np.max(np.abs(found - exact)) <= self.limit)
        good = good and self._shape_error(lean, tries, seen) <= self.shape_limit
        lean.release()
        return good

    def _on(self, model, snapshots: Sequence[Snapshot], share: float) -> LeanForward:
        shapes = np.hstack([x for x, _ in snapshots])
        weights = np.concatenate([w for _, w in snapshots])
        vectors, sizes = pod(model, shapes, weights)
        return LeanForward(self.forward, model.on(vectors[:, sizes > share * sizes[0]]))

    def _shape_error(self, lean: LeanForward, tries, seen: Sequence[SeenAt]) -> float:
        """Largest root mean square difference of a shape that is measured, at the sensors."""
        if self.evidence.shapes is None:
            return 0.0
        rows, off = self.forward.model.sensor_rows, 0.0
        for values, at in zip(tries, seen, strict=True):
            exact = _of_unit_size(rows @ at.shapes[:, at.index])
            x = _of_unit_size(lean.seen_shapes(values)[0])
            x = x * np.sign(np.sum(x * exact, axis=0))
            off = max(off, float(np.sqrt(np.mean((x - exact) ** 2, axis=0)).max()))
        return off

    # -- samples -------------------------------------------------------------------------------

    def _of(
        self, hypothesis: Hypothesis, effect: Effect | None, forward: Forward
    ) -> list[Snapshot]:
        """Modes all over the prior of an effect, beside what is uncertain in any case, by a forward
        of the reduced model in whatever terms."""
        key = "" if effect is None else effect.key
        if key not in self._snapshots:
            alone = replace(hypothesis, effects=() if effect is None else (effect,), name="alone",
                            unknown=False)  # fmt: skip
            points = self._values(alone, _PLACES if _is_placed(alone) else _POINTS, seed=3)
            self._snapshots[key] = _snapshots(seen_modes_at(forward, points))
        return self._snapshots[key]

    def _values(self, hypothesis: Hypothesis, count: int, seed: int) -> list[dict[str, float]]:
        return all_over(hypothesis, self.evidence, self.baseline, count, seed)


def _own(hypothesis: Hypothesis) -> tuple[Effect, ...]:
    """Its effects that change the model: what changes the sensors alone leaves it as it is."""
    return tuple(e for e in hypothesis.effects if e.apply is not None or e.loss is not None)


def _is_placed(hypothesis: Hypothesis) -> bool:
    """Whether a place is a parameter, so that any part of the model may change."""
    return any(prior.even for _, prior in hypothesis.priors)


def _snapshots(seen: Sequence[SeenAt]) -> list[Snapshot]:
    """What of modes makes a basis, where the test's are all there."""
    found = []
    for at in seen:
        if len(at.index):
            count = int(at.index.max()) + 1 + SPARE
            weights = np.where(np.isin(np.arange(at.shapes.shape[1]), at.index), 1.0, _OTHERS)
            found.append((at.shapes[:, :count], weights[:count]))
    return found


def _of_unit_size(shapes: np.ndarray) -> np.ndarray:
    """Columns of root mean square 1."""
    return shapes / np.sqrt(np.mean(shapes**2, axis=0))


def all_over(
    hypothesis: Hypothesis, evidence: Evidence, baseline: dict[str, float], count: int, seed: int
) -> list[dict[str, float]]:
    """Parameter values all over the priors of a hypothesis, and at its medians; each at one of the
    test's rows in turn, the outer first.

    Args:
        hypothesis: The hypothesis.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        count: Number of points, beside the medians and the steps of a parameter that has some.
        seed: Of the random numbers.
    """
    n, looks = len(evidence.conditions), hypothesis.looks
    rows, found = [0, n - 1, n // 2, n // 4, 3 * n // 4], []
    for i, z in enumerate(_points(hypothesis, count, seed)):
        row, look = rows[i % len(rows)], looks[(i // len(rows)) % len(looks)]
        found.append(hypothesis.values(z, evidence.conditions[row], baseline, row, look))
    return found


def _points(hypothesis: Hypothesis, count: int, seed: int) -> np.ndarray:
    """z at the medians, all over the priors of effects and tolerances, and at all values of a
    parameter that acts in steps, (n, d)."""
    some = hypothesis.own.stop
    limits = hypothesis.limits[:some]
    points = np.zeros((count + 2, len(hypothesis.priors)))
    if some:
        unit = qmc.Sobol(some, seed=seed).random_base2(int(np.ceil(np.log2(count))))[:count]
        points[2:, :some] = np.clip(_REACH * (2 * unit - 1), *limits.T)
    return np.vstack([points, *_steps(hypothesis)])


def _steps(hypothesis: Hypothesis) -> list[np.ndarray]:
    """Points at all values of each parameter that acts in steps, the others at their medians."""
    return [
        np.where(np.arange(len(hypothesis.priors)) == j, value, 0.0)
        for j, (_, prior) in enumerate(hypothesis.priors) if prior.scan
        for value in np.linspace(*hypothesis.limits[j], prior.scan)
    ]  # fmt: skip


def _ends(hypothesis: Hypothesis) -> list[np.ndarray]:
    """Points at either limit of each parameter of effects and tolerances, the others at their
    medians; and at all limits of the effects' together, where they are few."""
    own, found = hypothesis.own, []
    for j, limits in enumerate(hypothesis.limits[: own.stop]):
        at = np.arange(len(hypothesis.priors)) == j
        found += [np.where(at, limit, 0.0) for limit in limits]
    if 1 < own.stop - own.start <= _CORNERS:
        found += [hypothesis.at(np.array(corner)) for corner in product(*hypothesis.limits[own])]
    return found


def of_few_terms(
    hypothesis: Hypothesis, model: ArrayModel, evidence: Evidence, baseline: dict[str, float]
) -> ArrayModel:
    """A model in as few terms as a hypothesis changes: the model itself where that is nothing, or
    where a place is a parameter, which may be anywhere.

    Args:
        hypothesis: The hypothesis.
        model: The model.
        evidence: The test.
        baseline: Parameter values of the nominal model.
    """
    if _is_placed(hypothesis):
        return model
    free = changed(hypothesis, model.parameters, evidence, baseline)
    return merged(model, free, baseline) if free else model


def changed(
    hypothesis: Hypothesis, names: Iterable[str], evidence: Evidence, baseline: dict[str, float]
) -> list[str]:
    """Those of a model's parameters that a hypothesis changes somewhere in its priors, or in whose
    stiffness it dissipates.

    Args:
        hypothesis: The hypothesis.
        names: The parameters.
        evidence: The test.
        baseline: Parameter values of the nominal model.
    """
    wanted = all_over(hypothesis, evidence, baseline, _POINTS, seed=5)
    conditions = [float(condition) for condition in evidence.conditions]
    # What gives way from some size on does so at a limit, and perhaps at one condition alone.
    for z in (*_steps(hypothesis), *_ends(hypothesis)):
        wanted += [hypothesis.values(z, c, baseline, row) for row, c in enumerate(conditions)]
        wanted += [
            hypothesis.values(z, conditions[0], baseline, 0, look) for look in hypothesis.looks[1:]
        ]
    middle = np.zeros(len(hypothesis.priors))
    lossy = {key for c in conditions for key in hypothesis.losses(middle, c, 1.0)}
    return [
        name for name in names
        if name in lossy or any(v[name] != baseline[name] for v in wanted)
    ]  # fmt: skip

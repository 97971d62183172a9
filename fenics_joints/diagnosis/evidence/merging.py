"""Effects that are weighed as one.

*The same model.* Two sets of effects may give the same values of the model at the same prior
density, and are then one hypothesis: "compliance away from the bolts only" together with
"compliance at one joint" may be compliance "graded from zone to zone".

*The same predictions at different places.* A bolt and its mirror image, or two sets of loose bolts
that the sensors cannot tell apart, are one cause, with the prior odds of both: the data do not say
where it is.

Effects of different kinds that the test cannot tell apart stay separate and form a class
(`fenics_joints.diagnosis.evidence.classes`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE, ROUND_OFF
from fenics_joints.parallel import spread
from fenics_joints.reduction import ModalPrediction

#: Frequencies at which losses are compared, Hz. [numerical: chosen]
_HZ = (30.0, 700.0)
#: Step of derivatives that pair parameters, points at random that check the pairs, and where all
#: parameters are for a first look, in standard deviations of their priors. [numerical: chosen]
_STEP, _PROBES, _ALIKE = 1e-3, 3, 0.5


class KnownEffects:
    """The sets of effects that were considered so far, by what they do to the model.

    Args:
        baseline: Parameter values of the nominal model.
        conditions: Those of the test.
    """

    def __init__(self, baseline: Mapping[str, float], conditions: Iterable[float]):
        self._baseline, self._conditions = dict(baseline), tuple(float(c) for c in conditions)
        self._touched: dict[str, frozenset[str]] = {}
        self._met: dict[tuple, list[tuple[tuple[Effect, ...], dict]]] = {}

    def same(self, effects: Sequence[Effect]) -> tuple[Effect, ...] | None:
        """The first known set that does the same to the model; None if there is none, and the set
        is then known."""
        effects = tuple(effects)
        if not effects or any(e.sensing is not None for e in effects):
            return None
        alike, h = self._met.setdefault(self._outline(effects), []), Hypothesis(effects)
        # Where all parameters are alike, equal sets agree however these are paired.
        there = _made(h, np.full(len(h.priors), _ALIKE), self._baseline, self._conditions)
        for other, values in alike:
            if _close(there, values) and equal(effects, other, self._baseline, self._conditions):
                return other
        alike.append((effects, there))
        return None

    def _outline(self, effects: tuple[Effect, ...]) -> tuple:
        """A key that equal sets have in common, found without evaluating the model."""
        priors = sorted(repr(_known(p)) for e in effects for p in e.priors)
        touched = frozenset().union(*(self._touches(e) for e in effects))
        kinds = (
            any(getattr(e, key) for e in effects)
            for key in ("depends_on_condition", "by_level", "loss")
        )
        return tuple(priors), touched, tuple(kinds)

    def _touches(self, effect: Effect) -> frozenset[str]:
        if effect.key not in self._touched:
            self._touched[effect.key] = effect.touches(self._baseline, self._conditions)
        return self._touched[effect.key]


def distinct(
    effects: Iterable[Effect], baseline: Mapping[str, float], conditions: Iterable[float]
) -> tuple[Effect, ...]:
    """Effects without those that do the same to the model as an earlier one, whose description then
    names them.

    Args:
        effects: The effects.
        baseline: Parameter values of the nominal model.
        conditions: Those of the test.
    """
    known, found = KnownEffects(baseline, conditions), {}
    for effect in effects:
        same = known.same((effect,))
        if same is None:
            found[effect.key] = effect
            continue
        first = found[same[0].key]
        words = f"{first.describe} In this test it is equivalent to {effect.key}."
        found[first.key] = replace(first, describe=words.strip())
    return tuple(found.values())


def equal(
    a: Sequence[Effect],
    b: Sequence[Effect],
    baseline: Mapping[str, float],
    conditions: Sequence[float],
) -> bool:
    """Whether two sets of effects do the same to the model, with the same prior.

    They do if each parameter of one can be paired with a parameter of the other that has the same
    prior, so that all values and losses agree at every point: small changes from the medians pair
    them, and random points check the pairs.

    Args:
        a: Effects.
        b: Others.
        baseline: Parameter values of the nominal model.
        conditions: Those of the test.
    """
    first, second = Hypothesis(tuple(a)), Hypothesis(tuple(b))
    n = len(first.priors)
    if n != len(second.priors):
        return False

    def made(h: Hypothesis, z: np.ndarray) -> dict:
        return _made(h, z, dict(baseline), conditions)

    pairs = _paired(first, second, made)
    if pairs is None:
        return False
    rng = np.random.default_rng(1)
    for z in rng.uniform(-1.0, 1.0, (_PROBES, n)):
        other = np.zeros(n)
        other[pairs] = z
        if not _close(made(first, z), made(second, other)):
            return False
    return True


def _known(prior) -> tuple:
    return prior.median, prior.spread, prior.unit, prior.log, prior.span, prior.scan, prior.even


def _made(h: Hypothesis, z: np.ndarray, baseline: dict, conditions: Sequence[float]) -> dict:
    """Values and losses at all conditions, by what they are of."""
    found = {}
    for i, c in enumerate(conditions):
        found |= {(i, key): v for key, v in h.values(z, c, baseline).items()}
        for hz in _HZ:
            found |= {(i, hz, key): eta for key, eta in h.loss_factors(z, c, hz).items()}
    return found


def _paired(a: Hypothesis, b: Hypothesis, made) -> list[int] | None:
    """For each parameter of one its place in the other; None if they do not pair."""
    n, steps = len(a.priors), _STEP * np.eye(len(a.priors))
    others, pairs = [made(b, step) for step in steps], []
    for i in range(n):
        moved = made(a, steps[i])
        own = _known(a.priors[i][1])
        free = (j for j in range(n) if j not in pairs and _known(b.priors[j][1]) == own)
        j = next((j for j in free if _close(moved, others[j])), None)
        if j is None:
            return None
        pairs.append(j)
    return pairs


def _close(a: dict, b: dict) -> bool:
    """Whether two sets of values differ by round-off only."""
    if a.keys() != b.keys():
        return False
    return all(abs(a[k] - b[k]) <= ROUND_OFF * max(abs(a[k]), abs(b[k])) for k in a)


#: Distances from the medians, in standard deviations, at which effects are compared besides, one
#: parameter at a time: two that no test sees at their expected size may differ where they are
#: large. [decision: chosen]
_SIZES = (-3.0, -1.0, 1.0, 3.0)
#: Effects of a kind at most for which all are compared; of more, such as every three of a dozen
#: bolts, few are ever fitted. [numerical: chosen for time]
_MOST = 150


def merge_indistinguishable(
    effects: Sequence[Effect],
    forward: ModalPrediction,
    evidence: Evidence,
    baseline: dict[str, float],
    comm: MPI.Intracomm,
) -> tuple[Effect, ...]:
    """The effects, with those merged that differ in their place alone and predict the same test.
    Collective.

    Args:
        effects: The effects.
        forward: Predicts frequencies and shapes.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        comm: Communicator.
    """
    comparison = _Comparison(forward, evidence, baseline)
    kinds: dict[tuple, list[Effect]] = {}
    for effect in effects:
        kinds.setdefault(_kind(effect), []).append(effect)

    def alike(group: Sequence[Effect]) -> dict[str, str]:
        groups = _groups(group, comparison)
        return {other.key: chosen.key for chosen, others in groups for other in others}

    first = {e.key: e.key for e in effects}
    compared = [group for group in kinds.values() if 1 < len(group) <= _MOST]
    for found in spread(comm, compared, alike):
        first |= found
    members: dict[str, list[Effect]] = {}
    for effect in effects:
        members.setdefault(first[effect.key], []).append(effect)
    merged = {key: _merged(own) for key, own in members.items()}
    name = {key: merged[chosen].key for key, chosen in first.items()}
    return tuple(
        replace(e, holds=frozenset(name.get(key, key) for key in e.holds)) for e in merged.values()
    )


def _kind(effect: Effect) -> tuple:
    """Key under which effects may be merged; sensor faults never are."""
    own = effect.key if effect.sensing is not None or not effect.region else ""
    same = "name family weight priors by_level depends_on_condition drifts".split()
    return (own, effect.loss is None, *(getattr(effect, name) for name in same))


def _groups(group: Sequence[Effect], comparison: _Comparison) -> list[tuple[Effect, list[Effect]]]:
    """Each effect that predicts something new, with the later ones that predict the same."""
    found: list[tuple[Effect, list[Effect]]] = []
    for effect in group:
        for known, others in found:
            if comparison.same(effect, known):
                others.append(effect)
                break
        else:
            found.append((effect, []))
    return found


class _Comparison:
    """Compares effects by whitened predictions over their priors, all else at its median."""

    def __init__(self, forward: ModalPrediction, evidence: Evidence, baseline: dict[str, float]):
        self._given = forward, evidence, baseline
        self._lower = evidence.lower()
        self._known: dict[tuple[str, bool], np.ndarray] = {}

    def same(self, effect: Effect, other: Effect) -> bool:
        """Whether two effects predict the same; most differ at their medians already."""
        for far in (False, True):
            apart = np.linalg.norm(self._at(effect, far) - self._at(other, far), axis=1) / 2
            # One is then taken for the other with 46 % probability, and 50 % is chance.
            if not np.all(apart <= NEGLIGIBLE):
                return False
        return True

    def _at(self, effect: Effect, far: bool) -> np.ndarray:
        """Predictions at an effect's medians, or far from these, (n_points, k), remembered."""
        key = effect.key, far
        if key not in self._known:
            self._known[key] = self._solved(effect, far)
        return self._known[key]

    def _solved(self, effect: Effect, far: bool) -> np.ndarray:
        forward, evidence, baseline = self._given
        m = evidence.log_f.shape[1]
        hypothesis = Hypothesis(
            (effect,),
            modes=tuple(f"mode {j + 1}" for j in range(m)),
            damped=evidence.log_damping is not None,
            known=evidence.known,
        )
        d = len(effect.priors)
        limits = np.array([prior.limits() for prior in effect.priors]).reshape(d, 2)
        steps = np.vstack([size * np.eye(d) for size in _SIZES]) if far else np.zeros((1, d))
        z = np.array([hypothesis.at(point) for point in np.clip(steps, *limits.T)])
        predicted, _ = ManyPredictions(hypothesis, forward, evidence, baseline)(z)
        return whiten(self._lower, (predicted[:, evidence.fitted]).T).T


def _merged(own: Sequence[Effect]) -> Effect:
    """One effect in place of several, with their prior odds together."""
    if len(own) == 1:
        return own[0]
    places = "; ".join(e.region for e in own)
    words = f"In this test {len(own)} places are equivalent, each equally likely: {places}."
    return replace(
        own[0],
        region=" / ".join(e.region for e in own),
        weight=sum(e.weight for e in own),
        describe=f"{own[0].describe} {words}".strip(),
        holds=frozenset().union(*(e.holds for e in own)),
    )

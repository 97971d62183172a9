"""Effects at different places that predict the same of a test, which are weighed as one.

A bolt and its mirror image, or two sets of loose bolts that the sensors cannot tell apart, are one
cause whose place is a further parameter, of a few values: by the prior's share of each, for the
data say nothing of it. Two causes of different kinds that look alike are a class
(`fenics_joints.diagnosis.evidence.classes`) and stay two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.diagnosis.evidence.many import ManyPredictions
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE
from fenics_joints.reduction import Forward

#: How far from their medians, one by one, parameters are compared besides, in standard deviations:
#: what no test sees at its expected size is not yet the same where it is large. [decision: chosen]
_SIZES = (-3.0, -1.0, 1.0, 3.0)
#: Effects of a kind that are compared at most; of more, as of every three of a dozen bolts, few are
#: ever fitted. [numerical: chosen for time]
_MOST = 150


def one_of_alike(
    effects: Sequence[Effect],
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    comm: MPI.Intracomm,
) -> tuple[Effect, ...]:
    """Effects of which those that differ by their place alone, and not in this test, are one.

    Collective.

    Args:
        effects: The effects.
        forward: Predicts frequencies and shapes.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        comm: Communicator.
    """
    look = _Look(forward, evidence, baseline)
    kinds: dict[tuple, list[Effect]] = {}
    for effect in effects:
        kinds.setdefault(_kind(effect), []).append(effect)
    first = {e.key: e.key for e in effects}
    for group in kinds.values():
        for chosen, others in _groups(group, look) if 1 < len(group) <= _MOST else ():
            first |= {other.key: chosen.key for other in others}
    first = comm.bcast(first)  # one that is just alike on a rank may not be on another
    members: dict[str, list[Effect]] = {}
    for effect in effects:
        members.setdefault(first[effect.key], []).append(effect)
    merged = {key: _merged(own) for key, own in members.items()}
    name = {key: merged[chosen].key for key, chosen in first.items()}
    return tuple(
        replace(e, holds=frozenset(name.get(key, key) for key in e.holds)) for e in merged.values()
    )


def _kind(effect: Effect) -> tuple:
    """What effects have in common that can be one; a fault of a sensor is none of its like's."""
    own = effect.key if effect.sensing is not None or not effect.region else ""
    return (
        effect.name,
        own,
        effect.family,
        effect.weight,
        effect.priors,
        effect.by_level,
        effect.depends_on_condition,
        effect.drifts,
        effect.loss is None,
    )


def _groups(group: Sequence[Effect], look: _Look) -> list[tuple[Effect, list[Effect]]]:
    """Each effect that no earlier one is like, with those that are like it."""
    found: list[tuple[Effect, list[Effect]]] = []
    for effect in group:
        for known, others in found:
            if look.same(effect, known):
                others.append(effect)
                break
        else:
            found.append((effect, []))
    return found


class _Look:
    """Compares effects by whitened predictions over their priors, all else at its median."""

    def __init__(self, forward: Forward, evidence: Evidence, baseline: dict[str, float]):
        self._given = forward, evidence, baseline
        self._lower = evidence.lower()
        self._known: dict[tuple[str, bool], np.ndarray] = {}

    def same(self, effect: Effect, other: Effect) -> bool:
        """Whether two are the same; most differ at their medians already."""
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
    """One of them for all, with the prior odds of all."""
    if len(own) == 1:
        return own[0]
    places = "; ".join(e.region for e in own)
    words = f"To this test that is the same at {len(own)} places, each as likely: {places}."
    return replace(
        own[0],
        region=" / ".join(e.region for e in own),
        weight=sum(e.weight for e in own),
        describe=f"{own[0].describe} {words}".strip(),
        holds=frozenset().union(*(e.holds for e in own)),
    )

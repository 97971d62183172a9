"""A plan looks at a few of many sensors: what goes wrong at one goes wrong at the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Silent
from fenics_joints.diagnosis.effects.rig import MISPLACED, MISSCALED
from fenics_joints.diagnosis.plan.study import Measurement, Signature, Study, own_at

#: Of one kind of a sensor's faults so many stay. [numerical: chosen for time]
_KEPT = 4


def few_sensors(
    measurement: Measurement, effects: Sequence[Effect], baseline: Mapping[str, float]
) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """The effects without most sensors of a kind of fault, and what is to be said of these.

    The distances of all from all others grow with the square of their number. Those stay whose
    change, of the expected size and whitened, is the longest, the shortest and evenly between.

    Args:
        measurement: The test.
        effects: All effects.
        baseline: Parameter values of the nominal model.
    """
    kinds: dict[str, list[int]] = {}
    for i, effect in enumerate(effects):
        if effect.name in (MISPLACED, MISSCALED):
            kinds.setdefault(effect.name, []).append(i)
    study, left, silent = Study(measurement, effects, baseline), set(), []
    for name, members in kinds.items():
        if len(members) <= _KEPT:
            continue
        lengths = np.array([_length(study, effects[i]) for i in members])
        order = np.argsort(lengths, kind="stable")
        kept = order[np.round(np.linspace(0, len(order) - 1, _KEPT)).astype(int)]
        left |= {members[i] for i in set(range(len(members))) - set(kept.tolist())}
        silent.append(Silent(name, _words(len(members), lengths)))
    return tuple(e for i, e in enumerate(effects) if i not in left), tuple(silent)


def _length(study: Study, effect: Effect) -> float:
    """Of a sensor's change that the nuisances cannot make, linearly: half of it is D."""
    own = own_at(effect, 1.0)
    hypothesis, base = study.measurement.hypothesis(effect), study.baseline(effect)
    predicted, _ = study.measurement.predict(hypothesis, hypothesis.at(own), base)
    return float(np.linalg.norm(study.whitened(Signature(effect, own, predicted, np.nan))))


def _words(count: int, lengths: np.ndarray) -> str:
    low, high = lengths.min() / 2, lengths.max() / 2
    return (
        f"{count - _KEPT} of {count} sensors are left out of the plan; distances of all from no "
        f"gap are {low:.2g} to {high:.2g}, and those listed lie evenly between"
    )

"""Places in the space of parameters at which a reduced model is made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.stats import qmc

from fenics_joints.case import Case
from fenics_joints.case.sections import AttachedMass
from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.effects.part import CAUSES, SHEAR
from fenics_joints.diagnosis.effects.rig import MASS, SPRING
from fenics_joints.diagnosis.zones.sites import without_attached
from fenics_joints.diagnosis.zones.zone import bonded_values

#: How far from the median of its prior, in standard deviations, a parameter is put. [numerical:
#: chosen]
_WIDE = 1.5
#: Poisson's ratio, at least and at most. [numerical: chosen]
_NU = (-0.9, 0.47)
#: Stiffness of supports, Pa/m: of soft mounts, and from which on they are as good as rigid.
#: [numerical: chosen]
_SUPPORT = (1e9, 1e16)


def sample_ranges(case: Case) -> dict[str, tuple[float, float, bool]]:
    """Ranges (low, high, log) over which a reduced model must hold, by parameter of no joint."""
    values, ranges = bonded_values(case), {}
    for name in case.parts:
        for key, spread in CAUSES.items():
            # Two standard deviations: a basis from nearer samples is too stiff for a plate of
            # another thickness, and the hypothesis would lose for that.
            if f"{name}.{key}" in values:  # matrices have no thickness
                ranges[f"{name}.{key}"] = _about(values[f"{name}.{key}"], spread)
        if "nu" in case.mesh.lacks:
            continue
        nu = values[f"{name}.nu"]
        low, high = ((1 + nu) * np.exp(2 * sign * SHEAR) - 1 for sign in (-1, 1))
        ranges[f"{name}.nu"] = max(low, _NU[0]), min(high, max(nu, _NU[1])), False
    for name, section in case.masses.items():
        ranges[f"{name}.mass"] = _about(section.mass, MASS)
        if section.shift() is not None:
            ranges[f"{name}.travel"] = (*section.shift(), False)
    for name, section in case.springs.items():
        ranges[f"{name}.stiffness"] = _about(section.stiffness, SPRING)
    for name in case.supports:
        for key in ("k_n", "k_t"):
            if f"{name}.{key}" in values:
                ranges[f"{name}.{key}"] = (*_SUPPORT, True)
    for name, section in case.attached.items():
        key = "mass" if isinstance(section, AttachedMass) else "stiffness"
        ranges[f"{name}.{key}"] = (0.0, 1.5 * section.nominal()[key], False)
        if isinstance(section, AttachedMass) and section.shift() is not None:
            ranges[f"{name}.travel"] = (*section.shift(), False)
    return ranges


def _about(value: float, spread: float) -> tuple[float, float, bool]:
    return value * np.exp(-2 * spread), value * np.exp(2 * spread), True


def sample_values(
    effects: Sequence[Effect],
    baseline: Mapping[str, float],
    conditions: Sequence[float],
    count: int,
    seed: int,
    known: Iterable[str] = (),
) -> list[dict[str, float]]:
    """Parameter values with effects in them, at places of their priors from a Sobol sequence.

    The effects take turns, first each alone, then each with one of another family; and first one
    place of each kind, then the next, so that few samples leave no kind out. What changes nothing
    in the model is left out. Each place where a joint can give way comes once at least, however
    few samples there are: a basis without it would have it stiff at any stiffness.

    Args:
        effects: The effects.
        baseline: Values of the nominal model.
        conditions: The test's conditions, which take turns too.
        count: Number of samples; more where it takes more for every place.
        seed: Of the sequence.
        known: Parameters that are sampled otherwise; effects that change no others are left out.
    """
    alone = [e for e in effects if e.priors and not e.holds]
    acting = _kinds_first([e for e in alone if is_rare(e, baseline, known)])
    if not acting or count < 1:
        return []
    turns = [_turn(acting, i) for i in range(count)]
    turns += [(e,) for e in _left_out(acting, turns, baseline)]
    most = max(sum(len(e.priors) for e in turn) for turn in turns)
    exponent = int(np.ceil(np.log2(max(len(turns), 2))))
    places = _WIDE * (2 * qmc.Sobol(most, seed=seed).random_base2(exponent) - 1)
    found = []
    for i, turn in enumerate(turns):
        values, z = dict(baseline), iter(places[i])
        for effect in sorted(turn, key=lambda e: e.by_level):
            theta = {p.name: p.value(float(np.clip(next(z), *p.limits()))) for p in effect.priors}
            effect.apply(values, theta, float(conditions[i % len(conditions)]))
        found.append(without_attached(values, baseline))
    return [values for values in found if values != baseline]


def is_rare(effect: Effect, baseline: Mapping[str, float], known: Iterable[str]) -> bool:
    """Whether an effect changes parameters that are not sampled otherwise.

    Args:
        effect: The effect.
        baseline: Values of the nominal model.
        known: Parameters that are sampled otherwise.
    """
    return bool(effect.touches(baseline, (1.0,)) - set(known))


def _kinds_first(effects: Sequence[Effect]) -> list[Effect]:
    """The first place of each kind of effect, then the second of each, and so on."""
    met: Counter[str] = Counter()
    numbered = []
    for effect in effects:
        numbered.append((met[effect.name], effect))
        met[effect.name] += 1
    return [effect for _, effect in sorted(numbered, key=lambda pair: pair[0])]


def _left_out(
    effects: Sequence[Effect], turns: Sequence[tuple[Effect, ...]], baseline: Mapping[str, float]
) -> list[Effect]:
    """One effect for each set of parameters that none of those in turn changes."""
    touched = {e.key: e.touches(baseline, (1.0,)) for e in effects}
    met = {touched[e.key] for turn in turns for e in turn}
    left = {touched[e.key]: e for e in effects if touched[e.key] not in met}
    return list(left.values())


def _turn(effects: Sequence[Effect], i: int) -> tuple[Effect, ...]:
    """The effect whose turn it is, in later rounds with another."""
    n = len(effects)
    first, rounds = effects[i % n], i // n
    if rounds == 0:
        return (first,)
    others = [e for e in effects if (e.family or e.key) != (first.family or first.key)]
    return (first, others[(i + rounds) % len(others)]) if others else (first,)

"""The effects that a case with beams gives rise to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.diagnosis.effects.amplitude import amplitude_effects
from fenics_joints.diagnosis.effects.bolts import LOW_PRELOAD, low_preload
from fenics_joints.diagnosis.effects.damping import (
    HYSTERETIC,
    VISCOUS,
    has_ratios,
    hysteretic_damping,
    viscous_damping,
)
from fenics_joints.diagnosis.effects.effect import Effect, Silent
from fenics_joints.diagnosis.effects.lap import (
    KEYS,
    axial_error,
    graded_lap,
    lap_stiffness,
    loose_lap,
)
from fenics_joints.diagnosis.effects.library import (
    Group,
    by_preload,
    case_nuisances,
    common_groups,
    wanted_effects,
)
from fenics_joints.diagnosis.effects.rig import MISSED, missed_mode
from fenics_joints.diagnosis.zones.laps import LapZones, lap_as_one
from fenics_joints.measurements.data import TestData

__all__ = ["beam_effects", "beam_nuisances"]

_SLIP = (KEYS["slip"],)
#: What layers of solids may have, and joint elements not.
_OF_SOLIDS = {
    "joint compliance that falls with the pressure": (
        "joint elements of beams know no pressure; a stiffness graded along the lap is looked for"
    ),
    "contact lost at low pressure": (
        "joint elements have their beams' own stiffness too, which no loss of contact takes"
    ),
}


def beam_effects(
    case: Case, data: TestData, laps: LapZones | None
) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """The effects that a case with beams can hold, and those its test cannot speak of.

    Args:
        case: The case, with a joint section for each zone.
        data: The test.
        laps: Its zones; None without laps.

    Raises:
        InputError: If the case asks for an effect that is not there.
    """
    (parts, silent), *others = common_groups(case, data)
    parts = [_following_the_parts(effect, case, laps) for effect in parts]
    joints = _joints(case, data, laps)
    return wanted_effects(case, [*joints, (parts, silent), *others, _missed_modes(data)])


def beam_nuisances(case: Case, laps: LapZones | None) -> tuple[Effect, ...]:
    """See `fenics_joints.diagnosis.effects.library.case_nuisances`."""
    return tuple(_following_the_parts(effect, case, laps) for effect in case_nuisances(case))


def _joints(case: Case, data: TestData, laps: LapZones | None) -> list[Group]:
    """Effects in laps, and those that they or the test cannot speak of."""
    if laps is None:
        return [amplitude_effects(data, ())]
    reference = float(data.conditions[-1]) if by_preload(data) else None
    series = case.diagnose.joints == "bonded"
    silent = tuple(Silent(name, reason) for name, reason in _OF_SOLIDS.items())
    return [
        (_stiffness(laps, series, reference), silent),
        _bolts(laps, series),
        _damping(data, laps),
        amplitude_effects(data, laps.names, _SLIP, tuple(KEYS.values())),
    ]


def _stiffness(laps: LapZones, series: bool, reference: float | None) -> list[Effect]:
    whole, both = "joint", tuple(KEYS)
    kinds = {
        ("slap",): "The lap opens and shears more or less than the model says.",
        ("slip",): "The lap slides, and so bends, more or less than the model says.",
        both: "It does both.",
    }
    effects = [
        lap_stiffness(
            f"joint {' and '.join(kind)} stiffness", whole, laps.names, kind, series, reference,
            words,
        )
        for kind, words in kinds.items()
    ]  # fmt: skip
    single = {laps.words[zone]: (zone,) for zone in laps.names}
    symmetric, origin = laps.symmetric, "bolt" if len(laps.bolts) else "middle of the lap"
    for kind in kinds:
        if len(symmetric) > 1:
            effects.append(graded_lap(symmetric, kind, origin, series, reference))
        if len(single) > len(symmetric):
            effects.append(graded_lap(single, kind, None, series, reference))
    along = {lap.name: lap.along for lap in laps.laps}
    where = ", ".join(along) if len(along) < 3 else "all laps"
    effects.append(axial_error(tuple(along.values()), where))
    if len(along) > 1:
        share = 1 / len(along)
        effects += [axial_error((own,), name, share) for name, own in along.items()]
        effects += [
            lap_stiffness(
                "joint stiffness at one lap", name, zones, both, series, reference,
                f"{name} alone is softer or stiffer than the model says.",
                family="one place", weight=share,
            )
            for name, zones in laps.by_lap.items()
        ]  # fmt: skip
    return effects


def _bolts(laps: LapZones, series: bool) -> Group:
    bolts = laps.by_bolt if len(laps.by_bolt) > 1 else {}
    share = 1 / max(len(bolts), 1)
    effects = [loose_lap(name, own, share) for name, own in bolts.items()]
    if series:
        reason = (
            "the nominal lap is as one piece, so that nothing in it depends on the preload; "
            '[diagnose] joints = "given" takes the stiffness that the case gives'
        )
        return effects, (Silent(LOW_PRELOAD, reason),)
    if not len(laps.bolts):
        reason = "no lap has a bolt ([joints.NAME] bolted, or bolts)"
        return effects, (Silent(LOW_PRELOAD, reason),)
    keys, pressed = tuple(KEYS.values()), sum(laps.by_bolt.values(), ())
    effects.append(low_preload("joint", pressed, LOW_PRELOAD, keys=keys))
    name = "preload of one bolt lower than nominal"
    return [*effects, *(low_preload(b, z, name, share, keys) for b, z in bolts.items())], ()


def _damping(data: TestData, laps: LapZones) -> Group:
    """Slip alone is damped, as in eq. 3 of seed 002."""
    if not has_ratios(data):
        reason = "the test has no damping ratios of known accuracy ([test] damping, damping_noise)"
        return (), tuple(Silent(name, reason) for name in (HYSTERETIC, VISCOUS))
    middle = float(np.exp(np.nanmean(np.log(data.frequencies_hz))))
    slipping = hysteretic_damping(laps.names, _SLIP), viscous_damping(laps.names, middle, _SLIP)
    return slipping, ()


def _following_the_parts(effect: Effect, case: Case, laps: LapZones | None) -> Effect:
    """The same effect, with the stiffness of a lap that is as one piece going with its parts'.

    Args:
        effect: An error of parts.
        case: The case.
        laps: Its laps; None without.
    """
    if effect.apply is None or laps is None or case.diagnose.joints != "bonded":
        return effect

    def apply(values, theta, condition):
        before = lap_as_one(case, laps, values)
        effect.apply(values, theta, condition)
        for key, k in lap_as_one(case, laps, values).items():
            values[key] *= k / before[key]

    return replace(effect, apply=apply)


def _missed_modes(data: TestData) -> Group:
    """Modes of the beams that the test did not find, such as those along them.

    Of beams alone: their model has no torsion and no motion across the plane, and its modes along
    the beams hardly show in the plane, so that counting modes goes wrong easily.
    """
    reasons = {
        "measured shapes say which mode is which": data.shapes is not None,
        "damping ratios of one mode more are not predicted": has_ratios(data),
        "the test is by level, and its modes are followed": data.by_level,
    }
    for reason, applies in reasons.items():
        if applies:
            return (), (Silent(MISSED, reason),)
    return tuple(missed_mode(j, data.mode_names) for j in range(len(data.mode_names))), ()

"""Effects in laps of beams: the slap and the slip of their joint elements (seed 002, eq. 2).

Where the nominal lap is as one piece, an effect puts a stiffness in series with its k1 and k2,
relative to theirs, slap and slip; where the case gives k1 and k2, these are factors on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior, relative_error

__all__ = ["KEYS", "axial_error", "graded_lap", "lap_stiffness", "loose_lap"]

#: Parameters of a zone of joint elements, by what they resist.
KEYS = {"slap": "k1", "slip": "k2"}
FAMILY = "lap stiffness"
#: In series with a lap as one piece: as stiff as it, within a factor of 30 either way, the same
#: spread as of clamped faces.
_SERIES = (1.0, np.log(30.0), (1e-5, 1e6))
#: Factor on a stiffness that was given: identified elsewhere, or taken from a like joint.
_FACTOR = (1.0, np.log(3.0), (1e-3, 1e3))
#: Exponent of K = alpha P^beta (seed 001, eqs. 22 and 23), P proportional to the torque.
_EXPONENT = (0.5, 0.3, (0.0, 1.5))
#: What is left of the stiffness where a bolt does not press: a tenth, within a factor of 3.
_LEFT = (0.1, np.log(3.0), (1e-4, 1.0))
#: Spread of the factor on the axial stiffness.
_AXIAL = np.log(3.0)
#: Prior odds of a law that describes a distribution of stiffness without a physical reason for it.
_DESCRIPTION = 0.25


def _prior(name: str, series: bool) -> Prior:
    median, spread, span = _SERIES if series else _FACTOR
    return Prior(name, median, spread, "", True, span)


def lap_stiffness(
    name: str,
    region: str,
    zones: Sequence[str],
    kinds: Sequence[str],
    series: bool,
    reference: float | None,
    describe: str,
    *,
    family: str = FAMILY,
    weight: float = 1.0,
) -> Effect:
    """The stiffness of slap, of slip, or both, of some zones together.

    Args:
        name: Name of the effect.
        region: Where, for people.
        zones: The zones; each has parameters ``ZONE.k1`` and ``ZONE.k2``.
        kinds: Of ``"slap"`` and ``"slip"``.
        series: Whether the nominal lap is as one piece, and this in series with it; else a factor.
        reference: Torque at which the stiffness holds; None when the test has one torque only.
        describe: Sentence for the report.
        family: Effects that it stands for.
        weight: Prior odds relative to other effects.
    """
    groups = {"": tuple(zones)}
    return _lap(name, region, groups, kinds, series, reference, describe, family, weight)


def graded_lap(
    groups: Mapping[str, Sequence[str]],
    kinds: Sequence[str],
    origin: str | None,
    series: bool,
    reference: float | None,
) -> Effect:
    """Stiffnesses of their own in groups of zones along the laps.

    Args:
        groups: Zones of each group, by its name.
        kinds: Of ``"slap"`` and ``"slip"``.
        origin: What zones of a group are as far from; None if each zone is a group.
        series: See `lap_stiffness`.
        reference: Likewise.
    """
    how = "zone by zone" if origin is None else f"by the distance from the {origin}"
    what = " and ".join(kinds)
    name = f"joint {what} stiffness graded {how}"
    words = f"The stiffness of {what} is not the same all along the lap: it differs {how}."
    return _lap(
        name, "joint", groups, kinds, series, reference, words, FAMILY, _DESCRIPTION
    )


def _lap(name, region, groups, kinds, series, reference, describe, family, weight) -> Effect:
    def label(group: str, kind: str) -> str:
        return f"{group}, {kind}" if group else kind

    priors = [_prior(label(group, kind), series) for group in groups for kind in kinds]
    if reference is not None:
        mean, sd, limits = _EXPONENT
        priors += [Prior(f"beta of {kind}", mean, sd, "", False, limits) for kind in kinds]

    def apply(values, theta, condition):
        for kind in kinds:
            factor = 1.0
            if reference is not None:
                factor = (condition / reference) ** theta[f"beta of {kind}"]
            for group, zones in groups.items():
                k = theta[label(group, kind)] * factor
                for zone in zones:
                    values[f"{zone}.{KEYS[kind]}"] *= 1 / (1 + 1 / k) if series else k

    by_torque = reference is not None
    return Effect(
        name, region, tuple(priors), apply, describe, by_torque, family, weight=weight
    )


def loose_lap(region: str, zones: Sequence[str], weight: float) -> Effect:
    """One bolt of several that does not press: a share of the stiffness is left around it.

    Args:
        region: The bolt.
        zones: The zones nearest to it.
        weight: Prior odds: one over the number of bolts.
    """

    def apply(values, theta, condition):
        for zone in zones:
            for key in KEYS.values():
                values[f"{zone}.{key}"] *= theta["left"]

    median, spread, span = _LEFT
    words = (
        f"{region[:1].upper()}{region[1:]} is loose, or missing, and the lap softer around it. All "
        "bolts equally loose are the joint's stiffness as a whole."
    )
    prior = Prior("left", median, spread, "", True, span)
    return Effect("loose bolt", region, (prior,), apply, words, family="bolt", weight=weight)


def axial_error(laps: Sequence[str], region: str, weight: float = 1.0) -> Effect:
    """The axial stiffness of laps, which the model takes from the beams or the case.

    Args:
        laps: The laps along the beams; each has a parameter ``LAP.axial``.
        region: Where, for people.
        weight: Prior odds relative to other effects.
    """
    words = "Along the beams the lap is softer or stiffer than the two beams side by side."
    return relative_error(
        "joint axial stiffness", region, [f"{lap}.axial" for lap in laps], _AXIAL, words,
        span=(1e-3, 1e3), weight=weight,
    )  # fmt: skip

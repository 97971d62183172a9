"""Effects in the parts: errors of their material and dimensions, and their temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.dimensions import unfit
from fenics_joints.diagnosis.effects.effect import (
    Effect,
    Found,
    Prior,
    Setting,
    Silent,
    relative_error,
)
from fenics_joints.diagnosis.zones.laps import lap_as_one
from fenics_joints.diagnosis.zones.zone import Zones

#: Spread of a part's property as a cause, far beyond its tolerance: a wrong material or gauge.
#: [prior: chosen]
CAUSES = {"E": 0.15, "rho": 0.10, "thickness": 0.10, "width": 0.10}
DIMENSIONS = ("thickness", "width")
_WORDS = {"E": "modulus", "rho": "density", "thickness": "thickness", "width": "width"}
#: The same of a shear modulus at the same Young's modulus: Poisson's ratio of a metal, of which few
#: tables give more than a digit, is 0.25 to 0.4, which is some 6 % of G. [prior: handbooks of
#: metals: Poisson's ratios]
SHEAR = 0.06
#: Largest Poisson's ratio: models of nearly incompressible material lock beyond.
#: [numerical: chosen]
NU = 0.49
#: Relative change of Young's modulus with the temperature, 1/K. Handbooks of metals have some
#: -3e-4 for steels (Ledbetter and Reed, J. Phys. Chem. Ref. Data 2, 1973) and -5e-4 for aluminium
#: alloys; the difference is far below what is known of the temperature itself. [prior: Ledbetter
#: and Reed 1973]
_BY_KELVIN = -4e-4
#: Temperature of a test against that of the material's data, and its drift in a test, K: as a
#: cause, hence a cold hall, the sun or a chamber rather than a laboratory. [prior: chosen]
_OFFSET = Prior("offset", 0.0, 30.0, "K", False, (-100.0, np.inf))
#: Drift of it in a test, K. [prior: chosen]
_DRIFT = Prior("drift", 0.0, 10.0, "K", False)


def part_error(key: str, parts: Sequence[str], weight: float = 1.0, whole: bool = False) -> Effect:
    """A property of one part, or of several together, that is not what the model says.

    Args:
        key: ``E``, ``rho``, ``thickness`` or ``width``.
        parts: Names of the parts.
        weight: Prior odds: one over the number of parts for one of them.
        whole: Whether these are all parts.
    """
    name, region, words = _said(_WORDS[key], parts, whole)
    targets = [f"{part}.{key}" for part in parts]
    return relative_error(name, region, targets, CAUSES[key], words, weight=weight)


def shear_error(
    parts: Sequence[str], nu: float, weight: float = 1.0, whole: bool = False
) -> Effect:
    """A shear modulus, of parts of one material, that is not what the model says while E is.

    G times a factor is Poisson's ratio (1 + nu) / factor - 1: twist and shear feel it, and the
    bending of plates a little; a modulus error takes G with it.

    Args:
        parts: Names of the parts.
        nu: Their nominal Poisson's ratio.
        weight: See `part_error`.
        whole: Likewise.
    """

    most, least = max(NU, 0.5 * (nu + 0.5)), 0.0 if nu > 0 else 0.5 * (nu - 1)

    def apply(values, theta, condition):
        for part in parts:
            # Another effect, or a tolerance, may have raised it already.
            values[f"{part}.nu"] = np.minimum(
                (1 + values[f"{part}.nu"]) / theta["factor"] - 1, most
            )

    name, region, words = _said("shear modulus", parts, whole)
    span = (1 + nu) / (1 + most), (1 + nu) / (1 + least)
    prior = Prior("factor", 1.0, SHEAR, "", True, span)
    words = f"{words[:-1]} at the same Young's modulus, as with another Poisson's ratio."
    return Effect(name, region, (prior,), apply, words, weight=weight)


def _said(word: str, parts: Sequence[str], whole: bool) -> tuple[str, str, str]:
    """Name and region of an error of a property, and a sentence on it."""
    if len(parts) == 1:
        return f"{word} error", parts[0], f"The {word} of {parts[0]} differs from the model's."
    name = f"{word} error of {'all' if whole else 'several'} parts"
    region = "all parts" if whole else ", ".join(parts)
    return name, region, f"The {word} of {region} differs from the model's by one common factor."


def temperature(parts: Sequence[str], conditions: Sequence[float], drifts: bool) -> Effect:
    """A test at another temperature than the material's data, and one that drifts.

    E of every part times 1 + alpha dT, with dT = offset + drift x, and x from 0 at the first
    condition to 1 at the last, by their order. What it does to preloads is not in it.

    Args:
        parts: Names of the parts.
        conditions: The test's conditions, ascending.
        drifts: Whether the temperature may drift from the first condition to the last.
    """
    drifts = drifts and len(conditions) > 1
    place = np.linspace(0.0, 1.0, len(conditions))

    def apply(values, theta, condition):
        warmer = theta["offset"]
        if drifts:
            warmer = warmer + theta["drift"] * np.interp(condition, conditions, place)
        for part in parts:
            values[f"{part}.E"] *= 1 + _BY_KELVIN * warmer

    words = "The test was warmer or colder than the material's data, or its temperature drifted."
    # Not by the condition as far as a hypothesis asks: tightening does not scatter a temperature.
    return Effect(
        "temperature",
        "all parts",
        (_OFFSET, _DRIFT) if drifts else (_OFFSET,),
        apply,
        words,
        family="temperature",
        drifts=drifts,
    )


def part_effects(s: Setting) -> Found:
    """Errors of the parts of a case, and those that its model cannot represent."""
    parts, alike = tuple(s.case.parts), {}
    if not parts:  # a model by forms
        return
    for name, part in s.case.parts.items():
        nominal = part.nominal()
        alike.setdefault((nominal["E"], nominal["nu"], nominal["rho"]), []).append(name)
    asked = [(key, [name], 1 / len(parts), False) for name in parts for key in CAUSES]
    asked += [("nu", [name], 1 / len(parts), False) for name in parts]
    for group in alike.values():
        if len(group) > 1:
            asked += [(key, group, 1.0, len(group) == len(parts)) for key in (*CAUSES, "nu")]
    left_out: dict[tuple[str, str], list[str]] = {}
    for key, group, *more in asked:
        if key == "nu":
            effect = shear_error(group, s.case.parts[group[0]].nominal()["nu"], *more)
        else:
            effect = part_error(key, group, *more)
        reason = unfit(s.dimensions, [f"{part}.{key}" for part in group])
        if reason is not None:
            left_out.setdefault((effect.name, reason), []).append(effect.region)
            continue
        yield with_laps(effect, s.case, s.zones)
    # By level a mode's amplitude stands in for the condition, whose order is then lost.
    warmer = temperature(parts, s.data.conditions, drifts=not s.data.by_level)
    yield with_laps(warmer, s.case, s.zones)
    for (name, reason), where in left_out.items():
        yield Silent(name, f"of {', '.join(where)}: {reason}")


def with_laps(effect: Effect, case: Case, zones: Zones) -> Effect:
    """The same effect, with the stiffness of a lap that is as one piece going with its parts'.

    Args:
        effect: An error of parts.
        case: The case.
        zones: Its joints in zones.
    """
    if effect.apply is None or not zones.laps or case.diagnose.joints != "bonded":
        return effect

    def apply(values, theta, condition):
        before = lap_as_one(case, zones, values)
        effect.apply(values, theta, condition)
        for key, k in lap_as_one(case, zones, values).items():
            values[key] *= k / before[key]

    return replace(effect, apply=apply)

"""The effects that a case gives rise to, and what is uncertain in any case."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case_sections import AttachedMass
from fenics_joints.diagnosis.amplitude import NAMES, amplitude_effects
from fenics_joints.diagnosis.contact_zones import ContactZones
from fenics_joints.diagnosis.effects import (
    Effect,
    Prior,
    attached,
    compliance,
    lost_contact,
    placed,
    pressed_compliance,
    relative_error,
    two_zones,
)
from fenics_joints.diagnosis.result import Silent
from fenics_joints.errors import InputError
from fenics_joints.forms import lame_parameters
from fenics_joints.measurements import TestData
from fenics_joints.structure import Structure

__all__ = [
    "bonded_values", "by_preload", "case_effects", "case_nuisances", "layer_thickness",
    "sample_ranges",
]  # fmt: skip

#: Spread of a part's property as a cause, far beyond its tolerance: a wrong material or gauge.
_CAUSE = {"E": 0.15, "rho": 0.10, "thickness": 0.10}
#: Tolerances where the case gives none: handbook values, rolled plate.
_TOLERANCE = {"E": 0.015, "rho": 0.01, "thickness": 0.005}
_WORDS = {"E": "modulus error", "rho": "density error", "thickness": "thickness error"}
#: Relative spread of an attached mass or spring without a tolerance.
_ATTACHED = {"mass": 0.3, "stiffness": 1.0}


def layer_thickness(structure: Structure) -> dict[str, float]:
    """Thickness, m, of every joint's layer by the joint's name. Collective."""
    return {
        region.name: structure.extent(number)
        for number, region in enumerate(structure.regions)
        if region.is_joint
    }


def bonded_values(case: Case) -> dict[str, float]:
    """Parameter values of the model with the parts bonded: nothing of the joint assumed.

    The layers, with the uncoupled law, get the constrained modulus and the shear modulus of the
    stiffest part.
    """
    values = case.nominal(attached=True)
    nominal = [part.nominal() for part in case.parts.values()]
    stiffest = max(nominal, key=lambda part: part["E"])
    lmbda, mu = lame_parameters(stiffest["E"], stiffest["nu"])
    for name in case.joints:
        values[f"{name}.E"], values[f"{name}.G"] = lmbda + 2 * mu, mu
    return values


def case_nuisances(case: Case) -> tuple[Effect, ...]:
    """What is known within tolerance only, and free in every hypothesis."""
    given = case.tolerances()
    found = []
    for name in case.parts:
        for key, usual in _TOLERANCE.items():
            spread = given.get(f"{name}.{key}", usual)
            if spread > 0:
                words = f"{key} of {name}, within tolerance"
                found.append(relative_error(words, name, [f"{name}.{key}"], spread, ""))
    for name, section in case.masses.items():
        label = name.replace("_", " ")
        if section.tolerance:
            words = f"mass of {label}, within tolerance"
            found.append(relative_error(words, name, [f"{name}.mass"], section.tolerance, ""))
        if section.shift() is not None:
            found.append(placed(f"place of {label}", name, section.shift()))
    return tuple(found)


def case_effects(
    case: Case,
    data: TestData,
    thickness: dict[str, float],
    zones: ContactZones | None = None,
) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """The effects of the library that this case can hold, and those its test cannot speak of.

    Args:
        case: The case.
        data: The test.
        thickness: Layer thickness of each joint, m.
        zones: The contact whose zones the joints are; None if they are layers of the case's own.

    Raises:
        InputError: If the case asks for an effect that is not there.
    """
    reference = float(data.conditions[-1]) if by_preload(data) else None
    joints = _joint_effects(case, thickness, reference, zones)
    by_level, silent = amplitude_effects(data, tuple(case.joints))
    effects = (*joints, *_part_effects(case), *_attached_effects(case), *by_level)
    wanted = case.diagnose.effects
    if wanted is None:
        return effects, silent
    names = {effect.name for effect in effects} | set(NAMES)
    for name in wanted:
        if name not in names:
            raise InputError(
                f"{case.path}: diagnose.effects: {name!r} does not exist; expected some of: "
                f"{', '.join(sorted(names))}."
            )
    silent = tuple(s for s in silent if s.effect in wanted)
    return tuple(effect for effect in effects if effect.name in wanted), silent


def by_preload(data: TestData) -> bool:
    """Whether the test has several torques (or other preloads), by which joints may stiffen."""
    return len(data) > 1 and bool(np.all(data.conditions > 0)) and not data.by_level


def _joint_effects(case: Case, thickness, reference, contact) -> list[Effect]:
    zones = tuple(case.joints)
    if not zones:
        return []
    kinds = {
        "joint normal compliance": (True, False, "The interface gives way across its plane."),
        "joint tangential compliance": (False, True, "The interface gives way along its plane."),
        "joint normal and tangential compliance": (True, True, "It gives way both ways."),
    }
    effects = [
        compliance(
            name, "joint", zones, thickness,
            normal=n, tangential=t, reference=reference, describe=words,
        )
        for name, (n, t, words) in kinds.items()
    ]  # fmt: skip
    if contact is not None:
        names, low, high = contact.names, contact.low, contact.high
        effects.append(pressed_compliance(names, contact.pressure, thickness))
        return [*effects, lost_contact(names, low, high)]
    away = tuple(name for name, section in case.joints.items() if not section.bolted)
    if away and len(away) < len(zones):
        effects.append(
            compliance(
                "compliance away from the bolts only", ", ".join(away), away, thickness,
                normal=True, tangential=True, reference=reference,
                describe="The plates are as one under the bolts and barely touch elsewhere.",
            )
        )  # fmt: skip
    if len(zones) > 1:
        words = "The interface gives way, differently under the bolts and away from them."
        effects.append(two_zones(zones, thickness, reference, words))
    return effects


def _part_effects(case: Case) -> list[Effect]:
    effects = []
    for name in case.parts:
        for key, spread in _CAUSE.items():
            words = f"The {_WORDS[key].split()[0]} of {name} is not what the model says."
            effects.append(relative_error(_WORDS[key], name, [f"{name}.{key}"], spread, words))
    return effects


def _attached_effects(case: Case) -> list[Effect]:
    given = case.tolerances()
    effects = []
    for name, section in case.attached.items():
        is_mass = isinstance(section, AttachedMass)
        key = "mass" if is_mass else "stiffness"
        value = section.nominal()[key]
        spread = given.get(f"{name}.{key}", _ATTACHED[key])
        unit = "kg" if is_mass else "N/m"
        priors = [Prior(key, value, max(spread, 1e-3), unit, True, (1e-3 * value, 1e3 * value))]
        if is_mass and section.shift() is not None:
            low, high = section.shift()
            priors.append(Prior("travel", 0.0, (high - low) / 4, "m", False, (low, high)))
        label = name.replace("_", " ")
        words = f"The {key} of the {label} acts on the structure; the nominal model leaves it out."
        effects.append(attached(f"{label} {key}", label, name, tuple(priors), words))
    return effects


def sample_ranges(
    case: Case, thickness: Mapping[str, float]
) -> dict[str, tuple[float, float, bool]]:
    """Ranges (low, high, log) over which a reduced model must hold, by parameter.

    Args:
        case: The case.
        thickness: Layer thickness, m, of the joints whose moduli are to be among them.
    """
    ranges = {}
    bonded = bonded_values(case)
    for name, h in thickness.items():
        for key in ("E", "G"):
            ranges[f"{name}.{key}"] = (3e8 * h, bonded[f"{name}.{key}"], True)
    for name, part in case.parts.items():
        for key, spread in _CAUSE.items():
            # Two standard deviations: a basis from nearer samples is too stiff for a plate of
            # another thickness, and the hypothesis would lose for that.
            nominal, width = part.nominal()[key], 2 * spread
            ranges[f"{name}.{key}"] = (nominal * np.exp(-width), nominal * np.exp(width), True)
    for name, section in case.masses.items():
        if section.shift() is not None:
            ranges[f"{name}.travel"] = (*section.shift(), False)
    for name, section in case.attached.items():
        key = "mass" if isinstance(section, AttachedMass) else "stiffness"
        value = section.nominal()[key]
        ranges[f"{name}.{key}"] = (0.0, 1.5 * value, False)
        if isinstance(section, AttachedMass) and section.shift() is not None:
            ranges[f"{name}.travel"] = (*section.shift(), False)
    return ranges

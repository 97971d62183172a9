"""The effects that a case gives rise to, and what is uncertain in any case."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.sections import AttachedMass
from fenics_joints.diagnosis.effects.amplitude import NAMES, amplitude_effects
from fenics_joints.diagnosis.effects.bolts import LOW_PRELOAD, loose_bolt, low_preload
from fenics_joints.diagnosis.effects.damping import (
    HYSTERETIC,
    VISCOUS,
    has_ratios,
    hysteretic_damping,
    viscous_damping,
)
from fenics_joints.diagnosis.effects.effect import Effect, Prior, Silent, relative_error
from fenics_joints.diagnosis.effects.joint import (
    compliance,
    graded_compliance,
    lost_beyond,
    lost_contact,
    pressed_by_bolts,
    pressed_compliance,
)
from fenics_joints.diagnosis.effects.part import CAUSES, part_error, temperature
from fenics_joints.diagnosis.effects.rig import (
    MISPLACED,
    MISSCALED,
    attached,
    mass_error,
    misplaced_sensor,
    misscaled_sensor,
    placed,
    spring_error,
    support_compliance,
    swapped_modes,
)
from fenics_joints.diagnosis.effects.samples import sample_ranges, sample_values
from fenics_joints.diagnosis.zones.contacts import ContactZones
from fenics_joints.diagnosis.zones.joints import JointZones
from fenics_joints.diagnosis.zones.nominal import bonded_values, layer_thickness
from fenics_joints.diagnosis.zones.places import JointPlaces, joint_places
from fenics_joints.errors import InputError
from fenics_joints.measurements.data import TestData

__all__ = [
    "Group", "bonded_values", "by_preload", "case_effects", "case_nuisances", "common_groups",
    "layer_thickness", "sample_ranges", "sample_values", "wanted_effects",
]  # fmt: skip

#: Tolerances where the case gives none: handbook values, rolled plate. Of a width only what the
#: case says: it is milled, and bending does not see it.
_TOLERANCE = {"E": 0.015, "rho": 0.01, "thickness": 0.005, "width": 0.0}
#: Relative spread of an attached mass or spring without a tolerance.
_ATTACHED = {"mass": 0.3, "stiffness": 1.0}
#: Effects, and those that the test cannot speak of.
Group = tuple[Sequence[Effect], Sequence[Silent]]


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
    for name, section in case.springs.items():
        if section.tolerance:
            words = f"stiffness of {name.replace('_', ' ')}, within tolerance"
            key = f"{name}.stiffness"
            found.append(relative_error(words, name, [key], section.tolerance, ""))
    return tuple(found)


# -- causes ----------------------------------------------------------------------------------------


def case_effects(
    case: Case,
    data: TestData,
    thickness: dict[str, float],
    zones: ContactZones | JointZones | None = None,
) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """The effects of the library that this case can hold, and those its test cannot speak of.

    Of solid bodies; for beams see `fenics_joints.diagnosis.effects.lap_library.beam_effects`.

    Args:
        case: The case, with a joint for each zone.
        data: The test.
        thickness: Layer thickness of each joint, m.
        zones: How its contact or its joints were split; None if they are the case's own layers.

    Raises:
        InputError: If the case asks for an effect that is not there.
    """
    reference = float(data.conditions[-1]) if by_preload(data) else None
    joints = [
        (_joint_effects(case, thickness, reference, zones), ()),
        _bolt_effects(case, thickness, zones),
        _damping_effects(case, data),
        amplitude_effects(data, tuple(case.joints)),
    ]
    return wanted_effects(case, [*joints, *common_groups(case, data)])


def common_groups(case: Case, data: TestData) -> list[Group]:
    """Effects in parts, in what is attached to them, and in the test."""
    return [(_part_effects(case, data), ()), (_attached_effects(case), ()), _test_effects(data)]


def wanted_effects(
    case: Case, groups: Sequence[Group]
) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """Those that the case asks for, all by default.

    Raises:
        InputError: If it asks for one that is not there.
    """
    effects = tuple(effect for found, _ in groups for effect in found)
    silent = tuple(one for _, left_out in groups for one in left_out)
    wanted = case.diagnose.effects
    if wanted is None:
        return effects, silent
    names = {effect.name for effect in effects} | {s.effect for s in silent} | set(NAMES)
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


def _places(case: Case, zones) -> JointPlaces:
    return joint_places(case, zones if isinstance(zones, JointZones) else None)


def _joint_effects(case: Case, thickness, reference, zones) -> list[Effect]:
    names = tuple(case.joints)
    if not names:
        return []
    kinds = {
        "joint normal compliance": (True, False, "The interface gives way across its plane."),
        "joint tangential compliance": (False, True, "The interface gives way along its plane."),
        "joint normal and tangential compliance": (True, True, "It gives way both ways."),
    }
    effects = [
        compliance(
            name, "joint", names, thickness,
            normal=n, tangential=t, reference=reference, describe=words,
        )
        for name, (n, t, words) in kinds.items()
    ]  # fmt: skip
    if isinstance(zones, ContactZones):
        effects.append(pressed_compliance(zones.names, zones.pressure, thickness))
        return [*effects, lost_contact(zones.names, zones.low, zones.high)]
    return effects + _placed_compliance(_places(case, zones), thickness, reference)


def _placed_compliance(places: JointPlaces, thickness, reference) -> list[Effect]:
    """Compliances that differ from place to place."""
    effects = []
    away, where = places.away
    if away and len(away) < len(places.zones):
        effects.append(
            compliance(
                "compliance away from the bolts only", ", ".join(where), away, thickness,
                normal=True, tangential=True, reference=reference,
                describe="The plates are as one under the bolts and barely touch elsewhere.",
            )
        )  # fmt: skip
    if len(places.groups) > 1:
        words = "The interface gives way, differently under the bolts and away from them."
        effects.append(graded_compliance(places.groups, thickness, reference, words))
    around, distance = places.around
    if len({tuple(row) for row in distance.tolist()}) > 1:
        effects.append(pressed_by_bolts(around, distance, thickness, reference))
        effects.append(lost_beyond(around, distance, reference))
    for kind, singles in places.single().items():
        for region, zones in singles.items():
            effects.append(
                compliance(
                    f"compliance at one {kind}", region, zones, thickness,
                    normal=True, tangential=True, reference=reference, family="one place",
                    weight=1 / len(singles),
                    describe=f"The interface gives way at {region}, more than elsewhere.",
                )
            )  # fmt: skip
    return effects


def _bolt_effects(case: Case, thickness, zones):
    if not case.joints or isinstance(zones, ContactZones):
        return (), ()
    places = _places(case, zones)
    bolts = places.bolts if len(places.bolts) > 1 else {}
    weight = 1 / max(len(bolts), 1)
    effects = [loose_bolt(name, own, thickness, weight) for name, own in bolts.items()]
    if case.diagnose.joints == "bonded":
        reason = (
            "the nominal joint is bonded, so that nothing in it depends on the preload; "
            '[diagnose] joints = "given" takes the stiffness that the case gives'
        )
        return effects, (Silent(LOW_PRELOAD, reason),)
    effects.append(low_preload("joint", places.zones, LOW_PRELOAD))
    name = "preload of one bolt lower than nominal"
    return [*effects, *(low_preload(b, own, name, weight) for b, own in bolts.items())], ()


def _damping_effects(case: Case, data: TestData):
    if not case.joints:
        return (), ()
    if not has_ratios(data):
        reason = "the test has no damping ratios of known accuracy ([test] damping, damping_noise)"
        return (), tuple(Silent(name, reason) for name in (HYSTERETIC, VISCOUS))
    zones = tuple(case.joints)
    middle = float(np.exp(np.nanmean(np.log(data.frequencies_hz))))
    return (hysteretic_damping(zones), viscous_damping(zones, middle)), ()


def _part_effects(case: Case, data: TestData) -> list[Effect]:
    parts, alike = tuple(case.parts), {}
    for name, part in case.parts.items():
        nominal = part.nominal()
        alike.setdefault((nominal["E"], nominal["nu"], nominal["rho"]), []).append(name)
    effects = [part_error(key, [name], 1 / len(parts)) for name in parts for key in CAUSES]
    for group in alike.values():
        if len(group) > 1:
            whole = len(group) == len(parts)
            effects += [part_error(key, group, 1.0, whole) for key in CAUSES]
    # By level a mode's amplitude stands in for the condition, whose order is then lost.
    return [*effects, temperature(parts, data.conditions, drifts=not data.by_level)]


def _attached_effects(case: Case) -> list[Effect]:
    effects = [_attachment(case, name) for name in case.attached]
    effects += [mass_error(name, 1 / len(case.masses)) for name in case.masses]
    effects += [spring_error(name, 1 / len(case.springs)) for name in case.springs]
    # Those that are elastic in this model: they have a stiffness.
    known = bonded_values(case)
    supports = [name for name in case.supports if f"{name}.k_n" in known]
    effects += [support_compliance([name], 1 / len(supports)) for name in supports]
    if len(supports) > 1:
        effects.append(support_compliance(supports))
    return effects


def _attachment(case: Case, name: str) -> Effect:
    """What the nominal model leaves out."""
    section = case.attached[name]
    is_mass = isinstance(section, AttachedMass)
    key = "mass" if is_mass else "stiffness"
    value = section.nominal()[key]
    spread = case.tolerances().get(f"{name}.{key}", _ATTACHED[key])
    unit = "kg" if is_mass else "N/m"
    priors = [Prior(key, value, max(spread, 1e-3), unit, True, (1e-3 * value, 1e3 * value))]
    if is_mass and section.shift() is not None:
        low, high = section.shift()
        priors.append(Prior("travel", 0.0, (high - low) / 4, "m", False, (low, high)))
    label = name.replace("_", " ")
    words = f"The {key} of the {label} acts on the structure; the nominal model leaves it out."
    return attached(f"{label} {key}", label, name, tuple(priors), words)


def _test_effects(data: TestData):
    """Causes in the test."""
    n = len(data.mode_names)
    effects = [swapped_modes(j, data.mode_names) for j in range(n - 1)]
    if data.shapes is None:
        reason = "the test has no mode shapes ([test] shapes), and frequencies do not show it"
        return effects, tuple(Silent(name, reason) for name in (MISSCALED, MISPLACED))
    read = np.flatnonzero(np.any(np.isfinite(data.shapes), axis=1))
    if len(read) < 2:
        reason = "a single sensor has no shape"
        return effects, tuple(Silent(name, reason) for name in (MISSCALED, MISPLACED))
    points = data.sensors.points[read]
    length = float(np.max(np.linalg.norm(points[:, None] - points[None, :], axis=2)))
    effects += [misscaled_sensor(int(i), 1 / len(read)) for i in read]
    if length > 0:
        effects += [misplaced_sensor(int(i), length, 1 / len(read)) for i in read]
    return effects, ()

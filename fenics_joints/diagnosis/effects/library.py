"""The effects that a case gives rise to, and what is uncertain in any case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.dimensions import Dimensions, unfit
from fenics_joints.case.sections import AttachedMass
from fenics_joints.diagnosis.effects.damping import (
    HYSTERETIC,
    NAMES,
    SUPPORTS,
    VISCOUS,
    amplitude_effects,
    has_ratios,
    hysteretic_damping,
    spring_damping,
    support_damping,
    viscous_damping,
)
from fenics_joints.diagnosis.effects.effect import FACTOR, Effect, Prior, Silent, relative_error
from fenics_joints.diagnosis.effects.joint import (
    AXIAL,
    LOW_PRELOAD,
    PRIORS,
    STIFFER,
    STIFFER_AT,
    compliant,
    graded,
    loose_bolt,
    loose_together,
    lost_beyond,
    lost_contact,
    low_preload,
    pressed_by_bolts,
    pressed_compliance,
    smaller_contact,
    stiffer_joint,
)
from fenics_joints.diagnosis.effects.part import NU, part_effects
from fenics_joints.diagnosis.effects.rig import (
    MASS,
    MISPLACED,
    MISSCALED,
    MISSED,
    SPRING,
    attached,
    misjudged,
    misplaced_sensor,
    misscaled_sensor,
    missed_mode,
    support_compliance,
    swapped_modes,
    travel,
)
from fenics_joints.diagnosis.effects.sited import looked_for, sited_effects
from fenics_joints.diagnosis.zones.laps import lap_as_one
from fenics_joints.diagnosis.zones.sites import Sites
from fenics_joints.diagnosis.zones.zone import Zones, bonded_values
from fenics_joints.errors import InputError
from fenics_joints.formatting import spaced
from fenics_joints.measurements.data import TestData
from fenics_joints.reduction.prediction import ways_of


def check_parameters(
    effect: Effect,
    baseline: Mapping[str, float],
    condition: float,
    zones: Mapping[str, tuple[str, ...]],
) -> None:
    """Refuse an effect that speaks of parameters which it, or the model, does not have.

    Args:
        effect: The effect.
        baseline: Parameter values of the nominal model.
        condition: One of the test's.
        zones: Names of each joint's zones.

    Raises:
        InputError: With the name, and those there are.
    """
    try:
        effect.touches(baseline, (condition,))
    except KeyError as error:
        joint = {zone: name for name, own in zones.items() for zone in own}
        split = (name.rpartition(".") for name in baseline)
        known = dict.fromkeys(f"{joint.get(owner, owner)}.{key}" for owner, _, key in split)
        raise InputError(
            f"effect {effect.key}: {error.args[0]!r} is neither a parameter of its own "
            f"({', '.join(p.name for p in effect.priors)}) nor of the model: expected one of "
            f"{', '.join(known)}"
        ) from error


def for_zones(effect: Effect, zones: Mapping[str, tuple[str, ...]]) -> Effect:
    """An effect on joints as the same effect on each of their zones.

    Where ``effect.apply`` reads or writes ``JOINT.E`` it is given that of the joint's zones, one
    after another, each once. It may speak of several joints and of parts at a time; parts are
    changed once. One that names zones itself, or takes its values as a whole, stays as it is.

    Args:
        effect: The effect.
        zones: Names of each joint's zones.
    """
    split = {name: own for name, own in zones.items() if own != (name,)}
    if effect.apply is None or not split:
        return effect
    most = max(len(own) for own in split.values())

    def apply(values, theta, condition):
        for i in range(most):
            present = {name: own[i] for name, own in split.items() if i < len(own)}
            # A joint with fewer zones shows its last one, and what is done to that is dropped.
            shown = {name: present.get(name, own[-1]) for name, own in split.items()}
            local = _Local(values, shown)
            effect.apply(local, theta, condition)
            local.write_back(present, others=i == 0)
            if not local.spoken_of:
                return

    return replace(effect, apply=apply)


class _Local(dict):
    """Values with one zone of each joint under the joint's own name.

    Attributes:
        spoken_of: Whether a joint was asked for by its own name.
    """

    def __init__(self, values: dict[str, float], shown: Mapping[str, str]):
        super().__init__(values)
        self._values, self._shown = values, shown
        self.spoken_of = False

    def _zone(self, key: str) -> str:
        joint, _, name = key.rpartition(".")
        if joint not in self._shown:
            return key
        self.spoken_of = True
        return f"{self._shown[joint]}.{name}"

    def __getitem__(self, key: str) -> float:
        return super().__getitem__(self._zone(key))

    def __setitem__(self, key: str, value: float) -> None:
        super().__setitem__(self._zone(key), value)

    def __contains__(self, key: object) -> bool:
        return super().__contains__(self._zone(str(key)))

    def write_back(self, present: Mapping[str, str], others: bool) -> None:
        """Put what was changed into the values: of the zones that are present, and, if asked for,
        of everything that is no zone shown."""
        shown, own = set(self._shown.values()), set(present.values())
        for key, value in self.items():
            owner = key.rpartition(".")[0]
            if owner in own or (others and owner not in shown):
                self._values[key] = value


#: Tolerances where the case gives none: handbook values, rolled plate. Of a width and of Poisson's
#: ratio only what the case says: it is milled, and bending does not see them. [prior: handbooks]
_TOLERANCE = {"E": 0.015, "nu": 0.0, "rho": 0.01, "thickness": 0.005, "width": 0.0}
#: Relative spread of what is attached, at least; limit of a factor on Poisson's ratio, at least.
#: [numerical: chosen]
_EXACT, _MORE = 1e-3, 1.01
_NO_RATIOS = "the test has no damping ratios of known accuracy ([test] damping, damping_noise)"
_NOT_OF_LAPS = {
    "joint compliance that falls with the pressure": (
        "joint elements of beams know no pressure; a stiffness graded along the lap is looked for"
    ),
    "contact lost at low pressure": (
        "joint elements have their beams' own stiffness too, which no loss of contact takes"
    ),
}
#: Effects, and those that the test cannot speak of.
Group = tuple[Sequence[Effect], Sequence[Silent]]


def case_nuisances(
    case: Case, zones: Zones, dimensions: Dimensions | None = None
) -> tuple[Effect, ...]:
    """What is known within tolerance only, and free in every hypothesis.

    Args:
        case: The case.
        zones: Its joints in zones; laps that are as one piece go with their parts.
        dimensions: Which thicknesses and widths the model can represent; None: all.
    """
    given = case.tolerances()
    found = []
    for name in case.parts:
        for key, usual in _TOLERANCE.items():
            spread = given.get(f"{name}.{key}", usual)
            if spread > 0 and unfit(dimensions, [f"{name}.{key}"]) is None:
                words = f"{key} of {name}, within tolerance"
                least, most = FACTOR
                if key == "nu":
                    most = max(NU / case.parts[name].nominal()["nu"], _MORE)
                found.append(
                    relative_error(words, name, [f"{name}.{key}"], spread, "", span=(least, most))
                )
    known = [(*item, "mass") for item in case.masses.items()]
    for name, section, key in [*known, *((*item, "stiffness") for item in case.springs.items())]:
        if section.tolerance:
            words = f"{key} of {spaced(name)}, within tolerance"
            found.append(relative_error(words, name, [f"{name}.{key}"], section.tolerance, ""))
        if key == "mass" and section.shift() is not None:
            place = travel(section.shift())
            found.append(attached(f"place of {spaced(name)}", name, name, [place], ""))
    return tuple(_with_laps(effect, case, zones) for effect in found)


# -- causes ----------------------------------------------------------------------------------------


def case_effects(
    case: Case,
    data: TestData,
    zones: Zones,
    dimensions: Dimensions | None = None,
    sites: Sites | None = None,
    mass: float = 1.0,
) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """The effects of the library that this case can hold, and those its test cannot speak of.

    Args:
        case: The case, with a joint for each zone.
        data: The test.
        zones: Its joints in zones.
        dimensions: Which thicknesses and widths the model can represent; None: all.
        sites: Places where something may be that the nominal model has nothing of.
        mass: Of the structure, kg.

    Raises:
        InputError: If the case asks for an effect that is not there.
    """
    reference = float(data.conditions[-1]) if by_preload(data) else None
    of_joints = (
        []
        if not len(zones)
        else [
            (_stiffness(zones, reference), _of_layers_alone(zones)),
            _stiffer(case, zones, reference),
            _bolts(case, zones),
            _damping(data, zones),
        ]
    )
    of_beams = [] if zones.laps is None else [_missed_modes(data)]
    groups = [
        *of_joints,
        amplitude_effects(data, zones.all),
        _parts(case, data, zones, dimensions),
        (_attached_effects(case), ()),
        _support_damping(case, data),
        sited_effects(case, data, sites or Sites.none(), mass),
        _test_effects(data),
        *of_beams,
    ]
    return _wanted(case, groups)


def _wanted(case: Case, groups: Sequence[Group]) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """Those that the case asks for, all by default."""
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


# -- in joints -------------------------------------------------------------------------------------


def _stiffness(zones: Zones, reference: float | None) -> list[Effect]:
    """What the joints give way: all of them alike, by their pressure, and from place to place."""
    law, effects = PRIORS[zones.all[0].interface.name], []
    for kinds, (name, words) in law.alone.items():
        effects.append(compliant(name, "joint", zones.all, kinds, reference, words))
    if zones.by_pressure:
        return [*effects, pressed_compliance(zones.all), lost_contact(zones.all)]
    if zones.away and len(zones.away) < len(zones):
        away = zones.pick(zones.away)
        effects.append(
            compliant(
                "compliance away from the bolts only",
                ", ".join(dict.fromkeys(zone.joint for zone in away)),
                away,
                None,
                reference,
                "The plates are as one under the bolts and barely touch elsewhere.",
            )
        )
    for kinds in law.graded_kinds:
        for grading in zones.gradings:
            groups = {group: zones.pick(names) for group, names in grading.groups.items()}
            effects.append(graded(groups, kinds, grading.how, reference))
    effects += _by_distance(zones, reference) if zones.laps is None else _along_laps(zones)
    for kind, places in zones.places.items():
        for place, names in places.items():
            name, words = (text.format(kind=kind, place=place) for text in law.at_one)
            effects.append(
                compliant(
                    name,
                    place,
                    zones.pick(names),
                    None,
                    reference,
                    words,
                    family="one place",
                    weight=1 / len(places),
                )
            )
    return effects


def _by_distance(zones: Zones, reference: float | None) -> list[Effect]:
    """Layers pressed by their bolts, where some are further from them than others."""
    around = [zone for zone in zones if zone.bolt]
    if len({zone.distance for zone in around}) < 2:
        return []
    return [
        pressed_by_bolts(around, reference),
        pressed_by_bolts(around, reference, ("t",)),
        lost_beyond(around, reference),
        smaller_contact(around),
    ]


def _stiffer(case: Case, zones: Zones, reference: float | None) -> Group:
    """Layers stiffer than given: all of them, and those away from the bolts, or near them, alone.

    Laps with a stiffness of their own may be off either way as they are.
    """
    if zones.laps is not None:
        return (), ()
    if case.diagnose.joints == "bonded" or zones.by_pressure:
        reason = (
            "the nominal joint is bonded, and nothing is stiffer; "
            '[diagnose] joints = "given" takes the stiffness that the case gives'
        )
        return (), (Silent(STIFFER, reason),)
    near = tuple(name for name in zones.names if name not in zones.away)
    places = {"away from the bolts": zones.away, "near the bolts": near}
    places = {place: names for place, names in places.items() if 0 < len(names) < len(zones)}
    return [
        stiffer_joint(STIFFER, "joint", zones.all, reference),
        *(
            stiffer_joint(STIFFER_AT, place, zones.pick(names), reference, 1 / len(places))
            for place, names in places.items()
        ),
    ], ()


def _along_laps(zones: Zones) -> list[Effect]:
    """The axial stiffness of laps, which the model takes from the beams or the case."""
    along = {lap.name: lap.along for lap in zones.laps}
    where = ", ".join(along) if len(along) < 3 else "all laps"
    places = {where: list(along.values())}
    if len(along) > 1:
        places |= {name: [own] for name, own in along.items()}
    words = "Along the beams the lap is softer or stiffer than the two beams side by side."
    return [
        relative_error(
            "joint axial stiffness",
            place,
            [f"{lap}.axial" for lap in laps],
            AXIAL,
            words,
            span=(0.0, np.inf),
            weight=1.0 if place == where else 1 / len(along),
        )
        for place, laps in places.items()
    ]


def _of_layers_alone(zones: Zones) -> tuple[Silent, ...]:
    """What layers may have, and joint elements of beams not."""
    reasons = {} if zones.laps is None else _NOT_OF_LAPS
    return tuple(Silent(name, reason) for name, reason in reasons.items())


def _bolts(case: Case, zones: Zones) -> Group:
    if zones.by_pressure:
        return (), ()  # a contact's layer stands for a preload that was solved for
    by_bolt = {name: zones.pick(own) for name, own in zones.by("bolt").items()}
    single = by_bolt if len(by_bolt) > 1 else {}
    weight = 1 / max(len(single), 1)
    effects = [loose_bolt(name, own, weight) for name, own in single.items()]
    effects += loose_together(single)
    if case.diagnose.joints == "bonded":
        nominal = "joint is bonded" if zones.laps is None else "lap is as one piece"
        reason = (
            f"the nominal {nominal}, so that nothing in it depends on the preload; "
            '[diagnose] joints = "given" takes the stiffness that the case gives'
        )
        return effects, (Silent(LOW_PRELOAD, reason),)
    pressed = zones.all if zones.laps is None else sum(by_bolt.values(), ())
    if not pressed:
        reason = "no lap has a bolt ([joints.NAME] bolted, or bolts)"
        return effects, (Silent(LOW_PRELOAD, reason),)
    effects.append(low_preload("joint", pressed, LOW_PRELOAD))
    name = "preload of one bolt lower than nominal"
    return [*effects, *(low_preload(b, own, name, weight) for b, own in single.items())], ()


def _damping(data: TestData, zones: Zones) -> Group:
    if not has_ratios(data):
        return (), tuple(Silent(name, _NO_RATIOS) for name in (HYSTERETIC, VISCOUS))
    middle = float(np.exp(np.nanmean(np.log(data.frequencies_hz))))
    return (hysteretic_damping(zones.all), viscous_damping(zones.all, middle)), ()


# -- in parts, around them, and in the test --------------------------------------------------------


def _parts(case: Case, data: TestData, zones: Zones, dimensions) -> Group:
    effects, silent = part_effects(case, data, dimensions)
    return [_with_laps(effect, case, zones) for effect in effects], silent


def _with_laps(effect: Effect, case: Case, zones: Zones) -> Effect:
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


def _attached_effects(case: Case) -> list[Effect]:
    put_on = () if case.test is None else case.test.changed  # on purpose
    effects = [_attachment(case, name) for name in case.attached if name not in put_on]
    effects += [misjudged(name, "mass", 1 / len(case.masses)) for name in case.masses]
    effects += [misjudged(name, "stiffness", 1 / len(case.springs)) for name in case.springs]
    # Those that are elastic in this model: they have a stiffness.
    known = bonded_values(case)
    supports = [name for name in case.supports if f"{name}.k_n" in known]
    effects += [support_compliance([name], 1 / len(supports)) for name in supports]
    if len(supports) > 1:
        effects.append(support_compliance(supports))
    return effects


def _support_damping(case: Case, data: TestData) -> Group:
    """What supports and springs to the ground dissipate, where they are and damping says it."""
    known = bonded_values(case)
    supports = [name for name in case.supports if f"{name}.k_n" in known]
    springs = list(case.springs)
    if not (supports or springs) or not looked_for(case, SUPPORTS):
        return (), ()
    if not has_ratios(data):
        return (), (Silent(SUPPORTS, _NO_RATIOS),)
    places = [[name] for name in supports] + [supports] * (len(supports) > 1)
    weight = 1 / (len(places) + len(springs))
    found = [support_damping(own, support_compliance(own, weight)) for own in places]
    return [*found, *(spring_damping([name], spaced(name), weight) for name in springs)], ()


def _attachment(case: Case, name: str) -> Effect:
    """What the nominal model leaves out."""
    section = case.attached[name]
    is_mass = isinstance(section, AttachedMass)
    key = "mass" if is_mass else "stiffness"
    value = section.nominal()[key]
    spread = case.tolerances().get(f"{name}.{key}", MASS if is_mass else SPRING)
    unit = "kg" if is_mass else "N/m"
    priors = [Prior(key, value, max(spread, _EXACT), unit)]
    if is_mass and section.shift() is not None:
        priors.append(travel(section.shift()))
    label = spaced(name)
    words = f"The {key} of the {label} acts on the structure; the nominal model leaves it out."
    return attached(f"{label} {key}", label, name, priors, words)


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
        ways = len(ways_of(data.sensors, data.sensors.points.shape[1]))
        effects += [misplaced_sensor(int(i), length, 1 / len(read), ways) for i in read]
    return effects, ()


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

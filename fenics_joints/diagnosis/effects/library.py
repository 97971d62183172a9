"""The library of effects, and the tolerances that are uncertain in any case.

`LIBRARY` lists where effects come from. Each entry is a function of a `Setting` (the case, its test
and its zones) that yields the effects which are possible there, and a `Silent` for each that the
test can say nothing about. An entry more is an effect more, in all that a diagnosis does with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from fenics_joints.case import Case
from fenics_joints.case.dimensions import Dimensions, unfit
from fenics_joints.case.own_code import find, is_reference
from fenics_joints.diagnosis.effects import damping, joint, part, rig, sited
from fenics_joints.diagnosis.effects.effect import (
    FACTOR,
    Effect,
    Found,
    Setting,
    Silent,
    relative_error,
)
from fenics_joints.diagnosis.zones.zone import Zones
from fenics_joints.errors import InputError
from fenics_joints.formatting import spaced

#: Where effects come from, in the order in which they are listed where nothing else tells.
LIBRARY: list[Callable[[Setting], Found]] = [
    joint.compliances,
    joint.own_law_errors,
    joint.parameter_errors,
    joint.stiffer_than_given,
    joint.bolts,
    damping.joint_damping,
    damping.amplitude_effects,
    part.part_effects,
    rig.attachments,
    rig.damping_around,
    sited.sited_effects,
    rig.errors_of_test,
    rig.missed_modes,
]


def case_effects(setting: Setting) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """The effects of the library that a case can have and asks for, by default all; and those that
    its test cannot speak of.

    Raises:
        InputError: If the case asks for an effect that does not exist.
    """
    case = setting.case
    asked = [name for name in case.diagnose.effects or () if name != "all"]
    own = [_own(name, setting.zones) for name in asked if is_reference(name)]
    found = [one for effects in LIBRARY for one in effects(setting)]
    effects = [one for one in found if isinstance(one, Effect)]
    silent = [one for one in found if isinstance(one, Silent)]
    names = {e.name for e in effects} | {s.effect for s in silent} | set(damping.NAMES)
    for name in asked:
        if name not in names and not is_reference(name):
            raise InputError(
                f"{case.path}: diagnose.effects: {name!r} does not exist; expected some of: "
                f"{', '.join(sorted(names))}."
            )
    return (
        (*(e for e in effects if sited.looked_for(case, e.name)), *own),
        tuple(s for s in silent if sited.looked_for(case, s.effect)),
    )


def _own(reference: str, zones: Zones) -> Effect:
    """An effect that the case names as ``module:name``.

    Raises:
        InputError: If it is something else.
    """
    return for_zones(find(reference, Effect, "a diagnosis.Effect"), zones.by("joint"))


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
            # A joint with fewer zones shows its last one, whose changes are dropped.
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
        """Copy changed values back: of the zones that are present and, if ``others``, of all that
        is no zone."""
        shown, own = set(self._shown.values()), set(present.values())
        for key, value in self.items():
            owner = key.rpartition(".")[0]
            if owner in own or (others and owner not in shown):
                self._values[key] = value


#: Tolerances where the case gives none: handbook values, rolled plate. Of a width and of Poisson's
#: ratio only what the case says: it is milled, and bending does not see them. [prior: handbooks]
_TOLERANCE = {"E": 0.015, "nu": 0.0, "rho": 0.01, "thickness": 0.005, "width": 0.0}
#: Limit of a factor on Poisson's ratio, at least. [numerical: chosen]
_MORE = 1.01


def case_nuisances(
    case: Case, zones: Zones, dimensions: Dimensions | None = None
) -> tuple[Effect, ...]:
    """Tolerances: properties that are free in every hypothesis, within their tolerance.

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
                    most = max(part.NU / case.parts[name].nominal()["nu"], _MORE)
                found.append(
                    relative_error(words, name, [f"{name}.{key}"], spread, "", span=(least, most))
                )
    known = [(*item, "mass") for item in case.masses.items()]
    for name, section, key in [*known, *((*item, "stiffness") for item in case.springs.items())]:
        if section.tolerance:
            words = f"{key} of {spaced(name)}, within tolerance"
            found.append(relative_error(words, name, [f"{name}.{key}"], section.tolerance, ""))
        if key == "mass" and section.shift() is not None:
            place = rig.travel(section.shift())
            found.append(rig.attached(f"place of {spaced(name)}", name, name, [place], ""))
    return tuple(part.with_laps(effect, case, zones) for effect in found)

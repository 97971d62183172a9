"""The parameters of a case's structure, with their units and bounds."""

from __future__ import annotations

import math

from fenics_joints.case.case import Case
from fenics_joints.case.sections import JointSection, MassSection, PartSection
from fenics_joints.structure import Damped, Damping
from fenics_joints.structure.components import Parameter
from fenics_joints.units import parameter_unit

#: Bounds of E and G of a joint, Pa: far wider than any metal joint, from a rattling contact to a
#: weld of the thinnest layer.
_JOINT_MODULUS = (1e2, 1e14)
#: Bounds of properties whose section gives none. Stiffness per area, Pa/m: from faces that hardly
#: touch to a micrometre of metal.
_BOUNDS = {
    "nu": (0.0, 0.49),
    **dict.fromkeys(("thickness", "width"), (0.5, 2.0)),
    **dict.fromkeys(("k_n", "k_t"), (1e6, 1e19)),
    "c": (0.0, 1e3),
}
#: How far others may be from their nominal value, as a factor: the thickness of a transition layer
#: and the stiffness of a lap of beams; and any other known property.
_FACTORS = {"h": 30.0, **dict.fromkeys(("k1", "k2", "k_axial"), 1e3)}
#: Likewise of any other known property. Chosen: wide enough for a wrong material, and no more.
_KNOWN = 3.0
#: Likewise of a property of a law of somebody's own, where it is above zero and has no bounds.
_OWN, _ANY = 1e3, (-math.inf, math.inf)
#: Stiffness of a support, Pa/m, that is as good as rigid: E / (k L) of a metal body of size L is
#: below 1e-6. A steel cantilever's frequencies are 2e-6 below those of a rigidly held one.
RIGID_SUPPORT = 1e19
#: Bounds of that stiffness, Pa/m: from faces that hardly touch to a hundred times as good as rigid.
_SUPPORT = (1e6, 1e21)
#: How far a damping value may be from its nominal one, as a factor; a ratio is at most 1.
_DAMPING = 1e3
#: How much heavier or stiffer than the case says something attached may be.
_ATTACHED = {"mass": 10.0, "stiffness": 1e3}


def parameters(
    case: Case,
    *,
    attached: bool = False,
    width: bool = False,
    elastic_supports: bool = False,
    damping: bool = False,
) -> list[Parameter]:
    """The parameters of a case's structure, with units and bounds, in order."""
    bounds = _bounds(case)
    values = case.nominal(attached, width)
    if elastic_supports:
        for name, section in case.supports.items():
            if section.holds_all:
                for key in ("k_n", "k_t"):
                    # Of a structure from a script it may have a stiffness.
                    values[f"{name}.{key}"] = getattr(section, key, None) or RIGID_SUPPORT
                    bounds[f"{name}.{key}"] = _SUPPORT
    if damping and case.damping is not None:
        for name, value in case.damping.nominal().items():
            values[name] = value
            high = value * _DAMPING
            bounds[name] = value / _DAMPING, high if _unit(name) else min(high, max(1.0, value))
    return [
        Parameter(
            name,
            value,
            case.unit_of(name).replace("*", " "),
            *bounds[name],
            log=_is_log(name, value) and bounds[name][0] >= 0,
        )
        for name, value in values.items()
    ]


def _unit(name: str) -> str:
    return parameter_unit(name).replace("*", " ")


def _is_log(name: str, value: float) -> bool:
    return value > 0 and not name.endswith(".nu")


def _bounds(case: Case) -> dict[str, tuple[float, float]]:
    bounds = {}
    for name, section in {**case.parts, **case.joints}.items():
        given = section.bounds.model_dump(exclude_none=True)
        values = (
            section.nominal(width=True) if isinstance(section, PartSection) else section.nominal()
        )
        for key, value in values.items():
            bounds[f"{name}.{key}"] = given.get(key) or _usual(section, key, value)
    for name, section in {**case.masses, **case.springs}.items():
        for key, value in section.nominal().items():
            if key != "travel":
                bounds[f"{name}.{key}"] = value / _ATTACHED[key], value * _ATTACHED[key]
    for name, section in case.attached.items():
        for key, value in section.nominal().items():
            bounds[f"{name}.{key}"] = 0.0, value * _ATTACHED[key]
    for name, section in {**case.masses, **case.attached}.items():
        if isinstance(section, MassSection) and section.travel is not None:
            bounds[f"{name}.travel"] = section.shift()
    return bounds


def _usual(section: PartSection | JointSection, key: str, value: float) -> tuple[float, float]:
    """Bounds for a property whose section gives none."""
    law = section.own_law if isinstance(section, JointSection) else None
    if law is not None:
        return law.bounds.get(key) or ((value / _OWN, value * _OWN) if value > 0 else _ANY)
    if isinstance(section, JointSection) and key in ("E", "G"):
        low, high = _JOINT_MODULUS
    else:
        factor = _FACTORS.get(key, _KNOWN)
        low, high = _BOUNDS.get(key, (value / factor, value * factor))
    return min(low, value), max(high, value)


def model_damping(case: Case, structure: Damped) -> Damping:
    """The damping of a case's model, its values as parameters: ``[damping]``, and the c of laps.

    Args:
        case: The case; without damping there is none.
        structure: Its structure, built with ``damping``.
    """
    return structure.resolved(Damping() if case.damping is None else case.damping.damping())

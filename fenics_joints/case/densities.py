"""``rho = "average"`` of a transition layer: the mean density of the bodies that it joins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fenics_joints.units import to_si

__all__ = ["with_average_densities"]


def with_average_densities(raw: Any) -> Any:
    """The raw case with every joint's ``rho = "average"`` as a number, kg/m3.

    Seed 000, section 2, end: the layer's density is zero or the average of the two bodies'. What
    else is wrong with the case is left for its other checks.

    Raises:
        ValueError: If it is no transition layer's, or parts of unlike densities are more than two.
    """
    joints = raw.get("joints") if isinstance(raw, Mapping) else None
    if not isinstance(joints, Mapping):
        return raw
    wanted = {
        name: dict(joint)
        for name, joint in joints.items()
        if isinstance(joint, Mapping) and joint.get("rho") == "average"
    }
    if not wanted:
        return raw
    for name, joint in wanted.items():
        if joint.get("law") != "transition":
            raise ValueError(
                f'joints.{name}.rho = "average": expected a density, or law = "transition"'
            )
        joint["rho"] = _average(f"joints.{name}.rho", raw.get("parts"))
    return {**raw, "joints": {**joints, **wanted}}


def _average(key: str, parts: Any) -> float:
    parts = parts.values() if isinstance(parts, Mapping) else ()
    given = [p.get("rho") for p in parts if isinstance(p, Mapping)]
    try:
        densities = [float(to_si(rho, "kg/m3")) for rho in given]
    except (ValueError, TypeError):
        raise ValueError(f'{key} = "average": expected a density in every part') from None
    if len(set(densities)) == 1:
        return densities[0]
    if len(densities) != 2:
        raise ValueError(
            f'{key} = "average": expected two parts, or parts of one density, so that it is clear '
            "whose; give the density as a number"
        )
    return 0.5 * sum(densities)

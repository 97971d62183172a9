"""What a change of the expected size in each zone of a model would do to everything measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.effects import Effect, relative_error
from fenics_joints.diagnosis.effects_joint import compliance
from fenics_joints.diagnosis.evidence import Evidence
from fenics_joints.diagnosis.hypothesis import Hypothesis
from fenics_joints.diagnosis.prediction import predict
from fenics_joints.surrogate import Forward

__all__ = ["EXPECTED", "EXPONENT", "trend", "zone_sensitivities"]

#: Expected relative change of a zone's parameter: a wrong material, a mass left out, a clamp that
#: gives way.
EXPECTED = {"E": 0.15, "rho": 0.10, "mass": 0.3, "stiffness": 1.0, "k_n": 1.0, "k_t": 1.0}
#: Expected exponent of an interface's stiffness in the torque (seed 001, eqs. 22 and 23).
EXPONENT = 0.5


def zone_sensitivities(
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    regions: Sequence[str] | Mapping[str, Sequence[str]],
    *,
    thickness: Mapping[str, float],
    by_torque: bool = False,
) -> dict[str, np.ndarray]:
    """Change of the data by a change of the expected size of each parameter of each zone.

    A part has a column for its stiffness (E) and one for its mass (density), a mass, a spring or an
    elastic support one for each of its values: all derivatives, by one hypothesis that holds them.

    A joint has a column for its normal and one for its tangential compliance. The nominal joint is
    bonded, so that its derivative by ln E is next to nothing; that by the compliance 1/k is
    parallel to it, dE = -E^2/h d(1/k), and has the size of what an interface does. The change is
    finite, from bonded to an interface of the prior's median stiffness: a test rests on the
    columns' span alone and keeps its level with any that is fixed before the data, but has the
    power for the zone's true signature that its angle to the span gives; and the infinitesimal
    signature turns as compliance grows, towards the soft interface whose effect is large enough to
    matter. With ``by_torque`` each has a second column, that change growing with the logarithm of
    the torque, so that a joint which stiffens is not asked to explain the mean alone.

    Args:
        forward: Predicts frequencies and shapes.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        regions: Names of the model's regions, masses and springs; or, by a zone's name, those that
            are one zone.
        thickness: Layer thickness, m, of each joint; what is not in it is no joint.
        by_torque: Whether the conditions are torques, by which joints may stiffen.

    Returns:
        Arrays (N, k) by zone; a zone without parameters is left out.
    """
    if not isinstance(regions, Mapping):
        regions = {name: (name,) for name in regions}
    columns: dict[str, list[np.ndarray]] = {}
    relative = _relative(regions, baseline, thickness)
    nominal, slopes = _predict(tuple(e for _, e in relative), forward, evidence, baseline)
    for (zone, _), column in zip(relative, slopes.T, strict=False):
        columns.setdefault(zone, []).append(column)
    for zone, members in regions.items():
        joints = [name for name in members if name in thickness]
        for effect in _interfaces(zone, joints, thickness):
            given_way, _ = _predict((effect,), forward, evidence, baseline)
            change = given_way - nominal
            columns.setdefault(zone, []).append(change)
            if by_torque and len(evidence.conditions) > 1:
                columns[zone].append(EXPONENT * trend(evidence) * change)
    return {zone: np.array(columns[zone]).T for zone in regions if zone in columns}


def trend(evidence: Evidence) -> np.ndarray:
    """Centred logarithm of each datum's condition, (N,)."""
    x = np.log(evidence.conditions)
    return (x - x.mean())[evidence.entries.row]


def _predict(effects: Sequence[Effect], forward, evidence: Evidence, baseline):
    """Prediction and derivatives, the effects' at their medians."""
    modes = tuple(f"mode {j + 1}" for j in range(evidence.log_f.shape[1]))
    damped = evidence.log_damping is not None
    hypothesis = Hypothesis(tuple(effects), modes=modes, damped=damped)
    return predict(hypothesis, forward, evidence, np.zeros(len(hypothesis.priors)), baseline)


def _relative(regions, baseline, thickness) -> list[tuple[str, Effect]]:
    """(zone, effect) for each parameter of a zone that changes by a factor."""
    found = []
    for zone, members in regions.items():
        for key, spread in EXPECTED.items():
            names = [
                f"{member}.{key}" for member in members
                if member not in thickness and baseline.get(f"{member}.{key}", 0.0) > 0
            ]  # fmt: skip
            if names:
                found.append((zone, relative_error(f"{key} of {zone}", zone, names, spread, "")))
    return found


def _interfaces(zone: str, joints: Sequence[str], thickness) -> list[Effect]:
    """The joints of a zone giving way across their plane, and along it."""
    if not joints:
        return []
    return [
        compliance(
            f"{way} of {zone}", zone, joints, thickness,
            normal=way == "normal", tangential=way == "tangential", reference=None, describe="",
        )
        for way in ("normal", "tangential")
    ]  # fmt: skip

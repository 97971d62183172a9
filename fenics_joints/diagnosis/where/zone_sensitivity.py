"""Changes of all data by a change of the expected size in each zone of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior, in_series, relative_error
from fenics_joints.diagnosis.effects.joint import AXIAL, EXPONENT, OWN_SPREAD
from fenics_joints.diagnosis.effects.part import CAUSES
from fenics_joints.diagnosis.effects.rig import MASS, SPRING, support_compliance
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.reduction.prediction import ModalPrediction

#: Expected relative change of a zone's parameter: a wrong material, a mass misjudged, a spring too,
#: a lap along its beams.
EXPECTED = {
    "E": CAUSES["E"],
    "rho": CAUSES["rho"],
    "mass": MASS,
    "stiffness": SPRING,
    "axial": AXIAL,
}
#: Gauss points along the way from bonded to giving way. [numerical: chosen; what it misses is
#: shared out]
_NODES = 8


def zone_sensitivities(
    forward: ModalPrediction,
    evidence: Evidence,
    baseline: dict[str, float],
    regions: Sequence[str] | Mapping[str, Sequence[str]],
    *,
    interfaces: Mapping[str, Mapping[str, float]],
    by_torque: bool = False,
    added: Mapping[str, float] | None = None,
    own: Mapping[str, Sequence[str]] | None = None,
) -> dict[str, np.ndarray]:
    """Change of the data by a change of the expected size of each parameter of each zone.

    A part has a column for its stiffness (E) and one for its mass (density), a mass or a spring
    one: all derivatives, by one hypothesis that holds them. A support has one for giving way, from
    as good as rigid to its prior's median stiffness.

    A joint has a column for its normal and one for its tangential compliance. The nominal joint is
    bonded, so that its derivative by ln E is next to nothing; that by the compliance 1/k is
    parallel to it, dE = -E^2/h d(1/k), but as infinitesimal as it. A test rests on the columns'
    span alone and keeps its level with any that is fixed before the data; its power is for
    signatures near the span, and that of a joint turns as it gives way. A zone alone that gives way
    finitely shows little, though: its bonded neighbours carry its load, as they would not in a
    joint that gives way. So the change is that of all joints together, from bonded to interfaces of
    the prior's median stiffness, split exactly among the zones by integrating the derivatives by
    their compliances along the way. With ``by_torque`` each has a second column, that part growing
    with the logarithm of the torque, so that a joint which stiffens is not asked to explain the
    mean alone.

    Args:
        forward: Predicts frequencies and shapes.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        regions: Names of the model's regions, masses and springs; or, by a zone's name, those that
            are one zone.
        interfaces: For each joint the stiffness of an interface of the expected stiffness, by the
            parameter that it is in series with (`effects.joint.interfaces`); others are no joints.
        by_torque: Whether the conditions are torques, by which joints may stiffen.
        added: Expected mass, kg, of components that have none in the nominal model, as of a cable.
        own: Names of the parameters of joints with a law of the user's own, by joint; each has a
            column.

    Returns:
        Arrays (N, k) by zone; a zone without parameters is left out.
    """
    if not isinstance(regions, Mapping):
        regions = {name: (name,) for name in regions}
    columns: dict[str, list[np.ndarray]] = {}
    own = own or {}
    relative = _relative(regions, baseline, interfaces, own)
    nominal, slopes = _predict(tuple(e for _, e in relative), forward, evidence, baseline)
    for (zone, _), column in zip(relative, slopes.T, strict=False):
        columns.setdefault(zone, []).append(column)
    for zone, members in regions.items():
        held = [name for name in members if name not in own]
        for effect in (*_supports(held, baseline), *_added(zone, members, added or {})):
            changed, _ = _predict((effect,), forward, evidence, baseline)
            columns.setdefault(zone, []).append(changed - nominal)
    for zone, change in _parts_of_joints(regions, interfaces, forward, evidence, baseline, nominal):
        columns.setdefault(zone, []).append(change)
        if by_torque and len(evidence.conditions) > 1:
            columns[zone].append(EXPONENT[0] * trend(evidence) * change)
    return {zone: np.array(columns[zone]).T for zone in regions if zone in columns}


def with_compliant_joints(
    baseline: Mapping[str, float], interfaces: Mapping[str, Mapping[str, float]]
) -> dict[str, float]:
    """Parameter values with every joint giving way as its interface says."""
    values = dict(baseline)
    for joint, stiffness in interfaces.items():
        for key, k in stiffness.items():
            in_series(values, f"{joint}.{key}", k)
    return values


def trend(evidence: Evidence) -> np.ndarray:
    """Centred logarithm of each datum's condition, (N,)."""
    x = np.log(evidence.conditions)
    return (x - x.mean())[evidence.entries.row]


def _predict(effects: Sequence[Effect], forward, evidence: Evidence, baseline, z: float = 0.0):
    """Prediction and derivatives, every parameter of the effects ``z`` from its median."""
    modes = tuple(f"mode {j + 1}" for j in range(evidence.log_f.shape[1]))
    damped = evidence.log_damping is not None
    hypothesis = Hypothesis(tuple(effects), modes=modes, damped=damped, driven=evidence.driven)
    return ManyPredictions(hypothesis, forward, evidence, baseline).at(hypothesis.at(z))


def _relative(regions, baseline, interfaces, own) -> list[tuple[str, Effect]]:
    """(zone, effect) for each parameter of a zone that changes by a factor."""
    found = []
    for zone, members in regions.items():
        for key, spread in EXPECTED.items():
            names = [
                f"{member}.{key}"
                for member in members
                if member not in interfaces and baseline.get(f"{member}.{key}", 0.0) > 0
            ]
            if names:
                found.append((zone, relative_error(f"{key} of {zone}", zone, names, spread, "")))
        names = [name for member in members for name in own.get(member, ()) if baseline[name] > 0]
        found += [(zone, relative_error(name, zone, [name], OWN_SPREAD, "")) for name in names]
    return found


def _parts_of_joints(regions, interfaces, forward, evidence, baseline, nominal):
    """Each zone with its part of the change by compliance of all joints, across and along their
    planes."""
    zones = {
        zone: joints
        for zone, members in regions.items()
        if (joints := [name for name in members if name in interfaces])
    }
    if not zones:
        return
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    for key in next(iter(interfaces.values())):
        effects = [
            compliant_joints(zone, joints, interfaces, key) for zone, joints in zones.items()
        ]
        parts = np.zeros((len(nominal), len(effects)))
        for node, weight in zip(0.5 + 0.5 * nodes, 0.5 * weights, strict=True):
            _, slopes = _predict(effects, forward, evidence, baseline, node)
            parts += weight * slopes[:, : len(effects)]
        end, _ = _predict(effects, forward, evidence, baseline, 1.0)
        # The error of the quadrature goes to the zones in proportion to their parts.
        share = np.abs(parts) / np.maximum(np.abs(parts).sum(axis=1, keepdims=True), 1e-300)
        parts += share * (end - nominal - parts.sum(axis=1))[:, None]
        yield from zip(zones, parts.T, strict=True)


def compliant_joints(
    zone: str, joints: Sequence[str], interfaces: Mapping[str, Mapping[str, float]], key: str
) -> Effect:
    """Joints with a share of the expected interface's compliance in series, by its cube root.

    Most happens early: a little compliance is much beside that of a bonded layer.

    Args:
        zone: What they are together.
        joints: Their names.
        interfaces: See `zone_sensitivities`.
        key: The parameter that gives way.
    """

    def apply(values, theta, condition):
        for joint in joints:
            name = f"{joint}.{key}"
            values[name] = 1 / (1 / values[name] + theta["root"] ** 3 / interfaces[joint][key])

    prior = Prior("root", 0.0, 1.0, "", False, (0.0, 1.0))
    return Effect(f"{key} of {zone} giving way", zone, (prior,), apply)


def _supports(members: Sequence[str], baseline) -> list[Effect]:
    """The elastic supports of a zone giving way, both ways at once."""
    held = [name for name in members if f"{name}.k_n" in baseline]
    return [support_compliance(held)] if held else []


def _added(zone: str, members: Sequence[str], added: Mapping[str, float]) -> list[Effect]:
    """The expected mass of those of a zone that have none."""
    expected = {f"{name}.mass": added[name] for name in members if name in added}

    def apply(values, theta, condition):
        for name, mass in expected.items():
            values[name] += theta["share"] * mass

    prior = Prior("share", 1.0, 1.0, "", False, (0.0, np.inf))
    return [Effect(f"mass of {zone}", zone, (prior,), apply)] if expected else []

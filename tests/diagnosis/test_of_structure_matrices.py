"""Diagnoses of parts by matrices: what is named on a mesh of the same parts is named here."""

from __future__ import annotations

import numpy as np
import pytest
from matrix_parts import lap_structure
from unlike_meshes import lap, springs

from fenics_joints.diagnosis import diagnose
from fenics_joints.measurements import TestData
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Sensors

COUNTS = ((10, 2, 1), (10, 2, 1))
X = np.linspace(0.0, 0.11, 6)
SEEN = Sensors(
    [
        *([x, y, 0.01] for x in X for y in (0.0, 0.04)),
        *([x + 0.21, y, 0.02] for x in X for y in (0, 0.04)),
    ],
    [0, 0, 1],
)


def measured(k_n: float, k_t: float) -> TestData:
    """Modes that move the sensors, of a mesh whose joint has this stiffness."""
    modes = solve_modes(springs(lap(*COUNTS), 1, k_n, k_t), n_modes=16)
    shapes = modes.at(SEEN)[:, 6:]
    seen = np.flatnonzero(np.abs(shapes).max(axis=0) > 0.5 * np.abs(shapes).max())[:6]
    rng, shapes = np.random.default_rng(3), shapes[:, seen]
    hz = modes.frequencies_hz[6:][seen] * np.exp(1e-3 * rng.standard_normal(len(seen)))
    shapes = shapes / np.abs(shapes).max(axis=0) + 0.01 * rng.standard_normal(shapes.shape)
    names = tuple(f"mode {i + 1}" for i in range(len(seen)))
    more = {"shapes": shapes, "sensors": SEEN, "noise": 1e-3, "shape_noise": 0.01}
    return TestData([1.0], hz[None], names, **more)


@pytest.mark.survives
@pytest.mark.parallel
@pytest.mark.parametrize("k", [pytest.param(None, marks=pytest.mark.slow), (1e11, 2e10)])
def test_the_joint_is_named_as_on_a_mesh(k):
    test = measured(*(k or (1e15, 1e15)))
    answers = [
        diagnose(model, test, discrepancy=2e-3, mesh_error=False)
        for model in (lap_structure(*COUNTS), springs(lap(*COUNTS), 1))
    ]
    for found in answers:
        if k is None:
            assert found.verdict == "no gap"
            continue
        assert found.verdict == "cause"
        best = found.hypotheses[0]
        assert best.label.startswith("joint") and "compliance" in best.label
        values = {row["name"]: row["value"] for row in best.parameters}
        assert values["k_t"] == pytest.approx(k[1], rel=0.15)
    names = [next(e for e in found.effects).name for found in answers]
    assert names[0] == names[1]
    unseen = {silent.effect for silent in answers[0].silent}
    assert {"thickness error", "added mass"} <= unseen

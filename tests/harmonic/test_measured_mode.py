"""Joint laws from frequency and damping over amplitude, and what such data cannot tell."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from slip_chain import PLACES, TRUTH, chain

from fenics_joints.errors import InputError
from fenics_joints.harmonic import identify, solve_backbone, solve_harmonic
from fenics_joints.harmonic.identify import CurveFit
from fenics_joints.harmonic.measured_mode import ModeData, as_motion
from fenics_joints.measurements import MeasuredBackbone
from fenics_joints.measurements.amplitude import from_constant_force
from fenics_joints.measurements.amplitude.sweeps import SineSweep

START = {"lap.S_y": 0.6, "lap.n": 1.6}
DEVIATION = {"frequency": 2e-4, "damping": 0.02}


#: The identified model: softer at rest than the truth by 0.3 %, and damped by half.
MODEL = chain(K=0.997, C=0.005)


@pytest.fixture(scope="module")
def measured() -> MeasuredBackbone:
    """The truth at phase resonance, with more sliders, harmonics and samples, and with noise."""
    made = solve_backbone(
        chain(33), (0.02, 1.2), force="push", near=0.076, sensor="end", harmonics=5, samples=256
    )
    at = np.linspace(0, len(made) - 1, 9).astype(int)
    f, zeta = made.frequencies_hz[at], made.damping_ratios[at]
    rng = np.random.default_rng(4)
    sd = DEVIATION["frequency"] * f, DEVIATION["damping"] * zeta
    return MeasuredBackbone(
        "acceleration",
        made.amplitude("end", "acceleration")[at],
        f + sd[0] * rng.normal(size=9),
        sd[0],
        zeta + sd[1] * rng.normal(size=9),
        sd[1],
    )


def check(found, most: float = 2.5) -> None:
    """All parameters within so many of their deviations, which say something."""
    for name in START:
        assert abs(np.log(found.values[name] / TRUTH[name])) < most * found.sd[name]
        assert found.sd[name] < 0.15


def test_a_law_is_found_from_a_backbone_whatever_the_model_is_off_at_rest(measured):
    found = identify(MODEL.with_parameters, None, None, START, backbone=measured, **PLACES)
    check(found)
    assert not found.undetermined and max(found.mode.widths) < 2
    rest = found.offsets["frequency at rest"]
    assert abs(rest.value - 0.5 * 3e-3) < 3 * rest.sd + 1e-4
    damping = found.offsets["damping at rest"]
    viscous = 0.005 / (2 * 2 * np.pi * measured.frequencies_hz[0])
    assert damping.value == pytest.approx(viscous, rel=0.15)
    json.dumps(found.to_dict(), allow_nan=False)


def test_points_are_those_of_the_branch_and_derivatives_those_of_differences(measured):
    model, at = chain(), [0.05, 0.8, 0.3]
    branch = solve_backbone(model, (0.02, 1.2), near=0.076, sensor="end", harmonics=3)
    points = solve_backbone(model, at=at, near=0.076, sensor="end", harmonics=3)
    reached = branch.amplitude("end")
    order = np.argsort(reached)
    for key in ("frequencies_hz", "damping_ratios"):
        on_branch = np.interp(np.log(at), np.log(reached[order]), getattr(branch, key)[order])
        assert getattr(points, key) == pytest.approx(on_branch, rel=1e-2)
    warm = solve_backbone(model, at=at, near=0.076, sensor="end", harmonics=3, initial=points)
    assert warm.frequencies_hz == pytest.approx(points.frequencies_hz, rel=1e-8)
    data = ModeData.of(measured, "end", 0.01)
    fit = CurveFit(model.with_parameters, START, [data], "push", {"harmonics": 3})
    x = np.log([0.33, 2.2])
    J = fit.jacobian(x)
    for i, h in enumerate(1e-4 * np.eye(2)):
        slope = (fit.residual(x + h) - fit.residual(x - h)) / 2e-4
        assert np.linalg.norm(slope - J[:, i]) < 5e-3 * np.linalg.norm(J[:, i])


def test_from_curves_at_constant_force_to_the_law():
    """The whole way: sweeps of the truth with noise, their backbone, the law."""
    sweeps, rng = [], np.random.default_rng(5)
    for level in (0.002, 0.006, 0.015, 0.03):
        f = 0.0765 + 0.0045 * np.linspace(-1, 0.6, 41)
        result = solve_harmonic(chain(33), "push", level, at=f, harmonics=5, sensor="end")
        c = result.sensor_coefficients("end", "acceleration")
        h = (c[:, 1] - 1j * c[:, 2]) / level
        h = h * (1 + 0.003 * (rng.normal(size=41) + 1j * rng.normal(size=41)))
        sweeps.append(SineSweep(level, f, h, np.full(41, level)))
    backbone = from_constant_force(sweeps, "acceleration")
    free = solve_backbone(
        chain(33),
        at=backbone.amplitudes / (2 * np.pi * backbone.frequencies_hz) ** 2,
        near=0.076,
        sensor="end",
        harmonics=5,
    )
    scores = [
        (backbone.frequencies_hz - free.frequencies_hz) / backbone.frequencies_sd,
        (backbone.damping - free.damping_ratios) / backbone.damping_sd,
    ]
    assert np.mean(np.abs(scores) < 1.96) > 0.85
    check(identify(MODEL.with_parameters, None, None, START, backbone=backbone, **PLACES), 3.0)


def test_what_a_backbone_cannot_tell_is_said(measured):
    """Amplitudes that hardly slip say nothing of the slope when all has slipped."""
    low = replace(
        measured,
        **{
            key: getattr(measured, key)[:3]
            for key in ("amplitudes", "frequencies_hz", "frequencies_sd", "damping", "damping_sd")
        },
    )
    start = {"lap.E_p": 0.1, "lap.S_y": 0.5}
    found = identify(MODEL.with_parameters, None, None, start, backbone=low, **PLACES)
    assert "lap.E_p" in found.undetermined
    # A frequency that rises, which no slider makes, widens its own error and not that of damping.
    rising = replace(measured, frequencies_hz=measured.frequencies_hz[::-1])
    found = identify(MODEL.with_parameters, None, None, START, backbone=rising, **PLACES)
    assert found.mode.widths[0] > 20 > 4 > found.mode.widths[1]


def test_levels_of_force_need_damping_and_become_motions(measured):
    at_resonance = solve_backbone(
        chain(), (0.05, 0.8), force="push", near=0.076, sensor="end", harmonics=3
    )
    f, zeta = at_resonance.frequencies_hz, at_resonance.damping_ratios
    by_force = MeasuredBackbone(
        "force", at_resonance.force_amplitudes, f, 1e-3 * f, zeta, 0.1 * zeta
    )
    moved = as_motion(by_force, chain(), "push", "end")
    assert moved.amplitudes == pytest.approx(np.sort(at_resonance.amplitude("end")), rel=0.1)
    bare = replace(by_force, damping=np.full(len(f), np.nan), damping_sd=np.full(len(f), np.nan))
    with pytest.raises(InputError, match="expected damping at each level too"):
        as_motion(bare, chain(), "push", "end")
    with pytest.raises(InputError, match="expected curves and a level, loops, or a backbone"):
        identify(MODEL.with_parameters, None, None, START, **PLACES)

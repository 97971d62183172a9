"""Identification of joint laws from responses near a resonance."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from slip_chain import PLACES, TRUTH, chain

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.harmonic import (
    ContinuationSettings,
    MeasuredLoop,
    identify,
    predict,
    read_loops,
    solve_harmonic,
)
from fenics_joints.harmonic.identify import CurveFit, checked_data, peak_of
from fenics_joints.joint_laws import CubicSpring
from fenics_joints.measurements import MeasuredCurves

LEVELS = (0.005, 0.015, 0.03)


#: The identified model by its parameters.
CHAIN = chain().with_parameters


def made(level: float, at, sliders: int = 33):
    """The truth's response, with more sliders, harmonics and samples than the identified model."""
    return solve_harmonic(
        chain(sliders), "push", level, at=at, harmonics=7, samples=256, sensor="end"
    )


@pytest.fixture(scope="module")
def curves() -> MeasuredCurves:
    frequencies, amplitudes = [], []
    for level in LEVELS:
        band = (0.06, 0.09)
        branch = solve_harmonic(chain(), "push", level, band, harmonics=1, sensor="end")
        f = branch.peak.frequency_hz * np.linspace(0.97, 1.03, 11)
        frequencies.append(f)
        amplitudes.append(made(level, f).amplitude("end", "acceleration"))
    return MeasuredCurves(LEVELS, tuple(frequencies), tuple(amplitudes), "acceleration")


@pytest.fixture(scope="module")
def loop(curves) -> MeasuredLoop:
    """Two thirds of a period more than one of them, the clock started anywhere."""
    level, f = LEVELS[-1], float(curves.frequencies_hz[-1][4])
    result = made(level, [f])
    t = np.linspace(0, 1.7 / f, 90)
    angle = 2 * np.pi * f * (t - 0.3 / f)
    c = result.sensor_coefficients("end", "acceleration")[0]
    h = np.arange(1, 8)[:, None]
    response = c[1::2] @ np.cos(h * angle) + c[2::2] @ np.sin(h * angle)
    return MeasuredLoop(f, t, level * np.cos(angle), response, "acceleration")


def test_known_parameters_are_found_from_one_level_and_predict_the_others(curves):
    """By both methods; nine points are each solved once for each response."""
    start, found = {"lap.E_p": 0.1, "lap.S_y": 0.5}, {}
    # The least of the search's own objective, which for gradients is that of squares.
    for method, near in (("direct", 1e-6), ("gradient", 0.2)):
        one = identify(CHAIN, curves, LEVELS[-1], start, method=method, **PLACES)
        found[method] = one
        assert one.values["lap.S_y"] == pytest.approx(0.3, rel=0.03)
        assert one.values["lap.E_p"] == pytest.approx(0.2, rel=0.1)
        assert one.objective < 0.1 * one.start_objective
        assert one.objective == pytest.approx(np.abs(one.residuals).sum(), rel=1e-12)
        assert one.objective == pytest.approx(min(one.history), rel=near)
        for level in predict(one.model, curves, LEVELS[:2], **PLACES):
            assert abs(level.amplitude_error) < 0.01 and abs(level.frequency_error) < 1e-3
            assert level.mean_error < 0.01
        assert one.solutions == 9 * one.evaluations <= one.iterations
        assert len(one.history) == one.evaluations == len(one.trials)
        json.dumps(one.to_dict(), allow_nan=False)
    assert found["gradient"].evaluations < 0.5 * found["direct"].evaluations
    assert found["direct"].gradients == 1 < found["gradient"].gradients


def test_sharpness_is_found_from_a_loop(curves, loop):
    """All three from curve and loop; the loop's own scale is not known, nor when it began."""
    start = {"lap.S_y": 0.45, "lap.n": 1.5}
    found = identify(CHAIN, curves, LEVELS[-1], start, loops=[loop], harmonics=5, **PLACES)
    assert found.values["lap.n"] == pytest.approx(2.5, rel=0.05)
    assert found.values["lap.S_y"] == pytest.approx(0.3, rel=0.02)
    alone = identify(CHAIN, None, None, {"lap.n": 1.5}, loops=[loop], harmonics=5, **PLACES)
    assert alone.values["lap.n"] == pytest.approx(2.5, rel=0.05)
    assert alone.level == pytest.approx(LEVELS[-1]) and not len(alone.frequencies_hz)


def test_derivatives_pass_taylors_test(curves, loop):
    """What first-order derivatives leave falls as the step's square, for curve and loop alike."""
    data = checked_data(curves, LEVELS[-1], 9, [loop], "end")
    model, options = chain(), {"harmonics": 3, "settings": ContinuationSettings(tolerance=1e-11)}
    (lap,) = model.interfaces
    cubic = replace(lap, law=CubicSpring(0.6, -0.02), rows=lap.rows[:, :1], normal=False)
    smooth = replace(model, interfaces=(cubic,))
    fit = CurveFit(smooth.with_parameters, ("lap.k1", "lap.k3"), data, "push", options)
    fit.change = lambda values: smooth.with_parameters({**values, "lap.k3": -values["lap.k3"]})
    x, direction = np.log([0.6, 0.02]), np.array([0.5, -1.0])
    left = []
    r, J = fit.residual(x), fit.jacobian(x)
    for step in (0.02, 0.01, 0.005):
        change = step * direction
        apart = np.split(fit.residual(x + change) - r - J @ change, [9])
        left.append([np.linalg.norm(part) for part in apart])
    assert np.diff(np.log2(left), axis=0) == pytest.approx(np.full((2, 2), -2.0), abs=0.1)
    # With sliders the response bends wherever one more begins to slip: differences of it.
    fit = CurveFit(model.with_parameters, TRUTH, data, "push", options)
    x = np.log([0.15, 0.4, 2.0])
    fit.residual(x)
    J = fit.jacobian(x)
    for i, h in enumerate(1e-4 * np.eye(3)):
        slope = (fit.residual(x + h) - fit.residual(x - h)) / 2e-4
        assert np.linalg.norm(slope - J[:, i]) < 5e-3 * np.linalg.norm(J[:, i])


def test_what_the_data_do_not_determine_is_said(curves):
    """At a level that hardly slips, the slope beyond slip can be anything."""
    start = {"lap.E_p": 1e-4, "lap.S_y": 0.4}
    found = identify(CHAIN, curves, LEVELS[0], start, **PLACES)
    assert "lap.E_p" in found.undetermined and "lap.S_y" not in found.undetermined
    sd = np.sqrt(np.diag(np.linalg.inv(found.jacobian.T @ found.jacobian))) * found.noise
    assert list(found.sd.values()) == pytest.approx(sd, rel=1e-6)


def test_peak_of_a_sampled_resonance():
    """Off the samples, where a linear oscillator has it."""
    f = np.linspace(0.97, 1.021, 8)
    amplitude = 1 / np.abs(1 - f**2 + 2j * 0.01 * f)
    where, height = peak_of(f, amplitude)
    assert where == pytest.approx(np.sqrt(1 - 2e-4), abs=3e-4)
    assert height == pytest.approx(1 / (0.02 * np.sqrt(1 - 1e-4)), rel=3e-3)
    assert peak_of(f[:3], amplitude[:3]) == (f[2], amplitude[2])


def test_loops_are_read_from_a_table(loop, shared_tmp_path):
    path = shared_tmp_path / "loops.csv"
    if MPI.COMM_WORLD.rank == 0:
        lines = ["# a comment", "frequency [Hz],time [ms],force [N],response [m/s2]"]
        columns = loop.times * 1e3, loop.forces, loop.responses
        lines += [
            f"{loop.frequency_hz!r},{t!r},{f!r},{a!r}"
            for t, f, a in zip(*(c.tolist() for c in columns), strict=True)
        ]
        path.write_text("\n".join(lines), encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    (read,) = read_loops(path, "acceleration")
    assert read.level == pytest.approx(loop.level, rel=1e-9)
    assert read.angles() == pytest.approx(loop.angles(), abs=1e-9)
    with pytest.raises(InputError, match="no sine of that frequency"):
        MeasuredLoop(2 * loop.frequency_hz, loop.times, loop.forces, loop.responses, loop.response)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"method": "annealing"}, "method = 'annealing': expected one of: direct, gradient"),
        ({"parameters": {}}, "expected a start value"),
        ({"parameters": {"lap.S_y": 0.0}}, r"\['lap.S_y'\] = 0.0: expected a number above 0"),
        ({"parameters": {"lap.X": 1.0}}, "no parameter 'X'"),
        ({"level": 7.0}, "no curve was measured at 7 N"),
        ({"curves": None}, "expected curves that have it"),
        ({"curves": None, "level": None}, "there are no data"),
        ({"points": 2}, "points = 2: expected a whole number of at least 3"),
        ({"bounds": {"lap.S_y": (1.0, 2.0)}}, "expected 0 < low < start = 0.4 < high"),
        ({"bounds": {"lap.n": (1.0, 2.0)}}, "'lap.n' is no parameter"),
        ({"parameters": {"other.n": 1.0}}, "'other.n' belongs to no interface"),
    ],
)
def test_what_cannot_be_is_refused(curves, changes, words):
    given = {"curves": curves, "level": LEVELS[-1], "parameters": {"lap.S_y": 0.4}} | PLACES
    with pytest.raises(InputError, match=words):
        identify(CHAIN, **(given | changes))


def test_trials_without_a_model_are_turned_away(curves):
    """A slope beyond slip above that at rest is no backbone: the search goes round it."""
    start = {"lap.E_p": 0.9, "lap.S_y": 0.3}
    for method in ("direct", "gradient"):
        few = {"method": method, "max_evaluations": 10}
        found = identify(CHAIN, curves, LEVELS[-1], start, **few, **PLACES)
        assert found.values["lap.E_p"] < 1.0 and found.objective < found.start_objective
        assert found.failures == np.isinf(found.history).sum()

    def never(values):
        raise ConvergenceError("no model")

    with pytest.raises(ConvergenceError, match="no model"):
        identify(never, curves, LEVELS[-1], start, **PLACES)

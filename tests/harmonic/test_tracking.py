"""Folds, superharmonic and internal resonances over the force, and isolas."""

import numpy as np
import pytest
from oscillators import TURN, absorber, oscillator, start_of
from shooting import later

from fenics_joints.errors import InputError
from fenics_joints.harmonic import (
    ContinuationSettings,
    find_bifurcations,
    solve_harmonic,
    solve_isola,
    track_folds,
    track_resonance,
)
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import CubicSpring, ElasticFriction


def folds_of(result):
    return [b for b in find_bifurcations(result).bifurcations if b.kind == "fold"]


def test_folds_of_duffing_begin_at_its_cusp():
    """By one harmonic the least force with folds has a closed form; both folds lead to it."""
    c = 0.1
    model = oscillator(CubicSpring(0.0, 1.0), c)
    result = solve_harmonic(model, "push", 0.3, (0.7 / TURN, 3 / TURN), harmonics=1)
    omega = (np.sqrt(3) * c + np.sqrt(3 * c**2 + 4)) / 2  # omega^2 - 1 = sqrt(3) c omega
    square = 8 * np.sqrt(3) * c * omega / 9
    push = 2 * c * omega * np.sqrt(square / 3)
    for fold in folds_of(result):
        (turn,) = track_folds(result, fold, (0.01, 0.4), direction="down").turns
        assert turn.kind == "cusp"
        found = turn.force, TURN * turn.frequency_hz, turn.amplitude
        assert found == pytest.approx((push, omega, np.sqrt(square)), rel=1e-6)


def test_an_isola_is_found_and_attracts():
    """The absorber's detached branch of Detroux et al. 2015: it begins, and merges with the main
    branch, where folds turn back in force; a motion on it is that of time integration."""
    model = absorber()
    result = solve_harmonic(model, "push", 0.15, (0.9 / TURN, 1.5 / TURN), harmonics=5)
    curve = track_folds(result, folds_of(result)[2], (0.1, 0.3))
    turns = {turn.kind: turn for turn in curve.turns}
    assert list(turns) == ["merger", "isola"]
    begins, ends = turns["isola"].force, turns["merger"].force
    assert 0.12 < begins < 0.13 and 0.18 < ends < 0.19
    small, large = (solve_isola(curve, force) for force in (1.005 * begins, 0.995 * ends))
    assert np.ptp(small.omegas) < 0.15 < 0.9 < np.ptp(large.omegas)
    for isola in (small, large):
        assert isola.coefficients[-1] == pytest.approx(isola.coefficients[0])
    high = np.abs(large.amplitude() - 0.9 * large.peak.amplitude)
    i = int(np.argmin(np.where(find_bifurcations(large, method="hill").stable, high, np.inf)))
    state, push = start_of(large.coefficients[i], large.omegas[i]), large.force_amplitudes[i]
    found = later(model, push, large.omegas[i], 1.002 * state, 20)
    assert found == pytest.approx(state, abs=0.02 * np.abs(state).max())
    assert large.peak.amplitude > 1.5 * result.peak.amplitude
    with pytest.raises(InputError, match="has no fold there"):
        solve_isola(curve, 0.99 * begins)
    with pytest.raises(InputError, match="no branch through these folds closes"):
        solve_isola(curve, 1.05 * ends)


@pytest.mark.parametrize(
    ("law", "near"), [(CubicSpring(0.0, 1.0), 0.01), (ElasticFriction(0.3, 0.02), 0.02)]
)
def test_a_superharmonic_resonance_is_where_its_harmonic_is_largest(law, near):
    """Nearly, as damping is light or not; a cubic spring's in quadrature by a closed form too."""
    model = oscillator(law, 0.01)
    band, options = (0.28 / TURN, 0.45 / TURN), {"harmonics": 5, "samples": 512}
    fine = ContinuationSettings(max_step=0.05)
    result = solve_harmonic(model, "push", 0.3, band, settings=fine, **options)
    tracked = track_resonance(result, 3, (0.3, 0.5))
    assert tracked.force_amplitudes[[0, -1]] == pytest.approx([0.3, 0.5])
    for i, branch in (
        (0, result),
        (-1, solve_harmonic(model, "push", 0.5, band, settings=fine, **options)),
    ):
        third = np.hypot(*branch.coefficients[:, 0, 5:7].T)
        inside = slice(*np.searchsorted(branch.omegas, [0.3, 0.44]))
        top = branch.omegas[inside][np.argmax(third[inside])]
        assert tracked.omegas[i] == pytest.approx(top, rel=near)
    if isinstance(law, CubicSpring):
        first, third = (
            np.angle(tracked.coefficients[:, 0, k] - 1j * tracked.coefficients[:, 0, k + 1])
            for k in (1, 5)
        )
        assert np.cos(third - 3 * first) == pytest.approx(np.zeros(len(tracked)), abs=1e-6)


def test_an_internal_resonance_follows_what_the_first_mode_stiffens():
    """Three times the frequency is the second mode's, 3.3 rad/s and what the cube's mean adds."""
    first, second, zeta, k3 = 1.0, 3.3, 1e-3, 1.0
    modes = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
    K, C = (
        modes @ np.diag(d) @ modes.T
        for d in ((first**2, second**2), (2 * zeta * first, 2 * zeta * second))
    )
    spring = InterfacePoints("spring", CubicSpring(0.0, k3), np.array([[[1.0, 0.0]]]), np.ones(1))
    places = {"push": np.ones(2)}, {"mass": np.array([1.0, 0.0])}
    model = InterfaceModel(np.eye(2), K, (spring,), C, *places)
    band = 0.9 / TURN, 1.2 / TURN
    fine = ContinuationSettings(max_step=0.02)
    result = solve_harmonic(model, "push", 0.008, band, harmonics=7, settings=fine)
    tracked = track_resonance(result, 3, (0.008, 0.03))
    X = tracked.coefficients
    third = np.linalg.norm(X[:, :, 5:7], axis=2)
    assert third[:, 0] == pytest.approx(third[:, 1], rel=0.05)  # of the second mode
    # A small motion beside a cos(w t) meets the mean of 3 k3 a^2 cos^2, by half of it in the mode.
    mean = 1.5 * k3 * np.hypot(X[:, 0, 1], X[:, 0, 2]) ** 2
    expected = np.sqrt(second**2 + mean / 2) / 3 - second / 3
    assert tracked.omegas - second / 3 == pytest.approx(expected, rel=0.08)
    assert expected[-1] > 7e-4


def test_what_does_not_resonate_is_said():
    model = oscillator(CubicSpring(0.0, 1.0), 0.01)
    result = solve_harmonic(model, "push", 0.01, (0.05, 0.052), harmonics=3)
    with pytest.raises(InputError, match="it resonates nowhere on the branch"):
        track_resonance(result, 3, (0.005, 0.02))
    with pytest.raises(InputError, match=r"the result's 0\.01 N between"):
        track_resonance(result, 3, (0.05, 0.1))

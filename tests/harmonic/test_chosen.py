"""As many harmonics as a response needs."""

import numpy as np
import pytest
from oscillators import BAND, duffing, escape, jenkins

from fenics_joints.errors import ConvergenceError
from fenics_joints.harmonic import neglected_harmonics, solve_harmonic, solve_to_tolerance


@pytest.mark.parametrize(
    ("model", "push", "band"),
    [(duffing(), 0.05, BAND), (jenkins(), 0.2, (0.1, 0.25)), (escape(), 0.03, (0.08, 0.2))],
    ids=["cubic", "slider", "square"],
)
def test_the_estimate_is_what_more_harmonics_add(model, push, band):
    """Against many more, at the peak; the first estimate of all of them is of the right size."""
    result = solve_to_tolerance(model, "push", push, band, tolerance=1e-3, samples=512)
    H, i = result.balance.fourier.harmonics, result.peak.index
    assert 3 <= H <= 9
    assert neglected_harmonics(result, [i]).max() <= 1e-3
    few = solve_harmonic(model, "push", push, band, harmonics=1, samples=512)
    estimated = np.linalg.norm(neglected_harmonics(few, [few.peak.index], up_to=21))
    many = solve_harmonic(model, "push", push, band, harmonics=21, samples=512)
    assert result.peak.amplitude == pytest.approx(many.peak.amplitude, rel=2e-3)
    X = many.coefficients[many.peak.index, 0]
    size = np.linalg.norm(X[1:])
    assert np.linalg.norm(X[2 * H + 1 :]) / size < 2e-3
    assert estimated == pytest.approx(np.linalg.norm(X[3:]) / size, rel=0.6)


def test_too_few_are_said():
    with pytest.raises(ConvergenceError, match="3 harmonics leave out"):
        solve_to_tolerance(duffing(), "push", 0.05, BAND, tolerance=1e-6, most=3)

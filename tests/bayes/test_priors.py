"""Priors keep to bounds and laws, say what they are, and are refused by name."""

from __future__ import annotations

import numpy as np
import pytest
from linear_posterior import NoLaws, linear, prior
from scipy import stats

from fenics_joints.bayes import Posterior, PriorDensity, Settings, sample
from fenics_joints.bayes.priors import density
from fenics_joints.errors import InputError
from fenics_joints.structure import Parameter
from fenics_joints.updating.coordinates import LogScale

pytest.importorskip("arviz")


def test_priors_keep_to_bounds_and_laws():
    """The Jacobian: draws of a chain without data have the prior's moments."""
    known = prior(0.5, lower=0.5, upper=3.0)
    silent = Posterior(known, linear, lambda log_f: np.zeros(len(log_f)))
    draws = sample(silent, Settings(samples=8000, burn_in=1000)).draws()
    exact = stats.truncnorm(np.log(0.5) / 0.5, np.log(3.0) / 0.5, 0, 0.5)
    assert np.log(draws).mean() == pytest.approx(exact.mean(), abs=0.03)
    assert np.log(draws).std() == pytest.approx(exact.std(), rel=0.05)
    drawn = known.values(known.sample(4000, np.random.default_rng(0)))
    assert np.log(drawn).mean() == pytest.approx(exact.mean(), abs=0.02)


@pytest.mark.parametrize(
    ("kind", "numbers", "words"),
    [
        ("nomral", {"mean": 1, "sd": 0.1}, "expected one of: normal"),
        ("normal", {"mean": 1}, "expected mean, sd"),
        ("normal", {"mean": 1, "sd": -0.1}, "finite number above 0"),
        ("normal", {"mean": 1, "sd": 0.9}, "negative values"),
        ("normal", {"mean": -5, "sd": 1}, "positive number"),
        ("uniform", {"low": 3, "high": 2}, "0 <= low < high"),
        ("lognormal", {"median": 0, "log_sd": 1}, "positive number"),
    ],
)
def test_bad_priors_are_named(kind, numbers, words):
    with pytest.raises(InputError, match=f"prior of lap.k1: .*{words}"):
        density("lap.k1", kind, numbers)


def test_priors_in_words_and_beside_their_bounds():
    """Units, and the range that bounds leave, which may be none."""
    normal = density("lap.E", "normal", {"mean": 2e9, "sd": 1e8})
    p, scale = Parameter("lap.E", 2e9, unit="Pa", upper=2e9), LogScale(["lap.E"], NoLaws())
    (words,) = PriorDensity((p,), (normal,), scale).describe()
    assert words == "lap.E: normal, 95 % in 1.78 to 2.00 GPa"
    far = Parameter("lap.E", 3e9, lower=2.9e9)
    with pytest.raises(InputError, match="prior of lap.E: has .* of its probability"):
        PriorDensity((far,), (normal,), scale)

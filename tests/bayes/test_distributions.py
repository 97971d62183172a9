"""Densities against closed forms, and the distribution that samples follow."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from fenics_joints.bayes.distributions import choose, log_pdf
from fenics_joints.errors import InputError

pytest.importorskip("arviz")


def test_densities_in_closed_form():
    shapes = {"lognorm": (0.3,), "loguniform": (0.5, 3.0), "gamma": (4.0,), "beta": (2.0, 3.0)}
    shapes |= {"truncnorm": (-1.0, 2.0), "weibull_min": (8.0,)}
    shapes |= dict.fromkeys(("norm", "uniform", "gumbel_r", "gumbel_l", "logistic"), ())
    for name, args in shapes.items():
        frozen = getattr(stats, name)(*args, 1.5, 2.0)
        x = np.append(frozen.rvs(40, random_state=1), [-30.0, 0.0, 1.5, 300.0])
        found = log_pdf(frozen)
        assert found != frozen.logpdf
        np.testing.assert_allclose(found(x), frozen.logpdf(x), rtol=1e-9, atol=1e-12)
        by_name = getattr(stats, name)(*args, scale=2.0)
        np.testing.assert_allclose(log_pdf(by_name)(x), by_name.logpdf(x), rtol=1e-9, atol=1e-12)
    assert log_pdf(stats.pareto(b=3.0))(np.array([2.0])) == stats.pareto(3.0).logpdf(2.0)


def test_distributions_of_figure_7_are_found():
    """Jalali et al. 2019, Figure 7: a Weibull of shape 819 is found, and not taken for a normal."""
    x = stats.weibull_min(819.5, scale=2035.08).rvs(400, random_state=3)
    found = choose("mode 5", x, ["normal", "weibull", "gumbel"])
    shape, scale = found.frozen.args[0], found.frozen.kwds["scale"]
    assert found.family == "weibull" and found.p_value > 0.05
    # Where the likelihood is greatest, by its derivatives.
    z = x / scale
    assert np.mean(z**shape) == pytest.approx(1, abs=1e-6)
    assert 1 / shape + np.mean(np.log(z)) == pytest.approx(np.mean(z**shape * np.log(z)), abs=1e-6)
    assert scale == pytest.approx(2035.08, rel=5e-4) and shape == pytest.approx(819.5, rel=0.15)


def test_what_does_not_fit_is_refused():
    rng = np.random.default_rng(4)
    two_kinds = np.concatenate([rng.normal(100, 0.1, 20), rng.normal(110, 0.1, 20)])
    with pytest.raises(InputError, match="first: no distribution fits its 40 frequencies"):
        choose("first", two_kinds, ["normal"])
    accepted = choose("first", two_kinds, ["normal"], accept_misfit=True)
    assert accepted.doubtful and "fits badly" in accepted.words("first")
    for bad, words in (
        ([1.0, 2.0], "at least 5"),
        ([1.0, -2, 3, 4, 5], "positive"),
        ([5.0] * 9, "some scatter"),
    ):
        with pytest.raises(InputError, match=words):
            choose("first", np.array(bad))

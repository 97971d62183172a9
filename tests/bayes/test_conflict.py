"""Priors that the data contradict."""

from __future__ import annotations

import numpy as np
import pytest
from linear_posterior import MODES, SLOPE, NoLaws, linear, prior

from fenics_joints.bayes import Prior, check_prior
from fenics_joints.errors import InputError
from fenics_joints.structure import Parameter
from fenics_joints.updating.coordinates import LogScale

pytest.importorskip("arviz")


def test_prior_that_excludes_the_data():
    """What no value within four standard deviations of the prior brings near is refused."""
    known, sd = prior(0.1), np.full(3, 0.01)
    near = np.log(100) + SLOPE @ [0.3, -0.3]
    assert check_prior(known, linear, MODES, near, sd) == []
    far = np.log(100) + SLOPE @ [0.0, 1.5]
    # Along b alone, as far as its fourth standard deviation.
    left = 100 * np.expm1(np.max(np.abs(SLOPE[:, 1])) * (1.5 - 0.4))
    with pytest.raises(InputError, match="prior of .*b: excludes the data") as error:
        check_prior(known, linear, MODES, far, sd)
    found = float(str(error.value).split(" %")[0].split()[-1])
    assert 0.5 * left < found < left
    # Not the prior's fault: no parameter moves the modes apart so.
    odd = np.log(100) + np.array([0.1, 0.1, -0.1])
    words = check_prior(prior(2.0), linear, MODES, odd, np.full(3, 0.003))
    assert words and "third" in words[-1] and "give it a discrepancy" in words[-1]


def test_prior_beside_its_bounds_is_named():
    far = (Parameter("a", 30.0, lower=20.0),)
    with pytest.raises(InputError, match="prior of a: has .* of its probability"):
        Prior(far, prior().densities[:1], LogScale("a", NoLaws()))

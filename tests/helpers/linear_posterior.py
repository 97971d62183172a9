"""A linear model of three frequencies, with its prior and likelihood, for the tests of Bayes."""

from __future__ import annotations

import numpy as np

from fenics_joints.bayes import GaussianLikelihood, PriorDensity
from fenics_joints.bayes.priors import density
from fenics_joints.structure import Parameter
from fenics_joints.updating.coordinates import LogScale

SLOPE = np.array([[0.3, 0.1], [0.1, 0.4], [0.2, 0.2]])
MODES = ("first", "second", "third")


class NoLaws:
    regions = ()


def prior(log_sd=0.5, **bounds):
    parameters = tuple(Parameter(name, 1.0, **bounds) for name in "ab")
    given = {"median": 1.0, "log_sd": log_sd}
    densities = tuple(density(name, "lognormal", given) for name in "ab")
    return PriorDensity(parameters, densities, LogScale("ab", NoLaws()))


def linear(values):
    """ln f of a model that is linear in the logarithms."""
    return np.log(100.0) + np.log(values) @ SLOPE.T


def gaussian(shift=0.0):
    covariance = 1e-4 * np.array([[4.0, 2, 1], [2, 9, 3], [1, 3, 4]])
    return GaussianLikelihood(MODES, np.log(100) + SLOPE @ [0.1, -0.2] + shift, covariance)

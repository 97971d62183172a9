"""Bayesian identification: what the measured frequencies say about parameters, and how surely."""

from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.likelihood import FittedLikelihood, GaussianLikelihood
from fenics_joints.bayes.posterior import Posterior
from fenics_joints.bayes.priors import Prior
from fenics_joints.bayes.samplers import Settings, sample

__all__ = [
    "Chains",
    "FittedLikelihood",
    "GaussianLikelihood",
    "Posterior",
    "Prior",
    "Settings",
    "sample",
]

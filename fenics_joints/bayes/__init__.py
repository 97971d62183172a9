"""Bayesian identification: what the measured frequencies say about parameters, and how surely."""

from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.checks import calibrate, check_predictive, check_prior, rank, replicate
from fenics_joints.bayes.gibbs import Gibbs, Level
from fenics_joints.bayes.hierarchical import Specimens, sample_hierarchy
from fenics_joints.bayes.likelihood import FittedLikelihood, GaussianLikelihood
from fenics_joints.bayes.posterior import Posterior
from fenics_joints.bayes.priors import PriorDensity
from fenics_joints.bayes.samplers import Settings, sample

__all__ = [
    "Chains",
    "FittedLikelihood",
    "GaussianLikelihood",
    "Gibbs",
    "Level",
    "Posterior",
    "PriorDensity",
    "Settings",
    "Specimens",
    "calibrate",
    "check_predictive",
    "check_prior",
    "rank",
    "replicate",
    "sample",
    "sample_hierarchy",
]

"""Updating a model's parameters on a test: frequencies, shapes, damping ratios, FRFs, contact."""

from fenics_joints.measurements import FRFTarget, Target
from fenics_joints.updating.curves import Curves, fit_curves
from fenics_joints.updating.cutoff import CutoffMinimum, CutoffModel, CutoffSweep, minimise, sweep
from fenics_joints.updating.fit import update, update_all
from fenics_joints.updating.prediction import Prediction, Predictor
from fenics_joints.updating.result import Iteration, Update
from fenics_joints.updating.weighted import update_weighted

__all__ = [
    "Curves",
    "CutoffMinimum",
    "CutoffModel",
    "CutoffSweep",
    "FRFTarget",
    "Iteration",
    "Prediction",
    "Predictor",
    "Target",
    "Update",
    "fit_curves",
    "minimise",
    "sweep",
    "update",
    "update_all",
    "update_weighted",
]

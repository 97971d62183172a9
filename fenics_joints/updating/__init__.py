"""Updating a model's parameters on a test: frequencies, shapes, damping ratios, FRFs, contact."""

from fenics_joints.updating.cutoff import CutoffMinimum, CutoffModel, CutoffSweep, minimise, sweep
from fenics_joints.updating.fit import update_combined
from fenics_joints.updating.prediction import Prediction, Predictor
from fenics_joints.updating.result import CombinedUpdate, Iteration
from fenics_joints.updating.updating import Update, update
from fenics_joints.updating.weighted import update_weighted

__all__ = [
    "CombinedUpdate", "CutoffMinimum", "CutoffModel", "CutoffSweep", "Iteration", "Prediction",
    "Predictor", "Update", "minimise", "sweep", "update", "update_combined", "update_weighted",
]  # fmt: skip

"""Reduced models: parametric, plain arrays, checked, narrow enough to sample; and their files."""

from fenics_joints.reduction.arrays import ArrayModel, freeze
from fenics_joints.reduction.files import read_array_model, write_array_model
from fenics_joints.reduction.frf_basis import checked_frf_model, frf_basis, frf_error
from fenics_joints.reduction.prediction import BatchPrediction, ModalPrediction, Narrow, narrow
from fenics_joints.reduction.reduced import ReducedStructure, reduce

__all__ = [
    "ArrayModel",
    "ModalPrediction",
    "BatchPrediction",
    "Narrow",
    "ReducedStructure",
    "checked_frf_model",
    "freeze",
    "frf_basis",
    "frf_error",
    "narrow",
    "read_array_model",
    "reduce",
    "write_array_model",
]

"""Random stiffnesses of joints, and the frequencies they lead to (Jalali et al. 2019)."""

from fenics_joints.random_fields.fields import (
    FieldMap,
    KarhunenLoeve,
    Moments,
    RandomField,
    karhunen_loeve,
    propagate_samples,
    propagate_sensitivities,
)

__all__ = [
    "FieldMap",
    "KarhunenLoeve",
    "Moments",
    "RandomField",
    "karhunen_loeve",
    "propagate_samples",
    "propagate_sensitivities",
]

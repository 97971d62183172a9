"""The test as evidence: hypotheses, what they predict of it, their fits and their weights."""

from fenics_joints.diagnosis.evidence.evidence import Evidence, evidence_of
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.library import fit
from fenics_joints.diagnosis.evidence.predictions import PointwiseForward, model_of

__all__ = ["Evidence", "Fit", "Hypothesis", "PointwiseForward", "evidence_of", "fit", "model_of"]

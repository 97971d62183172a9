"""Structures by stiffness and mass matrices of another code, joined by the suite's joint laws."""

from fenics_joints.matrices.faces import NodeInterface
from fenics_joints.matrices.part import MatrixPart
from fenics_joints.matrices.structure import MatrixJoint, MatrixStructure

__all__ = ["NodeInterface", "MatrixJoint", "MatrixPart", "MatrixStructure"]

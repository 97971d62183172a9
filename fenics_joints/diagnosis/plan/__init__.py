"""Before any data: which causes a planned test could tell apart, and what to measure besides."""

from fenics_joints.diagnosis.plan.planned import plan
from fenics_joints.diagnosis.plan.result import Plan, PlannedClass, PlannedEffect

__all__ = ["Plan", "PlannedClass", "PlannedEffect", "plan"]

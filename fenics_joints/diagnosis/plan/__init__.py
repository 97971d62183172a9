"""Before any data: which causes a planned test could tell apart, and what to measure besides."""

from fenics_joints.diagnosis.plan.planned import Plan, PlannedClass, PlannedEffect, plan

__all__ = ["Plan", "PlannedClass", "PlannedEffect", "plan"]

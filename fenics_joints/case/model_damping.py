"""The damping of a case's model: its ``[damping]``, and the c of laps of beams."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from fenics_joints.beams import BeamStructure
from fenics_joints.case.case import Case
from fenics_joints.reduction.affine import RegionTerm
from fenics_joints.structure.damping import Damping

__all__ = ["model_damping"]


def model_damping(case: Case, structure) -> Damping:
    """The damping of a case, its values as parameters; none where it has none.

    A part or joint of beams that ``[damping]`` names is all of its stiffness: of a part its beams,
    with their axial stiffness in the laps; of a joint slap, slip and its own axial stiffness.

    Args:
        case: The case.
        structure: Its structure, built with ``damping``.
    """
    named = Damping() if case.damping is None else case.damping.damping()
    if not isinstance(structure, BeamStructure):
        return named
    viscous, hysteretic = (
        {region.name: value for name, value in own.items() for region in _stiff(structure, name)}
        for own in (named.viscous, named.hysteretic)
    )
    viscous |= structure.joint_damping().viscous
    return replace(named, viscous=viscous, hysteretic=hysteretic)


def _stiff(beams: BeamStructure, name: str) -> Iterator[RegionTerm]:
    """Regions with stiffness whose properties are those of a section."""
    for region in beams.regions:
        owners = {p.partition(".")[0] for p in region.properties.values() if isinstance(p, str)}
        if name in owners and len(region.stiffness):
            yield region

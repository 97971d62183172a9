"""How large things are, and so in which unit places are that a file gives without one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case.mesh import BUILDERS
from fenics_joints.errors import MeshError
from fenics_joints.meshes.cad_survey import StepSurvey
from fenics_joints.meshes.msh import read_lists

#: Factors to metres of the units that files are in, the largest first.
UNITS = {"m": 1.0, "inch": 0.0254, "cm": 1e-2, "mm": 1e-3}
#: Between these numbers of a unit, in metres, structures are that stand in a lab.
METRES = (1e-3, 15.0)
#: Sensors stand a little beside the drawing, too: share of its extent, and m.
_ROOM, _BESIDE = 1.02, 1e-3


def extents_of_step(survey: StepSurvey) -> np.ndarray:
    """Along the axes, m, shape (3,)."""
    return np.ptp([solid.box for solid in survey.solids], axis=(0, 1))


def extents_of_msh(path: Path) -> np.ndarray | None:
    """Along the axes, in the file's unit, shape (2,) or (3,); None if it cannot be read."""
    for gdim in (3, 2):
        try:
            return np.ptp(read_lists(path, gdim, 1.0).x, axis=0)
        except MeshError:
            pass
    return None


def extents_of_builder(name: str) -> np.ndarray | None:
    """With its own numbers, m; None where it has none."""
    kind = BUILDERS.get(name)
    if kind is None or kind.origin == "beams":
        return None
    return np.ptp(kind(builder=name).made().build(MPI.COMM_SELF).mesh.geometry.x, axis=0)


def likely_unit(spans: Sequence[float], extents: np.ndarray | None) -> str:
    """The largest unit with which places span no more than the structure.

    Turned or moved axes change nothing; sensors on a small part of a structure may mislead, so it
    is a guess.

    Args:
        spans: Of the places along their axes, in their unit.
        extents: Of the structure, m; None if they are not known, and then a usual size decides.
    """
    spans = np.sort(spans)[::-1]
    if extents is None:
        return "m" if METRES[0] <= spans[0] <= METRES[1] else "mm"
    room = np.zeros(len(spans))
    room[: len(extents)] = np.sort(extents)[::-1][: len(spans)]
    for unit, factor in UNITS.items():
        if np.all(factor * spans <= _ROOM * room + _BESIDE):
            return unit
    return "mm"

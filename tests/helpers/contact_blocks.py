"""Blocks pressed on each other, for the tests of preload contact."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from fenics_joints.preload import Contact
from fenics_joints.structure import part

COMM = MPI.COMM_WORLD
STEEL = {"E": 200e9, "nu": 0.3, "rho": 7800.0}


def faces(**options) -> Contact:
    """The contact of stacked blocks."""
    return Contact("c", "interface_lower", "interface_upper", **options)


def both(**properties):
    return [part("both", ("lower", "upper"), **STEEL | properties)]


def slope_of(errors, sizes) -> float:
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]

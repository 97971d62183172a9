"""Plates with a layer and blocks in contact, for the tests of reduced interfaces."""

from __future__ import annotations

import numpy as np
import ufl
from mpi4py import MPI

from fenics_joints.joint_laws import JointLaw
from fenics_joints.meshes import lap_plates, stacked_blocks
from fenics_joints.preload import Contact, PreloadModel
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.structure import Parameter, PointMass, Spring, Structure, Support, joint, part

E, G = 1e9, 3e8
N = 14
TIP, END = ((0.1, 0.02, 0.0), (0.0, 0.0, 1.0)), ((0.32, 0.06, 0.0165), (0.0, 0.6, 0.8))
PLACES = {"forces": {"tip": TIP, "end": END}, "sensors": {"tip": TIP, "end": END}}


class Stick(JointLaw):
    """A linear spring in the tangent plane."""

    def element(self, normal, slip, state, p):
        return ufl.as_ufl(0.0), p["k"] * slip, None


class Bond(JointLaw):
    """Linear springs in all directions."""

    coupled = True

    def element(self, normal, slip, state, p):
        return p["k_n"] * normal, p["k"] * slip, None


def plates(comm=MPI.COMM_WORLD, law="uncoupled", cell="hexahedron", held=False, degree=2):
    """Lap plates with a soft layer, free or clamped at an end, with something on them."""
    parts = part("plates", ("plate_1", "plate_2"), E="E", nu=0.3, rho=2750.0)
    layer = joint(
        "layer", ("joint_near", "joint_away"), E="layer.E", G="layer.G", stretch="s", law=law
    )
    return Structure(
        lap_plates(comm, element_size=0.04, n_thickness=1, cell=cell),
        [parts, layer],
        [
            Parameter("E", 7e10),
            Parameter("layer.E", 8e8),
            Parameter("layer.G", G),
            Parameter("s", 1.0),
            Parameter("m", 0.02),
        ],
        masses=[PointMass("tip", "m", (0.01, 0.03, 0.0))],
        springs=[Spring("cord", 1e4, (0.02, 0.0, 0.004), (0.0, 1.0, 0.0))],
        supports=[Support("end_1")] if held else [],
        degree=degree,
    )


def relative(found, exact, n_rigid=0):
    """Errors of the elastic frequencies, (n,)."""
    return found.frequencies_hz[n_rigid:] / exact.frequencies_hz[n_rigid:] - 1


def blocks(comm=MPI.COMM_WORLD, degree=2, bolts=()):
    """Two free bars, one on the other."""
    x, y, h = np.linspace(0.0, 0.2, 9), np.linspace(0.0, 0.02, 3), np.linspace(0.0, 0.01, 2)
    mesh = stacked_blocks(comm, lower=(x, y, -h[::-1]), upper=h)
    bars = part("bars", ("lower", "upper"), E="E", nu=0.3, rho=7800.0)
    structure = Structure(mesh, [bars], [Parameter("E", 2e11)], degree=degree)
    pads = Contact("pads", "interface_lower", "interface_upper")
    return PreloadModel(structure, [pads], bolts)


def sprung(model, k_n, k):
    areas = model.interfaces[0].areas
    return LinearJoint(model, springs={"pads": np.column_stack([areas * k_n, areas * k])})

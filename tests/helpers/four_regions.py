"""A free bar in four regions, one of which may be of another material, and what a test sees."""

from __future__ import annotations

from dataclasses import replace

import dolfinx.mesh
import numpy as np

from fenics_joints._compat import geometry_dofmap
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Sensors, Structure, part

NAMES = ("a", "b", "c", "d")
LENGTH = 0.4
MODES = 4


def beam(comm, wrong: str = "", factor: float = 0.7, density: float = 1.0) -> Structure:
    """A free bar in four equal regions, one of them with another modulus or density."""
    tagged = box(comm, (LENGTH, 0.03, 0.02), (16, 1, 1))
    mesh, tags = tagged.mesh, tagged.cell_tags
    x = mesh.geometry.x[geometry_dofmap(mesh)[tags.indices]].mean(axis=1)[:, 0]
    values = (1 + np.floor(x / LENGTH * len(NAMES))).astype(np.int32)
    tagged = replace(
        tagged,
        cell_tags=dolfinx.mesh.meshtags(mesh, tags.dim, tags.indices, values),
        cell_names={name: k + 1 for k, name in enumerate(NAMES)},
    )
    regions = [
        part(
            name,
            name,
            E=70e9 * (factor if name == wrong else 1.0),
            nu=0.3,
            rho=2700.0 * (density if name == wrong else 1.0),
        )
        for name in NAMES
    ]
    return Structure(tagged, regions)


def sensors() -> Sensors:
    """Nine stations on two edges, across the bar both ways."""
    x = np.linspace(0.0, LENGTH, 9)
    points = [(a, y, 0.02) for a in x for y in (0.0, 0.03) for _ in range(2)]
    directions = [d for _ in range(18) for d in ((0, 1, 0), (0, 0, 1))]
    return Sensors(np.array(points), np.array(directions, dtype=float))


def measured(structure: Structure, noise: float = 0.0):
    """Frequencies and shapes of the bar's first elastic modes at the sensors."""
    modes = solve_modes(structure, n_modes=6 + MODES)
    shapes = modes.at(sensors())[:, 6:]
    rms = np.sqrt(np.mean(shapes**2, axis=0))
    rng = np.random.default_rng(5)
    shapes = shapes + noise * rms * rng.standard_normal(shapes.shape)
    return modes.frequencies_hz[6:], shapes

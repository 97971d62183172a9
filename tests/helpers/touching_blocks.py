"""Files of two blocks that touch, with no layer in between, and what springs there do to a bar."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gmsh_files import gmsh_file
from scipy.optimize import brentq

#: A bar of two halves along x, m, and its material; with nu = 0 it is of one dimension.
HALF, WIDTH, E, RHO = 0.1, 0.01, 70e9, 2700.0
PART = f"""
[parts.metal]
cells = ["one", "two"]
E = {E}
nu = 0.0
rho = {RHO}
"""


def bar_frequency(k: float, modulus: float) -> float:
    """First frequency, Hz, of two free halves that move against each other on a spring k, Pa/m.

    u = cos(beta x) on each half, x from its free end; the jump 2 u(L) bears modulus beta sin:
    beta L tan(beta L) = 2 k L / modulus.
    """
    top = np.pi / 2 * (1 - 1e-12)
    a = brentq(lambda a: a * np.tan(a) - 2 * k * HALF / modulus, 1e-9, top, xtol=1e-14)
    return a / HALF * np.sqrt(modulus / RHO) / (2 * np.pi)


def write_bar(path: Path, cell: str = "hexahedron", shared: bool = True, turn: float = 0.0) -> Path:
    """The bar as a .msh file in millimetres: ``one``, ``two``, faces ``sides``.

    Args:
        path: The file.
        cell: Shape of its cells.
        shared: Whether the halves share the vertices between them, or have each their own.
        turn: Angle about (1, 2, -0.5), rad.
    """
    with gmsh_file(path) as gmsh:
        occ, mesh = gmsh.model.occ, gmsh.model.mesh
        length, width = 1e3 * HALF, 1e3 * WIDTH
        boxes = [occ.addBox(x, 0, 0, length, width, width) for x in (0, length)]
        if shared:
            occ.fragment([(3, boxes[0])], [(3, boxes[1])])
        occ.synchronize()
        for _, curve in gmsh.model.getEntities(1):
            box = np.array(gmsh.model.getBoundingBox(1, curve)).reshape(2, 3)
            along = np.ptp(box, axis=0).argmax() == 0
            mesh.setTransfiniteCurve(curve, 9 if along else 2)
        for _, face in gmsh.model.getEntities(2):
            mesh.setTransfiniteSurface(face)
            if cell == "hexahedron":
                mesh.setRecombine(2, face)
        for _, volume in gmsh.model.getEntities(3):
            mesh.setTransfiniteVolume(volume)
        sides = [
            face
            for _, face in gmsh.model.getEntities(2)
            if np.ptp(np.array(gmsh.model.getBoundingBox(2, face)).reshape(2, 3)[:, 0]) > 1
        ]
        for number, name in enumerate(("one", "two"), start=1):
            gmsh.model.addPhysicalGroup(3, [number], number, name)
        gmsh.model.addPhysicalGroup(2, sides, 3, "sides")
        mesh.generate(3)
        if turn:
            a = np.array([1, 2, -0.5]) / np.linalg.norm([1, 2, -0.5])
            cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
            turned = np.eye(3) + np.sin(turn) * cross + (1 - np.cos(turn)) * cross @ cross
            mesh.affineTransform(np.hstack([turned, np.zeros((3, 1))]).ravel().tolist())
    return path

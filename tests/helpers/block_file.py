"""A file of one block, all six faces of which have names."""

from __future__ import annotations

from pathlib import Path

from gmsh_files import gmsh_file

FACES = ("left", "right", "front", "back", "bottom", "top")


def write_block(path: Path, size=(20.0, 20.0, 40.0), cells=(2, 2, 2)) -> Path:
    """A block of hexahedra from the origin, mm, as a .msh file: ``block`` and `FACES`."""
    with gmsh_file(path) as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, *size)
        gmsh.model.occ.synchronize()
        mesh = gmsh.model.mesh
        for _, curve in gmsh.model.getEntities(1):
            box = gmsh.model.getBoundingBox(1, curve)
            axis = max(range(3), key=lambda i, box=box: box[i + 3] - box[i])
            mesh.setTransfiniteCurve(curve, cells[axis] + 1)
        for _, face in gmsh.model.getEntities(2):
            mesh.setTransfiniteSurface(face)
            mesh.setRecombine(2, face)
        mesh.setTransfiniteVolume(1)
        gmsh.model.addPhysicalGroup(3, [1], 1, "block")
        for tag, name in enumerate(FACES, start=1):  # OpenCASCADE's order: by axis, low and high
            gmsh.model.addPhysicalGroup(2, [tag], tag + 1, name)
        mesh.generate(3)
    return path

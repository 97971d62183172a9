"""Meshes of gmsh for tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def gmsh_file(path: Path, **options: float) -> Iterator:
    """gmsh, to draw and mesh in; what it has at the end is written to a .msh file.

    Args:
        path: The file.
        options: Of gmsh's ``Mesh.``, as ``MeshSizeMax``.
    """
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        for name, value in options.items():
            gmsh.option.setNumber(f"Mesh.{name}", value)
        gmsh.model.add("drawn")
        yield gmsh
        gmsh.write(str(path))
    finally:
        gmsh.finalize()

"""The content of a ``.msh`` file, read by gmsh as a mesh and as nothing else.

gmsh guesses a file's format from its name and first line, runs unknown formats as gmsh scripts,
which can start programs, and reads ``NAME.opt`` beside the file. So a file's first lines are
checked here, and a copy named ``mesh.msh`` in a private folder is read by a separate process, see
`fenics_joints.meshes.gmsh_apart`.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.files import is_file, shown_path
from fenics_joints.meshes.gmsh_apart import run_apart

#: Size of a file's head that is checked, bytes.
_HEAD = 65_536


@dataclass(frozen=True)
class MshGroup:
    """A physical group: its dimension, number, name (may be empty) and entities."""

    dim: int
    tag: int
    name: str
    entities: tuple[int, ...]


@dataclass(frozen=True)
class MshFile:
    """The content of a ``.msh`` file.

    Attributes:
        groups: The physical groups.
        blocks: Dimension, entity, gmsh's type of element, and the vertices, (n, n_vertices).
        kinds: Title and order of each type of element.
        tags: Numbers of the vertices, shape (n,).
        x: Coordinates of the vertices in the file's unit, shape (n, 3).
        points: Coordinates of the vertices of groups of points and lines, by the group's index.
    """

    groups: tuple[MshGroup, ...]
    blocks: tuple[tuple[int, int, int, np.ndarray], ...]
    kinds: dict[int, tuple[str, int]]
    tags: np.ndarray
    x: np.ndarray
    points: dict[int, np.ndarray]

    def elements(
        self, dim: int, entity: int | None = None
    ) -> Iterator[tuple[int, int, np.ndarray]]:
        """Entity, type and vertices of all blocks of a dimension."""
        for of, number, kind, nodes in self.blocks:
            if of == dim and entity in (None, number):
                yield number, kind, nodes


def read_msh_file(path: Path) -> MshFile:
    """Read a file on one rank.

    Raises:
        MeshError: The file is missing, does not begin as a ``.msh`` file does, or gmsh refuses it,
            crashes on it, or takes too long.
    """
    if not is_file(path):
        raise MeshError(f"{shown_path(path)}: no such file, expected a gmsh .msh file")
    with tempfile.TemporaryDirectory(prefix="fenics-joints-") as folder:
        copy = Path(folder) / "mesh.msh"
        try:
            shutil.copyfile(path, copy)
        except OSError as error:
            raise MeshError(f"{shown_path(path)}: cannot be read ({error.strerror})") from error
        with copy.open("rb") as file:
            _check_head(path, file.read(_HEAD))
        run_apart(path, Path(folder), "mesh.msh", copy.stat().st_size)
        return _loaded(path, Path(folder) / "mesh.npz")


def _check_head(path: Path, head: bytes) -> None:
    """Refuse a file that gmsh, by its first line, would not read as a mesh."""
    name, lines = shown_path(path), head.split(b"\n")
    first = lines[0].rstrip()
    if first not in (b"$MeshFormat", b"$Comments"):
        raise MeshError(f"{name}: not a gmsh .msh file, expected it to begin with $MeshFormat")
    at = next((i for i, line in enumerate(lines) if line.startswith(b"$MeshFormat")), None)
    line = b"" if at is None or at + 1 >= len(lines) else lines[at + 1].strip()
    if not re.fullmatch(rb"[1-4](\.\d+)?\s+[01]\s+[48]", line):
        raise MeshError(
            f"{name}: after $MeshFormat there is {line[:40]!r}, expected a version from 1 to 4.1, "
            "then 0 or 1, then 8"
        )


def _loaded(path: Path, file: Path) -> MshFile:
    with np.load(file, allow_pickle=False) as found:
        head = json.loads(found["head"].tobytes())
        groups = tuple(MshGroup(d, t, n, tuple(e)) for d, t, n, e in head["groups"])
        kinds = {int(k): v for k, v in head["kinds"].items()}
        blocks = tuple(
            (dim, entity, kind, found[f"block{i}"].astype(np.int64).reshape(-1, kinds[kind][2]))
            for i, (dim, entity, kind) in enumerate(head["blocks"])
        )
        points = {i: found[f"points{i}"].reshape(-1, 3) for i, g in enumerate(groups) if g.dim < 2}
        tags, x = found["tags"].astype(np.int64), found["x"].reshape(-1, 3)
    if not np.all(np.isfinite(x)):
        raise MeshError(f"{shown_path(path)}: a vertex is not finite, expected numbers")
    return MshFile(groups, blocks, {k: tuple(v[:2]) for k, v in kinds.items()}, tags, x, points)

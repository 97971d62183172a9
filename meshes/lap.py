"""Two beams of which one lies on the other: what is between them, and the names of that."""

from __future__ import annotations

from collections.abc import Sequence

from fenics_joints.meshes.separate import separate
from fenics_joints.meshes.skin import add_faces, facets_between
from fenics_joints.meshes.tagged import MeshLists

CELL_NAMES = {"beam_1": 1, "beam_2": 2, "joint": 3, "root": 4}


def lapped_groups(
    layer: float, bonded: bool, cells: Sequence[str], faces: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Names of the parts and of the faces of two beams.

    Args:
        layer: Thickness of the layer between them, in metres.
        bonded: Whether they share vertices.
        cells: Names of other parts than those of the beams and the layer.
        faces: Names of other faces than those between the beams.
    """
    cells = ["beam_1", "beam_2", *cells]
    if layer > 0:
        return [*cells, "joint"], [*faces, "joint_lower", "joint_upper"]
    if bonded:
        return cells, [*faces, "interface"]
    return cells, [*faces, "interface_lower", "interface_upper"]


def lapped(lists: MeshLists, layer: float, bonded: bool) -> MeshLists:
    """The mesh with faces between the beams, which are made separate bodies if they are to be.

    Args:
        lists: The mesh; beams that touch share vertices.
        layer: Thickness of the layer between the beams, in metres.
        bonded: Whether they go on to share vertices; those of a layer always do.
    """
    if layer > 0:
        faces = {
            "joint_lower": facets_between(lists, "joint", "beam_1"),
            "joint_upper": facets_between(lists, "joint", "beam_2"),
        }
        return add_faces(lists, faces)
    if bonded:
        return add_faces(lists, {"interface": facets_between(lists, "beam_1", "beam_2")})
    names = "interface_lower", "interface_upper"
    return separate(lists, [("root", "beam_1"), "joint", "beam_2"], {("beam_1", "beam_2"): names})

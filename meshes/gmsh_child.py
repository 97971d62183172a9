"""Reads a file with gmsh; a script that `fenics_joints.meshes.gmsh_apart` runs by its path.

It imports neither MPI nor `fenics_joints`. Arguments: Python's module path, as JSON; the limit of
memory, bytes; and the file. The content of ``mesh.msh`` is written to ``mesh.npz``; a STEP file is
only tested for being readable. If gmsh refuses the file, the reason is in ``error.txt``.
"""

import contextlib
import json
import sys


def main() -> None:
    """Read the file and write what is in it."""
    sys.path[:] = json.loads(sys.argv[1])
    import gmsh
    import numpy as np

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    with limited(int(sys.argv[2])):
        if sys.argv[3] in ("mesh.msh", "mesh.unv"):
            gmsh.merge(sys.argv[3])
            np.savez("mesh.npz", **_content(gmsh.model, np))
        else:
            _look_at(gmsh, sys.argv[3])


def _look_at(gmsh, path: str) -> None:
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    model = gmsh.model
    found = model.occ.importShapes(path, format="step")
    model.occ.synchronize()
    for dim, tag in found:
        model.occ.getMass(dim, tag)
        for _, face in model.getBoundary([(dim, tag)], oriented=False):
            model.occ.getMass(dim - 1, face)
            model.getBoundingBox(dim - 1, face)


@contextlib.contextmanager
def limited(most: int):
    """Work with this much memory, bytes, at most; why it fails goes to ``error.txt``."""
    _limit_memory(most)
    try:
        yield
    except Exception as error:
        text = "it takes too much memory" if isinstance(error, MemoryError) else str(error)
        with open("error.txt", "w", encoding="utf-8") as file:
            file.write(text or type(error).__name__)


def _limit_memory(most: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    with contextlib.suppress(ValueError, OSError):  # macOS has none
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _content(model, np) -> dict:
    groups = [
        [
            dim,
            tag,
            model.getPhysicalName(dim, tag),
            [int(e) for e in model.getEntitiesForPhysicalGroup(dim, tag)],
        ]
        for dim, tag in model.getPhysicalGroups()
    ]
    blocks, kinds, arrays = [], {}, {}
    for dim, entity in model.getEntities():
        for kind, _, nodes in zip(*model.mesh.getElements(dim, entity), strict=True):
            arrays[f"block{len(blocks)}"] = nodes
            blocks.append([dim, entity, int(kind)])
            title, _, order, corners, *_ = model.mesh.getElementProperties(kind)
            kinds[int(kind)] = [title, order, corners]
    points = {
        str(i): model.mesh.getNodesForPhysicalGroup(dim, tag)[1]
        for i, (dim, tag, _, _) in enumerate(groups)
        if dim < 2
    }
    arrays |= {f"points{i}": x for i, x in points.items()}
    tags, x, _ = model.mesh.getNodes()
    head = json.dumps({"groups": groups, "blocks": blocks, "kinds": kinds}).encode()
    return {"head": np.frombuffer(head, np.uint8), "tags": tags, "x": x, **arrays}


if __name__ == "__main__":
    main()

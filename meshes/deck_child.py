"""Reads a deck of another code; a script that `fenics_joints.meshes.gmsh_apart` runs by its path.

It imports neither MPI nor `fenics_joints`. Arguments: Python's module path, as JSON; the limit of
memory, bytes; and the file. Nodes, elements and their groups are written to ``mesh.npz``. If the
file cannot be read, the reason is in ``error.txt``.
"""

import json
import sys


def main() -> None:
    """Read the file and write what is in it."""
    sys.path[:] = json.loads(sys.argv[1])
    sys.path.insert(0, sys.argv[4])
    import numpy as np
    from gmsh_child import limited

    with limited(int(sys.argv[2])):
        read = by_ansys if sys.argv[3].endswith(".cdb") else by_meshlane
        head, arrays = read(sys.argv[3], np)
        np.savez("mesh.npz", head=np.frombuffer(json.dumps(head).encode(), np.uint8), **arrays)


#: Numbers of ANSYS' solid elements.
_NUMBERS = (
    "5 45 62 64 65 69 70 73 87 90 92 95 96 97 98 117 122 123 148 185 186 187 190 226 227 231 "
    "232 236 237 239 240 278 279 285"
)
_ANSYS = set(map(int, _NUMBERS.split()))


def by_ansys(path: str, np):
    """Nodes, solids by component and by material, and counts of the rest."""
    import mapdl_archive

    deck = mapdl_archive.Archive(path, parse_vtk=False)
    if deck.nnum is None or not len(deck.enum):
        raise ValueError("it has no nodes (NBLOCK) or no elements (EBLOCK)")
    kinds = {int(number): int(kind) for number, kind in deck.ekey}
    found, counts, of_number = {}, {}, {}
    for e, row in enumerate(deck.elem):
        # Without ET all elements are taken for solids.
        kind, nodes = kinds.get(int(row[1]), 0 if kinds else 185), [int(n) for n in row[10:]]
        if kind not in _ANSYS or len(nodes) < 4:
            name = f"elements of type {kind}"
            counts[name] = counts.get(name, 0) + 1
            continue
        shape = ("tetra", 10) if len(nodes) == 10 else ("tetra", 4) if len(nodes) == 4 else None
        shape = shape or ("hexahedron", 20 if len(nodes) >= 20 else 8)
        # A middle node that is not there: only corners count then.
        if len(nodes) < shape[1] or 0 in nodes[: shape[1]]:
            shape = shape[0], 4 if shape[0] == "tetra" else 8
        own = found.setdefault(shape, [])
        of_number[int(deck.enum[e])] = shape, len(own)
        own.append((int(row[0]), nodes[: shape[1]]))
    blocks, arrays, sets = [], {"x": deck.nodes, "tags": np.asarray(deck.nnum, np.int64)}, []
    for b, (shape, rows) in enumerate(found.items()):
        arrays[f"block{b}"] = np.array([nodes for _, nodes in rows], np.int64)
        arrays[f"material{b}"] = arrays[f"group{b}"] = np.array([m for m, _ in rows], np.int64)
        blocks.append(list(shape))
    places = list(found)
    for name, numbers in deck.element_components.items():
        by_block = {}
        for number in np.asarray(numbers).tolist():
            if number in of_number:
                shape, at = of_number[number]
                by_block.setdefault(places.index(shape), []).append(at)
        for b, at in by_block.items():
            arrays[f"set{len(sets)}"] = np.array(at, np.int64)
            sets.append([str(name), b])
    return {"blocks": blocks, "groups": {}, "counts": counts, "masses": [], "sets": sets}, arrays


def by_meshlane(path: str, np):
    """Nodes, cells by a number of theirs, and counts of what has no volume."""
    import meshlane

    mesh = meshlane.read(path)
    x = np.asarray(mesh.points, dtype=float)
    x = np.pad(x, [(0, 0), (0, 3 - x.shape[1])])
    blocks, arrays, counts = [], {"x": x, "tags": np.arange(len(x))}, {}
    key = next((k for k in mesh.cell_data if _tells(k) and _whole(mesh.cell_data[k], np)), None)
    for b, cells in enumerate(mesh.cells):
        kind = cells.type.rstrip("0123456789")
        if kind not in ("tetra", "hexahedron", "wedge", "pyramid"):
            counts[cells.type] = counts.get(cells.type, 0) + len(cells.data)
            continue
        group = np.zeros(len(cells.data), np.int64)
        if key is not None:
            group = np.asarray(mesh.cell_data[key][b]).astype(np.int64).ravel()
        arrays[f"block{len(blocks)}"] = np.asarray(cells.data, np.int64)
        arrays[f"group{len(blocks)}"] = group
        blocks.append([kind, cells.data.shape[1]])
    return {"blocks": blocks, "groups": {}, "counts": counts, "masses": []}, arrays


def _tells(key: str) -> bool:
    return any(
        word in key.lower() for word in ("physical", "material", "part", "region", "ref", "group")
    )


def _whole(arrays, np) -> bool:
    return all(np.all(np.mod(np.asarray(a, dtype=float), 1) == 0) for a in arrays)


if __name__ == "__main__":
    main()

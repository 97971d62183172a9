"""Reads a deck of another code; a script that `fenics_joints.meshes.gmsh_apart` runs by its path.

It imports neither MPI nor `fenics_joints`. Arguments: Python's module path, as JSON; the limit of
memory, bytes; and the file. Nodes, elements and their groups are written to ``mesh.npz``. If the
file cannot be read, the reason is in ``error.txt``.
"""

import json
import sys

#: Nastran's solids by card, with the numbers of nodes that they may have.
SOLIDS = {"CTETRA": ("tetra", (4, 10)), "CHEXA": ("hexahedron", (8, 20)), "CPENTA": ("wedge", (6, 15))}
SOLIDS["CPYRAM"] = ("pyramid", (5, 13))
#: What has no volume: it is counted, and left out.
OTHERS = (
    "CQUAD4 CQUAD8 CTRIA3 CTRIA6 CQUADR CTRIAR CBAR CBEAM CROD CBUSH CELAS1 CELAS2 RBE2 RBE3 RBAR "
    "CGAP CFAST CWELD MPC"
).split()


def main() -> None:
    """Read the file and write what is in it."""
    sys.path[:] = json.loads(sys.argv[1])
    sys.path.insert(0, sys.argv[4])
    import numpy as np
    from gmsh_child import limit_memory

    limit_memory(int(sys.argv[2]))
    try:
        suffix = sys.argv[3].rpartition(".")[2]
        read = {"bdf": by_nastran, "cdb": by_ansys}.get(suffix, by_meshlane)
        head, arrays = read(sys.argv[3], np)
        np.savez("mesh.npz", head=np.frombuffer(json.dumps(head).encode(), np.uint8), **arrays)
    except Exception as error:
        text = "it takes too much memory" if isinstance(error, MemoryError) else str(error)
        with open("error.txt", "w", encoding="utf-8") as file:
            file.write(text or type(error).__name__)


def by_nastran(path: str, np):
    """Nodes, solids by property, point masses, and counts of the rest."""
    from pyyeti.nastran import bulk

    def cards(name: str) -> list:
        return bulk.rdcards(path, name, return_var="list", no_data_return=[], follow_includes=False)

    grids = cards("GRID")
    if any(row[2] not in ("", 0) for row in grids if len(row) > 2):
        where = bulk.bulk2uset(path, follow_includes=False)[0]
        places = where.loc[(slice(None), 1), :].iloc[:, 1:4].to_numpy(float)
        tags = where.loc[(slice(None), 1), :].index.get_level_values(0).to_numpy()
    else:
        tags = np.array([row[0] for row in grids], dtype=np.int64)
        places = np.array([[float(c or 0.0) for c in (*row[2:5], 0.0, 0.0, 0.0)[:3]] for row in grids])
    blocks, arrays, counts = [], {"x": places, "tags": tags.astype(np.int64)}, {}
    for card, (kind, sizes) in SOLIDS.items():
        found = {}
        for row in cards(card):
            nodes = [int(n) for n in row[2:] if n not in ("", 0)]
            size = max((s for s in sizes if s <= len(nodes)), default=0)
            if not size:
                raise ValueError(f"{card} {row[0]}: has {len(nodes)} nodes")
            found.setdefault(size, []).append((int(row[1]), nodes[:size]))
        for size, rows in found.items():
            arrays[f"block{len(blocks)}"] = np.array([nodes for _, nodes in rows], np.int64)
            arrays[f"group{len(blocks)}"] = np.array([group for group, _ in rows], np.int64)
            blocks.append([kind, size])
    for card in OTHERS:
        if found := cards(card):
            counts[card] = len(found)
    materials = {int(r[0]): [_number(r, 1), _number(r, 3), _number(r, 4)] for r in cards("MAT1")}
    groups = {int(r[0]): [f"property_{int(r[0])}", materials.get(int(r[1]))] for r in cards("PSOLID")}
    where = {int(tag): x for tag, x in zip(arrays["tags"], arrays["x"].tolist(), strict=True)}
    masses = [[*where[int(r[1])], float(r[3])] for r in cards("CONM2") if int(r[1]) in where]
    return {"blocks": blocks, "groups": groups, "counts": counts, "masses": masses}, arrays


def _number(row, at: int):
    value = row[at] if len(row) > at else ""
    return None if value == "" else float(value)


#: Numbers of ANSYS' solid elements.
_ANSYS = {5, 45, 62, 64, 65, 69, 70, 73, 87, 90, 92, 95, 96, 97, 98, 117, 122, 123, 148, 185, 186, 187}
_ANSYS |= {190, 226, 227, 231, 232, 236, 237, 239, 240, 278, 279, 285}


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
    return any(word in key.lower() for word in ("physical", "material", "part", "region", "ref", "group"))


def _whole(arrays, np) -> bool:
    return all(np.all(np.mod(np.asarray(a, dtype=float), 1) == 0) for a in arrays)


if __name__ == "__main__":
    main()

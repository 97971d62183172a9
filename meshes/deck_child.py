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
        read = by_nastran if sys.argv[3].endswith(".bdf") else by_meshlane
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


def by_meshlane(path: str, np):
    """Nodes, cells by set or by a number of theirs, and counts of what has no volume."""
    import meshlane

    mesh = meshlane.read(path)
    x = np.asarray(mesh.points, dtype=float)
    x = np.pad(x, [(0, 0), (0, 3 - x.shape[1])])
    blocks, arrays, counts, numbers = [], {"x": x, "tags": np.arange(len(x))}, {}, {}
    named = [(name, sets) for name, sets in (mesh.cell_sets or {}).items()]
    key = next((k for k in mesh.cell_data if _tells(k) and _whole(mesh.cell_data[k], np)), None)
    sets = []
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
        for name, own in named:
            if own[b] is not None and len(own[b]):
                arrays[f"set{len(sets)}"] = np.asarray(own[b], np.int64)
                sets.append([name, len(blocks)])
        blocks.append([kind, cells.data.shape[1]])
    head = {"blocks": blocks, "groups": numbers, "counts": counts, "masses": [], "sets": sets}
    return head, arrays


def _tells(key: str) -> bool:
    return any(word in key.lower() for word in ("physical", "material", "part", "region", "ref", "group"))


def _whole(arrays, np) -> bool:
    return all(np.all(np.mod(np.asarray(a, dtype=float), 1) == 0) for a in arrays)


if __name__ == "__main__":
    main()

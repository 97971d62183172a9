"""Meshes of other codes: Nastran's, CalculiX's and Abaqus', ANSYS' decks, and VTU.

Those of ANSYS and VTU are read by mapdl-archive and meshlane, in a process of their own
(`fenics_joints.meshes.gmsh_apart`). Keywords and cards are read here: meshlane and meshio stop at
many of CalculiX' examples and at rigid elements of Nastran, and pyYeti brings Numba, with which
DOLFINx and h5py disagree. Here stands, too, which elements are a part, of what material, and what a
mesh for DOLFINx needs: one shape of cells, by their corners.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.files import check_size
from fenics_joints.meshes.gmsh_apart import run_apart

#: Suffixes of decks, with the package that reads each.
DECKS = {
    ".bdf": "",
    ".dat": "",
    ".nas": "",
    ".inp": "",
    ".cdb": "mapdl_archive",
    ".vtu": "meshlane",
}
#: Lines that would read another file.
_INCLUDE = re.compile(rb"^\s*(\*?INCLUDE\b|/INPUT\b)", re.IGNORECASE | re.MULTILINE)
#: Corners of each shape, its faces by corners, and gmsh's number of it.
_CORNERS = {"tetra": 4, "hexahedron": 8, "wedge": 6, "pyramid": 5}
_FACES = {
    "tetra": [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)],
    "pyramid": [(0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
    "wedge": [(0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)],
    "hexahedron": [
        (0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7),
    ],
}  # fmt: skip
_GMSH = {"tetra": (4, "Tetrahedron 4", 4), "hexahedron": (5, "Hexahedron 8", 8)}
#: Ends of the edges of which the nodes of second order are the middles, by shape and number of
#: nodes; of other orders than Abaqus' and Nastran's all are near some edge's middle.
_EDGES = {
    "tetra": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "hexahedron": [
        (0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4),
        (0, 4), (1, 5), (2, 6), (3, 7),
    ],
    "wedge": [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    "pyramid": [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)],
}  # fmt: skip
_CUT = "cells of several shapes are cut into tetrahedra"
#: Distance of a middle node from the middle of its edge, over the edge, from which an edge is
#: curved. [numerical: chosen]
_CURVED = 0.02


@dataclass
class Deck:
    """The solids of a deck.

    Attributes:
        x: Places of the nodes in the deck's unit of length, (n, 3).
        kind: ``"tetra"`` or ``"hexahedron"``.
        cells: Corners of each cell by the place among ``x``, (n_cells, n_corners).
        group: Number of each cell's part, (n_cells,).
        names: Name of each part, by its number.
        materials: E, nu and rho of parts in the deck's units, None where it does not say; by name.
        masses: Place and mass of each point mass, in the deck's units, (n, 4).
        notes: What was left out or changed.
    """

    x: np.ndarray
    kind: str
    cells: np.ndarray
    group: np.ndarray
    names: dict[int, str]
    materials: dict[str, tuple[float | None, float | None, float | None]] = field(
        default_factory=dict
    )
    masses: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    notes: tuple[str, ...] = ()

    def as_msh(self):
        """What `fenics_joints.meshes.msh.MshFile` is made of."""
        number, title, corners = _GMSH[self.kind]
        groups = [(3, n, name, [n]) for n, name in self.names.items()]
        blocks = tuple((3, n, number, self.cells[self.group == n]) for n in self.names)
        kinds = {number: (title, 1)}
        return groups, blocks, kinds, np.arange(len(self.x)), self.x, {}, self.notes


def read_deck(path: Path) -> Deck:
    """Read a deck on one rank.

    Raises:
        MeshError: If it has no solids, includes other files, or cannot be read; or the package that
            reads it is not installed.
    """
    package = DECKS[path.suffix.lower()]
    if package and find_spec(package) is None:
        raise MeshError(f"reading it needs {package}: pip install 'fenics-joints[decks]'")
    check_size(path)
    content = path.read_bytes()
    if _INCLUDE.search(content):
        raise MeshError("includes another file: expected one file that holds all")
    suffix, text = path.suffix.lower(), content.decode("latin-1")
    if not package:
        read = _by_keywords if suffix == ".inp" else _by_cards
        with bad_numbers():
            return _deck(*read(text), text, suffix)
    with tempfile.TemporaryDirectory(prefix="fenics-joints-") as folder:
        shutil.copyfile(path, Path(folder) / f"mesh{suffix}")
        run_apart(Path(folder), f"mesh{suffix}", len(content), "deck")
        with np.load(Path(folder) / "mesh.npz", allow_pickle=False) as found:
            head = json.loads(found["head"].tobytes())
            arrays = {key: found[key] for key in found.files if key != "head"}
    return _deck(head, arrays, text, suffix)


def _deck(head: dict, arrays: dict[str, np.ndarray], text: str, suffix: str) -> Deck:
    x, tags = arrays["x"].reshape(-1, 3), arrays["tags"].astype(np.int64)
    if not np.isfinite(x).all():
        raise MeshError("a node is not finite, expected numbers")
    order, notes, found = np.argsort(tags), [], []
    for b, (kind, _) in enumerate(head["blocks"]):
        nodes = arrays[f"block{b}"]
        at = np.searchsorted(tags, nodes, sorter=order)
        own = order[np.minimum(at, len(order) - 1)]
        if len(tags) == 0 or not np.array_equal(tags[own], nodes):
            raise MeshError("an element has a node that is not there")
        found.append((kind, own, arrays[f"group{b}"].astype(np.int64)))
    if not found:
        kinds = ", ".join(head["counts"]) or "none"
        raise MeshError(
            f"has no solids (its elements: {kinds}): expected tetrahedra, hexahedra, wedges or "
            "pyramids; of shells and beams export the matrices, see [mesh.matrices]"
        )
    groups, names, materials = _parts(head, arrays, found, text, suffix)
    curved = sum(_curved(x, kind, nodes) for kind, nodes, _ in found)
    if any(nodes.shape[1] > _CORNERS[kind] for kind, nodes, _ in found):
        notes.append(
            "cells are taken by their corners; the order of the displacement is mesh.degree"
            + (f"; {curved} of their edges are curved and become straight" if curved else "")
        )
    if head["counts"]:
        said = ", ".join(f"{count} {name}" for name, count in head["counts"].items())
        notes.append(f"left out, as they are no solids: {said}")
    solids = [(kind, nodes[:, : _CORNERS[kind]]) for kind, nodes, _ in found]
    kinds = {kind for kind, _ in solids}
    folded = any(_folded(nodes) for _, nodes in solids)
    if len(kinds) == 1 and kinds <= _GMSH.keys() and not folded:
        (kind,), cells, group = kinds, np.vstack([n for _, n in solids]), np.concatenate(groups)
    else:
        notes.append(_CUT)
        kind = "tetra"
        cut = [_tetrahedra(k, nodes, g) for (k, nodes), g in zip(solids, groups, strict=True)]
        cells, group = (np.concatenate(parts) for parts in zip(*cut, strict=True))
    cells, group = _upright(x, kind, cells, group, cut=notes[-1:] == [_CUT])
    masses = np.array(head["masses"], dtype=float).reshape(-1, 4)
    return Deck(x, kind, cells, group, names, materials, masses, tuple(notes))


def _folded(nodes: np.ndarray) -> bool:
    """Whether a cell has a node twice, as a tetrahedron in the place of a hexahedron."""
    ordered = np.sort(nodes, axis=1)
    return bool(np.any(ordered[:, 1:] == ordered[:, :-1]))


def _curved(x: np.ndarray, kind: str, nodes: np.ndarray) -> int:
    """Number of edges whose middle node is off their middle."""
    extra = nodes[:, _CORNERS[kind] :]
    if not extra.shape[1]:
        return 0
    ends = np.array(_EDGES[kind])
    one, other = x[nodes[:, ends[:, 0]]], x[nodes[:, ends[:, 1]]]
    middle, length = 0.5 * (one + other), np.linalg.norm(other - one, axis=2)
    off = np.linalg.norm(x[extra][:, :, None] - middle[:, None], axis=3).min(axis=2)
    return int(np.sum(off > _CURVED * length.max(axis=1)[:, None]))


def _tetrahedra(kind: str, nodes: np.ndarray, group: np.ndarray):
    """Cells as tetrahedra, (n, 4), and their groups.

    Each is a cone from its least node over the faces that do not have it, and a face of four nodes
    is cut from its least one: neighbours cut the face between them alike (Dompierre and others,
    Proc. 8th Int. Meshing Roundtable, 1999).
    """
    cells, groups = [], []
    for cell, own in zip(nodes.tolist(), group.tolist(), strict=True):
        least = min(cell)
        for face in _FACES[kind]:
            corners = list(dict.fromkeys(cell[i] for i in face))
            if least in corners or len(corners) < 3:
                continue
            first = corners.index(min(corners))
            turned = corners[first:] + corners[:first]
            for k in range(1, len(turned) - 1):
                cells.append((least, turned[0], turned[k], turned[k + 1]))
                groups.append(own)
    return np.array(cells, dtype=np.int64).reshape(-1, 4), np.array(groups, dtype=np.int64)


def _upright(x: np.ndarray, kind: str, cells: np.ndarray, group: np.ndarray, cut: bool):
    """Cells with a positive volume and their groups; flat pieces of cut cells are left out."""
    if kind != "tetra":
        return cells, group
    volume = np.linalg.det(x[cells[:, 1:]] - x[cells[:, :1]])
    keep = np.abs(volume) > 1e-9 * np.median(np.abs(volume))
    if not (keep.all() or cut):
        raise MeshError(f"{int((~keep).sum())} cells are flat, expected solids")
    cells = cells.copy()
    cells[volume < 0, :2] = cells[volume < 0, 1::-1]
    return cells[keep], group[keep]


def _parts(head, arrays, found, text: str, suffix: str):
    """Number of each cell's part by block, names of parts, and materials by name."""
    groups = [group for *_, group in found]
    known = {int(n): value for n, value in head["groups"].items()}
    materials: dict[str, tuple] = {}
    if known:  # Nastran: by property
        names = {
            n: known.get(n, [f"property_{n}", None])[0]
            for n in np.unique(np.concatenate(groups)).tolist()
        }
        for n, name in names.items():
            values = known.get(n, [name, None])[1]
            if values is not None:
                materials[name] = tuple(values)
        return groups, names, materials
    sections = _sections(text) if suffix == ".inp" else {}
    sets: dict[str, list[np.ndarray]] = {}
    for s, (name, block) in enumerate(head.get("sets", [])):
        own = sets.setdefault(name.upper(), [np.zeros(len(g), bool) for g in groups])
        own[block][arrays[f"set{s}"]] = True
    wanted = [name for name in (sections or sets) if name in sets]
    covered = [
        sum((sets[n][b] for n in wanted), np.zeros(len(g), int)) for b, g in enumerate(groups)
    ]
    if wanted and all(np.all(count == 1) for count in covered):
        groups = [
            sum((k + 1) * sets[n][b] for k, n in enumerate(wanted)) for b in range(len(groups))
        ]
        names = {k + 1: _section_name(name) for k, name in enumerate(wanted)}
        materials = {n: sections.get(w) for n, w in zip(names.values(), wanted, strict=True)}
    else:
        numbers = np.unique(np.concatenate(groups)).tolist()
        word = "material" if suffix == ".cdb" else "part"
        names = {n: f"{word}_{n}" if len(numbers) > 1 else "part" for n in numbers}
        one = [values for values in sections.values() if values is not None]
        materials = dict.fromkeys(names.values(), one[0] if len(one) == 1 else None)
    if suffix == ".cdb":
        known = _ansys(text)
        for n, name in names.items():
            own = {m for b, g in enumerate(groups) for m in arrays[f"material{b}"][g == n].tolist()}
            materials[name] = known.get(own.pop()) if len(own) == 1 else None
    return groups, names, {name: value for name, value in materials.items() if value is not None}


def _section_name(name: str) -> str:
    return re.sub(r"[^a-z0-9_-]+", "_", name.lower()).strip("_") or "part"


#: Keywords that make nodes or elements of others, or place them in another system.
_MADE = {"*NGEN", "*NFILL", "*NCOPY", "*NMAP", "*ELGEN", "*ELCOPY", "*SYSTEM"}
#: Members that a set may have.
_MOST = 10_000_000
#: Solids of CalculiX and Abaqus by their nodes.
_BY_NODES = {
    4: "tetra",
    10: "tetra",
    6: "wedge",
    15: "wedge",
    8: "hexahedron",
    20: "hexahedron",
    5: "pyramid",
}


def _by_keywords(text: str) -> tuple[dict, dict[str, np.ndarray]]:
    """Nodes, solids and sets of CalculiX' and Abaqus' input, as the child writes those of others.

    A part of Abaqus counts its nodes and elements by itself; an instance may move it.
    """
    points: dict[tuple[str, int], list[float]] = {}
    cells: dict[int, list[tuple[tuple[str, int], list[tuple[str, int]]]]] = {}
    sets: dict[str, set[tuple[str, int]]] = {}
    moved: dict[str, list[list[float]]] = {}
    part, counts = "", {}
    for keyword, options, rows in inp_lines(text):
        part = _part(part, keyword, options)
        name = options.get("ELSET")
        if keyword == "*INSTANCE":
            moved.setdefault(options.get("PART", ""), []).append(
                [float(v) for row in rows for v in row]
            )
        elif keyword == "*NODE":
            for row in (row for row in rows if len(row) > 1):
                x = [_floats([value])[0] or 0.0 for value in row[1:4]]
                points[part, int(row[0])] = x + [0.0] * (3 - len(x))
        elif keyword == "*ELEMENT":
            kind = options.get("TYPE", "")
            size = re.match(r"(?:DC3D|AC3D|C3D|F3D|SC)(\d+)", kind)
            values = [int(value) for row in rows for value in row]
            if size is None or int(size[1]) not in _BY_NODES:
                counts[kind] = counts.get(kind, 0) + len(rows)
                continue
            n = int(size[1])
            if len(values) % (n + 1):
                raise MeshError(f"*ELEMENT, TYPE={kind}: expected {n} nodes for each element")
            for k in range(0, len(values), n + 1):
                number, *nodes = values[k : k + n + 1]
                cells.setdefault(n, []).append(((part, number), [(part, i) for i in nodes]))
                if name:
                    sets.setdefault(part + name, set()).add((part, number))
        elif keyword == "*ELSET" and name:
            numbers, named = set_members(options, rows)
            own = sets.setdefault(part + name, set())
            own.update((part, i) for i in numbers)
            own.update(*(sets.get(part + other, ()) for other in named))
    numbers = [number for own in cells.values() for number, _ in own]
    if len(set(numbers)) < len(numbers):
        raise MeshError("an element's number is there twice: expected each once")
    for name, instances in moved.items():
        if len(instances) > 1 or len(instances[0]) > 3:
            raise MeshError(f"part {name} is there several times, or turned: expected each once")
        shift = instances[0] or [0.0] * 3
        for key in (key for key in points if key[0] == f"{name}/"):
            points[key] = [a + b for a, b in zip(points[key], shift, strict=True)]
    tag = {key: i for i, key in enumerate(points)}
    head = {"blocks": [], "groups": {}, "counts": counts, "masses": [], "sets": []}
    arrays = {"x": np.array(list(points.values())).reshape(-1, 3), "tags": np.arange(len(points))}
    for b, (n, own) in enumerate(cells.items()):
        if any(node not in tag for _, nodes in own for node in nodes):
            raise MeshError("an element has a node that is not there")
        arrays[f"block{b}"] = np.array([[tag[node] for node in nodes] for _, nodes in own])
        arrays[f"group{b}"] = np.zeros(len(own), np.int64)
        head["blocks"].append([_BY_NODES[n], n])
        at = {number: i for i, (number, _) in enumerate(own)}
        for name, numbers in sets.items():
            inside = sorted(at[number] for number in numbers if number in at)
            if inside:
                arrays[f"set{len(head['sets'])}"] = np.array(inside)
                head["sets"].append([name, b])
    return head, arrays


def _part(part: str, keyword: str, options: dict[str, str]) -> str:
    """Name of the part of Abaqus that a keyword is in, with a slash; of none an empty text."""
    if keyword == "*PART":
        return options.get("NAME", "") + "/"
    return "" if keyword in ("*END PART", "*ASSEMBLY") else part


def set_members(options: dict[str, str], rows: list[list[str]]) -> tuple[list[int], list[str]]:
    """Numbers in a set of CalculiX' and Abaqus' decks, and names of sets whose members are, too."""
    if "GENERATE" not in options:
        values = [value for row in rows for value in row]
        names = [value.upper() for value in values if not value.isdigit()]
        return [int(value) for value in values if value.isdigit()], names
    spans = [range(int(row[0]), int(row[1]) + 1, *map(int, row[2:3])) for row in rows]
    if sum(map(len, spans)) > _MOST:
        raise MeshError(f"a set has more than {_MOST:,} members")
    return [number for span in spans for number in span], []


def inp_lines(text: str):
    """Keyword, its options, and the lines of data below it, of CalculiX' and Abaqus' decks.

    Raises:
        MeshError: If nodes or elements are made by keywords, or nodes are in systems of their own.
    """
    keyword, options, rows = "", {}, []
    for line in (*text.splitlines(), "*END"):
        if line.startswith("**") or not line.strip():
            continue
        if not line.startswith("*"):
            rows.append([value.strip() for value in line.split(",") if value.strip()])
            continue
        if keyword in _MADE or (keyword == "*NODE" and options.get("SYSTEM", "R") != "R"):
            raise MeshError(
                f"has {keyword} {options.get('SYSTEM', '')}".rstrip()
                + ": expected each node and element by itself, in the basic coordinate system"
            )
        if keyword:
            yield keyword, options, rows
        keyword, *rest = (part.strip() for part in line.upper().split(","))
        options = dict(part.replace(" ", "").partition("=")[::2] for part in rest)
        rows = []


def _sections(text: str) -> dict[str, tuple | None]:
    """E, nu and rho of each element set with a solid section; None where the deck lacks them."""
    materials: dict[str, list] = {}
    sections: dict[str, str] = {}
    name = part = ""
    for keyword, options, rows in inp_lines(text):
        part = _part(part, keyword, options)
        if keyword == "*MATERIAL":
            name = options.get("NAME", "")
            materials[name] = [None, None, None]
        elif keyword == "*ELASTIC" and name and rows and len(rows[0]) > 1:
            materials[name][:2] = _floats(rows[0][:2])
        elif keyword == "*DENSITY" and name and rows:
            materials[name][2:] = _floats(rows[0][:1])
        elif keyword == "*SOLID SECTION" and "ELSET" in options:
            sections[part + options["ELSET"]] = options.get("MATERIAL", "")
    found = {name: materials.get(material) for name, material in sections.items()}
    return {name: None if v is None else tuple(v) for name, v in found.items()}


def _floats(values) -> list[float | None]:
    found = []
    for value in values:
        try:
            found.append(float(value.upper().replace("D", "E")))
        except ValueError:
            found.append(None)
    return found


@contextmanager
def bad_numbers():
    """What Python says of a word that is no number, as our error."""
    try:
        yield
    except MeshError:
        raise
    except (ValueError, IndexError, OverflowError) as error:
        raise MeshError(f"a line is not as expected: {error}") from error


#: Nastran's solids by card, with the numbers of nodes that they may have.
_CARDS = {
    "CTETRA": ("tetra", (4, 10)),
    "CHEXA": ("hexahedron", (8, 20)),
    "CPENTA": ("wedge", (6, 15)),
    "CPYRAM": ("pyramid", (5, 13)),
}


def cards(text: str) -> dict[str, list[list[str]]]:
    """Fields of the cards of a bulk data deck, in fields of 8, of 16 or between commas, by name."""
    found: dict[str, list[list[str]]] = {}
    row: list[str] = []
    _, begin, bulk = text.partition("BEGIN BULK") if "BEGIN BULK" in text else ("", "", text)
    for line in bulk.splitlines()[1 if begin else 0 :]:
        line = line.partition("$")[0].rstrip().expandtabs(8)
        if not line:
            continue
        if "," in line:
            fields = [field.strip() for field in line.split(",")]
            fields, name = fields[1:9], fields[0]
        else:
            wide, name = 16 if "*" in line[:8] else 8, line[:8].strip()
            fields = [line[i : i + wide].strip() for i in range(8, min(len(line), 72), wide)]
            fields += [""] * ((4 if wide == 16 else 8) - len(fields))
        if name and name[0] not in "+*":
            row = []
            found.setdefault(name.rstrip("*").upper(), []).append(row)
        row.extend(fields)
    return found


def _real(text: str) -> float | None:
    """A number of Nastran, such as 7.85-9; None where there is none."""
    if not text:
        return None
    return float(re.sub(r"(?<=[\d.])([+-]\d+)$", r"e\1", text.upper().replace("D", "E")))


def _by_cards(text: str) -> tuple[dict, dict[str, np.ndarray]]:
    """Nodes, solids by property and point masses of a bulk data deck, as the child writes those of
    others."""
    found = cards(text)
    grids = [
        (int(row[0]), row[1], [_real(c) or 0.0 for c in (*row[2:5], "", "", "")[:3]])
        for row in found.get("GRID", ())
    ]
    usual = {row[1] for row in found.get("GRDSET", ()) if row[1:]}
    systems = sorted((usual | {system for _, system, _ in grids}) - {"", "0"})
    if systems:
        raise MeshError(
            f"its nodes are in coordinate system {', '.join(systems)}: expected all in the "
            "basic one"
        )
    head = {"blocks": [], "groups": {}, "counts": {}, "masses": [], "sets": []}
    arrays = {
        "x": np.array([x for *_, x in grids]).reshape(-1, 3),
        "tags": np.array([number for number, *_ in grids], dtype=np.int64),
    }
    blocks: dict[tuple[str, int], list[tuple[int, list[int]]]] = {}
    for name, (kind, sizes) in _CARDS.items():
        for row in found.get(name, ()):
            nodes = [int(node) for node in row[2:] if node not in ("", "0")]
            size = max((s for s in sizes if s <= len(nodes)), default=0)
            if not size:
                raise MeshError(f"{name} {row[0]}: has {len(nodes)} nodes, expected {sizes[0]}")
            blocks.setdefault((kind, size), []).append((int(row[1]), nodes[:size]))
    for b, (shape, own) in enumerate(blocks.items()):
        arrays[f"block{b}"] = np.array([nodes for _, nodes in own], dtype=np.int64)
        arrays[f"group{b}"] = np.array([group for group, _ in own], dtype=np.int64)
        head["blocks"].append(list(shape))
    for name, rows in found.items():
        if _ELEMENT.fullmatch(name) or name.startswith("RB"):
            head["counts"][name] = len(rows)
    materials = {}
    for row in found.get("MAT1", ()):
        E, G, nu, rho = (_real(value) for value in (*row[1:5], "", "", "", "")[:4])
        materials[int(row[0])] = [E, E / (2 * G) - 1 if E and G and nu is None else nu, rho]
    solids = [row for row in found.get("PSOLID", ()) if len(row) > 1 and row[1]]
    properties = {int(row[0]): materials.get(int(row[1])) for row in solids}
    used = {group for own in blocks.values() for group, _ in own}
    head["groups"] = {group: [f"property_{group}", properties.get(group)] for group in used}
    places = dict(zip(arrays["tags"].tolist(), arrays["x"].tolist(), strict=True))
    for row in found.get("CONM2", ()):
        if int(row[1]) not in places or not (mass := _real(row[3])):
            continue
        off = np.array([_real(value) or 0.0 for value in (*row[4:7], "", "", "")[:3]])
        if off.any() and row[2] not in ("", "0", "-1"):
            raise MeshError(f"CONM2 {row[0]}: its offset is in coordinate system {row[2]}")
        place = off if row[2] == "-1" else places[int(row[1])] + off
        head["masses"].append([*place.tolist(), mass])
    return head, arrays


#: Nastran's elements that are no solids.
_ELEMENT = re.compile(
    r"C(QUAD|TRIA|BAR|BEAM|BEND|ROD|TUBE|BUSH|ELAS|GAP|FAST|WELD|SHEAR|DAMP|MASS|ONM1)\w*"
)


def _ansys(text: str) -> dict[int, tuple]:
    """E, nu and rho of the materials of a deck of ANSYS, by their numbers."""
    found: dict[int, dict[str, float | None]] = {}
    number = r"\s*([-+.\dEeDd]+)"
    for pattern in (
        r"^MPDATA,[^,]*,\s*\d+,\s*(\w+)\s*,\s*(\d+)\s*,\s*1\s*,",
        r"^MP,\s*(\w+)\s*,\s*(\d+)\s*,",
    ):
        for key, material, value in re.findall(pattern + number, text, re.MULTILINE):
            found.setdefault(int(material), {})[key.upper()] = _floats([value])[0]
    return {
        m: (values["EX"], values.get("NUXY", values.get("PRXY")), values.get("DENS"))
        for m, values in found.items()
        if "EX" in values
    }

"""The house: what may import what. Reads the sources; imports none of them."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = {
    "fenics_joints": "fenics_joints",
    "forms": "fenics_joints.forms",
    "meshes": "fenics_joints.meshes",
}

#: Rooms from the bottom to the top; those in one line do not know each other.
ORDER = (
    ("machine",),
    ("hall",),
    ("forms", "meshes"),
    ("structure",),
    ("modal",),
    ("joint_laws", "preload", "response"),
    ("measurements",),
    ("reduction",),
    ("beams", "matrices"),
    ("interfaces",),
    ("harmonic", "transient", "random_fields"),
    ("updating",),
    ("bayes", "database"),
    ("case",),
    ("diagnosis",),
    ("report",),
    ("commands",),
    ("cli",),
)
#: Folders in the diagnosis likewise; its own files stand on top.
IN_THE_DIAGNOSIS = ("thresholds", "zones", "effects", "evidence", "where", "model", "plan")
FLOOR = {room: floor for floor, rooms in enumerate(ORDER) for room in rooms}
HALL = {path.stem for path in (ROOT / "fenics_joints").glob("*.py")}

#: Folders that use the package as others do.
OUTSIDE = ("tests", "demos", "benchmarks")


def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for folder, package in SOURCES.items():
        for path in (ROOT / folder).rglob("*.py"):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join((package, *(p for p in parts if p != "__init__")))] = path
    return found


def imports(name: str, path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of the package that a file imports, wherever it does so."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name in known}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: expected no relative import"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                found |= {full if full in known else node.module} & known.keys()
    return found - {name}


def room(name: str) -> str:
    """The room of a module: its first folder; the command line is above all, others in the hall."""
    first = name.split(".")[1] if "." in name else "__init__"
    if first in ("cli", "__main__"):
        return "cli"
    return "hall" if first in HALL else first


KNOWN = modules()
GRAPH = {name: imports(name, path, KNOWN) for name, path in KNOWN.items()}


def test_the_hall_is_small_and_every_room_is_known():
    assert len(HALL) <= 10
    unknown = {room(name) for name in KNOWN} - FLOOR.keys()
    assert not unknown, f"rooms without a place in the order: {unknown}"


def test_imports_go_down_only():
    up = {
        (name, target)
        for name, targets in GRAPH.items()
        for target in targets
        if room(name) != room(target) and FLOOR[room(target)] >= FLOOR[room(name)]
    }
    assert up == set(), "imports against the order of the rooms"


def test_imports_in_the_diagnosis_go_down_only():
    def floor(name: str) -> int:
        folder = name.removeprefix("fenics_joints.diagnosis.").partition(".")[0]
        return (*IN_THE_DIAGNOSIS, folder).index(folder)

    own = {name: targets for name, targets in GRAPH.items() if room(name) == "diagnosis"}
    up = {
        (name, t)
        for name, targets in own.items()
        for t in targets & own.keys()
        if floor(t) > floor(name)
    }
    assert up == set()


def test_no_circle():
    """It raises a CycleError that names the modules."""
    TopologicalSorter(GRAPH).prepare()


def private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__") and name != "_"


def private_uses(path: Path) -> set[str]:
    """Underscored names that a file takes from elsewhere: imports, attributes, patches of them."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) not in ("self", "cls"):
            found.add(node.attr)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr"):
            found |= {a.value for a in node.args[1:2] if isinstance(a, ast.Constant)}
    return {name for name in found if isinstance(name, str) and private(name)}


def test_what_stands_outside_takes_no_private_names():
    # The generator of the blind check is sealed by its digest, names included.
    sealed = "benchmarks/blind", "tests/system/test_blind_world.py"
    files = [path for folder in OUTSIDE for path in (ROOT / folder).rglob("*.py")]
    uses = {path.relative_to(ROOT).as_posix(): private_uses(path) for path in files}
    assert {n: found for n, found in uses.items() if found and not n.startswith(sealed)} == {}


def test_tests_mirror_rooms_and_files():
    """A folder is a room's, crosses rooms or helps others; ``test_<name>[_<what>].py`` of a room
    tests its file, or its folder, of that name."""
    folders = {path.name for path in (ROOT / "tests").iterdir() if path.is_dir()}
    assert folders <= FLOOR.keys() | {"system", "helpers", "__pycache__"}
    stray = set()
    for path in (ROOT / "tests").glob("*/test_*.py"):
        folder = path.parent.name
        if folder == "system":
            continue
        source = ROOT / folder if folder in SOURCES else ROOT / "fenics_joints" / folder
        own = source.parent.glob("*.py") if folder == "hall" else source.rglob("[a-z]*")
        if not any(f"{path.stem}_".startswith(f"test_{o.stem}_") for o in own):
            stray.add(path.relative_to(ROOT).as_posix())
    assert stray == set()


def test_contributing_shows_the_rooms_in_their_order():
    """From top to bottom; and every file that it tells to copy from is there."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    shown = [set(re.findall(r"`(\w+)(?:/|\.py)`", row)) for row in rows[: len(ORDER) - 2]]
    assert shown == [set(rooms) for rooms in reversed(ORDER[2:])]
    places = ROOT, ROOT / "fenics_joints", ROOT / "fenics_joints" / "diagnosis"
    for name in re.findall(r"`([\w./]+/(?:\w+\.py)?)`", text):
        assert any((place / name).exists() for place in places), f"no {name}"

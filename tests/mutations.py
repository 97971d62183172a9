#!/usr/bin/env python3
"""Do the tests of a room catch a fault in it? 200 faults, drawn once by a seed, are tried in turn.

    python3 tests/mutations.py --draw         draw them into tests/mutations.json, from this tree
    python3 tests/mutations.py --run before   try the faults that column "before" of the table lacks
    python3 tests/mutations.py --run before --missed-by after    only those that "after" missed
    python3 tests/mutations.py                show how many are caught, by room

A fault changes one operator, comparison, number or argument of ``min`` and ``max`` in a function.
It is known by its room, its function and the expression, so that it is found again after code has
moved; one whose expression is gone is said to be so. A fault is caught if one of the room's own
tests that run its line fails or does not end. Runs in copies of the tree, and writes nothing but
the table.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
import shutil
import subprocess
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = Path(__file__).with_name("mutations.json")
SEED, COUNT, LEAST = 20261128, 200, 4
#: Tests that take longer than this many seconds have caught the fault.
LIMIT = 1800
_SWAPS = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.Lt: ">=",
    ast.Gt: "<=",
    ast.LtE: ">",
    ast.GtE: "<",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.And: "or",
    ast.Or: "and",
}
_SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.And: "and", ast.Or: "or"}
_COMPARED = {ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


def rooms(root: Path) -> dict[str, list[Path]]:
    """Files of each room; files of the package itself belong to the hall."""
    found = {name: sorted((root / name).rglob("*.py")) for name in ("forms", "meshes")}
    package = root / "fenics_joints"
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).parts
        found.setdefault(parts[0] if len(parts) > 1 else "hall", []).append(path)
    return {room: files for room, files in found.items() if (root / "tests" / room).is_dir()}


def faults(path: Path) -> list[dict]:
    """Every fault that can be made in a file's functions."""
    source = path.read_text(encoding="utf-8")
    found = list[dict]()

    def add(node, function, what, old, new):
        text = ast.unparse(node)
        same = sum(f["function"] == function and f["expression"] == text for f in found)
        place = {"line": node.lineno, "start": node.col_offset, "end_line": node.end_lineno}
        place["end"] = node.end_col_offset
        changed = {"function": function, "expression": text, "nth": same, "what": what}
        found.append({**changed, "old": old, "new": new, "place": place})

    def visit(node, function):
        if isinstance(node, ast.FunctionDef):
            function = f"{function}.{node.name}".lstrip(".")
            inside = node.body[1:] if ast.get_docstring(node) is not None else node.body
        elif isinstance(node, ast.ClassDef):
            function, inside = f"{function}.{node.name}".lstrip("."), node.body
        elif isinstance(node, (ast.Raise, ast.Assert)):
            return  # words of messages
        else:
            inside = list(ast.iter_child_nodes(node))
        if function:
            if isinstance(node, ast.BinOp) and type(node.op) in _SIGNS:
                add(node, function, "operator", _SIGNS[type(node.op)], _SWAPS[type(node.op)])
            elif isinstance(node, ast.BoolOp):
                add(node, function, "operator", _SIGNS[type(node.op)], _SWAPS[type(node.op)])
            elif isinstance(node, ast.Compare) and type(node.ops[0]) in _COMPARED:
                op = type(node.ops[0])
                add(node, function, "operator", _COMPARED[op], _SWAPS[op])
            elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
                add(node, function, "number", repr(node.value), repr(node.value + 1))
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("min", "max"):
                other = {"min": "max", "max": "min"}[node.func.id]
                add(node.func, function, "name", node.func.id, other)
        for child in inside:
            if not (isinstance(child, ast.expr) and child is getattr(node, "annotation", None)):
                visit(child, function)

    for node in ast.parse(source).body:
        visit(node, "")
    return found


def mutated(source: str, fault: dict) -> str:
    """The source with the fault in it; both sides of an operator stay as they are written."""
    tree = ast.parse(source)
    where = fault["place"]
    for node in ast.walk(tree):
        here = getattr(node, "lineno", None), getattr(node, "col_offset", None)
        there = getattr(node, "end_lineno", None), getattr(node, "end_col_offset", None)
        if here != (where["line"], where["start"]) or there != (where["end_line"], where["end"]):
            continue
        if fault["what"] == "number" and isinstance(node, ast.Constant):
            node.value = type(node.value)(node.value + 1)
        elif fault["what"] == "name" and isinstance(node, ast.Name):
            node.id = fault["new"]
        elif isinstance(node, (ast.BinOp, ast.BoolOp, ast.Compare)):
            code = f"a {fault['new']} b"
            new = ast.parse(code, mode="eval").body
            if isinstance(node, ast.Compare):
                node.ops[0] = new.ops[0]
            else:
                node.op = new.op
        else:
            continue
        return ast.unparse(tree)
    raise SystemExit(f"no {fault['expression']!r} at {where}")


def draw(root: Path) -> list[dict]:
    """The faults: at least `LEAST` of each room, the others by how many a room can have."""
    chosen = random.Random(SEED)
    pool = {}
    for room, files in rooms(root).items():
        pool[room] = [
            {"room": room, "file": str(path.relative_to(root)), **fault}
            for path in files
            for fault in faults(path)
        ]
        chosen.shuffle(pool[room])
    drawn = [fault for room in pool for fault in pool[room][:LEAST]]
    rest = [fault for room in pool for fault in pool[room][LEAST:]]
    return drawn + chosen.sample(rest, COUNT - len(drawn))


def found_again(root: Path, fault: dict) -> dict | None:
    """The same fault in another tree; None if its function or expression is gone."""
    files = rooms(root).get(fault["room"], [])
    for path in sorted(files, key=lambda path: str(path.relative_to(root)) != fault["file"]):
        for other in faults(path):
            if all(other[k] == fault[k] for k in ("function", "expression", "nth", "what", "new")):
                return {**fault, "file": str(path.relative_to(root)), "place": other["place"]}
    return None


def places(root: Path, table: list[dict]) -> dict[int, dict]:
    """Faults of the table by number, as they stand in a tree; without those that are gone."""
    found = {i: found_again(root, fault) for i, fault in enumerate(table)}
    return {i: fault for i, fault in found.items() if fault is not None}


def statement(source: str, line: int) -> tuple[int, int]:
    """First and last line of the innermost statement around a line; of one with a body its head."""
    best = 1, len(source.splitlines())
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, (ast.stmt, ast.ExceptHandler))
            and node.lineno <= line <= node.end_lineno
        ):
            inside = getattr(node, "body", None)
            last = inside[0].lineno - 1 if inside else node.end_lineno
            span = node.lineno, max(last, node.lineno)
            if line <= span[1] and span[1] - span[0] < best[1] - best[0]:
                best = span
    return best


class Copy:
    """A copy of the tree, in which tests run with one fault at a time.

    Args:
        root: The tree.
        folder: Of the copy.
    """

    def __init__(self, root: Path, folder: Path):
        self.folder = folder
        left = shutil.ignore_patterns(".git", "build", "cache", "__pycache__")
        shutil.copytree(root, folder, ignore=left, symlinks=True)
        shutil.copy(Path(__file__).parent / "helpers" / "fault_trace.py", folder)

    def pytest(self, *arguments: str, limit: float = LIMIT) -> int:
        """The exit status."""
        command = ["./with-fenicsx", "python3", "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        return subprocess.run(
            [*command, *arguments],
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=limit,
        ).returncode

    def trace(self, room: str, here: dict[int, dict]) -> dict[int, list[str]]:
        """Tests of a room, the fastest first, that run each fault's statement. Tests with processes
        of their own, which cannot be followed, run with every fault."""
        lines: dict[str, list] = {}
        for i, fault in here.items():
            source = (self.folder / fault["file"]).read_text(encoding="utf-8")
            span = statement(source, fault["place"]["line"])
            lines.setdefault(fault["file"], []).append([*span, i])
        (self.folder / "fault_lines.json").write_text(json.dumps(lines))
        self.pytest("-p", "fault_trace", f"tests/{room}", limit=3 * LIMIT)
        found = json.loads((self.folder / "fault_trace.json").read_text())
        seconds = found["seconds"]
        alone = {
            test
            for test in seconds
            if "subprocess" in (self.folder / test.split("::")[0]).read_text(encoding="utf-8")
        }
        return {
            i: sorted(
                (alone | set(found["ran"].get(str(i), ()))) & set(seconds), key=seconds.__getitem__
            )
            for i in here
        }

    def tried(self, fault: dict, tests: list[str]) -> str:
        """Result of tests with a fault: ``caught``, ``missed``, or ``broken`` if none ran."""
        if not tests:
            return "missed"
        path = self.folder / fault["file"]
        source = path.read_text(encoding="utf-8")
        path.write_text(mutated(source, fault), encoding="utf-8")
        try:
            status = self.pytest("-x", *tests)
        except subprocess.TimeoutExpired:
            return "caught"
        finally:
            path.write_text(source, encoding="utf-8")
        return {0: "missed", 1: "caught", 2: "caught"}.get(status, "broken")


def run(root: Path, faults: list[dict], results: dict[str, str], jobs: int, save, asked) -> None:
    """Try those of the asked faults that have no result yet, room by room."""
    here = places(root, faults)
    todo = [i for i in asked if str(i) not in results]
    results.update({str(i): "gone" for i in todo if i not in here})
    rooms_left = {faults[i]["room"]: None for i in todo if i in here}
    started, count = time.monotonic(), len(todo)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        free = [Copy(root, Path(folder) / f"tree{j}") for j in range(jobs)]

        def of_room(room: str) -> None:
            copy = free.pop()
            mine = {i: here[i] for i in todo if i in here and faults[i]["room"] == room}
            tests = copy.trace(room, mine)
            for i, fault in mine.items():
                results[str(i)] = copy.tried(fault, tests[i])
                save()
                done = sum(str(k) in results for k in todo)
                left = (time.monotonic() - started) * (count / done - 1) / 60
                said = f"{done} of {count}: {room}, {len(tests[i])} tests, {results[str(i)]}"
                print(f"{said}; about {left:.0f} min left", flush=True)
            free.append(copy)

        list(pool.map(of_room, rooms_left))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", action="store_true")
    parser.add_argument("--run", metavar="NAME", help="column of the table, as 'before'")
    parser.add_argument("--tree", type=Path, default=ROOT, help="checkout whose tests are tried")
    parser.add_argument("--missed-by", metavar="NAME", help="try only what that column missed")
    parser.add_argument("--jobs", type=int, default=1)
    asked = parser.parse_args()
    if asked.draw:
        if TABLE.exists():
            parser.error(f"{TABLE.name} is there: faults are drawn once")
        revision = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
        commit = subprocess.run(revision, capture_output=True, text=True, check=True).stdout.strip()
        table = {"seed": SEED, "parent_commit": commit, "faults": draw(ROOT), "results": {}}
        TABLE.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    if asked.run:
        results = table["results"].setdefault(asked.run, {})

        def save() -> None:
            TABLE.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")

        chosen = range(len(table["faults"]))
        if asked.missed_by:
            other = table["results"][asked.missed_by]
            chosen = [i for i in chosen if other.get(str(i)) in ("missed", "broken")]
        run(asked.tree.resolve(), table["faults"], results, asked.jobs, save, chosen)
        save()
    for name, results in table["results"].items():
        print(name, dict(Counter(results.values())))
        for room in sorted({fault["room"] for fault in table["faults"]}):
            of = [r for i, r in results.items() if table["faults"][int(i)]["room"] == room]
            print(f"  {room:16}", dict(Counter(of)))


if __name__ == "__main__":
    main()

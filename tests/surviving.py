#!/usr/bin/env python3
"""Tests that must survive a rewriting: ``tests/surviving.txt``, a line for each, with the reason.

    python3 tests/surviving.py            check that all are there; exit status 1 if one is missing
    python3 tests/surviving.py --write    add tests with the marks ``parallel`` and ``survives``

The script never removes a line. Whoever moves or joins tests edits the list by hand, so that a
reviewer sees it. Reads the sources; imports none of them.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_name("surviving.txt")


def tests() -> dict[str, set[str]]:
    """Ids of all tests, without parameters, and their marks."""
    found = {}
    for path in sorted([*ROOT.glob("tests/**/test_*.py"), *ROOT.glob("demos/test_*.py")]):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        of_file = {
            mark
            for line in tree.body
            if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "pytestmark"
            for mark in _marks(line.value)
        }
        name = path.relative_to(ROOT).as_posix()
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                marks = {mark for line in node.decorator_list for mark in _marks(line)}
                found[f"{name}::{node.name}"] = of_file | marks
            elif isinstance(node, ast.ClassDef) and node.name.startswith("Test"):
                for inner in node.body:
                    if isinstance(inner, ast.FunctionDef) and inner.name.startswith("test_"):
                        found[f"{name}::{node.name}::{inner.name}"] = of_file
    return found


def _marks(node: ast.AST) -> set[str]:
    return set(re.findall(r"pytest\.mark\.(\w+)", ast.unparse(node)))


def reasons() -> dict[str, str]:
    """Tests that must stay by their marks, with the reasons."""
    why = {"parallel": "two ranks", "survives": "marked so"}
    found = {name: [why[mark] for mark in why if mark in marks] for name, marks in tests().items()}
    return {name: ", ".join(own) for name, own in found.items() if own}


def listed() -> dict[str, str]:
    """Ids and reasons in the list."""
    if not LIST.exists():
        return {}
    lines = LIST.read_text(encoding="utf-8").splitlines()
    rows = [line.split("  # ") for line in lines if line and not line.startswith("#")]
    return {name: why for name, why in rows}


def gone() -> list[str]:
    """Tests of the list that are no longer there."""
    return sorted(set(listed()) - set(tests()))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="add marked tests")
    asked = parser.parse_args()
    if asked.write:
        rows = reasons() | listed()
        text = "# By tests/surviving.py --write. A line that goes is a test that was given up.\n"
        text += "".join(f"{name}  # {rows[name]}\n" for name in sorted(rows))
        LIST.write_text(text, encoding="utf-8")
    lost = gone()
    print("".join(f"gone: {name}\n" for name in lost), end="")
    print(f"{len(listed()) - len(lost)} of {len(listed())} tests that have to stay are there")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())

"""The page of numbers that results rest on, against the code."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import pytest

MADE = runpy.run_path(str(Path(__file__).parents[2] / "docs/site_pages/thresholds.py"))
ROOM = MADE["ROOT"] / "fenics_joints" / "diagnosis"
TREES = {
    path.relative_to(ROOM).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
    for path in ROOM.rglob("*.py")
}
#: Counts, places in a list, and more probable than not.
PLAIN = {-1, 0, 1, 2, 3, 0.5}
ROUND_OFF = 1e-5
CLAMPS = {"clip", "max", "maximum", "min", "minimum"}


@pytest.mark.survives
def test_the_page_is_as_the_code_and_each_number_has_a_kind_and_a_source():
    rows = list(MADE["rows"]("diagnosis"))
    assert [row for row in rows if row.kind not in MADE["KINDS"] or not row.source] == []
    assert sum(len(row.names) for row in rows if row.kind == "decision") <= 80
    others = [row for room in MADE["rooms"]() for row in MADE["rows"](room) if not row.words]
    assert others == []
    current = MADE["PAGE"].read_text(encoding="utf-8") == MADE["page"]()
    assert current, "python3 docs/site_pages/thresholds.py"


def written(node: ast.AST) -> set[float]:
    """Numbers in an expression, but for indices, powers and what other calls are given."""
    if isinstance(node, ast.Call | ast.Subscript | ast.Compare):
        return set()
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        return written(node.left)
    if isinstance(node, ast.Constant):
        return set(MADE["numbers"](node))
    return set().union(*map(written, ast.iter_child_nodes(node)))


@pytest.mark.parametrize("file", sorted(TREES))
def test_no_number_decides_without_a_name(file):
    """None is compared with or a bound, none an argument's default or a class attribute's."""
    found: set[float] = set()
    for node in ast.walk(TREES[file]):
        parts: list = []
        if isinstance(node, ast.Compare):
            parts = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in CLAMPS:
            parts = node.args
        elif isinstance(node, ast.arguments):
            parts = [*node.defaults, *node.kw_defaults]
        elif isinstance(node, ast.ClassDef):
            parts = [one.value for one in node.body if isinstance(one, ast.Assign | ast.AnnAssign)]
        found = found.union(*(written(part) for part in parts if part is not None))
    bare = {number for number in found - PLAIN if abs(number) > ROUND_OFF}
    assert bare == set()

"""Numbers that a diagnosis rests on: ``python3 docs/site_pages/thresholds.py`` writes their page.

The comment above a number says what it is and ends in ``[kind: source]``. Reads sources only.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
ROOM = ROOT / "fenics_joints" / "diagnosis"
PAGE = ROOT / "docs" / "thresholds.md"
KINDS = {
    "decision": "What decides an answer",
    "prior": "What is known of effects before a test",
    "numerical": "How it is computed",
}
TABLE = "| in | name | value | what it is | source |\n|---|---|---|---|---|"
HEAD = """# Numbers that a diagnosis rests on

Every number of `fenics_joints/diagnosis/` that somebody chose, what it is and where it comes from:
{counts}.

*Chosen* is no source: nobody measured whether another value is better. *Chosen for time* or memory
costs answers where it is too tight. Not here are round-off, numbers of formulas, the odds of one of
several places (one over their number), 0.5 where it means more probable than not, and what a case
file gives ([case files](case.md)). A prior is `Prior(name, median, spread, unit, log, span)`, or
these in brackets without the name; no parameter is looked for beyond `WIDEST` standard deviations.

Made by `python3 docs/site_pages/thresholds.py` from the comments in the code;
`tests/diagnosis/test_thresholds.py` says if it is out of date.
"""


class Row(NamedTuple):
    """Numbers that are assigned together."""

    file: str
    names: tuple[str, ...]
    value: str
    words: str
    kind: str
    source: str


def numbers(node: ast.AST) -> list[float]:
    """All that are written in a piece of code."""
    found = (n.value for n in ast.walk(node) if isinstance(n, ast.Constant))
    return [value for value in found if type(value) in (int, float)]


def rows() -> Iterator[Row]:
    """All of them, by file; kind and source are empty where the comment does not say them."""
    for path in sorted(ROOM.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines()
        for node in ast.parse(text).body:
            value = getattr(node, "value", None)
            if not isinstance(node, ast.Assign | ast.AnnAssign) or not value or not numbers(value):
                continue
            if ast.unparse(value).startswith("range("):
                continue  # names of kinds
            first = node.lineno - 1
            while lines[first - 1].startswith("#: "):
                first -= 1
            comment = " ".join(line[3:] for line in lines[first : node.lineno - 1])
            words, _, tag = comment.removesuffix("]").rpartition(" [")
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            names = [n.id for n in ast.walk(target) if isinstance(n, ast.Name)]
            kind, _, source = tag.partition(": ")
            file = path.relative_to(ROOM).as_posix()
            yield Row(file, tuple(names), ast.unparse(value), words, kind, source)


def page() -> str:
    """The page's text."""
    found, text, counts = list(rows()), "", []
    for kind, title in KINDS.items():
        own = [row for row in found if row.kind == kind]
        counts.append(f"{sum(len(row.names) for row in own)} for {title[0].lower()}{title[1:]}")
        text += f"\n## {title}\n\n{TABLE}\n"
        for row in own:
            names = ", ".join(f"`{name}`" for name in row.names)
            cells = row.file, names, f"`{row.value}`", row.words, row.source
            text += f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"
    return HEAD.format(counts=", ".join(counts)) + text


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

"""Numbers that results rest on: ``python3 docs/site_pages/thresholds.py`` writes their page.

The comment above a number says what it is and where it comes from; in the diagnosis it ends in
``[kind: source]``. Reads sources only.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "thresholds.md"
#: The room with the most of them, whose numbers have a kind and a source of their own.
DIAGNOSIS = "diagnosis"
KINDS = {
    "decision": "Decisions of a diagnosis",
    "prior": "Priors of a diagnosis",
    "numerical": "Numerics of a diagnosis",
}
HEAD = """# Numbers that results rest on

Every number in the code that somebody chose, by room: what it is and where it comes from. The
diagnosis comes first:
{counts}.

*Chosen* is no source: nobody measured whether another value is better. *Chosen for time* or memory
costs answers where it is too tight. Not here are round-off, numbers of formulas, tables of data,
the odds of one of several places (one over their number), 0.5 where it means more probable than
not, and what a case file gives ([case files](case.md)). A prior is `Prior(name, median, spread,
unit, log, span)`, or these in brackets without the name; no parameter is looked for beyond `WIDEST`
standard deviations.

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


def rooms() -> dict[str, list[Path]]:
    """Files of each room of the package, by its name."""
    package = ROOT / "fenics_joints"
    found = {"fenics_joints": sorted(package.glob("*.py"))}
    for folder in sorted({*package.iterdir(), ROOT / "forms", ROOT / "meshes"}):
        if folder.is_dir() and not folder.is_symlink():
            found[folder.name] = sorted(folder.rglob("*.py"))
    return {room: files for room, files in found.items() if files}


def rows(room: str) -> Iterator[Row]:
    """Those of a room, by file; kind and source are empty where the comment does not say them."""
    for path in rooms()[room]:
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines()
        for node in ast.parse(text).body:
            value = getattr(node, "value", None)
            if not isinstance(node, ast.Assign | ast.AnnAssign) or not _is_chosen(room, value):
                continue
            first = node.lineno - 1
            while lines[first - 1].startswith("#: "):
                first -= 1
            comment = " ".join(line[3:] for line in lines[first : node.lineno - 1])
            words, kind, source = comment, "", ""
            if room == DIAGNOSIS:
                words, _, tag = comment.removesuffix("]").rpartition(" [")
                kind, _, source = tag.partition(": ")
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            names = [n.id for n in ast.walk(target) if isinstance(n, ast.Name)]
            file = path.relative_to(ROOT).as_posix().removeprefix("fenics_joints/")
            file = file.removeprefix(f"{room}/")
            yield Row(file, tuple(names), ast.unparse(value), words, kind, source)


def _is_chosen(room: str, value: ast.AST | None) -> bool:
    """Whether a value has numbers that somebody chose, and is no table of data or of types."""
    if value is None or not numbers(value) or ast.unparse(value).startswith("range("):
        return False
    plain = ast.Constant, ast.UnaryOp, ast.BinOp, ast.Tuple
    return room == DIAGNOSIS or isinstance(value, plain)


def table(columns: str, found: list[tuple[str, ...]]) -> str:
    """A table of Markdown."""
    titles = columns.split(", ")
    lines = [titles, ["---"] * len(titles), *([c.replace("|", "\\|") for c in r] for r in found)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def page() -> str:
    """The page's text."""
    text, counts, found = "", [], list(rows(DIAGNOSIS))
    for kind, title in KINDS.items():
        own = [row for row in found if row.kind == kind]
        word = title.partition(" ")[0].lower()
        counts.append(f"{sum(len(row.names) for row in own)} for its {word}")
        cells = [(row.file, _names(row), f"`{row.value}`", row.words, row.source) for row in own]
        text += f"\n## {title}\n\n{table('in, name, value, what it is, source', cells)}"
    for room in rooms():
        cells = [(row.file, _names(row), f"`{row.value}`", row.words) for row in rows(room)]
        if cells and room != DIAGNOSIS:
            text += f"\n## {room}\n\n{table('in, name, value, what it is', cells)}"
    return HEAD.format(counts=", ".join(counts)) + text


def _names(row: Row) -> str:
    return ", ".join(f"`{name}`" for name in row.names)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

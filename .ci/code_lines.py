"""Code lines (no blanks, comments or docstrings) of each room as `ruff format` writes it.

Usage: `python3 .ci/code_lines.py [FOLDER]`; FOLDER is another checkout (this one if not given).
"""

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

_SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
_TOPS = ("fenics_joints", "forms", "meshes", "tests", "benchmarks", "demos", "docs", ".ci")


def code_lines(source: str) -> int:
    """Number of lines that hold code."""
    docstrings = set[int]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                if isinstance(first.value.value, str):
                    docstrings.update(range(first.lineno, first.end_lineno + 1))
    lines = set[int]()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _SILENT:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings)


def main(root: Path) -> None:
    """Print a table of the package's rooms and one of what stands beside it."""
    files, lines = Counter[str](), Counter[str]()
    for top in _TOPS:
        for path in sorted((root / top).rglob("*.py")):
            inside = path.relative_to(root).parts
            if "cache" in inside or "build" in inside:
                continue
            rooms = {top} if top != "fenics_joints" else {inside[1] if inside[2:] else "(files)"}
            package = top in ("fenics_joints", "forms", "meshes")
            for room in rooms | ({"the package"} if package else {"beside it"}):
                files[room] += 1
                lines[room] += code_lines(path.read_text(encoding="utf-8"))
    for room in sorted(lines, key=lines.__getitem__, reverse=True):
        print(f"{room:20} {files[room]:5} files {lines[room]:7} code lines")


if __name__ == "__main__":
    main(Path(sys.argv[1] if sys.argv[1:] else Path(__file__).parents[1]))

"""Keys of ``[nonlinear.NAME]``: ``./with-fenicsx python3 docs/site_pages/laws.py`` writes them.

It is made from the schema of the case file and stands in `docs/slip.md`;
`tests/system/test_documentation.py` says if it is out of date.
"""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "slip.md"
TABLE = re.compile(r"^\| law \| key .*?\n\n", re.DOTALL | re.MULTILINE)


def table() -> str:
    """In Markdown: keys that mean the same in several laws once, and what it is without the key."""
    from fenics_joints.case.schema import case_schema

    rows: dict[tuple[str, ...], list[str]] = {}
    for kind in case_schema()["$defs"].values():
        keys = dict(kind.get("properties", {}))
        law = keys.pop("law", {}).get("const")
        if law is None or "[nonlinear.NAME]" not in kind["description"]:
            continue
        for key, value in keys.items():
            words = re.sub(r"\.? \([^()]* text [^()]*\)$", "", value["description"]).rstrip(".")
            choices = (value, *value.get("anyOf", ()))
            unit = next((c["unit"] for c in choices if c.get("unit")), "")
            default = "needed" if key in kind.get("required", ()) else value.get("default")
            row = f"`{key}`", unit, "" if default is None else str(default), words
            rows.setdefault(row, []).append(f"`{law}`")
    lines = ["| law | key | unit | default | |", "|---|---|---|---|---|"]
    lines += [f"| {' | '.join((', '.join(laws), *row))} |" for row, laws in rows.items()]
    return "\n".join(lines) + "\n\n"


if __name__ == "__main__":
    PAGE.write_text(
        TABLE.sub(lambda _: table(), PAGE.read_text(encoding="utf-8")), encoding="utf-8"
    )

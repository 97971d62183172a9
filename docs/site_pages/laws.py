"""Keys of the laws of ``[nonlinear.NAME]``: ``python3 docs/site_pages/laws.py`` prints their table.

Made from the classes of the case file; `docs/slip.md` has it, and `tests/system/test_documentation.py`
says if it is out of date.
"""

from __future__ import annotations


def table() -> str:
    """The table in Markdown: law, key, unit, what it means."""
    from typing import get_args

    from fenics_joints.case import harmonic
    from fenics_joints.case.values import docstring_keys, named_by

    laws = [kind for kind in vars(harmonic).values() if _is_law(kind, harmonic)]
    lines = ["| law | key | unit | |", "|---|---|---|---|"]
    for word, kind in named_by("law", laws).items():
        keys = docstring_keys(kind)[1]
        for key, field in kind.model_fields.items():
            if key == "law":
                continue
            unit = _unit(field) or ("" if get_args(field.annotation) else "")
            words = keys[key].rstrip(".").replace("|", "or")
            need = "**required**" if field.is_required() else "optional"
            lines.append(f"| `{word}` | `{key}` | {unit} | {words}; {need} |")
    return "\n".join(lines)

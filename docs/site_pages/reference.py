"""The reference of the case file, from its schema: a page for each section."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

HEAD = """# The case file, key by key

Made from the schema that `fenics-joints schema` prints. A quantity is a number in the unit of its
row, or a text with another unit (`"8 mm"`). [From your files to a case](case.md) explains which
sections belong together, and the demos' `case.toml` have a comment on every number.

| section | |
|---|---|
"""


def write(source: Path) -> None:
    """Write `case-file.md`, and `case-file/NAME.md` for each section."""
    from fenics_joints.case.schema import case_schema

    folder = source / "case-file"
    folder.mkdir()
    schema = case_schema()
    sections = dict(schema["properties"])
    rows = f"| `title` | {sections.pop('title')['description']} |\n"
    for key, value in sections.items():
        words = value["description"].replace(", or None", "")
        rows += f"| [`[{key}]`](case-file/{key}.md) | {words} |\n"
        tables = _section(key, value, schema["$defs"], set())
        text = f"# `[{key}]`\n\n{words}\n" + tables.replace(f"\n## `[{key}]`\n", "")
        (folder / f"{key}.md").write_text(text, encoding="utf-8")
    listed = "\n".join(f"case-file/{key}" for key in sections)
    toc = f"\n```{{toctree}}\n:hidden:\n\n{listed}\n```\n"
    (source / "case-file.md").write_text(HEAD + rows + toc, encoding="utf-8")


def _section(path: str, schema: dict, kinds: dict, seen: set[str]) -> str:
    """Tables of all keys below a path, each kind of table once."""
    text = ""
    for name, deeper in _tables(path, schema, kinds):
        if name in seen:
            continue
        seen.add(name)
        text += _table(deeper, kinds[name])
        for key, value in kinds[name].get("properties", {}).items():
            text += _section(f"{deeper}.{key}", value, kinds, seen)
    return text


def _tables(path: str, schema: dict, kinds: dict) -> list[tuple[str, str]]:
    """Kinds of tables that may stand at a path, with the path they stand at."""
    if "$ref" in schema:
        return [(schema["$ref"].rsplit("/", 1)[1], path)]
    found = []
    for choice in schema.get("anyOf", []) + schema.get("oneOf", []) + schema.get("allOf", []):
        found += _tables(path, choice, kinds)
    if isinstance(schema.get("additionalProperties"), dict):
        found += _tables(f"{path}.NAME", schema["additionalProperties"], kinds)
    if isinstance(schema.get("items"), dict):
        found += _tables(path, schema["items"], kinds)
    return found


def _table(path: str, kind: dict) -> str:
    properties = kind.get("properties", {})
    which = [f'{key} = "{value["const"]}"' for key, value in properties.items() if "const" in value]
    words = re.sub(r"``([^`]+)``", r"`\1`", kind.get("description", ""))
    defaults = _of_a_builder(properties)
    title = f"`[{path}]`" + (f" with `{', '.join(which)}`" if which else "")
    rows = "".join(
        f"| `{key}` | {_kind(value)} | {defaults.get(key) or _default(key, value, kind)} | "
        + f"{_meaning(value)} |\n"
        for key, value in properties.items()
        if "const" not in value
    )
    table = f"| key | type or unit | default | |\n|---|---|---|---|\n{rows}\n" if rows else ""
    return f"\n## {title}\n\n{words}\n\n{table}"


def _of_a_builder(properties: dict) -> dict[str, str]:
    """The defaults of a mesh builder's arguments; none for other tables."""
    from fenics_joints.case.mesh import BUILDERS

    builder = getattr(BUILDERS.get(properties.get("builder", {}).get("const")), "made_by", None)
    return {
        field.name: f"`{json.dumps(field.default)}`"
        for field in (() if builder is None else dataclasses.fields(builder))
        if field.default not in (dataclasses.MISSING, None)
    }


def _meaning(schema: dict) -> str:
    """What a key means, without its unit, which stands beside it."""
    words = schema.get("description", "")
    words = words.rpartition("(")[0] if "unit" in schema else words
    return words.strip().replace("|", "\\|")


def _kind(schema: dict) -> str:
    """A type in words."""
    if "$ref" in schema:
        return "table"
    if "enum" in schema:
        return ", ".join(f"`{value!r}`".replace("'", '"') for value in schema["enum"])
    if "anyOf" in schema or "oneOf" in schema:
        kinds = [_kind(one) for one in schema.get("anyOf", schema.get("oneOf"))]
        return " or ".join(dict.fromkeys(kind for kind in kinds if kind != "nothing"))
    if "unit" in schema:
        words = schema["description"].rpartition("(")[2].rstrip(")")
        return words.removeprefix("in ").replace(", or a text with its unit", "")
    names = {
        "string": "text",
        "number": "number",
        "integer": "whole number",
        "null": "nothing",
        "boolean": "`true` or `false`",
        "object": "table",
    }
    kind = schema.get("type", "")
    if kind == "array":
        if "prefixItems" in schema:
            return "[" + ", ".join(_kind(one) for one in schema["prefixItems"]) + "]"
        return f"list of {_kind(schema.get('items', {}))}"
    if isinstance(kind, list):
        return " or ".join(names[one] for one in kind)
    return names.get(kind, "any value")


def _default(key: str, schema: dict, kind: dict) -> str:
    if key in kind.get("required", ()):
        return "**must be given**"
    value = schema.get("default")
    if value is None or value == {} or value == []:
        return ""
    if isinstance(value, dict):
        return "see there"
    return f"`{json.dumps(value)}`"

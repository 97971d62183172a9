"""The JSON schema: good files fit it, bad ones do not."""

from __future__ import annotations

import copy
import sys
from pathlib import Path

import pytest

from fenics_joints.case.schema import case_schema

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
FILES = [*sorted((ROOT / "demos").rglob("*.toml")), ROOT / "tests" / "lap_case.toml"]
KINDS = {
    "string": str,
    "number": (int, float),
    "integer": int,
    "boolean": bool,
    "array": list,
    "object": dict,
    "null": type(None),
}


def fits(value, schema, root) -> bool:
    """Whether a value fits a schema, by the words of JSON schema that ours uses."""
    if isinstance(schema, bool):
        return schema
    if "$ref" in schema and not fits(value, root["$defs"][schema["$ref"].split("/")[-1]], root):
        return False
    for word in ("anyOf", "oneOf"):
        if word in schema and not any(fits(value, option, root) for option in schema[word]):
            return False
    kinds = schema.get("type", list(KINDS))
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if not any(isinstance(value, KINDS[kind]) for kind in kinds):
        return False
    if value not in schema.get("enum", [value]) or value != schema.get("const", value):
        return False
    if isinstance(value, dict):
        known = schema.get("properties", {})
        other = schema.get("additionalProperties", {})
        inside = [(item, known.get(key, other)) for key, item in value.items()]
        if not set(schema.get("required", [])) <= value.keys():
            return False
    else:
        items = value if isinstance(value, list) else ()
        inside = [(item, schema.get("items", {})) for item in items]
    return all(fits(item, inner, root) for item, inner in inside)


@pytest.mark.parametrize("file", FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_our_own_cases_fit(file):
    schema = case_schema()
    assert fits(tomllib.loads(file.read_text(encoding="utf-8")), schema, schema)


def test_mistakes_do_not():
    """Unknown keys, a number where a name must be, a word that is none of the known ones."""
    schema = case_schema()
    good = tomllib.loads(FILES[-1].read_text(encoding="utf-8"))
    for table, key, value in (
        ("plates", "young", "69 GPa"),
        ("plates", "cells", 3),
        ("plates", "E", ["69 GPa"]),
    ):
        bad = copy.deepcopy(good)
        bad["parts"][table][key] = value
        assert not fits(bad, schema, schema)
    bad = copy.deepcopy(good)
    bad["joints"]["near"]["law"] = "glue"
    assert not fits(bad, schema, schema)

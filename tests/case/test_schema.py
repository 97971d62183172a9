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

jsonschema = pytest.importorskip("jsonschema")

ROOT = Path(__file__).resolve().parents[2]
FILES = [*sorted((ROOT / "demos").rglob("*.toml")), ROOT / "tests" / "lap_case.toml"]


@pytest.fixture(scope="module")
def fits():
    schema = case_schema()
    kind = jsonschema.validators.validator_for(schema)
    kind.check_schema(schema)
    return kind(schema).is_valid


def test_our_own_cases_fit_and_mistakes_do_not(fits):
    """Unknown keys, a number where a name must be, a word that is none of the known ones."""
    for file in FILES:
        good = tomllib.loads(file.read_text(encoding="utf-8"))
        assert fits(good), file
    for section, name, key, value in (
        ("parts", "plates", "young", "69 GPa"),
        ("parts", "plates", "cells", 3),
        ("parts", "plates", "E", ["69 GPa"]),
        ("joints", "near", "law", "glue"),
    ):
        bad = copy.deepcopy(good)
        bad[section][name][key] = value
        assert not fits(bad), key

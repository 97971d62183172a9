"""The JSON schema of a case file, for editors."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from fenics_joints.case.case import Case
from fenics_joints.case.messages import kinds_at
from fenics_joints.case.values import docstring_keys, in_files, listed


def case_schema() -> dict[str, object]:
    """The schema of what people write: quantities as numbers in SI units, or texts with a unit."""
    schema = Case.model_json_schema(mode="validation", schema_generator=_AsWritten)
    head = {"$schema": GenerateJsonSchema.schema_dialect, **schema}
    return {**head, "title": "A case of fenics-joints"}


def meaning(path: tuple[str, ...], beside: Iterable[str] = ()) -> str:
    """What a key of the case file means, in a few words; empty where nothing says it.

    Args:
        path: The key with the tables that it is in.
        beside: Keys of the same table, which tell of which kind it is.
    """
    for kind in kinds_at(path[:-1], Case):
        keys = docstring_keys(kind)[1] if hasattr(kind, "model_fields") else {}
        if path[-1] in keys and set(beside) <= {*keys, "builder"}:
            return re.split(r"[.;:] ", keys[path[-1]].rstrip("."))[0]
    return ""


class _AsWritten(GenerateJsonSchema):
    """Values as they may stand in the file, before they are made what a `Case` has."""

    def model_schema(self, schema: Any) -> dict[str, Any]:
        """A section, with what its docstring says of each key."""
        found, (words, keys) = super().model_schema(schema), docstring_keys(schema["cls"])
        for key, value in found.get("properties", {}).items():
            own = [keys.get(key, ""), f"({value['description']})" if "unit" in value else ""]
            value["description"] = " ".join(text for text in own if text)
        return found | {"description": words}

    def function_before_schema(self, schema: Any) -> dict[str, Any]:
        """What a value may be that is converted first."""
        inner = super().function_before_schema(schema)
        call = schema["function"]["function"]
        unit = getattr(call, "unit", None)
        if unit is not None:
            words = f"in {unit}, or a text with its unit" if unit else "a number, or a text in %"
            if call.word is not None:
                words += f', or "{call.word}"'
            return {"type": ["number", "string"], "description": words, "unit": unit}
        if call is listed:
            return {"anyOf": [inner.get("items", {}), inner]}
        if call is in_files:
            text = {"type": "string"}
            return {"anyOf": [text, {"type": "array", "items": text}, inner]}
        return inner

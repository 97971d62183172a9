"""The JSON schema of a case file, for editors."""

from __future__ import annotations

from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from fenics_joints.case.case import Case
from fenics_joints.case.values import in_files, listed


def case_schema() -> dict[str, object]:
    """The schema of what people write: quantities as numbers in SI units, or texts with a unit."""
    schema = Case.model_json_schema(mode="validation", schema_generator=_AsWritten)
    head = {"$schema": GenerateJsonSchema.schema_dialect, **schema}
    return {**head, "title": "A case of fenics-joints"}


class _AsWritten(GenerateJsonSchema):
    """Values as they may stand in the file, before they are made what a `Case` has."""

    def function_before_schema(self, schema: Any) -> dict[str, Any]:
        """What a value may be that is converted first."""
        inner = super().function_before_schema(schema)
        call = schema["function"]["function"]
        unit = getattr(call, "unit", None)
        if unit is not None:
            words = f"in {unit}, or a text with its unit" if unit else "a number, or a text in %"
            if call.word is not None:
                words += f', or "{call.word}"'
            return {"type": ["number", "string"], "description": words}
        if call is listed:
            return {"anyOf": [inner.get("items", {}), inner]}
        if call is in_files:
            text = {"type": "string"}
            return {"anyOf": [text, {"type": "array", "items": text}, inner]}
        return inner

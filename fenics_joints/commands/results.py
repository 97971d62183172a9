"""Keys of the JSON files, each with its type and meaning, from ``results.toml``."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from fenics_joints.errors import InputError
from fenics_joints.files import read_toml

#: Of the keys: one more whenever a key goes or changes its meaning.
VERSION = 1
_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_TYPES = {"text": "string"}


@cache
def result_keys() -> dict[str, dict[str, str]]:
    """Type and meaning of every key by the command; ``common`` holds those of all."""
    return read_toml(Path(__file__).with_name("results.toml"), "keys of the results")


def result_schema(command: str) -> dict[str, object]:
    """The JSON schema of a command's results.

    Args:
        command: ``check``, ``modes``, ``preload``, ``update``, ``bayes`` (of ``update --bayes``),
            ``harmonic``, ``diagnose`` or ``plan`` (of ``diagnose --plan``).

    Raises:
        InputError: If there is no such command.
    """
    keys = result_keys()
    if command == "common" or command not in keys:
        names = ", ".join(name for name in keys if name != "common")
        raise InputError(f"{command!r} has no schema of results; expected one of: {names}")
    schema: dict = {"type": "object", "properties": {}, "required": []}
    for key, said in {**keys["common"], **keys[command]}.items():
        kind, _, meaning = said.partition(": ")
        _put(schema, key.split("."), kind, meaning)
    title = f"Results of fenics-joints {command}, version {VERSION}"
    return {"$schema": _DIALECT, "title": title, **schema}


def _put(schema: dict, path: list[str], kind: str, meaning: str) -> None:
    """Add a key to the schema of an object, and the objects and lists that it is in."""
    name, several = path[0].removesuffix("[]"), path[0].endswith("[]")
    optional, name = name.endswith("?"), name.removesuffix("?")
    made = schema["properties"].setdefault(name, {})
    if not optional and name not in schema["required"]:
        schema["required"].append(name)
    if several and len(path) > 1:
        made.setdefault("type", "array")
        made = made.setdefault("items", {})
    if len(path) == 1:
        made.update(_type("[object]" if several else kind), description=meaning)
        return
    made.setdefault("type", "object")
    for part, empty in (("properties", {}), ("required", [])):
        made.setdefault(part, empty)
    _put(made, path[1:], kind, meaning)


def _type(kind: str) -> dict[str, object]:
    """JSON schema of a type such as ``[number?]``."""
    if "|" in kind:
        return {"enum": kind.split("|")}
    if kind.endswith("?"):
        made = _type(kind[:-1])
        return {"type": [made["type"], "null"], **{k: v for k, v in made.items() if k != "type"}}
    if kind.startswith("["):
        return {"type": "array", "items": _type(kind[1:-1])}
    if kind.startswith("{"):
        return {"type": "object", "additionalProperties": _type(kind[1:-1])}
    name, *limits = kind.split()
    made = {} if name == "any" else {"type": _TYPES.get(name, name)}
    return {**made, **dict(zip(("minimum", "maximum"), map(float, limits), strict=False))}

"""What is wrong with a case file, in words: pydantic's errors and our own, in one form."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

from fenics_joints.errors import InputError, shown


def case_error(path: Path, errors: list[str]) -> InputError:
    """One exception for all errors of a file."""
    if len(errors) == 1:
        return InputError(f"{path}: {errors[0]}")
    return InputError("\n  ".join([f"{path}: {len(errors)} errors:", *errors]))


def message(key: str, value: Any, expected: str) -> str:
    """A line of the form ``key = value: expected ...``."""
    return f"{key} = {shown(value)}: {expected}"


def describe(error: dict[str, Any], root: type) -> str:
    """One line for one of pydantic's errors."""
    loc = error["loc"]
    key = _dotted(loc)
    kind, value, ctx = error["type"], error["input"], error.get("ctx", {})
    if kind == "missing":
        return f"{key} is missing: expected it in {_place(loc)}"
    if kind == "extra_forbidden":
        return message(
            key, value, f"unknown key{did_you_mean(str(loc[-1]), _fields(loc[:-1], root))}"
        )
    if kind == "no_kind":
        return _no_kind(key, value, ctx["key"], ctx["known"].split(), ctx.get("instead", ""))
    if kind == "value_error":
        text = str(ctx["error"])
        # Of a section as a whole the message itself names the values.
        return f"{key}: {text}" if isinstance(value, dict) else message(key, value, text)
    if kind == "literal_error":
        hint = difflib.get_close_matches(str(value), ctx["expected"].replace("'", "").split(), 1)
        mean = f"; did you mean {hint[0].rstrip(',')!r}?" if hint else ""
        return message(key, value, f"expected {ctx['expected']}{mean}")
    return message(key, value, f"expected {_plain(error['msg'])}")


def _no_kind(name: str, value: Any, key: str, known: list[str], instead: str) -> str:
    """A section whose key that says what it is, is missing or unknown.

    Args:
        name: The section's.
        value: What stands in the file.
        key: Which says what it is.
        known: What it can be.
        instead: Key and value that may stand in its place; empty for none.
    """
    given = value.get(key) if isinstance(value, dict) else None
    names = ", ".join(repr(k) for k in known[:-1]) + f" or {known[-1]!r}"
    if given is not None and not (instead and instead.partition(" ")[0] in value):
        near = difflib.get_close_matches(str(given), known, 1)
        mean = f"; did you mean {near[0]!r}?" if near else ""
        return message(f"{name}.{key}", given, f"expected {names}{mean}")
    expected = f"{key} = {names}"
    return message(
        name,
        value,
        f"expected either {expected}, or {instead}" if instead else f"expected {expected}",
    )


def _plain(message: str) -> str:
    for start in ("Input should be ", "Input should have ", "Value should have "):
        message = message.removeprefix(start)
    return message.removeprefix("a valid ").replace("a valid ", "")


def _dotted(loc: tuple) -> str:
    key = ""
    for item in loc:
        if isinstance(item, int):
            key += f"[{item}]"
        elif not item.startswith("<") and item != "[key]":
            key += f".{item}" if key else item
    return key or "the file"


def _place(loc: tuple) -> str:
    section = _dotted(loc[:-1])
    return f"[{section}]" if len(loc) > 1 else "the file"


def did_you_mean(name: str, known: list[str]) -> str:
    """The end of a message about an unknown name: what is near it, and all there is."""
    near = difflib.get_close_matches(name, known, 1, 0.5)
    hint = f"; did you mean {near[0]!r}? Expected" if near else "; expected"
    return f"{hint} one of: {', '.join(known)}" if known else ""


def unknown(given: Iterable[tuple[str, str]], known: Iterable[str], what: str) -> list[str]:
    """A line for each key whose name is not known: what is wrong with it, and what may be meant."""
    known = list(known)
    return [
        message(key, name, f"{what}{did_you_mean(name, known)}")
        for key, name in given
        if name not in known
    ]


def indexed(key: str, names: Iterable[str] | None) -> list[tuple[str, str]]:
    """Keys of the items of a list, with these."""
    return [(f"{key}[{i}]", name) for i, name in enumerate(names or ())]


def refused(key: str, value: Any, call: Callable[[], object]) -> list[str]:
    """A line with the input error that a call raises, if it does."""
    try:
        call()
    except InputError as error:
        return [message(key, value, str(error))]
    return []


def kinds_at(loc: tuple, root: type) -> list[Any]:
    """Types that what stands at a place in the file may have."""
    kinds = [root]
    for item in loc:
        kinds = [option for kind in kinds for option in _inside(kind, item)]
    return kinds


def _fields(loc: tuple, root: type) -> list[str]:
    """Keys of the section at a place in the file."""
    found = []
    for kind in kinds_at(loc, root):
        fields = kind.model_fields.items() if hasattr(kind, "model_fields") else ()
        found += [field.alias or name for name, field in fields]
    return found


def _inside(kind: Any, item: str | int) -> list[Any]:
    """What types the value under ``item`` of a value of type ``kind`` may have."""
    if isinstance(item, str) and item.startswith("<"):
        return [kind] if getattr(kind, "__name__", "") == item[1:-1] else []
    if hasattr(kind, "model_fields"):
        field = kind.model_fields.get(item)
        return _options(field.annotation) if field else []
    if typing.get_origin(kind) in (dict, list, tuple):
        return _options(typing.get_args(kind)[-1])
    return []


def _options(kind: Any) -> list[Any]:
    """A type without its annotations, or the members of a union."""
    origin = typing.get_origin(kind)
    if origin is Annotated:
        return _options(typing.get_args(kind)[0])
    if origin in (typing.Union, types.UnionType):
        return [option for member in typing.get_args(kind) for option in _options(member)]
    return [kind]

"""Types of the values of a case file: numbers with units, points, lists, tables with names."""

from __future__ import annotations

import difflib
import inspect
import math
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Union, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    WithJsonSchema,
    create_model,
    model_validator,
)

from fenics_joints.case.own_code import declared, is_reference
from fenics_joints.errors import InputError, real
from fenics_joints.units import sizes, to_si

_NAME = r"[A-Za-z][A-Za-z0-9_-]*"
AXES = ("x", "y", "z")


def quantity(
    unit: str,
    least: float = -math.inf,
    most: float = math.inf,
    above: bool = False,
    word: str | None = None,
    meaning: str | None = None,
):
    """The type of a float in SI ``unit`` from text; within limits, or above the lower one.

    With a ``word`` that may stand in its place, for its ``meaning``.
    """

    def read(value: Any) -> float | str | None:
        if word is not None and value == word:
            return meaning
        try:
            number = to_si(value, unit)
        except InputError as error:
            if word is None:
                raise
            raise ValueError(f"{error}, or {word!r}") from None
        if not (number > least if above else number >= least) or number > most:
            low = f"{'above' if above else 'at least'} {least:g} {unit}".rstrip()
            high = f" and at most {most:g} {unit}".rstrip() if most < math.inf else ""
            raise ValueError(f"expected {low}{high}")
        smallest, largest = sizes(unit)
        if abs(number) > largest:
            raise ValueError(f"expected at most {largest:g} {unit}".rstrip())
        if above and least == 0 and number < smallest:
            raise ValueError(f"expected at least {smallest:g} {unit}".rstrip())
        return number

    read.unit, read.word = unit, word  # for the schema
    return Annotated[float if word is None else float | str | None, BeforeValidator(read)]


def listed(value: Any) -> Any:
    """A list, also of a single value."""
    return value if isinstance(value, list) else [value]


def in_files(value: Any) -> Any:
    """A section of a name, or a list of names, of files."""
    return {"files": value} if isinstance(value, list | str) else value


class FileName(str):
    """The name of a file that a case reads, relative to its folder."""


def _file_name(value: str) -> FileName:
    if not value.strip():
        raise ValueError("expected the name of a file")
    return FileName(value)


def _padded(vector: list[float]) -> tuple[float, ...]:
    return tuple(vector) + (0.0,) * (3 - len(vector))


def _bare(value: Any) -> float:
    """A number without a unit; a truth value or a text is none."""
    try:
        return real("", value)
    except InputError as error:
        raise ValueError(str(error).partition(": ")[2]) from None


def _written(value: Any) -> float | str:
    """A number, or a text that may be one with its unit."""
    return value if isinstance(value, str) else _bare(value)


def nonzero(vector: list[float]) -> list[float]:
    """A vector; ValueError if it is zero."""
    if not np.linalg.norm(vector) > 0:
        raise ValueError("expected a finite vector that is not zero")
    return vector


def _ascending(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError("expected [low, high] with low < high")
    return pair


def one_of_or_own(*words: str):
    """The type of a word that is one of these, or names an object of the user's own, see
    `fenics_joints.case.own_code`."""
    known = " or ".join([", ".join(repr(word) for word in words[:-1]), repr(words[-1])])

    def check(word: str) -> str:
        if word not in words and not is_reference(word):
            near = difflib.get_close_matches(word, (*words, *declared()), 1)
            mean = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"expected {known}, or module:name of your own{mean}")
        return word

    schema = {"anyOf": [{"enum": list(words)}, {"pattern": "^[A-Za-z_][A-Za-z0-9_.-]*:[A-Za-z_]"}]}
    return Annotated[str, AfterValidator(check), WithJsonSchema({"type": "string"} | schema)]


def check_values(given: Mapping[str, float | str], units: Mapping[str, str], name: str) -> None:
    """ValueError unless these are the values of all properties of an object of the user's own."""
    for key in given:
        if key not in units:
            raise ValueError(f"values.{key}: unknown, expected {', '.join(units)} of {name}")
    for key in units:
        if key not in given:
            raise ValueError(f"values.{key} is missing: expected {', '.join(units)} of {name}")
    in_si(given, units)


def in_si(given: Mapping[str, float | str], units: Mapping[str, str]) -> dict[str, float]:
    """Values in SI units, in the order of the units."""
    found = {}
    for key, unit in units.items():
        try:
            found[key] = float(to_si(given[key], unit))
        except InputError as error:
            raise ValueError(f"values.{key}: {error}") from None
    return found


Number = Annotated[float, BeforeValidator(_bare)]
Written = Annotated[float | str, BeforeValidator(_written)]
Length = quantity("m")
Size = quantity("m", 0, above=True)
Gap = quantity("m", 0)
Modulus = quantity("Pa", 0, above=True)
Density = quantity("kg/m3", 0, above=True)
Mass = quantity("kg", 0, above=True)
Stiffness = quantity("N/m", 0, above=True)
PerArea = quantity("Pa/m", 0, above=True)
Turning = quantity("N*m", 0, above=True)
Damper = quantity("N*m*s", 0)
Inertia = quantity("kg*m2", 0)
Spacing = quantity("Hz", 0)
Positive = quantity("", 0, above=True)
Share = quantity("", 0)
Poisson = quantity("", -0.999, 0.4999)
Point = Annotated[list[Length], Field(min_length=2, max_length=3), AfterValidator(_padded)]
Direction = Annotated[
    list[Number],
    Field(min_length=2, max_length=3),
    AfterValidator(nonzero),
    AfterValidator(_padded),
]
Names = Annotated[list[str], BeforeValidator(listed), Field(min_length=1)]
Count = Annotated[int, Field(ge=1, le=10**9, strict=True)]
ModeCount = Annotated[int, Field(ge=1, le=10_000, strict=True)]
File = Annotated[str, AfterValidator(_file_name)]
Files = Annotated[list[File], BeforeValidator(listed), Field(min_length=1)]


def ascending(kind):
    """The type of a pair [low, high] of a kind of number."""
    return Annotated[tuple[kind, kind], AfterValidator(_ascending)]


class CaseSection(BaseModel):
    """A table of the file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)
    #: Pairs of keys, one of which must be given, and not both.
    one_of: ClassVar[tuple[tuple[str, str], ...]] = ()

    @model_validator(mode="after")
    def _one_of_each_pair(self) -> CaseSection:
        for pair in self.one_of:
            if sum(getattr(self, name) is not None for name in pair) != 1:
                keys = [type(self).model_fields[name].alias or name for name in pair]
                raise ValueError(f"expected either {' or '.join(keys)}")
        return self


def docstring_keys(section: type[BaseModel]) -> tuple[str, dict[str, str]]:
    """A section's docstring without its list of attributes; and that list, by key.

    What a key of the case file means stands there alone: schema, documentation and the comments
    that `fenics-joints new` writes are made of it. A subclass has the keys of its base too.
    """
    words, found = "", {}
    for kind in reversed(section.__mro__[: section.__mro__.index(BaseModel)]):
        words, *listed = inspect.cleandoc(kind.__doc__ or "").split("\nAttributes:\n")
        keys = re.findall(r"^    (\w+): (.*(?:\n        .*)*)", "".join(listed), re.MULTILINE)
        found |= {key: " ".join(text.split()) for key, text in keys}
    return words.strip(), found


def tolerance_and_bounds(name: str, **kinds: Any) -> tuple[type[CaseSection], type[CaseSection]]:
    """Sections on how well parameters are known, by the types of their values.

    Relative standard deviations, and pairs of bounds; of thickness and width these are actual over
    nominal.
    """
    types = {
        "Tolerance": dict.fromkeys(kinds, Share),
        "Bounds": {key: ascending(kind) for key, kind in kinds.items()},
    }
    for what, own in types.items():
        keys = {key: (kind | None, None) for key, kind in own.items()}
        section = create_model(f"{name}{what}", __base__=CaseSection, __module__=__name__, **keys)
        section.__doc__ = f"{what} of parameters."
        globals()[section.__name__] = section  # by its name a case is sent from rank to rank
    return globals()[f"{name}Tolerance"], globals()[f"{name}Bounds"]


def either(kind: Callable[[Any], type[CaseSection] | None], sections, **context: str):
    """The type of a section of one of several classes.

    Args:
        kind: The class of a raw section, or None for an error that has the context.
        sections: The classes.
        context: ``key`` that tells them apart, its ``known`` words, what may stand ``instead``.
    """

    def tag(data: Any) -> str | None:
        found = kind(data)
        return None if found is None else f"<{found.__name__}>"

    options = Union[tuple(Annotated[s, Tag(f"<{s.__name__}>")] for s in sections)]  # noqa: UP007
    return Annotated[options, Discriminator(tag, "no_kind", "no kind of section", context)]


def named_by(key: str, sections) -> dict[str, type[CaseSection]]:
    """Sections by the word that their ``key`` must have."""
    return {get_args(s.model_fields[key].annotation)[0]: s for s in sections}


def chosen(key: str, *sections: type[CaseSection], own: type[CaseSection] | None = None):
    """The type of a section whose ``key`` says of which class it is, each with its own word.

    Args:
        key: The key.
        sections: The classes.
        own: The class where the word names an object of the user's own.
    """
    known = named_by(key, sections)

    def kind(data: Any) -> type[CaseSection] | None:
        word = data.get(key) if isinstance(data, dict) else None
        if not isinstance(word, str):
            return None
        return known.get(word) or (own if is_reference(word) else None)

    every = sections if own is None else (*sections, own)
    return either(kind, every, key=key, known=" ".join(known))


def _names(table: Any) -> Any:
    for name in table if isinstance(table, dict) else ():
        if not re.fullmatch(_NAME, name):
            raise ValueError(
                f"the name {name!r} is not usable: expected letters, digits, _ and -, "
                "starting with a letter"
            )
    return table


def named(kind):
    """A table of sections with names of their own, such as ``[parts.NAME]``."""
    return Annotated[dict[str, kind], BeforeValidator(_names)]

"""Senseless values by the kind of argument, and whether calls refuse them."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from math import inf, nan

import numpy as np

from fenics_joints.errors import InputError

#: Each odd value by the word that says that an argument takes it.
NUMBER = {
    "None": None,
    "text": "text",
    "empty": "",
    "nan": nan,
    "inf": inf,
    "True": True,
    "[]": [],
    "{}": {},
    "big": 10**400,
    "1e300": 1e300,
    "-1": -1.0,
    "0": 0.0,
}
COUNT = NUMBER | {"2.5": 2.5, "three": "3"}
TEXT = {"None": None, "empty": "", "1": 1.0, "nan": nan, "True": True, "[]": [], "bytes": b"x"}
FLAG = {"None": None, "text": "no", "1": 1, "0": 0.0, "[]": []}
OBJECT = {"None": None, "text": "text", "1": 1.0, "[nan]": [nan], "words": ["a"], "{}": {5: 1}}


def kind_of(value) -> dict:
    """Odd values to replace a valid one."""
    for kind, odd in ((bool, FLAG), (int, COUNT), (float, NUMBER), (str, TEXT)):
        if isinstance(value, kind):
            return odd
    odd = dict(OBJECT)
    if isinstance(value, (list, tuple, np.ndarray)):
        try:
            numbers = np.real(np.asarray(value, dtype=complex))
        except (TypeError, ValueError):
            return odd | {"[]": [], "twice": [*value, *value]}
        odd |= {"[]": [], "nans": nan * numbers, "deeper": [[[value]]], "-1": -1.0 - abs(numbers)}
    return odd


def outcome(make, good: dict, name: str, value) -> str:
    """Result of a call with one odd value: ``refused``, ``taken``, or the wrong error."""
    try:
        make(**{**good, name: value})
    except InputError:
        return "refused"
    except Exception as error:  # noqa: BLE001  all but an InputError is the finding
        return f"{type(error).__name__}: {error}"
    return "taken"


def arguments(make, good: dict) -> dict:
    """All arguments with valid values: the given ones and the defaults."""
    named = {
        name: parameter.default
        for name, parameter in inspect.signature(make).parameters.items()
        if parameter.default is not inspect.Parameter.empty
    }
    return named | good


def not_refused(calls: Iterable[tuple]) -> list[str]:
    """Odd values that calls take or fail at with anything but an `InputError`, a line each.

    Args:
        calls: What is called, arguments that work, and what it takes beside: ``"share:0 unit:*"``,
            words of odd values, or ``*`` for an argument that is not looked at.
    """
    wrong = []
    for make, good, takes in calls:
        make(**good)
        taken = {
            name: set(words.split(",")) for name, words in (w.split(":") for w in takes.split())
        }
        for name, value in arguments(make, good).items():
            if (allowed := taken.get(name, set())) == {"*"}:
                continue
            for word, odd in kind_of(value).items():
                if value is None and odd is None:
                    continue
                found = outcome(make, good, name, odd)
                if found != ("taken" if word in allowed else "refused"):
                    wrong.append(f"{make.__name__}: {name}:{word} = {odd!r}: {found}"[:300])
    return wrong

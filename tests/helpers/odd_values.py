"""Values that make no sense, by what was wanted, and whether calls refuse them."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, nan

from fenics_joints.errors import InputError
from fenics_joints.structure import Structure

NO_NUMBER = (None, "text", "", nan, inf, -inf, True, [], {}, 1j, 1e300, -1e300, 10**400, b"1")
#: What must be refused where something is wanted.
ANY = NO_NUMBER
FROM_0 = (*NO_NUMBER, -1.0, -1e-9)
ABOVE_0 = (*FROM_0, 0.0, 0)
COUNT = (*ABOVE_0, 2.5, "3")
TEXT = (None, "", " ", 1.0, nan, True, [], b"x")
FLAG = (None, "no", "True", 1, 0.0, [])
WORD = (None, "", "other", 1, True, [])
#: Names of parameters may stand for these.
NAMED_FROM_0 = tuple(v for v in FROM_0 if v != "text")
NAMED_ABOVE_0 = (*NAMED_FROM_0, 0.0)
RATIO = tuple(v for v in NO_NUMBER if v != "text") + (0.5, -1.0, 1.0)
VECTOR = (
    None,
    "x",
    "text",
    nan,
    True,
    1.0,
    [],
    {},
    [0, 0, 0],
    [nan, 0, 1],
    [1e300, 0, 0],
    [None, 0, 1],
    ["a", "b", "c"],
    [1.0],
    [1, 0, 0, 0],
    [[1, 0, 0]],
)
POINT = tuple(v for v in VECTOR if v != [0, 0, 0])
MODEL = (None, "model", 1.0, [], {}, Structure)
START = (5, "x", [1], (1, 2), {"a": 1}, object())
OPTIONS = (5, "x", [1], {5: 1}, {"": 1}, {"two words": 1}, {"eps_tol": object()})
GIVEN = ("text", 1.0, [1.0], {"nothing": 1.0}, {1: 1.0})


def not_refused(calls: Iterable[tuple], skip: type | tuple = ()) -> list[str]:
    """Odd values that calls take or fail at with anything but an `InputError`, a line each.

    Args:
        calls: What is called, arguments that work, and odd values of each argument.
        skip: Kinds of values that are left out.
    """
    wrong = []
    for make, good, odd in calls:
        make(**good)
        for name, values in odd.items():
            for value in values:
                if isinstance(value, skip):
                    continue
                try:
                    make(**{**good, name: value})
                except InputError:
                    continue
                except Exception as error:  # noqa: BLE001  all but an InputError is the finding
                    found = f"{type(error).__name__}: {error}"
                else:
                    found = "is taken"
                wrong.append(f"{make.__name__}: {name} = {value!r}: {found}")
    return wrong

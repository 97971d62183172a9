"""When an effect of the world and one of the diagnosis' library are the same thing.

The two were named by different people. The table says which names of the library are right for an
effect of the world; it is part of the rules, so it must not change once a final check is sealed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from fnmatch import fnmatchcase
from functools import cache

from benchmarks.blind import worlds

#: Further names of the library that are right, beside the world's own list of them; patterns.
ALSO: dict[str, tuple[str, ...]] = {
    "graded": ("joint compliance graded from zone to zone",),
    # Where it hangs says what it is.
    "harness": ("added mass",),
    # Causes that had no name before the library looked for local changes anywhere.
    "hard_spot": ("local gain of stiffness",),
    "holes": ("local loss of stiffness",),
    # A soft layer in a joint is a compliant joint.
    "gasket": ("joint*compliance*",),
    # Two names for what happens at a bolt that does not press.
    "loose_bolt": ("compliance at one bolt", "compliance at one joint"),
    # In the library's words: as one under the bolts and barely touching elsewhere; or touching near
    # them only, at any torque.
    "lost_contact": ("compliance away from the bolts only", "contact area smaller than modelled"),
}

#: Places up to which an answer that holds for any of them says where.
_PLACES = 5


def same_cause(world: str, library: str) -> bool:
    """Whether an effect of the library, by its name, is that effect of the world."""
    return any(fnmatchcase(plain_name(library), pattern) for pattern in _patterns(world))


@cache
def _patterns(world: str) -> tuple[str, ...]:
    names = _library().get(world, (world,))
    return (*(plain_name(name) for name in names), *ALSO.get(world, ()))


@cache
def _library() -> dict[str, tuple[str, ...]]:
    """The worlds' lists of what the diagnosis calls their effects."""
    return worlds.library()


def cause_of(library: str) -> str:
    """The world's name of an effect of the library; its own if the world has none such."""
    return next((name for name in _library() if same_cause(name, library)), library)


def same_region(world: str | list[str], library: str) -> bool:
    """Whether the library's region is the world's: one of several that are right, or its equal.

    Places that a test cannot tell apart are one to the library, "bolt 1 / bolt 4"; of more than
    five it names none.

    An effect of the whole structure (no region on either side) is in the right place anywhere.
    """
    allowed = [world] if isinstance(world, str) else list(world)
    given = [plain_name(place) for place in library.split(" / ")]
    named = given if len(given) <= _PLACES else []
    return given == [""] or any(not a or plain_name(a) in named for a in allowed)


def opened(answer: Mapping) -> dict:
    """The world's truth of a case as scoring needs it.

    Returns:
        ``kind``, ``geometry``, ``noise`` (quiet, usual, poor), ``final_only``,
        ``small_classes``, and ``effects`` with the world's ``name``, ``region`` (or those that
        symmetry makes equal) and ``size``.
    """
    world = worlds.world_of(answer["geometry"])
    return {
        "kind": answer["kind"],
        "geometry": answer["geometry"],
        "noise": world.noise_word(answer["noise"]),
        "final_only": answer["final_only"],
        # A rule of the third check: answers by class count only while the class is small.
        "small_classes": world.SMALL_CLASSES,
        "effects": [
            {"name": e["name"], "region": _region(e, answer["geometry"]), "size": e["params"]}
            for e in answer["effects"]
        ],
    }


def _region(effect: Mapping, geometry: str):
    """Where it acts: the world has no place for two modes that were mistaken, the library has; and
    joints that the world counts are pairs of parts to the library."""
    if effect["name"] == "mis_pairing" and not effect["region"]:
        first = effect["params"]["mode"] + 1
        return f"bending {first}, bending {first + 1}"
    touching = getattr(worlds.world_of(geometry), "touching", None)
    pair = touching(geometry, effect["region"]) if touching else ()
    if not pair:
        return effect["region"]
    return [effect["region"], *(" and ".join(way) for way in (pair, pair[::-1]))]


def outcomes(geometry: str) -> int:
    """Outcomes of a geometry: its effects, no gap, and none of these."""
    return len(worlds.world_of(geometry).EFFECTS[geometry]) + 2


def plain_name(text: str) -> str:
    """Lower case, with single spaces for all else that is no letter, digit or pattern."""
    return " ".join(re.sub(r"[^a-z0-9]+", " ", text.lower()).split())

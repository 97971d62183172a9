"""The thread of a bolt, guessed from the holes that it goes through."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fenics_joints.errors import real
from fenics_joints.preload.threads import Thread, thread, thread_names

#: What speaks against a reading of a hole, as a relative error of its diameter: a clearance of the
#: fine or the coarse series, none at all, an inch thread, a size of the second choice. Chosen, so
#: that each hole of ISO 273 and each tapping drill has its own thread (tests/preload).
_FINE, _COARSE, _TIGHT, _INCH, _RARE = 0.01, 0.02, 0.035, 0.03, 0.01
#: Error beyond which no thread fits, and by which another fits nearly as well. Chosen: sizes of the
#: first choice differ by a fifth or so.
_FAR, _NEARLY = 0.08, 0.03
#: Share by which a hole is wider than a tapped one on its axis. Chosen: tapping drills are 15 % and
#: more below clearance holes.
_TAPPED = 0.05


@dataclass(frozen=True)
class ThreadGuess:
    """A thread that fits holes.

    Attributes:
        thread: The thread.
        why: How the holes fit it, in words.
        others: Names of others that fit nearly as well.
    """

    thread: Thread
    why: str
    others: tuple[str, ...]


def head_radius(hole: float, guess: ThreadGuess | None) -> float:
    """Radius of the head of a bolt in a hole of a radius, m: half its width across flats.

    Without a thread 1.6 times the hole's, as metric heads have it.
    """
    return 1.6 * hole if guess is None else guess.thread.width_across_flats / 2


def cone_radius(head: float, thickness: float) -> float:
    """Radius, m, to which a head of a radius presses two plates, under one of a thickness, m.

    A cone from the edge of the head at 30 degrees to the axis, as Shigley's Mechanical Engineering
    Design takes it, since Osgood reports 25 to 33 (Roetscher's cone; VDI 2230 has one that depends
    on the parts' width, too).
    """
    return head + thickness * math.tan(math.pi / 6)


def guess_thread(widest: float, narrowest: float | None = None) -> ThreadGuess | None:
    """The standard thread for a hole, metric or inch; None if none is near.

    Clearance holes of ISO 273 (metric) and free-fit drills (inch), or a hole of the thread's own
    diameter; with a narrower hole on the same axis, tapped, that of diameter less pitch.

    Args:
        widest: Diameter of the widest hole on the bolt's axis, m.
        narrowest: Of the narrowest, m; the same by default.
    """
    widest = real("widest", widest, "m", above=0)
    narrow = widest if narrowest is None else real("narrowest", narrowest, "m", above=0)
    names = [n for n in thread_names() if thread(n).series in ("metric coarse", "UNC")]
    found = sorted(
        ((*_fit(thread(name), widest, narrow), name) for name in names), key=lambda f: f[0]
    )
    error, why, best = found[0]
    if error > _FAR:
        return None
    others = [name for other, _, name in found[1:] if other < error + _NEARLY]
    return ThreadGuess(thread(best), why, tuple(others))


def _fit(t: Thread, widest: float, narrow: float) -> tuple[float, str]:
    """Relative error of holes as those of a thread, and how they fit it, in words."""
    readings = [
        (0.0, t.hole_diameter, "a clearance hole of the medium series"),
        (_FINE, t.fine_hole_diameter, "a clearance hole of the fine series"),
        (_COARSE, t.coarse_hole_diameter, "a clearance hole of the coarse series"),
        (_TIGHT, t.diameter, "a hole without clearance"),
    ]
    error, words = min((cost + abs(widest / size - 1), words) for cost, size, words in readings)
    if not t.series.startswith("metric"):
        error += _INCH
        words = words.replace("a clearance hole of the medium series", "a free-fit hole")
    error += _RARE * (t.choice > 1)
    if narrow < (1 - _TAPPED) * widest:
        drill = t.diameter - t.pitch
        error += abs(narrow / drill - 1)
        words += f" and a tapped one of {1e3 * narrow:.4g} mm"
    return error, words

"""Standard threads with the bolt head, washer and clearance hole that go with them.

Nominal sizes are in two tables beside this file; all else is computed from the basic profile.
"""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

from fenics_joints.errors import InputError

#: An inch, m.
_INCH = 25.4e-3
#: Columns of the tables.
_LENGTHS = (
    "diameter",
    "width_across_flats",
    "head_height",
    "washer_inner_diameter",
    "washer_outer_diameter",
    "washer_thickness",
    "hole_diameter",
    "fine_hole_diameter",
    "coarse_hole_diameter",
)


@dataclass(frozen=True)
class Thread:
    """A thread of the 60-degree profile (ISO 68-1, ASME B1.1) and its hardware. Lengths in m.

    Attributes:
        name: Such as ``M12``, ``M12x1.25`` or ``5/16-24 UNF``.
        series: ``metric coarse``, ``metric fine``, ``UNC`` or ``UNF``.
        diameter: Nominal (major) diameter d.
        pitch: Pitch P.
        width_across_flats: Of hexagon head and nut.
        head_height: Of the hexagon head.
        washer_inner_diameter: Of the plain washer.
        washer_outer_diameter: Of the plain washer.
        washer_thickness: Of the plain washer.
        hole_diameter: Of the clearance hole, of the medium series.
        fine_hole_diameter: Of that of the fine series; infinite for inch threads, which have none.
        coarse_hole_diameter: Of that of the coarse series, likewise.
        choice: 1, or 2 for sizes of the second choice (ISO 262), rarely used.
    """

    name: str
    series: str
    diameter: float
    pitch: float
    width_across_flats: float
    head_height: float
    washer_inner_diameter: float
    washer_outer_diameter: float
    washer_thickness: float
    hole_diameter: float
    fine_hole_diameter: float = math.inf
    coarse_hole_diameter: float = math.inf
    choice: int = 1

    @property
    def half_angle(self) -> float:
        """Half the angle of the profile, rad."""
        return math.pi / 6

    @property
    def profile_height(self) -> float:
        """Height H of the sharp triangle, m (ISO 68-1)."""
        return math.sqrt(3) / 2 * self.pitch

    @property
    def pitch_diameter(self) -> float:
        """Basic pitch diameter d2 = d - 3 H / 4, m (ISO 724)."""
        return self.diameter - 0.75 * self.profile_height

    @property
    def minor_diameter(self) -> float:
        """Basic minor diameter d1 = d - 5 H / 4, m (ISO 724)."""
        return self.diameter - 1.25 * self.profile_height

    @property
    def root_diameter(self) -> float:
        """Root diameter of the bolt's thread d3 = d1 - H / 6, m (ISO 898-1)."""
        return self.minor_diameter - self.profile_height / 6

    @property
    def stress_area(self) -> float:
        """Tensile stress area, m2.

        Metric: pi/4 ((d2 + d3)/2)^2 (ISO 898-1); inch: pi/4 (d - 0.9743 P)^2 (ASME B1.1).
        """
        if self.series.startswith("metric"):
            effective = (self.pitch_diameter + self.root_diameter) / 2
        else:
            effective = self.diameter - 0.9743 * self.pitch
        return math.pi / 4 * effective**2


def thread(name: str | Thread) -> Thread:
    """A standard thread by its name.

    Args:
        name: ``M12`` (coarse), ``M12x1.25``, ``5/16-24`` or ``5/16-24 UNF``; case, spaces and
            the sign of multiplication do not matter. A `Thread` is returned as it is.

    Raises:
        InputError: If there is no such thread; names the nearest.
    """
    if isinstance(name, Thread):
        return name
    if not isinstance(name, str):
        raise InputError(f"thread {name!r}: expected a name such as 'M12' or '5/16-24 UNF'")
    table = _by_key()
    key = _key(name)
    if key in table:
        return table[key]
    near = difflib.get_close_matches(key, table, 3, cutoff=0.5)
    names = list(dict.fromkeys(table[k].name for k in near)) or ["M12", "M12x1.25", "5/16-24 UNF"]
    raise InputError(f"thread {name!r} is not in the table; nearest: {', '.join(names)}")


def thread_names() -> tuple[str, ...]:
    """Names of all threads in the table, metric first, by diameter."""
    return tuple(t.name for t in _all())


def _key(name: str) -> str:
    key = re.sub(r"[\s\"″]", "", name).upper().replace("×", "X").replace("*", "X")
    return re.sub(r"^NO\.?", "#", key)


@lru_cache(maxsize=1)
def _by_key() -> dict[str, Thread]:
    table = {}
    for t in _all():
        table[_key(t.name)] = t
        if t.series == "metric coarse":
            table[_key(f"{t.name}x{t.pitch * 1e3:g}")] = t
        elif not t.series.startswith("metric"):
            table[_key(t.name.split()[0])] = t
    return table


@lru_cache(maxsize=1)
def _all() -> tuple[Thread, ...]:
    threads = []
    for row in _rows("metric.csv"):
        for i, pitch in enumerate([row["coarse"], *row["fine"].split()]):
            name = f"{row['size']}x{pitch}" if i else row["size"]
            series = "metric fine" if i else "metric coarse"
            threads.append(_thread(name, series, float(pitch) * 1e-3, row, 1e-3))
    for row in _rows("inch.csv"):
        for series, per_inch in (("UNC", row["coarse"]), ("UNF", row["fine"])):
            name = f"{row['size']}-{per_inch} {series}"
            threads.append(_thread(name, series, _INCH / float(per_inch), row, _INCH))
    return tuple(threads)


def _thread(name: str, series: str, pitch: float, row: dict[str, str], unit: float) -> Thread:
    lengths = {key: float(row[key]) * unit for key in _LENGTHS if row.get(key)}
    return Thread(name, series, pitch=pitch, choice=int(row.get("choice", 1)), **lengths)


def _rows(file: str) -> Iterator[dict[str, str]]:
    text = resources.files(__package__).joinpath(file).read_text(encoding="utf-8")
    # The names of inch sizes may begin with #, so only "# " is a remark.
    return csv.DictReader(line for line in text.splitlines() if not line.startswith("# "))

"""Contact radius and force inside it, on grids of the parameters that the paper does not print.

Without an initial gap the contact is homogeneous: pressure over force does not depend on the
force, so a single solution gives the radius R at every level p / F = P_lim / F. The tables hold
ln R and ln phi, where phi is the share of the force within R, over the logarithms of the levels and
of the parameters. All axes are evenly spaced. The tables are interpolated linearly: near the
largest pressure the radius falls steeply, and splines would overshoot.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates

from fenics_joints.database import BoltedPlates, solve_bolted_plates
from fenics_joints.errors import JointsError

BOLT = "M12"
HOLE = 6.75e-3  # radius of the hole, m: M12, ISO 273 medium
LEVELS = np.geomspace(3.0, 250.0, 45)  # P_lim / F, 1/m2

THICKNESS = np.geomspace(5e-3, 100e-3, 15)
LOADED = np.geomspace(9e-3, 36e-3, 7)  # radius
PENALTY = np.geomspace(1e11, 1e15, 11)
RIM = np.geomspace(40e-3, 300e-3, 6)
RATIO = np.geomspace(0.2, 5, 7)
WASHER_RADIUS = np.geomspace(12e-3, 40e-3, 4)
WASHER_THICKNESS = np.geomspace(1.25e-3, 20e-3, 4)
#: Crown of the plates: gap in m at 100 mm from the axis at 1 N, evenly spaced in its arsinh.
CROWN = np.linspace(-4, 4, 9)
CROWN_UNIT = 2e-6 / 25e3
CELL = np.geomspace(0.5e-3, 8e-3, 5)


def crown(index: np.ndarray) -> np.ndarray:
    """Gap at 100 mm over the force, m/N, at a point on the axis CROWN."""
    return CROWN_UNIT * np.sinh(index)


FAMILIES = {
    "loaded, penalty": {"t": THICKNESS, "loaded": LOADED, "penalty": PENALTY},
    "loaded, rim": {"t": THICKNESS, "loaded": LOADED, "rim": RIM},
    "penalty, rim": {"t": THICKNESS, "penalty": PENALTY, "rim": RIM},
    "ratio, loaded": {"t": THICKNESS, "ratio": RATIO, "loaded": LOADED[::2]},
    "penalty, ratio": {"t": THICKNESS, "penalty": PENALTY[1:6], "ratio": RATIO},
    "gasket": {"t": THICKNESS, "washer": WASHER_RADIUS, "washer_t": WASHER_THICKNESS},
    "crown": {"t": THICKNESS, "crown": CROWN},
    "cell": {"t": THICKNESS, "cell": CELL},
    "nu": {"t": THICKNESS, "nu": np.array([0.1, 0.2, 0.3, 0.4])},
    "washers, smooth": {"t": THICKNESS},
    "washers, friction 0.2": {"t": THICKNESS},
    "bolt, smooth": {"t": THICKNESS},
    "bolt, friction 0.2": {"t": THICKNESS},
}


def solution(family: str, p: dict[str, float]):
    """Radii, m, and pressures over the force, 1/m2, at the contact points of one solution."""
    t, ratio = p["t"], p.get("ratio", 1.0)
    given = {"plate_radius": p.get("rim", 0.3), "upper_thickness": ratio, "nu": p.get("nu", 0.3)}
    given["size"] = p.get("cell", float(np.clip(0.05 * t * max(1, ratio), 1e-3, 2.5e-3)))
    if p.get("penalty", 1e15) < 0.99e15:  # the last is rigid contact
        given["penalty"] = p["penalty"]
    if "loaded" in p:
        given["loaded_diameter"] = 2 * p["loaded"]
    if family == "gasket":
        given |= {
            "model": "washers",
            "washer_diameter": 2 * p["washer"],
            "washer_thickness": p["washer_t"],
        }
    elif "," in family and family.split(",")[0] in ("washers", "bolt"):
        given["model"] = family.split(",")[0]
        given["washer_friction"] = 0.2 if "friction" in family else 0.0
    gap, force = 0.0, 1e4
    if "crown" in p:
        steep = force * crown(p["crown"]) / 0.1**2

        def gap(x):
            return steep * (x[:, 0] ** 2 - HOLE**2)

    result = solve_bolted_plates(BOLT, t, force, BoltedPlates(**given), gap=gap)
    result.solver.destroy()
    state = result["plates"]
    order = np.argsort(state.interface.points[:, 0])
    return state.interface.points[order, 0], state.pressure[order] / force


def curves(r: np.ndarray, p: np.ndarray, levels=LEVELS) -> tuple[np.ndarray, np.ndarray]:
    """Largest radius at which the pressure, linear between the points, reaches each level, and the
    share of the force inside it. Both have the shape of ``levels``.

    If the pressure reaches a level nowhere, the radius is that of the hole plus a small term that
    falls with the level, so that a fit has a slope to follow.
    """
    fine = np.unique(np.concatenate([r, np.linspace(r[0], r[-1], 2000)]))
    q = np.interp(fine, r, p)
    inside = np.concatenate([[0], np.cumsum(np.pi * np.diff(fine**2) * (q[1:] + q[:-1]) / 2)])
    radius = np.empty(len(levels))
    for i, level in enumerate(levels):
        above = np.flatnonzero(q >= level)
        if not len(above):
            radius[i] = fine[0] * (1 + 0.02 * q.max() / level)
        elif above[-1] == len(fine) - 1:
            radius[i] = fine[-1]
        else:
            k = above[-1]
            radius[i] = np.interp(-level, [-q[k], -q[k + 1]], [fine[k], fine[k + 1]])
    share = np.interp(radius, fine, inside / inside[-1])
    nowhere = levels > q.max()
    share[nowhere] = (levels * np.pi * (radius**2 - fine[0] ** 2))[nowhere]
    return radius, share


@dataclass(frozen=True)
class Table:
    """Responses on one grid.

    Attributes:
        axes: Values of each parameter; the first is the thickness.
        radius: Of shape (*axes, levels), m.
        share: Of the force inside, of the same shape.
    """

    axes: dict[str, np.ndarray]
    radius: np.ndarray
    share: np.ndarray

    @cached_property
    def _logs(self) -> list[np.ndarray]:
        return [np.log(a) for a in (self.radius, self.share)]

    def __call__(self, level: np.ndarray, **values) -> tuple[np.ndarray, np.ndarray]:
        """ln radius and ln share at levels, 1/m2, and parameters, broadcast together."""
        places = [_place(axis, values[name], name) for name, axis in self.axes.items()]
        places.append(_place(LEVELS, level, "level"))
        places = np.broadcast_arrays(*places)
        shape = places[0].shape
        at = np.array([p.ravel() for p in places])
        found = [map_coordinates(a, at, order=1, mode="nearest") for a in self._logs]
        return tuple(f.reshape(shape) for f in found)


def _place(axis: np.ndarray, value, name: str) -> np.ndarray:
    """Index on an evenly spaced axis: in logarithms, except for the plain axes crown and nu."""
    plain = name in ("crown", "nu")
    low, high = (axis[0], axis[-1]) if plain else np.log([axis[0], axis[-1]])
    x = np.asarray(value, dtype=float)
    x = x if plain else np.log(x)
    return np.clip((x - low) / (high - low), 0, 1) * (len(axis) - 1)


def compute(file: Path) -> None:
    """Solve all points that the file lacks; the file is written after each family."""
    done = dict(np.load(file)) if file.exists() else {}
    for family, axes in FAMILIES.items():
        shape = tuple(len(a) for a in axes.values())
        empty = np.full((2, *shape, len(LEVELS)), np.nan)
        both = done.get(family, empty)
        todo = np.argwhere(np.isnan(both[0, ..., 0]))
        said = set()
        for index in map(tuple, todo):
            p = {n: float(a[i]) for (n, a), i in zip(axes.items(), index, strict=True)}
            try:
                both[(slice(None), *index)] = curves(*solution(family, p))
            except JointsError as error:  # stays NaN, so the next run tries it again
                said.add(f"{p}: {error}"[:200])
        print(f"{family}: {len(todo) - len(said)} solved", *said, sep="\n  ", flush=True)
        done[family] = both
        np.savez_compressed(file, **done)


def load(file: Path) -> dict[str, Table]:
    """All tables of a file."""
    data = np.load(file)
    return {
        family: Table(axes, *data[family]) for family, axes in FAMILIES.items() if family in data
    }


if __name__ == "__main__":
    compute(Path(sys.argv[1]))

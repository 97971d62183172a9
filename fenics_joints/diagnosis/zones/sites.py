"""Places of a structure where something may be that its nominal model has nothing of.

Points where something may be attached, patches that may have lost stiffness, and plates that may be
bowed or of uneven thickness; and what changes the model there, by parameters that are all nought in
the nominal one (`fenics_joints.structure.changes`).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.dimensions import Dimensions, directed_parts
from fenics_joints.diagnosis.zones.part_cells import BOW, LOSS, TAPER, PartCells, Plate
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.changes import (
    STIFFNESSES,
    Change,
    PlacedPoint,
    PlacedResonator,
)

__all__ = [
    "HUNG", "ON", "Sites", "as_mass", "sites_of",
]  # fmt: skip

#: Prefixes of the parameters, besides those of `part_cells`.
ON, HUNG = "put_on", "hung"
#: Mass of what hangs on a spring where nothing does, over the structure's. [numerical: chosen]
_IDLE = 1e-6


@dataclass(frozen=True)
class Sites:
    """Places, in an order in which neighbours are near each other.

    Attributes:
        points: Where something may be attached, m, (P, 3).
        patches: Middles of patches of parts, m, (Q, 3).
        tapered: Plates whose thickness may change along their length.
        bowed: The structure as a plate that may be bowed, by direction.
    """

    points: np.ndarray
    patches: np.ndarray
    tapered: tuple[Plate, ...] = ()
    bowed: tuple[Plate, ...] = ()

    @classmethod
    def none(cls) -> Sites:
        """No places, as of beams."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)))


def sites_of(
    case: Case,
    full: Structure,
    dimensions: Dimensions | None,
    sensors: Sensors | None,
    wanted: Collection[str] = (LOSS, ON, BOW, TAPER),
) -> tuple[Sites, list[Change], dict[str, float]]:
    """Places of a structure, what may change there, and the parameters' nominal values. Collective.

    Args:
        case: The case.
        full: Its nominal model.
        dimensions: Which thicknesses it can represent; None: all.
        sensors: Of the test; something hangs on them more often than elsewhere.
        wanted: Prefixes of the parameters in question.
    """
    if full.gdim != 3 or full.axisymmetric:
        return Sites.none(), [], {}
    cells = PartCells(directed_parts(case, full.tagged), full)
    found, changes, values = Sites.none(), [], {}
    if ON in wanted:
        points = full.comm.bcast(cells.points(sensors))
        own = {key: f"{ON}.{key}" for key in ("mass", *STIFFNESSES, "place")}
        changes += [PlacedPoint(f"{ON} {i}", tuple(x), own | {"at": float(i)})
                    for i, x in enumerate(points.tolist())]  # fmt: skip
        values |= dict.fromkeys(own.values(), 0.0)
        more, idle = _hung(full, points)
        changes, values = [*changes, *more], values | idle
        found = replace(found, points=points)
    if LOSS in wanted:
        losses, middles = cells.losses()
        changes += losses
        values |= {f"{LOSS}.depth": 0.0, f"{LOSS}.place": 0.0, f"{LOSS}.size": 1.0}
        found = replace(found, patches=middles)
    # A rotation, which is no strain, must be one of the elements' too; and without sensors modes
    # are counted, those of a free body that is off by a little with the elastic ones.
    if full.degree > 1 and sensors is not None:
        bowed, more = cells.bowed() if BOW in wanted else ((), [])
        tapered, others = cells.tapered(dimensions) if TAPER in wanted else ((), [])
        changes += [*more, *others]
        values |= {plate.parameter: 0.0 for plate in (*bowed, *tapered)}
        found = replace(found, bowed=bowed, tapered=tapered)
    return found, changes, values


def _hung(full: Structure, points: np.ndarray) -> tuple[list[Change], dict[str, float]]:
    """What may hang on a spring at these points, and the parameters' nominal values, at which it
    is as light as nothing and too fast to take part."""
    mass = _IDLE * full.total_mass()
    own = {key: f"{HUNG}.{key}" for key in ("mass", "stiffness", "place")}
    changes = [PlacedResonator(f"{HUNG} {i}", tuple(x), own | {"at": float(i), "idle": mass})
               for i, x in enumerate(points.tolist())]  # fmt: skip
    stiffness = mass * (2 * np.pi * full.dilation_frequency()) ** 2
    return changes, dict(zip(own.values(), (mass, stiffness, 0.0), strict=True))


def as_mass(values: dict[str, float], baseline: dict[str, float]) -> dict[str, float]:
    """Values for the full model, which has no motion of what hangs on a spring: there it is the
    mass that a mode far below its own frequency feels."""
    if values.get(f"{HUNG}.mass") == baseline.get(f"{HUNG}.mass"):
        return values
    own = {name for name in baseline if name.startswith(f"{HUNG}.")}
    idle = {name: baseline[name] for name in own}
    felt = {f"{ON}.{key}": values[f"{HUNG}.{key}"] for key in ("mass", "place")}
    return {**values, **felt, **idle}



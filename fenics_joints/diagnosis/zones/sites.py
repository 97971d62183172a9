"""Places of a structure where something may be that its nominal model has nothing of.

Points where something may be attached, patches that may have lost stiffness, and plates that may be
bowed or of uneven thickness; and what changes the model there, by parameters that are all nought in
the nominal one (`fenics_joints.structure.changes`).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement, product

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.dimensions import Dimensions, directed_parts
from fenics_joints.diagnosis.zones.part_cells import BOW, LOSS, TAPER, PartCells, Plate
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.changes import (
    OFFSETS,
    STIFFNESSES,
    Change,
    PlacedPoint,
    PlacedResonator,
)

#: Prefixes of the parameters, besides those of `part_cells`.
ON, HUNG = "put_on", "hung"
#: Mass of what hangs on a spring where nothing does, over the structure's. [numerical: chosen]
_IDLE = 1e-6
#: Sites where something may be attached. [numerical: time]
COUNT = 3
#: Vertices about a point, and how far they reach that count, over the distance of the farthest.
#: [numerical: chosen]
_VERTICES, _NEAR = 24, 0.7
#: Powers of the distances from it, by degree. [numerical: definition]
_POWERS = np.array(
    sorted(
        (p for p in product(range(3), repeat=3) if sum(p) < 3),
        key=lambda p: (sum(p), [-k for k in p]),
    )
)
#: What of a parabola the vertices do not tell apart. [numerical: chosen]
_ALIKE = 1e-3
#: Products of a displacement and its slopes. [numerical: definition]
_PAIRS = tuple(combinations_with_replacement(range(4), 2))
_WHERE = ("place", *OFFSETS)


@dataclass(frozen=True)
class Sites:
    """Places, in an order in which neighbours are near each other.

    Attributes:
        points: Near which something may be attached, m, (P, 3).
        reach: How far from these, m.
        idle: Mass of what hangs on a spring where nothing does, kg.
        vertices: Of the parts' cells, m, (V, 3).
        patches: Middles of patches of parts, m, (Q, 3).
        share: Probability that something attached is about one of the sites, if it is anywhere.
        tapered: Plates whose thickness may change along their length.
        bowed: The structure as a plate that may be bowed, by direction.
    """

    points: np.ndarray
    patches: np.ndarray
    reach: float = 0.0
    idle: float = 0.0
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    share: float = 1.0
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
        mass, points = _IDLE * full.total_mass(), full.comm.bcast(cells.points(sensors, COUNT))
        about = cells.vertices[about_point(cells.vertices, points[0])[0]]
        reach = float(np.linalg.norm(about - points[0], axis=1).max())
        found = replace(found, points=points, reach=reach, vertices=cells.vertices, idle=mass)
        changes += placed(found)
        values |= dict.fromkeys((f"{ON}.{key}" for key in ("mass", *STIFFNESSES, *_WHERE)), 0.0)
        stiffness = mass * (2 * np.pi * full.dilation_frequency()) ** 2
        values |= {f"{HUNG}.mass": mass, f"{HUNG}.stiffness": stiffness}
        values |= dict.fromkeys((f"{HUNG}.{key}" for key in _WHERE), 0.0)
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


def placed(sites: Sites) -> list[Change]:
    """What may be attached near the sites' points.

    Args:
        sites: The sites.
    """
    kinds = (
        (ON, PlacedPoint, ("mass", *STIFFNESSES)),
        (HUNG, PlacedResonator, ("mass", "stiffness")),
    )
    changes = []
    for i, point in enumerate(sites.points):
        near, weights = about_point(sites.vertices, point)
        for name, kind, keys in kinds:
            own = {key: f"{name}.{key}" for key in (*keys, *_WHERE)}
            own |= {"at": float(i), "idle": sites.idle}
            for pair in _PAIRS:
                powers = {f"{w}_power": pair.count(1 + k) for k, w in enumerate(OFFSETS)}
                label = f"{name} {i} {pair[0]}{pair[1]}"
                changes.append(kind(label, sites.vertices[near], weights, pair, own | powers))
    return changes


def about_point(vertices: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which vertices are about a point, (P,), and a displacement at the point and its slopes along
    x, y and z from those at these, (4, P): of the parabola through them, which is smooth where a
    force at one point would bend the mesh.

    Args:
        vertices: All vertices, m, (V, 3).
        point: The point, m, (3,).
    """
    away = np.linalg.norm(vertices - point, axis=1)
    near = np.argsort(np.round(away / away.max(), 6), kind="stable")[:_VERTICES]
    x, far = vertices[near], float(away[near[-1]])
    terms = np.prod(((x - point) / far)[:, None] ** _POWERS, axis=2)
    # What is near counts more.
    count = np.exp(-0.5 * (away[near] / (_NEAR * far)) ** 2)
    weights = np.linalg.pinv(count[:, None] * terms, rcond=_ALIKE) * count
    return near, weights[:4] / np.array([[1.0], [far], [far], [far]])


def without_attached(values: dict[str, float], baseline: dict[str, float]) -> dict[str, float]:
    """Values for the full model, which has nothing attached."""
    own = tuple(f"{name}." for name in (ON, HUNG))
    return {k: baseline[k] if k.startswith(own) else v for k, v in values.items()}

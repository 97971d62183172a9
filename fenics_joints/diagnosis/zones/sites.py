"""Places of a structure where the nominal model may lack something.

Points where something may be attached, patches that may have lost stiffness, and plates that may be
bowed or of uneven thickness; and the changes of the model there, by parameters that are all 0 in
the nominal one (`fenics_joints.structure.changes`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations_with_replacement, product

import numpy as np

from fenics_joints._compat import geometry_dofmap
from fenics_joints.case import Case
from fenics_joints.case.dimensions import Dimensions, directed_parts, unfit
from fenics_joints.diagnosis.zones.partition import partition
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.changes import (
    OFFSETS,
    STIFFNESSES,
    Change,
    LocalLoss,
    PlacedPoint,
    PlacedResonator,
    ShapeChange,
)

#: Prefixes of parameters.
LOSS, BOW, TAPER = "local_loss", "bow", "taper"
#: Patches at most: the reduced model has a matrix for each. [numerical: chosen for memory]
_PATCHES = 40
#: A plate is so many times as long as thick, and its cells fill its box. [numerical: chosen]
_SLENDER, _FULL = 5.0, 0.93
#: Half the difference of the ends' thicknesses over their mean up to which the stiffness is looked
#: at, and the degree of the polynomial through it: 1e-6 off at most. [numerical: measured: 1e-6
#: off]
MOST_TAPER, _DEGREE = 0.2, 6
#: Height of a bow over its length up to which the stiffness is looked at. [numerical: chosen]
MOST_BOW = 0.02


@dataclass(frozen=True)
class Plate:
    """A plate, or a structure that is one as a whole.

    Attributes:
        name: What it is called.
        part: The part that it is of; ``""`` for the whole.
        parameter: Of its shape, in the model.
        length: Its length in the direction of the change, m.
        how: That direction in words.
    """

    name: str
    part: str
    parameter: str
    length: float
    how: str = ""


class PartCells:
    """The cells of a case's parts, gathered where they are asked for. Collective."""

    def __init__(self, case: Case, full: Structure):
        self.case, self.full, self.comm = case, full, full.comm
        msh = full.mesh
        corners = msh.geometry.x[geometry_dofmap(msh)]
        self.corners, self.owned = corners, len(full.cell_volumes())
        self.middles, self.volume = corners.mean(axis=1), full.cell_volumes()
        self.names = [name for part in case.parts.values() for name in part.cells]
        self.part = {name: key for key, part in case.parts.items() for name in part.cells}
        tags = full.tagged.cell_tags
        self.cells = {name: tags.find(full.tagged.cell_tag(name)) for name in self.names}

    def _own(self, name: str) -> np.ndarray:
        return self.cells[name][self.cells[name] < self.owned]

    # -- points --------------------------------------------------------------------------------

    @cached_property
    def vertices(self) -> np.ndarray:
        """Of the parts' cells, on all ranks, (n, 3)."""
        own = np.concatenate([self._own(name) for name in self.names])
        vertices = np.vstack(self.comm.allgather(self.corners[own].reshape(-1, 3)))
        size = float(np.ptp(vertices, axis=0).max())
        return vertices[np.unique(np.round(vertices / size, 7), axis=0, return_index=True)[1]]

    def points(self, sensors: Sensors | None, count: int) -> np.ndarray:
        """Vertices of the parts' cells far from each other, near sensors if there are so many."""
        vertices = self.vertices
        if sensors is not None:
            at = np.unique(sensors.points, axis=0)
            at = np.pad(at, [(0, 0), (0, 3 - at.shape[1])])
            near = {int(np.argmin(np.linalg.norm(vertices - x, axis=1))) for x in at}
            if len(near) >= count:
                vertices = vertices[sorted(near)]
        return _far_apart(vertices, count)

    # -- patches -------------------------------------------------------------------------------

    def losses(self) -> tuple[list[LocalLoss], np.ndarray]:
        """A loss of each part, and the middles of all patches."""
        own = [self._own(name) for name in self.names]
        cells = np.concatenate(own)
        group = np.repeat(np.arange(len(own)), [len(each) for each in own])
        gathered = self.comm.gather((self.middles[cells], self.volume[cells], group))
        found = None
        if gathered is not None:
            middles, volume, groups = (np.concatenate(each) for each in zip(*gathered, strict=True))
            found = partition(middles, volume, groups, self.names, ["all"] * len(own), _PATCHES)
            parts = [self.part[name] for name in found[2]]
            found = _by_part(found[0], np.array(found[3]), parts, [len(g[0]) for g in gathered])
        number, middle, counts = self.comm.bcast(found)
        number = number[self.comm.rank]
        losses, first = [], 0
        for part, count in counts.items():
            nominal = self.full.parameters[f"{part}.E"].value
            losses.append(
                LocalLoss(
                    f"{LOSS} {part}",
                    part,
                    [cells[number == first + i] for i in range(count)],
                    {
                        "depth": f"{LOSS}.depth",
                        "place": f"{LOSS}.place",
                        "size": f"{LOSS}.size",
                        "E": f"{part}.E",
                        "nominal": nominal,
                        "first": float(first),
                        "count": float(count),
                    },
                )
            )
            first += count
        return losses, middle

    # -- plates --------------------------------------------------------------------------------

    def _box(self, names: Sequence[str], ways: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Least and largest coordinates of groups of cells along directions, and their volume."""
        own = np.concatenate([self._own(name) for name in names])
        along = self.corners[own].reshape(-1, 3) @ ways.T
        low, high = along.min(axis=0, initial=np.inf), along.max(axis=0, initial=-np.inf)
        ends = self.comm.allgather((low, high, float(self.volume[own].sum())))
        return (
            np.min([e[0] for e in ends], axis=0),
            np.max([e[1] for e in ends], axis=0),
            sum(e[2] for e in ends),
        )

    def _ways(self, part: str) -> np.ndarray:
        """Normal of a part, its length and its width, as rows."""
        section = self.case.parts[part]
        n = np.asarray(section.normal, dtype=float)
        n /= np.linalg.norm(n)
        a = np.asarray(section.widens(), dtype=float)
        a -= (a @ n) * n
        a /= np.linalg.norm(a)
        return np.array([n, np.cross(a, n), a])

    def _shape(
        self,
        parameter: str,
        ways: np.ndarray,
        bend: tuple[float, float, float],
        across: np.ndarray,
        most: float,
        own: str = "",
    ) -> Iterator[ShapeChange]:
        """What a parameter of the shape changes in every part.

        Args:
            parameter: The parameter.
            ways: Normal of the plate and the direction along which it changes, as rows.
            bend: See `ShapeChange`.
            across: Likewise.
            most: Likewise, ``largest``.
            own: The part whose mass and thickness change; none of a bow.
        """
        normal, along = map(tuple, ways)
        for part in self.case.parts:
            E, rho = (self.full.parameters[f"{part}.{key}"].value for key in ("E", "rho"))
            amount = {
                "amount": parameter,
                "E": f"{part}.E",
                "nominal": E,
                "rho": f"{part}.rho" if part == own else rho,
                "nominal_rho": rho,
                "count": float(_DEGREE if part == own else 2),
            }
            yield ShapeChange(
                f"{parameter} {part}", part, normal, along, bend, across, most, amount
            )

    def bowed(self) -> tuple[tuple[Plate, ...], list[ShapeChange]]:
        """Directions in which the whole may be bowed, by the height of the bow, m."""
        every = [self._ways(part) for part in self.case.parts]
        ways = every[0]
        if any(abs(w[0] @ ways[0]) < 1 - 1e-6 for w in every):
            return (), []
        low, high, _ = self._box(self.names, ways)
        size, plates, changes = high - low, [], []
        evenly = np.array([np.ones(len(self.corners)), np.zeros(len(self.corners))])
        for i, how in ((1, "along"), (2, "across")):
            if size[i] < _SLENDER * size[0]:
                continue
            middle, L, name = 0.5 * (low[i] + high[i]), float(size[i]), f"{BOW}.{how}"
            plates.append(Plate("the structure", "", name, L, how))
            bend = 1 - 4 * middle**2 / L**2, 8 * middle / L**2, -4 / L**2
            changes += self._shape(name, ways[[0, i]], bend, evenly, MOST_BOW * L)
        return tuple(plates), changes

    def tapered(self, dimensions) -> tuple[tuple[Plate, ...], list[ShapeChange]]:
        """Plates whose thickness may change evenly along their length, by half the difference of
        the ends' over their mean. What lies on one tilts."""
        plates, changes = [], []
        for name in self.names:
            part = self.part[name]
            if unfit(dimensions, [f"{part}.thickness"]) is not None:
                continue
            ways = self._ways(part)
            low, high, volume = self._box([name], ways)
            size = high - low
            i = 1 + int(size[2] > size[1] * (1 + 1e-6))
            if size[i] < _SLENDER * size[0] or volume < _FULL * np.prod(size):
                continue
            parameter, L = f"{TAPER}.{name}", float(size[i])
            shown = part if len(self.case.parts[part].cells) == 1 else f"{part}, {name}"
            plates.append(Plate(shown, part, parameter, L))
            middle, height = 0.5 * (low + high), self.middles @ ways[0]
            half, above = 0.5 * size[0], height > 0.5 * (low[0] + high[0])
            across = np.array([np.where(above, half, -half), np.zeros(len(height))])
            across[:, self.cells[name]] = [[-middle[0]], [1.0]]
            bend = -2 * middle[i] / L, 2 / L, 0.0
            changes += self._shape(parameter, ways[[0, i]], bend, across, MOST_TAPER, own=part)
        return tuple(plates), changes


def _far_apart(points: np.ndarray, count: int) -> np.ndarray:
    """The point farthest from the middle, and those farthest from it and from each other, (count,
    3)."""
    chosen, away = [], np.linalg.norm(points - points.mean(axis=0), axis=1)
    while len(chosen) < min(count, len(points)):
        # Rounded, so that round-off does not choose between places that are as far.
        away = np.round(away / max(float(away.max()), 1e-300), 6)
        chosen.append(points[int(np.argmax(away))])
        away = np.min([np.linalg.norm(points - x, axis=1) for x in chosen], axis=0)
    return np.array(chosen)


def _tour(points: np.ndarray) -> list[int]:
    """An order in which neighbours are near: from an end always to the nearest that is left."""
    if len(points) < 3:
        return list(range(len(points)))
    away = np.linalg.norm(points - points.mean(axis=0), axis=1)
    order, left = [int(np.argmax(np.round(away / away.max(), 6)))], set(range(len(points)))
    left.remove(order[0])
    while left:
        rest = sorted(left)
        distance = np.linalg.norm(points[rest] - points[order[-1]], axis=1)
        order.append(rest[int(np.argmin(np.round(distance / away.max(), 6)))])
        left.remove(order[-1])
    return order


def _by_part(number, middle, parts: Sequence[str], sizes: Sequence[int]):
    """Patches numbered part by part along a tour of each.

    Returns:
        Number of each cell by rank; middles in this order; how many there are of each part.
    """
    order, counts = [], {}
    for part in dict.fromkeys(parts):
        own = np.flatnonzero(np.array(parts) == part)
        order += own[_tour(middle[own])].tolist()
        counts[part] = len(own)
    rank = np.empty(len(order), dtype=int)
    rank[order] = np.arange(len(order))
    return np.split(rank[number], np.cumsum(sizes)[:-1]), middle[order], counts


#: Prefixes of the parameters of what is attached.
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
    # A rotation must be free of strain in the elements too. And without sensors modes are counted:
    # the rigid motions of a body that is off by a little would be counted with the elastic ones.
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

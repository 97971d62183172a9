"""Size of a contact patch from a pressure that is linear between the vertices of its facets."""

from __future__ import annotations

import numpy as np

from fenics_joints.structure.faces import Interface, frames


def _edges(interface: Interface) -> np.ndarray:
    """Pairs at the ends of the facets' edges, (n, 2)."""
    f = interface.facets
    k = f.shape[1]
    around = {2: [(0, 1)], 3: [(0, 1), (1, 2), (2, 0)], 4: [(0, 1), (1, 3), (3, 2), (2, 0)]}[k]
    return np.unique(np.sort(np.vstack([f[:, list(e)] for e in around]), axis=1), axis=0)


def _mean_axis(normals: np.ndarray) -> np.ndarray:
    axis = normals.mean(axis=0)
    return axis / np.linalg.norm(axis)


def radii(points: np.ndarray, normals: np.ndarray, centre) -> np.ndarray:
    """Distances of points from an axis through ``centre`` along the mean normal."""
    arm = points - (0.0 if centre is None else np.asarray(centre, dtype=float))
    axis = _mean_axis(normals)
    return np.linalg.norm(arm - (arm @ axis)[:, None] * axis, axis=1)


def largest_radius(interface: Interface, pressure: np.ndarray, limit: float, centre=None) -> float:
    """Largest distance, m, from the centre at which the pressure reaches the limit; 0 if nowhere.

    Args:
        interface: The pairs.
        pressure: Pressure at the pairs, Pa, (n,).
        limit: Limit, Pa.
        centre: Centre, m, (gdim,); the origin by default.
    """
    radius = radii(interface.points, interface.normals, centre)
    above = pressure >= limit if limit > 0 else pressure > 0
    best = float(radius[above].max(initial=0.0))
    a, b = _edges(interface).T
    cross = above[a] != above[b]
    a, b = a[cross], b[cross]
    t = ((limit - pressure[a]) / (pressure[b] - pressure[a]))[:, None]
    points = (1 - t) * interface.points[a] + t * interface.points[b]
    return max(best, float(radii(points, interface.normals, centre).max(initial=0.0)))


def nearest_axis(points: np.ndarray, axes) -> np.ndarray:
    """Number of the axis nearest to each point, (n,); axes by a point on each, (k, gdim), m."""
    return np.argmin([np.linalg.norm(points - axis, axis=1) for axis in axes], axis=0)


def equal_radius(
    interface: Interface, pressure: np.ndarray, limit: float, centre
) -> tuple[float, float, float]:
    """Radius, m, of the circle around a hole with the area where the pressure is at least the
    limit, and the least and largest radius within the mesh's resolution; zeros if there is none.

    The hole, round the axis through ``centre``, ends at the nearest pair. Of an axis on a plane of
    symmetry the circle is the part that the pairs go round it. The pressure is only known at the
    vertices: the least area has the facets with the limit at all vertices, the largest also those
    with the limit at one vertex.

    Args:
        interface: The pairs, of a contact in space.
        pressure: Pressure at the pairs, Pa, (n,).
        limit: Limit, Pa, > 0.
        centre: A point on the axis, m, (3,).
    """
    above = pressure >= limit
    if not above.any():
        return 0.0, 0.0, 0.0
    arm = interface.points - np.asarray(centre, dtype=float)
    _, first, second = frames(_mean_axis(interface.normals)[None])[0]
    x, y = arm @ first, arm @ second
    away = np.hypot(x, y)
    hole = away.min()
    angles = np.sort(np.arctan2(y, x)[away > 1e-6 * away.max()])
    gap = np.diff(angles, append=angles[0] + 2 * np.pi).max()
    share = 1.0 if gap < 0.5 * np.pi else 1.0 - gap / (2 * np.pi)
    at, whole = above[interface.facets], interface.shares.sum(axis=1)
    areas = (
        contour_area(interface, pressure, limit)[0],
        whole[at.all(axis=1)].sum(),
        whole[at.any(axis=1)].sum(),
    )
    return tuple(float(np.sqrt(area / (np.pi * share) + hole**2)) for area in areas)


def contour_area(interface: Interface, pressure: np.ndarray, limit: float):
    """Area in which the pressure is at least the limit, and its derivative.

    Quadrilaterals are cut into two triangles, and facets' areas scaled to their measure.

    Returns:
        Area, m2, and its derivative by the pressure at each pair, m2/Pa, (n,).
    """
    slope = np.zeros(len(interface))
    total = 0.0
    for simplex, measure in _simplices(interface):
        p = pressure[simplex] - limit
        share, d_share = _share_above(p)
        total += float(np.sum(measure * share))
        np.add.at(slope, simplex, measure[:, None] * d_share)
    return total, slope


def _simplices(interface: Interface):
    """Segments or triangles with their measure, the facets' own where they are simplices."""
    facets = interface.facets
    measure = interface.shares.sum(axis=1)
    if facets.shape[1] < 4:
        yield facets, measure
        return
    halves = [facets[:, [0, 1, 3]], facets[:, [0, 3, 2]]]
    areas = [_triangle(interface.points[h]) for h in halves]
    scale = measure / np.where(areas[0] + areas[1] > 0, areas[0] + areas[1], 1.0)
    for half, area in zip(halves, areas, strict=True):
        yield half, area * scale


def _triangle(x: np.ndarray) -> np.ndarray:
    return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)


def cut_corners(d: np.ndarray):
    """Simplices of which one vertex lies apart from the others, where linear d >= 0 or where not.

    Args:
        d: Values at the vertices, (n, k).

    Yields:
        Rows of such simplices; that vertex of each, (m,), and the others, (m, k - 1); shares of the
        edges from it that are on its side, (m, k - 1); whether its corner is where d < 0.
    """
    above, k = d >= 0, d.shape[1]
    count = above.sum(axis=1)
    for mark, chosen, below in ((above, count == 1, False), (~above, count == k - 1, True)):
        rows = np.flatnonzero(chosen & (k > 2 or not below))
        lone = np.argmax(mark[rows], axis=1)
        others = np.array([[j for j in range(k) if j != i] for i in range(k)])[lone]
        d0 = d[rows, lone][:, None]
        yield rows, lone, others, d0 / (d0 - d[rows[:, None], others]), below


def _share_above(p: np.ndarray):
    """Share of simplices where a linear function with vertex values p is >= 0, and slope by p."""
    share, slope = (p >= 0).all(axis=1).astype(float), np.zeros(p.shape)
    for rows, lone, others, t, below in cut_corners(p):
        # The corner cut off there is prod p0 / (p0 - pj).
        corner, sign = t.prod(axis=1), -1.0 if below else 1.0
        p0, pj = p[rows, lone][:, None], p[rows[:, None], others]
        rest = t[:, ::-1] if p.shape[1] == 3 else np.ones_like(t)
        share[rows] = 1 - corner if below else corner
        slope[rows, lone] = sign * (rest * -pj / (p0 - pj) ** 2).sum(axis=1)
        slope[rows[:, None], others] = sign * rest * p0 / (p0 - pj) ** 2
    return share, slope


def mean_within(interface: Interface, pressure: np.ndarray, radius: float, centre=None) -> float:
    """Mean pressure, Pa, of the facets within a radius; those cut count by their share inside."""
    distance = radius - radii(interface.points, interface.normals, centre)
    force = area = 0.0
    for simplex, measure in _simplices(interface):
        share, _ = _share_above(distance[simplex])
        d, p = distance[simplex], pressure[simplex]
        force += float(np.sum(measure * _moment_above(d, p)))
        area += float(np.sum(measure * share))
    return force / area if area > 0 else 0.0


def _moment_above(d: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Integral of a linear p over the part of each simplex where linear d >= 0, per measure."""
    whole = p.mean(axis=1)
    result = np.where((d >= 0).all(axis=1), whole, 0.0)
    for rows, lone, others, t, below in cut_corners(d):
        p0, pj = p[rows, lone][:, None], p[rows[:, None], others]
        cut = p0 + t * (pj - p0)
        corner = t.prod(axis=1) * (p0[:, 0] + cut.sum(axis=1)) / d.shape[1]
        result[rows] = whole[rows] - corner if below else corner
    return result

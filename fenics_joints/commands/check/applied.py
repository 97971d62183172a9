"""Where obstacles, displacements and loads act, for the table and the picture of places."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from fenics_joints.case import Case
from fenics_joints.commands.check.places import Place
from fenics_joints.errors import InputError


def applied_places(case: Case, centres: Mapping[str, np.ndarray], gdim: int) -> list[Place]:
    """Of each the middle of its face; of an obstacle where it is nearest to that.

    Args:
        case: The case.
        centres: Of the mesh's named faces, m, shape (3,).
        gdim: Dimensions of the mesh.
    """
    return list(_places(case, centres, gdim))


def _places(case: Case, centres: Mapping[str, np.ndarray], gdim: int) -> Iterator[Place]:
    for name, obstacle in case.obstacles.items():
        if obstacle.facets in centres:
            yield from _nearest(name, obstacle, centres[obstacle.facets][:gdim], gdim)
    ways = [("displacement", case.displacements, "value"), ("load", case.loads, "force")]
    for kind, table, key in ways:
        for name, section in table.items():
            way = np.array([v or 0.0 for v in getattr(section, key) or ()])
            if section.facets in centres:
                at = _three(centres[section.facets])
                unit = _three(way / np.linalg.norm(way)) if way.any() else None
                yield Place(kind, name, at, unit)


def _nearest(name: str, obstacle, centre: np.ndarray, gdim: int) -> Iterator[Place]:
    try:
        shape = obstacle.shape(f"obstacles.{name}", gdim)
    except InputError:
        return  # said where the model is made
    distance, normal = shape(centre[None])
    yield Place("obstacle", name, _three(centre - distance[0] * normal[0]), _three(normal[0]))


def _three(vector) -> tuple[float, ...]:
    return (*map(float, vector), 0.0)[:3]

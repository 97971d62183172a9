"""Bodies that do not give way: planes, balls and cylinders that a face can touch.

Each is a function from positions, (n, gdim), to distances, m, (n,), negative inside it, and
outward unit normals there, (n, gdim).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, direction, flag, real, reals


@dataclass(frozen=True)
class Plane:
    """A plane, solid behind it.

    Attributes:
        point: A point of it, m, (gdim,).
        normal: Its normal, away from the solid, (gdim,).
    """

    point: tuple[float, ...]
    normal: tuple[float, ...]

    def __post_init__(self):
        reals("plane.point", self.point, (None,), "m")
        direction("plane.normal", self.normal)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normal = np.asarray(self.normal, dtype=float)
        normal = normal / np.linalg.norm(normal)
        return (x - np.asarray(self.point)) @ normal, np.broadcast_to(normal, x.shape).copy()


@dataclass(frozen=True)
class Sphere:
    """A ball; in two dimensions a disc, and with ``inside`` the hole of one.

    Attributes:
        centre: Its centre, m, (gdim,).
        radius: Its radius, m.
        inside: Whether the body lies within the sphere, which is a cavity.
    """

    centre: tuple[float, ...]
    radius: float
    inside: bool = False

    def __post_init__(self):
        reals("sphere.centre", self.centre, (None,), "m")
        real("sphere.radius", self.radius, "m", above=0)
        flag("sphere.inside", self.inside)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _round(x - np.asarray(self.centre, dtype=float), self.radius, self.inside)


@dataclass(frozen=True)
class Cylinder:
    """A round pin without ends, in three dimensions, and with ``inside`` the bore of one.

    Attributes:
        point: A point of its axis, m, (3,).
        axis: Direction of its axis, (3,).
        radius: Its radius, m.
        inside: Whether the body lies within the cylinder, which is a bore.
    """

    point: tuple[float, ...]
    axis: tuple[float, ...]
    radius: float
    inside: bool = False

    def __post_init__(self):
        reals("cylinder.point", self.point, (3,), "m")
        direction("cylinder.axis", self.axis)
        real("cylinder.radius", self.radius, "m", above=0)
        flag("cylinder.inside", self.inside)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        axis = np.asarray(self.axis, dtype=float)
        axis = axis / np.linalg.norm(axis)
        arm = x - np.asarray(self.point, dtype=float)
        return _round(arm - np.outer(arm @ axis, axis), self.radius, self.inside)


def _round(arm: np.ndarray, radius: float, inside: bool) -> tuple[np.ndarray, np.ndarray]:
    """Distances and normals from what lies at a radius from the arms' start."""
    length = np.linalg.norm(arm, axis=1)
    normal = arm / np.where(length > 0, length, 1.0)[:, None]
    return (radius - length, -normal) if inside else (length - radius, normal)


def checked_shape(name: str, shape: Callable) -> Callable:
    """The function, which refuses to return other arrays than distances and normals."""

    def checked(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance, normal = (np.asarray(q, dtype=float) for q in shape(x))
        if distance.shape != x.shape[:1] or normal.shape != x.shape:
            raise InputError(
                f"{name}: expected distances, ({len(x)},), and normals, {x.shape}; got "
                f"{distance.shape} and {normal.shape}."
            )
        return distance, normal

    return checked

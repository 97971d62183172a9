"""The view of mode shapes, with what a test measured beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from fenics_joints.report.mesh_pictures import diverging
from fenics_joints.report.surface import Surface, surface
from fenics_joints.report.view import Arrows, Colours, Look, scene

_TEST, _MODEL = "#009e73", "#e69f00"


def modes_view(
    vertices: np.ndarray,
    motions: Sequence[np.ndarray],
    names: Sequence[str],
    ways: Sequence[np.ndarray],
    arrows: Mapping[int, Sequence[Arrows]],
    notes: Mapping[int, str],
) -> Markup:
    """Mode shapes to turn and to play.

    Args:
        vertices: Corners of all cells, m, (n_cells, n_corners, 3).
        motions: How they move in each mode, each as ``vertices``.
        names: Of the modes.
        ways: Direction that is coloured in each, (3,).
        arrows: What stands beside a mode, by its place in ``motions``.
        notes: What is said of a mode, likewise.
    """

    def looks(s: Surface) -> list[Look]:
        return [
            Look(
                name,
                Colours(diverging, "one way", "the other", f"motion along {_words(way)}"),
                motion=motion.reshape(-1, 3)[s.pick],
                way=way,
                arrows=arrows.get(i, ()),
                note=notes.get(i, "Motion is enlarged; its scale is arbitrary."),
            )
            for i, (name, motion, way) in enumerate(zip(names, motions, ways, strict=True))
        ]

    whole = surface(vertices, motions=motions)
    return scene(whole, looks, f"Mode shapes in three dimensions: {', '.join(names)}.")


def _words(way: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(way)))
    if abs(way[axis]) > 0.999:
        return "xyz"[axis]
    return f"({', '.join(f'{c:.2g}' for c in way)})"


def measured_arrows(sensors, test: np.ndarray, model: np.ndarray) -> tuple[Arrows, Arrows]:
    """What a test measured of a mode at its sensors, and the model's, as arrows from each point.

    Sensors at one point that measure in several directions have one arrow.

    Args:
        sensors: Points and directions, k of them.
        test: Measured components, (k,), nan where a sensor was missing; in the model's scale.
        model: The model's, (k,).
    """
    points, place = np.unique(np.round(sensors.points, 9), axis=0, return_inverse=True)
    pair = []
    for name, values, colour, ball in (
        ("measured", test, _TEST, True),
        ("model at the sensors", model, _MODEL, False),
    ):
        vectors = np.zeros_like(points)
        np.add.at(vectors, place.ravel(), np.nan_to_num(values)[:, None] * sensors.directions)
        pair.append(Arrows(name, colour, points, vectors, ball))
    return tuple(pair)

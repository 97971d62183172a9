"""Shapes as a test measured them, at its sensors, beside those of a model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import PolyCollection

from fenics_joints.report import geometry
from fenics_joints.report.style import drawing, to_svg

_TEST, _MODEL = "#1f4e9c", "#d1661f"
#: Length of the longest arrow relative to the size of the structure.
_LONG = 0.18


def sensor_shapes(
    vertices: np.ndarray,
    sensors,
    test: np.ndarray,
    model: np.ndarray,
    name: str,
    alt: str,
    lines: Sequence[np.ndarray] = (),
) -> str:
    """Arrows of a measured shape and of its partner at the sensors, over the model's outline.

    Args:
        vertices: Corner coordinates of every cell, m, shape (n_cells, n_corners, 3).
        sensors: Points and directions, `fenics_joints.structure.Sensors`.
        test: Measured components, shape (n,); nan where a sensor was missing.
        model: The model's in the same scale, shape (n,).
        name: Unique in the page.
        alt: What it shows, in words.
        lines: Points, m, of lines that the test draws, each (k, 3).
    """
    vertices = np.asarray(vertices, dtype=float)
    faces, _ = geometry.outer_faces(vertices, np.zeros_like(vertices))
    flat, depth = geometry.oblique(faces)
    size = float(np.ptp(vertices.reshape(-1, 3), axis=0).max())
    largest = float(np.nanmax(np.abs([test, model]))) or 1.0
    start = _flat(sensors.points)
    with drawing(3.7, 1.75) as figure:
        axes = figure.subplots()
        axes.add_collection(
            PolyCollection(
                flat[np.argsort(depth)],
                facecolors="#eef0f3",
                edgecolors="#d3d7dd",
                lw=0.2,
                rasterized=True,
            )
        )
        for line in lines:
            axes.plot(*_flat(line).T, "-", lw=0.5, color="#8a9099")
        for values, colour, width in ((model, _MODEL, 0.011), (test, _TEST, 0.005)):
            arrows = _LONG * size / largest * values[:, None] * sensors.directions
            along = _flat(sensors.points + np.nan_to_num(arrows)) - start
            axes.quiver(
                *start.T,
                *along.T,
                color=colour,
                angles="xy",
                scale_units="xy",
                scale=1,
                width=width,
                headwidth=3,
            )
            # Arrows do not count for the limits of the axes, points do.
            axes.plot(*(start + along).T, ".", ms=0)
        axes.autoscale_view()
        axes.margins(0.04)
        axes.set_aspect("equal")
        axes.set_axis_off()
        return to_svg(figure, name, alt, dpi=130)


def _flat(points: np.ndarray) -> np.ndarray:
    """Points in the oblique view, (n, 2)."""
    return geometry.oblique(np.asarray(points, dtype=float)[:, None, :])[0][:, 0]

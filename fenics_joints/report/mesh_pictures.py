"""Mode shapes: as pictures, as a view, and beside what a test measured at its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize

from fenics_joints.measurements.gap import mac
from fenics_joints.report import geometry
from fenics_joints.report.document import Beside, Figure, View
from fenics_joints.report.style import drawing, to_svg
from fenics_joints.report.surface import Surface, surface
from fenics_joints.report.view import Arrows, Colours, SurfaceView, scene
from fenics_joints.structure.points import Sensors

#: Red to blue through near white, which all kinds of colour vision tell apart.
diverging = colormaps["RdBu_r"]
#: Colours of a test and of a model, in pictures and in views.
_TEST, _MODEL, _TEST_VIEW, _MODEL_VIEW = "#1f4e9c", "#d1661f", "#009e73", "#e69f00"
#: Length of the longest arrow relative to the size of the structure.
_LONG = 0.18


def draw_faces(axes, flat: np.ndarray, colours, edges: str) -> None:
    """Draw faces, (n, k, 2), the first ones behind, as pixels."""
    axes.add_collection(
        PolyCollection(flat, facecolors=colours, edgecolors=edges, lw=0.2, rasterized=True)
    )


def draw_arrows(
    axes, start: np.ndarray, along: np.ndarray, colour: str, width: float, head: float
) -> None:
    """Draw arrows from points, (n, 2), and let the axes reach to their ends."""
    how = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": width, "headwidth": head}
    axes.quiver(*start.T, *along.T, color=colour, zorder=5, **how)
    # Arrows do not count for the limits of the axes, points do.
    axes.plot(*(start + along).T, ".", ms=0)


def bare(axes, margin: float | None = None) -> None:
    """Show what was drawn in equal scales and without axes."""
    axes.autoscale_view()
    if margin is not None:
        axes.margins(margin)
    axes.set_aspect("equal")
    axes.set_axis_off()


def mode_shape(
    vertices: np.ndarray, motion: np.ndarray, direction: Sequence[float], name: str, alt: str
) -> str:
    """A mode shape in an oblique view, coloured by the motion along a direction.

    Args:
        vertices: Corner coordinates of every cell, m, shape (n_cells, n_corners, 3).
        motion: Displacement of the corners, any scale, same shape.
        direction: Direction that is coloured; the test's.
        name: Unique in the page.
        alt: What it shows, in words.

    Raises:
        InputError: If cells have a shape that the suite does not use.
    """
    faces, moved = geometry.outer_faces(
        np.asarray(vertices, dtype=float), np.asarray(motion, dtype=float)
    )
    size = np.ptp(faces.reshape(-1, 3), axis=0).max()
    largest = np.linalg.norm(moved, axis=-1).max() or 1.0
    shown = faces + 0.07 * size / largest * moved
    flat, depth = geometry.oblique(shown)
    unit = np.asarray(direction, dtype=float)
    value = (moved @ (unit / np.linalg.norm(unit))).mean(axis=1)
    scale = np.abs(value).max() or 1.0
    order = np.argsort(depth)
    colours = diverging(Normalize(-1, 1)(value[order] / scale))
    with drawing(3.7, 1.75) as figure:
        axes = figure.subplots()
        draw_faces(axes, flat[order], colours, "#4a4f57")
        bare(axes)
        return to_svg(figure, name, alt, dpi=130)


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
    start = geometry.oblique_points(sensors.points)
    with drawing(3.7, 1.75) as figure:
        axes = figure.subplots()
        draw_faces(axes, flat[np.argsort(depth)], "#eef0f3", "#d3d7dd")
        for line in lines:
            axes.plot(*geometry.oblique_points(line).T, "-", lw=0.5, color="#8a9099")
        for values, colour, width in ((model, _MODEL, 0.011), (test, _TEST, 0.005)):
            arrows = _LONG * size / largest * values[:, None] * sensors.directions
            along = geometry.oblique_points(sensors.points + np.nan_to_num(arrows)) - start
            draw_arrows(axes, start, along, colour, width, 3)
        bare(axes, 0.04)
        return to_svg(figure, name, alt, dpi=130)


@dataclass(frozen=True, repr=False)
class Shape:
    """A mode shape as a page shows it.

    Attributes:
        title: Such as ``mode 7, 123.40 Hz``.
        motion: How the corners of all cells move, any scale, (n_cells, n_corners, 3).
        way: Direction that is coloured, (3,).
        at_sensors: The same motion at the sensors of the measured shapes, (k,); None without any.
        match: Which measured shape it belongs to; None for none.
    """

    title: str
    motion: np.ndarray
    way: np.ndarray
    at_sensors: np.ndarray | None = None
    match: int | None = None


@dataclass(frozen=True, repr=False)
class MeasuredModes:
    """Shapes that a test measured, to see them at the model's.

    Attributes:
        names: Of the modes, m of them.
        sensors: Where and in which direction, `fenics_joints.structure.Sensors`, k of them.
        shapes: Components, (k, m), nan where a sensor was missing.
    """

    names: Sequence[str]
    sensors: Sensors
    shapes: np.ndarray

    def scales(self, model: np.ndarray) -> list[float]:
        """What brings each shape to the length and sign of a model's at the sensors, (k,)."""
        known, there = np.nan_to_num(self.shapes), ~np.isnan(self.shapes)
        size = np.maximum(np.sum(known**2, axis=0), 1e-300)
        length = np.sqrt(np.sum(there * model[:, None] ** 2, axis=0) / size)
        return (length * np.where(known.T @ model < 0, -1.0, 1.0)).tolist()


def shapes_view(
    vertices: np.ndarray,
    shapes: Sequence[Shape],
    stills: int,
    more: Sequence[object] = (),
    *,
    measured: MeasuredModes | None = None,
    parts: tuple[Sequence[str], np.ndarray] | None = None,
) -> View:
    """Mode shapes to turn and to play; for paper, pictures of the first ones.

    Args:
        vertices: Corners of all cells, m, (n_cells, n_corners, 3).
        shapes: The shapes.
        stills: How many have a picture.
        more: Blocks below the pictures.
        measured: Measured shapes to see beside each of the model's.
        parts: Names of parts, and the number of the part of each cell, (n_cells,); None for one.
    """

    def looks(s: Surface) -> list[SurfaceView]:
        return [_look(shape, s, measured) for shape in shapes]

    names, level = parts or ((), None)
    whole = surface(vertices, level=level, motions=[shape.motion for shape in shapes])
    figures = []
    for k, shape in enumerate(shapes[:stills]):
        alt = f"Mode shape of {shape.title}, coloured by its motion along {shape.way.tolist()}."
        drawn = mode_shape(vertices, shape.motion, shape.way, f"shape{k}", alt)
        figures.append(Figure(drawn, shape.title))
    words = ", ".join(shape.title for shape in shapes)
    tests: list[Arrows] = []
    if measured is not None:
        look = {"colour": _TEST_VIEW, "ball": True}
        for name, values in zip(measured.names, measured.shapes.T, strict=True):
            tests.append(sensor_arrows(name, measured.sensors, values, **look))
    name = f"Mode shapes in three dimensions: {words}."
    view = scene(whole, looks, name, parts=names, tests=tests)
    return View(view, [Beside("shapes", figures), *more])


def _look(shape: Shape, s: Surface, measured: MeasuredModes | None) -> SurfaceView:
    more: dict[str, object] = {}
    if measured is not None and shape.at_sensors is not None:
        model = np.asarray(shape.at_sensors, dtype=float)
        arrows = sensor_arrows("model at the sensors", measured.sensors, model, _MODEL_VIEW)
        more = {"arrows": [arrows], "match": shape.match, "scales": measured.scales(model)}
        more["mac"] = mac(measured.shapes, model[:, None])[:, 0].tolist()
    words = f"motion along {_direction_words(shape.way)}"
    return SurfaceView(
        shape.title,
        Colours(diverging, "one way", "the other", words),
        motion=shape.motion.reshape(-1, 3)[s.pick],
        way=shape.way,
        note="Motion is enlarged; its scale is arbitrary.",
        **more,  # type: ignore[arg-type]
    )


def largest_axis(motion: np.ndarray) -> np.ndarray:
    """The axis along which corners, (..., 3), move most, as a unit vector."""
    return np.eye(3)[int(np.argmax(np.sum(motion**2, axis=(0, 1))))]


def _direction_words(way: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(way)))
    if abs(way[axis]) > 0.999:
        return "xyz"[axis]
    return f"({', '.join(f'{c:.2g}' for c in way)})"


def sensor_arrows(
    name: str, sensors: Sensors, values: np.ndarray, colour: str, ball: bool = False
) -> Arrows:
    """Arrows of a mode at the sensors; those at one point in several directions have one arrow.

    Args:
        name: Whose they are.
        sensors: Points and directions, k of them.
        values: Components, (k,), nan where a sensor was missing.
        colour: Of CSS.
        ball: Whether they end in a ball instead of a tip.
    """
    points, place = np.unique(np.round(sensors.points, 9), axis=0, return_inverse=True)
    vectors = np.zeros_like(points)
    np.add.at(vectors, place.ravel(), np.nan_to_num(values)[:, None] * sensors.directions)
    return Arrows(name, colour, points, vectors, ball)

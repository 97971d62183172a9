"""The picture of the demo: the frame, its mode shapes, the derivatives by bolt, and the curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure

#: Corners of the faces of a hexahedron, numbered as in DOLFINx, in order around each face.
FACES = np.array(
    [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
)
#: Direction of view: from the front (-y), rotated to the right, and from above.
TURN, TILT = np.radians(-32.0), np.radians(24.0)
CASTINGS, RINGS = ("#b9c3cf", "#d9dee4"), "#c8322b"
LIFT = 0.22  # how far the column is lifted in the first panel, m


@dataclass
class Story:
    """Results of the demo.

    Attributes:
        corners: Corners of all cells, m, shape (n_cells, 8, 3).
        part: Part of each cell: 0 for the bed, 1 for the column, 2 for rings.
        motions: Displacement of the corners in each mode, shape (5, n_cells, 8, 3).
        hz: Frequencies, Hz, shape (5,).
        bolts: Positions of the bolts, m, shape (16, 2).
        by_E: d ln f / d ln E, shape (5, 16).
        exact: Relative change of f by one loose bolt, shape (16, 5).
        foretold: The same as predicted by the derivatives.
        over_E: Factors on E, shape (n,), and the frequencies, Hz, shape (n, 5).
        over_h: The same for h.
    """

    corners: np.ndarray
    part: np.ndarray
    motions: np.ndarray
    hz: np.ndarray
    bolts: np.ndarray
    by_E: np.ndarray
    exact: np.ndarray
    foretold: np.ndarray
    over_E: tuple[np.ndarray, np.ndarray]
    over_h: tuple[np.ndarray, np.ndarray]


def draw(story: Story, path: str, title: str) -> None:
    """Write the whole picture."""
    figure = Figure(figsize=(15, 17), layout="constrained")
    figure.suptitle(title, fontsize=13)
    frames, bolts, curves = figure.subfigures(3, 1, height_ratios=[2.0, 0.75, 0.95])
    panels = frames.subplots(2, 3).ravel()
    _taken_apart(panels[0], story)
    for i, axes in enumerate(panels[1:]):
        _shape(axes, story, i)
    _bolt_maps(bolts, story)
    _curves(curves, story)
    figure.savefig(path, dpi=80)


def _skin(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cell and face number of every face that belongs to one cell only."""
    whole = np.round(corners.reshape(-1, 3) / 1e-6).astype(np.int64)
    _, ids = np.unique(whole, axis=0, return_inverse=True)
    faces = np.sort(ids.reshape(corners.shape[:2])[:, FACES].reshape(-1, 4), axis=1)
    _, first, count = np.unique(faces, axis=0, return_index=True, return_counts=True)
    return np.divmod(first[count == 1], len(FACES))


def _paint(axes: Axes, corners, cell, face, colours) -> None:
    """Draw the faces that point to the viewer, far ones first, shaded by their direction."""
    right = np.array([np.cos(TURN), -np.sin(TURN), 0.0])
    into = np.array([np.sin(TURN), np.cos(TURN), 0.0]) * np.cos(TILT) - [0, 0, np.sin(TILT)]
    polygons = corners[cell[:, None], FACES[face]]
    middle = polygons.mean(axis=1)
    normal = np.cross(polygons[:, 2] - polygons[:, 0], polygons[:, 3] - polygons[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outwards = np.sum(normal * (middle - corners[cell].mean(axis=1)), axis=1)
    normal *= np.sign(outwards)[:, None]
    seen = np.flatnonzero(normal @ into < 0)
    seen = seen[np.argsort(-(middle[seen] @ into))]
    light = 0.72 + 0.28 * np.clip(normal[seen] @ np.array([0.25, -0.45, 0.86]), 0, 1)
    flat = np.stack([polygons @ right, polygons @ np.cross(right, into)], axis=-1)
    shaded = np.clip(colours[seen, :3] * light[:, None], 0, 1)
    axes.add_collection(
        PolyCollection(flat[seen], facecolors=shaded, edgecolors="#4a4f57", lw=0.25)
    )
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_axis_off()


def _taken_apart(axes: Axes, story: Story) -> None:
    parts = [np.flatnonzero(story.part == i) for i in range(3)]
    palette = np.array([to_rgba(c) for c in (*CASTINGS, RINGS)])
    corners, cells, faces, colours = story.corners.copy(), [], [], []
    corners[parts[1], :, 2] += LIFT
    for members in parts:
        # The surface of each body, as the faces of the rings are visible with the column lifted.
        cell, face = _skin(corners[members])
        cells.append(members[cell])
        faces.append(face)
        colours.append(palette[story.part[members[cell]]])
    _paint(axes, corners, *map(np.concatenate, (cells, faces, colours)))
    axes.set_title("stand-in, column lifted; rings in red")


def _shape(axes: Axes, story: Story, i: int) -> None:
    motion = story.motions[i]
    size = np.linalg.norm(motion, axis=-1)
    cell, face = _skin(story.corners)
    moved = story.corners + 0.14 / size.max() * motion
    value = size[cell[:, None], FACES[face]].mean(axis=1) / size.max()
    _paint(axes, moved, cell, face, colormaps["YlGnBu"](0.1 + 0.8 * value))
    axes.set_title(f"mode {i + 1}: {story.hz[i]:.1f} Hz")


def _bolt_maps(figure, story: Story) -> None:
    panels = figure.subplots(1, len(story.hz), sharey=True)
    x, y = 1e3 * story.bolts.T
    norm = Normalize(0, 1e3 * story.by_E.max())
    for i, axes in enumerate(panels):
        value = 1e3 * story.by_E[i]
        axes.scatter(x, y, s=620, c=value, cmap="OrRd", norm=norm, edgecolors="#4a4f57")
        for k in range(len(x)):
            dark = norm(value[k]) > 0.6
            axes.text(
                x[k],
                y[k],
                k + 1,
                ha="center",
                va="center",
                fontsize=9,
                color="white" if dark else "black",
            )
        axes.set(
            title=f"mode {i + 1}",
            aspect="equal",
            xlabel="x, mm",
            xlim=(-380, 380),
            ylim=(-380, 380),
        )
    panels[0].set_ylabel("y, mm (the bed goes on to -y)")
    bar = figure.colorbar(ScalarMappable(norm, "OrRd"), ax=panels, aspect=20)
    bar.set_label("d ln f / d ln E, 1e-3")
    figure.suptitle("Which bolts matter: the flange from above, one ring's modulus at a time")


def _curves(figure, story: Story) -> None:
    E, h, loose = figure.subplots(1, 3, width_ratios=[1, 0.8, 1.5])
    for i in range(len(story.hz)):
        factors, hz = story.over_E
        E.plot(factors, hz[:, i], f"C{i}", label=f"mode {i + 1}")
        factors, hz = story.over_h
        h.plot(factors, 100 * (hz[:, i] / story.hz[i] - 1), f"C{i}")
    for axes, name in ((E, "E"), (h, "h")):
        axes.axvline(1, color="0.6", lw=0.9, ls="--")
        axes.set(xlabel=f"{name} of all rings, times Table 11's")
    E.set(xscale="log", ylabel="frequency, Hz", ylim=(0, None))
    h.set(ylabel="change of the frequency, %")
    E.legend(fontsize=8)
    places = np.arange(len(story.bolts))
    for i in range(len(story.hz)):
        loose.bar(places + 1 + 0.16 * (i - 2), -100 * story.exact[:, i], 0.16, color=f"C{i}")
        loose.plot(places + 1 + 0.16 * (i - 2), -100 * story.foretold[:, i], "k_", ms=4)
    loose.set(
        xlabel="the loose bolt",
        ylabel="fall of the frequency, %",
        xticks=places + 1,
        title="one loose bolt (dashes: foretold by the slopes)",
    )

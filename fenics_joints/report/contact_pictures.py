"""Pictures of a contact in a preload state: pressure in plan, over the radius, and status.

Every connected patch of a contact's facets has a panel of its own. The pictures are matplotlib's
figures and need no display: ``figure.savefig("pressure.svg")``.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from scipy.sparse.csgraph import connected_components

from fenics_joints.errors import InputError
from fenics_joints.preload import OPEN, SLIP, STICK, ContactState
from fenics_joints.preload.patch import (
    contour_area,
    cut_corners,
    equal_radius,
    largest_radius,
    nearest_axis,
    radii,
)
from fenics_joints.report.style import CHOSEN, NOMINAL, PLACEBO, drawing, grid

#: Of lines over facets, which are pixels and keep their colours on a dark page.
_LINE, _MUTED, _APART = "#cf3f16", "#8d949e", "#eceef1"
_PRESSURE = colormaps["YlGnBu"]
_STATUS = {OPEN: ("open", "#c9ced5"), SLIP: ("slip", PLACEBO), STICK: ("stick", CHOSEN)}
#: Dashes of the circles, points.
_DASHES = (0, (4, 3))
#: Corners of a facet one after the other, by their number.
_AROUND = {3: [0, 1, 2], 4: [0, 1, 3, 2]}
#: Millimetres in a metre.
_MM = 1e3
#: Inches: width of a figure, most height of a row of panels.
_WIDTH, _MOST = 7.6, 3.6


@dataclass(frozen=True)
class _Patch:
    """One connected patch of a contact."""

    state: ContactState
    facets: np.ndarray  # its rows of the interface's facets
    pairs: np.ndarray  # its pairs
    centres: np.ndarray  # a point on each axis that goes through it, (k, gdim)
    title: str

    @property
    def pressure(self) -> np.ndarray:
        """Pressure at all pairs of the contact, zero at those of other patches."""
        pressure = np.zeros(len(self.state.interface))
        pressure[self.pairs] = self.state.pressure[self.pairs]
        return pressure

    def radii(self, limit: float, radius=largest_radius) -> list:
        """Contact radius about each axis, or another, by the pairs nearest to the axis."""
        nearest = nearest_axis(self.state.interface.points, self.centres)
        return [
            radius(self.state.interface, np.where(nearest == i, self.pressure, 0.0), limit, centre)
            for i, centre in enumerate(self.centres)
        ]

    def title_with(self, limit: float, between: str) -> str:
        """The title, what presses, and on what area of at least the limit."""
        force = float(self.state.force[self.pairs, 0].sum()) / 1e3
        area, c = contour_area(self.state.interface, self.pressure, limit)[0], self.state.interface
        if c.points.shape[1] == 2:
            ends = c.points[c.facets]
            lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
            # In plane strain, which has forces and areas per metre of depth.
            if np.allclose(self.state.facet_area, lengths, rtol=1e-6):
                return f"{self.title}{between}{force:.3g} kN/m, {area * _MM:.3g} mm"
        return f"{self.title}{between}{force:.3g} kN, {area * _MM**2:.0f} mm²"


def pressure_map(state: ContactState, *, limit: float = 1e6, centres=None) -> Figure:
    """Contact pressure over the interface in plan, with the contour and radius of a limit.

    Facets have the colour of their mean pressure, grey where they are open. The line is where the
    pressure, linear between the vertices, is at the limit; the dashed circles about the bolts' axes
    have, around the hole, the area within the line. Above each patch stand its force, this area,
    and the circles' radii.

    Args:
        state: A contact of a three-dimensional model, flat or nearly so.
        limit: Least pressure P_lim, Pa.
        centres: Bolts' axes on the interface, m, (n, 3); each belongs to the nearest patch, and a
            patch without an axis takes the nearest. By default each patch's centroid.

    Raises:
        InputError: For a contact in the plane, or centres of another shape.
    """
    _check(state, "pressure_map", limit)
    facet_pressure = state.facet_pressure / 1e6
    norm = Normalize(0.0, max(facet_pressure.max(), 1e-12))
    with _plan(state, centres) as (figure, plane, panels):
        for panel, patch in panels:
            value = facet_pressure[patch.facets]
            colours = np.where((value > 0)[:, None], _PRESSURE(norm(value)), to_rgba(_APART))
            _facets(panel, plane, state.interface.facets[patch.facets], colours)
            lines = _contour(plane.points, patch, limit)
            panel.add_collection(LineCollection(lines, colors=_LINE, lw=1.5, capstyle="round"))
            found = [r for r, _, _ in patch.radii(limit, equal_radius)]
            for radius, centre in zip(found, patch.centres, strict=True):
                if radius > 0:
                    middle, look = plane.at(centre[None])[0], {"fill": False, "lw": 1.1}
                    circle = Circle(middle, _MM * radius, ec=_LINE, ls=_DASHES, **look)
                    panel.add_patch(circle)
                    panel.plot(*middle, "+", color=_LINE, ms=6, mew=0.8)
            words = ", ".join(f"{_MM * radius:.1f}" for radius in found if radius > 0)
            reach = f", r = {words} mm" if words else ""
            panel.set_title(patch.title_with(limit, "\n") + reach, loc="left")
        beside = {"ax": [panel for panel, _ in panels], "aspect": 30, "pad": 0.02, "shrink": 0.9}
        bar = figure.colorbar(ScalarMappable(norm, _PRESSURE), **beside)
        bar.set_label("pressure, MPa")
        bar.outline.set_visible(False)
        handles = [
            Line2D([], [], color=_LINE, lw=1.5, label=_limit_name(limit)),
            Line2D([], [], color=_LINE, ls=_DASHES, lw=1.1, label="circle of equal area"),
            Patch(fc=_APART, label="open"),
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
    return figure


def status_map(state: ContactState, *, centres=None) -> Figure:
    """Which part of the interface is open, slips and sticks, in plan.

    The part of each facet that is nearest a vertex, and belongs to it, has that pair's colour.

    Args:
        state: A contact of a three-dimensional model, flat or nearly so.
        centres: As in `pressure_map`.

    Raises:
        InputError: For a contact in the plane, or centres of another shape.
    """
    _check(state, "status_map")
    with _plan(state, centres) as (figure, plane, panels):
        for panel, patch in panels:
            facets = state.interface.facets[patch.facets]
            corners, owner = _corners(plane.points, facets)
            colours = [_STATUS[kind][1] for kind in state.status[owner]]
            look = {"facecolors": colours, "edgecolors": colours, "lw": 0.3}
            panel.add_collection(PolyCollection(corners, rasterized=True, **look))
            _facets(panel, plane, facets, "none")
            panel.set_title(patch.title, loc="left")
        areas, handles = state.interface.areas, []
        for kind, (name, colour) in _STATUS.items():
            share = 100 * areas[state.status == kind].sum() / areas.sum()
            handles.append(Patch(fc=colour, label=f"{name}, {share:.0f} %"))
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
    return figure


def pressure_profile(
    state: ContactState, *, limit: float = 1e6, centres=None, direction=None
) -> Figure:
    """Pressure of all pairs over the distance from the bolt's axis, or along a direction.

    Args:
        state: A contact.
        limit: Least pressure P_lim, Pa, drawn with the contact radius that it gives.
        centres: As in `pressure_map`. In the plane the axis is the origin by default: r = 0.
        direction: Vector, (gdim,), along which positions are shown instead of the radius.

    Raises:
        InputError: For centres or a direction of another shape.
    """
    _check(state, limit=limit)
    along = _direction(state, direction)
    patches = _patches(state, centres)
    with drawing(_WIDTH, 2.4 * len(patches) + 0.5) as figure:
        figure.set_facecolor("white")
        panels = figure.subplots(len(patches), 1, sharex=along is None, squeeze=False).ravel()
        for panel, patch in zip(panels, patches, strict=True):
            _profile(panel, patch, limit, along)
        panels[-1].set_xlabel("distance from the axis, mm" if along is None else "position, mm")
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper left", ncols=4)
    return figure


def _distances(patch: _Patch) -> np.ndarray:
    """Distance of each pair of a patch from the nearest axis."""
    points, normals = patch.state.interface.points, patch.state.interface.normals
    return np.min([radii(points, normals, c)[patch.pairs] for c in patch.centres], axis=0)


def _profile(panel, patch: _Patch, limit: float, along) -> None:
    state, p = patch.state, patch.state.pressure[patch.pairs] / 1e6
    points = state.interface.points[patch.pairs]
    at = points @ along if along is not None else _distances(patch)
    at = _MM * at
    if points.shape[1] == 2:
        order = np.argsort(at)
        panel.plot(at[order], p[order], color=NOMINAL, lw=1.2, zorder=2)
    for kind, (name, colour) in _STATUS.items():
        # All names are in the legend of the first panel, whatever it has.
        mask = state.status[patch.pairs] == kind
        look = {"color": colour, "mec": _MUTED if kind == OPEN else colour, "label": name}
        panel.plot(at[mask], p[mask], "o", ms=3.4, mew=0.5, zorder=3, **look)
    panel.axhline(limit / 1e6, color=_LINE, lw=1.0, zorder=1, label=_limit_name(limit))
    radius = max(patch.radii(limit))
    if along is None and radius > 0:
        panel.axvline(_MM * radius, color=_LINE, lw=1.1, ls=_DASHES, zorder=1)
        left = _MM * radius < at.min() + 0.7 * np.ptp(at)
        words, place = f"contact radius {_MM * radius:.1f} mm", (_MM * radius, 0.97)
        look = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "va": "top"}
        panel.annotate(words, place, (5 if left else -5, 0), ha="left" if left else "right", **look)
    panel.set_title(patch.title_with(limit, ": "), loc="left")
    panel.set_ylabel("pressure, MPa")
    top = max(p.max(), limit / 1e6)
    panel.set_ylim(-0.03 * top, 1.1 * top)
    panel.margins(x=0.03)
    panel.grid(axis="y")


# -- patches ---------------------------------------------------------------------------------------


def _patches(state: ContactState, centres) -> list[_Patch]:
    """The connected patches of a contact, in the order of their least coordinates."""
    c = state.interface
    gdim = c.points.shape[1]
    if centres is not None:
        centres = np.atleast_2d(np.asarray(centres, dtype=float))
        if centres.shape[1:] != (gdim,) or not np.isfinite(centres).all():
            raise InputError(f"centres of shape {centres.shape}: expected (n, {gdim}), m.")
        closest = [int(np.argmin(np.linalg.norm(c.points - axis, axis=1))) for axis in centres]
    n = len(c)
    ends = np.repeat(c.facets[:, :1], c.facets.shape[1], axis=1)
    links = scipy.sparse.coo_matrix(
        (np.ones(c.facets.size), (ends.ravel(), c.facets.ravel())), shape=(n, n)
    )
    number = connected_components(links, directed=False)[1]
    groups = [np.flatnonzero(number == k) for k in np.unique(number)]
    groups.sort(key=lambda pairs: tuple(c.points[pairs].min(axis=0).round(9)))
    found = []
    for i, pairs in enumerate(groups):
        facets = np.flatnonzero(number[c.facets[:, 0]] == number[pairs[0]])
        weight = c.areas[pairs] / c.areas[pairs].sum()
        middle = weight @ c.points[pairs]
        own = middle[None] if gdim == 3 else np.zeros((1, gdim))
        if centres is not None:
            through = [i for i, pair in enumerate(closest) if number[pair] == number[pairs[0]]]
            own = centres[through]
            if not len(own):
                own = centres[[np.argmin(np.linalg.norm(centres - middle, axis=1))]]
        title = state.name if len(groups) == 1 else f"{state.name}, patch {i + 1}"
        found.append(_Patch(state, facets, pairs, own, title))
    return found


def _limit_name(limit: float) -> str:
    return f"P_lim = {limit / 1e6:g} MPa"


def _check(state: ContactState, plan: str = "", limit: float = 1.0) -> None:
    """Refuse a plan of a contact in the plane, and a limit that is no pressure."""
    if plan and state.interface.points.shape[1] != 3:
        raise InputError(
            f"{plan}: {state.name} is the contact of a model in the plane, which has no plan; "
            "expected one in space. pressure_profile shows pressure and status along it."
        )
    if not (np.isfinite(limit) and limit > 0):
        raise InputError(f"limit = {limit}: expected a pressure > 0, Pa.")


def _direction(state: ContactState, direction) -> np.ndarray | None:
    if direction is None:
        return None
    vector, gdim = np.asarray(direction, dtype=float), state.interface.points.shape[1]
    if vector.shape != (gdim,) or not np.linalg.norm(vector) > 0:
        raise InputError(f"direction = {direction}: expected a vector of {gdim} numbers.")
    return vector / np.linalg.norm(vector)


# -- plan ------------------------------------------------------------------------------------------


class _Plane:
    """The plan of an interface: its points in two axes across the mean normal, mm."""

    def __init__(self, state: ContactState):
        c = state.interface
        normal = c.normals.mean(axis=0)
        self.normal = normal / np.linalg.norm(normal)
        up = int(np.argmax(np.abs(self.normal)))
        first, second = [i for i in range(3) if i != up]
        a = np.eye(3)[first]
        a -= (a @ self.normal) * self.normal
        a /= np.linalg.norm(a)
        b = np.cross(self.normal, a)
        b *= np.sign(b[second])  # the picture has the model's axes, whichever way it is seen
        self.axes = np.array([a, b])
        straight = np.abs(self.normal[up]) > 1 - 1e-6
        self.names = [f"{'xyz'[i]}, mm" for i in (first, second)] if straight else ["mm", "mm"]
        self.points = self.at(c.points)

    def at(self, points: np.ndarray) -> np.ndarray:
        """Positions in the plan, mm."""
        return _MM * points @ self.axes.T


@contextmanager
def _plan(state: ContactState, centres):
    """A figure, the plan, and a panel of equal axes with each patch."""
    plane, patches = _Plane(state), _patches(state, centres)
    boxes = [plane.points[p.pairs] for p in patches]
    size = np.max([np.ptp(x, axis=0) for x in boxes], axis=0)
    columns = min(len(patches), 1 if size[0] > 3.5 * size[1] else 2)
    rows = -(-len(patches) // columns)
    height = (_WIDTH - 1.2) / columns * size[1] / max(size[0], 1e-12)
    margin = 0.03 * size.max()
    with drawing(_WIDTH, rows * (min(height, _MOST) + 0.55) + 0.65) as figure:
        figure.set_facecolor("white")
        panels = grid(figure, len(patches), columns)
        for panel, x in zip(panels, boxes, strict=True):
            (left, low), (right, high) = x.min(axis=0) - margin, x.max(axis=0) + margin
            panel.set(xlim=(left, right), ylim=(low, high), aspect="equal", xlabel=plane.names[0])
            panel.spines[:].set_visible(False)
            panel.tick_params(length=2)
        for panel in panels[::columns]:
            panel.set_ylabel(plane.names[1])
        yield figure, plane, list(zip(panels, patches, strict=True))


def _facets(panel, plane: _Plane, facets: np.ndarray, colours) -> None:
    shapes = plane.points[facets[:, _AROUND[facets.shape[1]]]]
    panel.add_collection(
        PolyCollection(shapes, facecolors=colours, edgecolors=_MUTED, lw=0.3, rasterized=True)
    )


def _corners(points: np.ndarray, facets: np.ndarray):
    """Each facet cut into one quadrilateral for each vertex, and the vertices: what is nearest."""
    around = facets[:, _AROUND[facets.shape[1]]]
    x = points[around]
    after, before = np.roll(x, -1, axis=1), np.roll(x, 1, axis=1)
    middle = np.broadcast_to(x.mean(axis=1, keepdims=True), x.shape)
    cut = np.stack([x, (x + after) / 2, middle, (x + before) / 2], axis=2)
    return cut.reshape(-1, 4, 2), around.ravel()


def _contour(points: np.ndarray, patch: _Patch, limit: float) -> np.ndarray:
    """Segments where the pressure is at the limit, (n, 2, 2), as `ContactState.area_above` cuts."""
    facets = patch.state.interface.facets[patch.facets]
    if facets.shape[1] == 4:
        facets = np.vstack([facets[:, [0, 1, 3]], facets[:, [0, 3, 2]]])
    # One vertex is alone on its side; the line crosses both edges from it.
    ends = [
        (1 - t[..., None]) * points[facets[rows, lone], None]
        + t[..., None] * points[facets[rows[:, None], others]]
        for rows, lone, others, t, _ in cut_corners(patch.state.pressure[facets] - limit)
    ]
    return np.concatenate(ends)

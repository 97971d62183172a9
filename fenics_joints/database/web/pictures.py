"""Pictures of the Kriging surface with the data and the joint that was asked for, as SVG."""

from __future__ import annotations

import io
import re
from functools import lru_cache

import numpy as np

from fenics_joints.database.query import Answer, JointSurfaces

_SHOWN = {"radius": (1e3, "contact radius (mm)"), "pressure": (1e-6, "mean pressure (MPa)")}
_LINE = "#1565c0"
#: How data and the joint that was asked for are marked.
_EDGE = {"markeredgecolor": "white", "markeredgewidth": 0.9, "clip_on": False, "ls": "none"}
_DATA = {"marker": "o", "ms": 6, "color": "#1a237e", "zorder": 3, **_EDGE}
_ASKED = {"marker": "*", "ms": 17, "color": "#c62828", "zorder": 4, **_EDGE}
#: Points of the surface each way, and of its section; a finer picture looks the same.
_POINTS, _ALONG = 61, 121
_SIZE = re.compile(r' width="[^"]*pt" height="[^"]*pt"')


class Pictures:
    """Draws answers over the Kriging surfaces; surfaces are evaluated once.

    Args:
        surfaces: Fitted.
    """

    def __init__(self, surfaces: JointSurfaces):
        self._surfaces = surfaces
        self._grid = lru_cache(maxsize=8)(self._evaluated)

    def svg(self, output: str, answer: Answer | None) -> str:
        """Surface over force and thickness, and its section at the thickness that was asked.

        Args:
            output: ``radius`` or ``pressure``.
            answer: What to mark; None for the surface alone.
        """
        from matplotlib.figure import Figure

        figure = Figure(figsize=(10.4, 4.3), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
        self._surface(figure, left, output, answer)
        self._section(right, output, answer)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
        # Without a size of its own it is as wide as the page allows.
        return _SIZE.sub("", stream.getvalue(), count=1)

    def _surface(self, figure, axes, output: str, answer: Answer | None) -> None:
        kriging, (factor, name) = self._surfaces.kriging[output], _SHOWN[output]
        force, thickness, value = self._grid(output, *self._others(answer))
        # Levels by equal shares of the surface: the pressure grows steeply to one corner.
        levels = np.unique(np.nanquantile(value, np.linspace(0, 1, 13)))
        if len(levels) > 2:
            shown = force / 1e3, thickness * 1e3, value * factor, levels * factor
            bar = figure.colorbar(axes.contourf(*shown, cmap="YlGnBu"), ax=axes, format="%.3g")
            bar.set_label(name)
        axes.plot(kriging.x[:, 1] / 1e3, kriging.x[:, 2] * 1e3, label="data", **_DATA)
        if answer is not None:
            axes.plot(answer.force / 1e3, answer.thickness * 1e3, label="your joint", **_ASKED)
        axes.set(xlabel="bolt force (kN)", ylabel="thickness of a plate (mm)")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)

    def _section(self, axes, output: str, answer: Answer | None) -> None:
        kriging, (factor, name) = self._surfaces.kriging[output], _SHOWN[output]
        rows = kriging.x
        forces, thickness = rows[:, 1], np.median(rows[:, 2])
        if answer is not None:
            forces, thickness = np.append(forces, answer.force), answer.thickness
        force = np.linspace(forces.min(), forces.max(), _ALONG)
        points = _points(force, np.full_like(force, thickness), self._others(answer))
        p = kriging.predict(points, extrapolate=True)
        for inside, style in ((True, "-"), (False, ":")):
            chosen = np.where(p.extrapolated != inside, p.value, np.nan)
            if np.isfinite(chosen).any():
                label = "Kriging" if inside else "extrapolated"
                axes.plot(force / 1e3, chosen * factor, style, color=_LINE, label=label)
        band = {"color": _LINE, "alpha": 0.18, "lw": 0, "label": "95 %"}
        axes.fill_between(force / 1e3, p.low * factor, p.high * factor, **band)
        same = np.isclose(rows[:, 2], thickness, rtol=1e-3)
        axes.plot(rows[same, 1] / 1e3, kriging.y[same] * factor, **_DATA)
        estimate = None if answer is None else getattr(answer, output)
        if estimate is not None:
            axes.plot(answer.force / 1e3, estimate.value * factor, **_ASKED)
        axes.set(xlabel="bolt force (kN)", ylabel=name)
        axes.set_title(f"plates of {thickness * 1e3:.4g} mm", loc="left", fontsize=10)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, loc="best")

    def _evaluated(self, output: str, *others: float):
        """Force, thickness and value on a grid; nan outside the data."""
        kriging = self._surfaces.kriging[output]
        ends = zip(kriging.x[:, 1:3].min(0), kriging.x[:, 1:3].max(0), strict=True)
        force, thickness = np.meshgrid(*(np.linspace(*pair, _POINTS) for pair in ends))
        p = kriging.predict(_points(force.ravel(), thickness.ravel(), others), extrapolate=True)
        # Where no other bolt was computed, the surface shown is that of the data's.
        inside = ~p.extrapolated | p.extrapolated.all()
        return force, thickness, np.where(inside, p.value, np.nan).reshape(force.shape)

    def _others(self, answer: Answer | None) -> tuple[float, ...]:
        """Diameter, and roughness if the surfaces depend on it."""
        given = [[getattr(j, n) for n in self._surfaces.inputs] for j in self._surfaces.rows]
        diameter, _, _, *others = np.median(given, axis=0).tolist()
        return (diameter if answer is None else answer.thread.diameter, *others)


def _points(force: np.ndarray, thickness: np.ndarray, others: tuple[float, ...]) -> np.ndarray:
    """Points of the surfaces' inputs, (n, 3 or 4)."""
    diameter, *more = (np.full_like(force, other) for other in others)
    return np.column_stack([diameter, force, thickness, *more])

"""Pictures of the Kriging surface with the data and the joint that was asked for, as SVG."""

from __future__ import annotations

import io
import re
from functools import lru_cache

import numpy as np

from fenics_joints.database.query import Answer, JointSurfaces

_SHOWN = {"radius": (1e3, "contact radius (mm)"), "pressure": (1e-6, "mean pressure (MPa)")}
_ASKED, _DATA, _LINE = "#c62828", "#1a237e", "#1565c0"
_POINTS = 61
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
            drawn = axes.contourf(
                force / 1e3, thickness * 1e3, value * factor, levels * factor, cmap="YlGnBu"
            )
            bar = figure.colorbar(drawn, ax=axes, format="%.3g")
            bar.set_label(name)
        rows = kriging.x[:, 1:3]
        axes.plot(
            rows[:, 0] / 1e3,
            rows[:, 1] * 1e3,
            "o",
            ms=6,
            color=_DATA,
            markeredgecolor="white",
            markeredgewidth=0.9,
            label="data",
            clip_on=False,
            zorder=3,
        )
        if answer is not None:
            axes.plot(
                answer.force / 1e3,
                answer.thickness * 1e3,
                "*",
                ms=17,
                color=_ASKED,
                markeredgecolor="white",
                label="your joint",
                clip_on=False,
                zorder=4,
                ls="none",
            )
        axes.set(xlabel="bolt force (kN)", ylabel="thickness of a plate (mm)")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)

    def _section(self, axes, output: str, answer: Answer | None) -> None:
        kriging, (factor, name) = self._surfaces.kriging[output], _SHOWN[output]
        rows = kriging.x
        thickness = np.median(rows[:, 2]) if answer is None else answer.thickness
        low, high = rows[:, 1].min(), rows[:, 1].max()
        if answer is not None:
            low, high = min(low, answer.force), max(high, answer.force)
        force = np.linspace(low, high, 121)
        points = self._points(force, np.full_like(force, thickness), answer)
        p = kriging.predict(points, extrapolate=True)
        for inside, style in ((True, "-"), (False, ":")):
            chosen = np.where(p.extrapolated != inside, p.value, np.nan)
            if np.isfinite(chosen).any():
                label = "Kriging" if inside else "extrapolated"
                axes.plot(force / 1e3, chosen * factor, style, color=_LINE, label=label)
        axes.fill_between(
            force / 1e3,
            p.low * factor,
            p.high * factor,
            color=_LINE,
            alpha=0.18,
            lw=0,
            label="95 %",
        )
        same = np.isclose(rows[:, 2], thickness, rtol=1e-3)
        if same.any():
            axes.plot(rows[same, 1] / 1e3, kriging.y[same] * factor, "o", ms=6, color=_DATA)
        estimate = None if answer is None else getattr(answer, output)
        if estimate is not None:
            axes.plot(
                answer.force / 1e3,
                estimate.value * factor,
                "*",
                ms=17,
                color=_ASKED,
                markeredgecolor="white",
                clip_on=False,
            )
        axes.set(xlabel="bolt force (kN)", ylabel=name)
        axes.set_title(f"plates of {thickness * 1e3:.4g} mm", loc="left", fontsize=10)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, loc="best")

    def _evaluated(self, output: str, *others: float):
        """Force, thickness and value on a grid; nan outside the data."""
        kriging = self._surfaces.kriging[output]
        low, high = kriging.x[:, 1:3].min(0), kriging.x[:, 1:3].max(0)
        force, thickness = np.meshgrid(
            np.linspace(low[0], high[0], _POINTS), np.linspace(low[1], high[1], _POINTS)
        )
        points = np.column_stack(
            [
                np.full(force.size, others[0]),
                force.ravel(),
                thickness.ravel(),
                *(np.full(force.size, other) for other in others[1:]),
            ]
        )
        p = kriging.predict(points, extrapolate=True)
        # Where no other bolt was computed, the surface shown is that of the data's.
        inside = ~p.extrapolated | p.extrapolated.all()
        return force, thickness, np.where(inside, p.value, np.nan).reshape(force.shape)

    def _points(self, force: np.ndarray, thickness: np.ndarray, answer: Answer | None):
        diameter, *others = self._others(answer)
        return np.column_stack(
            [
                np.full_like(force, diameter),
                force,
                thickness,
                *(np.full_like(force, other) for other in others),
            ]
        )

    def _others(self, answer: Answer | None) -> tuple[float, ...]:
        """Diameter, and roughness if the surfaces depend on it."""
        middle = np.median(
            [[getattr(j, n) for n in self._surfaces.inputs] for j in self._surfaces.rows], axis=0
        )
        diameter = middle[0] if answer is None else answer.thread.diameter
        return (float(diameter), *map(float, middle[3:]))

"""Page and charts of nonlinear frequency responses."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from fenics_joints.commands.harmonic.identified import mode_notes, mode_rows, source
from fenics_joints.commands.harmonic.model import SENSOR
from fenics_joints.commands.harmonic.result import HarmonicReport
from fenics_joints.commands.harmonic.stability import LevelStability
from fenics_joints.commands.harmonic.view import peak_shapes, response_view
from fenics_joints.formatting import percent, quantity
from fenics_joints.report.html import render, svg
from fenics_joints.report.style import INK, SERIES, drawing, to_svg


def harmonic_html(r: HarmonicReport) -> str:
    """The page of the ``harmonic`` command. Collective; empty on all ranks but the first."""
    # Loops are made of what all ranks hold.
    loops = [response.loops(response.peak.index) for response in r.responses]
    shapes = peak_shapes(r)
    if r.rank != 0:
        return ""
    view, still = (None, None) if shapes is None else response_view(r, shapes, loops[-1])
    pictures = [("Response at the levels of force", responses_chart(r))]
    if r.backbone is not None or r.static_backbone is not None:
        pictures.append(("Frequency and damping over amplitude", over_amplitude(r)))
    top = loops[-1]
    for name, made in top.items():
        pictures.append((f"Hysteresis in {name}", loops_chart(r, loops, name)))
        points = next(p for p in r.built.model.interfaces if p.name == name)
        if points.points is not None:
            pictures.append((f"Where {name} slips", interface_map(r, points, made)))
    return render(
        "harmonic.html",
        r=r,
        pictures=[(words, svg(chart)) for words, chart in pictures],
        points=sum(len(p) for p in r.built.model.interfaces),
        fitted=r.fitted_levels,
        source=source,
        mode_notes=mode_notes,
        view=view,
        still=still,
    )


def responses_chart(r: HarmonicReport) -> str:
    """Amplitude over frequency, by level, with the backbone and what was measured."""
    with drawing(7.6, 4.4) as figure:
        axes = figure.subplots()
        for shade, response, f in zip(_cycle(), r.responses, r.facts, strict=False):
            amplitude = response.amplitude(SENSOR, r.kind)
            label = quantity(f.level, r.level_unit)
            axes.plot(response.frequencies_hz, amplitude, color=shade, lw=1.6, label=label)
            axes.plot(f.frequency_hz, f.amplitude, "o", color=shade, ms=4)
            for found in r.stability:
                if found.level == f.level:
                    _stability(axes, found, response, amplitude, r.kind, shade)
            if f.measured is not None:
                hz, measured = r.curves.at(f.level)
                axes.plot(hz, measured, "x", color=shade, ms=5)
        low, high = axes.get_xlim()
        top = axes.get_ylim()[1]
        if r.backbone is not None:
            b = r.backbone
            axes.plot(
                b.frequencies_hz,
                b.amplitude(SENSOR, r.kind),
                color=INK,
                lw=1.0,
                ls=(0, (4, 3)),
                label="backbone",
            )
        axes.set(
            xlim=(low, high),
            ylim=(0, top),
            xlabel="frequency, Hz",
            ylabel=f"{r.kind} at the sensor{r.relative}, {r.unit}",
        )
        axes.legend(loc="best", title="x: measured" if r.curves is not None else None)
        peaks = "; ".join(f"{f.level:g} N: {f.frequency_hz:.3f} Hz" for f in r.facts)
        return to_svg(figure, "responses", f"Response over frequency. Peaks at {peaks}.")


def _stability(axes, found: LevelStability, response, amplitude, kind: str, shade: str) -> None:
    """Unstable responses pale, bifurcations as squares, the branches that leave there dotted."""
    lost = np.where(found.stability.stable, np.nan, amplitude)
    axes.plot(response.frequencies_hz, lost, color="white", lw=0.9)
    for b in found.stability.bifurcations:
        height = 0.5 * (amplitude[b.index] + amplitude[b.index + 1])
        axes.plot(b.frequency_hz, height, "s", color=shade, ms=3.5, mfc="white")
    for _, made in found.branches:
        axes.plot(made.frequencies_hz, made.amplitude(SENSOR, kind), color=shade, lw=1.2, ls=":")


def _cycle():
    while True:
        yield from SERIES


def over_amplitude(r: HarmonicReport) -> str:
    """Frequency and damping of the mode over its amplitude, with the levels' peaks."""
    both = [r.backbone, r.static_backbone]
    b = next(found for found in both if found is not None)
    x = b.amplitude()
    with drawing(7.6, 3.2) as figure:
        left, right = figure.subplots(1, 2)
        lines = {"color": "#2b7bba"}, {"color": INK, "ls": "--"}
        for found, line in zip(both, lines, strict=True):
            if found is not None:
                a, name = found.amplitude(), found.method.replace("epmc", "periodic")
                left.semilogx(a, found.frequencies_hz, lw=1.6, label=name, **line)
                right.semilogx(a, 100 * found.damping_ratios, lw=1.6, **line)
        for axes in (left, right):
            axes.set_xlabel("displacement at the sensor, m")
        if None not in both:
            left.legend(loc="best")
        for shade, f in zip(_cycle(), r.facts, strict=False):
            left.plot(f.displacement, f.frequency_hz, "o", color=shade, ms=4.5)
            right.plot(f.displacement, 100 * f.damping_ratio, "o", color=shade, ms=4.5)
        tested = np.array(mode_rows(r.identified[-1]) if r.identified else []).reshape(-1, 5)
        left.plot(tested[:, 0], tested[:, 1], "x", color=INK, ms=5)
        right.plot(tested[:, 0], 100 * tested[:, 3], "x", color=INK, ms=5)
        left.set_ylabel("frequency, Hz")
        right.set_ylabel("damping ratio, %")
        left.ticklabel_format(axis="y", useOffset=False)
        hz, zeta = b.frequencies_hz, b.damping_ratios
        alt = (
            f"Over displacements from {quantity(x[0], 'm')} to {quantity(x[-1], 'm')} the "
            f"frequency goes from {hz[0]:.3f} to {hz[-1]:.3f} Hz, the damping from "
            f"{percent(zeta[0])} to {percent(zeta[-1])}."
        )
        if len(tested):
            alt += " Crosses: the test."
        if r.backbone_note is not None:
            alt += f" {r.backbone_note[0].upper()}{r.backbone_note[1:]}."
        return to_svg(figure, "amplitude", alt)


def loops_chart(r: HarmonicReport, loops: list[dict], name: str) -> str:
    """Stress over strain at the point that dissipates most, at the peak of every level."""
    points = next(p for p in r.built.model.interfaces if p.name == name)
    at = int(np.argmax(loops[-1][name].dissipation))
    made = loops[-1][name]
    work = np.abs(np.ptp(made.strain[at], axis=0) * np.ptp(made.stress[at], axis=0))
    component = int(np.argmax(work))
    normal = points.normal and component == 0
    with drawing(7.6, 3.4) as figure:
        axes = figure.subplots()
        for shade, level, f in zip(_cycle(), loops, r.facts, strict=False):
            strain, stress = (
                np.append(a[at, :, component], a[at, 0, component])
                for a in (level[name].strain, level[name].stress)
            )
            label = quantity(f.level, r.level_unit)
            axes.plot(strain, stress / 1e3, color=shade, lw=1.5, label=label)
        layer = name in r.case.joints
        words = ("normal strain", "shear strain") if layer else ("opening, m", "slip, m")
        axes.set(
            xlabel=words[0] if normal else words[1],
            ylabel=f"{'normal' if normal else 'shear'} stress, kPa",
        )
        axes.legend(loc="best")
        place = "" if points.points is None else _place(points.points[at])
        return to_svg(figure, f"loops-{name}", f"Loops at the point of most dissipation{place}.")


def _place(point: np.ndarray) -> str:
    return f", at ({', '.join(f'{1e3 * c:.1f}' for c in point)}) mm"


def interface_map(r: HarmonicReport, points, made) -> str:
    """Slip and dissipation over an interface at the highest level's peak."""
    spread = np.ptp(points.points, axis=0)
    along, across = np.argsort(-spread)[:2]
    plan = spread[across] > 1e-3 * spread[along]
    per = "m²" if points.name in r.case.contacts else "m³"
    with drawing(7.6, 3.0) as figure:
        pair = figure.subplots(1, 2)
        shown = (
            (pair[0], made.slip_amplitude, "slip, m" if per == "m²" else "shear strain"),
            (pair[1], made.dissipation, f"energy per cycle, J/{per}"),
        )
        for axes, values, words in shown:
            (_plan if plan else _line)(figure, axes, 1e3 * points.points, along, across, values)
            axes.set_title(words)
        worst = int(np.argmax(made.dissipation))
        return to_svg(
            figure,
            f"map-{points.name}",
            f"Slip and dissipation over {points.name} at {r.facts[-1].level:g} N; most energy"
            f"{_place(points.points[worst])}.",
        )


def _plan(figure: Figure, axes, x, along, across, values) -> None:
    shown = axes.tripcolor(x[:, along], x[:, across], values, shading="gouraud", rasterized=True)
    figure.colorbar(shown, ax=axes, location="bottom", shrink=0.8)
    axes.set(xlabel=f"{'xyz'[along]}, mm", ylabel=f"{'xyz'[across]}, mm", aspect="equal")


def _line(figure: Figure, axes, x, along, across, values) -> None:
    order = np.argsort(x[:, along])
    axes.plot(x[order, along], values[order], color=SERIES[0], lw=1.4)
    axes.set_xlabel(f"{'xyz'[along]}, mm")

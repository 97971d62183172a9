"""What is said of nonlinear frequency responses, and their charts."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure as MatplotlibFigure

from fenics_joints.commands.harmonic.model import SENSOR
from fenics_joints.commands.harmonic.result import HarmonicReport
from fenics_joints.commands.harmonic.stability import LevelStability
from fenics_joints.commands.harmonic.view import peak_shapes, response_view
from fenics_joints.formatting import MISSING, hertz, number, percent, quantity
from fenics_joints.harmonic import IdentificationResult
from fenics_joints.report.document import (
    Cell,
    Document,
    Figure,
    Heading,
    Keys,
    OnPage,
    Table,
    Text,
    View,
    sentence,
)
from fenics_joints.report.style import INK, SERIES, drawing, to_svg

#: A misfit this many times the noise is spoken of.
_WIDE = 1.5


def harmonic_document(r: HarmonicReport) -> Document:
    """What is said of nonlinear frequency responses."""
    model = r.built.model
    points = ", ".join(f"{p.name} {len(p)}" for p in model.interfaces)
    rest = f"{hertz(r.built.frequencies_hz[r.built.mode])} Hz"
    steps = sum(len(response) for response in r.responses)
    notes = [f"{steps} points of the responses, {r.seconds:.0f} s in all"]
    if any(f.turning_points for f in r.facts):
        notes.append("some responses turn back in frequency: a swept test would jump there")
    if r.backbone_note is not None:
        notes.append(r.backbone_note)
    return Document(
        r.case.name,
        f"response to {r.title}",
        f"Response to {r.title}",
        [
            Keys(
                [
                    ("rest", rest, "mode at rest"),
                    ("dofs", r.built.n_dofs, f"degrees of freedom, {model.n_dofs} after reduction"),
                    (
                        "points",
                        sum(len(p) for p in model.interfaces),
                        f"points of joints: {points}",
                    ),
                ]
            ),
            *_peaks(r),
            *(Text(sentence(note), "note") for note in (*notes, *r.slider_notes)),
            OnPage(lambda: _scene(r)),
            *_modes(r),
            *_stability_blocks(r),
            *_identified(r),
            *_predictions(r),
            OnPage(lambda: _charts(r)),
        ],
        r.to_json,
    )


def _peaks(r: HarmonicReport) -> list:
    measured = [">test, Hz", f">test, {r.unit}"] if r.curves is not None else []
    table = Table(
        [
            r.drive,
            ">peak, Hz",
            f">{r.kind}, {r.unit}",
            ">damping",
            ">in joints, per cycle",
            ">displacement",
            *measured,
        ],
        id="peaks",
        page_columns=1 + len(measured),
    )
    for f in r.facts:
        cells = [MISSING] * len(measured)
        if measured and f.measured is not None:
            errors = (f.frequency_hz / f.measured_hz - 1, f.amplitude / f.measured - 1)
            hz, amplitude = (percent(error, sign=True) for error in errors)
            cells = [f"{f.measured_hz:.3f} ({hz})", f"{number(f.measured, 4)} ({amplitude})"]
        table.add(
            _level(r, f.level),
            f"{f.frequency_hz:.3f}",
            number(f.amplitude, 4),
            percent(f.damping_ratio),
            quantity(max(sum(f.joint_energy.values()), 0.0), "J"),
            quantity(f.displacement, "m"),
            *cells,
        )
    words = "Damping is the work of the force in a cycle over 4π times the kinetic energy."
    if measured:
        words += (
            " The last columns are the highest measured responses, in brackets the model's error."
        )
    return [Heading("Peaks"), OnPage([Text(words)]), table]


def _level(r: HarmonicReport, level: float) -> Cell:
    return Cell(quantity(level, r.level_unit), kind="nowrap")


def _scene(r: HarmonicReport) -> list | None:
    """The structure at its peaks, to be looked at from all sides. Collective."""
    loops, shapes = r.responses[-1].loops(r.responses[-1].peak.index), peak_shapes(r)
    if r.rank != 0:
        return None
    if shapes is None:
        return []
    view, still = response_view(r, shapes, loops)
    caption = (
        "At the highest level's peak, by the first harmonic; colour: motion along the sensor's "
        "direction. Motion is enlarged."
    )
    return [Heading("The structure at its peaks"), View(view, [Figure(still, caption)])]


def _modes(r: HarmonicReport) -> list:
    """The mode at the peaks' displacements, by each method."""
    if r.static_backbone is None:
        return []
    names = [name for method in r.mode_methods for name in (f">{method}, Hz", ">damping")]
    table = Table(["displacement", *names], id="modes")
    for displacement, found in r.mode_rows():
        words = [(f"{at[0]:.3f}", percent(at[1])) if at else (MISSING, MISSING) for at in found]
        first = Cell(quantity(displacement, "m"), kind="nowrap")
        table.add(first, *(word for pair in words for word in pair))
    how = (
        "At the displacements of the peaks: periodic motion (EPMC) beside static loads of the "
        "mode's inertia, whose damping is by Masing's rule or, in contacts, by loops."
    )
    blocks = [Heading("Mode over amplitude"), OnPage([Text(how)]), table]
    if r.static_backbone.end != "reached":
        words = "Under static loads the joint gives way before the highest amplitude."
        blocks.append(Text(words))
    return blocks


def _stability_blocks(r: HarmonicReport) -> list:
    """Where the responses' stability changes, and what leaves there."""
    if not r.stability:
        return []
    how = (
        "Where the stability of responses changes, and how many disturbances grow before and "
        "after, by their multipliers over a period. Motions of broken symmetry leave at a branch "
        "point, of twice the period at a period doubling; at a Neimark-Sacker bifurcation the "
        "motion begins to beat."
    )
    table = Table(
        [r.drive, "bifurcation", ">Hz", ">displacement", ">growing", "branch"], id="bifurcations"
    )
    for found in r.stability:
        rows = found.rows()
        for words in rows:
            table.add(_level(r, found.level), *words)
        if not rows:
            every = "all" if found.stability.stable.all() else "not all"
            table.add(_level(r, found.level), f"none; {every} responses are stable")
    notes = [Text(sentence(note), "note") for found in r.stability for note in found.notes]
    return [Heading("Stability"), OnPage([Text(how)]), table, *notes]


def _identified(r: HarmonicReport) -> list:
    """The parameters found by each method, and the measured mode beside the identified one."""
    if not r.identified:
        return []
    first, last = r.identified[0], r.identified[-1]
    weight = ""
    if first.mode is not None:
        weight = f", and {percent(first.noise)} for each standard deviation of the mode over its "
        weight += "amplitude"
    table = Table(
        "parameter | >start | >found | >s.d. | method | >objective at start | >at end | "
        ">responses | >solutions",
        id="identified",
    )
    for found in r.identified:
        for row in r.parameter_rows(found):
            table.add(
                *row,
                found.method,
                f"{found.start_objective:.3f}",
                f"{found.objective:.4f}",
                str(found.evaluations),
                str(found.solutions),
            )
    notes = []
    if left := last.undetermined:
        notes.append(f"not determined by these data: {', '.join(left)}")
    return [
        Heading("Identified"),
        Text(
            f"Identified from {_source(first)}: the objective is the sum of relative errors near "
            f"the peak{weight}; a response is the curve at all its selected frequencies, a "
            "solution one of them; s.d. is from the data alone."
        ),
        table,
        *_amplitude_table(last),
        *(Text(sentence(note), "note") for note in (*notes, *_mode_notes(last))),
    ]


def _amplitude_table(found: IdentificationResult) -> list[Table]:
    """The measured mode beside the identified one."""
    table = Table(">displacement | >test, Hz | >model, Hz | >test, damping | >model")
    for displacement, hz, made, zeta, ratio in mode_rows(found):
        hertzes = (f"{hz:.3f}", f"{made:.3f}")
        table.add(quantity(displacement, "m"), *hertzes, percent(zeta), percent(ratio))
    return [table] if table.rows else []


def _predictions(r: HarmonicReport) -> list:
    """How far the model is from every measured curve."""
    if not r.predictions:
        return []
    table = Table(
        [">measured at", "", ">peak, Hz", ">error", f">peak, {r.unit}", ">error", ">mean error"],
        caption="Mean error: of the amplitudes near the peak",
        id="predictions",
    )
    fitted = r.fitted_levels
    for p in r.predictions:
        (hz, amplitude), _ = p.peaks
        word = "fitted" if p.level in fitted else "predicted"
        table.add(
            Cell(quantity(p.level, "N"), kind="nowrap"),
            word if fitted else "",
            f"{hz:.3f}",
            percent(p.frequency_error, sign=True),
            number(amplitude, 4),
            percent(p.amplitude_error, sign=True),
            percent(p.mean_error),
        )
    return [Heading("Against the measured curves"), table]


def _source(found: IdentificationResult) -> str:
    """What data the parameters are from."""
    parts = []
    if len(found.frequencies_hz):
        parts.append(f"the curve at {quantity(found.level, 'N')}")
    if found.mode is not None:
        measured = found.mode.measured
        parts.append(f"a mode at {len(measured)} amplitudes ({measured.kind})")
    return " and ".join(parts) or "loops"


def _mode_notes(found: IdentificationResult) -> list[str]:
    """What the mode over its amplitude says beside the parameters, and what it cannot, a line each.

    Of none, if none was fitted.
    """
    if found.mode is None:
        return []
    notes = []
    rest = found.offsets.get("frequency at rest")
    if rest is not None:
        notes.append(
            f"at rest the test's frequency is {percent(abs(rest.value), 3)} (s.d. "
            f"{percent(rest.sd, 3)}) {'above' if rest.value > 0 else 'below'} the model's, beside "
            "what the law does"
        )
    damping = found.offsets.get("damping at rest")
    if damping is not None:
        notes.append(
            f"the test has a damping ratio of {percent(abs(damping.value), 3)} (s.d. "
            f"{percent(damping.sd, 3)}) {'more' if damping.value > 0 else 'less'} than the model, "
            "at all amplitudes the same"
        )
    for what, width in zip(("frequencies", "damping ratios"), found.mode.widths, strict=True):
        if width > _WIDE:
            notes.append(
                f"the law does not follow the {what}: it leaves {number(width, 2)} times their "
                "noise, and they were weighed so much less"
            )
    if not found.mode.measured.has_damping:
        notes.append(
            "without damping ratios slip cannot be told from any other softening of the joint"
        )
    return [*notes, *found.mode.measured.notes]


def mode_rows(found: IdentificationResult) -> list[tuple[float, float, float, float, float]]:
    """Displacement, m; measured and computed frequency, Hz, and damping ratio, at each amplitude.

    The computed ones with what the model lacks at rest.
    """
    if found.mode is None:
        return []
    points, measured = found.responses[-1], found.mode.measured
    hz = 1.0 + getattr(found.offsets.get("frequency at rest"), "value", 0.0)
    more = getattr(found.offsets.get("damping at rest"), "value", 0.0)
    columns = (
        found.mode.displacements,
        measured.frequencies_hz,
        hz * points.frequencies_hz,
        measured.damping,
        more + points.damping_ratios,
    )
    return list(zip(*(column.tolist() for column in columns), strict=True))


# -- charts ----------------------------------------------------------------------------------------


def _charts(r: HarmonicReport) -> list:
    """Charts, each under a heading. Collective."""
    # Loops are made of what all ranks hold.
    loops = [response.loops(response.peak.index) for response in r.responses]
    if r.rank != 0:
        return []
    drawn = {"Response at the levels of force": partial(responses_chart, r)}
    if r.backbone is not None or r.static_backbone is not None:
        drawn["Frequency and damping over amplitude"] = partial(over_amplitude, r)
    for name, made in loops[-1].items():
        drawn[f"Hysteresis in {name}"] = partial(loops_chart, r, loops, name)
        points = next(p for p in r.built.model.interfaces if p.name == name)
        if points.points is not None:
            drawn[f"Where {name} slips"] = partial(interface_map, r, points, made)
    return [b for words, draw in drawn.items() for b in (Heading(words), Figure(draw))]


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


def _plan(figure: MatplotlibFigure, axes, x, along, across, values) -> None:
    shown = axes.tripcolor(x[:, along], x[:, across], values, shading="gouraud", rasterized=True)
    figure.colorbar(shown, ax=axes, location="bottom", shrink=0.8)
    axes.set(xlabel=f"{'xyz'[along]}, mm", ylabel=f"{'xyz'[across]}, mm", aspect="equal")


def _line(figure: MatplotlibFigure, axes, x, along, across, values) -> None:
    order = np.argsort(x[:, along])
    axes.plot(x[order, along], values[order], color=SERIES[0], lw=1.4)
    axes.set_xlabel(f"{'xyz'[along]}, mm")

"""The document of nonlinear frequency responses, and its charts."""

from __future__ import annotations

from functools import partial
from itertools import cycle

import numpy as np

from fenics_joints.commands.harmonic.model import SENSOR
from fenics_joints.commands.harmonic.result import HarmonicReport
from fenics_joints.commands.harmonic.stability import LevelStability
from fenics_joints.commands.harmonic.view import peak_shapes, response_view
from fenics_joints.formatting import MISSING, hertz, number, percent, quantity
from fenics_joints.harmonic import IdentificationResult
from fenics_joints.report import document as doc
from fenics_joints.report.chart import Curve, curve_chart
from fenics_joints.report.style import INK, PAPER, SERIES, drawing, to_svg

#: Times the noise from which a misfit of the mode over its amplitude is noted; chosen: no result
#: depends on it.
_WIDE = 1.5


def harmonic_document(r: HarmonicReport) -> doc.Document:
    """The document of nonlinear frequency responses."""
    model = r.built.model
    points = ", ".join(f"{p.name} {len(p)}" for p in model.interfaces)
    rest = f"{hertz(r.built.frequencies_hz[r.built.mode])} Hz"
    steps = sum(len(response) for response in r.responses)
    notes = [f"{steps} points of the responses, {r.seconds:.0f} s in all"]
    if any(f.turning_points for f in r.facts):
        notes.append("some responses turn back in frequency: a swept test would jump there")
    if r.backbone_note is not None:
        notes.append(r.backbone_note)
    keys = [
        ("rest", rest, "mode at low amplitude (linear)"),
        ("dofs", r.built.n_dofs, f"degrees of freedom, {model.n_dofs} after reduction"),
        ("points", sum(map(len, model.interfaces)), f"points of joints: {points}"),
    ]
    return doc.Document(
        r.case.name,
        f"response to {r.title}",
        f"Response to {r.title}",
        [
            doc.Keys(keys),
            *_peaks(r),
            *_notes([*notes, *r.slider_notes]),
            doc.OnPage(lambda: _scene(r)),
            *_modes(r),
            *_stability_blocks(r),
            *_identified(r),
            *_predictions(r),
            doc.OnPage(lambda: _charts(r)),
        ],
        r.to_json,
    )


def _notes(lines) -> list[doc.Text]:
    return [doc.Text(doc.sentence(line), "note") for line in lines]


def _written(key: str, value) -> str | doc.Cell:
    """A number of nonlinear responses by its key."""
    if isinstance(value, float) and key.endswith("hz"):
        return f"{value:.3f}"
    if key.endswith(("damping", "damping_ratio")):
        return percent(value)
    if key.endswith("_error"):
        return percent(value, sign=key != "mean_error")
    return doc.by_unit(key, value)


def _level(value: float, unit: str) -> doc.Cell:
    """A level of the force or of the base's motion, or a displacement."""
    return doc.Cell(quantity(value, unit), kind="nowrap", value=value)


def _peaks(r: HarmonicReport) -> list:
    rows = []
    for f in r.facts:
        energy = max(sum(f.joint_energy_j.values()), 0.0)
        row = r.record(f) | {"level": _level(f.level, r.level_unit), "joint_energy_j": energy}
        row["peak"] = doc.Cell(number(f.peak, 4), value=f.peak)
        if r.curves is not None:
            row |= {"test_hz": MISSING, "test": MISSING}
        if f.measured_peak is not None:
            hz, peak = f.peak_hz / f.measured_peak_hz - 1, f.peak / f.measured_peak - 1
            row["test_hz"] = f"{f.measured_peak_hz:.3f} ({percent(hz, sign=True)})"
            row["test"] = f"{number(f.measured_peak, 4)} ({percent(peak, sign=True)})"
        rows.append(row)
    table = doc.Table.of(
        rows,
        f"level: {r.drive} | peak_hz: >peak, Hz | peak: >{r.kind}, {r.unit} | "
        "damping_ratio: >damping | joint_energy_j: >in joints, per cycle | "
        f"peak_displacement_m: >displacement | test_hz: >test, Hz | test: >test, {r.unit}",
        write=_written,
        id="peaks",
        on_page=("peak_displacement_m", "test_hz", "test"),
    )
    words = "Damping is the work of the force in a cycle over 4π times the kinetic energy."
    if r.curves is not None:
        words += " The last columns are the measured peaks, with the model's error in brackets."
    return [doc.Heading("Peaks"), doc.OnPage([doc.Text(words)]), table]


def _scene(r: HarmonicReport) -> list | None:
    """The structure at its peaks, to be looked at from all sides. Collective."""
    loops, shapes = r.responses[-1].loops(r.responses[-1].peak.index), peak_shapes(r)
    if r.rank != 0:
        return None
    if shapes is None:
        return []
    view, still = response_view(r, shapes, loops)
    caption = (
        "First harmonic at the peak of the highest level; colour: motion along the sensor's "
        "direction. Motion is enlarged."
    )
    return [doc.Heading("The structure at its peaks"), doc.View(view, [doc.Figure(still, caption)])]


def _modes(r: HarmonicReport) -> list:
    """The mode at the peaks' displacements, by each method."""
    if r.static_backbone is None:
        return []
    static = f"quasi-static, {r.case.harmonic.quasi_static}"
    rows = r.mode_records()
    table = doc.Table.of(
        [row | {"displacement": _level(row["displacement_m"], "m")} for row in rows],
        "displacement: displacement | periodic_hz: >periodic (EPMC), Hz | "
        f"periodic_damping: >damping | static_hz: >{static}, Hz | static_damping: >damping",
        write=_written,
        id="modes",
    )
    how = (
        "At the displacements of the peaks: periodic motion (EPMC), and static loading by the "
        "mode's inertia forces, with damping by Masing's rule or, for contacts, by full loops."
    )
    blocks = [doc.Heading("Mode over amplitude"), doc.OnPage([doc.Text(how)]), table]
    if r.static_backbone.end != "reached":
        words = "Under static loads the joint yields before the highest amplitude."
        blocks.append(doc.Text(words))
    return blocks


def _stability_blocks(r: HarmonicReport) -> list:
    """Where the responses' stability changes, and what leaves there."""
    if not r.stability:
        return []
    how = (
        "Points where the stability of a response changes, with the number of growing "
        "disturbances before and after (Floquet multipliers). At a branch point motions of broken "
        "symmetry branch off, at a period doubling motions of twice the period; at a "
        "Neimark-Sacker bifurcation the motion starts to beat."
    )
    rows = []
    for found in r.stability:
        every = "all" if found.stability.stable.all() else "not all"
        none = {"kind": f"none; {every} responses are stable", "branch": ""}
        level = {"level": _level(found.level, r.level_unit)}
        for row in found.records() or [none]:
            growing = ", ".join(map(str, row.get("unstable", ())))
            rows.append(row | level | {"unstable": growing})
    table = doc.Table.of(
        rows,
        f"level: {r.drive} | kind: bifurcation | frequency_hz: >Hz | "
        "displacement_m: >displacement | unstable: >growing | branch: branch",
        write=lambda key, value: "" if value is None else doc.by_unit(key, value),
        id="bifurcations",
    )
    notes = _notes(note for found in r.stability for note in found.notes)
    return [doc.Heading("Stability"), doc.OnPage([doc.Text(how)]), table, *notes]


def _identified(r: HarmonicReport) -> list:
    """The parameters found by each method, and the measured mode beside the identified one."""
    if not r.identified:
        return []
    first, last = r.identified[0], r.identified[-1]
    weight = ""
    if first.mode is not None:
        weight = f", and {percent(first.noise)} for each standard deviation of the mode over its "
        weight += "amplitude"
    table = doc.Table.of(
        [row for found in r.identified for row in r.parameter_records(found)],
        "parameter: parameter | start: >start | value: >found | sd: >s.d. | method: method | "
        "start_objective: >objective at start | objective: >at end | evaluations: >responses | "
        "solutions: >solutions",
        write=lambda key, x: f"{x:.4f}" if key.endswith("objective") else doc.by_unit(key, x),
        id="identified",
    )
    notes = []
    if left := last.undetermined:
        notes.append(f"not determined by these data: {', '.join(left)}")
    amplitude = doc.Table.of(
        measured_mode_records(last),
        "displacement_m: >displacement | test_hz: >test, Hz | model_hz: >model, Hz | "
        "test_damping: >test, damping | model_damping: >model",
        write=_written,
    )
    return [
        doc.Heading("Identified"),
        doc.Text(
            f"Identified from {_source(first)}: the objective is the sum of relative errors near "
            f"the peak{weight}; a response is the curve at all selected frequencies, a solution "
            "one point of it; standard deviations are from the data alone."
        ),
        table,
        *([amplitude] if amplitude.rows else []),
        *_notes([*notes, *_mode_notes(last)]),
    ]


def _predictions(r: HarmonicReport) -> list:
    """Errors of the model against every measured curve."""
    if not r.predictions:
        return []
    rows, fitted = [], r.fitted_levels
    for p in r.predictions:
        (hz, peak), _ = p.peaks
        word = "fitted" if p.level in fitted else "predicted"
        row = {"level": _level(p.level, "N"), "use": word if fitted else "", "peak_hz": hz}
        row["peak"] = doc.Cell(number(peak, 4), value=peak)
        keys = ("frequency_error", "amplitude_error", "mean_error")
        rows.append(row | {key: getattr(p, key) for key in keys})
    table = doc.Table.of(
        rows,
        "level: >measured at | use: | peak_hz: >peak, Hz | frequency_error: >error | "
        f"peak: >peak, {r.unit} | amplitude_error: >error | mean_error: >mean error",
        write=_written,
        caption="Mean error: of the amplitudes near the peak",
        id="predictions",
    )
    return [doc.Heading("Comparison with the measured curves"), table]


def _source(found: IdentificationResult) -> str:
    """The data that the parameters are identified from."""
    parts = []
    if len(found.frequencies_hz):
        parts.append(f"the curve at {quantity(found.level, 'N')}")
    if found.mode is not None:
        measured = found.mode.measured
        parts.append(f"a mode at {len(measured)} amplitudes ({measured.kind})")
    return " and ".join(parts) or "loops"


def _mode_notes(found: IdentificationResult) -> list[str]:
    """Remarks on a fit to a mode over its amplitude, a line each; none without such a fit."""
    if found.mode is None:
        return []
    notes = []
    rest = found.offsets.get("frequency at rest")
    if rest is not None:
        notes.append(
            f"at low amplitude the test's frequency is {percent(abs(rest.value), 3)} (s.d. "
            f"{percent(rest.sd, 3)}) {'above' if rest.value > 0 else 'below'} the model's, which "
            "the law does not change"
        )
    damping = found.offsets.get("damping at rest")
    if damping is not None:
        notes.append(
            f"the test's damping ratio is {'higher' if damping.value > 0 else 'lower'} than the "
            f"model's by {percent(abs(damping.value), 3)} (s.d. {percent(damping.sd, 3)}), the "
            "same at all amplitudes"
        )
    for what, width in zip(("frequencies", "damping ratios"), found.mode.widths, strict=True):
        if width > _WIDE:
            notes.append(
                f"the law does not reproduce the {what}: residuals are {number(width, 2)} times "
                "the noise, and their weight was reduced accordingly"
            )
    if not found.mode.measured.has_damping:
        notes.append(
            "without damping ratios slip cannot be distinguished from other softening of the joint"
        )
    return [*notes, *found.mode.measured.notes]


def measured_mode_records(found: IdentificationResult) -> list[dict]:
    """Displacement, measured and computed frequency and damping ratio at each amplitude.

    The computed ones with what the model lacks at rest.
    """
    if found.mode is None:
        return []
    points, measured = found.responses[-1], found.mode.measured
    hz = 1.0 + getattr(found.offsets.get("frequency at rest"), "value", 0.0)
    more = getattr(found.offsets.get("damping at rest"), "value", 0.0)
    return doc.records(
        displacement_m=found.mode.displacements,
        test_hz=measured.frequencies_hz,
        model_hz=hz * points.frequencies_hz,
        test_damping=measured.damping,
        model_damping=more + points.damping_ratios,
    )


# -- charts ----------------------------------------------------------------------------------------


def _charts(r: HarmonicReport) -> list:
    """Charts, each under a heading. Collective."""
    # Loops are made of what all ranks hold.
    loops = [response.loops(response.peak.index) for response in r.responses]
    if r.rank != 0:
        return []
    blocks: list = [doc.Heading("Response at the levels of force"), responses_chart(r)]
    if r.backbone is not None or r.static_backbone is not None:
        blocks += [doc.Heading("Frequency and damping over amplitude"), over_amplitude(r)]
    for points in r.built.model.interfaces:
        blocks.append(doc.Heading(f"Hysteresis in {points.name}"))
        blocks.append(loops_chart(r, loops, points))
        if points.points is not None:
            drawn = partial(interface_map, r, points, loops[-1][points.name])
            blocks += [doc.Heading(f"Where {points.name} slips"), doc.Figure(drawn)]
    return blocks


def responses_chart(r: HarmonicReport) -> doc.View:
    """Amplitude over frequency, by level, with the backbone and what was measured."""
    curves = []
    for shade, response, f in zip(cycle(SERIES), r.responses, r.facts, strict=False):
        amplitude, hz = response.amplitude(SENSOR, r.kind), response.frequencies_hz
        label = quantity(f.level, r.level_unit)
        curves.append(Curve(label, hz, amplitude, shade))
        curves.append(Curve(label, [f.peak_hz], [f.peak], shade, 0, mark="o"))
        for found in r.stability:
            if found.level == f.level:
                curves += _stability(found, hz, amplitude, r.kind, shade, label)
        if f.measured_peak is not None:
            curves.append(Curve(f"{label}, measured", *r.curves.at(f.level), shade, 0, mark="x"))
    if (b := r.backbone) is not None:
        shown = b.frequencies_hz, b.amplitude(SENSOR, r.kind)
        low, high = min(np.min(c.x) for c in curves), max(np.max(c.x) for c in curves)
        top = 1.05 * max(np.nanmax(c.y) for c in curves)
        there = (shown[0] >= low) & (shown[0] <= high) & (shown[1] <= top)
        curves.append(Curve("backbone", shown[0][there], shown[1][there], INK, 1.0, (4, 3)))
    ylabel = f"{r.kind} at the sensor{r.relative}, {r.unit}"
    peaks = "; ".join(f"{quantity(f.level, r.level_unit)}: {f.peak_hz:.3f} Hz" for f in r.facts)
    alt = f"Response over frequency. Peaks at {peaks}."
    return curve_chart(curves, "frequency, Hz", [ylabel], alt, file="responses")


def _stability(
    found: LevelStability, hz: np.ndarray, amplitude: np.ndarray, kind: str, shade: str, label: str
) -> list[Curve]:
    """Unstable responses dashed, bifurcations as squares, the branches that leave there dotted."""
    lost = np.where(found.stability.stable, np.nan, amplitude)
    curves = [Curve(f"{label}, unstable", hz, lost, PAPER, 1.0, (3, 3))]
    at = [
        (b.frequency_hz, amplitude[b.index : b.index + 2].mean())
        for b in found.stability.bifurcations
    ]
    if at:
        curves.append(Curve(f"{label}, bifurcation", *np.transpose(at), shade, 0, mark="s"))
    for _, made in found.branches:
        branch = made.frequencies_hz, made.amplitude(SENSOR, kind)
        curves.append(Curve(f"{label}, branch", *branch, shade, 1.2, (1, 2)))
    return curves


def over_amplitude(r: HarmonicReport) -> doc.View:
    """Frequency and damping of the mode over its amplitude, with the levels' peaks."""
    both = [b for b in (r.backbone, r.static_backbone) if b is not None]
    tested = measured_mode_records(r.identified[-1]) if r.identified else []
    curves = []
    for panel, (values, peak, test, factor) in enumerate(
        (
            ("frequencies_hz", "peak_hz", "test_hz", 1),
            ("damping_ratios", "damping_ratio", "test_damping", 100),
        )
    ):
        for b in both:
            look = (INK, 1.6, (4, 3)) if b is r.static_backbone else (SERIES[0],)
            name = b.method.replace("epmc", "periodic")
            curves.append(
                Curve(name, b.amplitude(), factor * getattr(b, values), *look, panel=panel)
            )
        for shade, f in zip(cycle(SERIES), r.facts, strict=False):
            at = [f.peak_displacement_m], [factor * getattr(f, peak)]
            name = f"peak at {quantity(f.level, r.level_unit)}"
            curves.append(Curve(name, *at, shade, 0, mark="o", panel=panel))
        rows = [
            (row["displacement_m"], factor * row[test]) for row in tested if row[test] is not None
        ]
        if rows:
            curves.append(Curve("measured", *np.transpose(rows), INK, 0, mark="x", panel=panel))
    x, hz, zeta = both[0].amplitude(), both[0].frequencies_hz, both[0].damping_ratios
    alt = (
        f"Over displacements from {quantity(x[0], 'm')} to {quantity(x[-1], 'm')} the "
        f"frequency goes from {hz[0]:.3f} to {hz[-1]:.3f} Hz, the damping from "
        f"{percent(zeta[0])} to {percent(zeta[-1])}."
    )
    if r.backbone_note is not None:
        alt += f" {doc.sentence(r.backbone_note)}"
    axes = "displacement at the sensor, m", ["frequency, Hz", "damping ratio, %"]
    look = {"file": "amplitude", "log": (True, False), "size": (7.6, 3.0)}
    return curve_chart(curves, *axes, alt, **look)


def loops_chart(r: HarmonicReport, loops: list[dict], points) -> doc.View:
    """Stress over strain at the point that dissipates most, at the peak of every level."""
    name, made = points.name, loops[-1][points.name]
    at = int(np.argmax(made.dissipation))
    work = np.abs(np.ptp(made.strain[at], axis=0) * np.ptp(made.stress[at], axis=0))
    component = int(np.argmax(work))
    normal = points.normal and component == 0
    curves = []
    for shade, level, f in zip(cycle(SERIES), loops, r.facts, strict=False):
        strain, stress = (
            np.append(a[at, :, component], a[at, 0, component])
            for a in (level[name].strain, level[name].stress)
        )
        curves.append(Curve(quantity(f.level, r.level_unit), strain, stress / 1e3, shade))
    layer = name in r.case.joints
    words = ("normal strain", "shear strain") if layer else ("opening, m", "slip, m")
    place = "" if points.points is None else _place(points.points[at])
    return curve_chart(
        curves,
        words[0 if normal else 1],
        [f"{'normal' if normal else 'shear'} stress, kPa"],
        f"Loops at the point of most dissipation{place}.",
        file=f"loops-{name}",
        size=(7.6, 3.0),
    )


def _place(point: np.ndarray) -> str:
    return f", at ({', '.join(f'{round(1e3 * c, 1) + 0.0:.1f}' for c in point)}) mm"


def interface_map(r: HarmonicReport, points, made) -> str:
    """Slip and dissipation over an interface at the highest level's peak: in plan, or along it."""
    x, spread = 1e3 * points.points, np.ptp(points.points, axis=0)
    along, across = np.argsort(-spread)[:2]
    plan, order = spread[across] > 1e-3 * spread[along], np.argsort(x[:, along])
    per = "m²" if points.name in r.case.contacts else "m³"
    shown = {
        "slip, m" if per == "m²" else "shear strain": made.slip_amplitude,
        f"energy per cycle, J/{per}": made.dissipation,
    }
    with drawing(7.6, 3.0) as figure:
        for axes, (words, values) in zip(figure.subplots(1, 2), shown.items(), strict=True):
            axes.set(title=words, xlabel=f"{'xyz'[along]}, mm")
            if plan:
                flat = x[:, along], x[:, across]
                drawn = axes.tripcolor(*flat, values, shading="gouraud", rasterized=True)
                figure.colorbar(drawn, ax=axes, location="bottom", shrink=0.8)
                axes.set(ylabel=f"{'xyz'[across]}, mm", aspect="equal")
            else:
                axes.plot(x[order, along], values[order], color=SERIES[0], lw=1.4)
        worst = int(np.argmax(made.dissipation))
        return to_svg(
            figure,
            f"map-{points.name}",
            f"Slip and dissipation over {points.name} at {r.facts[-1].level:g} N; most energy"
            f"{_place(points.points[worst])}.",
        )

"""The cut-off pressure of contacts, updated on the test: `[update.cutoff]` (Fronk et al. 2019)."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

import fenics_joints
from fenics_joints.case import Case, build_preload
from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.preload import (
    area_words,
    bolt_axes,
    bolt_centres,
    bolt_forces,
    contact_blocks,
    contact_facts,
    forces_in_words,
)
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.files import plain
from fenics_joints.formatting import percent, quantity
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.preload import STICK, ContactState, PreloadResult, PreloadSolver
from fenics_joints.preload.linear_joint import LinearJoint, pair_conditions
from fenics_joints.progress import Progress
from fenics_joints.report import document as doc
from fenics_joints.report.contact_pictures import status_map
from fenics_joints.report.style import CHOSEN, PLACEBO, SERIES, drawing, to_svg
from fenics_joints.updating import CutoffMinimum, CutoffModel, CutoffSweep, minimise, sweep

#: Change of ln f left after calibrating a parameter on a mode: far below a test's noise.
_CALIBRATED = 1e-6
#: Least change of ln f by ln of the parameter; with less the mode does not depend on it.
_FELT = 1e-6
#: Most Newton steps of the calibration, each by at most a factor of e^0.5: a factor of 400 in all.
_ITERATIONS = 12
_WORDS = {"two": "stuck or open", "three": "stuck, sliding or open"}
_COLOURS = {"two": CHOSEN, "three": PLACEBO}


def crossing(cutoffs: np.ndarray, frequencies_hz: np.ndarray, test_hz: float) -> float | None:
    """Cut-off, Pa, at which falling frequencies, (n,), first pass a test frequency; None if never.

    Linear between the two cut-offs about it.
    """
    below = np.flatnonzero(frequencies_hz <= test_hz)
    if not len(below) or below[0] == 0:
        return None
    k = int(below[0])
    high, low = frequencies_hz[k - 1], frequencies_hz[k]
    share = (high - test_hz) / (high - low)
    return float(cutoffs[k - 1] + share * (cutoffs[k] - cutoffs[k - 1]))


def run_cutoff(
    case: Case, comm: MPI.Intracomm, progress: Progress | None = None
) -> Outcome[CutoffReport]:
    """Update the cut-off pressure of a case's contacts. Collective.

    Raises:
        InputError: If the case lacks a test, contacts or bolts, or a frequency is missing.
        ConvergenceError: If a solution does not converge.
    """
    with threadpool_limits(1):
        found = _found(case, comm, progress or Progress(silent=True))
    return Outcome(found, cutoff_document(found))


def _found(case: Case, comm: MPI.Intracomm, progress: Progress) -> CutoffReport:
    started, section = time.perf_counter(), case.update.cutoff
    data = case.measurements()
    row = data.row(case.update.at)
    condition, test_hz = float(data.conditions[row]), data.frequencies_hz[row]
    if not np.all(np.isfinite(test_hz)):
        raise InputError(
            f"{case.path}: test.frequencies: a mode is missing at {condition:g}; expected all "
            "modes for the sum of their errors"
        )
    progress.step("building the model")
    model = build_preload(case, comm)
    joint, n = LinearJoint(model), len(test_hz)
    given, calibration = _calibrated(case, joint, data.mode_names, test_hz, progress)
    modes = _solve(joint, given, n)
    progress.step(f"contact of {model.jumps.n} degrees of freedom")
    result = PreloadSolver(model, given).solve(monitor=lambda i, norm: progress.advance())
    names = ("two", "three") if section.scheme == "both" else (section.scheme,)
    schemes = [_scheme(case, name, result, given, test_hz, progress) for name in names]
    axes = bolt_axes(result)
    return CutoffReport(
        case,
        result,
        (data.condition_name, condition, data.condition_unit),
        tuple(data.mode_names),
        test_hz,
        modes.frequencies_hz[modes.n_rigid : modes.n_rigid + n],
        calibration,
        [contact_facts(state, axes) for state in result.contacts.values()],
        schemes,
        time.perf_counter() - started,
    )


def _solve(joint: LinearJoint, given: Mapping[str, float], n: int, solver=None) -> Modes:
    """Modes of the stuck model, among them n elastic ones and some more."""
    return solve_modes(joint, given, n_modes=6 + n + 2, solver=solver)


def _calibrated(
    case: Case, joint: LinearJoint, names: Sequence[str], test_hz: np.ndarray, progress: Progress
) -> tuple[dict[str, float], dict | None]:
    """Newton's method in logarithms for one parameter, so that the stuck model has one mode."""
    wanted = case.update.cutoff.calibrate
    if wanted is None:
        return {}, None
    progress.step(f"calibrating {wanted.parameter} on {wanted.mode}")
    parameter = joint.parameters[wanted.parameter]
    column = list(joint.parameters).index(wanted.parameter)
    mode, value, solver = list(names).index(wanted.mode), parameter.value, None
    where = f"{case.path}: update.cutoff.calibrate: {wanted.mode}"
    for _ in range(_ITERATIONS):
        modes = _solve(joint, {wanted.parameter: value}, len(test_hz), solver)
        solver, index = modes.solver, modes.n_rigid + mode
        miss = math.log(test_hz[mode] / modes.frequencies_hz[index])
        slope = modes.gradients([index])[0, column] * value / (2 * modes.eigenvalues[index])
        progress.advance()
        if abs(miss) < _CALIBRATED:
            break
        if not abs(slope) > _FELT:
            raise InputError(
                f"{where} does not depend on {wanted.parameter}; expected another mode or parameter"
            )
        value *= math.exp(max(-0.5, min(0.5, miss / slope)))
    else:
        raise ConvergenceError(
            f"calibrating {wanted.parameter} on {wanted.mode} did not converge; calibrate another "
            "parameter"
        )
    if not parameter.lower <= value <= parameter.upper:
        raise InputError(
            f"{where} needs {wanted.parameter} = {value:g} {parameter.unit}, expected a value "
            f"within its bounds [{parameter.lower:g}, {parameter.upper:g}]"
        )
    facts = {"parameter": wanted.parameter, "mode": wanted.mode, "start": parameter.value}
    return {wanted.parameter: value}, {**facts, "value": value, "unit": parameter.unit}


def _scheme(
    case: Case,
    name: str,
    result: PreloadResult,
    given: Mapping[str, float],
    test_hz: np.ndarray,
    progress: Progress,
) -> SchemeReport:
    """All cut-off pressures by one scheme, and the least objective by full solutions alone."""
    start, section = time.perf_counter(), case.update.cutoff
    model = CutoffModel(
        result, scheme=name, n_elastic=len(test_hz), given=given, contacts=section.contacts
    )
    progress.step(f"{name} conditions: {len(model)} cut-off pressures", len(model))
    found = sweep(
        model, progress=lambda n, total, error: progress.reach(n, note=f"error {100 * error:.4f} %")
    )
    solves, seconds = model.solves, time.perf_counter() - start
    progress.step(f"{name} conditions: the minimum by full solutions")
    minimum = minimise(
        model,
        test_hz,
        max_solves=section.max_solves,
        progress=lambda n, cutoff, value: progress.advance(
            note=f"{cutoff / 1e6:.3g} MPa: {100 * value:.2f} %"
        ),
    )
    best = found.best(test_hz)
    facets = model.facets(best)
    return SchemeReport(
        name,
        found,
        best,
        found.objective(test_hz),
        minimum,
        [
            crossing(found.cutoffs, hz, f)
            for hz, f in zip(found.frequencies_hz.T, test_hz, strict=True)
        ],
        [replace(s, status=pair_conditions(s.interface, facets[s.name])) for s in model.states],
        float(sum(s.facet_area[facets[s.name] == STICK].sum() for s in model.states)),
        solves,
        seconds,
    )


@dataclass(frozen=True, eq=False)
class SchemeReport:
    """One scheme of conditions over all cut-off pressures.

    Attributes:
        scheme: ``"two"`` or ``"three"`` conditions.
        sweep: Frequencies at every cut-off.
        best: Step of the least objective in the sweep.
        objective_all: Objective at every step, (n_steps,).
        minimum: The least objective found by full solutions alone.
        crossings: Cut-off, Pa, at which each mode falls below its test frequency; None if never.
        states: The contacts at the best cut-off, with each pair's condition as its status.
        area: Area of the facets that are stuck there, m2.
        sweep_solves: Full solutions of the sweep.
        seconds: Time of the sweep.
    """

    scheme: str
    sweep: CutoffSweep
    best: int
    objective_all: np.ndarray
    minimum: CutoffMinimum
    crossings: list[float | None]
    states: list[ContactState]
    area: float
    sweep_solves: int
    seconds: float

    def __repr__(self) -> str:
        words = f"{self.cutoff / 1e6:.4g} MPa, sum of errors {100 * self.objective:.3g} %"
        return f"SchemeReport({self.scheme!r}, {words})"

    @property
    def cutoff(self) -> float:
        """Best cut-off pressure, Pa."""
        return float(self.sweep.cutoffs[self.best])

    @property
    def objective(self) -> float:
        """Sum of relative frequency errors there."""
        return float(self.objective_all[self.best])

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Elastic frequencies there, Hz, (n,)."""
        return self.sweep.frequencies_hz[self.best]

    def to_json(self) -> dict:
        """See `CutoffReport.to_json`."""
        m, found = self.minimum, self.sweep
        return {
            "scheme": self.scheme,
            "cutoff_pa": self.cutoff,
            "objective": self.objective,
            "frequencies_hz": self.frequencies_hz,
            "crossings_pa": self.crossings,
            "stuck_area_m2": self.area,
            "reduced_error": found.error,
            "full_solutions": self.sweep_solves,
            "seconds": self.seconds,
            "minimum": {
                "cutoff_pa": m.cutoff,
                "objective": m.objective,
                "frequencies_hz": m.frequencies_hz,
                "full_solutions": len(m.visited),
            },
            "sweep": {
                "cutoffs_pa": found.cutoffs,
                "frequencies_hz": found.frequencies_hz,
                "objective": self.objective_all,
            },
        }


@dataclass(frozen=True, eq=False)
class CutoffReport:
    """The result of ``fenics-joints update`` for a case with ``[update.cutoff]``.

    Attributes:
        case: The case.
        result: The preload state.
        condition: Name, value and unit of the test's condition.
        mode_names: Names of the test's modes.
        test_hz: Measured frequencies, Hz, (n,).
        stuck_hz: Those of the fully stuck model, (n,).
        calibration: Keys parameter, mode, start, value, unit; None without.
        contacts: Facts of each contact, see `contact_facts`.
        schemes: One for each scheme.
        seconds: Time of the whole run.
    """

    case: Case
    result: PreloadResult
    condition: tuple[str, float, str]
    mode_names: tuple[str, ...]
    test_hz: np.ndarray
    stuck_hz: np.ndarray
    calibration: dict | None
    contacts: list[dict]
    schemes: list[SchemeReport]
    seconds: float

    def __repr__(self) -> str:
        return f"CutoffReport({self.case.name!r}, {self.schemes})"

    @property
    def whole_area(self) -> float:
        """Area of the contacts, m2."""
        return sum(c["whole_area_m2"] for c in self.contacts)

    def to_json(self) -> dict[str, object]:
        """The content of ``--json``.

        Keys: ``version``, ``title``, ``dofs``, ``bolt_forces_n``, ``condition``, ``modes``,
        ``frequencies_hz`` (``test``, ``stuck``), ``calibration``, ``contacts`` and ``schemes``,
        each with ``scheme``, ``cutoff_pa``, ``objective``, ``frequencies_hz``, ``crossings_pa``,
        ``stuck_area_m2``, ``reduced_error``, ``full_solutions``, ``seconds``, ``minimum``, and
        ``sweep`` with all cut-offs.
        """
        return plain(
            {
                "version": fenics_joints.__version__,
                "title": self.case.title,
                "dofs": self.result.model.jumps.n,
                "bolt_forces_n": bolt_forces(self.result),
                "condition": dict(zip(("name", "value", "unit"), self.condition, strict=True)),
                "modes": self.mode_names,
                "frequencies_hz": {"test": self.test_hz, "stuck": self.stuck_hz},
                "calibration": self.calibration,
                "contacts": self.contacts,
                "schemes": [scheme.to_json() for scheme in self.schemes],
                "seconds": self.seconds,
            }
        )


# -- the document ----------------------------------------------------------------------------------


def cutoff_document(u: CutoffReport) -> doc.Document:
    """The document of an update of the cut-off pressure."""
    stuck = float(np.sum(np.abs(u.stuck_hz / u.test_hz - 1)))
    keys = [("stuck", percent(stuck), "sum of the relative errors, fully stuck")]
    for s in u.schemes:
        keys += [
            (f"cutoff-{s.scheme}", quantity(s.cutoff, "Pa"), f"best cut-off, {_WORDS[s.scheme]}"),
            (f"objective-{s.scheme}", percent(s.objective), "sum of the relative errors there"),
        ]
    blocks = [doc.Keys(keys)]
    if u.calibration is not None:
        c = u.calibration
        start, value = (quantity(c[key], c["unit"], 4) for key in ("start", "value"))
        blocks.append(
            doc.Text(
                f"{c['parameter']} = {value} (was {start}), so that {c['mode']} of the stuck model "
                "is as measured."
            )
        )
    caption = (
        "Sum of relative errors over the cut-off; ticks: where the search for the minimum alone "
        "solved the full model"
    )
    blocks.append(doc.Figure(lambda: _objective_picture(u), caption))
    for s in u.schemes:
        blocks += _scheme_blocks(u, s)
    model = u.result.model
    return doc.Document(
        u.case.name,
        "cut-off pressure",
        "Contact updated by one number: the cut-off pressure below which it is lost",
        [
            *blocks,
            doc.Heading("The contact under preload"),
            doc.Text(
                f"Bolt forces: {forces_in_words(u.result)}; {u.result.iterations} iterations, "
                f"{model.jumps.n} degrees of freedom."
            ),
            *contact_blocks(u.result, u.contacts),
        ],
        u.to_json,
    )


def _scheme_blocks(u: CutoffReport, s: SchemeReport) -> list:
    """One scheme: frequencies over the cut-off, at the best one, and how they were found."""
    rows = doc.records(
        mode=u.mode_names,
        test_hz=u.test_hz,
        stuck_hz=u.stuck_hz,
        best_hz=s.frequencies_hz,
        stuck_error_percent=100 * (u.stuck_hz / u.test_hz - 1),
        best_error_percent=100 * (s.frequencies_hz / u.test_hz - 1),
        crossing_pa=s.crossings,
    )
    table = doc.Table.of(
        rows,
        "mode: mode | test_hz: >measured, Hz | stuck_hz: >stuck, Hz | best_hz: >best, Hz | "
        "stuck_error_percent: >stuck | best_error_percent: >best | crossing_pa: >as measured at",
        caption=f"At the best cut-off, {quantity(s.cutoff, 'Pa')}",
        kind="frequencies",
    )
    m = s.minimum
    return [
        doc.Heading(f"{s.scheme.capitalize()} conditions: {_WORDS[s.scheme]}"),
        doc.Text(
            f"{s.scheme.capitalize()} conditions: best cut-off {quantity(s.cutoff, 'Pa')}, sum of "
            f"errors {percent(s.objective)}; stuck on {area_words(s.area)} of "
            f"{area_words(u.whole_area)}.",
            "bold",
        ),
        doc.Figure(
            lambda: _frequencies_picture(u, s),
            "Frequencies over the cut-off pressure; dashed: measured; dots: crossings; upright "
            "line: best",
        ),
        table,
        doc.OnPage(lambda: _maps(u.result, s)),
        doc.Text(
            f"{len(s.sweep.cutoffs)} cut-off pressures from {s.sweep_solves} solutions of the full "
            "model and reduced models between them, whose largest error was "
            f"{percent(s.sweep.error, 4)}, in {s.seconds:.0f} s. The search for the minimum alone "
            f"found {quantity(m.cutoff, 'Pa')} and {percent(m.objective)} with {len(m.visited)} "
            "full solutions.",
            "note",
        ),
    ]


def _maps(result: PreloadResult, s: SchemeReport) -> list[doc.Figure] | None:
    """Conditions of each contact at the best cut-off. Collective."""
    centres = bolt_centres(result)
    if result.model.comm.rank != 0:
        return None
    alt = f"Condition of the contact at the best cut-off, {quantity(s.cutoff, 'Pa')}."
    return [
        doc.Figure(
            to_svg(status_map(state, centres=centres), f"{s.scheme}{i}", alt),
            f"{state.name}: conditions at the best cut-off",
        )
        for i, state in enumerate(s.states)
    ]


def _frequencies_picture(u: CutoffReport, s: SchemeReport) -> str:
    """Frequencies over the cut-off pressure and measured ones (Fronk et al. 2019, figs. 10, 11)."""
    x = s.sweep.cutoffs / 1e6
    with drawing(7.6, 4.6) as figure:
        axes = figure.subplots()
        columns = (u.mode_names, u.test_hz, s.sweep.frequencies_hz.T, s.crossings)
        for shade, (name, test, hz, at) in zip(
            cycle(SERIES), zip(*columns, strict=True), strict=False
        ):
            axes.plot(x, hz, lw=1.5, color=shade)
            axes.axhline(test, color=shade, lw=1.1, ls=(0, (5, 3)))
            above = {"xytext": (4, 4), "textcoords": "offset points", "fontsize": 8.5}
            axes.annotate(name, (x[0], hz[0]), **above)
            if at is not None:
                axes.plot(at / 1e6, test, "o", ms=4.5, color=shade)
        axes.axvline(s.cutoff / 1e6, color=_COLOURS[s.scheme], lw=1.0)
        axes.set(xlabel="cut-off pressure, MPa", ylabel="frequency, Hz")
        axes.margins(x=0)
        alt = (
            f"Frequencies over the cut-off pressure, {_WORDS[s.scheme]}; dashed: measured; best at "
            f"{quantity(s.cutoff, 'Pa')}."
        )
        return to_svg(figure, f"hz-{s.scheme}", alt)


def _objective_picture(u: CutoffReport) -> str:
    """Sum of the relative errors over the cut-off pressure (Fronk et al. 2019, fig. 12)."""
    with drawing(7.6, 3.2) as figure:
        axes = figure.subplots()
        for s in u.schemes:
            x, colour = s.sweep.cutoffs / 1e6, _COLOURS[s.scheme]
            axes.plot(x, 100 * s.objective_all, color=colour, lw=1.6, label=_WORDS[s.scheme])
            axes.plot(s.cutoff / 1e6, 100 * s.objective, "o", color=colour, ms=5)
            steps = np.array(s.minimum.visited)
            axes.plot(x[steps], 100 * s.objective_all[steps], "|", color=colour, ms=9)
        axes.set(xlabel="cut-off pressure, MPa", ylabel="sum of relative errors, %")
        # Where almost nothing is stuck any more the error has no bounds of interest.
        axes.set_ylim(0, 250 * max(s.objective_all[0] for s in u.schemes))
        axes.margins(x=0)
        axes.legend(loc="best")
        words = "; ".join(
            f"{_WORDS[s.scheme]}: least at {quantity(s.cutoff, 'Pa')}" for s in u.schemes
        )
        return to_svg(figure, "objective", f"Sum of relative errors over the cut-off. {words}.")

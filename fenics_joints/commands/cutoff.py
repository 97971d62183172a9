"""The cut-off pressure of contacts, updated on the test: `[update.cutoff]` (Fronk et al. 2019)."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

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
from fenics_joints.formatting import hertz, percent, quantity
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.preload import STICK, ContactState, PreloadModel, PreloadResult, PreloadSolver
from fenics_joints.preload.linear_joint import LinearJoint, pair_conditions
from fenics_joints.progress import Progress
from fenics_joints.report.contact_pictures import status_map
from fenics_joints.report.document import Document, Figure, Heading, Keys, OnPage, Table, Text
from fenics_joints.report.style import CHOSEN, PLACEBO, drawing, to_svg
from fenics_joints.updating import CutoffMinimum, CutoffModel, CutoffSweep, minimise, sweep

#: Change of ln f left after calibrating a parameter on a mode.
_CALIBRATED = 1e-6
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
        found = _Run(case, comm, progress or Progress(silent=True)).report()
    return Outcome(found, cutoff_document(found))


class _Run:
    def __init__(self, case: Case, comm: MPI.Intracomm, progress: Progress):
        self.started = time.perf_counter()
        self.case, self.progress = case, progress
        self.section = case.update.cutoff
        data = case.measurements()
        row = data.row(case.update.at)
        self.condition = (data.condition_name, float(data.conditions[row]), data.condition_unit)
        self.mode_names = tuple(data.mode_names)
        self.test_hz = data.frequencies_hz[row]
        if not np.all(np.isfinite(self.test_hz)):
            raise InputError(
                f"{case.path}: test.frequencies: a mode is missing at {self.condition[1]:g}; "
                "expected all modes for the sum of their errors"
            )
        progress.step("building the model")
        self.model: PreloadModel = build_preload(case, comm)
        self.joint = LinearJoint(self.model)

    def report(self) -> CutoffReport:
        given, calibration = self._calibrated()
        stuck = self._stuck(given)
        self.progress.step(f"contact of {self.model.jumps.n} degrees of freedom")
        result = PreloadSolver(self.model, given).solve(
            monitor=lambda i, norm: self.progress.advance()
        )
        names = ("two", "three") if self.section.scheme == "both" else (self.section.scheme,)
        schemes = [self._scheme(name, result, given) for name in names]
        axes = bolt_axes(result)
        return CutoffReport(
            self.case,
            result,
            self.condition,
            self.mode_names,
            self.test_hz,
            stuck,
            calibration,
            [contact_facts(state, axes) for state in result.contacts.values()],
            schemes,
            time.perf_counter() - self.started,
        )

    @property
    def _n(self) -> int:
        return len(self.mode_names)

    def _solve(self, given, solver=None) -> Modes:
        return solve_modes(self.joint, given, n_modes=6 + self._n + 2, solver=solver)

    def _stuck(self, given) -> np.ndarray:
        modes = self._solve(given)
        return modes.frequencies_hz[modes.n_rigid : modes.n_rigid + self._n]

    def _calibrated(self) -> tuple[dict[str, float], dict | None]:
        """Newton's method in logarithms for one parameter, so that the stuck model has one mode."""
        wanted = self.section.calibrate
        if wanted is None:
            return {}, None
        self.progress.step(f"calibrating {wanted.parameter} on {wanted.mode}")
        parameter = self.joint.parameters[wanted.parameter]
        column = list(self.joint.parameters).index(wanted.parameter)
        mode, value, solver = self.mode_names.index(wanted.mode), parameter.value, None
        for _ in range(12):
            modes = self._solve({wanted.parameter: value}, solver)
            solver, index = modes.solver, modes.n_rigid + mode
            miss = math.log(self.test_hz[mode] / modes.frequencies_hz[index])
            slope = modes.gradients([index])[0, column] * value / (2 * modes.eigenvalues[index])
            self.progress.advance()
            if abs(miss) < _CALIBRATED:
                break
            if not abs(slope) > 1e-6:
                raise InputError(
                    f"{self.case.path}: update.cutoff.calibrate: {wanted.mode} does not depend on "
                    f"{wanted.parameter}; expected another mode or parameter"
                )
            value *= math.exp(max(-0.5, min(0.5, miss / slope)))
        else:
            raise ConvergenceError(
                f"calibrating {wanted.parameter} on {wanted.mode} did not converge; "
                "calibrate another parameter"
            )
        if not parameter.lower <= value <= parameter.upper:
            raise InputError(
                f"{self.case.path}: update.cutoff.calibrate: {wanted.mode} needs "
                f"{wanted.parameter} = {value:g} {parameter.unit}, expected a value within its "
                f"bounds [{parameter.lower:g}, {parameter.upper:g}]"
            )
        facts = {
            "parameter": wanted.parameter,
            "mode": wanted.mode,
            "start": parameter.value,
            "value": value,
            "unit": parameter.unit,
        }
        return {wanted.parameter: value}, facts

    def _scheme(self, name: str, result: PreloadResult, given) -> SchemeReport:
        start, contacts = time.perf_counter(), self.section.contacts
        model = CutoffModel(result, scheme=name, n_elastic=self._n, given=given, contacts=contacts)
        self.progress.step(f"{name} conditions: {len(model)} cut-off pressures", len(model))
        found = sweep(
            model,
            progress=lambda n, total, error: self.progress.reach(
                n, note=f"error {100 * error:.4f} %"
            ),
        )
        solves, seconds = model.solves, time.perf_counter() - start
        self.progress.step(f"{name} conditions: the minimum by full solutions")
        minimum = minimise(
            model,
            self.test_hz,
            max_solves=self.section.max_solves,
            progress=lambda n, cutoff, value: self.progress.advance(
                note=f"{cutoff / 1e6:.3g} MPa: {100 * value:.2f} %"
            ),
        )
        best = found.best(self.test_hz)
        facets = model.facets(best)
        return SchemeReport(
            name,
            found,
            best,
            found.objective(self.test_hz),
            minimum,
            [
                crossing(found.cutoffs, found.frequencies_hz[:, j], self.test_hz[j])
                for j in range(self._n)
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
        return {
            "scheme": self.scheme,
            "cutoff_pa": self.cutoff,
            "objective": self.objective,
            "frequencies_hz": self.frequencies_hz.tolist(),
            "crossings_pa": self.crossings,
            "stuck_area_m2": self.area,
            "reduced_error": self.sweep.error,
            "full_solutions": self.sweep_solves,
            "seconds": self.seconds,
            "minimum": {
                "cutoff_pa": self.minimum.cutoff,
                "objective": self.minimum.objective,
                "frequencies_hz": self.minimum.frequencies_hz.tolist(),
                "full_solutions": len(self.minimum.visited),
            },
            "sweep": {
                "cutoffs_pa": self.sweep.cutoffs.tolist(),
                "frequencies_hz": self.sweep.frequencies_hz.tolist(),
                "objective": self.objective_all.tolist(),
            },
        }


@dataclass(frozen=True, eq=False)
class CutoffReport:
    """What ``fenics-joints update`` found for a case with ``[update.cutoff]``.

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
        """What ``--json`` writes.

        Keys: ``version``, ``title``, ``dofs``, ``bolt_forces_n``, ``condition``, ``modes``,
        ``frequencies_hz`` (``test``, ``stuck``), ``calibration``, ``contacts`` and ``schemes``,
        each with ``scheme``, ``cutoff_pa``, ``objective``, ``frequencies_hz``, ``crossings_pa``,
        ``stuck_area_m2``, ``reduced_error``, ``full_solutions``, ``seconds``, ``minimum``, and
        ``sweep`` with all cut-offs.
        """
        name, value, unit = self.condition
        return {
            "version": fenics_joints.__version__,
            "title": self.case.title,
            "dofs": self.result.model.jumps.n,
            "bolt_forces_n": bolt_forces(self.result),
            "condition": {"name": name, "value": value, "unit": unit},
            "modes": list(self.mode_names),
            "frequencies_hz": {"test": self.test_hz.tolist(), "stuck": self.stuck_hz.tolist()},
            "calibration": self.calibration,
            "contacts": self.contacts,
            "schemes": [scheme.to_json() for scheme in self.schemes],
            "seconds": self.seconds,
        }


# -- what is said of it ----------------------------------------------------------------------------


def cutoff_document(u: CutoffReport) -> Document:
    """What is said of an update of the cut-off pressure."""
    stuck = float(np.sum(np.abs(u.stuck_hz / u.test_hz - 1)))
    keys = [("stuck", percent(stuck), "sum of the relative errors, fully stuck")]
    for s in u.schemes:
        keys += [
            (f"cutoff-{s.scheme}", quantity(s.cutoff, "Pa"), f"best cut-off, {_WORDS[s.scheme]}"),
            (f"objective-{s.scheme}", percent(s.objective), "sum of the relative errors there"),
        ]
    blocks = [Keys(keys)]
    if u.calibration is not None:
        c = u.calibration
        start, value = (quantity(c[key], c["unit"], 4) for key in ("start", "value"))
        blocks.append(
            Text(
                f"{c['parameter']} = {value} (was {start}), so that {c['mode']} of the stuck model "
                "is as measured."
            )
        )
    caption = (
        "Sum of relative errors over the cut-off; ticks: where the search for the minimum alone "
        "solved the full model"
    )
    blocks.append(Figure(lambda: _objective_picture(u), caption))
    for s in u.schemes:
        blocks += _scheme_blocks(u, s)
    model = u.result.model
    return Document(
        u.case.name,
        "cut-off pressure",
        "Contact updated by one number: the pressure below which it is lost",
        [
            *blocks,
            Heading("The contact under preload"),
            Text(
                f"Bolt forces: {forces_in_words(u.result)}; {u.result.iterations} iterations, "
                f"{model.jumps.n} degrees of freedom."
            ),
            *contact_blocks(u.result, u.contacts),
        ],
        u.to_json,
    )


def _scheme_blocks(u: CutoffReport, s: SchemeReport) -> list:
    """One scheme: frequencies over the cut-off, at the best one, and how they were found."""
    table = Table(
        "mode | >measured, Hz | >stuck, Hz | >best, Hz | >stuck | >best | >as measured at",
        caption=f"At the best cut-off, {quantity(s.cutoff, 'Pa')}",
        kind="frequencies",
    )
    columns = (u.mode_names, u.test_hz, u.stuck_hz, s.frequencies_hz, s.crossings)
    for name, test, stuck, best, crossing in zip(*columns, strict=True):
        errors = (percent(f / test - 1, sign=True) for f in (stuck, best))
        table.add(name, *map(hertz, (test, stuck, best)), *errors, quantity(crossing, "Pa"))
    m = s.minimum
    return [
        Heading(f"{s.scheme.capitalize()} conditions: {_WORDS[s.scheme]}"),
        Text(
            f"{s.scheme.capitalize()} conditions: best cut-off {quantity(s.cutoff, 'Pa')}, sum of "
            f"errors {percent(s.objective)}; stuck on {area_words(s.area)} of "
            f"{area_words(u.whole_area)}.",
            "bold",
        ),
        Figure(
            lambda: _frequencies_picture(u, s),
            "Frequencies over the cut-off pressure; dashed: measured; dots: crossings; upright "
            "line: best",
        ),
        table,
        OnPage(lambda: _maps(u.result, s)),
        Text(
            f"{len(s.sweep.cutoffs)} cut-off pressures from {s.sweep_solves} solutions of the full "
            "model and reduced models between them, whose largest error was "
            f"{percent(s.sweep.error, 4)}, in {s.seconds:.0f} s. The search for the minimum alone "
            f"found {quantity(m.cutoff, 'Pa')} and {percent(m.objective)} with {len(m.visited)} "
            "full solutions.",
            "note",
        ),
    ]


def _maps(result: PreloadResult, s: SchemeReport) -> list[Figure] | None:
    """Conditions of each contact at the best cut-off. Collective."""
    centres = bolt_centres(result)
    if result.model.comm.rank != 0:
        return None
    alt = f"Condition of the contact at the best cut-off, {quantity(s.cutoff, 'Pa')}."
    return [
        Figure(
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
        for j, name in enumerate(u.mode_names):
            line = axes.plot(x, s.sweep.frequencies_hz[:, j], lw=1.5, color=_shade(j))[0]
            axes.axhline(u.test_hz[j], color=_shade(j), lw=1.1, ls=(0, (5, 3)))
            axes.annotate(
                name,
                (x[0], s.sweep.frequencies_hz[0, j]),
                xytext=(4, 4),
                textcoords="offset points",
                fontsize=8.5,
            )
            if s.crossings[j] is not None:
                axes.plot(s.crossings[j] / 1e6, u.test_hz[j], "o", ms=4.5, color=line.get_color())
        axes.axvline(s.cutoff / 1e6, color=_COLOURS[s.scheme], lw=1.0)
        axes.set(xlabel="cut-off pressure, MPa", ylabel="frequency, Hz")
        axes.margins(x=0)
        alt = (
            f"Frequencies over the cut-off pressure, {_WORDS[s.scheme]}; dashed: measured; best at "
            f"{quantity(s.cutoff, 'Pa')}."
        )
        return to_svg(figure, f"hz-{s.scheme}", alt)


def _shade(j: int) -> str:
    return ("#2b7bba", "#8d949e", "#6b7f94", "#4d9a6a", "#7a5aa6", "#c2571a")[j % 6]


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

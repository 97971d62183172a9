"""The cut-off pressure of contacts, updated on the test: `[update.cutoff]` (Fronk et al. 2019)."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fenics_joints.case import Case, build_preload
from fenics_joints.commands.cutoff.page import cutoff_html
from fenics_joints.commands.cutoff.result import CutoffReport, SchemeReport
from fenics_joints.commands.cutoff.summary import show_cutoff
from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.preload.contacts import bolt_axes, contact_facts
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.preload import STICK, PreloadModel, PreloadResult, PreloadSolver
from fenics_joints.preload.linear_joint import LinearJoint, pair_conditions
from fenics_joints.progress import Progress
from fenics_joints.updating import CutoffModel, minimise, sweep

#: Change of ln f left after calibrating a parameter on a mode.
_CALIBRATED = 1e-6


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
    return Outcome.of(found, cutoff_html, show_cutoff)


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

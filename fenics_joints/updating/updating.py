"""Model updating: bounded, weighted least squares on frequencies, and curves over the torque.

Seed 001, eqs. 17 and 18, in the logarithms of the parameters, with adjoint sensitivities. The
iteration runs on a reduced model whose error is checked at the end, and made smaller if needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.optimize import least_squares
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from fenics_joints.beams import BeamStructure
from fenics_joints.beams.tested import ExactBeams
from fenics_joints.case.build import build_structure
from fenics_joints.case.case import Case
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements.gap import Gap, rms
from fenics_joints.modal.sensitivity import Identifiability, identifiability
from fenics_joints.progress import Progress
from fenics_joints.reduction.surrogate import Forward, Surrogate, crossing_names
from fenics_joints.structure.components import Parameter
from fenics_joints.updating.curves import CurveFit, fit_curves
from fenics_joints.updating.log_scale import LogScale

__all__ = ["Update", "UpdateReport", "run", "update"]

_SAMPLES = 16
#: Range of the samples about the start, as factors down and up.
_DOWN, _UP = 300.0, 10.0
#: Largest accepted relative frequency error of the reduced model.
_REDUCED = 2e-4


@dataclass(frozen=True, eq=False)
class Update:
    """Parameters identified from one set of frequencies.

    Attributes:
        names: Names of the parameters.
        values: Their values, SI.
        log_sd: Standard deviations of their logarithms, data and regularisation together.
        information: Inverse covariance of the logarithms, shape (p, p).
        frequencies_hz: The model's frequencies, shape (m,).
        identifiability: What the data alone determine.
        iterations: Number of accepted and rejected steps.
        message: Why the iteration ended.
    """

    names: tuple[str, ...]
    values: np.ndarray
    log_sd: np.ndarray
    information: np.ndarray
    frequencies_hz: np.ndarray
    identifiability: Identifiability
    iterations: int
    message: str


def update(
    forward: Forward,
    parameters: Sequence[Parameter],
    measured_hz: np.ndarray,
    log_sd: np.ndarray,
    start: Mapping[str, float],
    *,
    centre: Mapping[str, float] | None = None,
    regularisation: float = 2.3,
    max_evaluations: int = 100,
) -> Update:
    """Bounded, weighted least squares (seed 001, eqs. 17 and 18) in log parameters.

    Args:
        forward: Frequencies and sensitivities.
        parameters: What is identified; positive.
        measured_hz: Measured frequencies, Hz, shape (m,); nan where missing.
        log_sd: Standard deviations of their logarithms, shape (m,): the weights.
        start: Values of all the model's parameters at the start.
        centre: Values about which the regularisation holds the parameters; the start by default.
        regularisation: Its standard deviation, of the logarithm.
        max_evaluations: Model evaluations before giving up.

    Raises:
        InputError: For a parameter that is not positive, or without data.
        ConvergenceError: If the iteration does not converge.
    """
    names = tuple(p.name for p in parameters)
    for name in names:
        if not start[name] > 0:
            raise InputError(f"start of {name} = {start[name]:g}: expected a positive value.")
    used = np.isfinite(measured_hz)
    if not used.any():
        raise InputError("frequencies: expected at least one measured value.")
    problem = _Problem(
        forward, names, start, np.log(measured_hz[used]), log_sd[used], used,
        np.log([(centre or start)[n] for n in names]), regularisation,
    )  # fmt: skip
    scale = problem.scale
    low, high = scale.bounds(parameters)
    x = np.clip(scale.inverse(np.log([start[n] for n in names])), low + 1e-9, high - 1e-9)
    result = least_squares(
        problem.residual, x, problem.slope, bounds=(low, high), x_scale=1.0,
        ftol=1e-8, xtol=1e-7, gtol=1e-7, max_nfev=max_evaluations,
    )  # fmt: skip
    if result.status <= 0:
        raise ConvergenceError(
            f"updating {', '.join(names)} did not converge in {max_evaluations} evaluations; "
            "start nearer, or identify fewer parameters",
            result.message,
        )
    return problem.finish(result)


class _Problem:
    """Residuals and slopes of one identification, in the coordinates of `LogScale`."""

    def __init__(self, forward, names, start, log_f, log_sd, used, centre, regularisation):
        self.forward, self.names, self.start = forward, names, dict(start)
        self.log_f, self.log_sd, self.used = log_f, log_sd, used
        self.centre, self.regularisation = centre, regularisation
        self.scale = LogScale(names, forward.model)
        position = list(forward.model.parameters)
        self.columns = [position.index(name) for name in names]

    def values(self, x) -> dict[str, float]:
        at = np.exp(self.scale.logs(x)).tolist()
        return {**self.start, **dict(zip(self.names, at, strict=True))}

    def residual(self, x):
        log_f, _ = self.forward(self.values(x))
        pull = (self.scale.logs(x) - self.centre) / self.regularisation
        return np.concatenate([(log_f[self.used] - self.log_f) / self.log_sd, pull])

    def slope(self, x):
        return self._log_slope(x) @ self.scale.slope(x)

    def _log_slope(self, x):
        """Slope of all residuals by the log parameters."""
        return np.concatenate([self.data_slope(x), np.eye(len(x)) / self.regularisation])

    def data_slope(self, x):
        """Whitened sensitivities by the log parameters."""
        _, by_values = self.forward(self.values(x))
        slope = by_values[self.used][:, self.columns] * np.exp(self.scale.logs(x))
        return slope / self.log_sd[:, None]

    def finish(self, result) -> Update:
        slope = self._log_slope(result.x)
        information = slope.T @ slope
        log_f, _ = self.forward(self.values(result.x))
        return Update(
            self.names,
            np.exp(self.scale.logs(result.x)),
            np.sqrt(np.diag(np.linalg.inv(information))),
            information,
            np.exp(log_f),
            identifiability(self.data_slope(result.x), self.names),
            int(result.nfev),
            _WORDS.get(result.status, result.message),
        )


#: What scipy's status says, in words.
_WORDS = {
    1: "converged: the gradient vanishes",
    2: "converged: the sum of squares no longer falls",
    3: "converged: the parameters no longer change",
    4: "converged: neither the sum of squares nor the parameters change any more",
}


@dataclass(frozen=True, eq=False)
class UpdateReport:
    """What ``fenics-joints update`` found.

    Attributes:
        title: The case's title.
        condition: Name and unit of the condition.
        at: Condition at which ``parameters`` were identified.
        parameters: Dicts with name, value, unit, sd (of the logarithm), start.
        gap_before: Test against the model at the start, one row.
        gap_after: Test against the updated model, one row.
        published: Somebody's parameters, their frequencies and this model's at those parameters:
            keys source, parameters, frequencies_hz, model_hz, errors_percent; or None.
        identifiability: What the data alone determine.
        iterations: Model evaluations.
        message: Why the iteration ended.
        torque_fits: For every condition a dict with condition, parameters, sd, frequencies_hz,
            errors_percent, held_out.
        curves: Dicts with name, form, a, b: one per parameter; empty for a single condition.
        curve_gap_fitted: RMS error of the curves' model on the conditions they were fitted to.
        curve_gap_heldout: The same on those held out; None if there are none.
        curve_gap_validation: The same on validation data; None if there are none.
        curve_frequencies: Test against the curves' model at all conditions; None without curves.
        validation: Test against the curves' model on the validation data, or None.
        model: Facts on the model: dofs, basis, frequency_error.
    """

    title: str
    condition: tuple[str, str]
    at: float
    parameters: list[dict]
    gap_before: Gap
    gap_after: Gap
    published: dict | None
    identifiability: Identifiability
    iterations: int
    message: str
    torque_fits: list[dict]
    curves: list[dict]
    curve_gap_fitted: float | None
    curve_gap_heldout: float | None
    curve_gap_validation: float | None
    curve_frequencies: Gap | None
    validation: Gap | None
    model: dict

    def to_json(self) -> dict:
        """The documented keys of ``update --json``."""
        found = self.identifiability
        rows = [
            {
                "name": p["name"],
                "value": p["value"],
                "unit": p["unit"],
                "standard_deviation": p["sd"] * p["value"],
                "relative_standard_deviation": p["sd"],
                "start": p["start"],
                "determined": p["name"] not in found.undetermined,
            }
            for p in self.parameters
        ]
        return {
            "title": self.title,
            "condition": {"name": self.condition[0], "unit": self.condition[1], "value": self.at},
            "parameters": rows,
            "frequencies_hz": {
                "test": _listed(self.gap_after.test_hz[0]),
                "before": _listed(self.gap_before.model_hz[0]),
                "after": _listed(self.gap_after.model_hz[0]),
            },
            "errors_percent": _listed(100 * self.gap_after.relative[0]),
            "errors_before_percent": _listed(100 * self.gap_before.relative[0]),
            "identifiability": {
                "condition": _finite(found.condition),
                "collinearity": _finite(found.collinearity),
                "undetermined": list(found.undetermined),
                "weakest_direction": dict(zip(found.names, found.weakest.tolist(), strict=True)),
            },
            "iterations": self.iterations,
            "published": self.published,
            "torque_fits": self.torque_fits,
            "curves": self.curves,
            "curve_gap": {
                "fitted": self.curve_gap_fitted,
                "heldout": self.curve_gap_heldout,
                "validation": self.curve_gap_validation,
            },
            "model": self.model,
        }


def _listed(values) -> list:
    return [None if np.isnan(v) else float(v) for v in values]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


# -- the command -----------------------------------------------------------------------------------


def run(case: Case, comm: MPI.Intracomm, progress: Progress | None = None) -> UpdateReport:
    """Update a case's model at one condition, then at all, then as curves. Collective.

    Raises:
        InputError: If the case has no test or no section [update].
        ConvergenceError: If an identification does not converge.
    """
    # Matrices of this size are too small for a second BLAS thread to be worth waking.
    with threadpool_limits(1):
        return _Run(case, comm, progress or Progress(silent=True)).report()


class _Run:
    def __init__(self, case: Case, comm, progress):
        if case.update is None:
            raise InputError(f"{case.path}: update is missing, expected a section [update]")
        self.case, self.progress, self.section = case, progress, case.update
        self.data = case.measurements()
        progress.step("building the model")
        self.full = build_structure(case, comm)
        self.parameters = [self.full.parameters[name] for name in self.section.parameters]
        self.start = {**case.nominal(), **case.start()}
        at = self.section.at
        self.at = self.data.row(at) if at is not None else len(self.data) - 1
        self.failed: list[float] = []
        self.surrogate = self._surrogate()
        self.forward = self.surrogate.forward

    def _surrogate(self) -> Surrogate | ExactBeams:
        if isinstance(self.full, BeamStructure):
            return ExactBeams(
                self.full, self.start, sensors=self.data.sensors,
                n_test=len(self.data.mode_names), n_modes=self.case.diagnose.n_modes,
                shapes=self.data.shapes,
            )  # fmt: skip
        samples = self._samples()
        self.progress.step("reduced model: sampling the parameters", len(samples))
        return Surrogate(
            self.full, samples, self.start, sensors=self.data.sensors,
            n_test=len(self.data.mode_names), n_modes=self.case.diagnose.n_modes,
            shapes=self.data.shapes,
            progress=self.progress,
        )  # fmt: skip

    def _samples(self) -> list[dict[str, float]]:
        """A Sobol sequence about the start; points that no law allows are left out."""
        names = [p.name for p in self.parameters]
        start = np.array([self.start[n] for n in names])
        low = np.log(np.maximum(start / _DOWN, [p.lower for p in self.parameters]))
        high = np.log(np.minimum(start * _UP, [p.upper for p in self.parameters]))
        samples = [self.start]
        for row in qmc.Sobol(len(names), seed=1).random(8 * _SAMPLES):
            point = np.exp(low + row * (high - low)).tolist()
            values = {**self.start, **dict(zip(names, point, strict=True))}
            if self._allowed(values):
                samples.append(values)
            if len(samples) > _SAMPLES:
                break
        return samples

    def _allowed(self, values) -> bool:
        try:
            for number, region in enumerate(self.full.regions):
                q = self.full.field.region_values(number, values)
                if q is not None:
                    region.law.check(region.name, q)
        except InputError:
            return False
        return True

    # -- fits --------------------------------------------------------------------------------

    def _fit(self, row: int, start) -> Update:
        return update(
            self.forward, self.parameters, self.data.frequencies_hz[row],
            self.data.log_sd()[row], start, centre=self.start,
            regularisation=self.section.regularisation,
        )  # fmt: skip

    def _values(self, found: Update) -> dict[str, float]:
        return {**self.start, **dict(zip(found.names, found.values.tolist(), strict=True))}

    def _checked(self, row: int) -> Update:
        """Identify at a condition; where the reduced model errs there, better it and repeat."""
        for _ in range(3):
            found = self._fit(row, self.start)
            self.error, modes = self.surrogate.error([self._values(found)])
            if self.error < _REDUCED:
                break
            self.surrogate.refine(modes)
        return found

    def _sweep(self, first: Update) -> dict[int, Update]:
        """All conditions, each started from its neighbour, from the first one outwards.

        A condition at which the identification does not converge is left out and reported.
        """
        n = len(self.data)
        found: dict[int, Update] = {self.at: first}
        for rows in (range(self.at + 1, n), range(self.at - 1, -1, -1)):
            values = self._values(first)
            for row in rows:
                if self.data.shapes is None:
                    self.forward.track(values)
                try:
                    found[row] = self._fit(row, values)
                    values = self._values(found[row])
                except ConvergenceError:
                    self.failed.append(float(self.data.conditions[row]))
                self.progress.advance()
        if self.data.shapes is None:
            self.forward.track(self._values(first))
        return dict(sorted(found.items()))

    # -- report ------------------------------------------------------------------------------

    def report(self) -> UpdateReport:
        data, condition = self.data, float(self.data.conditions[self.at])
        self.progress.step(f"updating at {data.condition_name} {condition:g} {data.condition_unit}")
        before = np.exp(self.forward(self.start)[0])
        first = self._checked(self.at)
        self.progress.step("updating at all conditions", len(data) - 1)
        fits = self._sweep(first)
        held = [data.row(c) for c in self.section.hold_out]
        self.progress.step("fitting curves")
        curves = self._curves(fits, held)
        rows = [[self.at]]
        gap_before, gap_after = (
            Gap(data.conditions[r], data.mode_names, data.frequencies_hz[r], f[None, :])
            for r, f in zip(rows * 2, (before, first.frequencies_hz), strict=True)
        )
        return UpdateReport(
            title=self.case.title,
            condition=(data.condition_name, data.condition_unit),
            at=condition,
            parameters=self._table(first),
            gap_before=gap_before,
            gap_after=gap_after,
            published=self._published(),
            identifiability=first.identifiability,
            iterations=first.iterations,
            message=first.message,
            torque_fits=self._fits_table(fits, held),
            **self._curve_fields(curves, held),
            model={
                "dofs": self.full.n_dofs,
                "basis": self.surrogate.model.n_dofs,
                "frequency_error": self.error,
                "crossing_modes": crossing_names(self.surrogate, data.mode_names),
                "not_converged": [f"{c:g} {data.condition_unit}".strip() for c in self.failed],
            },
        )

    def _table(self, found: Update) -> list[dict]:
        return [
            {
                "name": p.name,
                "value": float(v),
                "unit": p.unit,
                "sd": float(sd),
                "start": self.start[p.name],
            }
            for p, v, sd in zip(self.parameters, found.values, found.log_sd, strict=True)
        ]

    def _fits_table(self, fits: Mapping[int, Update], held: Sequence[int]) -> list[dict]:
        table = []
        for row, found in fits.items():
            relative = found.frequencies_hz / self.data.frequencies_hz[row] - 1
            table.append(
                {
                    "condition": float(self.data.conditions[row]),
                    "parameters": dict(zip(found.names, found.values.tolist(), strict=True)),
                    "sd": dict(zip(found.names, found.log_sd.tolist(), strict=True)),
                    "frequencies_hz": found.frequencies_hz.tolist(),
                    "errors_percent": _listed(100 * relative),
                    "held_out": row in held,
                }
            )
        return table

    def _published(self) -> dict | None:
        published = self.section.published
        if published is None:
            return None
        given = self.case.published()
        model = np.exp(self.forward({**self.start, **given})[0])
        theirs = np.array(published.frequencies or [np.nan] * len(model))
        return {
            "source": published.source,
            "parameters": given,
            "frequencies_hz": _listed(theirs),
            "model_hz": model.tolist(),
            "errors_percent": _listed(100 * (model / theirs - 1)),
        }

    # -- curves ------------------------------------------------------------------------------

    def _curves(self, fits: Mapping[int, Update], held: Sequence[int]) -> CurveFit | None:
        conditions = self.data.conditions
        kept = [row for row in fits if row not in held]
        if len(kept) < 3 or np.any(conditions <= 0):
            return None
        return fit_curves(
            self.forward, [p.name for p in self.parameters], self.start,
            conditions[kept], self.data.frequencies_hz[kept], self.data.log_sd()[kept],
            np.log([fits[row].values for row in kept]), [fits[row].information for row in kept],
            self.section.regularisation,
        )  # fmt: skip

    def _curve_fields(self, curves: CurveFit | None, held: Sequence[int]) -> dict:
        if curves is None:
            keys = ("gap_fitted", "gap_heldout", "gap_validation", "frequencies")
            return {"curves": [], "validation": None} | {f"curve_{key}": None for key in keys}
        whole = self._curve_gap(curves, self.data)
        kept = [row for row in range(len(self.data)) if row not in held]
        validation = self.case.validation()
        checked = None if validation is None else self._curve_gap(curves, validation)
        return {
            "curves": curves.table(np.linspace(*self._range(), 40)),
            "curve_gap_fitted": _part(whole, kept),
            "curve_gap_heldout": _part(whole, held) if held else None,
            "curve_gap_validation": None if checked is None else checked.rms,
            "curve_frequencies": whole,
            "validation": checked,
        }

    def _range(self) -> tuple[float, float]:
        """Lowest and highest condition of all data."""
        validation = self.case.validation()
        known = [self.data.conditions] + ([validation.conditions] if validation else [])
        known = np.concatenate(known)
        return float(known.min()), float(known.max())

    def _curve_gap(self, curves: CurveFit, data) -> Gap:
        model = [
            np.exp(self.forward({**self.start, **curves.values(float(c))})[0])
            for c in data.conditions
        ]
        return Gap(data.conditions, data.mode_names, data.frequencies_hz, np.array(model))


def _part(gap: Gap, rows: Sequence[int]) -> float:
    return rms(gap.relative[list(rows)])

"""``fenics-joints update`` on frequencies: at one condition, at all of them, and as curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from fenics_joints.case import Case, build_structure
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements.gap import Gap, rms
from fenics_joints.modal.sensitivity import Identifiability
from fenics_joints.progress import Progress
from fenics_joints.reduction.adaptive import improve
from fenics_joints.reduction.combined import allowed
from fenics_joints.reduction.tested import tested_models
from fenics_joints.updating.curves import CurveFit, fit_curves
from fenics_joints.updating.updating import Update, update

__all__ = ["UpdateReport", "run"]

_SAMPLES = 16
#: Range of the samples about the start, as factors down and up.
_DOWN, _UP = 300.0, 10.0
#: Largest accepted relative frequency error of the reduced model.
_REDUCED = 2e-4
#: How often the reduced model is looked at where the first condition's values are.
_ROUNDS = 3


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
        self.surrogate = tested_models(self.full).seen(
            self.full, self.start, sensors=self.data.sensors, n_test=len(self.data.mode_names),
            n_modes=case.diagnose.n_modes, shapes=self.data.shapes, samples=self._samples,
            progress=progress,
        )  # fmt: skip
        self.forward = self.surrogate.forward

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
            if allowed(self.full, values):
                samples.append(values)
            if len(samples) > _SAMPLES:
                break
        return samples

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
        found = None

        def fitted() -> list[dict[str, float]]:
            nonlocal found
            found = self._fit(row, self.start)
            return [self._values(found)]

        self.error = float(improve(self.surrogate, fitted, _REDUCED, _ROUNDS).max())
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
                "crossing_modes": self.surrogate.crossing_names(data.mode_names),
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

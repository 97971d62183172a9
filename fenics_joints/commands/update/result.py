"""The result of ``fenics-joints update``, and its JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from fenics_joints.commands.update.words import decibel, in_words
from fenics_joints.files import plain
from fenics_joints.formatting import percent
from fenics_joints.measurements.gap import Gap, rms
from fenics_joints.report.document import records
from fenics_joints.updating.result import Update


@dataclass(frozen=True, eq=False, repr=False)
class Compared:
    """Frequencies, Hz, or damping ratios of the test's modes beside the full model's.

    Attributes:
        test: Measured, (m,); nan where missing.
        before: At the start, (m,).
        after: Updated, (m,).
        fitted: Which of them the fit saw, (m,), bool.
    """

    test: np.ndarray
    before: np.ndarray
    after: np.ndarray
    fitted: np.ndarray

    @property
    def error_before(self) -> np.ndarray:
        """Relative errors, model over test minus one, (m,); nan where not measured."""
        return self.before / self.test - 1

    @property
    def error_after(self) -> np.ndarray:
        """The same, updated."""
        return self.after / self.test - 1

    def rms(self) -> tuple[float, float] | None:
        """Root mean squares of the errors of what was fitted, before and after; None if nothing."""
        if not self.fitted.any():
            return None
        return rms(self.error_before[self.fitted]), rms(self.error_after[self.fitted])

    def columns(self, prefix: str = "", unit: str = "") -> dict[str, np.ndarray]:
        """Its columns in the records of the modes."""
        found = {f"{key}{unit}": getattr(self, key) for key in ("test", "before", "after")}
        found["error_before_percent"] = 100 * self.error_before
        found["error_after_percent"] = 100 * self.error_after
        found["fitted"] = self.fitted
        return {f"{prefix}{key}": values for key, values in found.items()}


@dataclass(frozen=True, eq=False, repr=False)
class ModeTable(Compared):
    """Frequencies, Hz, of the test's modes beside the full model's, with MAC and damping ratios.

    Attributes:
        names: Names, m of them.
        mac_before: MAC of test by paired model modes, (m, m); None without shapes.
        mac_after: The same, updated.
        damping: Damping ratios; None if they are no data.
    """

    names: tuple[str, ...]
    mac_before: np.ndarray | None = None
    mac_after: np.ndarray | None = None
    damping: Compared | None = None

    def records(self) -> list[dict[str, object]]:
        """A record for each mode, as in the JSON of ``update``."""
        columns: dict[str, Sequence] = {"name": self.names, **self.columns(unit="_hz")}
        if self.mac_after is not None:
            columns |= {
                "mac_before": np.diag(self.mac_before),
                "mac_after": np.diag(self.mac_after),
            }
        if self.damping is not None:
            columns |= self.damping.columns("damping_")
        return records(**columns)


@dataclass(frozen=True, eq=False, repr=False)
class Functions:
    """Measured functions beside the full model's, at the same lines.

    Attributes:
        frequencies_hz: Lines, Hz, (n,).
        measured: Shape (n, n_responses, n_references), nan where not measured.
        before: The model's at the start.
        after: Updated.
        lines: Which lines were fitted, (n,), bool.
        held: Which values no fit saw, the shape of ``measured``, bool.
        unit: SI unit.
        names: Names of responses and of references.
        solution: Error of the model's functions by modes against a direct solution, relative.
    """

    frequencies_hz: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    lines: np.ndarray
    held: np.ndarray
    unit: str
    names: tuple[tuple[str, ...], tuple[str, ...]]
    solution: float

    def decibels(self, model: np.ndarray, where: np.ndarray | bool = True) -> float | None:
        """Root mean square of 20 lg |H_model / H_test|, dB; None where nothing was measured.

        Args:
            model: `before` or `after`.
            where: Which values, bool; all by default.
        """
        used = np.isfinite(self.measured) & where
        if not used.any():
            return None
        return rms(20 * np.log10(np.abs(model[used]) / np.abs(self.measured[used])))

    def frac(self, model: np.ndarray) -> np.ndarray:
        """Frequency response assurance criterion of each function, (n_responses, n_references).

        |sum_f conj(H_test) H_model|^2 / (sum |H_test|^2 sum |H_model|^2), over all lines.
        """
        cross = np.abs(np.sum(np.conj(self.measured) * model, axis=0)) ** 2
        return cross / (np.sum(np.abs(self.measured) ** 2, 0) * np.sum(np.abs(model) ** 2, 0))

    def summary(self) -> dict[str, float | None]:
        """Errors in dB: all, fitted and held out, before and after."""
        kinds = {"all": True, "fitted": self.lines[:, None, None] & ~self.held, "held": self.held}
        return {
            f"{kind}_{name}": self.decibels(getattr(self, name), where)
            for name in ("before", "after")
            for kind, where in kinds.items()
        }


@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """Fits at all conditions, and curves over them.

    Attributes:
        fits: For every condition a dict with condition, parameters, sd (relative), frequencies_hz,
            errors_percent, held_out.
        curves: Dicts with name, form, T0, a, b, samples: one per parameter; empty without curves.
        frequencies: Test against the curves' model at all conditions; None without curves.
        validation: The same on data for validation, or None.
        log_sd: Standard deviations of the measured ln f, (n, m).
    """

    fits: list[dict]
    curves: list[dict]
    frequencies: Gap | None
    validation: Gap | None
    log_sd: np.ndarray

    @property
    def held_out(self) -> np.ndarray:
        """Which conditions were left out of the curves, (n,), bool."""
        left = {fit["condition"] for fit in self.fits if fit["held_out"]}
        return np.array([c in left for c in self.frequencies.conditions])

    def gaps(self) -> dict[str, float | None]:
        """RMS errors of the curves' model: at the conditions they were fitted to, at those held out
        and on data for validation; None where there are none."""
        if self.frequencies is None:
            return dict.fromkeys(("fitted", "heldout", "validation"))
        errors, held = self.frequencies.relative, self.held_out
        return {
            "fitted": rms(errors[~held]),
            "heldout": rms(errors[held]) if held.any() else None,
            "validation": None if self.validation is None else self.validation.rms,
        }


@dataclass(frozen=True, eq=False, repr=False)
class UpdateReport:
    """The result of ``fenics-joints update``.

    Attributes:
        title: The case's title.
        condition: Name, value and unit of the condition; None without one.
        kinds: Kinds of data that were fitted.
        parameters: Records with name, value, unit, standard_deviation,
            relative_standard_deviation, start and determined.
        update: The fit.
        modes: Modes before and after; None if the test has none that are data.
        functions: Functions before and after; None if they are no data.
        held: Records of modes that the fit did not see: name, test_hz, before_hz, predicted_hz,
            error_percent, standard_deviation_percent, by the covariance of the parameters alone,
            alone (whether no other was held out), parameters; where ratios are data the numbers
            again, without a unit, behind ``damping_``.
        model: Facts on the model.
        sweep: Fits at all conditions and curves over them; None where one condition was asked for.
        notes: Remarks and warnings, in words.
        published: Somebody's parameters, their frequencies and this model's at those parameters:
            keys source, parameters, frequencies_hz, model_hz, errors_percent; or None.
        pull: Standard deviation by which the fit held each parameter at its start, of its logarithm
            (or its value over its size there); None where nothing did.
        shapes: Draws the shapes of the updated model, as blocks; None but on rank 0.
        without_partner: Names of the test's modes that match none of the model's; left out.
        failure: Why the fit explains nothing of the test, in words; None if it does.
    """

    title: str
    condition: tuple[str, float, str] | None
    kinds: tuple[str, ...]
    parameters: list[dict]
    update: Update
    modes: ModeTable | None
    functions: Functions | None
    held: list[dict]
    model: dict
    sweep: Sweep | None = None
    notes: list[str] = field(default_factory=list)
    published: dict | None = None
    pull: float | None = None
    shapes: Callable[[], list] | None = field(default=None, repr=False)
    without_partner: tuple[str, ...] = ()
    failure: str | None = None

    def __repr__(self) -> str:
        failed = "" if self.failure is None else "explains nothing, "
        kinds = ", ".join(self.kinds)
        return f"UpdateReport({self.title[:30]!r}, {failed}{kinds}: {self.update!r})"

    @property
    def conditions(self) -> tuple[float, float]:
        """Condition number of the paper's equations at the start: raw, and as they are solved."""
        first = self.update.history[0]
        return first.condition_before, first.condition_after

    def changes(self) -> dict[str, tuple[str, str]]:
        """Errors before and after in words, by kind of data; the MAC if shapes alone are data."""
        found, modes = {}, self.modes
        errors = None if modes is None else modes.rms()
        if errors is not None:
            found["frequencies"] = tuple(map(percent, errors))
        if modes is not None and modes.damping is not None:
            found["damping ratios"] = tuple(percent(e, 1) for e in modes.damping.rms())
        if self.functions is not None:
            levels = self.functions.summary()
            found["FRFs"] = decibel(levels["all_before"]), decibel(levels["all_after"])
        if not found and modes is not None and modes.mac_after is not None:
            lowest = (np.diag(m).min() for m in (modes.mac_before, modes.mac_after))
            found["lowest MAC"] = tuple(f"{m:.4f}" for m in lowest)
        return found

    def held_changes(self) -> dict[str, tuple[float, float]]:
        """RMS errors of held-out data before and after, by kind: relative, of FRFs in dB."""
        found = {}
        for what, key, unit in (("frequencies", "", "_hz"), ("damping ratios", "damping_", "")):
            keys = [f"{key}{part}{unit}" for part in ("test", "before", "predicted")]
            rows = [[h[k] for k in keys] for h in self.held if None not in map(h.get, keys)]
            if rows:
                test, before, after = np.array(rows, dtype=float).T
                found[what] = rms(before / test - 1), rms(after / test - 1)
        if self.functions is not None and self.functions.held.any():
            levels = self.functions.summary()
            found["FRFs"] = levels["held_before"], levels["held_after"]
        return found

    def to_json(self) -> dict[str, object]:
        """The documented keys of ``update --json``."""
        u, found, sweep, modes = self.update, self.update.identifiability, self.sweep, self.modes
        before, after = self.conditions
        condition, frequencies = self.condition, None
        if condition is not None:
            condition = dict(zip(("name", "value", "unit"), condition, strict=True))
        if modes is not None:
            frequencies = {"test": modes.test, "before": modes.before, "after": modes.after}
        return plain(
            {
                "title": self.title,
                "condition": condition,
                "method": u.method,
                "data": self.kinds,
                "parameters": self.parameters,
                "frequencies_hz": frequencies,
                "errors_percent": None if modes is None else 100 * modes.error_after,
                "errors_before_percent": None if modes is None else 100 * modes.error_before,
                "modes": None if modes is None else modes.records(),
                "modes_without_partner": self.without_partner,
                "functions_db": None if self.functions is None else self.functions.summary(),
                "held_modes": self.held,
                "condition_numbers": {"before": before, "after": after},
                "identifiability": {
                    "condition": found.condition,
                    "collinearity": found.collinearity,
                    "undetermined": found.undetermined,
                    "weakest_direction": dict(zip(found.names, found.weakest, strict=True)),
                    "in_words": in_words(found),
                },
                "iterations": u.evaluations,
                "fit": {
                    "chi2": u.chi2,
                    "degrees_of_freedom": u.degrees_of_freedom,
                    "evaluations": u.evaluations,
                    "converged": u.converged,
                    "message": u.message,
                    "reason": None if u.converged else u.message,
                    "regularisation": self.pull,
                    "held_by_prior": [] if self.pull is None else found.undetermined,
                    "explains_nothing": self.failure,
                    "excess": u.excess,
                    "widths": {
                        "frequencies": u.widths.frequencies,
                        "shapes": u.widths.shapes,
                        "damping": u.widths.damping,
                        "modes_left_out": u.widths.without,
                    },
                },
                "history": [
                    {"values": dict(zip(u.names, i.values, strict=True)), "moved": i.moved}
                    for i in u.history
                ],
                "torque_fits": [] if sweep is None else sweep.fits,
                "curves": [] if sweep is None else sweep.curves,
                "curve_gap": None if sweep is None else sweep.gaps(),
                "published": self.published,
                "model": self.model,
                "notes": self.notes,
            }
        )


def parameter_records(
    found: Update, units: Sequence[str], start: Sequence[float]
) -> list[dict[str, object]]:
    """The records of `UpdateReport.parameters`."""
    return [
        {
            "name": name,
            "value": float(value),
            "unit": unit,
            "standard_deviation": float(sd * abs(value)),
            "relative_standard_deviation": float(sd),
            "start": first,
            "determined": name not in found.identifiability.undetermined,
        }
        for name, value, unit, sd, first in zip(
            found.names, found.values, units, found.relative_sd, start, strict=True
        )
    ]

"""What ``fenics-joints update`` found, and its JSON."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fenics_joints.commands.update.view import UpdatedShapes
from fenics_joints.commands.update.words import decibel, in_words
from fenics_joints.files import plain
from fenics_joints.formatting import percent
from fenics_joints.measurements.gap import Gap, rms
from fenics_joints.updating.result import Update


@dataclass(frozen=True, eq=False, repr=False)
class Compared:
    """Frequencies, Hz, or damping ratios of the test's modes beside those of the full model.

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

    @property
    def measured(self) -> np.ndarray:
        """Indices of the modes of which it was measured."""
        return np.flatnonzero(np.isfinite(self.test))

    def rms(self) -> tuple[float, float] | None:
        """Root mean squares of the errors of what was fitted, before and after; None if nothing."""
        if not self.fitted.any():
            return None
        return rms(self.error_before[self.fitted]), rms(self.error_after[self.fitted])

    def row(self, j: int, prefix: str = "", unit: str = "") -> dict[str, float | bool | None]:
        """A mode in the JSON of ``update``."""
        numbers = {f"{key}{unit}": getattr(self, key)[j] for key in ("test", "before", "after")}
        numbers["error_before_percent"] = 100 * self.error_before[j]
        numbers["error_after_percent"] = 100 * self.error_after[j]
        numbers["fitted"] = self.fitted[j]
        return {f"{prefix}{key}": plain(value) for key, value in numbers.items()}


@dataclass(frozen=True)
class Predicted:
    """A frequency, Hz, or damping ratio that a fit did not see.

    Attributes:
        test: Measured; nan if it was not.
        before: The model's at the start.
        predicted: That of the model fitted to all else.
        sd: Relative standard deviation of that by the parameters' covariance alone; nan where no
            fitted mode had such a datum.
    """

    test: float
    before: float
    predicted: float
    sd: float

    @property
    def error(self) -> float:
        """Predicted over measured, minus one."""
        return self.predicted / self.test - 1

    def row(self, prefix: str = "", unit: str = "") -> dict[str, float | None]:
        """Keys of a held mode in the JSON of ``update``."""
        keys = ("test", "before", "predicted")
        row = {f"{key}{unit}": getattr(self, key) for key in keys}
        row |= {"error_percent": 100 * self.error, "standard_deviation_percent": 100 * self.sd}
        return {f"{prefix}{key}": plain(v) for key, v in row.items()}


@dataclass(frozen=True, eq=False, repr=False)
class ModeTable(Compared):
    """Frequencies of the test's modes beside those of the full model, Hz, and what goes with them.

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

    def to_json(self) -> list[dict[str, object]]:
        """A row for each mode."""
        rows = []
        for j, name in enumerate(self.names):
            row = {"name": name, **self.row(j, unit="_hz")}
            if self.mac_after is not None:
                row |= {"mac_before": self.mac_before[j, j], "mac_after": self.mac_after[j, j]}
            if self.damping is not None:
                row |= self.damping.row(j, "damping_")
            rows.append(row)
        return rows


@dataclass(frozen=True, eq=False, repr=False)
class Functions:
    """Measured functions beside those of the full model, at the same lines.

    Attributes:
        frequencies_hz: Lines, Hz, (n,).
        measured: Shape (n, n_responses, n_references), nan where not measured.
        before: The model's at the start.
        after: Updated.
        lines: Which lines were fitted, (n,), bool.
        held: Which values no fit saw, the shape of ``measured``, bool.
        kind: ``receptance``, ``mobility`` or ``accelerance``.
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
    kind: str
    unit: str
    names: tuple[tuple[str, ...], tuple[str, ...]]
    solution: float

    def decibels(self, model: np.ndarray, where: np.ndarray | None = None) -> float | None:
        """Root mean square of 20 lg |H_model / H_test|, dB; None where nothing was measured.

        Args:
            model: `before` or `after`.
            where: Which values, bool; all by default.
        """
        used = np.isfinite(self.measured) & (True if where is None else where)
        if not used.any():
            return None
        ratio = np.abs(model[used]) / np.abs(self.measured[used])
        return rms(20 * np.log10(ratio))

    @property
    def fitted(self) -> np.ndarray:
        """Which values were fitted, bool."""
        return self.lines[:, None, None] & ~self.held

    def frac(self, model: np.ndarray) -> np.ndarray:
        """Frequency response assurance criterion of each function, (n_responses, n_references).

        |sum_f conj(H_test) H_model|^2 / (sum |H_test|^2 sum |H_model|^2), over all lines.
        """
        cross = np.abs(np.sum(np.conj(self.measured) * model, axis=0)) ** 2
        return cross / (np.sum(np.abs(self.measured) ** 2, 0) * np.sum(np.abs(model) ** 2, 0))

    def summary(self) -> dict[str, float | None]:
        """Errors in dB: all, fitted and held out, before and after."""
        held = self.held if self.held.any() else None
        found = {}
        for name, model in (("before", self.before), ("after", self.after)):
            found[f"all_{name}"] = self.decibels(model)
            found[f"fitted_{name}"] = self.decibels(model, self.fitted)
            found[f"held_{name}"] = None if held is None else self.decibels(model, held)
        return found


@dataclass(frozen=True)
class HeldMode(Predicted):
    """A mode that a fit did not see: its frequency, Hz, and what goes with it.

    Attributes:
        name: Its name.
        values: What was identified without it, by parameter.
        alone: Whether it was the only one held out.
        damping: Its damping ratio, held out too; None if ratios are no data.
    """

    name: str
    values: dict[str, float]
    alone: bool
    damping: Predicted | None = None

    def to_json(self) -> dict[str, object]:
        """Its row in the JSON of ``update``."""
        row = {"name": self.name, **self.row(unit="_hz")}
        row |= {"alone": self.alone, "parameters": self.values}
        return row if self.damping is None else row | self.damping.row("damping_")


@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """What was found at all conditions, and as curves over them.

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
            return {"fitted": None, "heldout": None, "validation": None}
        errors, held = self.frequencies.relative, self.held_out
        return {
            "fitted": rms(errors[~held]),
            "heldout": rms(errors[held]) if held.any() else None,
            "validation": None if self.validation is None else self.validation.rms,
        }


@dataclass(frozen=True, eq=False, repr=False)
class UpdateReport:
    """What ``fenics-joints update`` found.

    Attributes:
        title: The case's title.
        condition: Name, value and unit of the condition; None without one.
        kinds: Kinds of data that were fitted.
        parameters: Dicts with name, value, unit, sd (relative), start.
        update: The fit.
        modes: Modes before and after; None if the test has none that are data.
        functions: Functions before and after; None if they are no data.
        held: Modes that were held out.
        sweep: Fits at all conditions and curves over them; None where one condition was asked for.
        model: Facts on the model.
        notes: What a reader has to know, in words.
        published: Somebody's parameters, their frequencies and this model's at those parameters:
            keys source, parameters, frequencies_hz, model_hz, errors_percent; or None.
        pull: Standard deviation by which the fit held each parameter at its start, of its logarithm
            (or its value over its size there); None where nothing did.
        shapes: Shapes of the updated model, to be seen; None but on rank 0.
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
    held: list[HeldMode]
    model: dict
    sweep: Sweep | None = None
    notes: list[str] = field(default_factory=list)
    published: dict | None = None
    pull: float | None = None
    shapes: UpdatedShapes | None = field(default=None, repr=False)
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

    def changes(self) -> list[tuple[str, str, str]]:
        """Errors before and after in words, by kind of data; the MAC if shapes alone are data."""
        found, modes = [], self.modes
        errors = None if modes is None else modes.rms()
        if errors is not None:
            found.append(("frequencies", *(percent(e) for e in errors)))
        if modes is not None and modes.damping is not None:
            found.append(("damping ratios", *(percent(e, 1) for e in modes.damping.rms())))
        if self.functions is not None:
            levels = self.functions.summary()
            words = (decibel(levels[key]) for key in ("all_before", "all_after"))
            found.append(("functions", *words))
        if not found and modes is not None and modes.mac_after is not None:
            macs = (float(np.min(np.diag(m))) for m in (modes.mac_before, modes.mac_after))
            found.append(("lowest MAC", *(f"{m:.4f}" for m in macs)))
        return found

    def to_json(self) -> dict[str, object]:
        """The documented keys of ``update --json``."""
        u, found, sweep, modes = self.update, self.update.identifiability, self.sweep, self.modes
        before, after = self.conditions
        return plain(
            {
                "title": self.title,
                "condition": None
                if self.condition is None
                else dict(zip(("name", "value", "unit"), self.condition, strict=True)),
                "method": u.method,
                "data": self.kinds,
                "parameters": [
                    {
                        "name": p["name"],
                        "value": p["value"],
                        "unit": p["unit"],
                        "standard_deviation": p["sd"] * abs(p["value"]),
                        "relative_standard_deviation": p["sd"],
                        "start": p["start"],
                        "determined": p["name"] not in found.undetermined,
                    }
                    for p in self.parameters
                ],
                "frequencies_hz": None
                if modes is None
                else {"test": modes.test, "before": modes.before, "after": modes.after},
                "errors_percent": None if modes is None else 100 * modes.error_after,
                "errors_before_percent": None if modes is None else 100 * modes.error_before,
                "modes": None if modes is None else modes.to_json(),
                "modes_without_partner": self.without_partner,
                "functions_db": None if self.functions is None else self.functions.summary(),
                "held_modes": [h.to_json() for h in self.held],
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


def prediction_sd(found: Update, slopes: np.ndarray) -> float:
    """Standard deviation of what has these derivatives by the parameters, by their covariance."""
    return float(np.sqrt(max(slopes @ found.covariance @ slopes, 0.0)))

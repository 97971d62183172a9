"""What an update to frequencies, shapes, damping ratios and functions found, and its JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fenics_joints.commands.update.damping import DampingTable, HeldRatio
from fenics_joints.formatting import number, percent, spread
from fenics_joints.measurements.gap import rms
from fenics_joints.modal.sensitivity import Identifiability
from fenics_joints.updating.result import CombinedUpdate

__all__ = ["CombinedReport", "Functions", "HeldMode", "ModeTable", "in_words"]

#: Share of a direction from which a parameter is named in it.
_NAMED = 0.2
#: Condition number from which a direction is known by rounding alone.
_OPEN = 1e10
#: Standard deviation of a logarithm from which nothing is known.
_UNKNOWN = 10.0


@dataclass(frozen=True, eq=False)
class ModeTable:
    """Modes of the test beside those of the full model.

    Attributes:
        names: Names, m of them.
        test_hz: Measured, Hz, (m,).
        before_hz: At the start, Hz, (m,).
        after_hz: Updated, Hz, (m,).
        fitted: Which of them the fit saw, (m,), bool.
        mac_before: MAC of test by paired model modes, (m, m); None without shapes.
        mac_after: The same, updated.
        damping: Damping ratios; None if they are no data.
    """

    names: tuple[str, ...]
    test_hz: np.ndarray
    before_hz: np.ndarray
    after_hz: np.ndarray
    fitted: np.ndarray
    mac_before: np.ndarray | None = None
    mac_after: np.ndarray | None = None
    damping: DampingTable | None = None

    @property
    def before(self) -> np.ndarray:
        """Relative errors, model over test minus one, (m,)."""
        return self.before_hz / self.test_hz - 1

    @property
    def after(self) -> np.ndarray:
        """The same, updated."""
        return self.after_hz / self.test_hz - 1


@dataclass(frozen=True, eq=False)
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
class HeldMode:
    """A mode that a fit did not see.

    Attributes:
        name: Its name.
        test_hz: Measured, Hz.
        before_hz: The model's at the start, Hz.
        predicted_hz: That of the model fitted to all else, Hz.
        sd: Relative standard deviation of that by the parameters' covariance alone.
        values: What was identified without it, by parameter.
        alone: Whether it was the only one held out.
        damping: Its damping ratio, held out too; None if ratios are no data.
    """

    name: str
    test_hz: float
    before_hz: float
    predicted_hz: float
    sd: float
    values: dict[str, float]
    alone: bool
    damping: HeldRatio | None = None

    @property
    def error(self) -> float:
        """Predicted over measured, minus one."""
        return self.predicted_hz / self.test_hz - 1


@dataclass(frozen=True, eq=False)
class CombinedReport:
    """What ``fenics-joints update`` found from several kinds of data.

    Attributes:
        title: The case's title.
        condition: Name, value and unit of the condition; None without one.
        kinds: Kinds of data that were fitted.
        parameters: Dicts with name, value, unit, sd (relative), start.
        update: The fit.
        modes: Modes before and after; None if the test has none that are data.
        functions: Functions before and after; None if they are no data.
        held: Modes that were held out.
        model: Facts on the model.
        notes: What a reader has to know, in words.
        published: As `UpdateReport.published`, or None.
        pull: Standard deviation by which the fit held each parameter at its start, of its logarithm
            (or its value over its size there); None where nothing did.
    """

    title: str
    condition: tuple[str, float, str] | None
    kinds: tuple[str, ...]
    parameters: list[dict]
    update: CombinedUpdate
    modes: ModeTable | None
    functions: Functions | None
    held: list[HeldMode]
    model: dict
    notes: list[str] = field(default_factory=list)
    published: dict | None = None
    pull: float | None = None

    @property
    def conditions(self) -> tuple[float, float]:
        """Condition number of the seed's equations at the start: raw, and as they are solved."""
        first = self.update.history[0]
        return first.condition_before, first.condition_after

    def json(self) -> dict[str, object]:
        """The documented keys of ``update --json``."""
        u, found = self.update, self.update.identifiability
        before, after = self.conditions
        return {
            "title": self.title,
            "condition": None if self.condition is None else dict(
                zip(("name", "value", "unit"), self.condition, strict=True)
            ),
            "method": u.method,
            "data": list(self.kinds),
            "parameters": [
                {
                    "name": p["name"], "value": p["value"], "unit": p["unit"],
                    "standard_deviation": _finite(p["sd"] * abs(p["value"])),
                    "relative_standard_deviation": _finite(p["sd"]), "start": p["start"],
                    "determined": p["name"] not in found.undetermined,
                }
                for p in self.parameters
            ],
            "modes": None if self.modes is None else _modes_json(self.modes),
            "functions_db": None if self.functions is None else self.functions.summary(),
            "held_modes": [
                {
                    "name": h.name, "test_hz": h.test_hz, "before_hz": h.before_hz,
                    "predicted_hz": h.predicted_hz, "error_percent": 100 * h.error,
                    "standard_deviation_percent": _finite(100 * h.sd), "alone": h.alone,
                    "parameters": h.values, **({} if h.damping is None else h.damping.json()),
                }
                for h in self.held
            ],
            "condition_numbers": {"before": _finite(before), "after": _finite(after)},
            "identifiability": {
                "condition": _finite(found.condition), "collinearity": _finite(found.collinearity),
                "undetermined": list(found.undetermined),
                "weakest_direction": dict(zip(found.names, found.weakest.tolist(), strict=True)),
                "in_words": in_words(found),
            },
            "fit": {
                "chi2": _finite(u.chi2), "degrees_of_freedom": u.degrees_of_freedom,
                "evaluations": u.evaluations, "message": u.message,
                "regularisation": self.pull,
            },
            "history": [
                {"values": dict(zip(u.names, i.values.tolist(), strict=True)), "moved": i.moved}
                for i in u.history
            ],
            "published": self.published,
            "model": self.model,
            "notes": list(self.notes),
        }  # fmt: skip


def _modes_json(modes: ModeTable) -> list[dict]:
    rows = []
    for j, name in enumerate(modes.names):
        row = {
            "name": name, "test_hz": _finite(modes.test_hz[j]), "before_hz": modes.before_hz[j],
            "after_hz": modes.after_hz[j], "error_before_percent": _finite(100 * modes.before[j]),
            "error_after_percent": _finite(100 * modes.after[j]), "fitted": bool(modes.fitted[j]),
        }  # fmt: skip
        if modes.mac_after is not None:
            row |= {"mac_before": modes.mac_before[j, j], "mac_after": modes.mac_after[j, j]}
        if modes.damping is not None:
            row |= modes.damping.row(j)
        rows.append(row)
    return rows


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


# -- identifiability -------------------------------------------------------------------------------


def in_words(found: Identifiability) -> list[str]:
    """What the data determine, in sentences."""
    least = int(np.argmax(np.where(np.isfinite(found.sd), found.sd, np.inf)))
    if not found.undetermined:
        words = f"The data alone determine {_and(found.names)}"
        if len(found.names) > 1:
            sd = found.sd[least]
            words += f"; the least well known is {found.names[least]}, to {accuracy(sd)}"
        sentences = [words + "."]
    else:
        rest = [name for name in found.names if name not in found.undetermined]
        first = f"The data alone do not determine {_and(found.undetermined)}"
        sentences = [f"{first}; they do {_and(rest)}." if rest else f"{first}."]
    together = _together(found)
    return [*sentences, together] if together else sentences


def _together(found: Identifiability) -> str | None:
    """The direction that the data know least, if several parameters take part in it."""
    parts = sorted(zip(found.weakest, found.names, strict=True), key=lambda p: -abs(p[0]))
    parts = [(float(share), name) for share, name in parts if abs(share) >= _NAMED]
    if len(parts) < 2:
        return None
    (a, first), (b, second), *_ = parts
    if found.condition < _OPEN:
        times = number(found.condition, 2)
        known = f"the data know it {times} times worse than the best-known combination"
    else:
        known = "the data do not know it at all"
    if len(parts) == 2 and abs(abs(a) - abs(b)) < 0.1:
        what = "ratio" if a * b > 0 else "product"
        how = "by a common factor" if a * b > 0 else "one up and the other down by a factor"
        return (
            f"{first} and {second} can change together, {how}, and {known}: what "
            f"the data see is their {what}."
        )
    sign = 1 if a > 0 else -1
    mixed = ", ".join(f"{name} {sign * share:+.2f}" for share, name in parts)
    return f"Least known is the combination {mixed} (of logarithms); {known}."


def _and(names: Sequence[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def accuracy(sd: float) -> str:
    """A relative standard deviation of two digits, a factor either way, or ``open``."""
    if sd > _UNKNOWN:
        return "open"
    return f"{number(100 * sd, 2)} %" if np.isfinite(sd) and sd < 0.3 else spread(sd)


def decibel(value: float | None) -> str:
    """A level difference such as ``0.42 dB``."""
    return "–" if value is None else f"{value:.2f} dB"


def start_words(report: CombinedReport) -> str | None:
    """What the start's pull has to do with the standard deviations, where it has."""
    left = report.update.identifiability.undetermined
    if report.pull is None or not left:
        return None
    those = "those" if len(left) > 1 else "that"
    return (
        f"Standard deviations, {those} of {_and(left)} above all, are with update.regularisation = "
        f"{number(report.pull, 2)}, which holds every parameter near its start, within a factor of "
        f"{number(float(np.exp(report.pull)), 2)}; by the data alone they would be larger."
    )


def gap_words(report: CombinedReport) -> str:
    """Before and after in a line."""
    parts = []
    if report.modes is not None and report.modes.fitted.any():
        before, after = (
            rms(e[report.modes.fitted]) for e in (report.modes.before, report.modes.after)
        )
        parts.append(f"frequencies {percent(before)} -> {percent(after)}")
    if report.modes is not None and report.modes.damping is not None:
        before, after = (percent(e, 1) for e in report.modes.damping.rms())
        parts.append(f"damping ratios {before} -> {after}")
    if report.functions is not None:
        found = report.functions.summary()
        parts.append(f"functions {decibel(found['all_before'])} -> {decibel(found['all_after'])}")
    if not parts and report.modes is not None and report.modes.mac_after is not None:
        before, after = (
            float(np.min(np.diag(m))) for m in (report.modes.mac_before, report.modes.mac_after)
        )
        parts.append(f"lowest MAC {before:.4f} -> {after:.4f}")
    return ", ".join(parts)

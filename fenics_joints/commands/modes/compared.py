"""A model's modes beside those of a test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_joints.case import Case
from fenics_joints.errors import InputError
from fenics_joints.files import plain
from fenics_joints.measurements.gap import UNLIKE, mac, pair_modes, partnered, rms
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.points import Sensors


@dataclass(frozen=True, eq=False)
class Compared:
    """Pairs of a test's and a model's modes, m of them.

    Attributes:
        condition: Name, value and unit of where the test was, such as ``torque``, 20, ``N·m``;
            None if it has one condition without a unit.
        names: Names of the test's modes.
        test_hz: Their frequencies, Hz, shape (m,); nan where not measured.
        model_hz: Those of the model's modes, Hz, shape (m,).
        index: Which modes of the model these are, shape (m,).
        partnered: Mask of the test's modes that have a partner, (m,); a mode that matches none of
            the model's has a row, but no partner (`measurements.gap.partnered`).
        candidates: Modes of the model that the test could see, shape (k,).
        matrix: MAC of each measured shape with each candidate, shape (m, k); None without shapes.
        sensors: Where and in which direction shapes were measured, n of them; or None.
        test_shapes: Measured shapes, (n, m), nan where a sensor was missing; or None.
        model_shapes: The partners' shapes in the scale of the measured ones, (n, m); or None.
    """

    condition: tuple[str, float, str] | None
    names: tuple[str, ...]
    test_hz: np.ndarray
    model_hz: np.ndarray
    index: np.ndarray
    partnered: np.ndarray
    candidates: np.ndarray
    matrix: np.ndarray | None = None
    sensors: Sensors | None = None
    test_shapes: np.ndarray | None = None
    model_shapes: np.ndarray | None = None

    def __repr__(self) -> str:
        return f"Compared({int(self.partnered.sum())} pairs of modes, {100 * self.rms:.3g} %)"

    @property
    def relative(self) -> np.ndarray:
        """Model over test minus one, shape (m,); nan where not measured, or without a partner."""
        return np.where(self.partnered, self.model_hz / self.test_hz - 1.0, np.nan)

    @property
    def rms(self) -> float:
        """Root mean square of the relative errors; nan without a pair."""
        return rms(self.relative) if np.isfinite(self.relative).any() else float("nan")

    @property
    def alone(self) -> tuple[str, ...]:
        """Names of the test's modes without a partner."""
        return tuple(n for n, has in zip(self.names, self.partnered, strict=True) if not has)

    @property
    def mac(self) -> np.ndarray | None:
        """MAC of each pair, shape (m,); None without measured shapes."""
        if self.matrix is None:
            return None
        columns = [int(np.flatnonzero(self.candidates == i)[0]) for i in self.index]
        return self.matrix[np.arange(len(columns)), columns]

    def to_json(self) -> dict[str, object]:
        """Keys: condition, pairs (name, test_hz, mode from 1, model_hz, error_percent, mac; null
        without a partner), gap (root mean square error of the pairs, relative), without_partner
        (names), and mac_matrix with its columns, modes from 1."""
        values = [None] * len(self.names) if self.mac is None else self.mac.tolist()
        pairs = []
        for j, name in enumerate(self.names):
            test, known = float(self.test_hz[j]), bool(np.isfinite(self.test_hz[j]))
            pair = {"name": name, "test_hz": test if known else None}
            pair |= dict.fromkeys(("mode", "model_hz", "error_percent", "mac"))
            if self.partnered[j]:
                pair |= {
                    "mode": int(self.index[j]) + 1,
                    "model_hz": float(self.model_hz[j]),
                    "error_percent": 100 * float(self.relative[j]) if known else None,
                    "mac": values[j],
                }
            pairs.append(pair)
        return {
            "condition": None if self.condition is None else list(self.condition),
            "pairs": pairs,
            "gap": plain(self.rms),
            "without_partner": list(self.alone),
            "mac_matrix": None if self.matrix is None else self.matrix.tolist(),
            "mac_modes": (self.candidates + 1).tolist(),
        }


def compared(case: Case, modes: Modes) -> Compared | str | None:
    """A model's modes beside the case's test; why not, in words; or None without a test.

    With measured shapes modes are paired by MAC, else in order. Collective.
    """
    data = case.measured
    if data is None or not np.isfinite(data.frequencies_hz).any():
        return None
    if data.shapes is not None:
        row = data.shape_row
    else:
        row = len(data) - 1 if case.row() is None else case.row()
    try:
        pairing = pair_modes(modes, len(data.mode_names), data.sensors, reference=data.shapes)
    except InputError as error:
        return f"not compared with the test: {error}"
    has = partnered(pairing, modes.frequencies_hz, data.frequencies_hz[row], data.shapes)
    has_condition = len(data) > 1 or bool(data.condition_unit)
    condition = (data.condition_name, float(data.conditions[row]), data.condition_unit)
    more = {}
    if data.shapes is not None:
        seen = modes.at(data.sensors)[:, pairing.visible]
        more = {
            "matrix": mac(data.shapes, seen),
            "sensors": data.sensors,
            "test_shapes": data.shapes,
            "model_shapes": _scaled(pairing.shapes, data.shapes),
        }
    return Compared(
        condition if has_condition else None,
        tuple(data.mode_names),
        data.frequencies_hz[row],
        modes.frequencies_hz[pairing.index],
        pairing.index,
        has,
        pairing.visible,
        **more,
    )


def _scaled(model: np.ndarray, test: np.ndarray) -> np.ndarray:
    """The model's shapes times the factor that brings each nearest to the test's (n, m)."""
    known = np.where(np.isnan(test), 0.0, test)
    there = np.where(np.isnan(test), 0.0, model)
    return model * np.sum(known * there, axis=0) / np.sum(there**2, axis=0)


def condition_words(beside: Compared) -> str:
    """Where the test was, such as " at torque 20 N·m"; empty for one condition without a unit."""
    if beside.condition is None:
        return ""
    name, value, unit = beside.condition
    return f" at {name} {value:g} {unit}".rstrip()


def alone_words(beside: Compared) -> str:
    """A note on test modes without a partner, with the reason."""
    why = "frequency" if beside.mac is None else "shape"
    return (
        f"{', '.join(beside.alone)}: left out of the error, since no mode of the model has this "
        f"{why}; {UNLIKE}"
    )

"""Data of a case's test that an update fits, and data that it holds out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.errors import InputError
from fenics_joints.measurements import FRFTarget, MeasuredFRFs, Target
from fenics_joints.measurements.frfs import choose_lines

#: How far the band of the lowest and the highest mode goes where there is no other, as a factor.
_ALONE = 1.2
#: Lines that are fitted by default, at most.
_LINES = 60


@dataclass(frozen=True, eq=False, repr=False)
class UpdateData:
    """A case's data at one condition.

    Attributes:
        kinds: Kinds of data that are fitted.
        condition: Name, value and unit of the condition; None without one.
        mode_names: Names of the test's modes, m of them; empty without.
        held_modes: Indices of modes that no fit sees.
        each: Whether every mode is held out in turn.
        target: What is fitted.
        frfs: The measured functions in their band; None if they are not data.
        relative_sd: Their relative standard deviation, the shape of their values.
        lines: Indices of the lines that are fitted, ascending.
        held: Which values no fit sees, by ``bands`` or ``responses``; the shape of the values.
    """

    kinds: tuple[str, ...]
    condition: tuple[str, float, str] | None
    mode_names: tuple[str, ...]
    held_modes: tuple[int, ...]
    each: bool
    target: Target
    frfs: MeasuredFRFs | None = None
    relative_sd: np.ndarray | None = None
    lines: np.ndarray | None = None
    held: np.ndarray | None = None

    def without(self, mode: int) -> Target:
        """The target without a mode: neither its frequency, nor lines around its resonance."""
        target = self.target.without_modes([mode])
        if target.frfs is None:
            return target
        low, high = _around(self.target.frequencies_hz, mode)
        frfs = target.frfs
        out = (frfs.frequencies_hz >= low) & (frfs.frequencies_hz <= high)
        values = np.where(out[:, None, None], np.nan, frfs.values)
        return replace(target, frfs=replace(frfs, values=values))


def _around(frequencies_hz: np.ndarray, mode: int) -> tuple[float, float]:
    """The band of a mode: to the middle, in ln f, between it and its neighbours."""
    f = float(frequencies_hz[mode])
    others = frequencies_hz[np.isfinite(frequencies_hz)]
    below, above = others[others < f], others[others > f]
    low = np.sqrt(f * below.max()) if len(below) else f / _ALONE
    high = np.sqrt(f * above.min()) if len(above) else f * _ALONE
    return float(low), float(high)


def update_data(case: Case) -> UpdateData:
    """The data of a case that `fenics_joints.case.check_update.check_combined` has passed.

    Raises:
        InputError: If there is no line to fit.
    """
    kinds, update = case.fitted_data(), case.update
    if not case.combined():
        kinds = ("frequencies",)
        case.measurements()  # an error if there are none
    fields = _modes(case, kinds)
    names = fields.pop("names")
    held = update.held
    each = held is not None and held.each
    modes = () if held is None or each else held.modes or ()
    held_modes = tuple(names.index(name) for name in modes)
    bands = [_around(fields["frequencies_hz"], mode) for mode in held_modes]
    functions = _functions(case, bands) if "frfs" in kinds else {}
    target = Target(**fields, frfs=functions.pop("target", None))
    if held_modes:
        target = target.without_modes(held_modes)
    return UpdateData(kinds, _condition(case), names, held_modes, each, target, **functions)


def _condition(case: Case) -> tuple[str, float, str] | None:
    data = case.measured
    if data is None or (case.combined() and len(data) == 1 and not data.condition_unit):
        return None
    row = data.row(case.update.at)
    return data.condition_name, float(data.conditions[row]), data.condition_unit


def _modes(case: Case, kinds) -> dict:
    """Fields of a `Target` on modes. Measured shapes pair them even where they are no data."""
    data = case.measured
    if data is None or not {"frequencies", "shapes", "damping"} & set(kinds):
        # Functions alone; but where resonances are is known, and pairs them with the model's.
        return {"names": ()}
    row = data.row(case.update.at)
    fields = {"names": data.mode_names, "shape_sensors": data.sensors}
    frequencies = data.frequencies_hz[row]
    if "frequencies" not in kinds:
        frequencies = np.full(len(frequencies), np.nan)
    fields |= {"frequencies_hz": frequencies, "log_sd": positive(data.log_sd()[row])}
    if "damping" in kinds:
        fields |= {"damping_ratios": data.damping[row], "damping_log_sd": data.damping_sd}
    if data.shapes is not None and data.sensors is not None:
        fields["shapes"] = data.shapes
        fields["shape_sd"] = data.shape_noise if "shapes" in kinds else None
    return fields


def positive(log_sd: np.ndarray) -> np.ndarray:
    """Standard deviations, 1 where there is no datum that they are of."""
    return np.where(log_sd > 0, log_sd, 1.0)


def _functions(case: Case, bands: list[tuple[float, float]]) -> dict:
    """Fields of `UpdateData` on functions, and their target; no line of ``bands`` is fitted."""
    frfs, section, held = case.frfs(), case.test.frfs, case.update.held
    sd = frfs.stated_sd(section.noise, section.averages)
    out = np.zeros(frfs.values.shape, dtype=bool)
    bands = [*bands, *((held.bands if held is not None else None) or ())]
    out[frfs.lines_in(bands)] = True
    for name in (held.responses if held is not None else None) or ():
        out[:, frfs.response_names.index(name)] = True
    lines = _lines(case, frfs, sd, out)
    target = FRFTarget.from_measured(frfs, lines, sd)
    seen = np.where(out[lines], np.nan, target.values)
    target = replace(target, values=seen)
    return {"target": target, "frfs": frfs, "relative_sd": sd, "lines": lines, "held": out}


def _lines(case: Case, frfs: MeasuredFRFs, sd, out) -> np.ndarray:
    """Indices of the lines to fit, those asked for or a choice."""
    wanted, f = case.update.lines, frfs.frequencies_hz
    allowed = ~out.all(axis=(1, 2)) & (f > 0)
    if isinstance(wanted, list):
        near = np.unique([np.abs(f - line).argmin() for line in wanted])
        if not allowed[near].any():
            raise InputError(f"{case.path}: update.lines: expected some that are not held out")
        return near[allowed[near]]
    fitted = not case.damping_names().isdisjoint(case.update.parameters)
    seen = np.where(out, np.nan, frfs.values)
    return choose_lines(f, seen, wanted or _LINES, relative_sd=sd, allowed=allowed, peaks=fitted)

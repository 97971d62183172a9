"""Backbones as a test at several levels, and the other way round."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.measurements.amplitude.backbone import RESPONSES, MeasuredBackbone
from fenics_joints.measurements.amplitude.columns import level_unit
from fenics_joints.measurements.data import TestData

__all__ = ["NOISE", "by_mode", "test_by_level"]

#: Relative deviation of a frequency that nobody states.
NOISE = 1e-3
#: Levels nearer than this are one.
_SAME = 1e-5


def test_by_level(backbones: Mapping[str, MeasuredBackbone], most: int = 8) -> TestData:
    """A test of one or more modes by level, as a diagnosis takes it.

    Args:
        backbones: By the modes' names.
        most: Most levels of each mode: see `MeasuredBackbone.condensed`.

    Raises:
        InputError: If their amplitudes are of different responses.
    """
    few = {name: backbone.condensed(most) for name, backbone in backbones.items()}
    kinds = {one.response for one in few.values()}
    if len(kinds) != 1:
        raise InputError(
            f"the modes' amplitudes are of {' and '.join(sorted(kinds))}; expected one kind"
        )
    each = {name: _apart(one.amplitudes) for name, one in few.items()}
    levels = np.unique(np.concatenate(list(each.values())))
    levels = levels[np.append(True, np.diff(levels) > _SAME * levels[1:])]
    f, zeta = (np.full((len(levels), len(few)), np.nan) for _ in range(2))
    noise, ratios = [], []
    for column, (name, one) in enumerate(few.items()):
        rows = [int(np.argmin(np.abs(levels - a))) for a in each[name]]
        f[rows, column], zeta[rows, column] = one.frequencies_hz, one.damping
        noise.append(np.sqrt(np.mean((one.frequencies_sd / one.frequencies_hz) ** 2)))
        there = one.damping > 0
        ratios += ((one.damping_sd[there] / one.damping[there]) ** 2).tolist()
    notes = tuple(dict.fromkeys(note for one in few.values() for note in one.notes))
    return TestData(
        levels, f, tuple(few), "level", RESPONSES[kinds.pop()], zeta if ratios else None,
        noise=np.array(noise), damping_noise=float(np.sqrt(np.mean(ratios))) if ratios else None,
        notes=notes,
    )  # fmt: skip


#: Not a test, whatever pytest thinks of the name.
test_by_level.__test__ = False


def _apart(levels: np.ndarray) -> np.ndarray:
    """Ascending levels of which none is there twice, as of two ring-downs."""
    found = levels.copy()
    for i in range(1, len(found)):
        found[i] = max(found[i], found[i - 1] * (1 + 2 * _SAME))
    return found


def by_mode(data: TestData) -> dict[str, MeasuredBackbone]:
    """Backbones of the modes of a test by level, by their names."""
    kind, factor = level_unit(data.condition_unit)
    log_sd, found = data.log_sd(), {}
    for j, name in enumerate(data.mode_names):
        rows = np.flatnonzero(np.isfinite(data.frequencies_hz[:, j]) & (data.conditions > 0))
        if not len(rows):
            continue
        f, sd = data.frequencies_hz[rows, j], log_sd[rows, j]
        zeta = np.full(len(rows), np.nan) if data.damping is None else data.damping[rows, j]
        zeta = np.where(zeta > 0, zeta, np.nan)
        found[name] = MeasuredBackbone(
            kind, factor * data.conditions[rows], f, np.where(sd > 0, sd, NOISE) * f, zeta,
            data.damping_sd * zeta,
        )  # fmt: skip
    return found

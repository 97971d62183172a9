"""The modes of universal files, as the test of a case."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fenics_joints.case.test import ShapesSection, Test
from fenics_joints.errors import InputError, located
from fenics_joints.measurements import MeasuredShapes, TestData, read_shapes


def read_universal(folder: Path, section: ShapesSection) -> MeasuredShapes:
    """The modes in the files of ``[test.shapes]``; raises InputError for what is wrong in them."""
    with located("test.shapes"):
        return read_shapes(
            [folder / file for file in section.files], length_unit=section.length_unit
        )


def modes_of(found: MeasuredShapes, names: Sequence[str] | None, test: Test) -> TestData:
    """A test of these modes alone: frequencies, damping and shapes at one condition.

    Args:
        found: The modes.
        names: Their names, as many as modes; numbered by default.
        test: Says the condition.

    Raises:
        InputError: If there are other than as many names.
    """
    count = len(found.frequencies_hz)
    names = [f"mode {i + 1}" for i in range(count)] if names is None else list(names)
    if len(names) != count:
        hertz = ", ".join(f"{f:.5g}" for f in found.frequencies_hz)
        raise InputError(
            f"{', '.join(found.sources)}: has {count} modes, at {hertz} Hz; expected {len(names)}, "
            "as named in modes"
        )
    return TestData(
        [1.0 if test.shapes_at is None else test.shapes_at],
        found.frequencies_hz[None],
        tuple(names),
        test.condition or "row",
        damping=None if np.isnan(found.damping).all() else found.damping[None],
        sensors=found.sensors,
        shapes=found.shapes,
    )


def shapes_of(found: MeasuredShapes, data: TestData) -> np.ndarray:
    """The shapes of a test's modes, (n_sensors, m), by the frequencies where they were measured.

    Raises:
        InputError: If a mode has no shape near its frequency.
    """
    hz = data.frequencies_hz[data.shape_row]
    if np.isnan(hz).any():
        raise InputError(
            f"{', '.join(found.sources)}: {data.mode_names[int(np.argmax(np.isnan(hz)))]} has no "
            "frequency where the shapes were measured; expected one for each mode, or shapes_at"
        )
    order = np.argsort(hz, kind="stable")
    index = np.empty(len(hz), dtype=int)
    index[order] = found.nearest(hz[order])
    return found.shapes[:, index]

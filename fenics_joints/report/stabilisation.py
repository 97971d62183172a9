"""The stabilisation diagram of an identification, as a PNG."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from fenics_joints.errors import InputError
from fenics_joints.files import check_writable
from fenics_joints.report.style import CHOSEN, NOISE, NOMINAL, PLACEBO, drawing

if TYPE_CHECKING:
    from mpi4py import MPI

    from fenics_joints.measurements.identification import IdentifiedModes


#: Room that a label needs, as a part of the band.
_CROWDED = 0.018


def write_stabilisation(
    modes: IdentifiedModes, path: str | Path, comm: MPI.Comm | None = None, dpi: int = 150
) -> None:
    """Draw poles over the order of the model, on the functions' mean, and the modes identified.

    Args:
        modes: From `identify_modes`.
        path: The PNG to be.
        comm: Where given, only its rank 0 writes.
        dpi: Dots per inch.

    Raises:
        InputError: If it cannot be written.
    """
    if comm is not None and comm.rank != 0:
        return
    path = check_writable(path, "picture")
    stream = io.BytesIO()
    with drawing(8.0, 4.4) as figure:
        _draw(figure, modes)
        figure.savefig(stream, format="png", dpi=dpi, facecolor="white")
    try:
        path.write_bytes(stream.getvalue())
    except OSError as error:
        raise InputError(f"picture {path}: cannot be written ({error.strerror})") from error


def label_levels(frequencies_hz: np.ndarray, room: float) -> list[int]:
    """Rows, from the top, in which labels stand beside none that they would cover."""
    rows: list[float] = []  # last label of each row
    found = []
    for f in frequencies_hz:
        row = next((i for i, last in enumerate(rows) if f - last > room), len(rows))
        rows[row : row + 1] = [f]
        found.append(row)
    return found


def _draw(figure: Figure, modes: IdentifiedModes) -> None:
    poles, frfs = modes.poles, modes.frfs
    axes = figure.subplots()
    level = axes.twinx()
    power = np.nanmean(np.abs(frfs.values) ** 2, axis=(1, 2))
    level.semilogy(frfs.frequencies_hz, np.sqrt(power), color=NOMINAL, lw=1.0, zorder=1)
    level.set_ylabel(f"root mean square {frfs.kind}, {frfs.unit}")
    level.spines["right"].set_visible(True)
    hollow = {"marker": "o", "facecolors": "none", "edgecolors": PLACEBO, "linewidths": 0.8}
    half = poles.stable_frequency & ~poles.stable
    for chosen, label, look in (
        (~poles.stable_frequency, "unstable", {"marker": ".", "color": "#c4c9cf", "s": 8}),
        (half, "stable frequency", {**hollow, "s": 16}),
        (poles.stable, "stable frequency and damping", {"marker": "+", "color": CHOSEN, "s": 26}),
    ):
        at = poles.frequencies_hz[chosen], poles.order[chosen]
        axes.scatter(*at, label=label, zorder=3, **look)
    levels = label_levels(modes.frequencies_hz, _CROWDED * np.ptp(frfs.frequencies_hz))
    look = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "va": "top"}
    look |= {"rotation": 90, "color": NOISE, "fontsize": 8}
    for i, (f, down) in enumerate(zip(modes.frequencies_hz, levels, strict=True)):
        axes.axvline(f, color=NOISE, lw=1.0, zorder=2, label="mode" if i == 0 else None)
        axes.annotate(f"{f:.6g}", (f, 1.0), (2, -2 - 40 * down), **look)
    axes.set_zorder(level.get_zorder() + 1)  # points above the curve
    axes.set_xlim(*frfs.frequencies_hz[[0, -1]])
    axes.set_ylim(0, poles.order.max(initial=1) + 1)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel("number of modes of the model")
    figure.legend(loc="outside upper center", ncols=4)

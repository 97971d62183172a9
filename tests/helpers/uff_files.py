"""Universal files in the layouts of test labs' programs, written record by record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np


def ints(*values: int) -> str:
    """Whole numbers in columns of ten."""
    return "".join(f"{value:10d}" for value in values)


def reals(*values: float, digits: int = 5) -> str:
    """Numbers in the columns of 6E13.5, or of 3E25.16."""
    return "".join(f"{value:{digits + 8 + (digits > 9)}.{digits}E}" for value in values)


def block(kind: int, *records: str) -> str:
    """A dataset."""
    return "\n".join(["    -1", f"{kind:6d}", *records, "    -1"]) + "\n"


def units_164(length: float = 1000.0) -> str:
    """A length in units by one in metres; exponents with D, as Fortran writes them."""
    factors = reals(length, 1.0, 1.0, digits=16).replace("E", "D")
    return block(164, f"{9:10d}{'USER_DEFINED':>20}{2:10d}", factors, reals(273.15, digits=16))


def nodes_2411(nodes: Mapping[int, Sequence[float]], system: int = 0) -> str:
    """Nodes by number, moving in the axes of a coordinate system."""
    records = []
    for label, point in nodes.items():
        records += [ints(label, 1, system, 1), reals(*point, digits=16)]
    return block(2411, *records)


def nodes_15(nodes: Mapping[int, Sequence[float]]) -> str:
    """The same with six digits."""
    return block(15, *[ints(n, 0, 0, 0) + reals(*point) for n, point in nodes.items()])


def mode_55(
    number: int,
    hz: float,
    shape: Mapping[int, Sequence[float]],
    *,
    ratio: float = 0.0,
    turns: bool = False,
    kind: int = 8,
    analysis: int = 2,
) -> str:
    """A normal mode by node, with rotations of 0.5 if it ``turns``."""
    records = [*["NONE"] * 5, ints(1, analysis, 2 + turns, kind, 2, 6 if turns else 3)]
    records += [ints(2, 4, 0, number), reals(hz, 0, ratio, 0)]
    for label, values in shape.items():
        records += [ints(label), reals(*values, *[0.5] * 3 * turns)]
    return block(55, *records)


def complex_mode_55(
    number: int, hz: float, ratio: float, shape: Mapping[int, Sequence[complex]]
) -> str:
    """A complex eigenvalue; records filled with blanks, numbers that touch, a reference 7:-x."""
    eigenvalue = 2 * np.pi * hz * complex(-ratio, np.sqrt(1 - ratio**2))
    records = ["Test lab", "Run 1", f"Mode Shape ({hz:.0f} Hz)", "NONE", ints(7, -1, 12, 13)]
    records += [ints(1, 3, 2, 8, 5, 3), ints(2, 6, 1, number)]
    records += [_touching(eigenvalue, 0j, 0j)]
    for label, values in shape.items():
        records += [ints(label), _touching(*values)]
    return block(55, *[record.ljust(80) for record in records])


def _touching(*values: complex) -> str:
    return "".join(f"{x:13.6E}" for z in values for x in (z.real, z.imag))

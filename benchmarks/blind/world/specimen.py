"""A specimen: all that is true of one test, as plain data that can be kept and read again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Spec:
    """What the world's answer follows from, all but the noise.

    Attributes:
        geometry: Name of the rig.
        test: ``torque`` or ``level``: what the rows are.
        effects: ``{"name", "region", "params"}`` each; names are keys of `effects.LIBRARY` or
            `effects.UNKNOWN`.
        nuisance: Factors and shifts within tolerance: E, rho, thickness (two each), heads,
            accelerometer (kg factor), place (m).
        scatter: True over nominal tightening of each row.
        damping: Damping ratio at rest of each mode.
        shapes_row: Row at which the shapes were measured.
        levels: Forces, N, of the rows of a level test.
    """

    geometry: str
    test: str = "torque"
    effects: list[dict[str, Any]] = field(default_factory=list)
    nuisance: dict[str, Any] = field(default_factory=dict)
    scatter: list[float] = field(default_factory=list)
    damping: list[float] = field(default_factory=list)
    shapes_row: int = -1
    levels: list[float] = field(default_factory=list)

"""What an update of the cut-off pressure found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import fenics_joints
from fenics_joints.case import Case
from fenics_joints.commands.preload.contacts import bolt_forces
from fenics_joints.preload import ContactState, PreloadResult
from fenics_joints.updating import CutoffMinimum, CutoffSweep


@dataclass(frozen=True, eq=False)
class SchemeReport:
    """One scheme of conditions over all cut-off pressures.

    Attributes:
        scheme: ``"two"`` or ``"three"`` conditions.
        sweep: Frequencies at every cut-off.
        best: Step of the least objective in the sweep.
        objective_all: Objective at every step, (n_steps,).
        minimum: The least objective found by full solutions alone.
        crossings: Cut-off, Pa, at which each mode falls below its test frequency; None if never.
        states: The contacts at the best cut-off, with each pair's condition as its status.
        area: Area of the facets that are stuck there, m2.
        sweep_solves: Full solutions of the sweep.
        seconds: Time of the sweep.
    """

    scheme: str
    sweep: CutoffSweep
    best: int
    objective_all: np.ndarray
    minimum: CutoffMinimum
    crossings: list[float | None]
    states: list[ContactState]
    area: float
    sweep_solves: int
    seconds: float

    def __repr__(self) -> str:
        words = f"{self.cutoff / 1e6:.4g} MPa, sum of errors {100 * self.objective:.3g} %"
        return f"SchemeReport({self.scheme!r}, {words})"

    @property
    def cutoff(self) -> float:
        """Best cut-off pressure, Pa."""
        return float(self.sweep.cutoffs[self.best])

    @property
    def objective(self) -> float:
        """Sum of relative frequency errors there."""
        return float(self.objective_all[self.best])

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Elastic frequencies there, Hz, (n,)."""
        return self.sweep.frequencies_hz[self.best]

    def to_json(self) -> dict:
        """See `CutoffReport.to_json`."""
        return {
            "scheme": self.scheme,
            "cutoff_pa": self.cutoff,
            "objective": self.objective,
            "frequencies_hz": self.frequencies_hz.tolist(),
            "crossings_pa": self.crossings,
            "stuck_area_m2": self.area,
            "reduced_error": self.sweep.error,
            "full_solutions": self.sweep_solves,
            "seconds": self.seconds,
            "minimum": {
                "cutoff_pa": self.minimum.cutoff,
                "objective": self.minimum.objective,
                "frequencies_hz": self.minimum.frequencies_hz.tolist(),
                "full_solutions": len(self.minimum.visited),
            },
            "sweep": {
                "cutoffs_pa": self.sweep.cutoffs.tolist(),
                "frequencies_hz": self.sweep.frequencies_hz.tolist(),
                "objective": self.objective_all.tolist(),
            },
        }


@dataclass(frozen=True, eq=False)
class CutoffReport:
    """What ``fenics-joints update`` found for a case with ``[update.cutoff]``.

    Attributes:
        case: The case.
        result: The preload state.
        condition: Name, value and unit of the test's condition.
        mode_names: Names of the test's modes.
        test_hz: Measured frequencies, Hz, (n,).
        stuck_hz: Those of the fully stuck model, (n,).
        calibration: Keys parameter, mode, start, value, unit; None without.
        contacts: Facts of each contact, see `contact_facts`.
        schemes: One for each scheme.
        seconds: Time of the whole run.
    """

    case: Case
    result: PreloadResult
    condition: tuple[str, float, str]
    mode_names: tuple[str, ...]
    test_hz: np.ndarray
    stuck_hz: np.ndarray
    calibration: dict | None
    contacts: list[dict]
    schemes: list[SchemeReport]
    seconds: float

    def __repr__(self) -> str:
        return f"CutoffReport({self.case.name!r}, {self.schemes})"

    @property
    def whole_area(self) -> float:
        """Area of the contacts, m2."""
        return sum(c["whole_area_m2"] for c in self.contacts)

    def to_json(self) -> dict[str, object]:
        """What ``--json`` writes.

        Keys: ``version``, ``title``, ``dofs``, ``bolt_forces_n``, ``condition``, ``modes``,
        ``frequencies_hz`` (``test``, ``stuck``), ``calibration``, ``contacts`` and ``schemes``,
        each with ``scheme``, ``cutoff_pa``, ``objective``, ``frequencies_hz``, ``crossings_pa``,
        ``stuck_area_m2``, ``reduced_error``, ``full_solutions``, ``seconds``, ``minimum``, and
        ``sweep`` with all cut-offs.
        """
        name, value, unit = self.condition
        return {
            "version": fenics_joints.__version__,
            "title": self.case.title,
            "dofs": self.result.model.jumps.n,
            "bolt_forces_n": bolt_forces(self.result),
            "condition": {"name": name, "value": value, "unit": unit},
            "modes": list(self.mode_names),
            "frequencies_hz": {"test": self.test_hz.tolist(), "stuck": self.stuck_hz.tolist()},
            "calibration": self.calibration,
            "contacts": self.contacts,
            "schemes": [scheme.to_json() for scheme in self.schemes],
            "seconds": self.seconds,
        }

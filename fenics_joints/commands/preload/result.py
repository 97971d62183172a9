"""What the ``preload`` command found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import fenics_joints
from fenics_joints.case import Case
from fenics_joints.commands.preload.contacts import bolt_forces
from fenics_joints.preload import PreloadResult

__all__ = ["PreloadReport"]


@dataclass(frozen=True, eq=False)
class PreloadReport:
    """What the ``preload`` command found.

    Attributes:
        case: The case.
        result: The preload state.
        contacts: A dict of facts for each contact, see `contact_facts`.
        stuck_hz: Elastic frequencies with all contacts fully stuck, and obstacles where they press,
            Hz, (n,).
        preloaded_hz: Elastic frequencies with each pair as the preload leaves it, Hz, (n,).
        written: Files of fields.
        applied: A dict of facts for each obstacle, displacement and load, see `applied_facts`.
    """

    case: Case
    result: PreloadResult
    contacts: list[dict]
    stuck_hz: np.ndarray
    preloaded_hz: np.ndarray
    written: tuple[Path, ...] = ()
    applied: tuple[dict, ...] = ()

    def __repr__(self) -> str:
        words = f"{self.result.iterations} iterations, {len(self.contacts)} contacts"
        return f"PreloadReport({self.case.name!r}, {words})"

    def to_json(self) -> dict[str, object]:
        """What ``--json`` writes.

        Keys: ``version``, ``title``, ``dofs``, ``bolt_forces_n``, ``iterations``,
        ``complementarity``, ``contacts`` (each with the keys of `contact_facts`), ``applied``
        (obstacles, displacements and loads, with the keys of `applied_facts`), and
        ``frequencies_hz`` with ``stuck`` and ``preloaded``.
        """
        return {
            "version": fenics_joints.__version__,
            "title": self.case.title,
            "dofs": self.result.model.jumps.n,
            "bolt_forces_n": bolt_forces(self.result),
            "iterations": self.result.iterations,
            "complementarity": self.result.complementarity,
            "contacts": self.contacts,
            "applied": self.applied,
            "frequencies_hz": {
                "stuck": self.stuck_hz.tolist(),
                "preloaded": self.preloaded_hz.tolist(),
            },
        }

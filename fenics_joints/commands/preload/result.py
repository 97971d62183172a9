"""What the ``preload`` command found."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import fenics_joints
from fenics_joints.case import Case
from fenics_joints.commands.preload.contacts import bolt_forces
from fenics_joints.files import plain
from fenics_joints.formatting import number, quantity
from fenics_joints.preload import PreloadResult

#: Friction and pressure, Pa, beyond those of any metal: a hard steel's indentation has some 8 GPa.
_ROUGH, _HARDEST = 2.0, 1e10
#: Gap over a face's size that counts as zero.
_FLAT = 1e-9


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
        free_motions: Number of motions that nothing resists in the preloaded state, beyond those
            of the stuck structure.
        become_hz: Frequencies of the preloaded modes that have the stuck ones' shapes, Hz, (n,);
            nan where none has.
    """

    case: Case
    result: PreloadResult
    contacts: list[dict]
    stuck_hz: np.ndarray
    preloaded_hz: np.ndarray
    written: tuple[Path, ...] = ()
    applied: tuple[dict, ...] = ()
    free_motions: int = 0
    become_hz: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def rows(self) -> list[tuple[float, float]]:
        """Frequencies, Hz, stuck and preloaded, of the same shapes; then those of the preloaded
        modes whose shapes no stuck mode has, beside nan."""
        other = self.preloaded_hz[~np.isin(self.preloaded_hz, self.become_hz)]
        pairs = zip(self.stuck_hz, self.become_hz, strict=True)
        return [*pairs, *((np.nan, hz) for hz in other)]

    @property
    def notes(self) -> list[str]:
        """Remarks on the state and its frequencies, and unlikely values, a sentence each."""
        found = [
            f"contact {c.name}: friction of {number(c.friction)} is unlikely; dry metals have "
            "0.1 to 1"
            for c in self.result.model.contacts
            if c.friction > _ROUGH
        ] + [
            f"contact {c['name']}: a peak pressure of {quantity(c['peak_pressure_pa'], 'Pa')} is "
            "more than metals bear: are the bolts' forces right?"
            for c in self.contacts
            if c["peak_pressure_pa"] > _HARDEST
        ]
        if not np.isfinite(self.become_hz).all():
            found.append(
                "a mode without a frequency beside it has no mode of its shape in the other state: "
                "what slides or opens mixes them anew"
            )
        if self.free_motions:
            found.append(
                f"sliding or open faces add {self.free_motions} "
                f"motion{'s' * (self.free_motions > 1)} that nothing resists, at 0 Hz, which "
                "this table leaves out"
            )
        if _recedes(self.result):
            found.append(
                "the faces touch everywhere before tightening, and only bolts press them (a "
                "receding contact): if all bolt forces change by one factor, the pressures change "
                "by it too, but the pressed area and these frequencies stay the same; they change "
                "with faces that have a gap or a crown, with other loads, and with joints whose "
                "stiffness depends on the pressure"
            )
        return found

    def __repr__(self) -> str:
        words = f"{self.result.iterations} iterations, {len(self.contacts)} contacts"
        return f"PreloadReport({self.case.name!r}, {words})"

    def to_json(self) -> dict[str, object]:
        """What ``--json`` writes.

        Keys: ``version``, ``title``, ``dofs``, ``bolt_forces_n``, ``iterations``,
        ``complementarity``, ``contacts`` (each with the keys of `contact_facts`), ``applied``
        (obstacles, displacements and loads, with the keys of `applied_facts`),
        ``frequencies_hz`` with ``stuck``, ``preloaded`` and ``stuck_become`` (of the preloaded
        modes of the stuck shapes; null where there is none), ``free_motions`` and ``notes``.
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
                "stuck_become": plain(self.become_hz),
            },
            "free_motions": self.free_motions,
            "notes": self.notes,
        }


def _recedes(result: PreloadResult) -> bool:
    """Whether only bolts press, and the faces have no gap: the state is then proportional.

    Dundurs and Stippes, J. Appl. Mech. 37, 1970.
    """
    model = result.model
    if model.moved or len(model.bolts) < len(result.forces):
        return False
    sizes = [np.ptp(i.points, axis=0).max() for i in model.interfaces]
    return bool(model.bolts) and all(
        np.abs(i.gap).max(initial=0.0) <= _FLAT * size
        for i, size in zip(model.interfaces, sizes, strict=True)
    )

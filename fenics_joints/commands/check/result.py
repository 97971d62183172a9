"""What the ``check`` command found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

import fenics_joints
from fenics_joints.case import Case, CostEstimate
from fenics_joints.commands.check.body import Body
from fenics_joints.commands.check.costs import Cost
from fenics_joints.commands.check.places import Place
from fenics_joints.commands.check.weights import Weight
from fenics_joints.files import plain
from fenics_joints.measurements.amplitude.backbone import RESPONSES


@dataclass(frozen=True, eq=False)
class Checked:
    """A case, looked at.

    Attributes:
        path: The case file.
        case: The case, or what can be read of it; None if nothing can.
        errors: What is wrong: a command would refuse it.
        notes: What is unlikely, or was moved or left out.
        weights: Masses of parts, joints and what is put on.
        places: Sensors, forces, masses, springs; obstacles, displacements and loads, at faces.
        bolts: Bolts.
        body: The mesh, on rank 0; None where there is none.
        size_m: Its extents, m.
        dofs: Degrees of freedom; None where no model could be made.
        estimate: What one modal solution takes; None where it is not known.
        costs: What the commands take.
        directions: Normal and across that the mesh gives to parts without any.
        solved: The modes that test and bands were compared with, in words, or why none.
    """

    path: Path
    case: Case | None
    errors: tuple[str, ...]
    notes: tuple[str, ...] = ()
    weights: tuple[Weight, ...] = ()
    places: tuple[Place, ...] = ()
    bolts: tuple[Place, ...] = ()
    body: Body | None = field(default=None, repr=False)
    size_m: np.ndarray = field(default_factory=lambda: np.empty(0))
    dofs: int | None = None
    estimate: CostEstimate | None = None
    costs: tuple[Cost, ...] = ()
    directions: Mapping[str, tuple[tuple, tuple]] = MappingProxyType({})
    solved: str = ""

    def __repr__(self) -> str:
        return f"Checked({self.path.name}: {len(self.errors)} errors, {len(self.notes)} notes)"

    @property
    def title(self) -> str:
        """Title of the case, or the name of its folder."""
        return self.path.parent.name if self.case is None else self.case.name

    @property
    def mass(self) -> float:
        """Mass of the model, kg: without what is attached but not in it."""
        return sum(w.mass for w in self.weights if w.kind != "attached")

    def moved(self) -> list[Place]:
        """Sensors and forces that are beside the mesh."""
        return [p for p in self.places if p.kind in ("sensor", "force") and p.off > 1e-6]

    def test_words(self) -> str:
        """What was measured, in words; empty without a test."""
        case, words = self.case, []
        if case is None or case.test is None:
            return ""
        data, frfs = case.measured, case.frfs()
        if data is not None and np.isfinite(data.frequencies_hz).any():
            low, high = np.nanmin(data.frequencies_hz), np.nanmax(data.frequencies_hz)
            count, span = len(data.mode_names), f"{low:.5g} to {high:.5g} Hz"
            span = span if high > low else f"{low:.5g} Hz"
            words.append(f"{count} mode{'s' * (count > 1)}, {span}")
            if len(data) > 1:
                span = f"{data.conditions[0]:g} to {data.conditions[-1]:g} {data.condition_unit}"
                words.append(f"at {len(data)} values of {data.condition_name}, {span}".rstrip())
            if data.shapes is not None:
                words.append(f"shapes at {len(data.shapes)} sensors")
            if data.damping is not None:
                words.append("damping ratios")
        for name in case.test.amplitude if not case.test.is_by_amplitude else ():
            if (one := case.backbones().get(name)) is not None:
                a = one.amplitudes
                span = f"{a[0]:.3g} to {a[-1]:.3g} {RESPONSES[one.response]}"
                words.append(f"{name} at {len(one)} levels, {span}")
        if frfs is not None:
            words.append(
                f"{int(frfs.measured.sum())} functions, {frfs.frequencies_hz[0]:g} to "
                f"{frfs.frequencies_hz[-1]:g} Hz"
            )
        return ", ".join(words) or ("planned" if case.test.planned else "not read")

    def to_json(self) -> dict[str, object]:
        """What ``--json`` writes.

        Keys: ``version``, ``title``, ``errors`` and ``notes`` in sentences; ``masses`` (``name``,
        ``kind``, ``kg``, ``weighed_kg``), ``mass_kg`` of the model; ``places`` (``kind``, ``name``,
        ``at_m``, ``direction``, ``off_mm``); ``bolts``, likewise; ``test`` and ``solved`` in
        words; ``size_m``, ``dofs``, ``costs`` (``command``, ``seconds``, ``bytes``).
        """
        return plain(
            {
                "version": fenics_joints.__version__,
                "title": self.title,
                "errors": list(self.errors),
                "notes": list(self.notes),
                "masses": [w.to_json() for w in self.weights],
                "mass_kg": self.mass if self.weights else None,
                "places": [p.to_json() for p in self.places],
                "bolts": [p.to_json() for p in self.bolts],
                "test": self.test_words(),
                "solved": self.solved,
                "size_m": self.size_m,
                "dofs": self.dofs,
                "costs": [vars(cost) for cost in self.costs],
            }
        )

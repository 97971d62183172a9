"""What the ``modes`` command found."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from textwrap import shorten

import numpy as np

import fenics_joints
from fenics_joints.case import Case
from fenics_joints.commands.modes.compared import Compared
from fenics_joints.formatting import number
from fenics_joints.measurements.gap import VISIBLE
from fenics_joints.meshes import Ring
from fenics_joints.modal.modes import Modes


@dataclass(frozen=True, eq=False)
class ModeList:
    """Modes of a case.

    Attributes:
        case: The case.
        modes: The modes.
        visibility: How much of each mode the test's sensors see, shape (n,), see
            `Modes.visibility`; None if the case does not say what the test saw.
        size_m: Extents along the axes, m, shape (gdim,); empty if not measured.
        rings: The bolts' rings ``ring_1``, ... of the mesh, those that are flat layers.
        notes: What is to be said of the test's data, see `fenics_joints.case.test_notes`.
        beside: The modes beside those of the test; None if the case has no data.
        written: Files of the shapes for ParaView.
    """

    case: Case
    modes: Modes
    visibility: np.ndarray | None
    size_m: np.ndarray = field(default_factory=lambda: np.empty(0))
    rings: tuple[Ring, ...] = ()
    notes: tuple[str, ...] = ()
    beside: Compared | None = None
    written: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        highest = f"to {self.frequencies_hz[-1]:.5g} Hz" if len(self.modes) else "none"
        return f"ModeList({shorten(self.case.name, 60)!r}, {len(self.modes)} modes, {highest})"

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Natural frequencies, Hz, shape (n,); 0 for rigid-body modes, whose value is round-off."""
        frequencies = self.modes.frequencies_hz.copy()
        frequencies[: self.modes.n_rigid] = 0.0
        return frequencies

    @property
    def visible(self) -> np.ndarray | None:
        """Mask of the modes that the test could see, (n,), with all partners of its modes and
        without rigid-body modes."""
        if self.visibility is None:
            return None
        seen = (self.visibility >= VISIBLE) & (np.arange(len(self.modes)) >= self.modes.n_rigid)
        if self.beside is not None:
            seen[self.beside.index[self.beside.partnered]] = True
        return seen

    def to_json(self) -> dict[str, object]:
        """What ``--json`` writes.

        Keys: ``version``, ``title``; ``dofs``, the number of degrees of freedom;
        ``frequencies_hz``, ascending, 0 for rigid-body modes; ``rigid_body_modes``, their number;
        ``visible``, whether the test could see each mode, or null if the case does not say;
        ``size_m``, extents of the mesh; ``rings``, for each bolt's ring its name, centre_m,
        thickness_m, r_nei_m, r_wai_m, and parts, those below and above; ``notes``, sentences on the
        test's data; ``test``, the modes beside those of the test, see `Compared.to_json`, or null.
        """
        visible = self.visible
        return {
            "version": fenics_joints.__version__,
            "title": self.case.title,
            "dofs": self.modes.model.n_dofs,
            "frequencies_hz": self.frequencies_hz.tolist(),
            "rigid_body_modes": self.modes.n_rigid,
            "visible": None if visible is None else visible.tolist(),
            "size_m": self.size_m.tolist(),
            "rings": [
                {
                    "name": ring.name,
                    "centre_m": ring.centre.tolist(),
                    "thickness_m": ring.thickness,
                    "r_nei_m": ring.r_nei,
                    "r_wai_m": ring.r_wai,
                    "parts": [*ring.lower, *ring.upper],
                }
                for ring in self.rings
            ],
            "notes": list(self.notes),
            "test": None if self.beside is None else self.beside.to_json(),
        }

    def kinds(self) -> list[str]:
        """What each mode is, in words."""
        n_rigid, visible = self.modes.n_rigid, self.visible
        if visible is None:
            elastic = ["elastic"] * (len(self.modes) - n_rigid)
        else:
            elastic = [f"{'' if s else 'not '}seen by the test" for s in visible[n_rigid:]]
        return ["rigid body"] * n_rigid + elastic


def ring_row(ring: Ring) -> tuple[str, ...]:
    """A bolt's ring in a table: name, centre, thickness and radii in mm, and the parts joined."""
    centre = ", ".join(f"{round(1e3 * float(c), 1) + 0.0:.1f}" for c in ring.centre)
    radii = f"{1e3 * ring.r_nei:.3g} to {1e3 * ring.r_wai:.3g}"
    thickness = number(1e3 * ring.thickness)
    return ring.name, centre, thickness, radii, ", ".join((*ring.lower, *ring.upper))

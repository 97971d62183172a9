"""The modes of a case's nominal model, as a table, JSON or a page: the ``modes`` command."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

import fenics_joints
from fenics_joints.beams import BeamStructure
from fenics_joints.case.build import build_preload, build_structure
from fenics_joints.case.case import Case
from fenics_joints.errors import InputError, MeshError
from fenics_joints.formatting import mode_kinds
from fenics_joints.measurements.gap import VISIBLE
from fenics_joints.meshes import Ring, TaggedMesh, measure_ring
from fenics_joints.meshes.rings import ring_names
from fenics_joints.meshes.tagged import limits
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console

    from fenics_joints.preload.linear_joint import LinearJoint

__all__ = ["ModeList", "run_modes"]


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
    """

    case: Case
    modes: Modes
    visibility: np.ndarray | None
    size_m: np.ndarray = field(default_factory=lambda: np.empty(0))
    rings: tuple[Ring, ...] = ()

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Natural frequencies, Hz, shape (n,); 0 for rigid-body modes, whose value is round-off."""
        frequencies = self.modes.frequencies_hz.copy()
        frequencies[: self.modes.n_rigid] = 0.0
        return frequencies

    @property
    def visible(self) -> np.ndarray | None:
        """Which modes the test could see, shape (n,); no rigid-body mode is one."""
        if self.visibility is None:
            return None
        return (self.visibility >= VISIBLE) & (np.arange(len(self.modes)) >= self.modes.n_rigid)

    def json(self) -> dict[str, object]:
        """What ``--json`` writes.

        Keys: ``version``, ``title``; ``dofs``, the number of degrees of freedom;
        ``frequencies_hz``, ascending, 0 for rigid-body modes; ``rigid_body_modes``, their number;
        ``visible``, whether the test could see each mode, or null if the case does not say;
        ``size_m``, extents of the mesh; ``rings``, for each bolt's ring its name, centre_m,
        thickness_m, r_nei_m, r_wai_m, and parts, those below and above.
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
                    "name": ring.name, "centre_m": ring.centre.tolist(),
                    "thickness_m": ring.thickness, "r_nei_m": ring.r_nei, "r_wai_m": ring.r_wai,
                    "parts": [*ring.lower, *ring.upper],
                }
                for ring in self.rings
            ],
        }  # fmt: skip

    def html(self) -> str:
        """What ``--report`` writes. Collective."""
        from fenics_joints.report.html import modes_page

        return modes_page(self)

    def kinds(self) -> list[str]:
        """What each mode is, in words."""
        return mode_kinds(len(self.modes), self.modes.n_rigid, self.visible)

    def show(self, console: Console) -> None:
        """Print the summary."""
        from fenics_joints.report import terminal as summary

        title = f"{self.case.title or self.case.path.parent.name}: nominal model"
        summary.modes(
            console, title, self.frequencies_hz, self.kinds(), self.modes.model.n_dofs,
            self.size_m, self.rings,
        )  # fmt: skip


def run_modes(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    n_modes: int | None = None,
    state: str = "stuck",
    method: str = "direct",
) -> ModeList:
    """Modes of a case's nominal model. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        n_modes: Number of modes, rigid-body modes included; the case's ``diagnose.n_modes`` by
            default.
        state: What contacts are: ``"stuck"``, or as the ``"preload"`` leaves them.
        method: ``"direct"`` or ``"iterative"``, see `solve_modes`; contacts need the direct one.

    Raises:
        JointsError: If the case, the mesh or the solution fails.
    """
    n_modes = case.diagnose.n_modes if n_modes is None else n_modes
    progress.step("building the model")
    if state != "stuck" and not case.contacts:
        raise InputError(f"contacts = {state!r}: expected sections [contacts.NAME] in the case")
    if case.contacts:
        model = _preloaded(case, comm, progress, state)
    else:
        model = build_structure(case, comm)
    progress.step(f"solving {n_modes} modes of {model.n_dofs} degrees of freedom")
    modes = solve_modes(model, n_modes=n_modes, method=method)
    sensors = case.sensors()
    visibility = None if sensors is None else modes.visibility(sensors)
    if isinstance(model, BeamStructure):
        return ModeList(case, modes, visibility, model.size_m)
    tagged = getattr(model, "structure", model).tagged
    low, high = limits(tagged)
    return ModeList(case, modes, visibility, high - low, _rings(tagged))


def _rings(tagged: TaggedMesh) -> tuple[Ring, ...]:
    found = []
    if tagged.mesh.geometry.dim == 3:
        for name in ring_names(list(tagged.cell_names)):
            try:
                found.append(measure_ring(tagged, name))
            except MeshError:
                continue  # no flat layer: its joint's law may be for any shape
    return tuple(found)


def _preloaded(case: Case, comm: MPI.Intracomm, progress: Progress, state: str) -> LinearJoint:
    """The bodies of a case with linear contacts and its bolts."""
    from fenics_joints.preload import solve_preload
    from fenics_joints.preload.linear_joint import LinearJoint, status_conditions

    if state not in ("stuck", "preload"):
        raise InputError(f"contacts = {state!r}: expected 'stuck' or 'preload'.")
    model = build_preload(case, comm)
    if state == "stuck":
        return LinearJoint(model)
    progress.step("contact under preload")
    return LinearJoint(model, status_conditions(solve_preload(model)))

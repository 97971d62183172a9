"""The contacts of a case under its bolts' preload, and what that does to the frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

import fenics_joints
from fenics_joints.case.build import build_preload
from fenics_joints.case.case import Case
from fenics_joints.modal.modes import solve_modes
from fenics_joints.preload import OPEN, SLIP, STICK, ContactState, PreloadResult, PreloadSolver
from fenics_joints.preload.linear_joint import LinearJoint, status_conditions
from fenics_joints.preload.patch import largest_radius
from fenics_joints.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["PreloadReport", "bolt_axes", "contact_facts", "run_preload"]

#: Pressure, Pa, that bounds the contact radius (seed 000, eq. 10).
LIMIT = 1e6
_ELASTIC = 6


@dataclass(frozen=True, eq=False)
class PreloadReport:
    """What the ``preload`` command found.

    Attributes:
        case: The case.
        result: The preload state.
        contacts: A dict of facts for each contact, see `contact_facts`.
        stuck_hz: Elastic frequencies with all contacts fully stuck, Hz, (n,).
        preloaded_hz: Elastic frequencies with each pair as the preload leaves it, Hz, (n,).
        written: Files of fields.
    """

    case: Case
    result: PreloadResult
    contacts: list[dict]
    stuck_hz: np.ndarray
    preloaded_hz: np.ndarray
    written: tuple[Path, ...] = ()

    def json(self) -> dict[str, object]:
        """What ``--json`` writes.

        Keys: ``version``, ``title``, ``dofs``, ``bolt_forces_n``, ``iterations``,
        ``complementarity``, ``contacts`` (each with the keys of `contact_facts`), and
        ``frequencies_hz`` with ``stuck`` and ``preloaded``.
        """
        return {
            "version": fenics_joints.__version__,
            "title": self.case.title,
            "dofs": self.result.model.jumps.n,
            "bolt_forces_n": dict(self.result.forces),
            "iterations": self.result.iterations,
            "complementarity": self.result.complementarity,
            "contacts": self.contacts,
            "frequencies_hz": {
                "stuck": self.stuck_hz.tolist(),
                "preloaded": self.preloaded_hz.tolist(),
            },
        }

    def html(self) -> str:
        """What ``--report`` writes."""
        from fenics_joints.commands.preload.page import preload_html

        return preload_html(self)

    def show(self, console: Console) -> None:
        """Print the summary."""
        from fenics_joints.commands.preload.summary import preload

        preload(console, self)


def bolt_axes(result: PreloadResult) -> dict[str, np.ndarray]:
    """A point on the axis of every bolt, m, (gdim,): the middle of its two faces. Collective."""
    model = result.model
    return {
        bolt.name: 0.5 * (_middle(model.face(bolt.lower)) + _middle(model.face(bolt.upper)))
        for bolt in model.bolts
    }


def _middle(face) -> np.ndarray:
    return 0.5 * (face.points.min(axis=0) + face.points.max(axis=0))


def contact_facts(state: ContactState, axes: dict[str, np.ndarray]) -> dict:
    """What is said of a contact.

    Args:
        state: The contact in its state.
        axes: A point on each bolt's axis, by bolt.

    Returns:
        Keys ``name``; ``force_n``; ``peak_pressure_pa``, the largest of the facets' means, and
        ``peak_nodal_pressure_pa``; ``mean_pressure_pa``, over the closed area; ``area_m2``, closed,
        ``area_above_1_mpa_m2`` and ``whole_area_m2``; ``radius_m`` by bolt, the farthest place
        nearest to that bolt with 1 MPa or more; ``open``, ``slip``, ``stick``: numbers of pairs.
    """
    force, area = state.normal_force, state.area
    return {
        "name": state.name,
        "force_n": force,
        "peak_pressure_pa": float(state.facet_pressure.max(initial=0.0)),
        "peak_nodal_pressure_pa": float(state.pressure.max(initial=0.0)),
        "mean_pressure_pa": force / area if area else 0.0,
        "area_m2": area,
        "area_above_1_mpa_m2": state.area_above(LIMIT),
        "whole_area_m2": float(state.facet_area.sum()),
        "radius_m": _radii(state, axes),
        **{
            word: int(np.sum(state.status == kind))
            for word, kind in (("open", OPEN), ("slip", SLIP), ("stick", STICK))
        },
    }


def _radii(state: ContactState, axes: dict[str, np.ndarray]) -> dict[str, float]:
    """Contact radius at each bolt, of the pairs that are nearest to it."""
    if not axes:
        return {}
    points = state.interface.points
    distance = [np.linalg.norm(points - axis, axis=1) for axis in axes.values()]
    nearest = np.argmin(distance, axis=0)
    found = {}
    for i, (name, axis) in enumerate(axes.items()):
        own = np.where(nearest == i, state.pressure, 0.0)
        found[name] = largest_radius(state.interface, own, LIMIT, axis)
    return found


def run_preload(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, fields: Path | None = None
) -> PreloadReport:
    """Contacts at the case's bolt forces, and the frequencies about that state. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        fields: A file to write the fields to, ``.bp`` or ``.xdmf``.

    Raises:
        JointsError: If the case, the mesh or a solution fails.
    """
    progress.step("building the model")
    model = build_preload(case, comm)
    progress.step(f"contact of {model.jumps.n} degrees of freedom")
    result = PreloadSolver(model).solve(monitor=lambda i, norm: progress.advance())
    axes = bolt_axes(result)
    contacts = [contact_facts(state, axes) for state in result.contacts.values()]
    progress.step("modes with the contacts stuck, and as the preload leaves them")
    joint = LinearJoint(model)
    stuck = solve_modes(joint, n_modes=6 + _ELASTIC + 1)
    loose = solve_modes(
        joint.change(status_conditions(result)), n_modes=6 + _ELASTIC + 1, solver=stuck.solver
    )
    written = ()
    if fields is not None:
        from fenics_joints.preload.fields import write

        progress.step(f"writing {fields}")
        written = tuple(write(result, fields))
    return PreloadReport(
        case, result, contacts, _elastic(stuck), _elastic(loose), written
    )


def _elastic(modes) -> np.ndarray:
    return modes.frequencies_hz[modes.n_rigid : modes.n_rigid + _ELASTIC]

"""The page of the ``preload`` command, and its parts on contacts."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from fenics_joints.commands.preload.applied import applied_rows
from fenics_joints.commands.preload.contacts import bolt_centres, contact_rows, forces_in_words
from fenics_joints.commands.preload.result import PreloadReport
from fenics_joints.commands.preload.view import preload_view
from fenics_joints.formatting import quantity
from fenics_joints.preload import PreloadResult
from fenics_joints.report.contact_pictures import pressure_map, pressure_profile
from fenics_joints.report.html import render, svg
from fenics_joints.report.style import to_svg


def preload_html(p: PreloadReport) -> str:
    """The page of the ``preload`` command. Collective; empty on all ranks but the first."""
    centres = bolt_centres(p.result)
    view = preload_view(p.result)
    if p.result.model.comm.rank != 0:
        return ""
    return render(
        "preload.html",
        p=p,
        title=p.case.title,
        contacts=contact_rows(p.contacts),
        pictures=contact_pictures(p.result, centres),
        forces=forces_in_words(p.result),
        view=view,
        applied=applied_rows(p.applied),
    )


def picture(figure, name: str, alt: str) -> Markup:
    """A figure of `contact_pictures` as ``<svg>``."""
    return svg(to_svg(figure, name, alt))


def contact_pictures(result: PreloadResult, centres) -> list[tuple[str, object]]:
    """The pressure in plan, and along the first direction of the face, of each contact."""
    found = []
    if result.model.structure.gdim < 3:
        return found
    for i, state in enumerate(result.contacts.values()):
        along = np.ptp(state.interface.points, axis=0).argmax()
        direction = np.eye(3)[along]
        words = f"Pressure of the contact {state.name}"
        peak = quantity(float(state.facet_pressure.max(initial=0)), "Pa")
        plan = pressure_map(state, centres=centres)
        line = pressure_profile(state, centres=centres, direction=direction)
        found.append(
            (
                f"{state.name}: pressure in plan",
                picture(plan, f"plan{i}", f"{words} in plan; peak {peak}."),
            )
        )
        found.append(
            (
                f"{state.name}: pressure of all pairs along {'xyz'[along]}",
                picture(line, f"line{i}", f"{words} along {'xyz'[along]}."),
            )
        )
    return found

"""The page of the ``check`` command."""

from __future__ import annotations

from fenics_joints.commands.check.result import Checked
from fenics_joints.commands.check.summary import cost_rows, weight_rows
from fenics_joints.formatting import extents, number
from fenics_joints.report.case_pictures import structure_picture
from fenics_joints.report.html import render, svg


def check_page(result: Checked) -> str:
    """A checked case as a page: what is wrong, a picture, masses, places, costs."""
    return render(
        "check.html",
        title=result.title,
        result=result,
        weights=weight_rows(result),
        costs=cost_rows(result),
        pictures=_pictures(result),
        test=result.test_words(),
        size=extents(result.size_m) if len(result.size_m) else "",
        places=[_row(p) for p in (*result.bolts, *result.places)],
    )


def _row(place) -> tuple[str, str, str, str, str]:
    """Kind, name, place in mm, direction, distance from the mesh in mm."""
    at = ", ".join(number(1e3 * x, 5) for x in place.point)
    way = "" if place.direction is None else ", ".join(f"{x:.3g}" for x in place.direction)
    return place.kind, place.name, at, way, number(1e3 * place.off) if place.off >= 0 else ""


def _pictures(result: Checked) -> list:
    """The structure from above and from below, with all that is on it."""
    body = result.body
    if body is None:
        return []
    places = {
        kind: [p for p in result.places if p.kind == kind]
        for kind in (
            "sensor",
            "force",
            "mass",
            "spring",
            "attached",
            "obstacle",
            "displacement",
            "load",
        )
    }
    places["bolt"] = list(result.bolts)
    return [
        svg(structure_picture(body.vertices, body.group, body.names, places, below=below))
        for below in (False, True)
    ]

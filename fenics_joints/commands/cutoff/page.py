"""The page of an update of the cut-off pressure."""

from __future__ import annotations

import numpy as np

from fenics_joints.commands.cutoff.result import CutoffReport, SchemeReport
from fenics_joints.commands.preload.contacts import (
    area_words,
    bolt_centres,
    contact_rows,
    forces_in_words,
)
from fenics_joints.commands.preload.page import contact_pictures, picture
from fenics_joints.formatting import quantity
from fenics_joints.report.contact_pictures import status_map
from fenics_joints.report.html import render, svg
from fenics_joints.report.style import CHOSEN, PLACEBO, drawing, to_svg

_WORDS = {"two": "stuck or open", "three": "stuck, sliding or open"}
_COLOURS = {"two": CHOSEN, "three": PLACEBO}


def cutoff_html(u: CutoffReport) -> str:
    """The page of an update of the cut-off. Collective; empty on all ranks but the first."""
    centres = bolt_centres(u.result)
    if u.result.model.comm.rank != 0:
        return ""
    schemes = []
    for s in u.schemes:
        maps = [
            (state.name, picture(status_map(state, centres=centres), f"{s.scheme}{i}", _alt(s)))
            for i, state in enumerate(s.states)
        ]
        schemes.append(
            {
                "r": s,
                "words": _WORDS[s.scheme],
                "frequencies": svg(frequencies_over_cutoff(u, s)),
                "maps": maps,
                "area": area_words(s.area),
            }
        )
    return render(
        "cutoff.html",
        u=u,
        title=u.case.title,
        schemes=schemes,
        forces=forces_in_words(u.result),
        objective=svg(objective_over_cutoff(u)),
        contacts=contact_rows(u.contacts),
        whole=area_words(u.whole_area),
        pictures=contact_pictures(u.result, centres),
        stuck=float(np.sum(np.abs(u.stuck_hz / u.test_hz - 1))),
    )


def _alt(s: SchemeReport) -> str:
    return f"Condition of the contact at the best cut-off, {quantity(s.cutoff, 'Pa')}."


def frequencies_over_cutoff(u: CutoffReport, s: SchemeReport) -> str:
    """Frequencies over the cut-off pressure and measured ones (Fronk et al. 2019, figs. 10, 11)."""
    x = s.sweep.cutoffs / 1e6
    with drawing(7.6, 4.6) as figure:
        axes = figure.subplots()
        for j, name in enumerate(u.mode_names):
            line = axes.plot(x, s.sweep.frequencies_hz[:, j], lw=1.5, color=_shade(j))[0]
            axes.axhline(u.test_hz[j], color=_shade(j), lw=1.1, ls=(0, (5, 3)))
            axes.annotate(
                name,
                (x[0], s.sweep.frequencies_hz[0, j]),
                xytext=(4, 4),
                textcoords="offset points",
                fontsize=8.5,
            )
            if s.crossings[j] is not None:
                axes.plot(s.crossings[j] / 1e6, u.test_hz[j], "o", ms=4.5, color=line.get_color())
        axes.axvline(s.cutoff / 1e6, color=_COLOURS[s.scheme], lw=1.0)
        axes.set(xlabel="cut-off pressure, MPa", ylabel="frequency, Hz")
        axes.margins(x=0)
        alt = (
            f"Frequencies over the cut-off pressure, {_WORDS[s.scheme]}; dashed: measured; best at "
            f"{quantity(s.cutoff, 'Pa')}."
        )
        return to_svg(figure, f"hz-{s.scheme}", alt)


def _shade(j: int) -> str:
    return ("#2b7bba", "#8d949e", "#6b7f94", "#4d9a6a", "#7a5aa6", "#c2571a")[j % 6]


def objective_over_cutoff(u: CutoffReport) -> str:
    """Sum of the relative errors over the cut-off pressure (Fronk et al. 2019, fig. 12)."""
    with drawing(7.6, 3.2) as figure:
        axes = figure.subplots()
        for s in u.schemes:
            x, colour = s.sweep.cutoffs / 1e6, _COLOURS[s.scheme]
            axes.plot(x, 100 * s.objective_all, color=colour, lw=1.6, label=_WORDS[s.scheme])
            axes.plot(s.cutoff / 1e6, 100 * s.objective, "o", color=colour, ms=5)
            steps = np.array(s.minimum.visited)
            axes.plot(x[steps], 100 * s.objective_all[steps], "|", color=colour, ms=9)
        axes.set(xlabel="cut-off pressure, MPa", ylabel="sum of relative errors, %")
        # Where almost nothing is stuck any more the error has no bounds of interest.
        axes.set_ylim(0, 250 * max(s.objective_all[0] for s in u.schemes))
        axes.margins(x=0)
        axes.legend(loc="best")
        words = "; ".join(
            f"{_WORDS[s.scheme]}: least at {quantity(s.cutoff, 'Pa')}" for s in u.schemes
        )
        return to_svg(figure, "objective", f"Sum of relative errors over the cut-off. {words}.")

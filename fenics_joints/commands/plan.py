"""The ``diagnose --plan`` command: which causes a test could distinguish, before any data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import Rectangle
from mpi4py import MPI

from fenics_joints.case import Case
from fenics_joints.case.check_structure import refuse_applied
from fenics_joints.commands.diagnose.words import effect_name, silent_blocks, with_place
from fenics_joints.commands.outcome import Outcome
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.plan.planned import Plan, plan
from fenics_joints.diagnosis.verdict import NO_GAP, UNKNOWN
from fenics_joints.formatting import (
    MISSING,
    condition_value,
    hertz,
    number,
    percent,
    probability,
    quantity,
)
from fenics_joints.progress import Progress
from fenics_joints.report import document as doc
from fenics_joints.report.panels import draw_matrix
from fenics_joints.report.style import CHOSEN, PLACEBO, drawing, to_svg
from fenics_joints.report.tables import facts_table

#: Rows of each table on the terminal.
_EFFECTS, _ADDITIONS = 12, 4
#: Effects up to which the picture has numbers in its cells.
_NUMBERED = 26
#: Width of a letter of an effect's name, in.
_LETTER = 0.078
_ASSUMPTIONS = (
    "One cause is present, at its expected size. A larger one is easier to detect and to "
    "distinguish, a smaller one harder.",
    "Errors are normal in the logarithm of frequency.",
    "Predictions at these sizes are exact. The nearest prediction of another effect is found by "
    "Gauss-Newton steps within five standard deviations of its prior.",
)


def run_plan(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    keep: Path | None = None,
    effects: Sequence[str] | None = None,
) -> Outcome[Plan]:
    """Which causes a test could distinguish, before any data. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        keep: Folder of the reduced model, which the next run goes on from.
        effects: In place of ``[diagnose] effects``.

    Raises:
        JointsError: If the case, the mesh or a solution fails.
    """
    refuse_applied(case, "diagnose --plan")
    found = plan(case.looking_for(effects), comm, progress, keep=keep)
    return Outcome(found, plan_document(found))


def plan_document(p: Plan) -> doc.Document:
    """The document of a plan."""
    seen = sum(e.seen for e in p.effects)
    values = ", ".join(condition_value(x, p.condition[1]) for x in p.conditions)
    how = f"modes at {p.condition[0]} {values}"
    keys = [
        ("apart", p.n_apart, "causes or groups of causes that it could distinguish"),
        ("seen", f"{seen} of {len(p.effects)}", "causes detectable at their expected size"),
        ("noise", percent(p.noise), "noise of a frequency"),
        ("discrepancy", percent(p.discrepancy), "model error (discrepancy)"),
    ]
    modes = doc.Table("mode | >frequency, Hz", caption="Of the baseline model", id="modes")
    for name, hz in zip(p.mode_names, p.frequencies_hz, strict=True):
        modes.add(name, hertz(hz))
    explained = (
        "Each effect is added to the model at its expected size, and every other one is fitted to "
        "the data that the test would then give, with all tolerances free. D is half of the "
        f"remaining difference, in standard deviations of noise and model error. Below {APART} the "
        "two would be confused in more than 1 % of tests."
    )
    picture = (
        "A row is the effect that is present, a column the effect that it may be mistaken for; "
        "orange: confusable, blue: distinct. Frames enclose the effects that this test could not "
        "distinguish."
    )
    caption = (
        "D between the row's effect and the nearest prediction of the column's; columns have the "
        "numbers of the rows"
    )
    return doc.Document(
        p.title,
        "what the planned test could show",
        "Before any data: what the planned test could show",
        [
            doc.Verdict("what the planned test could show", [("", s) for s in p.sentences()]),
            doc.OnPage([doc.Keys(keys)]),
            doc.Heading("Which causes it could distinguish", "which"),
            doc.OnPage([doc.Text(explained), doc.Text(picture)]),
            doc.Figure(lambda: matrix_picture(p), caption, wide=True),
            *_groups(p),
            _effects(p),
            *_additions(p, seen),
            *silent_blocks(p.silent),
            doc.OnTerminal(
                [
                    doc.Text(f"D above {APART} is less than 1 % confusion.", "note"),
                    doc.Text(
                        f"noise {percent(p.noise)}, discrepancy {percent(p.discrepancy)}", "note"
                    ),
                ]
            ),
            doc.Heading("The planned test", "test"),
            doc.Text(f"It measures {', '.join(p.measured)} of {len(p.mode_names)} {how}.", "note"),
            doc.OnPage(
                [
                    modes,
                    facts_table(p.model),
                    doc.Heading("Assumptions", level=3),
                    doc.Items(_ASSUMPTIONS),
                ]
            ),
        ],
        p.to_json,
    )


def _groups(p: Plan) -> list:
    """Classes of effects that the test could not distinguish."""
    if not p.classes:
        return []
    table = doc.Table(
        "group | causes | >collinearity | changes that cancel | >remainder",
        caption="The changes that cancel best, and the remainder; with a collinearity index above "
        "20 no size of the effects would help",
        id="classes",
    )
    for c in p.classes:
        names = "; ".join(map(with_place, c.members))
        index = doc.Cell(number(c.collinearity, 2), kind="flag" if c.collinearity > 20 else "")
        table.add(c.letter, names, index, c.combination, f"{c.left:.1f} s.d.")
    return [doc.OnPage([doc.Heading("Groups that it could not distinguish", level=3), table])]


def _effects(p: Plan) -> doc.Table:
    """Every effect at its expected size: its D from the baseline, and its most likely mistake."""
    table = doc.Table(
        "> | effect | group | >D: baseline | >named | >mistaken for | >share | "
        "expected size | >D over its sizes",
        caption="Every effect at its expected size: the middle of three sizes, the median of its "
        "prior and one standard deviation either way. Named, or mistaken for another (by its "
        "number): mean probabilities in simulated tests with this cause alone, its size drawn from "
        "the prior",
        id="effects",
        most=_EFFECTS,
        page_columns=2,
    )
    places = {e.key: f"{i + 1}" for i, e in enumerate(p.effects)}
    for i, e in enumerate(p.effects):
        shares = [MISSING] * 3
        if (found := likeliest(p, i)) is not None:
            named, other, share = found
            shares = [
                probability(named),
                places.get(other) or effect_name(other),
                probability(share),
            ]
        size = ", ".join(f"{n} = {quantity(value, e.units[n])}" for n, value in e.size.items())
        table.add(
            places[e.key],
            doc.Cell(with_place(e.key), note=e.describe),
            e.letter or ("" if e.seen else "not detectable"),
            doc.Cell(f"{e.distance:.1f}", kind="" if e.seen else "flag"),
            *shares,
            size,
            f"{e.distance_least:.1f} to {e.distance_most:.1f}",
            style="" if e.seen else "dim",
        )
    return table


def _additions(p: Plan, seen: int) -> list:
    """Gain of further measurements."""
    heading = doc.Heading("What to measure next", "next")
    if not p.additions:
        words = "No further measurement is needed: the test detects and distinguishes all causes."
        return [heading, doc.OnPage([doc.Text(words)])]
    words = (
        "Each row is one further measurement of the same quality. The pairs that the test cannot "
        "distinguish are compared again with it, every rival fitted to all data."
    )
    table = doc.Table(
        "further measurement | >distinct | >detected | >mean gain of D | >largest | between",
        caption="The most useful first",
        id="additions",
        most=_ADDITIONS,
        page_columns=2,
    )
    nothing = (MISSING, MISSING, "")
    table.add("the test as planned", str(p.n_apart), str(seen), *nothing, style="dim")
    for i, a in enumerate(p.additions):
        pair = " and ".join(map(with_place, a.pair)) if a.largest_gain >= 0.01 else MISSING
        gains = (f"{a.mean_gain:.2f}", f"{a.largest_gain:.2f}")
        style = "" if i else "lead"
        table.add(a.measurement, str(a.apart), str(a.seen), *gains, pair, style=style)
    return [heading, doc.OnPage([doc.Text(words)]), table]


def likeliest(p: Plan, i: int) -> tuple[float, str, float] | None:
    """How often an effect is named where it is the cause, the effect that it is most often mistaken
    for, and how often; None if no test of it was simulated."""
    row = p.taken_for[i]
    if np.isnan(row).any():
        return None
    names = [*(e.key for e in p.effects), NO_GAP, UNKNOWN]
    j = max((j for j in range(len(row)) if j != i), key=row.__getitem__)
    return float(row[i]), names[j], float(row[j])


def matrix_picture(p: Plan) -> str:
    """The matrix of distances D, members of a class together, as ``<svg>``."""
    n = len(p.effects)
    names = [with_place(e.key) for e in p.effects]
    D = p.distances.copy()
    D[np.arange(n), np.arange(n)] = np.nan
    colours = LinearSegmentedColormap.from_list(
        "apart", [(0.0, PLACEBO), (0.5, "#e9e4da"), (1.0, CHOSEN)]
    )
    cell = 0.42 if n <= _NUMBERED else 0.24
    beside = _LETTER * max((len(name) for name in names), default=0) + 0.6
    wide = cell * (n + 1) + beside
    with drawing(wide, cell * n + 1.0) as figure:
        # The reader's font may be wider than the one that the layout knows.
        room = 0.1 * beside / wide
        figure.get_layout_engine().set(rect=(room, 0, 1 - room, 1))
        axes = figure.add_subplot()
        draw_matrix(axes, D, colours, (0, 2 * APART), _short if n <= _NUMBERED else None)
        numbers = [str(i + 1) for i in range(n)]
        axes.set_yticks(range(n), [f"{name}  {i}" for name, i in zip(names, numbers, strict=True)])
        axes.set_xticks(range(n + 1), [*numbers, "baseline"])
        axes.tick_params(length=0, top=True, bottom=False, labeltop=True, labelbottom=False)
        axes.get_xticklabels()[-1].set_rotation(90)
        axes.set_xlabel("mistaken for", labelpad=6)
        axes.xaxis.set_label_position("top")
        letters = [e.letter for e in p.effects]
        for c in p.classes:
            first, count = letters.index(c.letter), len(c.members)
            corner = (first - 0.5, first - 0.5)
            axes.add_patch(Rectangle(corner, count, count, fill=False, edgecolor="#1b2027", lw=1.6))
        return to_svg(figure, "matrix", _matrix_words(p))


def _short(distance: float) -> str:
    return f"{distance:.1f}" if distance < 9.95 else f"{distance:.0f}"


def _matrix_words(p: Plan) -> str:
    groups = "; ".join(", ".join(c.members) for c in p.classes) or "none"
    return (
        "Matrix of the distance of each effect from the nearest prediction of each other one. "
        f"Effects that cannot be distinguished: {groups}."
    )

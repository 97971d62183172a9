"""The page of ``diagnose --plan``, and the picture of its distances."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import Rectangle

from fenics_joints.commands.diagnose.reading import by_reason
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.plan.planned import Plan, PlannedEffect
from fenics_joints.diagnosis.verdict import NO_GAP, UNKNOWN
from fenics_joints.formatting import quantity, spaced
from fenics_joints.report.html import facts, ink_on, render, svg
from fenics_joints.report.style import CHOSEN, PLACEBO, drawing, to_svg

#: Effects up to which the picture has numbers in its cells.
_NUMBERED = 26
#: Width of a letter of an effect's name, in.
_LETTER = 0.078


def plan_html(p: Plan) -> str:
    """The plan as a page of HTML without any reference to other files."""
    how_many, which_not, next_ = p.sentences()
    return render(
        "plan.html",
        {"by_reason": by_reason},
        p=p,
        sentences=(how_many, which_not, next_),
        matrix=svg(matrix_picture(p)),
        sizes={e.key: size_words(e) for e in p.effects},
        chances={e.key: likeliest(p, i) for i, e in enumerate(p.effects)},
        apart=APART,
        facts=facts(p.model),
    )


def size_words(e: PlannedEffect) -> str:
    """An effect's expected size, such as ``k_t = 1.00 TPa/m``."""
    return ", ".join(f"{name} = {quantity(value, e.units[name])}" for name, value in e.size.items())


def likeliest(p: Plan, i: int) -> tuple[float, str, float] | None:
    """How often an effect is named where it is the cause, what else it is taken for most often,
    and how often; None if no test of it was simulated."""
    row = p.taken_for[i]
    if np.isnan(row).any():
        return None
    names = [*(e.key for e in p.effects), NO_GAP, UNKNOWN]
    j = max((j for j in range(len(row)) if j != i), key=row.__getitem__)
    return float(row[i]), names[j], float(row[j])


def matrix_picture(p: Plan) -> str:
    """The matrix of distances D, members of a class together, as ``<svg>``."""
    n = len(p.effects)
    names = [spaced(e.key) for e in p.effects]
    D = np.ma.masked_invalid(p.distances.copy())
    D[np.arange(n), np.arange(n)] = np.ma.masked
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
        axes.imshow(D, cmap=colours, vmin=0, vmax=2 * APART, aspect="equal")
        numbers = [str(i + 1) for i in range(n)]
        axes.set_yticks(range(n), [f"{name}  {i}" for name, i in zip(names, numbers, strict=True)])
        axes.set_xticks(range(n + 1), [*numbers, "no gap"])
        axes.tick_params(length=0, top=True, bottom=False, labeltop=True, labelbottom=False)
        axes.get_xticklabels()[-1].set_rotation(90)
        axes.set_xlabel("taken for", labelpad=6)
        axes.xaxis.set_label_position("top")
        axes.spines[:].set_visible(False)
        if n <= _NUMBERED:
            _write_numbers(axes, D, colours)
        _frame_classes(axes, p)
        return to_svg(figure, "matrix", _matrix_words(p))


def _write_numbers(axes, D, colours) -> None:
    for i, j in zip(*np.nonzero(~np.ma.getmaskarray(D)), strict=True):
        value = float(D[i, j])
        ink = ink_on(colours(min(value / (2 * APART), 1.0))[:3])
        text = f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
        axes.text(j, i, text, ha="center", va="center", fontsize=8.5, color=ink)


def _frame_classes(axes, p: Plan) -> None:
    letters = [e.letter for e in p.effects]
    for c in p.classes:
        first, count = letters.index(c.letter), letters.count(c.letter)
        corner = (first - 0.5, first - 0.5)
        axes.add_patch(Rectangle(corner, count, count, fill=False, edgecolor="#1b2027", lw=1.6))


def _matrix_words(p: Plan) -> str:
    groups = "; ".join(", ".join(c.members) for c in p.classes) or "none"
    return (
        "Matrix of the distance of each effect, if it is at work, from what each other can make. "
        f"Effects that cannot be told apart: {groups}."
    )

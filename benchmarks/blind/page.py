"""The scores as a page of HTML that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from markupsafe import Markup
from scipy.stats import norm

import fenics_joints
from benchmarks.blind.rates import clopper_pearson
from benchmarks.blind.score import APART
from benchmarks.blind.targets import targets
from fenics_joints.report import style as pictures
from fenics_joints.report.html import page_environment
from fenics_joints.report.style import CHOSEN, NOISE, NOMINAL, PLACEBO


def page(scores: Mapping, sealed: Mapping) -> str:
    """The page.

    Args:
        scores: From `score.score`.
        sealed: The published list.
    """
    environment = page_environment(Path(__file__).parent)
    environment.globals.update(version=fenics_joints.__version__, apart=APART)
    environment.filters.update(rate=_rate, number=_number, span=_span)
    drawn = {
        "calibration": _calibration(scores["summary"]["calibration"]),
        "separability": _separability(scores["by_separability"]),
        "confusion": _confusion(scores["confusion"]),
        "shrinkage": _shrinkage(scores["cases"]),
    }
    figures = {name: Markup(text) if text else None for name, text in drawn.items()}
    return environment.get_template("page.html").render(
        s=scores,
        sealed=sealed,
        summary=scores["summary"],
        figures=figures,
        targets=targets(scores["summary"], sealed.get("world", "first")),
        groups=_groups(scores),
    )


def _groups(scores: Mapping) -> list[tuple[str, Mapping]]:
    """Rows of the table by geometry, noise, and what was for scoring only."""
    rows = [("all", scores["summary"])]
    rows += [(name, s) for name, s in scores["by"]["geometry"].items()]
    rows += [(f"noise {name}", s) for name, s in scores["by"]["noise"].items()]
    words = {"False": "seen in development", "True": "for scoring only"}
    return rows + [(words.get(name, name), s) for name, s in scores["by"]["final_only"].items()]


def _rate(rate: Mapping) -> str:
    """Such as ``83 % (5 of 6; 36 to 100 %)``."""
    if not rate["n"]:
        return "–"
    low, high = 100 * rate["low"], 100 * rate["high"]
    return f"{100 * rate['value']:.0f} % ({rate['k']} of {rate['n']}; {low:.0f} to {high:.0f} %)"


def _number(value: float | None, percent: bool = False) -> str:
    if value is None:
        return "–"
    return f"{100 * value:.1f} %" if percent else f"{value:.3f}"


def _span(t) -> str:
    if t.value is None:
        return "–"
    return f"{_number(t.low, t.percent)} to {_number(t.high, t.percent)}"


# -- pictures --------------------------------------------------------------------------------------


def _calibration(found: Mapping) -> str | None:
    """Share that came true against the stated probability, for causes and for classes."""
    panels = [(level, found[level]) for level in ("cause", "class") if found[level]]
    if not panels:
        return None
    with pictures.drawing(8.2, 3.9) as figure:
        for place, (level, c) in enumerate(panels, 1):
            axes = figure.add_subplot(1, len(panels), place)
            axes.plot([0, 1], [0, 1], color=NOMINAL, linewidth=1, linestyle="--")
            stated = np.array([b["stated"] for b in c["bins"]])
            share = np.array([b["found"] for b in c["bins"]])
            limits = np.array([clopper_pearson(b["right"], b["count"]) for b in c["bins"]])
            errors = np.abs(limits.T - share)
            axes.errorbar(stated, share, errors, fmt="o", color=CHOSEN, markersize=4.5, linewidth=1)
            axes.set(
                xlim=(-0.03, 1.03),
                ylim=(-0.03, 1.03),
                aspect="equal",
                xlabel="stated probability",
                ylabel="share that came true",
                title=f"by {level}: error {c['ece']:.3f} ({c['low']:.3f} to {c['high']:.3f})",
            )
        alt = "Share of the boldest statements that came true against their stated probability."
        return pictures.to_svg(figure, "calibration", alt)


def _separability(rows: list[Mapping]) -> str | None:
    """Accuracy against D: causes, classes, the oracle, and Phi(D)."""
    if not rows:
        return None
    with pictures.drawing(8.2, 3.6) as figure:
        axes = figure.add_subplot()
        x = np.array([row["median"] for row in rows])
        kinds = (
            ("cause", CHOSEN, "o", [row["single"]["top1_cause"] for row in rows]),
            ("class", PLACEBO, "s", [row["single"]["top1_class"] for row in rows]),
            ("oracle", NOISE, "^", [row["oracle"]["top1"] for row in rows]),
        )
        for i, (name, colour, mark, rates) in enumerate(kinds):
            kept = [(a, r) for a, r in zip(x, rates, strict=True) if r["n"]]
            if kept:
                at = np.array([a for a, _ in kept]) * 1.04 ** (i - 1)  # beside one another
                y = np.array([r["value"] for _, r in kept])
                errors = np.abs(np.array([(r["low"], r["high"]) for _, r in kept]).T - y)
                axes.errorbar(
                    at, y, errors, fmt=mark, color=colour, markersize=4.5, linewidth=1, label=name
                )
        fine = np.geomspace(max(x.min() / 2, 0.05), x.max() * 2, 100)
        axes.plot(
            fine,
            norm.cdf(fine),
            color=NOMINAL,
            linewidth=1,
            linestyle="--",
            label="against one rival at D",
        )
        axes.axvline(APART, color=NOMINAL, linewidth=0.8)
        axes.set(
            xscale="log",
            ylim=(-0.03, 1.03),
            xlabel="separability D, standard deviations",
            ylabel="right first answer",
        )
        axes.set_xticks([v for v in (0.1, 0.3, 1, 3, 10, 30, 100) if fine[0] <= v <= fine[-1]])
        axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
        axes.minorticks_off()
        axes.legend(loc="lower right")
        alt = "Share of single effects named first against their separability D."
        return pictures.to_svg(figure, "separability", alt)


def _confusion(c: Mapping) -> str | None:
    """Answered cause by true cause, as counts on a ground shaded by the share of the row."""
    counts = np.array(c["counts"], dtype=float)
    if counts.sum() == 0:
        return None
    rows = counts.sum(axis=1) > 0
    columns = counts.sum(axis=0) > 0
    shown = counts[np.ix_(rows, columns)]
    true = [n for n, kept in zip(c["true"], rows, strict=True) if kept]
    said = [n for n, kept in zip(c["said"], columns, strict=True) if kept]
    with pictures.drawing(8.6, 2.2 + 0.27 * len(true)) as figure:
        axes = figure.add_subplot()
        share = shown / shown.sum(axis=1, keepdims=True)
        for i, j in np.argwhere(shown > 0):
            right = true[i] == said[j]
            axes.add_patch(_square(j, i, CHOSEN if right else PLACEBO, 0.15 + 0.6 * share[i, j]))
            axes.text(j, i, f"{shown[i, j]:.0f}", ha="center", va="center")
        axes.set(xlim=(-0.5, len(said) - 0.5), ylim=(len(true) - 0.5, -0.5), ylabel="true")
        axes.set_xticks(range(len(said)), said, rotation=40, ha="right", fontsize=8)
        axes.set_yticks(range(len(true)), true, fontsize=8)
        axes.tick_params(length=0)
        return pictures.to_svg(figure, "confusion", "Counts of the answered by the true cause.")


def _square(x: float, y: float, colour: str, alpha: float):
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.46, y - 0.46), 0.92, 0.92, color=colour, alpha=alpha, linewidth=0)


def _shrinkage(cases: list[Mapping]) -> str | None:
    """S* of each case with an effect against its placebo's, and by how much it is ahead."""
    rows = [c for c in cases if c["kind"] in ("single", "pair") and c["shrinkage"]]
    if not rows:
        return None
    with pictures.drawing(8.2, 3.9) as figure:
        axes, beside = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
        least = -1.0
        axes.plot([least, 1], [least, 1], color=NOMINAL, linewidth=1, linestyle="--")
        axes.axhline(0.8, color=NOISE, linewidth=0.8)
        for kind, mark, colour in (("single", "o", CHOSEN), ("pair", "s", PLACEBO)):
            x = [max(c["shrinkage"]["placebo"], least) for c in rows if c["kind"] == kind]
            y = [max(c["shrinkage"]["s"], least) for c in rows if c["kind"] == kind]
            if x:
                axes.scatter(x, y, s=18, marker=mark, alpha=0.7, color=colour, label=kind)
        limits = (least - 0.05, 1.05)
        axes.set(
            xlim=limits, ylim=limits, xlabel="S* of the best wrong effect", ylabel="S* as chosen"
        )
        axes.legend(loc="lower right")
        excess = [c["shrinkage"]["s"] - c["shrinkage"]["placebo"] for c in rows]
        beside.hist(np.clip(excess, -1, 2), bins=np.linspace(-1, 2, 31), color=CHOSEN, alpha=0.8)
        beside.axvline(0.0, color=NOMINAL, linewidth=1, linestyle="--")
        beside.set(xlabel="S* less the placebo's", ylabel="cases")
        alt = "Shrinkage on held-out data, chosen hypothesis against placebo, case by case."
        return pictures.to_svg(figure, "shrinkage", alt)

"""The cases that a diagnosis got wrong, one line each, to be told beside the score."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from benchmarks.blind import seal
from benchmarks.blind.forecast import NONE, UNKNOWN, Forecast
from benchmarks.blind.matching import same_cause
from benchmarks.blind.score import APART
from benchmarks.blind.seal import SealError
from fenics_joints.formatting import percent

_HEAD = ("case", "true", "the test", "gap", "D", "said", "probability of the truth")
#: Hypotheses that are shown of what was said.
_SHOWN = 2


def told(folder: Path) -> str:
    """Markdown: a table for each kind of case, of those whose answer was wrong.

    Of single effects those with D >= 2.33 come first: the others no one could tell for sure.

    Args:
        folder: The folder of a check that is scored.

    Raises:
        SealError: If it is not scored yet.
    """
    if not (folder / "scores.json").exists():
        raise SealError(f"{folder}: no scores.json; score comes before misses")
    rows = {row["id"]: row for row in seal.read_json(folder / "scores.json")["cases"]}
    answers = seal.read_json(folder / seal.UNSEALED)["answers"]
    lines = []
    for title, names in misses(rows).items():
        lines += [f"## {title}", "", _line(_HEAD), _line(["---"] * len(_HEAD))]
        for name in names:
            path = folder / "diagnoses" / f"{name}.json"
            diagnosis = seal.read_json(path).get("diagnosis")
            lines.append(_line(_row(rows[name], answers[name], diagnosis)))
        lines.append("")
    return "\n".join(lines)


def misses(rows: Mapping[str, Mapping]) -> dict[str, list[str]]:
    """Ids of the wrong ones by what they are, the clearest first.

    Args:
        rows: ``cases`` of the scores, by id.
    """
    groups: dict[str, list[str]] = {
        f"One effect, D >= {APART}, its class not first": [],
        f"One effect, D < {APART} or not known, its class not first": [],
        "No effect, not called so": [],
        "An unknown cause, not called so": [],
        "Two effects, neither among the three that were likeliest": [],
    }
    apart, close, none, unknown, pair = groups.values()
    for name, row in sorted(rows.items(), key=lambda item: -(item[1]["separability"] or 0.0)):
        if row["kind"] == "single" and not (row["rank_class"] and row["rank_class"] <= 1):
            (apart if (row["separability"] or 0.0) >= APART else close).append(name)
        elif row["kind"] == "none" and row["verdict"] != NONE:
            none.append(name)
        elif row["kind"] == "unknown" and row["verdict"] != "unknown":
            unknown.append(name)
        elif row["kind"] == "pair" and not _holds_one(row):
            pair.append(name)
    return {f"{title} ({len(names)})": names for title, names in groups.items() if names}


def _holds_one(row: Mapping) -> bool:
    """Whether one of its effects is among the three that were said to be likeliest."""
    said = [label.split(" (")[0] for label in row["said"]]
    return any(same_cause(true["name"], label) for true in row["true"] for label in said)


def _row(row: Mapping, answer: Mapping, diagnosis: Mapping | None) -> list[str]:
    forecast = Forecast(diagnosis)
    distance = row["separability"]
    return [
        f"`{row['id']}`",
        " + ".join(_true(effect) for effect in row["true"]) or "none",
        _test(answer),
        percent(answer["gap"]),
        "" if distance is None else f"{distance:.1f}",
        f"{row['verdict']}: {_said(forecast)}",
        _of_truth(forecast, row),
    ]


def _true(effect: Mapping) -> str:
    region = effect.get("region") or ""
    if not isinstance(region, str):
        region = " or ".join(region)
    sizes = ", ".join(f"{k} {_short(v)}" for k, v in (effect.get("size") or {}).items())
    return effect["name"] + (f" ({region})" if region else "") + (f": {sizes}" if sizes else "")


def _short(value) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, (list, tuple)):
        return "(" + " ".join(_short(v) for v in value) + ")"
    return str(value)


def _test(answer: Mapping) -> str:
    """What the test measured, and how well."""
    (of_f, of_shapes), shaped = answer["noise"][:2], answer["spec"].get("shapes", True)
    rows, modes = len(answer["frequencies"]), len(answer["frequencies"][0])
    sensors = len(answer["shapes"]) - len(answer["missing"])
    shapes = f"{sensors} sensors" if shaped else "no shapes"
    noise = percent(of_f) + (f", {percent(of_shapes)}" if shaped else "")
    rows_of = "" if rows == 1 else f", {rows} {answer['test']}s"
    return f"{answer['geometry']}, {modes} modes, {shapes}{rows_of}, {noise}"


def _said(forecast: Forecast) -> str:
    first = sorted(forecast.hypotheses, key=lambda found: -found[1])[:_SHOWN]
    return "; ".join(f"{' + '.join(members)} {p:.2f}" for members, p in first)


def _of_truth(forecast: Forecast, row: Mapping) -> str:
    """Probability that each true effect is at work, by its name, alone or not."""
    shares = forecast.marginals("cause")
    if row["kind"] in ("none", "unknown"):
        label = {"none": NONE, "unknown": UNKNOWN}[row["kind"]]
        return f"{shares.get(label, 0.0):.2f}"
    found = [
        max((p for label, p in shares.items() if same_cause(true["name"], label)), default=0.0)
        for true in row["true"]
    ]
    return ", ".join(f"{p:.2f}" for p in found)


def _line(cells) -> str:
    return "| " + " | ".join(cells) + " |"

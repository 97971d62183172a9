"""What each mechanism of the diagnosis is worth: opened cases, with one left out at a time.

Each is switched off from outside, by other values of what it is told or another function in its
place, so that the diagnosis itself has no switches.
"""

from __future__ import annotations

import math
import random
import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from itertools import zip_longest
from pathlib import Path
from unittest.mock import patch

from mpi4py import MPI

from benchmarks.blind import seal
from benchmarks.blind.forecast import Forecast
from benchmarks.blind.matching import opened
from benchmarks.blind.score import Record
from fenics_joints.case import load_case
from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.effects.library import LIBRARY
from fenics_joints.diagnosis.effects.sited import sited_effects
from fenics_joints.errors import JointsError
from fenics_joints.files import json_text, write_text

_DIAGNOSIS = "fenics_joints.diagnosis"
_LIBRARY = f"{_DIAGNOSIS}.evidence.library"
_PREDICTOR = f"{_DIAGNOSIS}.evidence.predictor"
_SEARCH = f"{_DIAGNOSIS}.search.Search"


def _as_found(search, found, *more, **options):
    search.model_error = 0.0
    return found


#: What is put in the place of what, by what is left out.
MECHANISMS: dict[str, dict[str, object]] = {
    "nothing": {},
    "attached and local effects": {
        f"{_DIAGNOSIS}.effects.library.LIBRARY": [f for f in LIBRARY if f is not sited_effects]
    },
    "pairs of effects": {f"{_SEARCH}._add_effects": lambda *a: []},
    "leaders weighed by sampling": {f"{_SEARCH}._sampled": _as_found},
    "leaders held to the full model": {f"{_SEARCH}._checked": _as_found},
    "a basis held to the reduced model": {f"{_LIBRARY}._LOOKED": 1},
    "a basis for each effect": {f"{_PREDICTOR}._LARGE": math.inf},
    "interpolation between torques": {
        f"{_PREDICTOR}.HypothesisPredictor._is_smooth": lambda *a: False
    },
    "unknown cause as a random field": {
        f"{_LIBRARY}.with_localised_unknown": lambda found, test: found
    },
    "misfit by simulated tests": {f"{_DIAGNOSIS}.diagnose.with_simulated": lambda fits, *a: fits},
    "simulated tests of causes outside the library": {f"{_SEARCH}._simulate": lambda *a: None},
    "measured error of the mesh": {
        "fenics_joints.diagnosis.model.prepared.mesh_errors": lambda *a, **k: None
    },
}


def ablate(
    folders: Sequence[Path],
    keep: Path,
    out: Path,
    *,
    cases: int,
    geometries: Sequence[str],
    mechanisms: Sequence[str] = tuple(MECHANISMS),
    say: Callable[[str], None] = print,
) -> dict:
    """Scores and seconds of cases without each mechanism, also written as they come.

    Args:
        folders: Checks, unpacked; their keys are in ``checks``.
        keep: Folder of kept models.
        out: File of the results, JSON; what it holds already is not made again.
        cases: How many of each geometry, drawn at random but always the same.
        geometries: Their names.
        mechanisms: Which are left out, by name.
        say: Told what is done.
    """
    rows = seal.read_json(out) if out.exists() else {}
    listed = []
    for folder in folders:
        key = (Path(__file__).with_name("checks") / f"{folder.name}.key").read_bytes().strip()
        listed += [
            (folder / "cases" / name, opened(answer))
            for name, answer in seal.answers_of(folder, key).items()
        ]
    listed.sort(key=lambda one: one[0].name)
    random.Random(1).shuffle(listed)
    own = [[one for one in listed if one[1]["geometry"] == name][:cases] for name in geometries]
    for place, truth in (one for same in zip_longest(*own) for one in same if one):
        for left_out in mechanisms:
            key = f"{place.name}, without {left_out}"
            if key not in rows:
                rows[key] = {
                    "geometry": truth["geometry"],
                    "kind": truth["kind"],
                    "without": left_out,
                    **_one(place, truth, keep, left_out),
                }
                write_text(out, json_text(rows))
                say(f"{key}: {rows[key]}")
    return rows


def _one(place: Path, truth: dict, keep: Path, left_out: str) -> dict:
    started = time.process_time()
    with ExitStack() as stack:
        for name, other in MECHANISMS[left_out].items():
            stack.enter_context(patch(name, other))
        try:
            said = diagnose(
                load_case(place), MPI.COMM_SELF, keep=keep / truth["geometry"]
            ).to_json()
        except JointsError as error:
            said, why = None, str(error)[:200]
    seconds = time.process_time() - started
    if said is None:
        return {"score": 0.0, "nats": math.log(20), "seconds": seconds, "error": why}
    record = Record(place.name, truth, Forecast(said))
    right = record.rank("class") == 1
    if truth["kind"] in ("none", "unknown"):
        right = said["verdict"] == {"none": "no gap", "unknown": "unknown"}[truth["kind"]]
    nats = record.log_score("class")
    if truth["kind"] == "pair":
        shares = record.forecast.marginals("class")
        right = statistics.mean(record.among_two("class"))
        nats = -statistics.mean(
            math.log(max([shares.get(label, 0.0) for label in each] + [1e-4]))
            for each in record.accepted("class")
        )
    return {"score": float(right), "nats": nats, "seconds": seconds, "verdict": said["verdict"]}


def table(rows: dict) -> str:
    """Markdown: what is lost of right answers and of ln probability, and the time, by geometry."""
    lines = ["| without | geometry | cases | right | nats lost | s a case |", 6 * "|---" + "|"]
    groups: dict[tuple[str, str], list[dict]] = {}
    for row in rows.values():
        groups.setdefault((row["without"], row["geometry"]), []).append(row)
    nats = {key: statistics.mean(row["nats"] for row in own) for key, own in groups.items()}
    for (name, geometry), own in groups.items():
        lines.append(
            f"| {name} | {geometry} | {len(own)} | {sum(r['score'] for r in own):g} | "
            f"{nats[name, geometry] - nats['nothing', geometry]:.2f} | "
            f"{statistics.median(r['seconds'] for r in own):.0f} |"
        )
    return "\n".join(lines)

"""Scores of the diagnoses against the opened answers.

What counts as right, and which cases count where, is in the README beside this file.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.blind import seal
from benchmarks.blind.forecast import LEVELS, NONE, UNKNOWN, Forecast
from benchmarks.blind.matching import cause_of, outcomes
from benchmarks.blind.matching import opened as truth_of
from benchmarks.blind.rates import Rate, calibration, grouped_rate, median_interval
from benchmarks.blind.seal import SealError
from fenics_joints.diagnosis.verdict import NAMED

#: Separability above which an effect is one the test can tell from every other: 1 % confusion.
APART = 2.33
#: Least probability that the logarithmic score counts with, lest one case decide it.
_FLOOR = 1e-4
#: An error of the model on held-out data that is not this many times the noise cannot shrink.
_VISIBLE = 2.0
_FALSE = 0.05


@dataclass(frozen=True)
class Record:
    """A case with its answer and what the diagnosis said.

    Attributes:
        name: Id of the case.
        truth: The answer: ``kind`` (none, single, pair, unknown), ``effects`` (name, region, size),
            ``geometry``, ``noise``, ``final_only``.
        forecast: What the diagnosis said.
        separability: D of the case, in standard deviations; None if it was not computed.
        oracle: Probability by outcome (effects' names and `NONE`) of one who knows the generator.
        n_causes: Outcomes between which a uniform guess would divide.
    """

    name: str
    truth: Mapping
    forecast: Forecast
    separability: float | None = None
    oracle: Mapping[str, float] = field(default_factory=dict)
    n_causes: int = 13

    @property
    def kind(self) -> str:
        """none, single, pair or unknown."""
        return self.truth["kind"]

    @property
    def effects(self) -> list[Mapping]:
        """The effects at work."""
        return list(self.truth["effects"])

    def accepted(self, level: str, *, region: bool = True) -> list[set[str]]:
        """For each thing that is true the labels of it that are right."""
        if self.kind == "none":
            return [{NONE}]
        if self.kind == "unknown":
            # Some the library has in other words; where they are it says as well as it can.
            named = [self.forecast.accepted(e, level, region=False) for e in self.effects]
            return [{UNKNOWN}.union(*named)]
        return [self.forecast.accepted(e, level, region=region) for e in self.effects]

    def counted(self, level: str, *, region: bool = True) -> list[set[str]]:
        """As `accepted`, without classes that say too little to be an answer, where rules say so.

        Outcomes without effect have no class. Such an answer is ambiguous: neither first nor among
        the first two.
        """
        found = self.accepted(level, region=region)
        if level != "class" or not self.truth.get("small_classes"):
            return found
        return [
            {x for x in right if x in (NONE, UNKNOWN) or not self.forecast.says_little(x)}
            for right in found
        ]

    def rank(self, level: str, *, region: bool = True, named: bool = False) -> float:
        """Rank of the (first) right outcome, from 1; equals count before it; inf if it has none.

        Args:
            level: One of `LEVELS`.
            region: Whether the region must be right too.
            named: Whether "none of these" is left out, which names nothing that one could check.
        """
        shares = self.forecast.shares(level)
        if named:
            shares.pop(UNKNOWN, None)
        right = self.counted(level, region=region)[0]
        best = max((shares.get(label, 0.0) for label in right), default=0.0)
        if best <= 0:
            return math.inf
        return 1 + sum(p >= best for label, p in shares.items() if label not in right)

    def right_share(self, level: str) -> float:
        """Probability given to the truth of a case with one outcome; labels of it taken as one."""
        if self.forecast.verdict == "failed":
            return 1 / self.n_causes
        shares = self.forecast.shares(level)
        return sum(shares.get(label, 0.0) for label in self.accepted(level, region=False)[0])

    def brier(self, level: str) -> float:
        """Sum over outcomes of (probability - truth)^2; a uniform guess among K has 1 - 1 / K."""
        if self.forecast.verdict == "failed":
            return 1 - 1 / self.n_causes
        right = self.accepted(level, region=False)[0]
        others = [p for k, p in self.forecast.shares(level).items() if k not in right]
        return (1 - self.right_share(level)) ** 2 + sum(p**2 for p in others)

    def log_score(self, level: str) -> float:
        """-ln of the probability given to the truth."""
        return -math.log(max(self.right_share(level), _FLOOR))

    def among_two(self, level: str) -> list[bool]:
        """For each thing that is true whether it is among the two likeliest to be at work."""
        found = self.forecast.marginals(level)
        first = set(sorted(found, key=lambda k: -found[k])[:2])
        return [bool(right & first) for right in self.counted(level, region=False)]

    def statement(self, level: str) -> tuple[float, bool] | None:
        """The boldest thing said, "this is at work": its probability and whether it is so."""
        found = self.forecast.marginals(level)
        if not found:
            return None
        label = max(found, key=lambda k: found[k])
        # Nothing is said to be surer than experience bears.
        most = self.forecast.diagnosis.get("probabilities", {}).get("most", 1.0)
        right = any(label in each for each in self.accepted(level, region=False))
        return min(found[label], most), right

    def set_of(self, share: float = 0.9) -> list[str]:
        """Fewest causes and regions that together have that probability, likeliest first."""
        taken, total = [], 0.0
        shares = self.forecast.shares("effect")
        for label in sorted(shares, key=lambda k: -shares[k]):
            taken.append(label)
            total += shares[label]
            if total >= share - 1e-9:  # sums of thirds and the like
                break
        return taken


# -- reading ---------------------------------------------------------------------------------------


def read_records(folder: Path, reckon: Callable | None = None) -> list[Record]:
    """The cases whose answers are open.

    Args:
        folder: The folder of the check.
        reckon: ``(id, answer) -> (separability, oracle's probabilities)``; None: without.

    Raises:
        SealError: If answers are sealed still, or a diagnosis was changed after they were opened.
    """
    if not (folder / seal.UNSEALED).exists():
        raise SealError(f"{folder}: the answers are sealed; unseal comes before score")
    opened = seal.read_json(folder / seal.UNSEALED)
    records = []
    for name, answer in sorted(opened["answers"].items()):
        path = folder / "diagnoses" / f"{name}.json"
        if seal.file_digest(path) != opened["diagnoses_sha256"][name]:
            raise SealError(f"{path}: was changed after the answers were opened")
        forecast = Forecast(seal.read_json(path).get("diagnosis"))
        distance, oracle = (None, {}) if reckon is None else reckon(name, answer)
        count = outcomes(answer["geometry"])
        records.append(Record(name, truth_of(answer), forecast, distance, oracle, count))
    return records


# -- scores ----------------------------------------------------------------------------------------


def score(records: Sequence[Record]) -> dict:
    """All scores as JSON: ``cases``, ``summary``, ``by`` (geometry, noise, final_only),
    ``drop`` (development to scoring only), ``by_separability``, ``confusion``.

    Args:
        records: From `read_records`.
    """
    return {
        "kinds": dict(Counter(r.kind for r in records)),
        "failed": sum(r.forecast.verdict == "failed" for r in records),
        "summary": summary(records),
        "by": {key: _split(records, key) for key in ("geometry", "noise", "final_only")},
        "drop": _drop(records),
        "by_separability": _by_separability(records),
        "confusion": confusion(records),
        "cases": [_row(r) for r in records],
    }


def _split(records: Sequence[Record], key: str) -> dict:
    values = sorted({str(r.truth.get(key)) for r in records})
    return {v: summary([r for r in records if str(r.truth.get(key)) == v]) for v in values}


def summary(records: Sequence[Record]) -> dict:
    """The scores of a set of cases."""
    single = [r for r in records if r.kind == "single"]
    apart = [r for r in single if r.separability is not None and r.separability >= APART]
    one = [r for r in records if r.kind != "pair"]
    return {
        "n": len(records),
        "single": _singles(single),
        "single_apart": _singles(apart),
        "oracle": {"single": _oracle_right(single), "single_apart": _oracle_right(apart)},
        "pair": _pairs([r for r in records if r.kind == "pair"]),
        "none": _false_alarms([r for r in records if r.kind == "none"]),
        "unknown": _unknowns(records),
        "brier": {level: _mean(r.brier(level) for r in one) for level in LEVELS[1:]},
        "log_score": {level: _mean(r.log_score(level) for r in one) for level in LEVELS[1:]},
        "uniform": {
            "brier": _mean(1 - 1 / r.n_causes for r in one),
            "log_score": _mean(math.log(r.n_causes) for r in one),
        },
        "calibration": {level: _calibration(records, level) for level in LEVELS[1:]},
        "sets": _sets(one),
        "shrinkage": _shrinkage(records),
    }


def _drop(records: Sequence[Record]) -> dict | None:
    """Fall of "cause first" from what development saw to what is for scoring only.

    The interval resamples both sets of cases; None if either is empty.
    """
    single = [r for r in records if r.kind == "single"]
    hits = [
        np.array([r.rank("cause") <= 1 for r in single if bool(r.truth.get("final_only")) == last])
        for last in (False, True)
    ]
    if not len(hits[0]) or not len(hits[1]):
        return None
    random = np.random.default_rng(0)
    drawn = [random.choice(h, (2000, len(h))).mean(axis=1) for h in hits]
    low, high = np.quantile(drawn[0] - drawn[1], [0.025, 0.975])
    return {
        "development": Rate.of(hits[0]).to_json(),
        "final": Rate.of(hits[1]).to_json(),
        "value": float(hits[0].mean() - hits[1].mean()),
        "low": float(low),
        "high": float(high),
    }


def _singles(records: Sequence[Record]) -> dict:
    """Top-1 and top-2 by cause and by class, with and without the region."""
    out = {"n": len(records)}
    for level in ("cause", "class"):
        ranks = [r.rank(level, region=False) for r in records]
        named = [r.rank(level, region=False, named=True) for r in records]
        out[f"top1_{level}"] = Rate.of(rank <= 1 for rank in ranks).to_json()
        out[f"top2_{level}"] = Rate.of(rank <= 2 for rank in named).to_json()
    for level in ("effect", "class"):
        ranks = [r.rank(level, region=True) for r in records]
        out[f"cause_and_region_{level}"] = Rate.of(rank <= 1 for rank in ranks).to_json()
    out["verdict_right"] = Rate.of(
        r.forecast.verdict in NAMED and r.rank("class", region=False) <= 1 for r in records
    ).to_json()
    out["verdicts"] = dict(Counter(r.forecast.verdict for r in records))
    out["answer_size"] = _answer_sizes(records)
    return out


def _answer_sizes(records: Sequence[Record]) -> dict:
    """How many effects the leading class holds: an answer by class is worth no more than this."""
    sizes = []
    for r in records:
        shares = r.forecast.shares("class")
        if shares:
            sizes.append(r.forecast.members(max(shares, key=lambda k: shares[k])))
    return {"mean": _mean(sizes), "median": _median(sizes), "largest": max(sizes, default=None)}


def _oracle_right(records: Sequence[Record]) -> dict:
    """Top-1 and top-2 of the oracle, by the world's own names."""
    ranks = []
    for r in records:
        if r.oracle:
            best = r.oracle.get(r.effects[0]["name"], 0.0)
            rivals = [p for name, p in r.oracle.items() if name != r.effects[0]["name"]]
            ranks.append(1 + sum(p >= best for p in rivals))
    return {
        "top1": Rate.of(k <= 1 for k in ranks).to_json(),
        "top2": Rate.of(k <= 2 for k in ranks).to_json(),
    }


def _pairs(records: Sequence[Record]) -> dict:
    """Both effects, or one at least, among the two that are likeliest at work."""
    out = {"n": len(records)}
    for level in ("cause", "class"):
        hits = [r.among_two(level) for r in records]
        both = [all(h) and (level == "class" or len(h) == 2) for h in hits]
        out[f"both_{level}"] = Rate.of(both).to_json()
        out[f"one_{level}"] = Rate.of(any(h) for h in hits).to_json()
    return out


def _false_alarms(records: Sequence[Record]) -> dict:
    """Cases without effect in which the diagnosis says anything but "no gap"."""
    verdicts = [r.forecast.verdict for r in records]
    return {
        "n": len(records),
        "alarm": Rate.of(v != "no gap" for v in verdicts).to_json(),
        "cause_named": Rate.of(v in NAMED for v in verdicts).to_json(),
        "verdicts": dict(Counter(verdicts)),
    }


def _unknowns(records: Sequence[Record]) -> dict:
    """Causes outside the library caught: by the verdict, and at 5 % false of its probability; and
    those that the library has in other words and that are named so."""
    inside = [r for r in records if r.kind in ("none", "single")]
    outside = [r for r in records if r.kind == "unknown"]
    by_verdict = {
        "caught": Rate.of(r.forecast.verdict == "unknown" for r in outside).to_json(),
        "false": Rate.of(r.forecast.verdict == "unknown" for r in inside).to_json(),
    }
    chance = {r.name: r.forecast.marginals("effect").get(UNKNOWN, 0.0) for r in inside + outside}
    threshold = _threshold([chance[r.name] for r in inside])
    return {
        "n": len(outside),
        "by_verdict": by_verdict,
        "in_other_words": Rate.of(
            r.forecast.verdict in NAMED and r.rank("class") == 1 for r in outside
        ).to_json(),
        "threshold": threshold,
        "caught": Rate.of(chance[r.name] > threshold for r in outside).to_json(),
        "caught_apart": Rate.of(
            chance[r.name] > threshold
            for r in outside
            if r.separability is not None and r.separability >= APART
        ).to_json(),
        "false": Rate.of(chance[r.name] > threshold for r in inside).to_json(),
    }


def _threshold(known: Sequence[float], allowed: float = _FALSE) -> float:
    """Least threshold that at most 5 % of the known cases exceed; 0 without any."""
    if not known:
        return 0.0
    return sorted(known, reverse=True)[int(math.floor(allowed * len(known) + 1e-9))]


def _calibration(records: Sequence[Record], level: str) -> dict | None:
    said = [s for r in records if (s := r.statement(level)) is not None]
    found = calibration([p for p, _ in said], [true for _, true in said])
    return None if found is None else {"n": len(said), **found.to_json()}


def _sets(records: Sequence[Record]) -> dict:
    """90 % sets of causes and regions: how often the truth is in them, and their sizes."""
    sets = [(r, set(r.set_of())) for r in records]
    hits = [bool(r.accepted("effect", region=False)[0] & s) for r, s in sets]
    sizes = [len(s) for _, s in sets if s]
    return {
        "coverage": Rate.of(hits).to_json(),
        "median_size": _median(sizes),
        "mean_size": _mean(sizes),
    }


# -- shrinkage -------------------------------------------------------------------------------------


def shrinkage_of(diagnosis: Mapping) -> dict | None:
    """S*, the placebo's, and whether the stated interval held; None where there is no gap.

    S* = (E_before - E_after) / (E_before - E_noise) with root mean squares on held-out data, worked
    out here from these; of each fold, whether its error lay in the interval stated before.
    """
    gap = diagnosis["gap"]
    given = diagnosis.get("shrinkage") or {
        "before": gap["heldout_before"],
        "after": gap["heldout_after"],
        "placebo": gap["placebo_after"],
        "noise": gap["noise"],
        "folds": [],
    }
    before, noise = given["before"], given["noise"]
    if before is None or noise is None or before < _VISIBLE * noise:
        return None
    return {
        "s": (before - given["after"]) / (before - noise),
        "placebo": (before - given["placebo"]) / (before - noise),
        "covered": [bool(fold["covered"]) for fold in given["folds"]],
    }


def _shrinkage(records: Sequence[Record]) -> dict:
    """Of the cases with an effect of the library."""
    rows = [
        s
        for r in records
        if r.kind in ("single", "pair")
        and r.forecast.diagnosis is not None
        and (s := shrinkage_of(r.forecast.diagnosis)) is not None
    ]
    return {
        "n": len(rows),
        "s": median_interval(row["s"] for row in rows),
        "placebo": median_interval(row["placebo"] for row in rows),
        "excess": median_interval(row["s"] - row["placebo"] for row in rows),
        "above_placebo": Rate.of(row["s"] > row["placebo"] for row in rows).to_json(),
        "predicted_covered": grouped_rate([row["covered"] for row in rows]),
    }


# -- where it goes wrong ---------------------------------------------------------------------------


def confusion(records: Sequence[Record]) -> dict:
    """Counts of the likeliest cause by the true one, by the world's names; pairs are left out."""
    counts: Counter = Counter()
    for r in records:
        if r.kind == "pair":
            continue
        true = {"none": NONE, "unknown": UNKNOWN}.get(r.kind) or r.effects[0]["name"]
        shares = r.forecast.shares("cause")
        said = max(shares, key=lambda k: shares[k]) if shares else "failed"
        counts[true, said if said in (NONE, UNKNOWN, "failed") else cause_of(said)] += 1
    names = sorted({name for pair in counts for name in pair} - {NONE, UNKNOWN, "failed"})
    rows = [*names, NONE, UNKNOWN]
    columns = [*rows, *(["failed"] if any(said == "failed" for _, said in counts) else [])]
    return {
        "true": rows,
        "said": columns,
        "counts": [[counts[true, said] for said in columns] for true in rows],
    }


def _by_separability(records: Sequence[Record]) -> list[dict]:
    """Accuracy of single effects in ranges of D, beside the oracle's and what D itself predicts."""
    edges = [0.0, 0.5, 1.0, 1.65, APART, 4.0, 8.0, math.inf]
    rows = []
    for low, high in zip(edges, edges[1:], strict=False):
        inside = [
            r
            for r in records
            if r.kind == "single" and r.separability is not None and low <= r.separability < high
        ]
        if inside:
            rows.append(
                {
                    "low": low,
                    "high": None if math.isinf(high) else high,
                    "median": float(np.median([r.separability for r in inside])),
                    "single": _singles(inside),
                    "oracle": _oracle_right(inside),
                }
            )
    return rows


def _row(r: Record) -> dict:
    """A case in the list of cases."""
    shares = r.forecast.shares("effect")
    statement = r.statement("class")
    shrink = None if r.forecast.diagnosis is None else shrinkage_of(r.forecast.diagnosis)
    one = r.kind != "pair"
    return {
        "id": r.name,
        "geometry": r.truth.get("geometry"),
        "noise": r.truth.get("noise"),
        "kind": r.kind,
        "true": [{k: e[k] for k in ("name", "region", "size") if k in e} for e in r.effects],
        "verdict": r.forecast.verdict,
        "said": sorted(shares, key=lambda k: -shares[k])[:3],
        "stated": None if statement is None else statement[0],
        "rank_cause": _finite(r.rank("cause")) if one else None,
        "rank_class": _finite(r.rank("class", region=False)) if one else None,
        "separability": r.separability,
        "shrinkage": shrink,
    }


def _finite(x: float) -> float | None:
    return None if math.isinf(x) else x


def _mean(values) -> float | None:
    values = list(values)
    return float(np.mean(values)) if values else None


def _median(values) -> float | None:
    values = list(values)
    return float(np.median(values)) if values else None

"""Probabilities of hypotheses as a diagnosis counted with them.

Versions up to November 2026 wrote only those that they showed, between 1 and 90 %. With a hundred
hypotheses the least of them add up to one more: as weights they would make "no gap" out of 0.6 to
0.3, and "some sensor is misplaced" likely. Their JSON has what they were made of: evidence, odds
and p-values. Recomputed so, they are those that are
shown in between to 4 % of themselves at most, 1 % in the median of 213 diagnoses. What "none of
these" keeps once held-out data have spoken follows from no evidence, and is taken as shown.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import expit, logsumexp

_UNKNOWN = "none of these"
#: Prior odds of any effect and of an unknown cause; p-value below which a hypothesis fails; weights
#: of what looks like a listed effect, and nats beyond which a misfit says no more.
_ANY, _OTHER, _MISFIT = 1.5, 0.2, 0.01
_ALIKE, _MOST = (-2.08, 0.36), 10.0
#: Least and largest probability that is shown, of that next to these.
_LEAST, _SHOWN = 0.0101, 0.8999
#: Effects whose odds come beside those of the others.
_BESIDE = (
    "local loss of stiffness",
    "cable or stinger",
    "attached resonator",
    "plate not flat",
    "thickness not even",
    "damping of the supports",
)


def weights_of(diagnosis: Mapping) -> np.ndarray:
    """Posterior probability of each of ``hypotheses``, in their order; they sum to one.

    Args:
        diagnosis: The JSON of a diagnosis; some early ones wrote weights, which are taken.
    """
    rows = diagnosis["hypotheses"]
    if "outside" in diagnosis:  # the JSON has them as they are
        return np.array([row["probability"] for row in rows], dtype=float)
    for key in ("weight", "probability"):
        if all(key in row and (key == "weight" or "log_evidence" not in row) for row in rows):
            return np.array([row[key] for row in rows], dtype=float)
    odds = {
        f"{e['name']} ({e['region']})" if e["region"] else e["name"]: e["odds"]
        for e in diagnosis["effects"]
    }
    total = sum(o for key, o in odds.items() if not key.startswith(_BESIDE))
    unknown = np.array([row["label"] == _UNKNOWN for row in rows])
    prior = [
        np.log(_OTHER) if other else sum(np.log(_ANY * odds[key] / total) for key in row["effects"])
        for row, other in zip(rows, unknown, strict=True)
    ]
    score = np.array([row["log_evidence"] for row in rows]) + prior
    p = np.array([row["p_value"] for row in rows])
    if (failed := ~unknown & (p < _MISFIT)).any():
        score[failed] -= max(float(logsumexp(score[failed])) - score[unknown].max(), 0.0)
    found = np.exp(score - logsumexp(score))
    leader = int(np.argmax(np.where(unknown, -np.inf, score)))
    misfit = min(-np.log(max(p[leader], 1e-300)), _MOST)
    found *= 1 - expit(_ALIKE[0] + _ALIKE[1] * misfit)
    found[unknown] += (1 - found.sum()) / unknown.sum()
    return _as_shown(found, unknown, [row.get("probability") for row in rows])


def _as_shown(found: np.ndarray, unknown: np.ndarray, shown: list[float | None]) -> np.ndarray:
    """With the probability of an unknown cause that is shown, if that is one and no limit of what
    is shown; the others keep their odds."""
    rest = found[~unknown].sum()
    own = [p for p, other in zip(shown, unknown, strict=True) if other]
    if len(own) != 1 or own[0] is None or not _LEAST < own[0] < _SHOWN or not rest > 0:
        return found
    return np.where(unknown, own[0], found * (1 - own[0]) / rest)

"""What stability and bifurcations along a branch cost, over the branch itself.

    ./with-fenicsx env OMP_NUM_THREADS=1 python3 benchmarks/stability.py [--json FILE]

Chains of 1 to 12 masses, each on a cubic spring or a slider to the ground, pushed at the first: the
branch about the first resonance, then `find_bifurcations` of it. Processor time; forms compiled.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from fenics_joints.harmonic import find_bifurcations, solve_harmonic
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import CubicSpring, ElasticFriction

TURN = 2 * np.pi


def chain(n: int, law) -> InterfaceModel:
    """Masses of 1 between springs of 1 and the ground at both ends, a law at each."""
    axes, K = np.eye(n), 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    joint = InterfacePoints("joints", law, axes[:, None, :], np.ones(n))
    return InterfaceModel(axes, K, (joint,), 0.02 * K, {"push": axes[0]}, {"first": axes[0]})


def timed(function):
    """Result and processor time, s."""
    start = time.process_time()
    return function(), time.process_time() - start


def cost(n: int, law, push: float) -> dict:
    """Times of one chain."""
    model = chain(n, law)
    low = np.sqrt(np.linalg.eigvalsh(model.K)[0]) / TURN
    solve = lambda: solve_harmonic(model, "push", push, (0.7 * low, 1.6 * low))  # noqa: E731
    solve()
    result, branch = timed(solve)
    found, stability = timed(lambda: find_bifurcations(result))
    return {
        "masses": n,
        "law": law.name,
        "responses": len(result),
        "branch_s": branch,
        "stability_s": stability,
        "ratio": stability / branch,
        "bifurcations": [b.kind for b in found.bifurcations],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    rows = []
    for law, push in ((CubicSpring(0.0, 1.0), 0.05), (ElasticFriction(1.0, 0.05), 0.1)):
        for n in (1, 4, 12):
            rows.append(cost(n, law, push))
            print(
                "{law:>16} {masses:3d} masses {responses:4d} responses: branch {branch_s:6.2f} s, "
                "stability {stability_s:6.2f} s, ratio {ratio:5.2f}; ".format(**rows[-1])
                + (", ".join(rows[-1]["bifurcations"]) or "no bifurcations")
            )
    if asked.json:
        asked.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Bayesian identification: what a sample costs, and how good the model is that is sampled.

The beams of seed 002 with the paper's likelihood and chain (20,000 samples, 5,000 thrown away) on
all ranks; and the lap plates, a solid model, through their reduced model: its error against the
full one at 50 random points of the prior, and the cost of a sample against a full solution.

    mpirun -n 2 python3 benchmarks/bayes.py beams
    python3 benchmarks/bayes.py plates
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fenics_joints.bayes import (
    FittedLikelihood,
    GaussianLikelihood,
    Posterior,
    Settings,
    sample,
)
from fenics_joints.bayes.case_model import case_model
from fenics_joints.build import build_structure
from fenics_joints.case import load_case
from fenics_joints.case_bayes import specimens
from fenics_joints.modal import solve_modes

DEMOS = Path(__file__).parents[1] / "demos"
COMM = MPI.COMM_WORLD


def say(text: str) -> None:
    """Print on rank 0."""
    if COMM.rank == 0:
        print(text, flush=True)


def clock(run):
    """What ``run`` returns, and its seconds of wall and of this rank's processor."""
    COMM.barrier()
    wall, own = time.perf_counter(), time.process_time()
    found = run()
    COMM.barrier()
    return found, time.perf_counter() - wall, time.process_time() - own


def beams() -> None:
    """20,000 samples in all, and 20,000 for each of four chains."""
    case = load_case(DEMOS / "bolted_beams")
    model, wall, _ = clock(lambda: case_model(case, COMM))
    say(f"beams: {model.n_dofs} dofs, sampled with {model.n_basis}, ready in {wall:.1f} s")
    say(f"error at {model.check.n_points} points of the prior: {model.check.error:.1e}")
    likelihood = FittedLikelihood.from_specimens(case.measurements().mode_names, specimens(case))
    posterior = Posterior(model.prior, model.frequencies, likelihood)
    for kind, n in (("metropolis", 5000), ("metropolis", 20000), ("prior_metropolis", 20000),
                    ("emcee", 20000)):  # fmt: skip
        settings = Settings(kind, n, n // 4, 4)
        found, wall, own = clock(lambda s=settings: sample(posterior, s, COMM))
        worst = min(min(c["ess_bulk"], c["ess_tail"]) for c in found.convergence.values())
        rhat = max(c["rhat"] for c in found.convergence.values())
        say(f"{kind}, 4 chains of {n} on {COMM.size} ranks: {wall:.1f} s ({own:.1f} s of the "
            f"processor on rank 0), least ESS {worst:.0f}, R-hat {rhat:.4f}")  # fmt: skip


def plates() -> None:
    """Error and cost of the reduced model."""
    case = load_case(DEMOS / "lap_plates")
    model, wall, own = clock(lambda: case_model(case, COMM))
    check = model.check
    say(f"plates: {model.n_dofs} dofs, sampled with {model.n_basis}, ready in {wall:.0f} s "
        f"({own:.0f} s of the processor)")  # fmt: skip
    say(f"error at {check.n_points} points of the prior: {check.error:.1e}, median "
        f"{check.median:.0e}; {check.n_missing} points lack a mode")  # fmt: skip
    full, n = build_structure(case, COMM), case.diagnose.n_modes
    points = model.frequencies.by_name(
        model.prior.values(model.prior.sample(4, np.random.default_rng(1)))
    )
    modes = solve_modes(full, points[0], n_modes=n)
    _, _, solve = clock(
        lambda: [solve_modes(full, p, n_modes=n, solver=modes.solver) for p in points[1:]]
    )
    solve /= 3
    data = case.measurements()
    likelihood = GaussianLikelihood.from_row(
        data.mode_names, data.frequencies_hz[-1], data.log_sd()[-1], case.diagnose.discrepancy
    )
    posterior = Posterior(model.prior, model.frequencies, likelihood)
    settings = Settings("metropolis", 1000, 500, 16)
    found, wall, own = clock(lambda: sample(posterior, settings, COMM))
    each = own / (found.evaluations / COMM.size)
    say(f"full solution {solve:.2f} s, a sample {1e3 * each:.2f} ms (seconds of the processor): "
        f"{solve / each:.0f} times cheaper")  # fmt: skip


if __name__ == "__main__":
    with threadpool_limits(1):
        {"beams": beams, "plates": plates}[sys.argv[1] if len(sys.argv) > 1 else "beams"]()

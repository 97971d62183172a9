"""Bayesian identification: what a sample costs, and how good the model is that is sampled.

    ./with-fenicsx env OMP_NUM_THREADS=1 mpirun -n 2 python3 benchmarks/bayes.py beams
    ./with-fenicsx env OMP_NUM_THREADS=1 python3 benchmarks/bayes.py plates
    ./with-fenicsx env OMP_NUM_THREADS=1 python3 benchmarks/bayes.py --quick

beams: Jalali et al. 2019's structure with the paper's likelihood and length of a chain, 20,000
samples of which 5,000 are thrown away, four chains of it over the ranks: seconds against the 30
that are allowed, and a sample against the peer, SciPy's `eigh` of the whole beams.
plates: the lap plates, a solid model, with four parameters: a sample of the reduced model against a
full solution in the same run, in pairs, and the reduced model's error at 50 random points of the
prior beside what its own estimate says there and elsewhere.
--quick takes coarse plates and short chains, to see in a minute that all of it works.
"""

from __future__ import annotations

import statistics
import time

import numpy as np
import scipy.linalg
from harness import ROOT, parser, timed, write
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fenics_joints.bayes import FittedLikelihood, GaussianLikelihood, Posterior, Settings, sample
from fenics_joints.case import Case, build_structure, load_case
from fenics_joints.case.bayes import bayes_data, specimens
from fenics_joints.commands.bayes.model import CaseModel, case_model
from fenics_joints.modal import solve_modes

DEMOS = ROOT / "demos"
COMM = MPI.COMM_WORLD
#: What is allowed and asked for.
LIMIT_S, LEAST_RATIO, LARGEST_ERROR = 30.0, 500.0, 1e-4


def say(text: str) -> None:
    """Print on rank 0."""
    if COMM.rank == 0:
        print(text, flush=True)


def clock(run):
    """What ``run`` returns, its seconds of wall, and of this rank's processor."""
    COMM.barrier()
    found, wall, own = timed(run)
    COMM.barrier()
    return found, wall, own


def described(model: CaseModel, wall: float) -> dict:
    """Size and error of the model that is sampled."""
    check = model.check
    return {
        "dofs": model.n_dofs,
        "basis": model.n_basis,
        "prepared_s": wall,
        "error": check.error,
        "median_error": check.median,
        "estimated_error": model.bound,
        "points": check.n_points,
        "points_without_modes": check.n_missing,
        "error_allowed": LARGEST_ERROR,
    }


def show(title: str, found: dict) -> None:
    """A line for each number."""
    say(f"\n{title}")
    for key, value in found.items():
        if isinstance(value, dict):
            words = ", ".join(f"{k} {v:.4g}" for k, v in value.items())
        else:
            words = f"{value:.4g}"
        say(f"    {key:28s} {words}")


# -- beams -----------------------------------------------------------------------------------------


def beams(args) -> dict:
    case = load_case(DEMOS / "bolted_beams")
    model, wall, _ = clock(lambda: case_model(case, COMM))
    names = bayes_data(case).mode_names
    posterior = Posterior(
        model.prior, model.frequencies, FittedLikelihood.from_specimens(names, specimens(case))
    )
    found = described(model, wall)
    for kind in ("metropolis", "prior_metropolis", "emcee"):
        settings = Settings(kind, args.samples, args.samples // 4, args.chains)
        chains, wall, own = clock(lambda s=settings: sample(posterior, s, COMM))
        worst = chains.convergence.values()
        found[kind] = {
            "seconds": wall,
            "share_of_limit": wall / LIMIT_S,
            "processor_s": own,
            "samples": args.samples * args.chains,
            "least_ess": min(min(c["ess_bulk"], c["ess_tail"]) for c in worst),
            "rhat": max(c["rhat"] for c in worst),
        }
        each = own * COMM.size / (args.samples * args.chains)
        found[kind]["peer_ratio"] = peer(case, model, len(names)) / each
    found["ranks"], found["limit_s"] = COMM.size, LIMIT_S
    show(f"beams: {args.chains} chains of {args.samples} samples on {COMM.size} ranks", found)
    return found


def peer(case: Case, model: CaseModel, n_modes: int, count: int = 60) -> float:
    """Processor seconds for a point: the beams' matrices whole, their lowest modes by SciPy."""
    full = build_structure(case, MPI.COMM_SELF)
    draws = model.prior.sample(count, np.random.default_rng(3))
    points = model.frequencies.by_name(model.prior.values(draws))
    begin = time.process_time()
    for values in points:
        K, M = full.stiffness(values), full.mass(values)
        scipy.linalg.eigh(K, M, subset_by_index=[0, 3 + 2 * n_modes])
    return (time.process_time() - begin) / count


# -- plates ----------------------------------------------------------------------------------------


def plates(args) -> dict:
    case = load_case(DEMOS / "lap_plates")
    size = {"element_size": args.element_size}
    case = case.model_copy(update={"mesh": case.mesh.model_copy(update=size)})
    model, wall, _ = clock(lambda: case_model(case, COMM))
    found = described(model, wall)
    data = case.measurements()
    row = data.row(case.update.at)
    posterior = Posterior(
        model.prior,
        model.frequencies,
        GaussianLikelihood.from_row(
            data.mode_names, data.frequencies_hz[row], data.log_sd()[row], case.diagnose.discrepancy
        ),
    )
    found |= pairs(case, model, posterior, args)
    found["least_ratio"] = LEAST_RATIO
    show(f"lap plates, elements of {1e3 * args.element_size:g} mm", found)
    return found


def pairs(case: Case, model: CaseModel, posterior: Posterior, args) -> dict:
    """A full solution and a short run of chains after it, several times."""
    full, n = build_structure(case, COMM), case.diagnose.n_modes
    draws = model.prior.sample(args.runs + 1, np.random.default_rng(1))
    points = [{**model.start, **p} for p in model.frequencies.by_name(model.prior.values(draws))]
    solver = solve_modes(full, points[0], n_modes=n).solver  # compiles and orders
    solve, each, ratios = [], [], []
    for i, values in enumerate(points[1:]):
        own = clock(lambda v=values: solve_modes(full, v, n_modes=n, solver=solver))[2]
        settings = Settings("metropolis", args.segment, args.segment // 2, args.chains, seed=i)
        before = model.frequencies.calls
        chains_s = clock(lambda s=settings: sample(posterior, s, COMM))[2]
        asked = model.frequencies.calls - before
        solve.append(own)
        each.append(chains_s / asked)
        ratios.append(own / each[-1])
    return {
        "full_solution_s": statistics.median(solve),
        "sample_s": statistics.median(each),
        "ratio": statistics.median(ratios),
        "worst_ratio": min(ratios),
        "chains": args.chains,
    }


def main() -> None:
    parts = {"beams": beams, "plates": plates}
    made = parser(__doc__, parts)
    made.add_argument("--quick", action="store_true", help="coarse plates, short chains")
    made.add_argument("--samples", type=int, default=20000, help="of a chain of the beams")
    made.add_argument("--chains", type=int, default=4)
    made.add_argument("--runs", type=int, default=5, help="pairs of the plates")
    made.add_argument("--segment", type=int, default=1000, help="samples of a chain in a pair")
    made.add_argument("--element-size", type=float, default=5e-3, help="of the plates, metres")
    args = made.parse_args()
    if args.quick:
        args.samples, args.segment, args.runs, args.element_size = 2000, 200, 3, 0.02
    with threadpool_limits(1):
        found = {name: parts[name](args) for name in args.parts or parts}
    if COMM.rank == 0:
        write(args.json, found)


if __name__ == "__main__":
    main()

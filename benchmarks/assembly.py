"""K(p) and M(p) as sums of kept matrices, against their assembly, in one process.

The lap plates with every parameter of `diagnose`, at values drawn about the nominal ones.

    ./with-fenicsx python3 benchmarks/assembly.py [--element-size 5e-3] [--runs 10]
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case

CASE = Path(__file__).parent.parent / "demos" / "lap_plates"
#: Calls after which all that is varied here is summed.
_WARM = 16


def measure(element_size: float, runs: int) -> None:
    case = load_case(CASE)
    mesh = case.mesh.model_copy(update={"element_size": element_size})
    case = case.model_copy(update={"mesh": mesh})
    rng = np.random.default_rng(1)

    def made():
        return build_structure(case, MPI.COMM_WORLD, law="uncoupled", width=True)

    def timed(full) -> float:
        moved = {
            name: p.value * (1 + 0.02 * rng.standard_normal())
            for name, p in full.parameters.items()
            if p.value and not name.endswith(".nu")
        }
        full.comm.barrier()
        begin = time.perf_counter()
        K, M = full.stiffness(moved), full.mass(moved)
        seconds = time.perf_counter() - begin
        K.destroy(), M.destroy()
        return seconds

    kept = made()
    first = sum(timed(kept) for _ in range(_WARM))
    timed(made())  # compiles the forms
    pairs = [(timed(made()), timed(kept)) for _ in range(runs)]
    if MPI.COMM_WORLD.rank == 0:
        whole, summed = (statistics.median(each) for each in zip(*pairs, strict=True))
        ratio = statistics.median(b / a for a, b in pairs)
        print(f"{kept.n_dofs} DOFs, {len(kept.parameters)} parameters")
        print(f"assembled {whole:.3f} s, summed {summed:.3f} s: {ratio:.2f} (median of pairs)")
        print(f"the first {_WARM}, with the samples made: {first / _WARM / whole:.2f} of assembly")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--element-size", type=float, default=5e-3, help="metres")
    parser.add_argument("--runs", type=int, default=10)
    args = parser.parse_args()
    measure(args.element_size, args.runs)


if __name__ == "__main__":
    main()

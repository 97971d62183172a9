"""Ten modes of the engraving machine's stand-in: direct and iterative, time and memory.

    python3 benchmarks/iterative.py [--sizes 0.06 0.03] [--ranks 1 2] [--json FILE]
    python3 benchmarks/iterative.py --sizes 0.018 --methods iterative --ranks 2

Needs nothing but Python itself where it is started: the runs go through ``./with-fenicsx`` when
DOLFINx is not at hand. Each run is a process of its own under MPI: build the mesh and the model,
solve. Peak memory is the sum over the ranks of the largest resident size of each, of the whole
process and of the solution beyond what the process had before it (imports, mesh, space, compiled
forms). The modal solution assembles its matrices itself, so they are in the second number of both
methods. Forms are compiled beforehand, by a run on the coarsest mesh.
"""

from __future__ import annotations

import json
import resource
import sys
import tempfile
from pathlib import Path

from harness import ROOT, across_processes, parser, python_command, run, threads, timed, write

CASE = ROOT / "demos" / "engraving_machine"
COARSEST = 0.15
RIGID = 6
GIB = 2**20  # in KiB, the unit of ru_maxrss on Linux


# -- one run, under MPI --------------------------------------------------------------------------


def solve(size: float, method: str, n_modes: int, output: Path) -> None:
    """What a user's script does, and what it took."""
    from mpi4py import MPI

    from fenics_joints.case import build_structure, load_case
    from fenics_joints.modal import solve_modes

    comm = MPI.COMM_WORLD
    case = load_case(CASE)
    mesh = case.mesh.model_copy(update={"element_size": size})
    model = build_structure(case.model_copy(update={"mesh": mesh}), comm)
    model.dilation_frequency()  # compiles and counts the forms' tables before the solution
    before = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    comm.Barrier()
    modes, seconds, cpu = timed(lambda: solve_modes(model, n_modes=n_modes, method=method))
    cpu = comm.allreduce(cpu)
    peak = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    steps = modes.statistics.get("iterations", modes.statistics.get("block_solves"))
    applied = modes.statistics.get("preconditioner_applications", modes.statistics.get("solves"))
    report = {
        "dofs": model.n_dofs,
        "method": method,
        "ranks": comm.size,
        "seconds": seconds,
        "cpu_seconds": cpu,
        "process_gib": peak / GIB,
        "solution_gib": (peak - before) / GIB,
        "iterations": steps,
        "columns": applied,
        "residual": float(modes.residuals.max()),
        "frequencies_hz": modes.frequencies_hz.tolist(),
    }
    if comm.rank == 0:
        output.write_text(json.dumps(report))


# -- all runs --------------------------------------------------------------------------------------


def one_run(arguments, size, method, ranks) -> dict:
    """One run as a process of its own, with its wall time from start to exit."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "run.json"
        words = ["--as", method, "--sizes", size, "--modes", arguments.modes, "--output", output]
        command = python_command(arguments.launcher, __file__, *words, ranks=ranks)
        wall = run(command, Path(folder), threads(1))["wall"]
        return json.loads(output.read_text()) | {"size": size, "wall_seconds": wall}


def compare(rows) -> list[dict]:
    """Ratios of the iterative method to the direct one, of the same size and number of ranks."""
    found = []
    for row in rows:
        twin = [
            r
            for r in rows
            if r["method"] == "direct" and r["size"] == row["size"] and r["ranks"] == row["ranks"]
        ]
        if row["method"] != "iterative" or not twin:
            continue
        pairs = zip(row["frequencies_hz"], twin[0]["frequencies_hz"], strict=True)
        found.append(
            {key: row[key] for key in ("dofs", "ranks")}
            | {
                key: row[key] / twin[0][key]
                for key in ("process_gib", "solution_gib", "seconds", "cpu_seconds")
            }
            | {"largest_difference": max(abs(a / b - 1) for a, b in list(pairs)[RIGID:])}
        )
    return found


def show(rows, ratios) -> None:
    print(
        f"{'DOFs':>10s} {'method':10s}{'ranks':>6s}{'iterations':>11s}{'columns':>8s}"
        f"{'solve, s':>10s}{'cpu, s':>9s}{'whole, s':>10s}{'process, GiB':>14s}"
        f"{'solution, GiB':>15s}"
    )
    for r in rows:
        print(
            f"{r['dofs']:10,d} {r['method']:10s}{r['ranks']:6d}{r['iterations']:11d}"
            f"{r['columns']:8d}{r['seconds']:10.1f}{r['cpu_seconds']:9.1f}{r['wall_seconds']:10.1f}"
            f"{r['process_gib']:14.2f}{r['solution_gib']:15.2f}"
        )
    for r in ratios:
        print(
            f"{r['dofs']:,} DOFs, {r['ranks']} ranks, iterative over direct: process memory "
            f"{r['process_gib']:.2f}, solution memory {r['solution_gib']:.2f}, time "
            f"{r['seconds']:.2f}, processor time {r['cpu_seconds']:.2f}; largest difference of a "
            f"frequency {r['largest_difference']:.1e}"
        )


def main() -> None:
    methods = ("direct", "iterative")
    made = across_processes(parser(__doc__), methods)
    sizes = "element sizes, m; 0.06 has some 1e5 DOFs, 0.03 4e5, 0.018 1e6"
    made.add_argument("--sizes", type=float, nargs="+", default=[0.06, 0.03], help=sizes)
    made.add_argument("--ranks", type=int, nargs="+", default=[1, 2], help="MPI ranks")
    made.add_argument("--methods", nargs="+", choices=methods, default=methods)
    made.add_argument("--modes", type=int, default=10, help="modes, rigid-body ones included")
    arguments = made.parse_args()
    if arguments.role:
        solve(arguments.sizes[0], arguments.role, arguments.modes, arguments.output)
        return
    rows = []
    for method in arguments.methods:
        one_run(arguments, COARSEST, method, 1)  # compiles forms
    for size in arguments.sizes:
        for ranks in arguments.ranks:
            for method in arguments.methods:
                rows.append(one_run(arguments, size, method, ranks))
                print(f"{method}, {ranks} ranks, {rows[-1]['dofs']:,} DOFs: done", file=sys.stderr)
    ratios = compare(rows)
    show(rows, ratios)
    write(arguments.json, {"runs": rows, "ratios": ratios})


if __name__ == "__main__":
    main()

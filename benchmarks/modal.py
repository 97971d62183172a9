"""Modes of the lap plates beside CalculiX: the same nodes, the same frequencies, whole processes.

    python3 benchmarks/modal.py [--runs 3] [--json FILE]

Needs nothing but Python itself where it is started: our side runs through ``./with-fenicsx`` when
DOLFINx is not at hand, CalculiX where ``ccx`` is found. It also measures the floor under our solve,
in the same process on the same matrix: one MUMPS factorisation and the solves of Lanczos.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).resolve()
PLATES = {"E": 69e9, "G": 26.9e9, "rho": 2750.0}
LAYER = {"E": 3.00e9, "G": 1.15e9, "rho": 0.0}  # Tian et al. 2021's initial values, in both zones
SINGLE_SOLVES = 36  # a Krylov basis without restart for 12 modes: 2 n + 12


# -- our side, under MPI -------------------------------------------------------------------------


def make_mesh(comm, counts):
    from fenics_joints.meshes import lap_plates

    n_length, n_width, n_thickness = counts
    return lap_plates(comm, n_length=n_length, n_width=n_width, n_thickness=n_thickness, zone=0.0)


def solve_ours(counts, n_modes: int, with_floor: bool, output: Path) -> None:
    """One process of our side: what a user's script does, and the stages' times."""
    from mpi4py import MPI

    from fenics_joints.modal import solve_modes
    from fenics_joints.structure import Structure, joint, part

    comm = MPI.COMM_WORLD
    times = {"import": time.perf_counter() - START}
    nu = PLATES["E"] / (2 * PLATES["G"]) - 1
    regions = [
        part("plates", ("plate_1", "plate_2"), E=PLATES["E"], nu=nu, rho=PLATES["rho"]),
        joint("layer", "joint_away", law="isotropic", **LAYER),
    ]
    begin = time.perf_counter()
    model = Structure(make_mesh(comm, counts), regions)
    times["mesh and structure"] = time.perf_counter() - begin
    begin = time.perf_counter()
    modes = solve_modes(model, n_modes=n_modes)
    total = time.perf_counter() - begin
    solving = float(modes.statistics["seconds"])
    times |= {"assembly": total - solving, "eigenproblem": solving}
    result = {
        "dofs": model.n_dofs,
        "frequencies_hz": modes.frequencies_hz.tolist(),
        "residual": float(modes.residuals.max()),
        "seconds": times,
        "statistics": dict(modes.statistics),
    }
    if with_floor:
        result["floor"] = measure_floor(model, modes)
    if comm.rank == 0:
        output.write_text(json.dumps(result))


def measure_floor(model, modes, repeats: int = 3) -> list[dict[str, float]]:
    """Our eigenproblem and MUMPS alone, in turn on one matrix; the ordering is kept in both.

    Seconds of ours, of a factorisation, of a single solve and of a block as wide as ours.
    """
    solver = modes.solver
    K, M = model.stiffness(), model.mass()
    rows = []
    for _ in range(repeats):
        begin = time.perf_counter()
        found = solver.solve(K, M).statistics
        ours = time.perf_counter() - begin
        width = found["solves"] // found["block_solves"]
        row = {"ours": ours, "blocks": found["block_solves"], "width": width}
        rows.append(row | time_mumps(solver.solver.getST().getKSP(), width))
    return rows


def time_mumps(ksp, width: int, repeats: int = 4) -> dict[str, float]:
    """Seconds of one factorisation, one single solve and one block solve."""
    from petsc4py import PETSc

    A = ksp.getOperators()[1]
    right, left = A.createVecs()
    right.setRandom()
    pair = [PETSc.Mat().createDense([A.getSizes()[0], (None, width)], comm=A.comm) for _ in "xy"]
    for mat in pair:
        mat.setUp()
        mat.assemble()
    pair[0].setRandom()
    A.stateIncrease()  # so that PETSc believes in new values
    ksp.setOperators(A)
    seconds = {"factor": clock(ksp.setUp, 1)}
    seconds["single"] = clock(lambda: ksp.solve(right, left), repeats)
    seconds["block"] = clock(lambda: ksp.matSolve(*pair), repeats)
    for mat in pair:
        mat.destroy()
    return seconds


def clock(function, repeats: int) -> float:
    begin = time.perf_counter()
    for _ in range(repeats):
        function()
    return (time.perf_counter() - begin) / repeats


# -- CalculiX's deck -----------------------------------------------------------------------------

# DOLFINx numbers the corners of a hexahedron along x, then y, then z; CalculiX goes around.
CORNERS = (0, 1, 3, 2, 4, 5, 7, 6)
# The ends of its twelve edges, in the order of C3D20's nodes 9 to 20.
EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)


def write_deck(counts, n_modes: int, path: Path) -> None:
    """The same mesh as C3D20 elements (3 x 3 x 3 Gauss points, as ours)."""
    import numpy as np
    from mpi4py import MPI

    from fenics_joints._compat import geometry_dofmap

    tagged = make_mesh(MPI.COMM_SELF, counts)
    corners = geometry_dofmap(tagged.mesh)[:, CORNERS].astype(np.int64)
    x = tagged.mesh.geometry.x
    ends = np.sort(corners[:, np.array(EDGES)].reshape(-1, 2), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    nodes = np.concatenate([x, x[edges].mean(axis=1)])
    elements = np.hstack([corners, number.reshape(-1, 12) + len(x)]) + 1
    layer = np.zeros(len(corners), dtype=bool)
    layer[tagged.cell_tags.find(tagged.cell_tag("joint_away"))] = True
    with path.open("w") as deck:
        deck.write("*NODE, NSET=ALL\n")
        deck.writelines(f"{i},{a:.12g},{b:.12g},{c:.12g}\n" for i, (a, b, c) in enumerate(nodes, 1))
        for name, chosen, values in (("PLATES", ~layer, PLATES), ("LAYER", layer, LAYER)):
            deck.write(f"*ELEMENT, TYPE=C3D20, ELSET={name}\n")
            for i in np.flatnonzero(chosen):
                row = [str(n) for n in (i + 1, *elements[i])]
                deck.write(",".join(row[:11]) + ",\n" + ",".join(row[11:]) + "\n")
            nu = values["E"] / (2 * values["G"]) - 1
            deck.write(
                f"*MATERIAL, NAME={name}\n*ELASTIC\n{values['E']},{nu}\n*DENSITY\n{values['rho']}\n"
                f"*SOLID SECTION, ELSET={name}, MATERIAL={name}\n"
            )
        deck.write(f"*STEP\n*FREQUENCY\n{n_modes}\n*END STEP\n")


def read_frequencies(path: Path) -> list[float]:
    """Frequencies in Hz from CalculiX's .dat file; zero where the eigenvalue is negative."""
    lines = path.read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if "E I G E N V A L U E" in line)
    rows = []
    for line in lines[start + 1 :]:
        words = line.split()
        if words and words[0].isdigit():
            rows.append(float(words[3]))
        elif rows:
            break
    return rows


# -- the comparison ------------------------------------------------------------------------------


def timed(command, cwd: Path, environment) -> dict[str, float]:
    """Run a whole process; its wall-clock and processor seconds."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True
    )
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        said = done.stdout[-2000:] + done.stderr[-4000:]
        sys.exit(f"{shlex.join(map(str, command))} failed:\n{said}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall": wall, "cpu": cpu}


def launcher(arguments) -> list[str]:
    if arguments.launcher is not None:
        return shlex.split(arguments.launcher)
    return [] if find_spec("dolfinx") else [str(HERE.parents[1] / "with-fenicsx")]


def run_benchmark(arguments, scratch: Path) -> dict:
    start = launcher(arguments)
    python = [*start, "python3" if start else sys.executable, str(HERE)]
    ranks = ["mpirun", "-n", str(arguments.ranks)]
    inner = ["python3" if start else sys.executable, str(HERE)]
    # One thread for each rank: two ranks with two threads each would fight for two cores.
    threads = "1" if arguments.ranks > 1 else str(arguments.threads)
    ours = {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    size = ["--elements", *map(str, arguments.elements), "--modes", str(arguments.modes)]
    coarse = ["--elements", "10", "4", "1", "--modes", str(arguments.modes)]

    def command(extra):
        return [*start, *(ranks if arguments.ranks > 1 else []), *inner, *extra]

    out = scratch / "ours.json"
    timed(command([*coarse, "--as", "ours", "--output", str(out)]), scratch, ours)  # compiles forms
    ccx = arguments.ccx or shutil.which("ccx")
    if ccx:
        timed([*python, *size, "--as", "deck", "--output", str(scratch / "lap.inp")], scratch, {})
    runs = []
    for _ in range(arguments.runs):
        run = {"ours": timed(command([*size, "--as", "ours", "--output", str(out)]), scratch, ours)}
        run["detail"] = json.loads(out.read_text())
        if ccx:
            both = str(arguments.threads)
            run["ccx"] = timed([ccx, "-i", "lap"], scratch, {"OMP_NUM_THREADS": both})
        runs.append(run)
        line = "   ".join(
            f"{who} {run[who]['wall']:6.1f} s wall {run[who]['cpu']:6.1f} s cpu"
            for who in ("ours", "ccx")
            if who in run
        )
        print(f"run {len(runs)}: {line}", flush=True)
    timed(command([*size, "--as", "floor", "--output", str(out)]), scratch, ours)
    theirs = read_frequencies(scratch / "lap.dat") if ccx else None
    return summarise(runs, json.loads(out.read_text()), theirs)


def summarise(runs, floored, theirs) -> dict:
    detail, floors = runs[-1]["detail"], floored["floor"]
    for row in floors:
        row["mumps_blocks"] = row["factor"] + row["blocks"] * row["block"]
        row["mumps_singles"] = row["factor"] + SINGLE_SOLVES * row["single"]
        row["ratio"] = row["ours"] / row["mumps_blocks"]
        row["ratio_to_singles"] = row["ours"] / row["mumps_singles"]
    report = {
        "dofs": detail["dofs"],
        "frequencies_hz": detail["frequencies_hz"],
        "residual": detail["residual"],
        "runs": [{who: run[who] for who in ("ours", "ccx") if who in run} for run in runs],
        "stages_seconds": {
            stage: statistics.median(run["detail"]["seconds"][stage] for run in runs)
            for stage in detail["seconds"]
        },
        "statistics": detail["statistics"],
        "floor": {key: statistics.median(row[key] for row in floors) for key in floors[0]},
    }
    if theirs is not None:
        report["ccx_frequencies_hz"] = theirs
        report["largest_difference_percent"] = max(
            100 * abs(a / b - 1)
            for a, b in zip(detail["frequencies_hz"], theirs, strict=True)
            if b > 1.0  # the rigid-body modes are round-off in both
        )
        for key in ("wall", "cpu"):
            report[f"times_faster_{key}"] = statistics.median(
                run["ccx"][key] / run["ours"][key] for run in runs
            )
    return report


def show(report) -> None:
    theirs = report.get("ccx_frequencies_hz")
    print(f"\n{report['dofs']:,} DOFs; largest relative residual {report['residual']:.1e}")
    print("mode      ours, Hz" + ("       ccx, Hz    difference" if theirs else ""))
    for i, f in enumerate(report["frequencies_hz"]):
        beside = ""
        if theirs:
            beside = f"{theirs[i]:14.3f}"
            beside += f"{100 * (f / theirs[i] - 1):12.5f} %" if theirs[i] > 1 else "         rigid"
        print(f"{i + 1:4d}{f:14.3f}{beside}")
    stages = ", ".join(f"{stage} {s:.2f}" for stage, s in report["stages_seconds"].items())
    print(f"stages of ours, s: {stages}")
    floor = report["floor"]
    print(
        f"MUMPS alone, s: factorisation {floor['factor']:.2f}; one solve {floor['single']:.3f}; "
        f"one with {floor['width']:.0f} columns {floor['block']:.3f}"
    )
    print(
        f"eigenproblem, ordering kept: {floor['ours']:.2f} s, {floor['ratio']:.2f} times MUMPS "
        f"alone (factorisation + {floor['blocks']:.0f} block solves, "
        f"{floor['mumps_blocks']:.2f} s), "
        f"{floor['ratio_to_singles']:.2f} times factorisation + {SINGLE_SOLVES} single solves "
        f"({floor['mumps_singles']:.2f} s)"
    )
    if theirs:
        print(f"largest difference in frequency: {report['largest_difference_percent']:.4f} %")
        print(
            f"whole process, median of {len(report['runs'])} pairs: "
            f"{report['times_faster_wall']:.2f} times faster than ccx "
            f"(processor time: {report['times_faster_cpu']:.2f} times less)"
        )
    else:
        print("ccx was not found (apt install calculix-ccx, or --ccx PATH): no comparison made")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3, help="alternating pairs of runs")
    parser.add_argument("--ranks", type=int, default=2, help="MPI ranks of ours")
    threads = "threads of ccx, and of ours at 1 rank"
    parser.add_argument("--threads", type=int, default=2, help=threads)
    parser.add_argument("--elements", type=int, nargs=3, default=(60, 24, 4), metavar="N")
    parser.add_argument("--modes", type=int, default=12)
    parser.add_argument("--ccx", help="path of CalculiX")
    parser.add_argument("--launcher", help="command that enters FEniCSx; '' for none")
    parser.add_argument("--json", type=Path, help="write all numbers here")
    roles = ("ours", "floor", "deck")  # what a child process does
    parser.add_argument("--as", dest="role", choices=roles, help=argparse.SUPPRESS)
    parser.add_argument("--output", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.role == "deck":
        write_deck(arguments.elements, arguments.modes, arguments.output)
    elif arguments.role:
        floor = arguments.role == "floor"
        solve_ours(arguments.elements, arguments.modes, floor, arguments.output)
    else:
        with tempfile.TemporaryDirectory() as scratch:
            report = run_benchmark(arguments, Path(scratch))
        show(report)
        if arguments.json:
            arguments.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    START = time.perf_counter()
    main()

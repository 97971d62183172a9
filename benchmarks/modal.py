"""Modes of the lap plates beside CalculiX: the same nodes, the same frequencies, whole processes.

    python3 benchmarks/modal.py [--runs 3] [--json FILE]

Needs nothing but Python itself where it is started: our side runs through ``./with-fenicsx`` when
DOLFINx is not at hand, CalculiX where ``ccx`` is found. It also measures the floor under our solve,
in the same process on the same matrix: one MUMPS factorisation and the solves of Lanczos.
"""

from __future__ import annotations

import json
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from harness import across_processes, parser, python_command, run, threads, timed, write

PLATES = {"E": 69e9, "G": 26.9e9, "rho": 2750.0}
LAYER = {"E": 3.00e9, "G": 1.15e9, "rho": 0.0}  # Tian et al. 2021's initial values, in both zones
SIDES = ("ours", "slepc")
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
    model, times["mesh and structure"], _ = timed(
        lambda: Structure(make_mesh(comm, counts), regions)
    )
    modes, total, _ = timed(lambda: solve_modes(model, n_modes=n_modes))
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


def solve_slepc(counts, n_modes: int, output: Path) -> None:
    """The same modes as a script of DOLFINx and SLEPc alone finds them: shift-and-invert by MUMPS.

    All else is as SLEPc sets it: Krylov-Schur, and LU, for it does not know that the matrix is
    positive definite.
    """
    import basix.ufl
    import dolfinx.fem.petsc
    import numpy as np
    import ufl
    from dolfinx import fem
    from mpi4py import MPI
    from petsc4py import PETSc
    from slepc4py import SLEPc

    tagged = make_mesh(MPI.COMM_WORLD, counts)
    mesh, layer = tagged.mesh, tagged.cell_tags.find(tagged.cell_tag("joint_away"))
    constants = fem.functionspace(mesh, ("DG", 0))
    E, G, rho = (fem.Function(constants) for _ in range(3))
    for function, key in ((E, "E"), (G, "G"), (rho, "rho")):
        function.x.array[:] = PLATES[key]
        function.x.array[constants.dofmap.list[layer].ravel()] = LAYER[key]
    cell = mesh.topology.cell_name()
    V = fem.functionspace(mesh, basix.ufl.element("S", cell, 2, shape=(3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    lame = G * (E - 2 * G) / (3 * G - E)
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * G * strain + lame * ufl.tr(strain) * ufl.Identity(3)
    matrices, dx = [], ufl.dx(metadata={"quadrature_degree": 5})
    for form in (ufl.inner(stress, ufl.sym(ufl.grad(v))) * dx, rho * ufl.inner(u, v) * dx):
        matrices.append(dolfinx.fem.petsc.assemble_matrix(fem.form(form)))
        matrices[-1].assemble()
    eps = SLEPc.EPS().create(mesh.comm)
    eps.setOperators(*matrices)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setDimensions(n_modes)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    eps.setTarget(-((2 * np.pi * 50) ** 2))
    transform = eps.getST()
    transform.setType(SLEPc.ST.Type.SINVERT)
    transform.getKSP().setType(PETSc.KSP.Type.PREONLY)
    transform.getKSP().getPC().setType(PETSc.PC.Type.LU)
    transform.getKSP().getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    eps.setFromOptions()
    eps.solve()
    found = np.sort([eps.getEigenvalue(i).real for i in range(n_modes)])
    if mesh.comm.rank == 0:
        result = {"frequencies_hz": (np.sqrt(np.maximum(found, 0)) / (2 * np.pi)).tolist()}
        output.write_text(json.dumps(result))


def measure_floor(model, modes, repeats: int = 3) -> list[dict[str, float]]:
    """Our eigenproblem and MUMPS alone, in turn on one matrix; the ordering is kept in both.

    Seconds of ours, of a factorisation, of a single solve and of a block as wide as ours.
    """
    solver = modes.solver
    K, M = model.stiffness(), model.mass()
    rows = []
    for _ in range(repeats):
        solved, ours, _ = timed(lambda: solver.solve(K, M))
        found = solved.statistics
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
    seconds = {"factor": timed(ksp.setUp)[1]}
    for name, solve, given in (("single", ksp.solve, (right, left)), ("block", ksp.matSolve, pair)):
        seconds[name] = statistics.mean(timed(lambda: solve(*given))[1] for _ in range(repeats))  # noqa: B023
    for mat in pair:
        mat.destroy()
    return seconds


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


def run_benchmark(arguments, scratch: Path) -> dict:
    # One thread for each rank: two ranks with two threads each would fight for two cores.
    ours = threads(1 if arguments.ranks > 1 else arguments.threads)
    size = ["--elements", *arguments.elements, "--modes", arguments.modes]
    coarse = ["--elements", 10, 4, 1, "--modes", arguments.modes]

    def spent(role: str, extra, output: Path, ranks: int = arguments.ranks) -> dict:
        words = [*extra, "--as", role, "--output", output]
        command = python_command(arguments.launcher, __file__, *words, ranks=ranks)
        return run(command, scratch, ours)

    out = scratch / "ours.json"
    for role in SIDES:
        spent(role, coarse, out)  # compiles forms
    ccx = arguments.ccx or shutil.which("ccx")
    if ccx:
        spent("deck", size, scratch / "lap.inp", ranks=1)
    runs = []
    for _ in range(arguments.runs):
        row = {}
        for role in SIDES:
            row[role] = spent(role, size, out)
            row[f"{role}_detail"] = json.loads(out.read_text())
        if ccx:
            row["ccx"] = run([ccx, "-i", "lap"], scratch, threads(arguments.threads))
        runs.append(row)
        line = "   ".join(
            f"{who} {row[who]['wall']:6.1f} s wall {row[who]['cpu']:6.1f} s cpu"
            for who in (*SIDES, "ccx")
            if who in row
        )
        print(f"run {len(runs)}: {line}", flush=True)
    spent("floor", size, out)
    theirs = read_frequencies(scratch / "lap.dat") if ccx else None
    return summarise(runs, json.loads(out.read_text()), theirs)


def summarise(runs, floored, theirs) -> dict:
    detail, floors = runs[-1]["ours_detail"], floored["floor"]
    for row in floors:
        row["mumps_blocks"] = row["factor"] + row["blocks"] * row["block"]
        row["mumps_singles"] = row["factor"] + SINGLE_SOLVES * row["single"]
        row["ratio"] = row["ours"] / row["mumps_blocks"]
        row["ratio_to_singles"] = row["ours"] / row["mumps_singles"]
    report = {
        "dofs": detail["dofs"],
        "frequencies_hz": detail["frequencies_hz"],
        "residual": detail["residual"],
        "runs": [{who: run[who] for who in (*SIDES, "ccx") if who in run} for run in runs],
        "slepc": {
            "times_slower": statistics.median(
                run["slepc"]["wall"] / run["ours"]["wall"] for run in runs
            ),
            "largest_difference_percent": max(
                100 * abs(a / b - 1)
                for a, b in zip(
                    detail["frequencies_hz"],
                    runs[-1]["slepc_detail"]["frequencies_hz"],
                    strict=True,
                )
                if b > 1.0
            ),
        },
        "stages_seconds": {
            stage: statistics.median(run["ours_detail"]["seconds"][stage] for run in runs)
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
    slepc = report["slepc"]
    print(
        f"DOLFINx and SLEPc alone, whole process: {slepc['times_slower']:.2f} times our time, "
        f"frequencies within {slepc['largest_difference_percent']:.5f} %"
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
    roles = (*SIDES, "floor", "deck")  # of a child process
    made = across_processes(parser(__doc__), roles)
    made.add_argument("--runs", type=int, default=3, help="alternating pairs of runs")
    made.add_argument("--ranks", type=int, default=2, help="MPI ranks of ours")
    threads = "threads of ccx, and of ours at 1 rank"
    made.add_argument("--threads", type=int, default=2, help=threads)
    made.add_argument("--elements", type=int, nargs=3, default=(60, 24, 4), metavar="N")
    made.add_argument("--modes", type=int, default=12)
    made.add_argument("--ccx", help="path of CalculiX")
    arguments = made.parse_args()
    if arguments.role == "deck":
        write_deck(arguments.elements, arguments.modes, arguments.output)
    elif arguments.role == "slepc":
        solve_slepc(arguments.elements, arguments.modes, arguments.output)
    elif arguments.role:
        floor = arguments.role == "floor"
        solve_ours(arguments.elements, arguments.modes, floor, arguments.output)
    else:
        with tempfile.TemporaryDirectory() as scratch:
            report = run_benchmark(arguments, Path(scratch))
        show(report)
        write(arguments.json, report)


if __name__ == "__main__":
    START = time.perf_counter()
    main()

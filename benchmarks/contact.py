"""A bolted joint with contact beside CalculiX: the same nodes, the same pressures, whole processes.

    python3 benchmarks/contact.py [--runs 3] [--json FILE]      # beside CalculiX
    python3 benchmarks/contact.py --sizes [--json FILE]         # growth over six meshes

A quarter of two round plates, pressed together by the force of an M12 under washers, frictionless:
eight-node hexahedra with 2 x 2 x 2 Gauss points in both. Of CalculiX's kinds of contact the fastest
whose pressures lie within 3 % of ours counts. Needs nothing but Python itself where it is started:
our side runs through ``./with-fenicsx`` when DOLFINx is not at hand, CalculiX where ``ccx`` is.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from harness import across_processes, parser, python_command, run, threads, timed, write
from modal import CORNERS

E_MODULUS, NU, FORCE = 200e9, 0.3, 25e3
PLATES = {"thickness": (0.015, 0.015), "radius": 0.06, "quarter": True}
LIMIT = 0.03  # of the pressures' difference in L2, relative
#: Radial size, m, and cells around the circle, of six meshes.
SIZES = (
    (1.25e-3, 64),
    (0.75e-3, 96),
    (0.52e-3, 136),
    (0.37e-3, 188),
    (0.265e-3, 260),
    (0.245e-3, 280),
)
#: Peak memory of both ranks, MB, as a + b n, measured at 196,350 DOFs, where most is kept.
MEMORY = (400.0, 7.4e-3)
#: Linear pressure-overclosure, N/mm3: 1e8 throws surface to surface 26 % off on a coarse mesh.
STIFFNESS = 1e7
KINDS = {
    "surface to surface": ("SURFACE TO SURFACE", f"LINEAR\n{STIFFNESS:g}"),
    "node to surface": ("NODE TO SURFACE", f"LINEAR\n{STIFFNESS:g},1e-3"),
    "mortar": ("MORTAR", "HARD"),
}
# The six faces of C3D8, by the corners of CalculiX's order.
FACES = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 4, 5), (1, 2, 5, 6), (2, 3, 6, 7), (3, 0, 7, 4))


# -- our side, under MPI -------------------------------------------------------------------------


def make_model(comm, mesh, bonded: bool = False):
    from fenics_joints.meshes import bolted_plates
    from fenics_joints.preload import Contact, PreloadModel, WasherForce
    from fenics_joints.structure import Structure, Support, part

    tagged = bolted_plates(comm, size=mesh[0], n_around=int(mesh[1]), **PLATES)
    plates = part("plates", ("plate_1", "plate_2"), E=E_MODULUS, nu=NU, rho=7850.0)
    walls = [Support("symmetry_x", (0,)), Support("symmetry_y", (1,))]
    structure = Structure(tagged, [plates], degree=1, supports=walls)
    contact = Contact("plates", "interface_lower", "interface_upper", bonded=bonded)
    bolt = WasherForce("bolt", "washer_1", "washer_2", FORCE / 4)
    return tagged, PreloadModel(structure, [contact], [bolt])


def solve_ours(mesh, output: Path) -> None:
    """One process of our side: what a user's script does, and the stages' times."""
    import numpy as np
    from mpi4py import MPI

    from fenics_joints.preload import PreloadSolver

    comm = MPI.COMM_WORLD
    times = {"import": time.perf_counter() - START}
    (_, model), times["mesh and model"], _ = timed(lambda: make_model(comm, mesh))
    solver, times["matrix"], _ = timed(lambda: PreloadSolver(model))
    result, times["contact"], _ = timed(solver.solve)
    state = result["plates"]
    megabytes = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    order = np.lexsort(np.round(state.interface.points.T, 9))
    if comm.rank == 0:
        found = {
            "dofs": model.jumps.n,
            "pairs": len(state.interface),
            "iterations": result.iterations,
            "factorisations": solver.newton.factorisations,
            "solutions": solver.newton.solves,
            "force": state.normal_force,
            "complementarity": result.complementarity,
            "megabytes": megabytes,
            "seconds": times,
            "points": state.interface.points[order].tolist(),
            "areas": state.interface.areas[order].tolist(),
            "pressure": state.pressure[order].tolist(),
        }
        output.write_text(json.dumps(found))


def solve_bonded(mesh, output: Path) -> None:
    """Displacements of the plates glued together, in the nodes' order of the deck."""
    from mpi4py import MPI
    from petsc4py import PETSc

    from fenics_joints.preload.hold import find_hold

    tagged, model = make_model(MPI.COMM_SELF, mesh, bonded=True)
    K, load = model.stiffness(), model.load()
    pins = find_hold(model, K).pins
    K.zeroRowsColumns(pins.astype("int32"), diag=K.getDiagonal().sum() / K.getSize()[0])
    ksp = PETSc.KSP().create(MPI.COMM_SELF)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    ksp.setOperators(K)
    x = load.duplicate()
    ksp.solve(load, x)
    u = model.jumps.displacement(x).x.array.reshape(-1, 3)[_node_dofs(tagged, model.V)]
    output.write_text(json.dumps(u.tolist()))


def _node_dofs(tagged, V):
    """Blocks of the displacement at the mesh's nodes, (n,)."""
    import numpy as np

    from fenics_joints._compat import geometry_dofmap

    blocks = np.empty(len(tagged.mesh.geometry.x), dtype=np.int64)
    blocks[geometry_dofmap(tagged.mesh)] = V.dofmap.list
    return blocks


# -- CalculiX's deck, in mm, N and MPa -------------------------------------------------------------


def write_decks(mesh, folder: Path) -> None:
    """One deck for each kind of contact, and one with the plates glued."""
    import numpy as np
    from mpi4py import MPI

    from fenics_joints._compat import geometry_dofmap

    tagged, model = make_model(MPI.COMM_SELF, mesh)
    x = tagged.mesh.geometry.x
    elements = geometry_dofmap(tagged.mesh)[:, CORNERS].astype(np.int64)
    at = _node_dofs(tagged, model.V)
    # At the washers x holds displacements, so these are the consistent forces of our own load.
    loads = model.load().array_r.reshape(-1, 3)[at, 2]
    interface = model.interfaces[0]
    node_of = np.empty(len(at), dtype=np.int64)
    node_of[at] = np.arange(len(at))
    pairs = np.column_stack([node_of[interface.lower], node_of[interface.upper]])
    parts = _common(tagged, x, elements, loads)
    for kind, (method, behaviour) in KINDS.items():
        deck = folder / f"{_stem(kind)}.inp"
        deck.write_text(
            "".join(
                [
                    parts[0],
                    *_contact(elements, pairs, method, behaviour),
                    parts[1],
                    "*CONTACT FILE\nCDIS,CSTR\n*END STEP\n",
                ]
            )
        )
    tie = (
        f"*EQUATION\n2\n{b + 1},{i},1,{a + 1},{i},-1\n"
        for a, b in pairs
        for i in (1, 2, 3)
        if not _on_wall(x[a], i)
    )
    (folder / "bonded.inp").write_text("".join([parts[0], *tie, parts[1], "*END STEP\n"]))


def _on_wall(x, i: int) -> bool:
    return i < 3 and abs(x[i - 1]) < 1e-9


def _common(tagged, x, elements, loads) -> tuple[str, str]:
    """What stands in all decks before the contact, and after it."""
    import numpy as np

    lines = ["*NODE, NSET=ALL\n"]
    lines += [f"{i},{a:.12g},{b:.12g},{c:.12g}\n" for i, (a, b, c) in enumerate(1e3 * x, 1)]
    lines.append("*ELEMENT, TYPE=C3D8, ELSET=PLATES\n")
    lines += [",".join(map(str, (i, *row))) + "\n" for i, row in enumerate(elements + 1, 1)]
    lines.append(
        f"*MATERIAL, NAME=STEEL\n*ELASTIC\n{E_MODULUS / 1e6},{NU}\n"
        "*SOLID SECTION, ELSET=PLATES, MATERIAL=STEEL\n*BOUNDARY\n"
    )
    for axis in (0, 1):
        lines += [f"{n + 1},{axis + 1}\n" for n in np.flatnonzero(np.abs(x[:, axis]) < 1e-9)]
    # The loads balance one another: this holds plate 1 as a whole, without a reaction.
    held = int(np.argmin(x[:, 2] - 1e-3 * np.hypot(x[:, 0], x[:, 1])))
    lines.append(f"{held + 1},3\n")
    after = ["*STEP\n*STATIC\n1.,1.\n*CLOAD\n"]
    after += [f"{n + 1},3,{loads[n]:.14g}\n" for n in np.flatnonzero(loads)]
    after.append("*NODE FILE\nU\n")
    return "".join(lines), "".join(after)


def _contact(elements, pairs, method: str, behaviour: str) -> list[str]:
    import numpy as np

    lines = []
    for name, nodes in (("LOWER", pairs[:, 0]), ("UPPER", pairs[:, 1])):
        inside = np.isin(elements, nodes)
        lines.append(f"*SURFACE, NAME={name}, TYPE=ELEMENT\n")
        for face, corners in enumerate(FACES, 1):
            cells = np.flatnonzero(inside[:, corners].all(axis=1))
            lines += [f"{cell + 1},S{face}\n" for cell in cells]
    lines.append(
        f"*SURFACE INTERACTION, NAME=TOUCH\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE={behaviour}\n"
        f"*CONTACT PAIR, INTERACTION=TOUCH, TYPE={method}\nUPPER,LOWER\n"
    )
    return lines


def _stem(kind: str) -> str:
    return kind.replace(" ", "_")


def read_frd(path: Path, block: str, column: int | slice) -> dict[int, list[float]]:
    """Columns of the last block of this name in CalculiX's .frd file, by node."""
    found, inside = {}, False
    for line in path.read_text().splitlines():
        if line.startswith(" -4"):
            inside = line.split()[1] == block
            found = {} if inside else found
        elif inside and line.startswith(" -1"):
            values = [float(line[i : i + 12]) for i in range(13, len(line.rstrip()), 12)]
            found[int(line[3:13])] = values[column]
        elif line.startswith(" -3"):
            inside = False
    return found


def read_nodes(path: Path) -> list[tuple[float, float, float]]:
    """Positions of a deck's nodes, m."""
    nodes = []
    for line in path.read_text().splitlines()[1:]:
        if line.startswith("*"):
            return nodes
        nodes.append(tuple(1e-3 * float(word) for word in line.split(",")[1:]))
    return nodes


# -- the comparison ------------------------------------------------------------------------------


def compare(ours: dict, folder: Path, kind: str) -> dict:
    """Pressures of one of CalculiX's kinds beside ours, at the same nodes."""
    path = folder / f"{_stem(kind)}.frd"
    pressures = read_frd(path, "CONTACT", 3)
    nodes = read_nodes(path.with_suffix(".inp"))
    theirs = {}
    for number, value in pressures.items():
        x, y, z = nodes[number - 1]
        if abs(z) < 1e-9:  # the slave's nodes alone carry pressures; the master's are zero
            key = round(x, 7), round(y, 7)
            theirs[key] = max(theirs.get(key, 0.0), 1e6 * value)
    difference = size = force = 0.0
    for (x, y, _), area, p in zip(ours["points"], ours["areas"], ours["pressure"], strict=True):
        q = theirs.get((round(x, 7), round(y, 7)), 0.0)
        difference, size = difference + area * (p - q) ** 2, size + area * p**2
        force += area * q
    return {"difference": (difference / size) ** 0.5, "force": force}


def iterations(log: Path) -> int:
    """CalculiX's iterations, from the lines of its .cvg file."""
    return sum(1 for line in log.read_text().splitlines() if line.split()[:1] == ["1"])


def ours(arguments, role: str, mesh, output: Path, ranks: int) -> dict[str, float]:
    """Run a role of our side with two threads in all; its seconds."""
    words = ["--mesh", *mesh, "--as", role, "--output", output]
    command = python_command(arguments.launcher, __file__, *words, ranks=ranks)
    scratch = output if output.is_dir() else output.parent
    return run(command, scratch, threads(1 if ranks > 1 else 2))


def theirs(arguments, deck: str, scratch: Path) -> dict[str, float]:
    """Run CalculiX on a deck; its seconds."""
    return run([arguments.ccx, "-i", deck], scratch, {"OMP_NUM_THREADS": "2"})


def run_beside(arguments, scratch: Path) -> dict:
    out, mesh = scratch / "ours.json", arguments.mesh
    ours(arguments, "ours", (4e-3, 16), out, 1)  # compiles forms
    kinds, bonded = [], None
    if arguments.ccx:
        ours(arguments, "deck", mesh, scratch, 1)
        bonded = compare_bonded(arguments, mesh, scratch)
        kinds = [kind for kind in KINDS if kind in (arguments.kinds or KINDS)]
    runs = []
    for number in range(arguments.runs):
        rows = {}
        for ranks in (2, 1):
            rows[f"ours, {ranks} ranks"] = ours(arguments, "ours", mesh, out, ranks)
            rows[f"detail {ranks}"] = json.loads(out.read_text())
        for kind in kinds:
            rows[kind] = theirs(arguments, _stem(kind), scratch)
            rows[kind] |= compare(rows["detail 2"], scratch, kind)
            rows[kind]["iterations"] = iterations(scratch / f"{_stem(kind)}.cvg")
        if number == 0:  # what is not within the limit need not be repeated
            kinds = [kind for kind in kinds if rows[kind]["difference"] <= LIMIT]
        runs.append(rows)
        for who, row in rows.items():
            if "wall" in row:
                print(
                    f"run {number + 1}: {who:20s}{row['wall']:8.1f} s wall{row['cpu']:8.1f} s cpu"
                    + (
                        f"   pressures {100 * row['difference']:.2f} % off, {row['iterations']} "
                        "iterations"
                        if "difference" in row
                        else ""
                    ),
                    flush=True,
                )
    return summarise(runs, kinds, bonded)


def compare_bonded(arguments, mesh, scratch: Path) -> float:
    """Largest difference of the glued plates' displacements, less their rigid shift, relative."""
    ours(arguments, "bonded", mesh, scratch / "bonded.json", 1)
    theirs(arguments, "bonded", scratch)
    mine = json.loads((scratch / "bonded.json").read_text())
    read = read_frd(scratch / "bonded.frd", "DISP", slice(0, 3))
    other = [[1e-3 * value for value in read[i + 1]] for i in range(len(mine))]
    worst = largest = 0.0
    for i in range(3):
        # Along the axis each side is held elsewhere.
        shift = statistics.mean(a[i] - b[i] for a, b in zip(mine, other, strict=True))
        shift = shift if i == 2 else 0.0
        worst = max(worst, *(abs(a[i] - b[i] - shift) for a, b in zip(mine, other, strict=True)))
        largest = max(largest, *(abs(b[i]) for b in other))
    return worst / largest


def summarise(runs, kinds, bonded) -> dict:
    sides = ["ours, 2 ranks", "ours, 1 ranks", *kinds]
    wall = {side: statistics.median(run[side]["wall"] for run in runs) for side in sides}
    mine = min(sides[:2], key=wall.get)
    detail = runs[-1]["detail " + mine.split()[1]]
    detail = {k: v for k, v in detail.items() if k not in ("points", "areas", "pressure")}
    report = {"detail": detail, "wall": wall, "ours": mine, "bonded_difference": bonded}
    report["runs"] = [{k: v for k, v in run.items() if "detail" not in k} for run in runs]
    if kinds:
        report["ccx"] = best = min(kinds, key=wall.get)
        for key in ("wall", "cpu"):
            ratios = [run[best][key] / run[mine][key] for run in runs]
            report[f"times_faster_{key}"] = statistics.median(ratios)
    return report


def show(report: dict) -> None:
    detail = report["detail"]
    print(
        f"\n{detail['dofs']:,} DOFs, {detail['pairs']:,} pairs; ours ({report['ours']}): "
        f"{detail['iterations']} iterations, {detail['factorisations']} preconditioners made, "
        f"{detail['megabytes']:.0f} MB, complementarity {detail['complementarity']:.1e}"
    )
    print("stages of ours, s: " + ", ".join(f"{k} {v:.2f}" for k, v in detail["seconds"].items()))
    if report["bonded_difference"] is not None:
        print(
            f"glued plates, largest difference of displacements: {report['bonded_difference']:.1e}"
        )
    if "ccx" in report:
        print(
            f"whole process, median of {len(report['runs'])}: {report['times_faster_wall']:.2f} "
            f"times faster than ccx, {report['ccx']} (processor time: "
            f"{report['times_faster_cpu']:.2f} times less)"
        )
    elif report["bonded_difference"] is not None:
        print(f"none of ccx's kinds of contact came within {100 * LIMIT:g} % of our pressures")
    else:
        print("ccx was not found (apt install calculix-ccx, or --ccx PATH): no comparison made")


def run_sizes(arguments, scratch: Path) -> dict:
    rows, out = [], scratch / "ours.json"
    print("     DOFs   pairs  iterations preconditioners  solutions   wall, s    cpu, s       MB")
    for mesh in ((4e-3, 16), *SIZES):
        ours(arguments, "count", mesh, scratch / "count.json", 1)
        dofs = json.loads((scratch / "count.json").read_text())
        need, there = MEMORY[0] + MEMORY[1] * dofs, available_megabytes()
        if need > there:
            print(f"{dofs:9,}  skipped: about {need:.0f} MB needed, {there:.0f} MB available")
            continue
        row = ours(arguments, "ours", mesh, out, 2)
        if mesh not in SIZES:
            continue  # compiled the forms
        row |= {
            k: v
            for k, v in json.loads(out.read_text()).items()
            if k not in ("points", "areas", "pressure")
        }
        rows.append(row)
        print(
            f"{row['dofs']:9,}{row['pairs']:8,}{row['iterations']:12d}"
            f"{row['factorisations']:16d}{row['solutions']:11d}{row['wall']:10.1f}"
            f"{row['cpu']:10.1f}{row['megabytes']:9.0f}",
            flush=True,
        )
    return {"sizes": rows}


def write_count(mesh, output: Path) -> None:
    from mpi4py import MPI

    from fenics_joints.meshes import bolted_plates

    tagged = bolted_plates(MPI.COMM_SELF, size=mesh[0], n_around=int(mesh[1]), **PLATES)
    output.write_text(str(3 * len(tagged.mesh.geometry.x)))


def available_megabytes() -> float:
    lines = Path("/proc/meminfo").read_text().splitlines()
    return next(float(line.split()[1]) / 1024 for line in lines if line.startswith("MemAvailable"))


def main() -> None:
    roles = {"ours": solve_ours, "bonded": solve_bonded, "deck": write_decks, "count": write_count}
    made = across_processes(parser(__doc__), roles)
    made.add_argument("--runs", type=int, default=3, help="alternating runs")
    made.add_argument("--sizes", action="store_true", help="growth over six meshes instead")
    help_mesh = "radial size, m, and cells around the circle"
    made.add_argument(
        "--mesh", type=float, nargs=2, default=SIZES[1], metavar=("SIZE", "N"), help=help_mesh
    )
    made.add_argument("--kinds", nargs="*", choices=KINDS, help="CalculiX's kinds of contact")
    made.add_argument("--ccx", default=shutil.which("ccx"), help="path of CalculiX")
    arguments = made.parse_args()
    if arguments.role:
        roles[arguments.role](arguments.mesh, arguments.output)
        return
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    with tempfile.TemporaryDirectory() as scratch:
        report = (run_sizes if arguments.sizes else run_beside)(arguments, Path(scratch))
    if not arguments.sizes:
        show(report)
    write(arguments.json, report)


if __name__ == "__main__":
    START = time.perf_counter()
    main()

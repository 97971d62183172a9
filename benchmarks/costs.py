"""What a mechanism costs over what it stands beside, in one process.

    ./with-fenicsx env OMP_NUM_THREADS=1 python3 benchmarks/costs.py [PART ...] [--json FILE]

assembly: K(p) and M(p) of the lap plates with every parameter of `diagnose`, at values drawn about
the nominal ones, as sums of kept matrices over their assembly.
gradient: of all eigenvalues by all of these parameters, over one modal solution; and with each
cell's modulus as a parameter of its own, which is what one assembly for each mode gives anyway.
patches: of the eigenvalues of 20 elastic modes by the moduli of 1,000 patches of a plate, and of
their shapes at 20 sensors, each over one modal solution.
stability: `find_bifurcations` over the branch about the first resonance, of chains of 1 to 12
masses, each on a cubic spring or a slider to the ground, pushed at the first; processor time.
"""

from __future__ import annotations

import resource
import statistics

import numpy as np
from harness import ROOT, parser, timed, write
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.diagnosis.zones.zone import bonded_values
from fenics_joints.harmonic import find_bifurcations, solve_harmonic
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import CubicSpring, ElasticFriction
from fenics_joints.meshes import box, in_patches
from fenics_joints.modal import solve_modes
from fenics_joints.response import shape_gradients
from fenics_joints.structure import Parameter, Sensors, Structure, part

#: Calls after which all matrices that are varied here are summed.
WARM = 16
TURN = 2 * np.pi


def lap_plates(element_size: float):
    case = load_case(ROOT / "demos" / "lap_plates")
    mesh = case.mesh.model_copy(update={"element_size": element_size})
    return case.model_copy(update={"mesh": mesh})


def assembly(args) -> dict:
    case, rng = lap_plates(args.element_size), np.random.default_rng(1)

    def made():
        return build_structure(case, MPI.COMM_WORLD, law="uncoupled", width=True)

    def spent(full) -> float:
        moved = {
            name: p.value * (1 + 0.02 * rng.standard_normal())
            for name, p in full.parameters.items()
            if p.value and not name.endswith(".nu")
        }
        full.comm.barrier()
        (K, M), seconds, _ = timed(lambda: (full.stiffness(moved), full.mass(moved)))
        K.destroy(), M.destroy()
        return seconds

    kept = made()
    first = sum(spent(kept) for _ in range(WARM))
    spent(made())  # compiles the forms
    whole, summed = zip(*((spent(made()), spent(kept)) for _ in range(args.runs)), strict=True)
    return {
        "DOFs": kept.n_dofs,
        "parameters": len(kept.parameters),
        "assembled, s": statistics.median(whole),
        "summed, s": statistics.median(summed),
        "ratio (median of pairs)": statistics.median(np.divide(summed, whole)),
        "the first calls, with the samples made": first / WARM / statistics.median(whole),
    }


def gradient(args) -> dict:
    case = lap_plates(args.element_size)
    full = build_structure(case, MPI.COMM_WORLD, law="uncoupled", attached=True)
    given = {k: v for k, v in bonded_values(case).items() if k in full.parameters}
    given |= {"bolts_and_nuts.mass": 0.16, "accelerometer.mass": 0.02}
    modes = solve_modes(full, given, n_modes=args.modes)
    elastic = np.arange(modes.n_rigid, args.modes)
    modes.gradients(elastic)  # compiles the form
    rows = []
    for _ in range(args.runs):
        modes, solve, _ = timed(
            lambda s=modes.solver: solve_modes(full, given, n_modes=args.modes, solver=s)
        )
        _, every, _ = timed(lambda m=modes: m.gradients(elastic))
        vector, value = modes.vector(elastic[0]), modes.eigenvalues[elastic[0]]
        _, one, _ = timed(lambda v=vector, e=value: full.cell_gradient(v, e, given))
        rows.append((solve, every, one, every / solve))
    solve, every, one, ratio = np.median(rows, axis=0).tolist()
    return {
        "DOFs": full.n_dofs,
        "modal solution, s": solve,
        f"gradient of {len(elastic)} modes by {len(full.parameters)} parameters, s": every,
        "gradient of one mode by properties of cells, s": one,
        "ratio gradient / solution (median of pairs)": ratio,
    }


def patched_plate(comm, counts, patches: int) -> Structure:
    """A free plate of 1 x 0.625 m, 20 mm thick, with a modulus for each patch.

    Args:
        comm: Communicator.
        counts: Cells along its sides and through it.
        patches: Patches along its long side, a multiple of 8; along the other 5/8 of them.
    """
    lengths, across = np.array([1.0, 0.625]), np.array([patches, 5 * patches // 8])

    def label(x):
        return np.floor(x[:, :2] / lengths * across).astype(int) @ [1, patches]

    mesh, names = in_patches(box(comm, (*lengths, 0.02), counts), "body", label)
    parts = [part(name, name, E=f"{name}.E", nu=0.33, rho=2700.0) for name in names]
    return Structure(mesh, parts, [Parameter(f"{name}.E", 70e9, "Pa") for name in names])


def plate_sensors(count: int = 20) -> Sensors:
    """Sensors across the plate at random places on it."""
    rng = np.random.default_rng(3)
    places = rng.random((count, 2)) * [1.0, 0.625]
    return Sensors(np.column_stack([places, np.full(count, 0.02)]), [0.0, 0.0, 1.0])


def patches(args) -> dict:
    full, made, _ = timed(lambda: patched_plate(MPI.COMM_WORLD, args.cells, args.patches))
    sensors = plate_sensors()
    solve = solve_modes(full, n_modes=26)
    elastic, rows = np.arange(solve.n_rigid, 26), []
    solve.gradients(elastic), shape_gradients(solve, elastic[:1], sensors)  # compiles the forms
    for _ in range(args.runs):
        found, alone, _ = timed(lambda s=solve.solver: solve_modes(full, n_modes=26, solver=s))
        _, values, _ = timed(lambda m=found: m.gradients(elastic))
        _, shapes, _ = timed(lambda m=found: shape_gradients(m, elastic, sensors))
        rows.append((alone, values, shapes, values / alone, shapes / alone))
    alone, values, shapes, ratio, of_shapes = np.median(rows, axis=0).tolist()
    return {
        "DOFs": full.n_dofs,
        "parameters": len(full.parameters),
        "structure, s": made,
        "modal solution, s": alone,
        "eigenvalues, s": values,
        "shapes, s": shapes,
        "ratio of eigenvalues (median of pairs)": ratio,
        "ratio of shapes (median of pairs)": of_shapes,
        "peak memory, GiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def chain(n: int, law) -> InterfaceModel:
    """Masses of 1 between springs of 1 and the ground at both ends, a law at each."""
    axes, K = np.eye(n), 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    joint = InterfacePoints("joints", law, axes[:, None, :], np.ones(n))
    return InterfaceModel(axes, K, (joint,), 0.02 * K, {"push": axes[0]}, {"first": axes[0]})


def stability(args) -> dict:
    rows = {}
    for law, push in ((CubicSpring(0.0, 1.0), 0.05), (ElasticFriction(1.0, 0.05), 0.1)):
        for n in (1, 4, 12):
            model = chain(n, law)
            low = np.sqrt(np.linalg.eigvalsh(model.K)[0]) / TURN
            solve = lambda m=model, f=low, p=push: solve_harmonic(m, "push", p, (0.7 * f, 1.6 * f))  # noqa: E731
            solve()  # compiles
            result, _, branch = timed(solve)
            found, _, spent = timed(lambda r=result: find_bifurcations(r))
            rows[f"{law.name}, {n} masses"] = {
                "responses": len(result),
                "branch_s": branch,
                "stability_s": spent,
                "ratio": spent / branch,
                "bifurcations": [b.kind for b in found.bifurcations],
            }
    return rows


def main() -> None:
    parts = {"assembly": assembly, "gradient": gradient, "patches": patches, "stability": stability}
    made = parser(__doc__, parts)
    made.add_argument("--element-size", type=float, default=5e-3, help="of the plates, metres")
    made.add_argument("--runs", type=int, default=10, help="pairs of the plates")
    made.add_argument("--modes", type=int, default=12, help="of the plates")
    made.add_argument(
        "--cells", type=int, nargs=3, default=(80, 50, 1), help="of the patched plate"
    )
    made.add_argument("--patches", type=int, default=40, help="along its long side")
    args = made.parse_args()
    found = {name: parts[name](args) for name in args.parts or parts}
    if MPI.COMM_WORLD.rank == 0:
        for name, rows in found.items():
            print(name, *(f"    {key}: {value}" for key, value in rows.items()), sep="\n")
        write(args.json, found)


if __name__ == "__main__":
    main()

"""Cost of the gradient of all eigenvalues by all parameters, against one modal solution.

Both in one process on the same model: the lap plates with every parameter of `diagnose` (materials,
thickness, joint zones, attached masses and springs), and once more with each cell's modulus as a
parameter of its own, which is what one assembly per mode gives anyway.

    ./with-fenicsx python3 benchmarks/gradient.py [--element-size 5e-3] [--runs 5]
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.diagnosis.zones.zone import bonded_values
from fenics_joints.modal import solve_modes

CASE = Path(__file__).parent.parent / "demos" / "lap_plates"


def measure(element_size: float, runs: int, n_modes: int) -> None:
    case = load_case(CASE)
    mesh = case.mesh.model_copy(update={"element_size": element_size})
    full = build_structure(
        load_case(CASE).model_copy(update={"mesh": mesh}),
        MPI.COMM_WORLD,
        law="uncoupled",
        attached=True,
    )
    given = bonded_values(case) | {"bolts_and_nuts.mass": 0.16, "accelerometer.mass": 0.02}
    modes = solve_modes(full, given, n_modes=n_modes)
    elastic = np.arange(modes.n_rigid, n_modes)
    modes.gradients(elastic)  # compiles the form
    solve, every, one = [], [], []
    for _ in range(runs):
        begin = time.perf_counter()
        modes = solve_modes(full, given, n_modes=n_modes, solver=modes.solver)
        solve.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        modes.gradients(elastic)
        every.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        full.cell_gradient(modes.vector(elastic[0]), modes.eigenvalues[elastic[0]], given)
        one.append(time.perf_counter() - begin)
    if MPI.COMM_WORLD.rank == 0:
        ratio = statistics.median(e / s for e, s in zip(every, solve, strict=True))
        cells = full.mesh.topology.index_map(full.mesh.topology.dim).size_global
        rows = {
            "modal solution (assembly, factorisation, Lanczos), s": statistics.median(solve),
            f"gradient of {len(elastic)} modes by all parameters, s": statistics.median(every),
            f"gradient of one mode by {4 * cells} cell properties, s": statistics.median(one),
            "ratio gradient / solution (median of pairs)": ratio,
        }
        print(f"{full.n_dofs} DOFs, {n_modes} modes, {len(full.parameters)} parameters")
        for name, value in rows.items():
            print(f"{name:55s} {value:8.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--element-size", type=float, default=5e-3, help="metres")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--modes", type=int, default=12)
    args = parser.parse_args()
    measure(args.element_size, args.runs, args.modes)


if __name__ == "__main__":
    main()

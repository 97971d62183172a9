"""Updating on frequencies and FRFs: basins of convergence, noise, and the cost of an iteration.

    ./with-fenicsx env OMP_NUM_THREADS=1 python3 benchmarks/updating.py [PART ...] [--json FILE]

All by default, on one core. The structure is Machines 2022's of section 4.2, dumbbells with a
sandwich of E = 10 GPa, nu = 0.24, h = 10 mm (Table 6), all of 7850 kg/m3. The paper's Figure 9 is
lost: the blocks' thickness is a reconstruction, and force, responses and lines are ours. The test
is a mesh with the true layer, and its FRFs a direct solution; the model is a mesh with the start's
layer, 20 mm, reduced for basin and noise.

basin: random starts, log-uniform over E x/: 10 and h x/: 5, nu uniform in 0.05 to 0.45: how many
come to within 0.5 % of all three, by either method, with all data and with frequencies alone.
noise: 0.1 % on frequencies and 2 % on FRFs: whether the stated covariance holds, and what Machines
2022's weights make of the same noise.
cost: one iteration of the full model, all sensitivities of 6 modes and 50 lines, over its modal
solution alone with the same solver.
many: one iteration, steps of the trust region included, of the moduli of 1,000 patches of a plate
on frequencies and shapes (20 sensors) of 20 modes, over its modal solution alone; on any number of
ranks.
"""

from __future__ import annotations

import resource
import statistics
import time
from collections import Counter
from collections.abc import Callable
from functools import cached_property

import numpy as np
from costs import patched_plate, plate_sensors
from harness import parser, timed, write
from mpi4py import MPI
from scipy.stats import chi2, qmc

from fenics_joints.errors import JointsError
from fenics_joints.measurements import FRFTarget, Target
from fenics_joints.meshes import dumbbell
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import frf_basis, frf_error
from fenics_joints.response import solve_frf
from fenics_joints.structure import Damping, Parameter, Sensors, Structure, part, transition
from fenics_joints.updating import Predictor, update, update_weighted
from fenics_joints.updating.coordinates import Coordinates
from fenics_joints.updating.target_fit import TargetFit

BODY = {"E": 1.3e11, "nu": 0.27, "rho": 7850.0}
TRUE = {"E": 1e10, "nu": 0.24, "h": 0.01}
START = {"E": 3.5e10, "nu": 0.27, "h": 0.02}
WANTED = np.array(list(TRUE.values()))
JOINT = [
    Parameter("E", 1e10, "Pa", 1e7, 1e13),
    Parameter("nu", 0.24, "", 0.01, 0.49),
    Parameter("h", 0.01, "m", 1e-4, 0.2),
]
DAMPING = Damping(structural=0.01)
LINES = np.linspace(300.0, 3000.0, 50)
F_SD, H_SD, GOOD = 1e-3, 0.02, 5e-3


def structure(h0: float, element_size: float) -> Structure:
    """The dumbbells with a layer h0 thick in the mesh."""
    layer = transition("layer", "joint", E="E", nu="nu", h="h", meshed=h0, rho=BODY["rho"])
    bodies = part("bodies", ("head_1", "neck_1", "neck_2", "head_2"), **BODY)
    tagged = dumbbell(MPI.COMM_SELF, layer=h0, element_size=element_size)
    return Structure(tagged, [bodies, layer], JOINT)


def places(h0: float) -> tuple[Sensors, Sensors, Sensors]:
    """Force, responses, and three directions at the heads' corners; those above move with h0."""
    top = 0.13 + h0
    points = np.array([[0.12, 0.09, -0.13], [-0.05, 0.02, top], [0.12, -0.09, top]])
    ways = np.array([[0.3, 0.5, 1.0], [0.4, 1.0, 0.3], [1.0, 0.5, 0.2]])
    corners = [(x, y, z) for z in (-0.13, top) for x in (-0.12, 0.12) for y in (-0.09, 0.09)]
    everywhere = Sensors(np.repeat(corners, 3, axis=0), np.tile(np.eye(3), (8, 1)))
    return Sensors(points[:1], ways[:1]), Sensors(points, ways), everywhere


def random_values(u: np.ndarray) -> dict[str, float]:
    """A point of the starts' range from three numbers between 0 and 1."""
    return {
        "E": TRUE["E"] * 100 ** (u[0] - 0.5),
        "nu": 0.05 + 0.4 * u[1],
        "h": TRUE["h"] * 25 ** (u[2] - 0.5),
    }


class World:
    """The test, and the model that is fitted to it."""

    def __init__(self, element_size: float):
        self.full = structure(START["h"], element_size)
        self.places = places(START["h"])
        true, (excitation, sensors, corners) = structure(TRUE["h"], element_size), places(TRUE["h"])
        modes = solve_modes(true, n_modes=14, tolerance=1e-10)
        self.f, self.shapes = modes.frequencies_hz[6:12], modes.at(corners)[:, 6:12]
        common = {"frequencies_hz": LINES, "damping": DAMPING}
        self.H = solve_frf(true, excitation=excitation, sensors=sensors, **common).values

    def target(self, rng=None) -> Target:
        """The data, with noise from ``rng``."""
        f, H = self.f, self.H
        if rng is not None:
            f = f * np.exp(F_SD * rng.standard_normal(f.shape))
            noise = rng.standard_normal((2, *H.shape))
            H = H * (1 + H_SD * (noise[0] + 1j * noise[1]))
        excitation, sensors, corners = self.places
        frfs = FRFTarget(LINES, H, sensors, excitation, relative_sd=H_SD)
        return Target(f, F_SD, self.shapes, corners, frfs=frfs)

    @cached_property
    def reduced(self):
        """The model on a basis from eight points of the starts' range."""
        excitation, sensors, corners = self.places
        samples = [random_values(u) for u in qmc.Sobol(3, seed=1).random(8)]
        common = {
            "frequencies_hz": LINES,
            "excitation": excitation,
            "sensors": sensors,
            "damping": DAMPING,
        }
        model = frf_basis(self.full, samples, n_modes=24, tolerance=1e-8, **common)
        error = frf_error(model, self.full, [TRUE], lines=None, **common)
        print(
            f"{self.full.n_dofs} DOFs, {model.n_dofs} reduced; FRF error at the true values: "
            f"median {np.median(error.relative):.1e}, largest {error.worst:.1e}"
        )
        return model.arrays(excitation, sensors, corners)


# -- basin -----------------------------------------------------------------------------------------


def methods(world: World) -> dict[str, Callable]:
    """Each a function of the start."""
    model, both = world.reduced, world.target()
    only = both.only("frequencies")

    def log(data, moves="first"):
        return lambda start: update(
            model, JOINT, data, start, damping=DAMPING, moves=moves, strict=False
        )

    def paper(data, rows="parts", limit=None):
        return lambda start: update_weighted(
            model,
            JOINT,
            data,
            start,
            damping=DAMPING,
            complex_rows=rows,
            step_limit=limit,
            strict=False,
        )

    return {
        "log, lines moved first": log(both),
        "log, lines never moved": log(both, "never"),
        "log, frequencies alone": log(only),
        "Machines 2022, Re and Im": paper(both),
        "Machines 2022, magnitude": paper(both, "magnitude"),
        "Machines 2022, frequencies alone": paper(only),
        "Machines 2022, Re and Im, step limit 0.3": paper(both, limit=0.3),
        "Machines 2022, magnitude, step limit 0.3": paper(both, "magnitude", 0.3),
        "Machines 2022, frequencies alone, step limit 0.3": paper(only, limit=0.3),
    }


def outcome(found) -> str:
    """Where a fit ended."""
    if np.abs(found.values / WANTED - 1).max() <= GOOD:
        return "found"
    if found.converged:
        return "elsewhere"
    return "diverged" if found.message.startswith("diverged") else "stalled"


def basin(world: World, args) -> dict:
    rng = np.random.default_rng(2023)
    starts = [random_values(rng.random(3)) for _ in range(args.starts)]
    result = {}
    print(f"\n{args.starts} random starts; 'elsewhere': converged, but not to within 0.5 %")
    print(f"{'':45s} found elsewhere diverged stalled evaluations Table 6's start")
    for name, fit in methods(world).items():
        ends, evaluations, begin = Counter(), [], time.perf_counter()
        for start in starts:
            try:
                found = fit(start)
            except JointsError:
                ends["diverged"] += 1
                continue
            ends[outcome(found)] += 1
            if outcome(found) == "found":
                evaluations.append(found.evaluations)
        seconds, first = time.perf_counter() - begin, outcome(fit(START))
        median = statistics.median(evaluations) if evaluations else float("nan")
        row = [ends[key] for key in ("found", "elsewhere", "diverged", "stalled")]
        print(f"{name:45s} {row[0]:5d} {row[1]:9d} {row[2]:8d} {row[3]:7d} {median:11g} {first}")
        result[name] = dict(ends) | {
            "median_evaluations": median,
            "seconds": seconds,
            "from_table_6": first,
        }
    return result


# -- noise -----------------------------------------------------------------------------------------


def calibration(fits) -> dict:
    """Whether (x - x_true)^T C^-1 (x - x_true) is chi-squared, and how many are within 1, 2 sd."""
    off = np.array([f.values - WANTED for f in fits])
    squares = sum(d @ np.linalg.solve(f.covariance, d) for d, f in zip(off, fits, strict=True))
    ratio = np.abs(off) / [f.sd for f in fits]
    return {
        "draws": len(fits),
        "chi2": float(squares),
        "expected": 3 * len(fits),
        "p": float(chi2.cdf(squares, 3 * len(fits))),
        "within_1_sd": (ratio < 1).mean(axis=0).tolist(),
        "within_2_sd": (ratio < 2).mean(axis=0).tolist(),
        "scatter": np.sqrt(np.mean(np.square(off / WANTED), axis=0)).tolist(),
        "stated": np.median([f.sd / WANTED for f in fits], axis=0).tolist(),
    }


def noise(world: World, args) -> dict:
    data = [world.target(np.random.default_rng(i)) for i in range(args.draws)]
    result = {}

    def fit(name, target_of, **more):
        result[name] = calibration(
            [
                update(world.reduced, JOINT, target_of(t), START, damping=DAMPING, **more)
                for t in data
            ]
        )

    fit("log, lines moved first", lambda t: t)
    fit("log, lines always moved", lambda t: t, moves="always")
    fit("log, frequencies alone", lambda t: t.only("frequencies"))
    for rows in ("parts", "magnitude"):
        name = f"Machines 2022, {rows}, step limit 0.3"
        # Eq. 14 with tolerances of five standard deviations, from Table 6's start.
        fits = [
            update_weighted(
                world.reduced,
                JOINT,
                target,
                START,
                damping=DAMPING,
                complex_rows=rows,
                step_limit=0.3,
                eps_1=5 * F_SD,
                eps_2=5 * H_SD,
                strict=False,
            )
            for target in data
        ]
        there = update_weighted(
            world.reduced,
            JOINT,
            world.target(),
            TRUE,
            damping=DAMPING,
            complex_rows=rows,
            max_iterations=0,
            strict=False,
        )
        done = [f for f in fits if f.converged]
        result[name] = calibration(done) if done else {"draws": 0}
        result[name]["at_the_true_values"] = there.relative_sd.tolist()
    print(f"\n{args.draws} draws of noise; errors and deviations of E, nu, h in per cent")
    for name, row in result.items():
        print(f"{name}: {row['draws']} fits converged")
        if row["draws"]:
            print(
                f"    chi-squared {row['chi2']:.0f}, expected {row['expected']} (p {row['p']:.2f})"
            )
            for key in ("within_1_sd", "within_2_sd", "scatter", "stated"):
                print(f"    {key:12s} {_percent(row[key])}")
        if "at_the_true_values" in row:
            print(f"    deviations at the true values {_percent(row['at_the_true_values'])}")
    return result


def _percent(numbers) -> str:
    return ", ".join(f"{100 * x:.3g}" for x in numbers)


# -- cost ------------------------------------------------------------------------------------------


def cost(_, args) -> dict:
    model, (excitation, sensors, corners) = structure(START["h"], args.cost_size), places(0.02)
    modes = solve_modes(model, TRUE, n_modes=16)
    H = np.ones((len(LINES), len(sensors), len(excitation)), dtype=complex)
    target = Target(
        modes.frequencies_hz[6:12],
        F_SD,
        modes.at(corners)[:, 6:12],
        corners,
        frfs=FRFTarget(LINES, H, sensors, excitation),
    )
    predict = Predictor(model, target, list(TRUE), damping=DAMPING)
    solver, rows = None, []
    for run in range(args.runs + 1):
        values = {n: v * (1 + 0.01 * run) for n, v in TRUE.items()}
        found, alone, _ = timed(
            lambda v=values, s=solver: solve_modes(model, v, n_modes=predict.n_modes, solver=s)
        )
        solver = found.solver
        fixed, moved = (timed(lambda v=values, m=m: predict(v, m))[1] for m in (False, True))
        rows.append((alone, fixed / alone, moved / alone))
    alone, fixed, moved = np.median(rows[1:], axis=0).tolist()  # the first compiles the forms
    result = {
        "dofs": model.n_dofs,
        "modes": predict.n_modes,
        "lines": len(LINES),
        "modal_solution_s": alone,
        "ratio": fixed,
        "ratio_moved": moved,
    }
    print(
        f"\n{model.n_dofs} DOFs, {predict.n_modes} modes: {result['modal_solution_s']:.2f} s; an "
        f"iteration with sensitivities of 6 of them and {len(LINES)} x {len(sensors)} FRF values "
        f"by 3 parameters: {result['ratio']:.2f} times that, {result['ratio_moved']:.2f} with "
        "lines moved (medians of pairs; asked: 3)"
    )
    return result


# -- many ------------------------------------------------------------------------------------------


def iterations(model: Structure, count: int) -> tuple[float, float, list[float]]:
    """Seconds of a modal solution whose ordering is known, and of an iteration from one accepted
    step to the next, medians of ``count``; the misfits."""
    sensors, names = plate_sensors(), list(model.parameters)
    nominal = np.array([p.value for p in model.parameters.values()])
    scatter = np.exp(0.1 * np.random.default_rng(4).standard_normal(len(names)))
    modes = solve_modes(model, dict(zip(names, nominal * scatter, strict=True)), n_modes=26)
    elastic = slice(modes.n_rigid, 26)
    hertz, shapes = modes.frequencies_hz[elastic], modes.at(sensors)[:, elastic]
    alone = [
        timed(lambda: solve_modes(model, n_modes=26, solver=modes.solver))[1] for _ in range(count)
    ]
    modes.solver.destroy()
    predict = Predictor(model, Target(hertz, F_SD, shapes, sensors, 0.01), names, n_modes=26)
    start = dict(zip(names, nominal.tolist(), strict=True))
    coordinates = Coordinates(list(model.parameters.values()), start, model)
    first, steps = coordinates.inverse(nominal), []
    fit = TargetFit([predict], coordinates, lambda x: ((x - first) / 0.1, np.eye(len(x)) / 0.1))
    fit.on_step = lambda x, moved: steps.append((time.perf_counter(), fit.misfit(x)))
    fit.solve(first, count + 1)
    times, misfits = zip(*steps, strict=True)
    return statistics.median(alone), statistics.median(np.diff(times).tolist()), list(misfits)


def many(_, args) -> dict:
    """The test is the plate itself with moduli that scatter by 10 %."""
    iterations(patched_plate(MPI.COMM_WORLD, (16, 10, 1), 8), 2)  # compiles the forms
    model = patched_plate(MPI.COMM_WORLD, args.cells, args.patches)
    alone, spent, misfits = iterations(model, args.runs)
    result = {
        "dofs": model.n_dofs,
        "parameters": len(model.parameters),
        "modal_solution_s": alone,
        "iteration_s": spent,
        "ratio": spent / alone,
        "misfits": misfits,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }
    if MPI.COMM_WORLD.rank == 0:
        print("many:", *(f"    {k}: {v}" for k, v in result.items()), sep="\n")
    return result


def main() -> None:
    parts = {"basin": basin, "noise": noise, "cost": cost, "many": many}
    made = parser(__doc__, parts)
    made.add_argument("--starts", type=int, default=100)
    made.add_argument("--draws", type=int, default=50)
    made.add_argument("--runs", type=int, default=5)
    made.add_argument("--element-size", type=float, default=0.045, help="metres")
    made.add_argument("--cost-size", type=float, default=0.02, help="metres, of cost")
    made.add_argument("--cells", type=int, nargs=3, default=(80, 50, 1), help="of many")
    made.add_argument("--patches", type=int, default=40, help="of many, along the long side")
    args = made.parse_args()
    wanted = args.parts or list(parts)
    world = World(args.element_size) if {"basin", "noise"} & set(wanted) else None
    found = {name: parts[name](world, args) for name in wanted}
    if MPI.COMM_WORLD.rank == 0:
        write(args.json, found)


if __name__ == "__main__":
    main()

"""Harmonic balance: beside time integration, beside pyHarm, and its growth with the model's size.

    ./with-fenicsx env OMP_NUM_THREADS=1 python3 benchmarks/harmonic.py [transient] [peer] [growth]

All three by default, on one core.

transient: the lap beam of the demo with the law of its paper, about its first resonance: a branch
by harmonic balance, and at some of its frequencies the same reduced model by PETSc's generalised
alpha, each from the steady motion at the frequency before, as in a stepped sine. The time steps and
the tolerance of steadiness are the cheapest with which all are within 0.5 % of the peak of a finer
time integration.
peer: a chain of masses with Jenkins elements, beside pyHarm (Apache-2.0), if it is installed
(``pip install pyHarm-os``, in an environment of its own that sees DOLFINx).
growth: time per point of the branch against interface points, harmonics and sliders.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.harmonic import Balance, HarmonicResult, Settings, solve_harmonic
from fenics_joints.interfaces import (
    InterfaceModel,
    InterfacePoints,
    full_layers,
    loading_shapes,
    reduce_layers,
    with_modal_damping,
)
from fenics_joints.joint_laws import Bilinear, Iwan, IwanLayer, RichardAbbott
from fenics_joints.modal import solve_modes
from fenics_joints.transient import solve_transient, steady_harmonics

CASE = Path(__file__).resolve().parent.parent / "demos" / "lap_beam"
PLACES = {
    "forces": {"force": ((0.1, 0.0, -6e-3), (0, 0, 1))},
    "sensors": {"tip": ((0.415, 0.0, 6e-3), (0, 0, 1))},
}
#: The paper's layer is 6 mm thick, the mesh's a hundredth of it.
RATIO, E_P, S_Y, N = 100.0, 101e3, 574.26e3, 2.5
DAMPING, FORCE, BAND = 0.003, 6.0, (26.5, 28.5)
#: Time steps per period and change over ten periods that counts as steady, cheapest first.
LADDER = ((100, 4e-3), (200, 4e-3), (250, 4e-3), (250, 2e-3), (300, 2e-3), (400, 1e-3))
FINER = (1000, 2e-4)
ACCURACY = 0.005  # of the peak
#: Newton's tolerance is the loosest that does not matter beside these.
OPTIONS = {"snes_rtol": 1e-5}


def timed(function: Callable):
    """Result, wall and processor time, s."""
    wall, processor = time.perf_counter(), time.process_time()
    result = function()
    return result, time.perf_counter() - wall, time.process_time() - processor


# -- the lap beam ----------------------------------------------------------------------------------


def lap_beam(n_sliders: int, n_modes: int = 12, mesh: dict | None = None) -> InterfaceModel:
    """The demo's nominal beam on its modes and a dozen static shapes of the yielding joint."""
    case = load_case(CASE)
    if mesh:
        case = case.model_copy(update={"mesh": case.mesh.model_copy(update=mesh)})
    structure = build_structure(case, MPI.COMM_SELF)
    joint = case.joints["lap"]
    backbone = RichardAbbott(RATIO * joint.E, E_P, S_Y, N)
    laws = {"lap": IwanLayer(backbone, RATIO * joint.G, n_sliders, thickness=RATIO)}
    modes = solve_modes(structure, n_modes=n_modes)
    full = full_layers(structure, laws, **PLACES)
    load = full.M.createVecLeft()
    full.M.mult(modes.shapes[0], load)
    load.scale(float(modes.eigenvalues[0]))
    push = abs(full.forces["force"].dot(modes.shapes[0])) * FORCE
    largest = push / (2 * DAMPING * float(modes.eigenvalues[0]))
    shapes = loading_shapes(full, load, largest * np.geomspace(0.01, 1.0, 12))
    model = reduce_layers(
        structure, laws, n_modes=n_modes, interface_modes=0, extra=shapes, **PLACES
    )
    damped = with_modal_damping(model, DAMPING)
    return InterfaceModel(
        damped.M, damped.K, damped.interfaces, damped.C, damped.forces, damped.sensors
    )


def with_points(model: InterfaceModel, n: int) -> InterfaceModel:
    """The model with n points: fewer of them, or each of them several times, of the same volume."""
    (points,) = model.interfaces
    chosen = np.floor(np.arange(n) * len(points) / n).astype(int)
    weights = points.weights[chosen]
    weights = weights * points.weights.sum() / weights.sum()
    return replace(model, interfaces=(
        replace(points, rows=points.rows[chosen], weights=weights, points=None),
    ))  # fmt: skip


def branch(model: InterfaceModel, harmonics: int = 5, max_step: float = 0.15) -> HarmonicResult:
    """The response to the force over the band."""
    settings = Settings(max_step=max_step)
    return solve_harmonic(
        model, "force", FORCE, BAND, harmonics=harmonics, sensor="tip", settings=settings
    )


def per_point(model: InterfaceModel, harmonics: int = 5) -> dict:
    """Time per point of the branch, without compiling."""
    Balance(model, harmonics).interface_force(np.zeros((model.n_dofs, 2 * harmonics + 1)))
    found, wall, processor = timed(lambda: branch(model, harmonics))
    n = len(found)
    return {
        "points_of_branch": n, "wall_s": wall / n, "processor_s": processor / n,
        "newton_steps": int(found.iterations.sum()), "jacobians": int(found.jacobians.sum()),
        "result": found,
    }  # fmt: skip


# -- time integration ------------------------------------------------------------------------------


def motion_at(found: HarmonicResult, i: int) -> tuple:
    """Displacement, velocity and states of a response at the start of a period."""
    X, omega = found.coefficients[i], found.omegas[i]
    h = np.arange(1, found.balance.fourier.harmonics + 1)
    u = X[:, 0] + X[:, 1::2].sum(axis=1)
    states = [made.state for made in found.balance.stresses(X).values()]
    return u, X[:, 2::2] @ (h * omega), states


def stepped(model: InterfaceModel, frequency: float, initial, steps: int, tolerance: float,
            max_periods: int = 2000):  # fmt: skip
    """The steady first harmonic at the sensor, and how many periods it took."""
    omega, last, now, count = 2 * np.pi * frequency, None, None, 0
    while last is None or np.abs(now - last).max() > tolerance * np.abs(now).max():
        if count >= max_periods:
            raise SystemExit(f"{frequency:g} Hz is not steady after {count} periods")
        run = solve_transient(
            model, step=1 / frequency / steps, n_steps=10 * steps, initial=initial,
            loads={"force": lambda t: FORCE * np.cos(omega * t)}, sensors=["tip"],
            petsc_options=OPTIONS,
        )  # fmt: skip
        initial, count, last = run.final, count + 10, now
        now = steady_harmonics(run.times, run.displacements["tip"], frequency)
    return now[1] - 1j * now[2], count


def beside_time_integration(args) -> dict:
    """Time per frequency of both, at the same accuracy."""
    model = lap_beam(args.sliders, mesh=args.mesh)
    n = len(model.interfaces[0])
    balance = per_point(model, args.harmonics)
    found = balance.pop("result")
    c = found.sensor_coefficients("tip")
    by_balance, peak = c[:, 1] - 1j * c[:, 2], found.peak.amplitude
    top = found.peak.index
    height = found.amplitude("tip")
    half = np.flatnonzero(height > 0.5 * peak)
    chosen = sorted({half[0], top, half[-1], *([1] if args.frequencies > 3 else [])})
    print(f"{n} interface points, {args.sliders} sliders, {model.n_dofs} degrees of freedom, "
          f"{args.harmonics} harmonics, {len(found)} points of the branch, peak "
          f"{1e3 * peak:.3f} mm at {found.peak.frequency_hz:.3f} Hz")  # fmt: skip
    starts = {i: motion_at(found, i - 1) for i in chosen}
    finest = {}
    for i in chosen:
        finest[i] = stepped(model, found.frequencies_hz[i], motion_at(found, i), *FINER)[0]
        off = abs(abs(by_balance[i]) - abs(finest[i])) / peak
        print(f"  {found.frequencies_hz[i]:7.3f} Hz: harmonic balance is {100 * off:.3f} % of the "
              f"peak off {FINER[0]} steps per period", flush=True)  # fmt: skip
    rows = []
    for steps, tolerance in LADDER:
        rows = []
        for i in chosen:
            f = found.frequencies_hz[i]
            (value, periods), wall, processor = timed(
                lambda i=i, f=f: stepped(model, f, starts[i], steps, tolerance)  # noqa: B023
            )
            error = abs(abs(value) - abs(finest[i])) / peak
            rows.append({
                "hz": f, "periods": periods, "wall_s": wall, "processor_s": processor,
                "off": error, "balance_off": abs(abs(by_balance[i]) - abs(finest[i])) / peak,
            })  # fmt: skip
            print(f"  {steps} steps, tolerance {tolerance:g}, {f:7.3f} Hz: {periods} periods, "
                  f"{wall:.1f} s, {100 * error:.3f} % off", flush=True)  # fmt: skip
            if error > ACCURACY:
                break
        if len(rows) == len(chosen) and max(row["off"] for row in rows) <= ACCURACY:
            break
    else:
        raise SystemExit("no time integration is accurate enough")
    ratios = {
        key: float(np.mean([row[key] for row in rows])) / balance[key]
        for key in ("wall_s", "processor_s")
    }
    print(f"time integration, {steps} steps per period: {np.mean([r['wall_s'] for r in rows]):.2f} "
          f"s per frequency; harmonic balance {balance['wall_s']:.3f} s; ratio "
          f"{ratios['wall_s']:.0f} (processor time {ratios['processor_s']:.0f})")  # fmt: skip
    return {
        "interface_points": n, "sliders": args.sliders, "dofs": model.n_dofs, "peak_m": peak,
        "harmonic_balance": balance, "time_integration": rows, "steps_per_period": steps,
        "tolerance": tolerance, "ratio": ratios,
    }  # fmt: skip


# -- the peer --------------------------------------------------------------------------------------


def chain(n: int, every: int, H: int) -> dict:
    """A chain of unit masses with Jenkins elements between some of them: first resonance near 1."""
    k = (2 * n + 1) ** 2 / np.pi**2
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = k
    slack = np.pi / (2 * n)  # between neighbours, at a unit amplitude of the end
    return {
        "M": np.eye(n), "C": 0.02 * np.eye(n), "K": K, "at": list(range(0, n, every)),
        "stiffness": 0.3 * k, "strength": 0.3 * k * 0.2 * slack, "push": 0.025 * n, "H": H,
        "T": 128, "band": (0.8, 1.3),
    }  # fmt: skip


def our_chain(c: dict) -> InterfaceModel:
    """It as an `InterfaceModel`."""
    n = len(c["M"])
    rows = (np.eye(n) - np.eye(n, k=-1))[c["at"]]
    law = Iwan(Bilinear(c["stiffness"], c["strength"], 0.0), 1)
    joint = InterfacePoints("joints", law, rows[:, None, :], np.ones(len(rows)))
    end = np.eye(n)[-1]
    return InterfaceModel(c["M"], c["K"], (joint,), c["C"], {"end": end}, {"end": end})


def by_pyharm(c: dict, step: float):
    """Frequencies (rad/s), amplitudes of the end, and the times that the branch took, s."""
    os.environ.setdefault("PYHARM_CONTEXT_FILE", f"{tempfile.mkdtemp()}/context.json")
    from pyHarm.Maestro import Maestro

    n = len(c["M"])
    connectors = {
        f"jenkins {i}": {
            "type": "Jenkins", "dirs": [0], "mu": 1.0, "N0": c["strength"], "k": c["stiffness"],
            "connect": [("chain", [i]), ("chain", [i - 1]) if i else ("GROUND", [None])],
        }
        for i in c["at"]
    }  # fmt: skip
    connectors["push"] = {
        "type": "CosinusForcing", "connect": [("chain", [n - 1]), ("GROUND", [None])],
        "dirs": [0], "amp": c["push"],
    }  # fmt: skip
    matrices = {"matrix": {key: c[key].copy() for key in "MCK"}, "ndofs": 1}
    low, high = c["band"]
    study = {
        "study": "frf", "puls_inf": low, "puls_sup": high, "ds0": step, "ds_max": step,
        "ds_min": 1e-6, "solver": "NewtonRaphson", "verbose": False,
        "solver_options": {"tol_residual": 1e-6, "tol_delta_x": 1e-6},
    }  # fmt: skip
    task = Maestro({
        "system": {"type": "Base", "nh": c["H"], "nti": c["T"]},
        "substructures": {"chain": matrices}, "connectors": connectors, "analysis": {"frf": study},
    })  # fmt: skip
    _, wall, processor = timed(task.operate)
    x = np.array([s.x for s in task.nls["frf"].SolList if s.flag_accepted])
    dofs = task.system.expl_dofs
    end = dofs[(dofs["node_num"] == n - 1) & (dofs["harm"] == 1)].index
    return x[:, -1], np.hypot(*x[:, end].T), wall, processor


def elsewhere(function: Callable, *arguments):
    """Call in a temporary folder: pyHarm leaves files where it runs."""
    here = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            return function(*arguments)
        finally:
            os.chdir(here)


def beside_pyharm(args) -> dict | None:
    """The same curve by both, and the times."""
    try:
        import pyHarm  # noqa: F401
    except ImportError:
        print("pyHarm is not installed: python3 -m venv --system-site-packages PEER, "
              "PEER/bin/pip install pyHarm-os, and start this with PEER/bin/python")  # fmt: skip
        return None
    c = chain(args.masses, 2, args.harmonics)
    small = chain(4, 2, args.harmonics)
    by_pyharm(small, 0.2)  # compiles
    model, step = our_chain(c), args.peer_step
    band = tuple(w / (2 * np.pi) for w in c["band"])

    def ours(longest):
        settings = Settings(max_step=longest)
        return solve_harmonic(
            model, "end", c["push"], band, harmonics=c["H"], samples=c["T"], cycles=3,
            settings=settings,
        )  # fmt: skip

    ours(0.1)  # compiles
    omega, height, wall, processor = by_pyharm(c, step)
    inside = omega <= c["band"][1]
    omega, height = omega[inside], height[inside]
    fair = min((0.2, 0.1, 0.07, 0.05, 0.03, 0.02), key=lambda s: abs(len(ours(s)) - len(omega)))
    found, our_wall, our_processor = timed(lambda: ours(fair))
    at = solve_harmonic(
        model, "end", c["push"], at=omega / (2 * np.pi), harmonics=c["H"], samples=c["T"], cycles=3
    )
    off = float(np.abs(at.amplitude("end") - height).max() / height.max())
    rows = {
        "masses": args.masses, "jenkins": len(c["at"]), "harmonics": c["H"], "samples": c["T"],
        "points": [len(found), len(omega)], "wall_s": [our_wall, wall],
        "processor_s": [our_processor, processor], "largest_difference": off,
        "ratio": wall / our_wall,
        "ratio_per_point": wall / len(omega) * len(found) / our_wall,
    }  # fmt: skip
    print(f"chain of {args.masses} masses, {len(c['at'])} Jenkins elements, {c['H']} harmonics, "
          f"{c['T']} samples:\n  ours {our_wall:.2f} s, {len(found)} points; pyHarm {wall:.2f} s, "
          f"{len(omega)} points; per point {rows['ratio_per_point']:.0f} times faster\n  largest "
          f"difference {100 * off:.1e} % of the peak, at pyHarm's frequencies")  # fmt: skip
    return rows


# -- growth ----------------------------------------------------------------------------------------


def slope(sizes, times) -> float:
    """Exponent of the growth, by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def growth(args) -> dict:
    """Time per point of the branch against sizes."""
    base = lap_beam(args.sliders, mesh=args.mesh)
    law = base.interfaces[0].law
    found = {}

    def run(what: str, size: int, model: InterfaceModel, harmonics: int = args.harmonics):
        row = per_point(model, harmonics)
        row.pop("result")
        found.setdefault(what, []).append({"size": size} | row)
        print(f"  {size:4d} {what:10s} {1e3 * row['processor_s']:8.1f} ms per point, "
              f"{row['points_of_branch']} points, {row['newton_steps']} Newton steps, "
              f"{row['jacobians']} Jacobians", flush=True)  # fmt: skip

    for n in args.points:
        run("points", n, with_points(base, n))
    for n in args.slider_counts:
        sliders = IwanLayer(law.backbone, law.G, n, thickness=RATIO)
        run("sliders", n, base.with_laws(lap=sliders))
    for H in args.harmonic_counts:
        run("harmonics", H, base, H)
    exponents = {
        what: slope([r["size"] for r in rows], [r["processor_s"] for r in rows])
        for what, rows in found.items()
    }
    print("growth: " + ", ".join(f"{what} ^ {e:.2f}" for what, e in exponents.items()))
    return {"rows": found, "exponents": exponents}


def main() -> None:
    parts = {"transient": beside_time_integration, "peer": beside_pyharm, "growth": growth}
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("parts", nargs="*", choices=[*parts, []], help="all by default")
    parser.add_argument("--harmonics", type=int, default=5)
    parser.add_argument("--sliders", type=int, default=12)
    parser.add_argument("--frequencies", type=int, default=3, choices=(3, 4),
                        help="at which time is integrated")  # fmt: skip
    parser.add_argument("--masses", type=int, default=20, help="of the chain")
    parser.add_argument("--peer-step", type=float, default=0.1, help="pyHarm's longest step")
    counts = {"type": int, "nargs": "+"}
    parser.add_argument("--points", default=[60, 120, 240, 480, 960], **counts)
    parser.add_argument("--slider-counts", default=[4, 8, 16, 32], **counts)
    parser.add_argument("--harmonic-counts", default=[1, 3, 5, 9], **counts)
    parser.add_argument("--coarse", action="store_const", dest="mesh", default=None,
                        const={"n_length": 8, "n_lap": 5, "n_width": 3},
                        help="a small mesh, to try this out")  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    found = {name: elsewhere(parts[name], args) for name in args.parts or parts}
    if args.json:
        args.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

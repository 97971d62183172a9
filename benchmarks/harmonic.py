"""Harmonic balance: beside time integration, and its growth with the model's size.

    ./with-fenicsx env OMP_NUM_THREADS=1 python3 benchmarks/harmonic.py [PART ...]

All by default, on one core. Beside other codes: harmonic_peers.py.

transient: the lap beam of the demo with the law of its paper, about its first resonance: a branch
by harmonic balance, and at some of its frequencies the same reduced model by PETSc's generalised
alpha, each from the steady motion at the frequency before, as in a stepped sine. The time steps and
the tolerance of steadiness are the cheapest with which all are within 0.5 % of the peak of a finer
time integration.
growth: time per point of the branch against interface points, harmonics and sliders.
evaluations: a law's harmonics over a cycle, integrated exactly, as in one direction of slip, beside
the sum over 128 samples, as in two.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from harness import ROOT, parser, timed, write
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.harmonic import Balance, ContinuationSettings, HarmonicResult, solve_harmonic
from fenics_joints.harmonic.fourier import Fourier
from fenics_joints.interfaces import (
    InterfaceModel,
    full_layers,
    loading_shapes,
    reduce_layers,
    with_modal_damping,
)
from fenics_joints.joint_laws import CoulombStick, ElasticFriction, Iwan, IwanLayer, RichardAbbott
from fenics_joints.joint_laws.kernel import LawKernel
from fenics_joints.modal import solve_modes
from fenics_joints.transient import solve_transient, steady_harmonics

CASE = ROOT / "demos" / "lap_beam"
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
    return replace(
        model, interfaces=(replace(points, rows=points.rows[chosen], weights=weights, points=None),)
    )


def branch(model: InterfaceModel, harmonics: int = 5, max_step: float = 0.15) -> HarmonicResult:
    """The response to the force over the band."""
    settings = ContinuationSettings(max_step=max_step)
    return solve_harmonic(
        model, "force", FORCE, BAND, harmonics=harmonics, sensor="tip", settings=settings
    )


def per_point(model: InterfaceModel, harmonics: int = 5) -> dict:
    """Time per point of the branch, without compiling."""
    Balance(model, harmonics).interface_force(np.zeros((model.n_dofs, 2 * harmonics + 1)))
    found, wall, processor = timed(lambda: branch(model, harmonics))
    n = len(found)
    return {
        "points_of_branch": n,
        "wall_s": wall / n,
        "processor_s": processor / n,
        "newton_steps": int(found.iterations.sum()),
        "jacobians": int(found.jacobians.sum()),
        "result": found,
    }


# -- time integration ------------------------------------------------------------------------------


def motion_at(found: HarmonicResult, i: int) -> tuple:
    """Displacement, velocity and states of a response at the start of a period."""
    X, omega = found.coefficients[i], found.omegas[i]
    h = np.arange(1, found.balance.fourier.harmonics + 1)
    u = X[:, 0] + X[:, 1::2].sum(axis=1)
    states = [made.state for made in found.balance.stresses(X).values()]
    return u, X[:, 2::2] @ (h * omega), states


def stepped(
    model: InterfaceModel,
    frequency: float,
    initial,
    steps: int,
    tolerance: float,
    max_periods: int = 2000,
):
    """The steady first harmonic at the sensor, and how many periods it took."""
    omega, last, now, count = 2 * np.pi * frequency, None, None, 0
    while last is None or np.abs(now - last).max() > tolerance * np.abs(now).max():
        if count >= max_periods:
            raise SystemExit(f"{frequency:g} Hz is not steady after {count} periods")
        run = solve_transient(
            model,
            step=1 / frequency / steps,
            n_steps=10 * steps,
            initial=initial,
            loads={"force": lambda t: FORCE * np.cos(omega * t)},
            sensors=["tip"],
            petsc_options=OPTIONS,
        )
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
    print(
        f"{n} interface points, {args.sliders} sliders, {model.n_dofs} degrees of freedom, "
        f"{args.harmonics} harmonics, {len(found)} points of the branch, peak "
        f"{1e3 * peak:.3f} mm at {found.peak.frequency_hz:.3f} Hz"
    )
    starts = {i: motion_at(found, i - 1) for i in chosen}
    finest = {}
    for i in chosen:
        finest[i] = stepped(model, found.frequencies_hz[i], motion_at(found, i), *FINER)[0]
        off = abs(abs(by_balance[i]) - abs(finest[i])) / peak
        print(
            f"  {found.frequencies_hz[i]:7.3f} Hz: harmonic balance is {100 * off:.3f} % of the "
            f"peak off {FINER[0]} steps per period",
            flush=True,
        )
    rows = []
    for steps, tolerance in LADDER:
        rows = []
        for i in chosen:
            f = found.frequencies_hz[i]
            (value, periods), wall, processor = timed(
                lambda i=i, f=f: stepped(model, f, starts[i], steps, tolerance)  # noqa: B023
            )
            error = abs(abs(value) - abs(finest[i])) / peak
            rows.append(
                {
                    "hz": f,
                    "periods": periods,
                    "wall_s": wall,
                    "processor_s": processor,
                    "off": error,
                    "balance_off": abs(abs(by_balance[i]) - abs(finest[i])) / peak,
                }
            )
            print(
                f"  {steps} steps, tolerance {tolerance:g}, {f:7.3f} Hz: {periods} periods, "
                f"{wall:.1f} s, {100 * error:.3f} % off",
                flush=True,
            )
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
    print(
        f"time integration, {steps} steps per period: {np.mean([r['wall_s'] for r in rows]):.2f} "
        f"s per frequency; harmonic balance {balance['wall_s']:.3f} s; ratio "
        f"{ratios['wall_s']:.0f} (processor time {ratios['processor_s']:.0f})"
    )
    return {
        "interface_points": n,
        "sliders": args.sliders,
        "dofs": model.n_dofs,
        "peak_m": peak,
        "harmonic_balance": balance,
        "time_integration": rows,
        "steps_per_period": steps,
        "tolerance": tolerance,
        "ratio": ratios,
    }


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
        print(
            f"  {size:4d} {what:10s} {1e3 * row['processor_s']:8.1f} ms per point, "
            f"{row['points_of_branch']} points, {row['newton_steps']} Newton steps, "
            f"{row['jacobians']} Jacobians",
            flush=True,
        )

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


# -- evaluations -----------------------------------------------------------------------------------


def evaluations(args) -> dict:
    """Processor time per point, s, of harmonics and of them with their Jacobian."""
    curve, found = RichardAbbott(1.0, 0.05, 0.2, 1.5), {}
    laws = {
        "Jenkins": ElasticFriction(1.0, 0.2),
        "12 sliders": Iwan(curve, 12),
        "24 sliders": Iwan(curve, 24),
        "Coulomb": CoulombStick(5.0, 1.0, 0.2, 1.0),
    }
    P, K = 240, 2 * args.harmonics + 1
    for name, law in laws.items():
        for n_slip in (1, 2):
            kernel, d = LawKernel.of(law, n_slip, law.coupled), n_slip + law.coupled
            fourier = Fourier(args.harmonics, 128)
            X = np.random.default_rng(0).standard_normal((P, d, K)) * 0.06
            X[:, :, 1:3] *= 10
            given = X, X @ fourier.derivative.T, fourier.synthesis, law.values(P)
            row = found[f"{name}, {n_slip}"] = {}
            for jacobian in (False, True):
                times = {False: [], True: []}
                for _ in range(7):
                    for exact in {False, kernel.exact}:
                        options = {"exact": exact, "jacobian": jacobian}
                        _, _, spent = timed(lambda o=options: kernel.harmonic(*given, **o))  # noqa: B023
                        times[exact].append(spent / P)
                what = "jacobian" if jacobian else "residual"
                row[what], row[f"{what}_sampled"] = min(times[kernel.exact]), min(times[False])
            print(
                f"  {name}, slip in {n_slip}: "
                + ", ".join(
                    f"{what} {1e6 * row[what]:.1f} us, {row[what] / row[f'{what}_sampled']:.2f} "
                    "times the sum over samples"
                    for what in ("residual", "jacobian")
                ),
                flush=True,
            )
    return found


def main() -> None:
    parts = {"transient": beside_time_integration, "growth": growth, "evaluations": evaluations}
    made = parser(__doc__, parts)
    made.add_argument("--harmonics", type=int, default=5)
    made.add_argument("--sliders", type=int, default=12)
    made.add_argument(
        "--frequencies", type=int, default=3, choices=(3, 4), help="at which time is integrated"
    )
    counts = {"type": int, "nargs": "+"}
    made.add_argument("--points", default=[60, 120, 240, 480, 960], **counts)
    made.add_argument("--slider-counts", default=[4, 8, 16, 32], **counts)
    made.add_argument("--harmonic-counts", default=[1, 3, 5, 9], **counts)
    made.add_argument(
        "--coarse",
        action="store_const",
        dest="mesh",
        default=None,
        const={"n_length": 8, "n_lap": 5, "n_width": 3},
        help="a small mesh, to try this out",
    )
    args = made.parse_args()
    found = {name: parts[name](args) for name in args.parts or parts}
    write(args.json, found)


if __name__ == "__main__":
    main()

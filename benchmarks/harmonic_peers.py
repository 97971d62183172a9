"""Harmonic balance here, by pyHarm and by tmdsimpy: the same systems in one run, on one core.

    PEER/bin/python benchmarks/harmonic_peers.py [--json FILE]

PEER is an environment of its own that sees DOLFINx (``python3 -m venv --system-site-packages``),
with ``pip install pyHarm-os`` (Apache-2.0) and ``pip install jax`` beside a checkout of tmdsimpy
(MIT, not on PyPI) whose folder the variable TMDSIMPY names. Who is missing is left out, and said.

jenkins: a chain of masses with Jenkins elements between some of them, about its first resonance.
cubic: the same chain with cubic springs there, so weak that the curve does not fold.

Each peer steps as its own continuation does, with steps that give about as many points as the
others; tolerances are 1e-6 of a step. What is compiled is compiled before. The curves are compared
with solutions of ours at the peer's frequencies.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Callable

import numpy as np
from harness import parser, timed, write

from fenics_joints.harmonic import ContinuationSettings, solve_harmonic
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import Bilinear, CubicSpring, Iwan

HOW = {
    "pyHarm": "pip install pyHarm-os",
    "tmdsimpy": "pip install jax, and name a checkout of github.com/tmd-lab/tmdsimpy in TMDSIMPY",
}


def chain(kind: str, n: int, every: int, H: int, copies: int = 1) -> dict:
    """A chain of unit masses with elements between some of them: first resonance near 1 rad/s.

    As many ``copies`` of each side by side do together what one does.
    """
    k = (2 * n + 1) ** 2 / np.pi**2
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = k
    slack = np.pi / (2 * n)  # between neighbours, at a unit amplitude of the end
    each = k / copies
    own = {"stiffness": 0.3 * each, "strength": 0.3 * each * 0.2 * slack, "band": (0.8, 1.3)}
    if kind == "cubic":
        own = {"cubic": 0.01 * each / slack**2, "band": (0.8, 1.3)}
    common = {"kind": kind, "K": K, "M": np.eye(n), "C": 0.02 * np.eye(n), "push": 0.025 * n}
    return {**own, **common, "at": list(range(0, n, every)) * copies, "H": H, "T": 128}


# -- ours ------------------------------------------------------------------------------------------


def our_model(c: dict) -> InterfaceModel:
    """The chain as an `InterfaceModel`."""
    n = len(c["M"])
    rows = (np.eye(n) - np.eye(n, k=-1))[c["at"]]
    if c["kind"] == "cubic":
        law = CubicSpring(0.0, c["cubic"])
    else:
        law = Iwan(Bilinear(c["stiffness"], c["strength"], 0.0), 1)
    joint = InterfacePoints("joints", law, rows[:, None, :], np.ones(len(rows)))
    end = np.eye(n)[-1]
    return InterfaceModel(c["M"], c["K"], (joint,), c["C"], {"end": end}, {"end": end})


def ours(c: dict, longest: float | None = None, omega: np.ndarray | None = None):
    """The branch, or solutions at frequencies, rad/s."""
    common = {"harmonics": c["H"], "samples": c["T"], "cycles": 3}
    if omega is not None:
        at = omega / (2 * np.pi)
        return solve_harmonic(our_model(c), "end", c["push"], at=at, **common)
    band = tuple(w / (2 * np.pi) for w in c["band"])
    settings = ContinuationSettings(max_step=longest)
    return solve_harmonic(our_model(c), "end", c["push"], band, settings=settings, **common)


# -- pyHarm ----------------------------------------------------------------------------------------


def by_pyharm(c: dict, step: float):
    """Frequencies (rad/s), amplitudes of the end, and the times that the branch took, s."""
    from pyHarm.Maestro import Maestro

    n, common = len(c["M"]), {"dirs": [0]}
    if c["kind"] == "cubic":
        common |= {"type": "CubicSpring", "k": c["cubic"]}
    else:
        common |= {"type": "Jenkins", "mu": 1.0, "N0": c["strength"], "k": c["stiffness"]}
    connectors = {
        f"element {number}": common
        | {"connect": [("chain", [i]), ("chain", [i - 1]) if i else ("GROUND", [None])]}
        for number, i in enumerate(c["at"])
    }
    connectors["push"] = {
        "type": "CosinusForcing",
        "connect": [("chain", [n - 1]), ("GROUND", [None])],
        "dirs": [0],
        "amp": c["push"],
    }
    matrices = {"matrix": {key: c[key].copy() for key in "MCK"}, "ndofs": 1}
    low, high = c["band"]
    study = {
        "study": "frf",
        "puls_inf": low,
        "puls_sup": high,
        "ds0": step,
        "ds_max": step,
        "ds_min": 1e-6,
        "solver": "NewtonRaphson",
        "verbose": False,
        "solver_options": {"tol_residual": 1e-6, "tol_delta_x": 1e-6},
    }
    task = Maestro(
        {
            "system": {"type": "Base", "nh": c["H"], "nti": c["T"]},
            "substructures": {"chain": matrices},
            "connectors": connectors,
            "analysis": {"frf": study},
        }
    )
    _, wall, processor = timed(task.operate)
    x = np.array([s.x for s in task.nls["frf"].SolList if s.flag_accepted])
    dofs = task.system.expl_dofs
    end = dofs[(dofs["node_num"] == n - 1) & (dofs["harm"] == 1)].index
    return x[:, -1], np.hypot(*x[:, end].T), wall, processor


# -- tmdsimpy --------------------------------------------------------------------------------------


def tmdsimpy_system(c: dict):
    """The chain as a `VibrationSystem`."""
    import tmdsimpy

    n = len(c["M"])
    rows = (np.eye(n) - np.eye(n, k=-1))[c["at"]]
    system = tmdsimpy.VibrationSystem(c["M"], c["K"], c["C"])
    if c["kind"] == "cubic":
        from tmdsimpy.nlforces.cubic_stiffness import CubicForce

        system.add_nl_force(CubicForce(rows, rows.T, np.full(len(rows), c["cubic"])))
        return system
    from tmdsimpy.jax.nlforces import JenkinsForce  # less than half the time of its VectorJenkins

    for row in rows[:, None]:
        system.add_nl_force(JenkinsForce(row, row.T, c["stiffness"], c["strength"]))
    return system


def by_tmdsimpy(c: dict, step: float):
    """The same by tmdsimpy, with the Newton solver and the scaling of its examples."""
    import tmdsimpy.utils.harmonic as hutils
    from tmdsimpy.continuation import Continuation
    from tmdsimpy.jax.solvers import NonlinearSolverOMP

    system, n, h, (low, high) = tmdsimpy_system(c), len(c["M"]), np.arange(c["H"] + 1), c["band"]
    load = np.zeros(n * hutils.Nhc(h))
    load[2 * n - 1] = c["push"]  # cosine of the first harmonic
    solver = NonlinearSolverOMP({"verbose": False, "max_steps": 30})
    D = c["K"] - low**2 * c["M"] + 1j * low * c["C"]
    first = np.linalg.solve(D, load[n : 2 * n])
    start = np.zeros_like(load)
    start[n : 3 * n] = np.concatenate([first.real, -first.imag])

    def residual(X, calc_grad=True):
        return system.hbm_res(X, load, h, Nt=c["T"], aft_tol=1e-7, calc_grad=calc_grad)

    start, *_ = solver.nsolve(lambda U, calc_grad=True: residual(np.append(U, low))[:2], start)
    scale = hutils.harmonic_wise_conditioning(np.append(start, low), n, h, delta=1e-3 * c["push"])
    scale[-1] = high
    options = {
        "DynamicCtoP": True,
        "MaxSteps": 4000,
        "dsmax": step,
        "dsmin": 1e-6,
        "verbose": 10**9,
        "xtol": 1e-6,
        "TargetNfev": 4,
        "corrector": "Ortho",
    }
    follow = Continuation(solver, ds0=step, CtoP=scale, RPtoC=1 / np.abs(D).max(), config=options)
    first = np.append(start, low)
    X, wall, processor = timed(lambda: follow.continuation(residual, first, low, high))
    return X[:, -1], np.hypot(X[:, 2 * n - 1], X[:, 3 * n - 1]), wall, processor


# -- side by side ----------------------------------------------------------------------------------


def available() -> dict[str, Callable]:
    """The peers that are here; of others it is said how to get them."""
    if os.environ.get("TMDSIMPY"):
        sys.path.insert(0, os.environ["TMDSIMPY"])
    here = {}
    for name, run in {"pyHarm": by_pyharm, "tmdsimpy": by_tmdsimpy}.items():
        try:
            __import__("tmdsimpy.jax.solvers" if name == "tmdsimpy" else name)
            here[name] = run
        except ImportError:
            print(f"{name} is not here: {HOW[name]}", file=sys.stderr)
    return here


def beside(c: dict, peers: dict[str, Callable], steps: dict[str, float]) -> list[dict]:
    """A row for each code: points, times, and how far it is from ours at its frequencies."""
    small = chain(c["kind"], 4, 2, c["H"])
    ours(small, 0.1)  # compiles
    rows, fair = [], 40
    for name, run in peers.items():
        with contextlib.redirect_stdout(sys.stderr):
            run(small, steps[name])  # compiles
            omega, height, wall, processor = run(c, steps[name])
        inside = omega <= c["band"][1]
        omega, height = omega[inside], height[inside]
        same = ours(c, omega=omega).amplitude("end")
        off = float(np.abs(same - height).max() / height.max())
        fair = len(omega)
        rows.append(
            {
                "code": name,
                "points": fair,
                "wall_s": wall,
                "processor_s": processor,
                "largest_difference": off,
            }
        )
    longest = min((0.2, 0.1, 0.07, 0.05, 0.03, 0.02), key=lambda s: abs(len(ours(c, s)) - fair))
    found, wall, processor = timed(lambda: ours(c, longest))
    rows.insert(0, {"code": "ours", "points": len(found), "wall_s": wall, "processor_s": processor})
    for row in rows:
        row["ratio_per_point"] = row["wall_s"] / row["points"] * len(found) / wall
    return rows


def main() -> None:
    made = parser(__doc__)
    made.add_argument("--masses", type=int, default=20, help="of the chain")
    made.add_argument("--copies", type=int, default=1, help="of each element, side by side")
    made.add_argument("--kinds", nargs="+", default=["jenkins", "cubic"])
    made.add_argument("--harmonics", type=int, default=5)
    made.add_argument("--pyharm-step", type=float, default=0.1, help="pyHarm's longest step")
    made.add_argument("--tmdsimpy-step", type=float, default=0.1, help="tmdsimpy's longest step")
    args = made.parse_args()
    target = args.json and args.json.resolve()
    steps = {"pyHarm": args.pyharm_step, "tmdsimpy": args.tmdsimpy_step}
    os.environ.setdefault("PYHARM_CONTEXT_FILE", f"{tempfile.mkdtemp()}/context.json")
    peers, found = available(), {}
    os.chdir(tempfile.mkdtemp())  # pyHarm leaves files where it runs
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # JAX has threads of its own
    for kind in args.kinds:
        c = chain(kind, args.masses, 2, args.harmonics, args.copies)
        found[kind] = beside(c, peers, steps)
        print(
            f"{args.masses} masses, {len(c['at'])} {kind} elements, {c['H']} harmonics, "
            f"{c['T']} samples"
        )
        for row in found[kind]:
            off = row.get("largest_difference")
            far = "" if off is None else f", {100 * off:.1e} % of the peak from ours"
            print(
                f"  {row['code']:9s}{row['points']:5d} points {row['wall_s']:8.2f} s, per point "
                f"{row['ratio_per_point']:6.1f} times ours{far}",
                flush=True,
            )
    write(target, found)


if __name__ == "__main__":
    main()

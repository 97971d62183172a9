"""Stage two of the lap beam: a layer that yields, identified from the virtual test.

`demo_nonlinear.py` shows this in short. Run as a script, this file computes the numbers of
`README.md`, also with the direct search of the paper:

    python3 demos/lap_beam/stage_two.py
"""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.optimize import least_squares

from fenics_joints.harmonic import identify, predict, read_loops, solve_harmonic
from fenics_joints.interfaces import InterfaceModel, reduce_layers, with_modal_damping
from fenics_joints.joint_laws import Iwan, IwanLayer, RichardAbbott
from fenics_joints.measurements import read_curves
from fenics_joints.meshes import lap_beam
from fenics_joints.modal import frequency_sensitivity, solve_modes
from fenics_joints.structure import Parameter, PointMass, Structure, Support, joint, part

HERE = Path(__file__).parent
COMM = MPI.COMM_WORLD
T, H = 6e-5, 6e-3  # thickness of the layer in the mesh, and in the paper, m
TIP = (0.42, 0.0, 6e-3)
COUNTS = {"n_length": 10, "n_lap": 8, "n_width": 3}
PLACES = {"force": "shaker", "sensor": "tip"}
SLIDERS, HARMONICS, SAMPLES = 16, 3, 64
POINTS = 7  # of the 6 N curve, near its peak
#: Table 2 and 3: E_e / (1 - nu^2) and G, Pa, of the paper's layer (see README.md); E_p, S_y, n.
PAPER = {"E": 654.72e6, "G": 168.13e6, "E_p": 1.01e5, "S_y": 5.7426e5, "n": 2.5}


@dataclass(frozen=True)
class Test:
    """Data of the virtual test, from the heads of its files."""

    shaker: float
    damping: float
    frequencies_hz: np.ndarray

    __test__ = False


def read_test() -> Test:
    """Bending modes at rest, shaker and damping, from the head of ``frf.csv``."""
    text = (HERE / "frf.csv").read_text(encoding="utf-8")
    head = " ".join(line[2:] for line in text.splitlines() if line.startswith("#"))
    modes = [float(f) for f in head.split("Modes at rest, Hz: ")[1].split(". ")[0].split(",")]
    damping = float(head.split("viscous damping ")[1].split(",")[0])
    shaker = float(head.split("shaker at x = ")[1].split(" m")[0])
    # The second mode bends in the plane.
    return Test(shaker, damping, np.array(modes)[[0, 2, 3]])


def beams(masses) -> Structure:
    """The beams with a layer of parameters ``E`` and ``G``, Pa, scaled to its thickness."""
    mesh = lap_beam(COMM, layer=T, **COUNTS)
    lap = joint("lap", "joint", E="E", G="G")
    steel = part("beams", ("beam_1", "beam_2"), E=207e9, nu=0.3, rho=7800.0)
    parameters = [Parameter(key, PAPER[key] * T / H) for key in ("E", "G")]
    points = [PointMass(f"mass {i}", m, x) for i, (m, x) in enumerate(masses)]
    return Structure(mesh, [steel, lap], parameters, supports=[Support("clamp")], masses=points)


def bolt_and_accelerometer(bolt: float, accelerometer: float):
    """Point masses, kg and m."""
    half = bolt / 2
    return [(half, (0.21, 0.0, 6e-3)), (half, (0.21, 0.0, -6e-3)), (accelerometer, TIP)]


def linear_stage(structure: Structure, frequencies_hz: np.ndarray, bending=(0, 2, 3)):
    """E and G of the layer from low-level frequencies, Pa; and the model's frequencies, Hz.

    The first frequency has the largest weight, because the curves near it have to be fitted to a
    hundredth of a percent.
    """
    noise = np.array([1e-4, 1e-3, 1e-2])

    def solved(x):
        values = dict(zip(("E", "G"), np.exp(x) * T / H, strict=True))
        modes = solve_modes(structure, values, n_modes=6)
        slope = frequency_sensitivity(modes, bending) * np.array(list(values.values()))
        return modes.frequencies_hz[list(bending)], slope

    found = least_squares(
        lambda x: np.log(solved(x)[0] / frequencies_hz) / noise,
        np.log([PAPER["E"], PAPER["G"]]),
        lambda x: solved(x)[1] / noise[:, None],
        x_scale=[1.0, 1.0],
        xtol=1e-6,
        bounds=(np.log(1e6), np.log(1e11)),
    )
    return np.exp(found.x), solved(found.x)[0]


def layer_law(E, G, E_p, S_y, n, *, shear: bool = False, sliders: int = SLIDERS):
    """Eq. 4 for the equivalent stress, or, as printed, for the shear stress alone."""
    if shear:
        return Iwan(RichardAbbott(G, E_p, S_y, n), sliders, thickness=H / T)
    return IwanLayer(RichardAbbott(E, E_p, S_y, n), G, sliders, thickness=H / T)


def nonlinear_model(
    structure: Structure,
    law,
    E: float,
    G: float,
    shaker: float,
    damping: float,
    interface_modes: int = 24,
) -> InterfaceModel:
    """The reduced model with the layer's law."""
    model = reduce_layers(
        structure,
        {"lap": law},
        n_modes=8,
        interface_modes=interface_modes,
        given={"E": E * T / H, "G": G * T / H},
        forces={"shaker": ((shaker, 0.0, -6e-3), (0, 0, 1))},
        sensors={"tip": (TIP, (0, 0, 1))},
    )
    return with_modal_damping(model, damping)


def summary(model: InterfaceModel, levels, band) -> list[dict]:
    """Peak, its frequency, and the damping, by level."""
    rows = []
    for level in levels:
        response = solve_harmonic(
            model, "shaker", level, band, harmonics=HARMONICS, samples=SAMPLES, sensor="tip"
        )
        i, omega = response.peak.index, 2 * np.pi * response.peak.frequency_hz
        X = response.coefficients[i]
        # Kinetic energy of the first harmonic at its largest speed.
        kinetic = 0.5 * omega**2 * sum(X[:, k] @ model.M @ X[:, k] for k in (1, 2))
        rows.append(
            {
                "level": level,
                "frequency_hz": response.peak.frequency_hz,
                "tip_m": response.peak.amplitude,
                "damping": float(response.force_work()[i] / (4 * np.pi * kinetic)),
                "joint_share": float(
                    response.dissipation([i])["lap"][0] / response.force_work()[i]
                ),
            }
        )
    return rows


def options() -> dict:
    """Options of all responses here; ranks share the points of the interface."""
    return {"harmonics": HARMONICS, "samples": SAMPLES, "comm": COMM, **PLACES}


def identified(model, curves, start, method: str, loops=()):
    """Parameters from the highest level alone, and their predictions at all levels."""
    level = max(curves.levels)
    found = identify(
        model.with_parameters,
        curves,
        level,
        start,
        method=method,
        points=POINTS,
        loops=loops,
        **options(),
    )
    return found, predict(found.model, curves, points=POINTS, **options())


def say(*lines: str) -> None:
    """Print on rank 0."""
    if COMM.rank == 0:
        print(*lines, sep="\n", flush=True)


def tell(words: str, found, predictions) -> None:
    """Print an identification in a few lines."""
    values = ", ".join(
        f"{name[4:]} {value:.4g} (+-{100 * found.sd[name]:.0f} %)"
        for name, value in found.values.items()
    )
    say(
        f"{words}: {values}",
        f"  eq. 6 {found.start_objective:.3f} -> {found.objective:.3f}; {found.evaluations} "
        f"responses ({found.solutions} periodic solutions, {found.iterations} Newton steps), "
        f"{found.gradients} gradients",
    )
    tell_errors(predictions)


def tell_errors(predictions) -> None:
    """Print the errors by level."""
    for p in predictions:
        say(
            f"  {p.level:g} N: mean error {100 * p.mean_error:.1f} %, peak "
            f"{100 * p.amplitude_error:+.1f} %, its frequency {100 * p.frequency_error:+.3f} %"
        )


def paper_parameters() -> None:
    """Print what the paper's parameters give in the solid model, with the masses of README.md."""
    structure = beams(bolt_and_accelerometer(7e-3, 10e-3))
    say("the paper's parameters, shaker at 0.1 m, damping 0.3 %")
    for shear in (False, True):
        model = nonlinear_model(
            structure, layer_law(**PAPER, shear=shear), PAPER["E"], PAPER["G"], 0.1, 0.003, 40
        )
        for row in summary(model, (0.05, 1.5, 3.0, 6.0), (24.0, 28.0)):
            say(
                f"  {'shear alone' if shear else 'equivalent stress'} {row['level']:g} N: "
                f"{row['frequency_hz']:.3f} Hz, tip {1e3 * row['tip_m']:.2f} mm, damping "
                f"{100 * row['damping']:.3f} %, of it the joint {100 * row['joint_share']:.0f} %"
            )


def main() -> None:
    """Print all numbers of README.md on stage two."""
    began = time.time()
    test = read_test()
    curves = read_curves(HERE / "frf.csv", "acceleration")
    loops = read_loops(HERE / "loops.csv", "acceleration")
    for p in curves.levels:
        f, a = curves.at(p)
        say(f"test, {p:g} N: largest {a.max():.3f} m/s2 at {f[a.argmax()]:.3f} Hz")
    structure = beams(bolt_and_accelerometer(5.7e-3, 10e-3))
    (E, G), frequencies = linear_stage(structure, test.frequencies_hz)
    say(
        f"linear stage: k_n {E / H / 1e9:.3g}, k_t {G / H / 1e9:.3g} GPa/m; {frequencies} Hz, "
        f"errors {100 * (frequencies / test.frequencies_hz - 1)} %"
    )
    for shear in (False, True):
        modulus = G if shear else E
        start = {"lap.E_p": 0.02 * modulus, "lap.S_y": 6e4}
        law = layer_law(E, G, *start.values(), 2.5, shear=shear)
        model = nonlinear_model(structure, law, E, G, test.shaker, test.damping)
        say("", "shear alone" if shear else "equivalent stress")
        say("linear layer")
        rigid = {"lap.S_y": 1e4 * start["lap.S_y"]}
        tell_errors(predict(model.with_parameters(rigid), curves, points=POINTS, **options()))
        best, predictions = identified(model, curves, start, "gradient")
        tell("gradient", best, predictions)
        say(f"  {time.time() - began:.0f} s")
        if not shear:
            tell("direct", *identified(model, curves, start, "direct"))
            say(f"  {time.time() - began:.0f} s")
        n = identify(
            best.model.with_parameters,
            None,
            None,
            {"lap.n": 2.5},
            loops=loops,
            **options() | {"harmonics": 5},
        )
        say(
            f"n from the loop alone: {n.values['lap.n']:.3g} (+-{100 * n.sd['lap.n']:.0f} %), "
            f"rms error {100 * n.objective:.1f} %"
        )
        tell(
            "with n, curve and loop",
            *identified(model, curves, {**best.values, "lap.n": 2.5}, "gradient", loops),
        )
    say("")
    paper_parameters()
    say(f"{time.time() - began:.0f} s")


if __name__ == "__main__":
    main()

"""Make the virtual test of the lap beam: responses near the first resonance, by time integration.

Iranzad and Ahmadian 2012 show their measured curves only as figures. This test replaces them. It
comes from another model than the one that is identified: no layer and no Iwan law, but two beams in
unilateral contact with Coulomb friction, on rough and therefore elastic surfaces, pressed together
by a bolt that bends and stretches; with a finer mesh, time steps instead of harmonics, and noise.

The preload is the paper's 120 N. It closes the whole lap, with 0.11 MPa at most. The ends of the
lap open once the tip moves by about 1 mm, which softens without damping, while friction damps. The
forces keep the tip below 1.5 mm.

Time integration moves the harmonic-balance amplitudes of the same model, from which it starts, by
up to 3 % on the flanks: 192 steps per period cost 0.009 % of frequency, (omega h)^2 / 12. So the
test also verifies harmonic balance with friction and opening. Writes `frf.csv` and `loops.csv`
beside this file:

    python3 demos/lap_beam/virtual_test.py

It takes some minutes, on one process.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.harmonic import solve_harmonic
from fenics_joints.interfaces import (
    InterfaceModel,
    reduce_contacts,
    static_state,
    with_modal_damping,
)
from fenics_joints.joint_laws import CoulombStick
from fenics_joints.meshes import lap_beam
from fenics_joints.modal import solve_modes
from fenics_joints.preload import BeamBolt, Contact, LinearJoint, PreloadModel
from fenics_joints.structure import PointMass, Structure, Support, part
from fenics_joints.transient import solve_transient, steady_harmonics

HERE = Path(__file__).parent
LEVELS = (1.5, 3.0, 6.0)  # N, the paper's
PRELOAD = 120.0  # N, the paper's
SHAKER, ZETA = 0.02, 0.0015  # m from the clamp; viscous damping of all modes
CONTACT = {"normal_stiffness": 5e10, "tangential_stiffness": 3e11, "friction": 0.3}
WASHER, SHANK = 12e-3, 3e-3  # side of the pressed square; shank of the bolt with force washer, m
#: Offsets from the resonance at rest, in units of half its half-power width.
SWEEP = np.array([-3.4, -2.6, -2, -1.5, -1.1, -0.8, -0.5, -0.2, 0.2, 0.7, 1.3, 2])
STEPS, NOISE, SEED = 192, 0.01, 3
TIP, ACCELEROMETER = (0.42, 0.0, 6e-3), 10e-3


def beams() -> PreloadModel:
    """Two steel beams in contact, a bolt, an accelerometer."""
    mesh = lap_beam(MPI.COMM_SELF, n_length=10, n_lap=10, n_width=5, washer=WASHER)
    structure = Structure(
        mesh,
        [part("beams", ("beam_1", "beam_2"), E=207e9, nu=0.3, rho=7800.0)],
        supports=[Support("clamp")],
        masses=[PointMass("accelerometer", ACCELEROMETER, TIP)],
    )
    bolt = BeamBolt("bolt", "washer_lower", "washer_upper", PRELOAD, SHANK, head_mass=2.5e-3)
    return PreloadModel(structure, [Contact("lap", "interface_lower", "interface_upper")], [bolt])


def truth() -> tuple[InterfaceModel, np.ndarray]:
    """The reduced model and its static load, the tightened bolt, (n,).

    The elastic bolt is tightened until the contact carries the preload.
    """
    law = CoulombStick(**CONTACT)
    model = reduce_contacts(
        LinearJoint(beams()),
        {"lap": law},
        n_modes=8,
        interface_modes=40,
        forces={"shaker": ((SHAKER, 0.0, -6e-3), (0, 0, 1))},
        sensors={"tip": (TIP, (0, 0, 1))},
    )
    (lap,), tight = model.interfaces, PRELOAD
    for _ in range(8):
        x, _ = static_state(model, tight * model.forces["bolt"])
        pressure = CONTACT["normal_stiffness"] * np.maximum(-lap.rows[:, 0] @ x, 0.0)
        tight *= PRELOAD / float(pressure @ lap.weights)
    print(
        f"{model.n_dofs} unknowns, {len(lap)} pairs, {np.mean(pressure > 0):.0%} closed, "
        f"largest pressure {pressure.max() / 1e3:.0f} kPa"
    )
    return replace(model, C=with_modal_damping(at_rest(model), ZETA).C), (
        tight * model.forces["bolt"]
    )


def at_rest(model: InterfaceModel) -> InterfaceModel:
    """The model of vibrations so small that closed contact stays closed and sticks."""
    return model.with_laws(lap=CoulombStick(**CONTACT, pressure=1e9))


class Shaker:
    """A stepped sine on the preloaded beams."""

    def __init__(self, model: InterfaceModel, static: np.ndarray):
        self.preloaded, self.static = model, static
        self.model = replace(model, forces={**model.forces, "static": static})
        self.now = None

    def start(self, level: float, frequency: float) -> float:
        """Start from the steady state by harmonic balance; its amplitude, m.

        Otherwise hundreds of periods would pass before the motion is steady.
        """
        response = solve_harmonic(
            self.preloaded, "shaker", level, at=[frequency], static=self.static, sensor="tip"
        )
        X, h = response.coefficients[0], np.arange(1, response.balance.fourier.harmonics + 1)
        state = response.balance.stresses(X)["lap"].state
        v = 2 * np.pi * frequency * (X[:, 2::2] @ h)
        self.now = X[:, 0] + X[:, 1::2].sum(axis=1), v, [state]
        return float(response.amplitude()[0])

    def run(self, level: float, frequency: float, periods: int):
        """Integrate over whole periods from the present state."""
        omega = 2 * np.pi * frequency
        made = solve_transient(
            self.model,
            step=1 / frequency / STEPS,
            n_steps=periods * STEPS,
            loads={"shaker": lambda t: level * np.cos(omega * t), "static": lambda t: 1.0},
            sensors=["tip"],
            initial=self.now,
        )
        self.now = made.final
        return made

    def amplitude(self, level: float, frequency: float) -> tuple[float, float]:
        """Steady first harmonic of the tip, m, and its value at the start.

        The transient decays like e^(-zeta omega t) and rotates. Three readings give its limit
        (Aitken's extrapolation), and three such limits have to agree.
        """
        first = self.start(level, frequency)
        read, limits = [], []
        while len(limits) < 3 or np.ptp(np.abs(limits[-3:])) > 2e-3 * abs(limits[-1]):
            if len(read) == 80:
                raise SystemExit(f"{level:g} N, {frequency:.4f} Hz: not steady")
            made = self.run(level, frequency, 6)
            _, cosine, sine = steady_harmonics(made.times, made.displacements["tip"], frequency)
            read.append(cosine - 1j * sine)
            if len(read) >= 3:
                a, b, c = read[-3:]
                limits.append(c - (c - b) ** 2 / (c - 2 * b + a))
        return abs(limits[-1]), first


def main() -> None:
    """Write the test."""
    began = time.time()
    model, static = truth()
    modes = solve_modes(at_rest(model), n_modes=8)
    print("frequencies at rest, Hz:", np.round(modes.frequencies_hz, 3))
    first = modes.frequencies_hz[0]
    rng = np.random.default_rng(SEED)
    rows, loops = [], []
    for level in LEVELS:
        shaker, found = Shaker(model, static), []
        for frequency in first * (1 + ZETA * SWEEP):
            now, start = shaker.amplitude(level, frequency)
            found.append((frequency, now * (2 * np.pi * frequency) ** 2))
            print(
                f"{level:g} N {frequency:.4f} Hz {found[-1][1]:.4f} m/s2, {now / start - 1:+.2%} "
                f"from the start, {time.time() - began:.0f} s",
                flush=True,
            )
        rows += [(level, f, a * (1 + NOISE * rng.standard_normal())) for f, a in found]
        if level == LEVELS[-1]:
            loops = loop(shaker, level, max(found, key=lambda pair: pair[1])[0], rng)
    head = describe(modes.frequencies_hz)
    write("frf.csv", head, "level [N],frequency [Hz],amplitude [m/s2]", rows)
    write("loops.csv", head, "frequency [Hz],time [s],force [N],response [m/s2]", loops)


def loop(shaker: Shaker, level: float, frequency: float, rng) -> list[tuple]:
    """Force and acceleration over the last of many periods at one frequency."""
    shaker.start(level, frequency)
    shaker.run(level, frequency, 60)
    made = shaker.run(level, frequency, 2)
    t, a = made.times[-STEPS:], made.accelerations["tip"][-STEPS:]
    a = a + NOISE * np.abs(a).max() * rng.standard_normal(len(a))
    force = level * np.cos(2 * np.pi * frequency * t)
    return list(zip(np.full(len(t), frequency), t - t[0], force, a, strict=True))


def describe(frequencies) -> list[str]:
    """The head of the files: how the test was made."""
    bending = ", ".join(f"{f:.3f}" for f in frequencies)
    return [
        "Virtual test of the lap beam, made by virtual_test.py: time integration of two beams in",
        f"contact, preload {PRELOAD:g} N, friction {CONTACT['friction']:g}, contact stiffness",
        f"{CONTACT['normal_stiffness']:g} Pa/m normal, {CONTACT['tangential_stiffness']:g} Pa/m "
        f"tangential, shank {SHANK:g} m,",
        f"viscous damping {ZETA:g}, shaker at x = {SHAKER:g} m, accelerometer {ACCELEROMETER:g} kg "
        "at the tip.",
        f"Modes at rest, Hz: {bending}.",
        f"Noise {NOISE:g} of the amplitude. The response is the acceleration of the tip.",
    ]


def write(name: str, head: list[str], columns: str, rows) -> None:
    """Write a table under its head."""
    lines = [f"# {line}" for line in head] + [columns]
    lines += [",".join(f"{value:.6g}" for value in row) for row in rows]
    (HERE / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if MPI.COMM_WORLD.size > 1:
        sys.exit("virtual_test.py: expected one process")
    main()

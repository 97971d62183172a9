# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # The Brake-Reuss beam: what six frequencies and eight levels say about a lap
#
# Two steel beams, cut to half their height where they overlap, are held by three bolts and hung
# free. This is a benchmark of the jointed-structures community with a public test (source in
# `README.md`): six bending frequencies from a hammer test, and frequency and damping of the first
# mode at eight levels of acceleration, from 5 to 80 m/s2.
#
# Run it with `./with-fenicsx python3 demos/half_lap_beam/demo_half_lap_beam.py [PICTURE]`, on as
# many ranks as you like. The mesh is coarser than that of `case.toml`, to save time.

# +
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.harmonic.model import harmonic_model
from fenics_joints.commands.update.run import run_update
from fenics_joints.harmonic import solve_backbone
from fenics_joints.measurements import pair_modes
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress

comm = MPI.COMM_WORLD
here = Path(__file__).parent


def coarse(name: str):
    """A case of this folder with a coarser mesh."""
    case = load_case(here / name)
    mesh = case.mesh.model_copy(update={"n_length": 8, "n_lap": 8, "n_width": 2})
    return case.model_copy(update={"mesh": mesh})


def say(*lines: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(*lines, sep="\n", flush=True)


def row(name: str, values, digits: int = 2) -> str:
    """A line of numbers."""
    return f"{name:44s}" + "".join(f"{v:10.{digits}f}" for v in values)


case = coarse("case.toml")
test = case.measurements().frequencies_hz[0]
# -

# ## Six frequencies
#
# With the lap bonded, the first mode of the model is about half as high again as the measured one.
# A layer with two fitted stiffnesses, normal and tangential, is enough for all six modes.

structure = build_structure(case, comm)


def frequencies(values) -> np.ndarray:
    """Frequencies, Hz, of the modes that were measured."""
    modes = solve_modes(structure, values, n_modes=22)
    return modes.frequencies_hz[pair_modes(modes, len(test), case.sensors()).index]


bonded = frequencies({"lap.E": 194e9, "lap.G": 75e9})
found = run_update(case, comm).result
identified = {p["name"]: p["value"] for p in found.parameters}
say(
    row("measured, Hz", test),
    row("lap as one, %", 100 * (bonded / test - 1)),
    row("lap's layer identified, %", 100 * (found.modes.after / test - 1)),
    *(f"  {name} {value / 1e-4 / 1e9:.3g} GPa/m" for name, value in identified.items()),
)
assert bonded[0] > 1.4 * test[0]
assert np.abs(found.modes.after / test - 1).max() < 0.02

# ## Eight levels
#
# First a check that needs no joint model. At resonance, acceleration over force at the same point
# is phi^2 / (2 zeta), where phi is the mode shape at unit modal mass. From measured damping and
# force:

level = np.array([5, 20, 30, 40, 50, 60, 70, 80.0])  # m/s2
hz, zeta = (
    np.loadtxt(here / f"{name}_at_levels.csv", delimiter=",", skiprows=1)[:, 1]
    for name in ("frequencies", "damping")
)
force = np.array([0.0296, 0.1502, 0.2785, 0.4859, 0.7689, 1.1112, 1.5664, 2.0735])  # N
participation = 2 * zeta * level / force
slipping = coarse("slipping.toml")
built = harmonic_model(slipping, comm, Progress(silent=True))
modes = solve_modes(built.model, n_modes=built.mode + 1)
phi = float(built.model.row("sensors", "sensor") @ modes.vector(built.mode))
say("", row("measured phi^2, 1/kg", participation, 3), f"model's phi^2 {phi**2:.3f} 1/kg")
assert abs(phi**2 / participation.mean() - 1) < 0.15

# Now the lap slips: its shear stress follows Richard and Abbott's curve without hardening, with
# Masing's rule. The beam hangs free, so the response includes its rigid-body motions.

w = 2 * np.pi * built.frequencies_hz[built.mode]
backbone = solve_backbone(
    built.model,
    (0.8 * level[0] / w**2, 1.1 * level[-1] / w**2),
    harmonics=3,
    sensor="sensor",
    near=float(built.frequencies_hz[built.mode]),
    comm=comm,
)
reached = backbone.amplitude("sensor", "acceleration")
damping = np.interp(level, reached, backbone.damping_ratios)
softer = np.interp(level, reached, backbone.frequencies_hz)
say(
    "",
    row("level, m/s2", level, 0),
    row("damping measured, %", 100 * zeta, 3),
    row("damping with slip, %", 100 * damping, 3),
    row("frequency measured, Hz above its lowest", hz - hz.min(), 3),
    row("frequency with slip, Hz above 80 m/s2", softer - softer[-1], 3),
)
assert np.abs(damping[:5] / zeta[:5] - 1).max() < 0.12
assert softer[0] - softer[-1] > 0.3 and hz[-1] > hz[0]

# Slip explains how the damping grows. It does not explain the frequency. Masing's rule ties
# softening to damping: the model's frequency falls by more than 0.5 Hz, while the measured one
# falls by half of that and rises again. So something also stiffens as the amplitude grows, and no
# law made of sliders does that.

# ## A picture
#
# Damping and frequency over the level, drawn if a path is given.


def picture(path: str) -> None:
    """Draw the measured and the computed mode over its amplitude."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(level, 100 * zeta, "o", label="test")
    left.plot(reached, 100 * backbone.damping_ratios, "-", label="lap that slips")
    left.set(xlabel="acceleration at 85 mm, m/s2", ylabel="damping, %")
    left.legend()
    right.plot(level, hz, "o", label="test")
    right.plot(reached, backbone.frequencies_hz, "-", label="lap that slips")
    right.set(xlabel="acceleration at 85 mm, m/s2", ylabel="frequency, Hz")
    right.legend()
    figure.savefig(path, dpi=130)


if comm.rank == 0 and len(sys.argv) > 1:
    picture(sys.argv[1])

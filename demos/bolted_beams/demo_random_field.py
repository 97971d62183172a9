# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # A joint that varies along the lap: random fields on the interface
#
# The paper behind this demo (Jalali et al. 2019, see `README.md`) makes the normal stiffness k1 and
# the tangential stiffness k2 random: k_i = k_i0 (1 + eps f_i), where f_i is a random field over the
# interface. It then takes one random variable for the whole lap.
#
# This demo shows the effect of that choice. Each of the five joint elements gets its own k1 and k2,
# with a correlation length along the lap. A correlation length much longer than the lap amounts to
# one variable, a much shorter one to five independent variables.
#
# Run it with `./with-fenicsx python3 demos/bolted_beams/demo_random_field.py [PICTURE]`, on as many
# ranks as you like. It takes some seconds.

# +
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.random_fields import (
    Moments,
    RandomField,
    karhunen_loeve,
    propagate_samples,
    propagate_sensitivities,
)
from fenics_joints.reduction import ModalPrediction, narrow

comm = MPI.COMM_WORLD
EPS, N = 0.034, 400


def say(*lines: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(*lines, sep="\n", flush=True)


def row(name: str, values, digits: int = 2) -> str:
    """A line of numbers."""
    return f"{name:30s}" + "".join(f"{v:8.{digits}f}" for v in values)


# -

# ## The lap in five zones
#
# The case has one joint. Here each of the five elements of the lap is a separate joint, which makes
# ten stiffnesses. `narrow` makes a reduced model that depends on these alone and is small enough to
# be sampled. It also gives the error of its frequencies for stiffnesses within a factor of 1.3.

# +
case = load_case(Path(__file__).parent)
lap = case.joints["lap"]
zones = [f"zone_{i + 1}" for i in range(5)]
mesh = case.mesh.model_copy(update={"lap_zones": [1] * 5})
joints = {zone: lap.model_copy(update={"cells": [zone]}) for zone in zones}
beams = build_structure(case.model_copy(update={"mesh": mesh, "joints": joints}), comm)
sensors = case.sensors()
names = {key: [f"{zone}.{key}" for zone in zones] for key in ("k1", "k2")}
mean = {name: beams.values()[name] for key in names for name in names[key]}
ranges = {name: (k / 1.3, 1.3 * k) for name, k in mean.items()}
small = narrow(beams.arrays(sensors), ranges, 14, tolerance=2e-5)
forward = ModalPrediction(small.model, sensors, 8, 14)
say(
    f"small model: {small.model.n_dofs} vectors for {len(mean)} stiffnesses, error of a frequency "
    f"{small.error:.0e} at {small.n_checked} points"
)
# -

# ## The fields
#
# The midpoints of the elements are 10 mm apart. The Karhunen-Loeve expansion shows how many
# independent variables a field of a given correlation length needs. Here all of them are kept.

# +
places = (np.arange(5) + 0.5) * case.mesh.laps[0] / 5
LENGTHS = {"one variable": None, "100 mm": 0.1, "30 mm": 0.03, "10 mm": 0.01, "2 mm": 0.002}


def fields(length: float | None) -> list[RandomField]:
    """k1 and k2 as independent fields."""
    series = None if length is None else karhunen_loeve(places, length, n_terms=5)
    return [RandomField(tuple(names[key]), EPS, series) for key in names]


say("", "share of the variance in the first terms, %")
for name, length in LENGTHS.items():
    if length is not None:
        values = karhunen_loeve(places, length, n_terms=5).eigenvalues
        say(row(name, 100 * np.cumsum(values) / values.sum(), 1))
# -

# ## Scatter of the frequencies
#
# It is computed in two ways: by samples, each of which is solved, and by sensitivities, which are
# first and second derivatives at the mean. Both give the same result. A field that varies along the
# lap averages out, so the frequencies scatter less. Different modes bend the lap at different
# places, so their frequencies also correlate less.


# +
def apart(moments: Moments) -> float:
    """Mean of the correlations of different modes."""
    return float(np.mean(moments.correlation[np.triu_indices(8, 1)]))


drawn, linear = {}, {}
for name, length in LENGTHS.items():
    drawn[name] = propagate_samples(forward, fields(length), mean, N, seed=5)
    linear[name] = propagate_sensitivities(forward, fields(length), mean)
nominal = np.exp(forward(beams.values() | mean)[0])
say("", f"scatter of the frequencies, %, for {100 * EPS:g} % in k1 and k2; mean correlation")
for name in LENGTHS:
    for how, found in (("samples", drawn[name]), ("sensitivities", linear[name])):
        line = row(f"{name}, {how}", 100 * found.sd / nominal, 3)
        say(f"{line}{apart(found):8.2f}")
say("", row("shift of the mean, 1e-6", 1e6 * (linear["one variable"].mean / nominal - 1), 0))

chance = 4 / np.sqrt(2 * N)
for name in LENGTHS:
    assert np.allclose(drawn[name].sd, linear[name].sd, rtol=chance)
    assert np.allclose(drawn[name].correlation, linear[name].correlation, atol=0.16)
scatter = [linear[name].sd for name in LENGTHS]
assert np.all(np.diff(scatter, axis=0) < 0)
assert apart(linear["2 mm"]) < apart(linear["one variable"])
# -

# ## A picture

if comm.rank == 0 and len(sys.argv) > 1:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6.5), layout="constrained")
    top, below = figure.subfigures(2, 1)
    shown = ("one variable", "30 mm", "2 mm")
    for axes, name in zip(top.subplots(1, 3, sharey=True), shown, strict=True):
        k2 = drawn[name].parameters[:, 5:] / 1e3
        edges = 1e3 * np.linspace(0, case.mesh.laps[0], 6)
        for i, sample in enumerate(k2[:8]):
            axes.stairs(sample, edges, color=f"C{i}", lw=1.3, baseline=None)
        what = name if LENGTHS[name] is None else f"correlation length {name}"
        axes.set(title=what, xlabel="place in the lap, mm", ylabel="k2 of a specimen, kN·m")
        axes.label_outer()
    left, *squares = below.subplots(1, 3, width_ratios=[1.4, 1, 1])
    modes = np.arange(1, 9)
    for i, name in enumerate(LENGTHS):
        left.plot(modes, 100 * linear[name].sd / nominal, color=f"C{i}", label=name)
        left.plot(modes, 100 * drawn[name].sd / nominal, "o", ms=4, color=f"C{i}")
    left.set(
        xlabel="mode",
        ylabel="scatter of the frequency, %",
        ylim=(0, 0.45),
        title="lines: sensitivities; dots: samples",
    )
    left.legend(fontsize="small", loc="upper right", ncols=2)
    for axes, name in zip(squares, ("one variable", "2 mm"), strict=True):
        image = axes.imshow(
            drawn[name].correlation, vmin=0, vmax=1, cmap="viridis", extent=(0.5, 8.5, 8.5, 0.5)
        )
        axes.set(
            title=f"correlation: {name}", xlabel="mode", ylabel="mode", xticks=modes, yticks=modes
        )
    below.colorbar(image, ax=squares, shrink=0.8)
    figure.savefig(sys.argv[1], dpi=110)

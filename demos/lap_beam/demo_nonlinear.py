# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # A bolted lap beam: how a joint slips, from the response to one force
#
# The larger the force on a bolted beam, the lower is its first resonance and the higher its
# damping. The paper of this demo (Iranzad and Ahmadian 2012, see `README.md`) models this by a thin
# layer that yields. Its eq. 4 is the stress over the strain, with stiffness E_e at rest, E_p when
# all of the layer slips, and a strength S_y. E_p and S_y are found from the response to 6 N alone;
# the responses to 3 and 1.5 N are predicted.
#
# The paper shows its measured curves only as figures. The test here is therefore another model: two
# beams in contact with friction under the paper's preload of 120 N, integrated in time, with 1 % of
# noise (`virtual_test.py`, whose output is `frf.csv`).
#
# Run it with `./with-fenicsx python3 demos/lap_beam/demo_nonlinear.py [PICTURE]`, on as many ranks
# as you like. `stage_two.py` computes the other numbers of `README.md`.

# +
import sys

import numpy as np
from stage_two import (
    COMM,
    HERE,
    POINTS,
    H,
    beams,
    bolt_and_accelerometer,
    identified,
    layer_law,
    linear_stage,
    nonlinear_model,
    options,
    read_test,
    say,
    tell,
    tell_errors,
)

from fenics_joints.harmonic import predict
from fenics_joints.measurements import read_curves

test, curves = read_test(), read_curves(HERE / "frf.csv", "acceleration")
for level in curves.levels:
    f, a = curves.at(level)
    say(f"{level:g} N: largest {a.max() / level:.2f} m/s2 per N, at {f[a.argmax()]:.2f} Hz")
# -

# ## Stage one: the layer at rest, from low-level frequencies
#
# This stage uses the same coarse mesh as the next, so that the layer makes up for errors of the
# mesh.

structure = beams(bolt_and_accelerometer(5.7e-3, 10e-3))
(E, G), frequencies = linear_stage(structure, test.frequencies_hz)
say(
    f"the layer's normal stiffness {E / H / 1e9:.0f} GPa/m (not determined further)",
    "first three bending frequencies: " + ", ".join(f"{f:.2f}" for f in frequencies) + " Hz",
)

# ## Stage two: how it yields, from the response to 6 N
#
# The equivalent stress of the layer, from opening and slip together, follows eq. 4 when it loads,
# and Masing's rule when it unloads and reloads. Harmonic balance gives the response and its exact
# derivatives by E_p and S_y.

start = {"lap.E_p": 0.02 * E, "lap.S_y": 6e4}
model = nonlinear_model(
    structure, layer_law(E, G, *start.values(), 2.5), E, G, test.shaker, test.damping
)
linear = predict(model.with_parameters({"lap.S_y": 1e9}), curves, points=POINTS, **options())
found, predictions = identified(model, curves, start, "gradient")
say("", "a layer that never yields")
tell_errors(linear)
tell("identified from 6 N", found, predictions)

# The law identified at one level predicts the amplitudes at the others to a few per cent. A layer
# that never yields is off by up to several times as much.

for before, after in zip(linear, predictions, strict=True):
    assert after.mean_error < 0.08
    assert abs(after.frequency_error) < 1e-3
    assert after.mean_error < 0.5 * before.mean_error or after.level == min(curves.levels)
assert found.evaluations < 40

# ## A picture
#
# If a path was given: amplitude per force, and the objective of the search.


def picture(path: str) -> None:
    """Draw amplitude per force over frequency, and the objective over the search."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2, 1))
    for i, p in enumerate(predictions):
        f = p.frequencies_hz
        left.plot(f, p.measured / p.level, "o", color=f"C{i}", label=f"{p.level:g} N, test")
        name = "identified" if p.level == found.level else "predicted"
        left.plot(f, p.computed / p.level, "-", color=f"C{i}", label=f"{p.level:g} N, {name}")
    left.set(xlabel="frequency, Hz", ylabel="tip acceleration per force, m/s2/N")
    left.legend(fontsize="small")
    history = np.where(np.isfinite(found.history), found.history, np.nan)
    right.semilogy(history, "o-")
    right.set(xlabel="response", ylabel="eq. 6")
    figure.savefig(path, dpi=130)


if COMM.rank == 0 and len(sys.argv) > 1:
    picture(sys.argv[1])

# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # Two C-shaped beams: how much of a bolted joint is in contact
#
# Two steel beams touch on pads at their ends, and a bolt at each end presses them together. The
# paper behind this demo (Fronk et al. 2019, see `README.md`) measured the first six elastic modes
# of the free assembly. The frequencies of its model with the pads fully stuck are 1 to 5 % too
# high. It corrects them by one number, the cut-off pressure: where the contact pressure is lower,
# the pads are taken as not stuck.
#
# This demo computes the contact pressure from the bolt preload, the frequencies at every cut-off
# pressure, and the cut-off pressure that fits the test best. `case.toml` has all numbers with their
# sources. Here the mesh is far coarser, to be quick.
#
# Run it with `./with-fenicsx python3 demos/c_beam/demo_c_beam.py [PICTURE]`, on as many ranks as
# you like.

# +
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import build_preload, load_case
from fenics_joints.commands.cutoff import run_cutoff
from fenics_joints.modal import solve_modes
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.preload.torque import motosh_force

comm = MPI.COMM_WORLD
case = load_case(Path(__file__).parent)
coarse = {"element_size": 8e-3, "radial_size": 4e-3, "middle_size": 60e-3, "n_thickness": (1, 1)}
quick = case.update.cutoff.model_copy(update={"max_solves": 6})
case = case.model_copy(
    update={
        "mesh": case.mesh.model_copy(update=coarse),
        "update": case.update.model_copy(update={"cutoff": quick}),
    }
)


def say(*lines: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(*lines, sep="\n", flush=True)


def row(name: str, values, digits: int = 1) -> str:
    """A line of six numbers."""
    return f"{name:34s}" + "".join(f"{v:9.{digits}f}" for v in values)


# -

# ## From the torque to the bolt force
#
# The bolts are 5/16-24. Motosh's equation (the paper's eq. 8) gives the force for a torque. The
# paper prints three pairs of torque and force, but not the friction; 0.107 reproduces them.

forces = [motosh_force(torque, "5/16-24", 0.107, 0.107) for torque in (10.2, 16.9, 25.1)]
say("bolt force at 10.2, 16.9, 25.1 N·m, kN: " + ", ".join(f"{f / 1e3:.1f}" for f in forces))
assert np.allclose(forces, [8.6e3, 14.3e3, 21.2e3], rtol=6e-3)  # Table 3

# ## Fully stuck
#
# In this model the pads are stuck all over, and the bolts are beams between rigid spiders. It has
# four accelerometers of 20 g, whose places the paper does not print.

stuck = solve_modes(LinearJoint(build_preload(case, comm)), n_modes=12)
ours = stuck.frequencies_hz[stuck.n_rigid :]
printed = np.array([271, 338, 483, 571, 744, 892])  # Table 1, FEA
test = case.measurements().frequencies_hz[0]
say(
    f"{stuck.model.n_dofs} unknowns",
    row("measured, Hz", test),
    row("the paper's stuck model, Hz", printed),
    row("ours, Hz", ours),
    row("ours against the paper's, %", 100 * (ours / printed - 1)),
)
assert np.all(np.abs(ours / printed - 1) < 0.045)

# Modes 7 and 11 open and close the joint, and mode 12 shears it (the paper also counts the six
# rigid-body modes). These three are the modes whose frequencies are too high.

# ## Every cut-off pressure
#
# `run_cutoff` calibrates Young's modulus on mode 10, which hardly depends on the joint. It solves
# the contact at the case's 28 kN, and computes the six frequencies as one facet after the other
# falls below the cut-off pressure. These facets are open ("two" conditions) or slide ("three").

found = run_cutoff(case, comm).result
peak = found.contacts[0]["peak_pressure_pa"]
say(
    "",
    f"E {found.calibration['value'] / 1e9:.1f} GPa, from mode 10",
    f"peak pressure {peak / 1e6:.1f} MPa at 28 kN, contact on "
    f"{found.contacts[0]['area_m2'] * 1e6:.0f} of {found.whole_area * 1e6:.0f} mm²",
)
for scheme in found.schemes:
    say(
        f"{scheme.scheme} conditions: best cut-off {scheme.cutoff / 1e6:.1f} MPa, "
        f"{scheme.cutoff / peak:.2f} of the peak; sum of errors {100 * scheme.objective:.1f} %",
        row("  frequencies there, Hz", scheme.frequencies_hz),
        row("  against the test, %", 100 * (scheme.frequencies_hz / test - 1), 2),
    )
before = float(np.sum(np.abs(found.stuck_hz / test - 1)))
say(f"fully stuck: sum of errors {100 * before:.1f} %")

# As in the paper, open facets fit far better than sliding ones, since sliding faces cannot clap.
# The paper's best cut-off, 23 MPa, is 0.47 of its peak pressure, 49 MPa. Our peak is higher,
# because our contact has no penalty stiffness that lets the faces overlap (see `README.md`). So
# only this ratio can be compared.

two, three = found.schemes
assert two.objective < 0.6 * three.objective < 0.6 * before
assert 0.3 < two.cutoff / peak < 0.6

# ## A picture
#
# Frequencies over the cut-off pressure, if a path was given.


def picture(path: str) -> None:
    """Draw the six frequencies over the cut-off pressure of both schemes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    words = {"two": "stuck or open", "three": "stuck, sliding or open"}
    for axes, scheme in zip(panels, found.schemes, strict=True):
        for j, hz in enumerate(scheme.sweep.frequencies_hz.T):
            axes.step(scheme.sweep.cutoffs / 1e6, hz, f"C{j}", label=found.mode_names[j])
            axes.axhline(test[j], color=f"C{j}", ls="--", lw=0.9)
        axes.axvline(scheme.cutoff / 1e6, color="0.6", lw=0.9)
        axes.set(title=words[scheme.scheme], xlabel="cut-off pressure, MPa", ylim=(200, 950))
    panels[0].set_ylabel("frequency, Hz (dashed: measured)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=6)
    figure.savefig(path, dpi=130)


if comm.rank == 0 and len(sys.argv) > 1:
    picture(sys.argv[1])

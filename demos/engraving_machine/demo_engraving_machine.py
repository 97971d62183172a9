# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # Which of a machine's 16 bolts matter?
#
# The last section of "A Three-Dimensional Transition Interface Model for Bolt Joint" ("the paper",
# Machines 2022, 10, 511) is about an engraving machine: a cast bed and a cast column, joined by 16
# M12 bolts. Each bolt is modelled as a ring of "transition material" between the flanges. The paper
# prints the bolts, the materials and five frequencies; the figure with the dimensions is lost.
#
# So the frame here is a **stand-in**: a bed and a column whose overall dimensions were fitted to
# the five frequencies that the paper computed (Table 12). Their agreement therefore validates
# nothing. The demo shows how the frequencies depend on the modulus and thickness of the rings,
# which bolts matter to which mode, and what one loose bolt changes.
#
# Run it with `./with-fenicsx python3 demos/engraving_machine/demo_engraving_machine.py [PICTURE
# [SIZE]]`, on as many ranks as you like. SIZE is the size of the elements in mm. The default is
# that of `case.toml`, 150, which is quick; 30 has more degrees of freedom than the paper's model
# and needs 8 GB.

# +
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.stats import spearmanr

from fenics_joints.case import build_mesh, build_structure, load_case
from fenics_joints.database import query, seed_database
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce

comm = MPI.COMM_WORLD
case = load_case(Path(__file__).parent)
if len(sys.argv) > 2:
    size = {"element_size": 1e-3 * float(sys.argv[2])}
    case = case.model_copy(update={"mesh": case.mesh.model_copy(update=size)})
RIGID, SHOWN = 6, 5
first_five = np.arange(RIGID, RIGID + SHOWN)


def say(*lines: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(*lines, sep="\n", flush=True)


def row(name: str, values, form: str = "9.2f") -> str:
    """A line of numbers."""
    return f"{name:32s}" + "".join(f"{v:{form}}" for v in values)


# -

# ## The rings, from the database
#
# The input is an M12 bolt, a tightening torque of 120 N·m and flanges of 25 mm. The database gives
# the radius to which the flanges touch (Kriging over the paper's contact analyses) and the material
# of the ring (from the nearest identified joint).

answer = query(seed_database(), bolt="M12", torque=120.0, thickness=25e-3, roughness=1.6e-6)
ring = answer.identified
say(
    f"bolt force {answer.force / 1e3:.1f} kN; contact radius {1e3 * answer.radius.value:.1f} mm, "
    f"95 % {1e3 * answer.radius.low:.1f} to {1e3 * answer.radius.high:.1f} mm",
    f"ring: E {ring.E / 1e6:.0f} MPa, nu {ring.nu:.3f}, h {1e3 * ring.h:.2f} mm",
)
assert abs(answer.radius.value - case.mesh.r_wai) < 0.1e-3
in_case = [(joint.E, joint.nu, joint.h) for joint in case.joints.values()]
assert np.allclose(in_case, (ring.E, ring.nu, ring.h))

# ## Ten modes of the free frame

tagged = build_mesh(case, comm)
model = build_structure(case, comm, tagged=tagged)
modes = solve_modes(model, n_modes=RIGID + 10, tolerance=1e-8)
assert modes.n_rigid == RIGID
hz = modes.frequencies_hz[first_five]
computed = np.array([147.14, 155.05, 218.68, 237.39, 439.65])  # Table 12
measured = np.array([145.81, 155.07, 216.61, 244.13, 441.46])
say(
    "",
    f"{model.n_dofs} unknowns, {model.total_mass():.0f} kg, six rigid-body modes",
    row("STAND-IN, Hz", hz),
    row("the paper's machine, computed", computed),
    row("the paper's machine, measured", measured),
    row("stand-in against computed, %", 100 * (hz / computed - 1)),
    row("modes 6 to 10 of the stand-in", modes.frequencies_hz[RIGID + SHOWN :]),
)
# The dimensions were fitted to these frequencies on the fine mesh.
assert np.all(np.abs(hz / computed - 1) < 0.06)

# ## Which bolts matter
#
# One adjoint evaluation for each mode gives the derivatives by all 16 moduli at once: d ln f / d ln
# E, the percentage by which a frequency rises when the modulus of one ring rises by 1 %. The frame
# is symmetric about x = 0, so bolts come in pairs.

names = list(model.parameters)
slopes = modes.gradients(first_five) / (2 * modes.eigenvalues[first_five, None])
n_bolts = len(case.joints)


def by(key: str) -> np.ndarray:
    """d ln f / d ln p of each mode by one property of each bolt's ring, shape (5, 16)."""
    found = [names.index(f"ring_{i + 1}.{key}") for i in range(n_bolts)]
    return slopes[:, found] * [model.parameters[names[i]].value for i in found]


by_E, by_h = by("E"), by("h")
x, y = tagged.points["bolts"][:, :2].T
mirror = np.array([np.hypot(x + a, y - b).argmin() for a, b in zip(x, y, strict=True)])
left = np.flatnonzero(x < 1e-9)
say(
    "",
    "d ln f / d ln E of each bolt's ring, in 1e-6; the right half is the same as the left",
    row("bolt (x, y in mm)", range(1, SHOWN + 1), "9d"),
    *(
        row(f"{i + 1:2d}  ({1e3 * x[i]:5.0f}, {1e3 * y[i]:5.0f})", 1e6 * by_E[:, i], "9.1f")
        for i in left
    ),
    row("all 16 together, E", 1e6 * by_E.sum(axis=1), "9.1f"),
    row("all 16 together, h", 1e6 * by_h.sum(axis=1), "9.1f"),
)
assert np.allclose(by_E, by_E[:, mirror], rtol=1e-3, atol=1e-8)

# ## All rings together, from welded to loose
#
# The same frame with one modulus for all rings is reduced to its modes at four moduli. The curves
# over E and h then cost almost nothing. Their slopes at the values of Table 11 check the adjoint
# derivatives.

together = {"rings": case.joints["ring_1"].model_copy(update={"cells": list(case.joints)})}
common = build_structure(case.model_copy(update={"joints": together}), comm, tagged=tagged)
samples = [{"rings.E": ring.E * f} for f in (1, 3e-2, 1e-3, 25)]
small = reduce(common, samples, n_modes=RIGID + 7)


def curve(key: str, factors) -> np.ndarray:
    """The five frequencies, Hz, with one property of all rings times each factor."""
    value = common.parameters[key].value
    found = [solve_modes(small, {key: value * f}, n_modes=RIGID + SHOWN) for f in factors]
    return np.array([m.frequencies_hz[RIGID:] for m in found])


step = 1.02
for key, adjoint in (("E", by_E), ("h", by_h)):
    low, high = curve(f"rings.{key}", (1 / step, step))
    difference = np.log(high / low) / np.log(step**2)
    say(row(f"all 16 together, {key}, differences", 1e6 * difference, "9.1f"))
    assert np.allclose(adjoint.sum(axis=1), difference, rtol=0.02)
factors = np.logspace(-3, np.log10(25), 45)
over_E = curve("rings.E", factors)
thickness = np.linspace(0.25, 4, 31)
over_h = curve("rings.h", thickness)
say(
    "",
    row("all rings' E x 0.001, Hz", over_E[0]),
    row("all rings' E x 0.1, Hz", curve("rings.E", [0.1])[0]),
    row("as in Table 11, Hz", curve("rings.E", [1.0])[0]),
    row("E of cast iron (x 24.5), Hz", curve("rings.E", [150e9 / ring.E])[0]),
    row("h x 0.25, Hz", over_h[0]),
    row("h x 4, Hz", over_h[-1]),
)

# ## One loose bolt
#
# The ring of a loose bolt keeps a thousandth of its modulus. The model is solved again for each
# bolt and compared with the prediction by the derivatives of the tight state: f falls by
# 0.999 d ln f / d ln E.

loose, solver = {}, None
for i in left:
    given = {f"ring_{i + 1}.E": 1e-3 * ring.E}
    found = solve_modes(
        model, given, n_modes=RIGID + SHOWN + 1, solver=solver, initial=modes, tolerance=1e-5
    )
    solver = found.solver
    loose[i] = found.frequencies_hz[first_five] / hz - 1
exact = np.array([loose[i] if i in loose else loose[mirror[i]] for i in range(n_bolts)])
foretold = -0.999 * by_E.T
say("", "change of the frequencies by one loose bolt, %", row("bolt", range(1, SHOWN + 1), "9d"))
say(*(row(f"{i + 1:2d}", 100 * exact[i], "9.4f") for i in left))
worst = left[np.abs(exact[left]).argmax(axis=0)]
# Rank correlation over the bolts, each pair once: 1 if the derivatives give the right order.
agree = [spearmanr(exact[left, j], foretold[left, j]).statistic for j in range(SHOWN)]
ratio = np.median(exact[left] / foretold[left], axis=0)
say(
    row("worst bolt", worst + 1, "9d"),
    row("rank correlation with foretold", agree),
    row("exact over foretold, median", ratio, "9.1f"),
)
assert np.all(exact < 1e-6) and np.all(ratio > 1) and np.mean(agree) > 0.7

# ## A picture
#
# Drawn if a path is given: the frame with the column lifted, the five mode shapes, the
# derivatives by bolt, and the curves.


def parts() -> np.ndarray:
    """0 for cells of the bed, 1 of the column, 2 of rings, in the order of `corner_motion`."""
    owned = tagged.mesh.topology.index_map(tagged.mesh.topology.dim).size_local
    tags = tagged.cell_tags.values[np.argsort(tagged.cell_tags.indices)][:owned]
    kinds = np.minimum(tags - tagged.cell_tag("bed"), 2)
    gathered = comm.gather(kinds)
    return np.concatenate(gathered) if comm.rank == 0 else kinds


if len(sys.argv) > 1:
    corners, motions = model.corner_motion([modes.vector(int(i)) for i in first_five])
    part = parts()
    if comm.rank == 0:
        from drawing import Story, draw

        story = Story(
            corners,
            part,
            motions,
            hz,
            np.column_stack([x, y]),
            by_E,
            exact,
            foretold,
            (factors, over_E),
            (thickness, over_h),
        )
        draw(story, sys.argv[1], f"{case.title}: {model.n_dofs} unknowns")

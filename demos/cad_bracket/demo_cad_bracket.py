# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # From a STEP file to the bolts that matter
#
# A bracket is bolted on a plate with four M12. The assembly is a STEP file, as any CAD program
# writes it. `case.toml` beside this file names the solids by their labels and gives the thread and
# torque of the bolts. The faces that touch, the holes and the contact radius are found
# automatically. A ring of transition material around each bolt (see `README.md`) joins the parts.
#
# Run it with `./with-fenicsx python3 demos/cad_bracket/demo_cad_bracket.py [PICTURE]`, on as many
# ranks as you like. To use your own file, change the first lines of `case.toml`.

# +
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import build_mesh, build_structure, load_case
from fenics_joints.meshes import check_mesh, measure_ring
from fenics_joints.modal import solve_modes

comm = MPI.COMM_WORLD
case = load_case(Path(__file__).parent)


def say(*lines: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(*lines, sep="\n", flush=True)


# -

# ## From the file to a mesh
#
# The bracket is moved up by the thickness of the layer, 0.72 mm, so that only the rings connect the
# two parts. `measure_ring` measures the rings, and `check_mesh` counts the bodies.

tagged = build_mesh(case, comm)
rings = [measure_ring(tagged, f"ring_{number}") for number in (1, 2, 3, 4)]
for ring in rings:
    x, y, _ = ring.centre * 1e3
    say(
        f"{ring.name} at {x:.1f}, {y:.1f} mm from {1e3 * ring.r_nei:.2f} to "
        f"{1e3 * ring.r_wai:.1f} mm, {1e3 * ring.thickness:.2f} mm thick"
    )
assert check_mesh(tagged).bodies == 1
assert np.allclose([ring.r_nei for ring in rings], 13.5e-3 / 2, rtol=1e-6)

# ## Modes of the free assembly

structure = build_structure(case, comm, tagged=tagged)
modes = solve_modes(structure, n_modes=11)
elastic = np.arange(modes.n_rigid, len(modes))
frequencies = modes.frequencies_hz[elastic]
assert modes.n_rigid == 6
say("frequencies, Hz: " + ", ".join(f"{f:.0f}" for f in frequencies))

# ## Which bolts matter
#
# One adjoint evaluation gives the derivative of each frequency by all parameters. The table has 100
# times the relative change of a frequency over that of the modulus of a bolt's ring. Bolts 1 and 2
# mirror bolts 3 and 4, so their numbers agree except for the mesh. Each mode's sum over all moduli
# (rings, plate and bracket) is 50.

names = list(structure.parameters)
gradients = modes.gradients(elastic)
columns = [names.index(f"bolt_{number}.E") for number in (1, 2, 3, 4)]
moduli = np.array([structure.parameters[names[i]].value for i in columns])
slopes = gradients[:, columns] * moduli / (2 * modes.eigenvalues[elastic])[:, None]
say("", "100 d ln f / d ln E of the rings of", "bolt         1       2       3       4")
for number, row in enumerate(100 * slopes, start=1):
    say(f"mode {number}" + "".join(f"{value:8.3f}" for value in row))
assert np.allclose(slopes[:, :2], slopes[:, 2:], rtol=0.1, atol=1e-4)
iron = gradients[:, names.index("iron.E")] * structure.parameters["iron.E"].value
assert np.allclose(slopes.sum(axis=1) + iron / (2 * modes.eigenvalues[elastic]), 0.5, rtol=1e-5)

# ## One bolt loose
#
# The modulus of one ring falls by a factor of 1000. The first order (derivative times change) does
# not predict so large a change, but it ranks the bolts correctly: the bolt with the largest
# derivative of the first frequency lowers this frequency most when it is loose.

loose = []
for number in (1, 2):
    name = f"bolt_{number}.E"
    given = {name: structure.parameters[name].value / 1000}
    changed = solve_modes(structure, given, n_modes=11, solver=modes.solver, initial=modes)
    loose.append(100 * (changed.frequencies_hz[elastic] / frequencies - 1))
    say(f"bolt {number} loose, %: " + ", ".join(f"{change:.1f}" for change in loose[-1]))
assert np.all(np.array(loose) < 0.01)
assert np.argmin([change[0] for change in loose]) == np.argmax(slopes[0, :2])


# ## Picture


def draw(path: str) -> None:
    """The bolts on the bracket's foot, coloured by their derivative; a panel for each mode."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(slopes), figsize=(11, 2.4), layout="constrained")
    x, y = 1e3 * np.array([ring.centre[:2] for ring in rings]).T
    for number, (panel, row) in enumerate(zip(axes, 100 * slopes, strict=True)):
        panel.add_patch(plt.Rectangle((-80, 0), 160, 120, fill=False, color="#6b7280"))
        for centre, ring, value in zip(zip(x, y, strict=True), rings, row, strict=True):
            share = value / max(row.max(), 1e-9)
            colour, ink = plt.cm.YlOrRd(share), "white" if share > 0.6 else "black"
            panel.add_patch(plt.Circle(centre, 1e3 * ring.r_wai, color=colour))
            panel.add_patch(plt.Circle(centre, 1e3 * ring.r_nei, color="white"))
            panel.text(centre[0], centre[1] - 20, f"{value:.2f}", ha="center", size=8, color=ink)
        panel.set_title(f"mode {number + 1}, {frequencies[number]:.0f} Hz", fontsize=10)
        panel.set(xlim=(-85, 85), ylim=(-5, 125), aspect="equal", xticks=[], yticks=[])
        panel.set_axis_off()
    figure.suptitle("100 d ln f / d ln E of each bolt's ring, on the bracket's foot", fontsize=10)
    figure.savefig(path, dpi=150)


if comm.rank == 0 and len(sys.argv) > 1:
    draw(sys.argv[1])

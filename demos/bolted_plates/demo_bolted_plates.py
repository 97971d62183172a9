# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # Two bolted plates: how far they touch, beside a published table
#
# "A Three-Dimensional Transition Interface Model for Bolt Joint" (Machines 2022) computes how far
# two plates under one M12 bolt touch. R is the largest radius at which the pressure between them is
# still 1 MPa (its equation 10). The paper prints R for seven thicknesses and five forces (Table 2),
# and the mean pressure inside R (Table 3). It prints neither the washers nor the contact settings.
#
# This demo computes all 35 cases twice: with the assumptions that an engineer would make, and with
# the one change that `investigate.py` finds, a soft contact. It shows both beside the printed
# values. `README.md` has the details.
#
# Run it with `./with-fenicsx python3 demos/bolted_plates/demo_bolted_plates.py [PICTURE [CSV]]`,
# on as many ranks as you like.

# +
import csv
import sys
from importlib import resources

import numpy as np
from mpi4py import MPI
from rich import box
from rich.console import Console
from rich.table import Table

from fenics_joints.database import BoltedPlates, solve_bolted_plates

comm = MPI.COMM_WORLD
HOLE = 6.75e-3  # radius, m


def say(*things) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        console = Console(width=90, highlight=False, color_system=None)
        for thing in things:
            console.print(thing)


# -

# ## The published tables
#
# The package contains them as the first rows of its database.

with resources.files("fenics_joints.database").joinpath("seed000.csv").open() as file:
    rows = [r for r in csv.DictReader(file) if r["force [N]"] and r["radius [m]"]]
cells = {(float(r["force [N]"]), float(r["thickness [m]"])): r for r in rows}
forces, thicknesses = (np.unique([key[i] for key in cells]) for i in (0, 1))
printed_radius, printed_pressure = (
    np.array([[float(cells[f, t][name]) for t in thicknesses] for f in forces])
    for name in ("radius [m]", "pressure [Pa]")
)

# ## All 35 cases
#
# Without an initial gap the problem is homogeneous: twice the force gives twice the pressure on the
# same contact area. So one solution per thickness, at the force F0, covers all forces: the radius
# for 1 MPa at a force F is the radius for 1 MPa x F0 / F in this solution. The models are small, so
# each rank solves some of them.


def all_cases(settings: BoltedPlates) -> tuple[np.ndarray, np.ndarray]:
    """Radii, m, and mean pressures, Pa, of shape (5, 7)."""
    both = np.zeros((2, len(forces), len(thicknesses)))
    radius, pressure = both
    for j in range(comm.rank, len(thicknesses), comm.size):
        state = solve_bolted_plates("M12", thicknesses[j], forces[0], settings)["plates"]
        for i, force in enumerate(forces):
            level = settings.P_lim * forces[0] / force
            radius[i, j] = state.radius(level)
            pressure[i, j] = state.mean_pressure(level) * force / forces[0]
    return tuple(comm.allreduce(both))


rigid = all_cases(BoltedPlates())

# A check: the largest case, solved at its own force.

check = solve_bolted_plates("M12", thicknesses[-1], forces[-1], BoltedPlates())["plates"]
assert abs(check.radius(1e6) / rigid[0][-1, -1] - 1) < 1e-6
assert abs(check.mean_pressure(1e6) / rigid[1][-1, -1] - 1) < 1e-6

# With contact without penetration, no friction, and the load on rings of 24 mm (the diameter of the
# washers), every radius is smaller than printed. Other loads (washers or a whole bolt, with or
# without friction) change the radii by a few millimetres at most; `README.md` has the numbers.

assert np.all(rigid[0] < printed_radius)

# ## The missing assumption
#
# `investigate.py` compares what the paper may have assumed: sizes of washers and plates,
# thicknesses, friction, coarse meshes, other forces and limits. One assumption alone explains the
# table: a soft contact, as the penalty method gives it, with a stiffness of 1.0e12 Pa/m. The
# stiffness is fitted to the 35 radii; nothing else here is fitted.

soft = all_cases(BoltedPlates(penalty=1.03e12))


def rms(found: np.ndarray, printed: np.ndarray) -> float:
    """Root mean square of the relative error, in logarithms, %."""
    return 100 * float(np.sqrt(np.mean(np.log(found / printed) ** 2)))


def show(title: str, scale: float, *values: np.ndarray) -> Table:
    """A table with the printed, the rigid and the soft value in every cell."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("force\nkN", justify="right")
    for t in thicknesses:
        table.add_column(f"plates of\n{1e3 * t:.0f} mm", justify="right")
    for i, force in enumerate(forces):
        cells = np.transpose([scale * v[i] for v in values])
        texts = ["\n".join(f"{v:.1f}" for v in cell) for cell in cells]
        table.add_row(f"{force / 1e3:.1f}", *texts, end_section=True)
    return table


each = "in each cell printed, rigid contact, soft contact"
say(
    show(f"Contact radius, mm; {each}", 1e3, printed_radius, rigid[0], soft[0]),
    show(f"Mean pressure, MPa; {each}", 1e-6, printed_pressure, rigid[1], soft[1]),
)
for name, found in (("rigid", rigid), ("soft", soft)):
    say(
        f"{name} contact against the table, rms: radius {rms(found[0], printed_radius):.0f} %, "
        f"mean pressure {rms(found[1], printed_pressure):.0f} %"
    )

# With this one number the radii for plates of 20 mm (the paper's Table 1, read in steps of 0.91 mm)
# agree within 1.5 mm, and all 35 radii to 4 % rms.

assert np.all(np.abs(soft[0][:, 2] - printed_radius[:, 2]) < 1.5e-3)
assert rms(soft[0], printed_radius) < 4.5 < rms(rigid[0], printed_radius)

# ## A picture and a file
#
# The first argument is the path of a picture (radius over force), the second that of a CSV file
# with all numbers.


def picture(path: str) -> None:
    """Draw the radii over the force, a colour for each thickness."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    figure = Figure(figsize=(9, 4), layout="constrained")
    one, two = figure.subplots(1, 2, sharey=True)
    for j, thickness in enumerate(thicknesses):
        for axes, found in ((one, rigid), (two, soft)):
            axes.plot(forces / 1e3, 1e3 * found[0][:, j], f"C{j}-")
            axes.plot(forces / 1e3, 1e3 * printed_radius[:, j], f"C{j}o", ms=4)
        at = 63.5, 1e3 * soft[0][-1, j]
        two.annotate(f"{1e3 * thickness:.0f} mm", at, color=f"C{j}", va="center")
    two.set_xlim(10, 72)
    one.set(title="rigid contact", xlabel="force, kN", ylabel="contact radius, mm", ylim=(0, 72))
    two.set(title="soft contact, 1.03e12 Pa/m (fitted)", xlabel="force, kN")
    marks = [Line2D([], [], color="k", marker="o", ls="", ms=4), Line2D([], [], color="k")]
    one.legend(marks, ["printed (Table 2)", "computed"], loc="upper left")
    figure.savefig(path, dpi=130)


def write(path: str) -> None:
    """Write all cases as CSV."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        kinds = "printed", "rigid", "soft"
        heads = [f"{what}, {k} [{u}]" for what, u in (("R", "mm"), ("P", "MPa")) for k in kinds]
        table.writerow(["thickness [mm]", "force [kN]", *heads])
        for j, thickness in enumerate(thicknesses):
            for i, force in enumerate(forces):
                radii = (1e3 * v[i, j] for v in (printed_radius, rigid[0], soft[0]))
                pressures = (1e-6 * v[i, j] for v in (printed_pressure, rigid[1], soft[1]))
                numbers = [f"{v:.2f}" for v in (*radii, *pressures)]
                table.writerow([f"{1e3 * thickness:g}", f"{force / 1e3:g}", *numbers])


if comm.rank == 0 and len(sys.argv) > 1:
    picture(sys.argv[1])
if comm.rank == 0 and len(sys.argv) > 2:
    write(sys.argv[2])

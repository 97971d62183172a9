# # Updating a joint's stiffness
#
# The command `fenics-joints update demos/bolted_beams`, call by call: what the first five of eight
# measured frequencies say of a lap joint, and how the other three are predicted.

# +
from pathlib import Path

from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.commands.update.run import update_case

here = Path(__file__).parent if "__file__" in globals() else Path.cwd()
case = load_case(here.parents[1] / "demos" / "bolted_beams")
found = update_case(case, MPI.COMM_WORLD)
found.update
# -

# Before and after, mode by mode.

# +
before, after = found.modes.error_before, found.modes.error_after
for name, b, a in zip(found.modes.names, before, after, strict=True):
    print(f"{name:8} {100 * b:+7.2f} % {100 * a:+7.2f} %")
# -

# How well the data determine the values: a relative standard deviation for each.

# +
for name, sd in zip(found.update.names, found.update.relative_sd, strict=True):
    print(f"{name:8} {100 * sd:.2g} %")
assert found.update.converged

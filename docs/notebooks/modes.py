# # Modes, and a test beside them
#
# The command `fenics-joints modes demos/dumbbell`, call by call.

# +
from pathlib import Path

from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.commands.modes import run_modes
from fenics_joints.progress import Progress

here = Path(__file__).parent if "__file__" in globals() else Path.cwd()
case = load_case(here.parents[1] / "demos" / "dumbbell")
outcome = run_modes(case, MPI.COMM_WORLD, Progress(silent=True))
found = outcome.result
found.modes
# -

# The test's modes, each with its partner among the model's, by MAC.

# +
for name, test, model, mac in zip(
    found.beside.names, found.beside.test_hz, found.beside.model_hz, found.beside.mac, strict=True
):
    print(f"{name:15} {test:8.1f} Hz {model:8.1f} Hz   MAC {mac:.3f}")
assert found.modes.n_rigid == 6 and found.beside.mac.min() > 0.9
# -

# A shape is a function of DOLFINx, to be evaluated or written; `found.modes.to_pyvista(6)` gives it
# to pyvista (`pip install 'fenics-joints[view]'`), and `outcome.page()` is the page with the view.

shape = found.modes.shape(6)
print(shape.function_space.mesh.topology.cell_name(), len(shape.x.array))

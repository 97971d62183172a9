# # Where, which and how far
#
# The command `fenics-joints diagnose`, call by call, on lapped beams whose test was computed with a
# joint. The diagnosis starts from beams that are one piece over the lap, and has to find the joint.

# +
import csv
import tempfile
from pathlib import Path

from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.diagnosis import diagnose
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress

CASE = """
title = "Virtual beams"
[mesh]
builder = "offset_beams"
lengths = [0.36, 0.26]
laps = 0.05
width = 0.021
thickness = 0.0106
elements = [12, 9]
lap_elements = 5
[parts.beams]
cells = ["beam_1", "beam_2"]
E = "208 GPa"
nu = 0.3
rho = 7860.0
[joints.lap]
cells = "lap"
law = "generic"
k1 = 1763.2
k2 = 37402.0
bolted = true
[test]
frequencies = "frequencies.csv"
condition = "torque"
noise = "0.1 %"
"""
comm = MPI.COMM_WORLD
folder = Path(comm.bcast(tempfile.mkdtemp() if comm.rank == 0 else None))
# -

# The test: eight frequencies of the same beams with a joint, half as stiff against slip as the case
# says. A case is read with its test, so a first file holds its place.

# +
header = ["torque [N m]", *(f"mode {i + 1} [Hz]" for i in range(8))]
if comm.rank == 0:
    (folder / "case.toml").write_text(CASE)
    with (folder / "frequencies.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, [20, *(100.0 * (i + 1) for i in range(8))]])
comm.barrier()
beams = build_structure(load_case(folder), comm)
truth = solve_modes(beams, {"lap.k2": 0.5 * 37402.0}, n_modes=12)
hz = truth.frequencies_hz[truth.n_rigid :][:8]
if comm.rank == 0:
    with (folder / "frequencies.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, [20, *hz.round(3)]])
comm.barrier()
# -

found = diagnose(load_case(folder), comm, Progress(silent=True))
found

# The same in words; `commands.diagnose.run.run_diagnose` makes the page with the view.

for name, sentence in explain(found).sentences:
    print(f"{name}. {sentence}\n")
assert found.before.rms > 0.005

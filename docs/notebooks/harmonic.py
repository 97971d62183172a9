# # A joint that slips: frequency and damping over the level
#
# What `fenics-joints harmonic` does, on a coarse lap beam whose joint gives way smoothly.

# +
import tempfile
from pathlib import Path

from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.commands.harmonic.run import run_harmonic
from fenics_joints.progress import Progress

CASE = """
title = "Small lap beam"
[mesh]
builder = "lap_beam"
layer = "0.06 mm"
n_length = 4
n_lap = 4
n_width = 2
[parts.beams]
cells = ["beam_1", "beam_2"]
E = "207 GPa"
nu = 0.3
rho = "7800 kg/m3"
[joints.lap]
cells = ["joint"]
E = "5 MPa"
G = "1.7 MPa"
[supports.clamp]
facets = "clamp"
[nonlinear.lap]
law = "richard_abbott"
stress = "equivalent"
thickness = "6 mm"
E_p = "100 kPa"
S_y = "500 kPa"
n = 2.5
[harmonic]
force = { point = ["100 mm", "0 mm", "-6 mm"], direction = [0, 0, 1] }
sensor = { point = ["410 mm", "0 mm", "6 mm"], direction = [0, 0, 1] }
levels = ["0.01 N", "10 N"]
band = ["25 Hz", "31 Hz"]
damping = "1 %"
harmonics = 3
samples = 64
"""
comm = MPI.COMM_WORLD
folder = Path(comm.bcast(tempfile.mkdtemp() if comm.rank == 0 else None))
if comm.rank == 0:
    (folder / "case.toml").write_text(CASE)
comm.barrier()
outcome = run_harmonic(load_case(folder), comm, Progress(silent=True))
found = outcome.result
found
# -

# The peak falls with the level, and a cycle takes a larger share of the energy.

# +
for fact in found.facts:
    print(f"{fact.level:6g} N: {fact.peak_hz:.3f} Hz, {100 * fact.damping_ratio:.2f} %")
low, high = found.facts
assert high.peak_hz < low.peak_hz and high.damping_ratio > low.damping_ratio
# -

# Both responses over their force: what is linear would lie on one line.

# +
from matplotlib import pyplot

figure, axes = pyplot.subplots(figsize=(7, 3), layout="constrained")
for fact, response in zip(found.facts, found.responses, strict=True):
    amplitude = response.amplitude("sensor", "displacement") / fact.level
    axes.plot(response.frequencies_hz, 1e3 * amplitude, label=f"{fact.level:g} N")
axes.set(xlabel="frequency, Hz", ylabel="displacement over force, mm/N")
_ = axes.legend()

"""``update`` where the model has fewer modes than the test: some are left out, and said."""

from __future__ import annotations

import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.update.run import update_case
from fenics_joints.measurements.gap import TooFewModes
from fenics_joints.modal import solve_modes

#: Two beams of two elements each have eighteen degrees of freedom.
CASE = """
[mesh]
builder = "offset_beams"
lengths = ["360 mm", "260 mm"]
laps = "50 mm"
width = "21 mm"
thickness = "10.6 mm"
elements = [2, 2]
lap_elements = 1
[parts.beams]
cells = ["beam_1", "beam_2"]
E = "208 GPa"
nu = 0.3
rho = "7860 kg/m3"
[joints.lap]
cells = "lap"
law = "generic"
k1 = "2500 N m"
k2 = "50000 N m"
[test]
frequencies = "f.csv"
noise = "0.5 %"
[test.sees]
points = [["0 mm", "0 mm", "0 mm"], ["300 mm", "0 mm", "0 mm"], ["570 mm", "0 mm", "0 mm"]]
direction = [0, 0, 1]
[update]
parameters = ["lap.k1", "lap.k2"]
[diagnose]
n_modes = 8
"""


def case_of(folder, hz, more=""):
    (folder / "case.toml").write_text(CASE + more, encoding="utf-8")
    head = ",".join(f"mode {i + 1} [Hz]" for i in range(len(hz)))
    row = ",".join(f"{f:.6f}" for f in hz)
    (folder / "f.csv").write_text(f"{head}\n{row}\n", encoding="utf-8")
    return load_case(folder)


def test_modes_without_a_partner_are_left_out(tmp_path):
    """More of the model's modes are looked through than the case says; the others still do."""
    case = case_of(tmp_path, [200.0])
    true = {"lap.k1": 1763.0, "lap.k2": 37400.0}
    model = build_structure(case, MPI.COMM_WORLD)
    modes = solve_modes(model, true, n_modes=18)
    seen = modes.visibility(case.sensors()) > 0.3
    seen[: modes.n_rigid] = False
    hz = [*modes.frequencies_hz[seen], 50e3, 60e3]
    found = update_case(case_of(tmp_path, hz), MPI.COMM_WORLD)
    (note,) = [note for note in found.notes if "left out" in note]
    assert note.startswith(f"mode {len(hz) - 1}, mode {len(hz)}: left out")
    assert len(found.modes.names) == len(hz) - 2
    assert found.update.mapping() == pytest.approx(true, rel=1e-3)


def test_a_held_mode_without_a_partner_is_refused(tmp_path):
    hz = [1000.0 * (i + 1) for i in range(20)]
    case = case_of(tmp_path, hz, '[update.held]\nmodes = ["mode 20"]\n')
    with pytest.raises(TooFewModes, match="expected at least 20"):
        update_case(case, MPI.COMM_WORLD)

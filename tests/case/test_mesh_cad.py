"""A case of a STEP file: its rings, what is said of them, radii from the database."""

from __future__ import annotations

from unittest.mock import Mock

import pytest
from mpi4py import MPI
from step_files import flanges

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.modes import run_modes
from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.modal import solve_modes

CASE = """
[mesh]
file = "machine.step"
size = "30 mm"
layer = "0.7 mm"
circle = 6
ring_size = "9 mm"
[mesh.parts]
bed = 1
column = ["60 mm", "30 mm", "30 mm"]
[mesh.faces]
ground = ["10 mm", "10 mm", "0 mm"]
[mesh.bolts]
r_wai = "11 mm"
thread = "M12"
[parts.frame]
cells = ["bed", "column"]
E = "150 GPa"
nu = 0.23
rho = "7200 kg/m3"
"""
RING = """
[joints.{0}]
law = "transition"
cells = "{1}"
E = "6111 MPa"
nu = 0.253
h = "0.72 mm"
"""


def written(folder, text):
    write_step(folder / "machine.step", flanges())
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return load_case(folder)


def test_case(tmp_path):
    """A case of a STEP file: its rings with one set of parameters, or each with its own."""
    together = CASE + RING.format("rings", "ring_*")
    each = CASE + "".join(RING.format(f"ring_{i}", f"ring_{i}") for i in (1, 2, 3, 4))
    slopes, tagged = [], None
    for text in (together, each):
        structure = build_structure(written(tmp_path, text), MPI.COMM_SELF, tagged=tagged)
        tagged = structure.tagged
        modes = solve_modes(structure, n_modes=8)
        by_h = [i for i, name in enumerate(structure.parameters) if name.endswith(".h")]
        slopes.append((modes.eigenvalues[6:], modes.gradients([6, 7])[:, by_h].sum(axis=1)))
    assert slopes[0][0] == pytest.approx(slopes[1][0], rel=1e-9)
    assert slopes[0][1] == pytest.approx(slopes[1][1], rel=1e-5)
    assert "ground" in tagged.facet_names


def test_modes_say_what_was_found(tmp_path):
    """The rings and the size of the mesh: a bolt that was not found, or a wrong unit, is seen."""
    text = CASE.replace("[mesh]", "[mesh]\ndegree = 1") + RING.format("rings", "ring_*")
    result = run_modes(written(tmp_path, text), MPI.COMM_SELF, Mock(), n_modes=7)
    found = result.json()
    assert found["size_m"] == pytest.approx([0.1, 0.06, 0.0357], rel=1e-9)
    assert [ring["name"] for ring in found["rings"]] == [f"ring_{i}" for i in (1, 2, 3, 4)]
    assert found["rings"][2]["centre_m"] == pytest.approx([0.085, 0.015, 0.02035], abs=1e-9)
    assert found["rings"][0]["parts"] == ["bed", "column"]
    page = result.page().html()
    for what in ("100 x 60.0 x 35.7 mm", "ring_4", "85, 45, 20.35", "6 to 11", "bed, column"):
        assert what in page


def test_radius_from_the_database(tmp_path):
    """M12 at 120 N·m is 50 kN; Machines 2022's Table 2 has 51.55 mm for plates of 25 mm."""
    text = CASE.replace('r_wai = "11 mm"', 'torque = "120 N*m"\nthickness = "25 mm"')
    # Two of these rings do not fit beside each other.
    with pytest.raises(MeshError, match=r"case.toml: mesh: .*: 30 mm .*, 10[23]\.\d") as told:
        build_structure(written(tmp_path, text + RING.format("rings", "ring_*")), MPI.COMM_SELF)
    assert "rings of bolt 1 at (45, 15, 20) mm between 'bed' and 'column'" in str(told.value)
    with pytest.raises(InputError, match="either r_wai, or thread, torque and thickness"):
        written(tmp_path, CASE.replace('r_wai = "11 mm"', 'torque = "9 N*m"'))

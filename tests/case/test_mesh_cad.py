"""A case of a STEP file: its rings, what is said of them, radii from the database."""

from __future__ import annotations

import io
from unittest.mock import Mock

import pytest
from mpi4py import MPI
from rich.console import Console
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


def test_case(tmp_path):
    """A case of a STEP file: its rings with one set of parameters, or each with its own."""
    write_step(tmp_path / "machine.step", flanges())
    together = CASE + RING.format("rings", "ring_*")
    each = CASE + "".join(RING.format(f"ring_{i}", f"ring_{i}") for i in (1, 2, 3, 4))
    slopes, tagged = [], None
    for text in (together, each):
        (tmp_path / "case.toml").write_text(text, encoding="utf-8")
        structure = build_structure(load_case(tmp_path), MPI.COMM_SELF, tagged=tagged)
        tagged = structure.tagged
        modes = solve_modes(structure, n_modes=8)
        at = [i for i, name in enumerate(structure.parameters) if name.startswith("ring")]
        by_h = [i for i in at if list(structure.parameters)[i].endswith(".h")]
        slopes.append((modes.eigenvalues[6:], modes.gradients([6, 7])[:, by_h].sum(axis=1)))
    assert slopes[0][0] == pytest.approx(slopes[1][0], rel=1e-9)
    assert slopes[0][1] == pytest.approx(slopes[1][1], rel=1e-5)
    assert "ground" in tagged.facet_names


def test_modes_say_what_was_found(tmp_path, capfd):
    """The rings and the size of the mesh: a bolt that was not found, or a wrong unit, is seen."""
    write_step(tmp_path / "machine.step", flanges())
    text = CASE.replace("[mesh]", "[mesh]\ndegree = 1") + RING.format("rings", "ring_*")
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    result = run_modes(load_case(tmp_path), MPI.COMM_SELF, Mock(), n_modes=7)
    found = result.json()
    assert found["size_m"] == pytest.approx([0.1, 0.06, 0.0357], rel=1e-9)
    assert [ring["name"] for ring in found["rings"]] == [f"ring_{i}" for i in (1, 2, 3, 4)]
    assert found["rings"][2]["centre_m"] == pytest.approx([0.085, 0.015, 0.02035], abs=1e-9)
    assert found["rings"][0]["parts"] == ["bed", "column"]
    console = Console(record=True, width=80, file=io.StringIO())
    result.summary(console)
    page = result.page()
    assert '<b id="size">100 x 60.0 x 35.7 mm</b>' in page and '<b id="rings">4</b>' in page
    said = console.export_text()
    for what in ("100 x 60.0 x 35.7 mm", "ring_4", "85.0, 45.0, 20.4", "6 to 11", "bed, column"):
        assert what in said and what in page


def test_radius_from_the_database(tmp_path):
    """M12 at 120 N·m is 50 kN; Machines 2022's Table 2 has 51.55 mm for plates of 25 mm."""
    write_step(tmp_path / "machine.step", flanges())
    text = CASE.replace('r_wai = "11 mm"', 'torque = "120 N*m"\nthickness = "25 mm"')
    (tmp_path / "case.toml").write_text(text + RING.format("rings", "ring_*"), encoding="utf-8")
    # Two of these rings do not fit beside each other.
    with pytest.raises(MeshError, match=r"case.toml: mesh: .*: 30 mm .*, 10[23]\.\d") as told:
        build_structure(load_case(tmp_path), MPI.COMM_SELF)
    assert "rings of bolt 1 at (45, 15, 20) mm between 'bed' and 'column'" in str(told.value)
    (tmp_path / "case.toml").write_text(
        CASE.replace('r_wai = "11 mm"', 'torque = "9 N*m"'), encoding="utf-8"
    )
    with pytest.raises(InputError, match="either r_wai, or thread, torque and thickness"):
        load_case(tmp_path)

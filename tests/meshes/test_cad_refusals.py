"""Assemblies from STEP that are refused: each message names the solid or the bolt."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from mpi4py import MPI
from step_files import FLANGE_BOLTS, flanges
from step_meshes import meshed

from fenics_joints.errors import MeshError
from fenics_joints.meshes import read_step, step_file

MM = 1e-3


def one_box(occ):
    occ.addBox(0, 0, 0, 10, 10, 10)


def overlapping(occ):
    flanges()(occ)
    occ.addBox(90, 0, 10, 30, 60, 5)


def far_apart(occ):
    flanges(gap=5)(occ)


def with_lone_block(occ):
    flanges()(occ)
    occ.addBox(200, 0, 0, 10, 10, 10)


def corner(occ):
    """A block with a foot and a back, each with a bolt of its own, against an L."""
    block = occ.addBox(0, 0, 0, 60, 60, 60)
    base, wall = occ.addBox(-10, 0, -10, 70, 60, 10), occ.addBox(-10, 0, 0, 10, 60, 60)
    angle, _ = occ.fuse([(3, base)], [(3, wall)])
    drills = [(3, occ.addCylinder(30, 30, -11, 0, 0, 30, 5))]
    drills += [(3, occ.addCylinder(-11, 30, 40, 30, 0, 0, 5))]
    occ.cut([(3, block)], drills, removeTool=False)
    occ.cut(angle, drills)


def with_bolts(occ):
    """A bolt left in each hole, as wide as the bed's."""
    flanges(upper_radius=7)(occ)
    for x, y in FLANGE_BOLTS:
        occ.addCylinder(x, y, 5, 0, 0, 40, 6)


def sunk(occ):
    flanges(gap=-0.1)(occ)


ABC = {"a": 1, "b": 2, "c": 3}
AB = {"parts": {"a": 1, "b": 2}}
FIRST, SECOND = r"bolt 1 at \(45, 15, 20\) mm", r"bolt 2 at \(45, 45, 20\) mm"
LEAVES = f"ring of {FIRST} between 'a' and 'b', 6 to 14.9 mm, leaves the faces"
REFUSED = {
    "one solid": (one_box, {}, "it has one solid, .*expected at least two for bolts"),
    "overlap": (overlapping, {"parts": {"b": 1, "s": 3}}, r"'b' and 's' overlap by 29\d\d.* mm3"),
    "no contact": (far_apart, AB, r"no two of 'a', 'b' have .* 'b' are 5 mm apart \(layer says"),
    "hanging": (with_lone_block, {"parts": ABC}, "no bolt joins 'a', 'b' with 'c'"),
    "wide ring": (flanges(upper=(20, 3, 80, 54)), {"r_wai": 14.9 * MM, **AB}, LEAVES),
    "no hole": (
        flanges(upper_radius=0),
        {"parts": {"bed": 1}},
        r"no bolt: expected holes of 0 to 22 mm .*are: 'bed': 12 mm at \(45, 15, 20\) mm",
    ),
    "no hole here": (
        flanges(),
        {"bolts": [(0.045, 0.015, 0.02), (0.065, 0.03, 0.02)]},
        r"bolt 2 at \(65, 30, 20\) mm: .* has no hole there, expected one, or r_nei",
    ),
    "out of line": (flanges(shift=0.3), {}, "the axes of its two holes are 0.3 mm apart"),
    "overlapping rings": (flanges(), {"r_wai": 16 * MM}, f"{FIRST} .*{SECOND} .*: 30 mm apart"),
    "narrow": (flanges(), {"r_nei": 4 * MM}, "r_nei is 4 mm, expected at least the hole's .*, 6"),
    "off": (flanges(), {"bolts": [(0.045, 0.015, 0.03)]}, "bolt 1 at .* is on no two faces that"),
    "no label": (flanges(), {"parts": {"a": "B"}}, "parts.a = 'B' fits 0 solids.*there are: 1"),
    "twice": (flanges(), {"parts": {"a": 1, "b": (0.01, 0.01, 0.01)}}, "parts.a and parts.b are"),
    "no face": (flanges(), {"faces": {"end": (1, 1, 1)}}, "faces.end: no face of a solid is at"),
    "bonded too": (flanges(), {"bonded": [("a", "b")], **AB}, "no two of 'a', 'b'"),
    "not there": (flanges(), {"bonded": [("a", "b")]}, "bonded has .*expected two of the parts"),
    "reserved": (flanges(), {"parts": {"ring_2": 1}}, "parts has the name 'ring_2', which is that"),
    "reserved face": (flanges(), {"faces": {"joint_upper": (0, 0.03, 0.01)}}, "faces has the name"),
    "loop": (corner, {"layer": 0.7 * MM}, "cannot be moved 0.7 mm apart along the normal"),
    "bolts in the file": (with_bolts, {"parts": ABC}, f"'c' passes .* of {FIRST} between 'a' and"),
    "far out of line": (flanges(shift=4), {}, "the axes of its two holes are 4 mm apart"),
    "sunk": (sunk, AB, "no two of 'a', 'b' .*; 'a' and 'b' overlap by 434"),
    "edge": (flanges(), {"faces": {"end": (0, 0, 0.01)}}, r"end: 2 faces .* meet at \(0, 0, 10\)"),
    "micrometres": (flanges(), {"element_size": 4e-5}, "element_size is 0.04 mm, .* about 2.*e.10"),
    "fine ring": (flanges(), {"ring_size": 1e-6}, "ring_size is 0.001 mm, .* cells; expected at"),
    "radius": (flanges(), {"r_wai": -1.0}, "r_wai is -1.0, expected the outer radius"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(tmp_path, name):
    """Each names the solid or the bolt, and what was expected."""
    draw, given, message = REFUSED[name]
    sizes = {"element_size": 0.04, "r_wai": 11 * MM, "circle": 6, "ring_size": 9 * MM}
    with pytest.raises(MeshError, match=message):
        meshed(tmp_path, draw, **(sizes | given))


def test_no_step_file(tmp_path):
    (tmp_path / "a.step").write_text("solid a", encoding="utf-8")
    for name, message in (("a.step", "not a STEP file"), ("b.step", "no such file")):
        with pytest.raises(MeshError, match=message):
            read_step(tmp_path / name, MPI.COMM_SELF, element_size=1.0, r_wai=1.0)
    (tmp_path / "a.step").write_text("ISO-10303-21;\nHEADER;", encoding="utf-8")
    with pytest.raises(MeshError, match="a.step: gmsh cannot read it|it has no solid"):
        read_step(tmp_path / "a.step", MPI.COMM_SELF, element_size=1.0, r_wai=1.0)


def test_what_was_looked_at_is_what_is_read(tmp_path, monkeypatch):
    """Another file takes the place of a file that gmsh could read in a process of its own."""
    path, read = tmp_path / "parts.step", []
    path.write_text(good := "ISO-10303-21;\nEND-ISO-10303-21;\n")

    def look(folder, file, size):
        read.append((folder / file).read_text())
        path.write_text("ISO-10303-21; crashes")

    def load(file, format):
        read.append(Path(file).read_text())
        return []

    monkeypatch.setattr(step_file, "run_apart", look)
    occ = SimpleNamespace(importShapes=load, synchronize=lambda: None)
    with pytest.raises(MeshError, match="no solid"):
        step_file.import_solids(path, SimpleNamespace(occ=occ), {})
    assert read == [good, good]

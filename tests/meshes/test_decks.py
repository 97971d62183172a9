"""Decks of other codes: the same two blocks from each, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from fenics_joints.errors import MeshError
from fenics_joints.meshes.decks import read_deck
from fenics_joints.meshes.msh import read_lists

gmsh = pytest.importorskip("gmsh")
pytest.importorskip("meshlane")
pytest.importorskip("mapdl_archive")

#: Two blocks of 20 by 10 by 10 mm on one another, two hexahedra each, that share no nodes.
STEEL, ALLOY = (210000.0, 0.3, 7.85e-9), (70000.0, 0.33, 2.7e-9)


def cells(block: int) -> list[list[int]]:
    found = []
    for i in (0, 1):
        z = 10.0 * block
        low = [(10.0 * i, 0.0), (10.0 * (i + 1), 0.0), (10.0 * (i + 1), 10.0), (10.0 * i, 10.0)]
        found.append([NODE[block, x, y, h] for h in (z, z + 10.0) for x, y in low])
    return found


NODE, NUMBERED = {}, {}
for b in (0, 1):
    for x in (0.0, 10.0, 20.0):
        for y in (0.0, 10.0):
            for z in (10.0 * b, 10.0 * b + 10.0):
                NODE[b, x, y, z] = len(NODE) + 1
                NUMBERED[len(NODE)] = (x, y, z)


def nastran() -> str:
    lines = ["SOL 103", "CEND", "BEGIN BULK"]
    lines += [f"GRID,{n},,{x},{y},{z}" for n, (x, y, z) in NUMBERED.items()]
    for b, number in ((0, 100), (1, 200)):
        for k, own in enumerate(cells(b)):
            lines.append(f"CHEXA,{10 * b + k + 1},{number}," + ",".join(map(str, own[:6])) + ",")
            lines.append("," + ",".join(map(str, own[6:])))
        E, nu, rho = (STEEL, ALLOY)[b]
        lines += [f"PSOLID,{number},{b + 1}", f"MAT1,{b + 1},{E},,{nu},{rho}"]
    return "\n".join([*lines, "CBAR,50,300,1,2,0.,1.,0.", "CONM2,70,1,,1.5-3", "ENDDATA"])


def abaqus() -> str:
    lines = ["*NODE", *(f"{n}, {x}, {y}, {z}" for n, (x, y, z) in NUMBERED.items())]
    for b, (E, nu, rho) in enumerate((STEEL, ALLOY)):
        lines.append(f"*ELEMENT, TYPE=C3D8R, ELSET=BLOCK_{b}")
        lines += [
            f"{10 * b + k + 1}, " + ", ".join(map(str, own)) for k, own in enumerate(cells(b))
        ]
        lines += [f"*MATERIAL, NAME=M{b}", "*ELASTIC", f"{E}, {nu}", "*DENSITY", f"{rho}"]
        lines.append(f"*SOLID SECTION, ELSET=BLOCK_{b}, MATERIAL=M{b}")
    return "\n".join(lines) + "\n"


def ansys() -> str:
    lines = [
        "/PREP7",
        "ET,1,185",
        f"NBLOCK,6,SOLID,{len(NUMBERED)},{len(NUMBERED)}",
        "(3i9,6e21.13e3)",
    ]
    lines += [
        f"{n:9d}{0:9d}{0:9d}" + "".join(f"{c:21.13E}" for c in x) for n, x in NUMBERED.items()
    ]
    lines += ["N,R5.3,LOC,       -1,", "EBLOCK,19,SOLID,4,4", "(19i9)"]
    for b in (0, 1):
        for k, own in enumerate(cells(b)):
            head = [1, 1, 1, 1, 0, 0, 0, 0, 8, 0, 2 * b + k + 1]
            lines.append("".join(f"{n:9d}" for n in (*head, *own)))
    lines.append("       -1")
    for b in (0, 1):
        lines += [f"CMBLOCK,BLOCK_{b},ELEM,2", "(8i10)", f"{2 * b + 1:10d}{2 * b + 2:10d}"]
    lines.append(f"MPDATA,R5.0, 1,EX  ,       1, 1, {STEEL[0]}    ,")
    lines.append(f"MPDATA,R5.0, 1,DENS,       1, 1, {STEEL[2]}    ,")
    return "\n".join(lines) + "\n"


def by_gmsh(path, version=None) -> None:
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        for b in (0, 1):
            gmsh.model.addDiscreteEntity(3, b + 1)
            own = {n: x for n, x in NUMBERED.items() if n in {m for c in cells(b) for m in c}}
            gmsh.model.mesh.addNodes(3, b + 1, list(own), [c for x in own.values() for c in x])
            gmsh.model.mesh.addElementsByType(b + 1, 5, [], [n for c in cells(b) for n in c])
            gmsh.model.addPhysicalGroup(3, [b + 1], b + 1, f"block_{b}")
        if version:
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def vtu(path) -> None:
    import meshlane

    number = {n: i for i, n in enumerate(NUMBERED)}
    hexes = np.array([[number[n] for n in c] for b in (0, 1) for c in cells(b)])
    mesh = meshlane.Mesh(
        np.array(list(NUMBERED.values())),
        [("hexahedron", hexes)],
        cell_data={"material": [np.array([1, 1, 2, 2])]},
    )
    meshlane.write(path, mesh)


WRITERS = {
    "two.bdf": lambda p: p.write_text(nastran()),
    "two.inp": lambda p: p.write_text(abaqus()),
    "two.cdb": lambda p: p.write_text(ansys()),
    "two.vtu": vtu,
    "two.unv": by_gmsh,
    "old.msh": lambda p: by_gmsh(p, 2.2),
    "new.msh": lambda p: by_gmsh(p, 4.1),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_two_blocks(tmp_path, name):
    WRITERS[name](tmp_path / name)
    lists = read_lists(tmp_path / name, 3, 1e-3)
    assert lists.cell == "hexahedron" and len(lists.cells) == 4 and len(lists.x) == 24
    centres = {}
    for part, tag in lists.cell_names.items():
        own = lists.x[lists.cells[lists.cell_values == tag]]
        centres[part] = own.mean(axis=(0, 1))
        # The volume by the three edges at the first corner, in DOLFINx's order.
        edges = own[:, [1, 2, 4]] - own[:, :1]
        assert np.linalg.det(edges) == pytest.approx(1e-6)
    assert sorted(c[2] for c in centres.values()) == pytest.approx([0.005, 0.015])


def test_materials_and_what_is_no_solid(tmp_path):
    for name in ("two.bdf", "two.inp"):
        WRITERS[name](tmp_path / name)
        deck = read_deck(tmp_path / name)
        assert sorted(deck.materials.values()) == [ALLOY, STEEL]
    (tmp_path / "two.cdb").write_text(ansys())
    assert read_deck(tmp_path / "two.cdb").materials["block_1"] == (STEEL[0], None, STEEL[2])
    deck = read_deck(tmp_path / "two.bdf")
    assert deck.masses.tolist() == [[0, 0, 0, 1.5e-3]]
    assert deck.notes == ("left out, as they are no solids: 1 CBAR",)


def test_mixed_cells_are_cut_alike(tmp_path):
    """A hexahedron beside two wedges: tetrahedra that fill them and meet face to face."""
    points = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)]
    lines = ["*NODE", *(f"{i + 1}, {x}, {y}, {z}" for i, (x, y, z) in enumerate(points))]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=A", "1, 1, 2, 5, 4, 7, 8, 11, 10"]
    lines += ["*ELEMENT, TYPE=C3D6, ELSET=B", "2, 2, 3, 6, 8, 9, 12", "3, 2, 6, 5, 8, 12, 11"]
    (tmp_path / "mixed.inp").write_text("\n".join(lines) + "\n")
    lists = read_lists(tmp_path / "mixed.inp", 3, 1.0)
    corners = lists.x[lists.cells]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    assert [
        volumes[lists.cell_values == t].sum() for t in lists.cell_names.values()
    ] == pytest.approx([1, 1])
    faces = np.sort(
        lists.cells[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1
    )
    counts = np.unique(faces, axis=0, return_counts=True)[1]
    # Ten outer squares are two triangles each; no face is there three times.
    assert counts.max() == 2 and (counts == 1).sum() == 20
    assert "cut into tetrahedra" in lists.notes[-1]


def test_second_order_by_corners(tmp_path):
    ends = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    middles = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
    points = ends + [tuple(0.5 * np.add(ends[a], ends[b])) for a, b in middles]
    for bent, words in ((0.0, "mesh.degree"), (0.1, "1 of their edges are curved")):
        moved = [*points[:4], tuple(np.add(points[4], (0, -bent, 0))), *points[5:]]
        lines = ["*NODE", *(f"{i + 1}, {x}, {y}, {z}" for i, (x, y, z) in enumerate(moved))]
        lines += ["*ELEMENT, TYPE=C3D10, ELSET=A", "1, " + ", ".join(map(str, range(1, 11)))]
        (tmp_path / "t.inp").write_text("\n".join(lines) + "\n")
        lists = read_lists(tmp_path / "t.inp", 3, 1.0)
        assert lists.cell == "tetrahedron" and len(lists.x) == 4
        assert words in lists.notes[0]


def test_what_cannot_be_is_said(tmp_path):
    shell = "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n*ELEMENT, TYPE=S4, ELSET=A\n1,1,2,3,4\n"
    for name, text, words in (
        ("a.inp", shell, "no solids.*matrices"),
        ("b.inp", abaqus() + "*INCLUDE, INPUT=/etc/passwd\n", "includes another file"),
        ("c.bdf", nastran().replace("GRID,1,", "GRID,99,"), "a node that is not there"),
        ("d.bdf", "INCLUDE '/etc/passwd'\n" + nastran(), "includes another file"),
        ("e.vtu", "<html>", "cannot read it"),
        ("f.unv", "nothing", "not a universal file"),
        ("g.cdb", "/PREP7\n", "no solids|cannot read it"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(MeshError, match=words):
            read_lists(tmp_path / name, 3, 1.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.replace("GRID,1,,", "GRID,1,3,"), "coordinate system 3"),
        (lambda t: t.replace("BEGIN BULK", "BEGIN BULK\nGRDSET,,2"), "coordinate system 2"),
    ],
)
def test_systems_of_nastran(tmp_path, change, said):
    path = tmp_path / "a.bdf"
    path.write_text(change(nastran()))
    with pytest.raises(MeshError, match=said):
        read_deck(path)


def test_offsets_of_masses_and_shear_moduli_of_nastran(tmp_path):
    path = tmp_path / "a.bdf"
    E, nu, rho = STEEL
    text = nastran().replace(f"MAT1,1,{E},,{nu},{rho}", f"MAT1,1,{E},{E / 2.6},,{rho}")
    path.write_text(text.replace("CONM2,70,1,,1.5-3", "CONM2,70,1,,1.5-3,1.,2.,3."))
    deck = read_deck(path)
    assert deck.masses == pytest.approx(np.array([[1.0, 2.0, 3.0, 1.5e-3]]))
    assert deck.materials["property_100"] == pytest.approx(STEEL)


def test_parts_of_abaqus_count_their_own(tmp_path):
    """Both parts have the same numbers, and the same name of the set with their section."""
    path, lines = tmp_path / "a.inp", []
    for part, z in (("LOW", 0.0), ("HIGH", 1.0)):
        lines += [f"*PART, NAME={part}", "*NODE"]
        lines += [f"{n + 1},{n % 2},{n // 2 % 2},{z + n // 4}" for n in range(8)]
        lines += ["*ELEMENT, TYPE=C3D8", "1,1,2,4,3,5,6,8,7", "*ELSET, ELSET=ALL", "1"]
        lines += [f"*SOLID SECTION, ELSET=ALL, MATERIAL={part}", "*END PART"]
    lines += ["*ASSEMBLY, NAME=A"]
    lines += [f"*INSTANCE, NAME={p}-1, PART={p}\n*END INSTANCE" for p in ("LOW", "HIGH")]
    lines += ["*END ASSEMBLY"]
    for part, (E, nu, rho) in (("LOW", STEEL), ("HIGH", ALLOY)):
        lines += [f"*MATERIAL, NAME={part}", "*ELASTIC", f"{E},{nu}", "*DENSITY", f"{rho}"]
    path.write_text("\n".join(lines))
    deck = read_deck(path)
    assert deck.materials == {"low_all": STEEL, "high_all": ALLOY}
    for name, z in (("low_all", 0.5), ("high_all", 1.5)):
        number = next(n for n, own in deck.names.items() if own == name)
        assert deck.x[deck.cells[deck.group == number]].mean(axis=(0, 1))[2] == z


@pytest.mark.parametrize("line", ["*ELGEN, ELSET=A\n1, 2, 1, 1", "*SYSTEM\n1,0,0"])
def test_what_makes_nodes_or_elements_is_refused(tmp_path, line):
    path = tmp_path / "a.inp"
    path.write_text(line + "\n" + abaqus())
    with pytest.raises(MeshError, match="by itself"):
        read_deck(path)

"""Meshes and drawings of a stranger: no script in them runs, no crash of gmsh ends the program."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from uuid import uuid4

import numpy as np
import pytest
from mesh_measures import write_msh
from mpi4py import MPI

from fenics_joints.cli import main
from fenics_joints.errors import MeshError
from fenics_joints.meshes import read_msh, read_step
from fenics_joints.meshes.cad_survey import survey_step

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="one process reads files")

#: What a script of gmsh's can do to a machine; MARK is a file that is not to appear, wherever the
#: process that reads the mesh works.
MARK = Path(tempfile.gettempdir()) / f"fenics-joints-{uuid4()}"
RUN = f'SystemCall "echo ran > {MARK}";'
#: Heads that a sniffer may take for those of a mesh; gmsh takes all but the last for a script.
HEADS = {
    "comment": "// $MeshFormat\n{}",
    "second line": "{}\n$MeshFormat\n4.1 0 8\n$EndMeshFormat\n",
    "blank line": "\n$MeshFormat\n4.1 0 8\n$EndMeshFormat\n{}",
    "space": " $MeshFormat\n4.1 0 8\n$EndMeshFormat\n{}",
    "byte order mark": "\ufeff$MeshFormat\n4.1 0 8\n$EndMeshFormat\n{}",
    "comment over lines": "/*\n$MeshFormat\n4.1 0 8\n$EndMeshFormat\n*/\n{}",
    "results": "$PostFormat\n1.4 0 8\n$EndPostFormat\n// $MeshFormat\n{}",
    "view": 'View "$MeshFormat" {{ SP(0, 0, 0){{1}}; }};\n{}',
    "old format": "$NOD\n0\n$ENDNOD\n// $MeshFormat\n{}",
    "after a mesh": "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n{}\n",
}
#: With the first line of a mesh a file is read: its name must not make a script of it.
NAMES = ("mesh.geo", "mesh", "mesh.pos", "mesh.py", "mesh.msh.gz", "a;echo ran > MARK;.msh.gz")
DRAWINGS = {
    "comment": "/* ISO-10303-21; */\n{}",
    "line comment": "// ISO-10303-21;\n{}",
    "second line": "{}\nISO-10303-21;\nHEADER;\n",
    "after a head": "ISO-10303-21;\n{}\n",
    "brep": "DBRep_DrawableShape\n\nCASCADE Topology V1\nISO-10303-21;\n{}",
    "iges": " ISO-10303-21; IGES".ljust(72) + "S      1\n{}",
}


@pytest.fixture
def victim(tmp_path, monkeypatch):
    """A folder with a script beside the mesh, and what is in the folder but for new files."""
    folder = tmp_path / "stranger's"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("HOME", str(tmp_path))
    (folder / "other.geo").write_text(RUN, encoding="utf-8")
    yield folder
    MARK.unlink(missing_ok=True)


def everything(folder: Path) -> set[Path]:
    """All files but those that libraries keep in a user's home, and the mark."""
    own = {".fltk", ".config", ".cache"}
    found = {path for path in folder.parent.rglob("*") if not own & set(path.parts)}
    return found | {path for path in (MARK,) if path.exists()}


def attack(folder: Path, head: str, name: str) -> Path:
    path = folder / name
    path.write_text(HEADS[head].format(RUN), encoding="utf-8")
    (folder / f"{name}.opt").write_text(RUN, encoding="utf-8")
    return path


def test_gmsh_itself_runs_such_files(victim):
    """Without a guard: else the tests below could not fail."""
    path = attack(victim, "comment", "mesh.msh")
    code = f"import gmsh; gmsh.initialize(); gmsh.merge({str(path)!r})"
    subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, timeout=60)
    assert MARK.read_text().strip() == "ran"


@pytest.mark.parametrize(
    "head, name", [*((head, "mesh.msh") for head in HEADS), *(("after a mesh", n) for n in NAMES)]
)
def test_no_mesh_runs_a_script(victim, head, name):
    path = attack(victim, head, name)
    before = everything(victim)
    with pytest.raises(MeshError) as caught:
        read_msh(path, MPI.COMM_SELF)
    assert name in str(caught.value) and everything(victim) == before


@pytest.mark.parametrize(
    "head, name",
    [
        *((head, "mesh.step") for head in DRAWINGS),
        *(("after a head", f"mesh.{ending}") for ending in ("brep", "geo", "py")),
    ],
)
def test_no_drawing_runs_a_script(victim, head, name):
    path = victim / name
    path.write_text(DRAWINGS[head].format(RUN), encoding="utf-8")
    before = everything(victim)
    with pytest.raises(MeshError, match=name):
        read_step(path, MPI.COMM_SELF, element_size=0.01, joint="layer")
    assert everything(victim) == before


@pytest.mark.parametrize("name", ["plain.msh", "plain.geo", "plain.msh.gz"])
def test_a_mesh_is_read_whatever_its_name_and_neighbours(victim, name):
    """Its options beside it are not read; a link and gmsh's own comments do not matter."""
    whole = write_msh(victim).read_text()
    target = victim / "target"
    target.write_text(f"$Comments\n{RUN}\n$EndComments\n{whole}{RUN}\n", encoding="utf-8")
    (victim / name).symlink_to(target)
    for sidecar in (f"{name}.opt", "target.opt", ".gmshrc", ".gmsh-options"):
        (victim / sidecar).write_text(RUN, encoding="utf-8")
    (victim / "numpy.py").write_text(f"open({str(MARK)!r}, 'w')", encoding="utf-8")
    before = everything(victim)
    tagged = read_msh(victim / name, MPI.COMM_SELF)
    assert set(tagged.cell_names) == {"left", "right"} and everything(victim) == before


@pytest.mark.parametrize("name", ["mesh.msh", "mesh.step"])
def test_commands_run_nothing(victim, name, capsys, monkeypatch):
    """The command line, and a case file that names the file."""
    step = name.endswith(".step")
    path = victim / name
    text = DRAWINGS["comment"] if step else HEADS["comment"]
    path.write_text(text.format(RUN), encoding="utf-8")
    case = victim / "case"
    case.mkdir()
    size = 'size = "5 mm"\n' if step else ""
    (case / "case.toml").write_text(
        f'[mesh]\nfile = "../{name}"\n{size}[parts.a]\ncells = "left"\nE = "210 GPa"\nnu = 0.3\n'
        "rho = 7850\n",
        encoding="utf-8",
    )
    before = everything(victim)
    option = "--step" if step else "--msh"
    for command in (
        ["new", "made", option, str(path), "--yes"],
        ["check", str(case)],
        ["modes", str(case)],
    ):
        monkeypatch.setattr(sys, "argv", ["fenics-joints", *command])
        with pytest.raises(SystemExit) as caught:
            main()
        assert caught.value.code not in (0, None)
    assert name in "".join(capsys.readouterr())
    assert everything(victim) == before


# -- files that crash gmsh or fill the memory ------------------------------------------------------


def mesh(version: str, nodes: str, elements: str = "") -> bytes:
    return (
        f"$MeshFormat\n{version} 0 8\n$EndMeshFormat\n$Nodes\n{nodes}\n$EndNodes\n"
        f"$Elements\n{elements}\n$EndElements\n"
    ).encode()


FOUR = "4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1"
BROKEN = {
    "1e11 vertices": mesh("4.1", "1 100000000000 1 1"),
    "2e9 elements": mesh("2.2", FOUR, "2000000000"),
    "infinite vertex": mesh("2.2", FOUR.replace("2 1 0 0", "2 1e999 0 0"), "1\n1 4 2 1 1 1 2 3 4"),
    "parent that is not there": mesh("2.2", FOUR, "1\n1 4 6 1 1 1 1 99 0 1 2 3 4"),
    "version 9": b"$MeshFormat\n9 0 8\n$EndMeshFormat\n",
    "sections without end": b"$MeshFormat\n4.1 0 8\n" + b"$Nodes\n" * 100_000,
}


@pytest.mark.parametrize("name", BROKEN)
def test_no_mesh_ends_or_stops_the_program(tmp_path, name):
    path = tmp_path / "mesh.msh"
    path.write_bytes(BROKEN[name])
    with pytest.raises(MeshError, match="mesh.msh: "):
        read_msh(path, MPI.COMM_SELF)


def test_no_drawing_ends_the_program(tmp_path):
    """Of drawings whose references are turned about OpenCASCADE crashes on a half, here on two."""
    whole = (Path(__file__).parents[1] / "meshes" / "data" / "washers.step").read_bytes()
    lines, rng = whole.split(b"\n"), np.random.default_rng(1)
    numbered = [i for i, line in enumerate(lines) if line.startswith(b"#")]
    for k in range(3):
        bad = list(lines)
        for i in rng.choice(numbered[200:], 12, replace=False):
            other = lines[rng.choice(numbered)].split(b"=")[0].strip()
            bad[i] = re.sub(rb"#\d+(?=[,)])", other, bad[i], count=1)
        path = tmp_path / f"bad{k}.step"
        path.write_bytes(b"\n".join(bad))
        with contextlib.suppress(MeshError):
            survey_step(path)


def test_many_comments_before_a_drawing_cost_no_time(tmp_path):
    """Each comment once doubled the time of the pattern that reads the file's head."""
    path = tmp_path / "comments.step"
    path.write_bytes(b"/**/" * 1000 + b"x")
    with pytest.raises(MeshError):
        survey_step(path)

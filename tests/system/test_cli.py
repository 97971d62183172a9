"""The ``fenics-joints`` command: files, exit codes, messages, and how it stops."""

from __future__ import annotations

import ast
import io
import json
import shutil
import subprocess
import sys
from unittest.mock import Mock

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

import fenics_joints
from fenics_joints import __version__, commands, files
from fenics_joints.case import build_structure, load_case, size
from fenics_joints.cli import main
from fenics_joints.commands import modes as mode_list
from fenics_joints.database import Store
from fenics_joints.errors import InputError
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.structure import Sensors

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


@pytest.fixture
def run(monkeypatch):
    """Runs the command in this process; returns its exit code."""

    def call(*arguments) -> int:
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["fenics-joints", *map(str, arguments)])
            # The command silences the other ranks; pytest wants its own streams back.
            patch.setattr(sys, "stdout", sys.stdout)
            patch.setattr(sys, "stderr", sys.stderr)
            with pytest.raises(SystemExit) as end:
                main()
        return end.value.code or 0

    return call


@pytest.mark.smoke
@pytest.mark.parallel
def test_modes(shared_tmp_path, write_case, run, capfd):
    """Frequencies of any number of ranks are those that one rank finds without the command."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        write_case(shared_tmp_path)
    comm.barrier()
    out = shared_tmp_path / "modes.json"
    assert run("modes", shared_tmp_path, "--json", out) == 0
    comm.barrier()
    content = json.loads(out.read_text())
    case = load_case(shared_tmp_path)
    structure = build_structure(case, MPI.COMM_SELF)
    modes = solve_modes(structure, n_modes=14)
    assert content["version"] == __version__ and content["title"] == "Lap plates"
    assert content["rigid_body_modes"] == 6 and content["frequencies_hz"][:6] == [0.0] * 6
    assert content["dofs"] == structure.V.dofmap.index_map.size_global * 3
    assert content["frequencies_hz"][6:] == pytest.approx(modes.frequencies_hz[6:], rel=1e-8)
    # Visible modes by another route: torsion and in-plane bending do not move the middle line out
    # of plane, compared with the plates' edge in all directions.
    x = np.repeat([0.0, 0.06, 0.26, 0.32], 3)
    edge = np.column_stack([x, np.zeros(12), np.where(x < 0.2, 0.0, 0.0165)])
    everywhere = np.linalg.norm(modes.at(Sensors(edge, np.tile(np.eye(3), (4, 1)))), axis=0)
    line = np.linalg.norm(modes.at(case.sensors()), axis=0)
    assert content["visible"] == [False] * 6 + (line > 0.1 * everywhere)[6:].tolist()
    again = shared_tmp_path / "iterative.json"
    fields = shared_tmp_path / "modes.xdmf"
    assert run("modes", shared_tmp_path, "--iterative", "--json", again, "--vtx", fields) == 0
    comm.barrier()
    assert fields.read_text().count("<Attribute") == 14 - 6
    frequencies = json.loads(again.read_text())["frequencies_hz"]
    assert frequencies == pytest.approx(content["frequencies_hz"], rel=1e-8)
    said = capfd.readouterr()
    if comm.rank == 0:
        assert f"{content['frequencies_hz'][6]:.2f}" in said.out and "wrote" in said.out
        assert "solving 14 modes" in said.err
    else:
        assert not said.out and not said.err


@serial
@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["modes", "{}/nowhere"], 1, ["nowhere", "no such file"]),
        (["modes", "{}", "--report", "{}"], 1, ["--report", "is a folder"]),
        (["modes", "{}", "--json", "{}/a", "--report", "{}/a"], 1, ["--json's file too"]),
        (["modes", "{}", "--json", "{}/case.toml"], 1, ["--json", "case.toml", "ends in .json"]),
        (["update", "{}", "--report", "{}/./damping.csv"], 1, ["damping.csv", "ends in .html"]),
        (["modes", "{}", "--report", "{}/page.pdf"], 1, ["writes HTML", "ends in .html"]),
        (["modes", "{}", "--out", "{}"], 1, ["--out", "case.toml", "nothing is overwritten"]),
        (["modes", "{}", "--out", "{}/case.toml"], 1, ["is a file", "expected a folder"]),
        (["modes", "{}", "--format", "csv"], 2, ["--format", "expected --out"]),
        (["modes", "{}", "--out", "{}/new", "--format", "pdf"], 2, ["'pdf'", "html, json, csv"]),
        (["modes", "{}", "-q"], 2, ["no file is named", "--out"]),
        (["modes", "{}", "--set", "mesh.siz=1"], 1, ["mesh.siz", "unknown key"]),
        (["modes", "{}", "--set", "mesh"], 1, ["--set mesh", "KEY=VALUE"]),
        (["modes", "{}", "--set", "title.x.y=1"], 1, ["--set", "title has no key 'x'"]),
        (["modes", "{}", "--set", "title=a\x1b[31m"], 1, ["KEY=VALUE"]),
        (["preload", "{}", "--vtx", "{}/a.xdmf", "--json", "{}/a.h5"], 1, ["--json's file too"]),
        (["modes", "{}", "--vtx", "{}/a.xdmf", "--report", "{}/a.h5"], 1, ["--report's file too"]),
        (["modes", "{}", "--vtx", "{}/a.vtk"], 1, ["a.vtk", "ends in .bp or .xdmf"]),
        (["preload", "{}", "--vtx", "{}/none/a.bp"], 1, ["no folder"]),
        (["update", "{}", "--bayes", "--keep", "{}/a", "--json", "{}/a"], 1, ["file too"]),
        (["modes", "{}", "--json", ""], 2, ["--json", "is empty"]),
        (["modes", ""], 2, ["CASE", "is empty"]),
        (["modes", "{}", "-n", "0"], 2, ["-n"]),
    ],
)
def test_exit_codes(tmp_path, write_case, run, capfd, monkeypatch, arguments, code, said):
    monkeypatch.setattr(mode_list, "build_structure", Mock(side_effect=AssertionError))
    write_case(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert run(*(a.format(tmp_path) for a in arguments)) == code
    streams = capfd.readouterr()
    assert "Traceback" not in streams.err
    for fragment in said:
        assert fragment in streams.err + streams.out
    assert sorted(tmp_path.iterdir()) == before


@serial
def test_no_input_is_overwritten_by_another_name(tmp_path, write_case, run, capfd):
    """By a link of either kind; a file that is there and is no input may be replaced."""
    write_case(tmp_path)
    (tmp_path / "soft.json").symlink_to("case.toml")
    (tmp_path / "hard.json").hardlink_to(tmp_path / "frequencies.csv")
    inputs = [tmp_path / name for name in ("case.toml", "frequencies.csv")]
    before = [path.read_bytes() for path in inputs]
    for name in ("soft.json", "hard.json"):
        assert run("modes", tmp_path, "--json", tmp_path / name) == 1
        assert "overwritten" in capfd.readouterr().err
    assert before == [path.read_bytes() for path in inputs]
    (tmp_path / "old.json").write_text("old")
    check = files.check_outputs
    check({"--json": tmp_path / "old.json", "--report": None}, load_case(tmp_path).files())
    # A database is an input of the command that shows it.
    Store(tmp_path / "own.db", create=True).close()
    for option in ("--csv", "--json"):
        own = tmp_path / "own.db"
        assert run("database", "show", "--db", own, option, own) == 1
        assert "overwritten" in capfd.readouterr().err and own.stat().st_size > 0


@serial
def test_too_large_a_model(tmp_path, write_case, run, capfd, monkeypatch):
    """Refused before anything is built; ``--large`` goes on, on all commands that solve."""

    monkeypatch.setattr(mode_list, "build_structure", Mock(side_effect=InputError("work began")))
    monkeypatch.setattr(size, "available_bytes", lambda: 1e6)
    write_case(tmp_path)
    for command in ("modes", "preload", "update", "diagnose", "harmonic"):
        assert run(command, tmp_path) == 1
        assert "--large" in capfd.readouterr().err
        assert run(command, "--large", "--help") == 0
    assert run("modes", tmp_path, "--large") == 1
    assert "work began" in capfd.readouterr().err


@serial
def test_a_folders_name_reaches_terminal_and_page_as_text(tmp_path, write_case, run, capfd):
    """Escape codes could clear the screen, or write into the terminal's own input; without a title
    the case is named by its folder."""
    folder = tmp_path / "\x1b[31mred\x07"
    folder.mkdir()
    write_case(folder, ('title = "Lap plates"', ""))
    page = tmp_path / "page.html"
    assert run("modes", folder, "--report", page) == 0
    said = capfd.readouterr()
    assert "\x1b" not in said.out + said.err.replace("\x1b[2K", "") + page.read_text()
    assert run("modes", folder / "none") == 1
    assert "\x1b" not in capfd.readouterr().err


@serial
@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "stopped"),
        (RuntimeError("broken"), 1, "unexpected RuntimeError: broken"),
    ],
)
def test_failure_during_the_work(tmp_path, write_case, run, capfd, monkeypatch, error, code, said):
    """No file is left."""

    monkeypatch.setattr(mode_list, "solve_modes", Mock(side_effect=error))
    monkeypatch.setattr(mode_list, "build_structure", lambda *_: Mock(n_dofs=1))
    write_case(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert run("modes", tmp_path, "--json", tmp_path / "out.json") == code
    streams = capfd.readouterr()
    assert said in streams.err and "Traceback" not in streams.err and not streams.out
    assert sorted(tmp_path.rglob("*")) == before
    run("modes", tmp_path, "--debug")
    assert ("Traceback" in capfd.readouterr().err) == (code == 1)


@serial
def test_old_file_survives_a_failed_write(tmp_path, monkeypatch):
    target = tmp_path / "out.json"
    files.write_text(target, "old")
    for error in (KeyboardInterrupt, OSError(28, "No space left on device")):
        monkeypatch.setattr(files.os, "fsync", Mock(side_effect=error))
        with pytest.raises((KeyboardInterrupt, InputError)):
            files.write_text(target, "new")
        assert target.read_text() == "old" and list(tmp_path.iterdir()) == [target]


ONE_RANK_FAILS = """
from mpi4py import MPI
from fenics_joints.errors import InputError
from fenics_joints.parallel import guarded
with guarded():
    if MPI.COMM_WORLD.rank == 1:
        raise InputError("only here")
    MPI.COMM_WORLD.barrier()
"""


@serial
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_a_rank_that_fails_alone_ends_the_others(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(ONE_RANK_FAILS)
    command = ["mpirun", "-n", "2", sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode != 0
    assert done.stderr.count("error (on rank 1): only here") == 1


#: Runs the command of its arguments, and says which modules are there in the end.
SEEN = """
import atexit, runpy, sys
atexit.register(lambda: print(sorted(sys.modules)))
runpy.run_module("fenics_joints", run_name="__main__")
"""
ASKED = "--bolt M12 --torque 120N·m --thickness 25mm"


@serial
@pytest.mark.parametrize(
    ("line", "said", "without"),
    [
        ("modes --help", "--set KEY=VALUE", ("dolfinx", "mpi4py", "fenics_joints.case.case")),
        (f"database query {ASKED}", "contact radius", ("dolfinx", "matplotlib")),
        ("--version", __version__, ("dolfinx", "mpi4py")),
    ],
)
def test_what_needs_no_model_is_quick(line, said, without):
    """Neither DOLFINx, which takes a second to load, nor the case's machinery."""
    command = [sys.executable, "-c", SEEN, *line.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    *printed, loaded = done.stdout.splitlines()
    assert said in "\n".join(printed) and not set(without) & set(ast.literal_eval(loaded))


@serial
def test_commands_and_rooms_are_imported_when_asked_for():
    assert all(callable(getattr(commands, name)) for name in commands.__all__)
    assert fenics_joints.modal.solve_modes is solve_modes and "preload" in dir(fenics_joints)
    for package in (commands, fenics_joints):
        with pytest.raises(AttributeError, match="has no attribute 'run_away'"):
            package.run_away  # noqa: B018


def test_progress_counts_to_what_is_done():
    """Progress takes totals, as from samplers, and single steps, as from loops."""
    stream = io.StringIO()
    with Progress(stream=stream) as progress:
        progress.interval = -1.0
        progress.step("sampling", 100)
        progress.advance(0)
        progress.interval = 10.0
        progress.reach(30)
        progress.advance(5)
        progress.interval = 0.0
        progress.reach(80, "half")
        progress.reach(104)
    assert stream.getvalue().splitlines() == [
        "sampling ...",
        "sampling: 0",
        "sampling: 80 of 100 (half)",
        "sampling: 104",
    ]

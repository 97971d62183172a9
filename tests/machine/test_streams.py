"""The command in an environment that lacks something: an answer, or one sentence and a status."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time

import pytest
from mpi4py import MPI

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")

FAST = "-m fenics_joints database show"


def run(shell: str, *, cwd=None, **variables: str) -> tuple[int, bytes, str]:
    """Runs a line of a shell in which $P is Python; status, output, and errors as text."""
    env = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")} | variables
    command = ["sh", "-c", f"P={shlex.quote(sys.executable)}; {shell}"]
    done = subprocess.run(command, capture_output=True, cwd=cwd, env=env, timeout=120, check=False)
    error = done.stderr.decode(errors="replace")
    assert "Traceback" not in error and "please report" not in error, error
    return done.returncode, done.stdout, error


@pytest.fixture(scope="module")
def answer() -> str:
    status, out, error = run(f"$P {FAST}")
    assert status == 0, error
    return out.decode()


def numbers(text: str) -> list[str]:
    return re.findall(r"\d+\.\d+", text)


@pytest.mark.parametrize("encoding", ["latin-1", "ascii:strict", "cp437"])
def test_numbers_are_the_same_in_every_encoding(answer, encoding):
    status, out, error = run(f"$P {FAST}", PYTHONIOENCODING=encoding)
    text = out.decode(encoding.split(":")[0])
    assert (status, numbers(text), error) == (0, numbers(answer), "")
    assert not answer.isascii() and "?" not in text and "\\x" not in text and "\\u" not in text


def test_schema_is_json_in_every_encoding():
    status, out, error = run("$P -m fenics_joints schema", PYTHONIOENCODING="ascii")
    assert (status, "properties" in json.loads(out)) == (0, True), error


@pytest.mark.parametrize("columns", ["0", "x", "", "1e9"])
def test_width_that_no_terminal_has_is_left_out(answer, columns):
    status, out, _ = run(f"$P {FAST}", COLUMNS=columns)
    assert (status, out.decode()) == (0, answer)


@pytest.mark.parametrize(
    ("shell", "status"),
    [
        ("<&-", 0),
        ("2>&-", 0),
        (">&-", 1),
        ("<&- >&- 2>&-", 1),
        (">/dev/full", 1),
        ("2>/dev/full", 0),
        (">&- --csv rows.csv -q", 0),
        ("--csv /dev/full", 1),
    ],
)
def test_closed_and_full_streams(answer, tmp_path, shell, status):
    """What could not be written is said; a file never takes the number of a closed stream."""
    found, out, error = run(f"$P {FAST} {shell}", cwd=tmp_path)
    assert found == status
    if status and "2>" not in shell:
        assert error.count("\n") == 1 and error.startswith("error: "), error
    if not status and ">&- -" not in shell:
        assert out.decode() == answer
    if "rows.csv" in shell:
        assert (tmp_path / "rows.csv").read_text(encoding="utf-8").startswith("diameter")


def test_version_on_a_full_disk():
    status, _, error = run("$P -m fenics_joints --version >/dev/full")
    assert (status, error.count("\n")) == (1, 1)


def test_folder_that_was_removed(tmp_path):
    status, out, error = run(f"mkdir gone; cd gone; rmdir ../gone; $P {FAST}", cwd=tmp_path)
    assert (status, out) == (1, b"") and "folder" in error.splitlines()[-1]


def test_without_a_home_or_a_folder_for_temporary_files(answer, tmp_path):
    status, out, error = run(f"unset HOME; TMPDIR={tmp_path / 'nowhere'} $P {FAST}")
    assert (status, out.decode()) == (0, answer), error


def test_without_a_home_none_is_taken_where_others_can_put_files(tmp_path):
    """PETSc would take options from .petscrc there, which can load a library."""
    code = """
import os, pwd
from fenics_joints.machine.streams import environment
pwd.getpwuid = lambda uid: (_ for _ in ()).throw(KeyError(uid))  # a user without an entry
environment()
print(os.environ["HOME"], oct(os.stat(os.environ["HOME"]).st_mode)[-3:])
"""
    status, out, error = run(
        f"unset HOME; $P -c {shlex.quote(code)}", cwd=tmp_path, TMPDIR=str(tmp_path)
    )
    home, mode = out.decode().split()
    assert (status, mode) == (0, "700") and os.path.dirname(home) == str(tmp_path), error
    assert not os.path.exists(home)  # removed at the end


@pytest.mark.parametrize(
    ("error", "reported"),
    [
        ("ConnectionRefusedError(111, 'refused')", True),
        ("OSError('\\x1b[2J')", True),
        ("OSError(errno.ENOSPC, 'full')", False),
        ("FileNotFoundError(errno.ENOENT, 'none', 'name')", False),
    ],
)
def test_only_errors_of_files_are_called_so(error, reported):
    """Others are to be reported."""
    code = "import errno\nfrom fenics_joints.parallel import guarded\n"
    code += f"with guarded(): raise {error}"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 1 and "\x1b" not in done.stderr
    assert ("please report" in done.stderr) is reported, done.stderr


def test_names_that_are_no_utf8(tmp_path):
    """As an old disk has them: cases are read, and results written; a case cannot name them."""
    make = '$P -m fenics_joints new "$B" --beams --yes'
    name = "B=$(printf 'a\\377b')"
    status, _, error = run(
        f'{name}; {make}; $P -m fenics_joints check "$B" --json "$B.json"', cwd=tmp_path
    )
    assert status == 0, error
    (made,) = tmp_path.glob("*.json")
    assert b"\xff" in os.fsencode(made) and json.loads(made.read_bytes())["dofs"] > 0


@pytest.mark.parametrize("kilobytes", [150_000, 600_000])
def test_too_little_memory(tmp_path, kilobytes):
    """Said before a library is imported: OpenBLAS waits for memory for ever."""
    limit = f"ulimit -v {kilobytes}; $P -m fenics_joints"
    status, out, error = run(f"{limit} check .", cwd=tmp_path)
    assert (status, out) == (1, b"") and "memory" in error and len(error.splitlines()) <= 2
    status, out, _ = run(f"{limit} check --help", cwd=tmp_path)
    assert status == 0 and b"CASE" in out


STOPPED = """
import sys, time
from fenics_joints.parallel import guarded
with guarded():
    print("inside", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_ctrl_c_on_two_ranks_needs_no_abort():
    command = ["mpirun", "-n", "2", sys.executable, "-c", STOPPED]
    pipe = dict(stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    process = subprocess.Popen(command, text=True, start_new_session=True, **pipe)
    assert [process.stdout.readline() for _ in range(2)] == ["inside\n"] * 2
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode != 0 and "MPI_ABORT" not in out, out

"""Summaries on the terminal: nothing cut, and no escape codes where nobody reads them."""

from __future__ import annotations

import io
import os
import pty
import shutil
import subprocess
import sys

import pytest
from mpi4py import MPI
from rich.console import Console

from fenics_joints.progress import Progress
from fenics_joints.report.document import Document, Table, Text
from fenics_joints.report.terminal import show

if MPI.COMM_WORLD.size > 1:
    pytest.skip("about one process", allow_module_level=True)

CELLS = (
    "stiffness of the layer near the second bolt",
    "1234.567 ± 0.234 kN/mm",
    "1250.001",
    "-12.34 %",
    "from 34 mm to 56 mm, or 78 mm",
)


def printed(width: int) -> str:
    stream = io.StringIO()
    console = Console(file=stream, width=width)
    table = Table("parameter | >identified | >predicted, Hz | >error | range")
    table.add(*CELLS)
    words = "a sentence that is longer than the line on which it stands, with its caveat"
    show(console, Document("case", "result", blocks=[table, Text(words)]))
    return stream.getvalue()


@pytest.mark.parametrize("width", [50, 64, 100])
def test_nothing_is_cut(width):
    text = printed(width)
    assert "…" not in text and max(map(len, text.splitlines())) <= width
    words = sorted(w for cell in CELLS for w in cell.split())
    rows = text.partition("─\n")[2].partition("a sentence")[0]
    assert sorted("".join(rows.split())) == sorted("".join(words))
    if width >= 64:
        assert sorted(rows.split()) == words  # and broken at spaces only
    if width >= 100:
        assert all(cell in text for cell in CELLS[1:4])  # numbers stay whole while names wrap
    assert " ".join(text.split()).endswith("with its caveat")


SCRIPT = (
    "from fenics_joints.report.terminal import new_console, say\n"
    "from fenics_joints.progress import Progress\n"
    "import sys\n"
    "with Progress(stream=sys.stdout) as progress:\n"
    "    progress.step('a step')\n"
    "console = new_console()\n"
    "say(console, 'words', 'bold red')\n"
    "print(console.width)\n"
)


def environment(**more: str) -> dict[str, str]:
    left_out = ("COLUMNS", "NO_COLOR", "FORCE_COLOR", "TERM")
    return {k: v for k, v in os.environ.items() if k not in left_out} | {"TERM": "xterm"} | more


def on_a_terminal(**more: str) -> str:
    """What the script writes to a terminal of its own."""
    leader, follower = pty.openpty()
    command, given = [sys.executable, "-c", SCRIPT], environment(**more)
    subprocess.run(command, stdout=follower, env=given, check=True, timeout=60)
    os.close(follower)
    with open(leader, "rb", closefd=True) as stream:
        data = b""
        try:
            while chunk := os.read(stream.fileno(), 4096):
                data += chunk
        except OSError:
            pass  # Linux says so that the other end is closed
    return data.decode()


def test_escape_codes_are_for_terminals_only():
    assert "\x1b[1;31mwords" in on_a_terminal()
    plain = on_a_terminal(NO_COLOR="1")
    assert "words" in plain and "31m" not in plain and "\x1b[1m" not in plain
    assert "\x1b" not in on_a_terminal(TERM="dumb")
    command = [sys.executable, "-c", SCRIPT]
    run = subprocess.run(command, capture_output=True, text=True, env=environment(), check=True)
    assert run.stdout.splitlines() == ["a step ...", "words", "100"]


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_no_escape_codes_under_mpirun():
    """Open MPI gives each rank a terminal, and passes on what is written there."""
    command = ["mpirun", "-n", "1", sys.executable, "-c", SCRIPT]
    run = subprocess.run(command, capture_output=True, text=True, env=environment(), check=True)
    assert run.stdout.splitlines() == ["a step ...", "words", "100"]


def test_a_step_says_what_is_left_of_it(monkeypatch):
    clock, stream = [0.0], io.StringIO()
    monkeypatch.setattr("fenics_joints.progress.time.monotonic", lambda: clock[0])
    with Progress(stream=stream) as progress:
        progress.outline(["read", "solve"])
        progress.step("solving", 5)
        for clock[0] in (11.0, 22.0):
            progress.advance()
    assert stream.getvalue().splitlines() == [
        "stages: 1. read; 2. solve",
        "solving ...",
        "solving: 1 of 5, about 44 s left",
        "solving: 2 of 5, about 33 s left",
    ]

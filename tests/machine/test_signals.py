"""Signals to a process that is inside PETSc, and readers that go away."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
from mpi4py import MPI

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")

#: Waits in a function that PETSc calls, whose exceptions PETSc turns into its own errors; the
#: clean-up takes a while.
SCRIPT = """
import sys, time
from fenics_joints.parallel import guarded
with guarded():
    from petsc4py import PETSc

    def residual(snes, x, f):
        print("inside", flush=True)
        time.sleep(20)

    snes = PETSc.SNES().create(PETSc.COMM_SELF)
    x = PETSc.Vec().createSeq(1)
    snes.setFunction(residual, x.duplicate())
    try:
        try:
            snes.solve(None, x)
        except {caught}:
            raise PETSc.Error(-1)
    finally:
        time.sleep(1.0)
"""


def run(code: str) -> subprocess.Popen:
    process = subprocess.Popen(
        [sys.executable, "-c", code], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout.readline() == "inside\n"
    return process


@serial
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
@pytest.mark.parametrize("caught", ["ZeroDivisionError", "BaseException"])
def test_a_stop_is_known_as_one_even_inside_petsc(number, code, caught):
    process = run(SCRIPT.format(caught=caught))
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert "stopped; no file" in err and "unexpected" not in err


@serial
def test_further_signals_while_it_leaves_print_no_traceback():
    process = run(SCRIPT.format(caught="ZeroDivisionError"))
    while process.poll() is None:  # to its very end
        process.send_signal(signal.SIGTERM)
        time.sleep(0.01)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 143
    assert "Traceback" not in err


@serial
def test_a_reader_that_goes_away_is_not_the_end():
    """PETSc's handler would abort; so would a web page whose tab is closed."""
    code = """
import os
from fenics_joints.parallel import guarded
with guarded():
    from petsc4py import PETSc
    r, w = os.pipe(); os.close(r)
    try:
        os.write(w, b"x")
    except BrokenPipeError:
        print("goes on")
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (found.returncode, found.stdout) == (0, "goes on\n"), found.stderr


@serial
def test_output_into_a_closed_pipe():
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "fenics_joints", "database", "show"]
    process = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert "Traceback" not in process.stderr and "PETSC" not in process.stderr, process.stderr
    assert process.returncode in (0, 1, 141)

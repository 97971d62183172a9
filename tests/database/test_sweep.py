"""Sweeps over samples: ranks share them, a killed one goes on."""

from __future__ import annotations

import contextlib
import math
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mpi4py import MPI

from fenics_joints.database import JointRow, Sample, Store, grid, sweep
from fenics_joints.errors import InputError

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


def closed_form(sample: Sample, factor: float = 1.0) -> dict[str, float]:
    """A power law, and no answer for the thickest plate."""
    if sample.thickness > 0.035:
        raise ValueError("too thick")
    radius = factor * 4e-3 * sample.force**0.2 * sample.thickness**0.3
    return {"radius": radius, "pressure": sample.force / (math.pi * radius**2)}


SAMPLES = grid(["M12"], [2e4, 3e4, 4e4, 5e4], [0.01, 0.02, 0.03, 0.04])


@pytest.mark.parallel
def test_ranks_share_a_sweep_and_a_failed_sample_stops_no_other(shared_tmp_path):
    comm = MPI.COMM_WORLD
    path = shared_tmp_path / "joints.db"
    if comm.rank == 0:
        Store(path, create=True).close()
    comm.barrier()
    calls = []

    def analyse(sample, **settings):
        calls.append(sample)
        time.sleep(0.02)
        return closed_form(sample, **settings)

    with Store(path) as store:
        first = sweep(SAMPLES, analyse, store, comm, model="law", settings={"factor": 1.5})
        here = comm.allgather(calls)
        assert sorted(map(repr, sum(here, []))) == sorted(map(repr, SAMPLES))  # each one once
        assert all(here)  # by all ranks
        assert first.computed == 12 and len(first.failed) == 4
        assert set(first.failed.values()) == {"ValueError: too thick"}
        rows = {(j.force, j.thickness): j for j in store.joints()}
        for s in SAMPLES:
            if s.thickness < 0.035:
                assert rows[s.force, s.thickness].radius == closed_form(s, 1.5)["radius"]
        row = rows[2e4, 0.01]
        assert (row.model, row.settings, row.bolt) == ("law", '{"factor": 1.5}', "M12")
        assert row.version.startswith("fenics-joints") and row.date and row.author
        # Again: nothing is computed; with other settings, all; with retry, what failed.
        calls.clear()
        again = sweep(SAMPLES, analyse, store, comm, model="law", settings={"factor": 1.5})
        assert (again.computed, again.finished_before) == (0, 12)
        assert again.failed == first.failed and not any(comm.allgather(calls))
        made = {"model": "law", "settings": {"factor": 1.5}, "retry": True}
        sweep(SAMPLES, lambda s, **_: {"radius": 0.03}, store, comm, **made)
        assert len(store.joints()) == 16


_SLOW = """
import os, time
from pathlib import Path

def analyse(sample, folder):
    with open(Path(folder) / "calls", "a") as calls:
        calls.write(f"{sample.force:g} {sample.thickness:g}\\n")
    time.sleep(0.15)
    return {"radius": 0.02 + 1e-6 * sample.force * sample.thickness}
"""


@serial
def test_a_killed_sweep_goes_on_and_loses_or_repeats_nothing_finished(tmp_path):
    """Two ranks if there is mpirun, killed by SIGKILL amid a sample; then again to the end."""
    (tmp_path / "slow_analysis.py").write_text(_SLOW)
    database = tmp_path / "joints.db"
    words = f"database sweep --db {database} --bolt M12 --force '10, 20, 30, 40 kN' --thickness "
    words += f"'10, 20, 30 mm' --analysis slow_analysis:analyse --set folder={tmp_path} --ranks 2"
    command = [sys.executable, "-m", "fenics_joints", *shlex.split(words)]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}

    def rows() -> list[JointRow]:
        with contextlib.suppress(InputError), Store(database) as store:
            return store.joints()
        return []  # it is not there, or without its tables for a moment

    def start():
        pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        return subprocess.Popen(command, env=environment, start_new_session=True, **pipes)

    run = start()
    end = time.monotonic() + 60
    while not 3 <= len(rows()) < 12:
        assert run.poll() is None and time.monotonic() < end, run.stderr.read()
        time.sleep(0.02)
    _kill_ranks(str(database))
    run.communicate()
    before, called = rows(), (tmp_path / "calls").read_text().splitlines()
    assert 3 <= len(before) < 12
    again = start()
    _, errors = again.communicate(timeout=60)
    assert again.returncode == 0, errors
    after = rows()
    assert after[: len(before)] == before and len(after) == 12
    assert {(j.force, j.thickness) for j in after} == {
        (f, b) for f in (1e4, 2e4, 3e4, 4e4) for b in (0.01, 0.02, 0.03)
    }
    # What was finished before the kill was not called again.
    later = (tmp_path / "calls").read_text().splitlines()[len(called) :]
    assert len(later) == 12 - len(before)
    assert not {f"{j.force:g} {j.thickness:g}" for j in before} & set(later)


def _kill_ranks(word: str) -> None:
    """SIGKILL to what has the word, which only this test uses, among its arguments."""

    def has_word(process: Path) -> bool:
        with contextlib.suppress(OSError):
            return word.encode() in (process / "cmdline").read_bytes()
        return False

    end = time.monotonic() + 20
    while alive := [p for p in Path("/proc").glob("[0-9]*") if has_word(p)]:
        assert time.monotonic() < end, f"not killed: {alive}"
        for process in alive:
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(process.name), signal.SIGKILL)
        time.sleep(0.05)

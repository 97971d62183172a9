"""Ranks that the command starts by itself: as one rank to whoever looks on, and none is left."""

from __future__ import annotations

import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from mpi4py import MPI

from fenics_joints.machine import ranks

pytestmark = [
    pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own"),
    pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun"),
]

#: Waits on all ranks, or ends as it is told.
SCRIPT = """
import os, sys, time
from fenics_joints.machine import ranks
from fenics_joints.parallel import guarded
if ranks.may_start():
    sys.exit(ranks.run_on(2))
with ranks.reported(), guarded():
    from mpi4py import MPI
    comm = MPI.COMM_WORLD
    ranks.join(comm.rank, comm.size)
    print(comm.rank, os.getpid(), file=sys.stderr, flush=True)
    if sys.argv[1:] == ["fails alone"] and comm.rank == 1:
        raise ValueError("of rank 1")
    time.sleep(60)
"""


@pytest.fixture
def start(tmp_path):
    """Starts `SCRIPT`; gives the process, and those of its ranks once they are up."""
    (tmp_path / "__main__.py").write_text(SCRIPT)
    (tmp_path / "tmp").mkdir()

    def started(*arguments: str) -> tuple[subprocess.Popen, list[int]]:
        process = subprocess.Popen(
            [sys.executable, str(tmp_path / "__main__.py"), *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "TMPDIR": str(tmp_path / "tmp")},
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # as of a terminal
        )
        up = sorted(process.stderr.readline().split() for _ in range(2))
        assert [rank for rank, _ in up] == ["0", "1"]
        return process, [int(pid) for _, pid in up]

    return started


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def ends(pids: list[int], seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while any(map(is_running, pids)) and time.monotonic() < end:
        time.sleep(0.05)
    return not any(map(is_running, pids))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_all_ranks_as_it_ends_one(start, tmp_path, number):
    process, pids = start()
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (128 + number, "stopped; no file is left half-written\n")
    assert ends(pids) and not list((tmp_path / "tmp").glob("fenics_joints*"))


def test_a_killed_rank_ends_the_others(start, tmp_path):
    process, pids = start()
    os.kill(pids[1], signal.SIGKILL)
    _, err = process.communicate(timeout=60)
    assert process.returncode not in (0, None)
    assert "error: rank 1 of 2 was ended by SIGKILL" in err and "----" not in err, err
    assert ends(pids) and not list((tmp_path / "tmp").glob("fenics_joints*"))


def test_a_killed_parent_leaves_no_ranks(start, tmp_path):
    process, pids = start()
    process.kill()
    process.communicate(timeout=60)
    assert ends(pids) and not list((tmp_path / "tmp").glob("fenics_joints*"))


def test_a_rank_that_fails_alone_speaks_once(start):
    process, pids = start("fails alone")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1 and ends(pids)
    (line,) = [line for line in err.splitlines() if line.startswith("error")]
    assert "(on rank 1)" in line and "of rank 1" in line and "MPI" not in err


def on_terminal(*arguments: str) -> tuple[int, str]:
    """Status of the command, and what a terminal of 80 columns shows."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "fenics_joints", *arguments],
        stdout=theirs,
        stderr=theirs,
        env={**os.environ, "COLUMNS": "80", "TERM": "xterm-256color"},
    )
    os.close(theirs)
    shown = b""
    with suppress(OSError):  # Linux's end of a terminal
        while words := os.read(ours, 65536):
            shown += words
    os.close(ours)
    return process.wait(timeout=60), shown.decode()


@pytest.mark.smoke
def test_two_ranks_print_on_a_terminal_as_one(tmp_path, write_case):
    write_case(tmp_path)
    printed, frequencies = {}, {}
    for n in (1, 2):
        out = str(tmp_path / f"{n}.json")
        status, shown = on_terminal("modes", str(tmp_path), "--ranks", str(n), "--json", out)
        assert status == 0, shown
        result = json.loads(Path(out).read_text())
        assert result["run"]["ranks"] == n and "solving 14 modes" in shown and "\x1b[" in shown
        # From the first line of the result on: before it the progress is redrawn as time passes.
        printed[n] = shown[shown.rindex("Lap plates") :].replace(out, "")
        frequencies[n] = result["frequencies_hz"]
    assert printed[1] == printed[2] and "\x1b[" in printed[1]
    assert frequencies[1] == pytest.approx(frequencies[2], rel=1e-8)


@pytest.mark.parametrize("n", ["1", "2"])
def test_an_error_is_one_line(tmp_path, n):
    command = [sys.executable, "-m", "fenics_joints", "modes", str(tmp_path / "none"), "--ranks", n]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(r"error: .*no such file.*\n", done.stderr), done.stderr


@pytest.mark.parametrize(
    ("mpirun", "said"),
    [
        ('shift 2; OMPI_COMM_WORLD_RANK=0 "$@" & OMPI_COMM_WORLD_RANK=1 "$@"; wait', "another MPI"),
        ("echo no slots >&2; exit 3", "no slots"),
    ],
)
def test_without_the_right_mpirun_one_rank_computes(tmp_path, write_case, mpirun, said):
    """As where mpirun belongs to another MPI, or may not start anything."""
    write_case(tmp_path)
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "mpirun"
    program.write_text(f"#!/bin/sh\n{mpirun}\n")
    program.chmod(0o700)
    out = tmp_path / "modes.json"
    command = [sys.executable, "-m", "fenics_joints", "modes", str(tmp_path), "--json", str(out)]
    done = subprocess.run(
        [*command, "--ranks", "2"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}"},
    )
    assert done.returncode == 0, done.stderr
    (note,) = [line for line in done.stderr.splitlines() if line.startswith("note: one rank")]
    assert said in note and json.loads(out.read_text())["run"]["ranks"] == 1


def test_cores_are_neither_threads_nor_those_of_others(tmp_path, monkeypatch):
    """Four cores of two threads, of which this process may use three and a half."""
    for n in range(8):
        folder = tmp_path / f"sys/devices/system/cpu/cpu{n}/topology"
        folder.mkdir(parents=True)
        (folder / "thread_siblings_list").write_text(f"{n % 4},{n % 4 + 4}\n")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)))
    assert ranks.cores(tmp_path) == 4
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {1, 2, 5, 7})
    assert ranks.cores(tmp_path) == 3
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text("0::/a/b\n")
    group = tmp_path / "sys/fs/cgroup/a"
    (group / "b").mkdir(parents=True)
    (group / "b/cpu.max").write_text("max 100000\n")
    assert ranks.cores(tmp_path) == 3
    (group / "cpu.max").write_text("250000 100000\n")
    assert ranks.cores(tmp_path) == 2
    (tmp_path / "proc/self/cgroup").write_text("4:cpu,cpuacct:/c\n")
    old = tmp_path / "sys/fs/cgroup/cpu/c"
    old.mkdir(parents=True)
    (
        (old / "cpu.cfs_quota_us").write_text("50000\n"),
        (old / "cpu.cfs_period_us").write_text("1000\n"),
    )
    assert ranks.cores(tmp_path) == 3
    (old / "cpu.cfs_quota_us").write_text("500\n")
    assert ranks.cores(tmp_path) == 1


def test_a_rank_and_a_job_of_a_batch_system_start_nothing(monkeypatch):
    for name in (*ranks.LAUNCHED, "SLURM_PROCID", "SLURM_JOB_ID", "PBS_JOBID", "LSB_JOBID"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "argv", ["/usr/bin/fenics-joints", "modes"])
    assert ranks.may_start()
    for name in ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "SLURM_PROCID", "PBS_JOBID"):
        with monkeypatch.context() as patch:
            patch.setenv(name, "0")
            assert not ranks.may_start()
    monkeypatch.setattr(sys, "argv", ["/usr/bin/ipykernel_launcher.py"])
    assert not ranks.may_start()

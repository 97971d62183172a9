"""Commands that are killed at random moments: nothing finished is lost, the answer is the same."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own"),
]

DEMOS = Path(__file__).parents[2] / "demos"
KILLS = int(os.environ.get("KILLS", 20))
#: Keys of what differs between any two runs: times, counts of what was found ready, folders.
COUNTS = {"evaluations", "full_solutions", "calls", "computed", "kept", "iterations", "points"}
RUNTIME = COUNTS | {"seconds", "path", "history", "profile", "branch"}


def diagnosis(folder: Path) -> list[str]:
    shutil.copytree(DEMOS / "bolted_beams", folder, dirs_exist_ok=True)
    with (folder / "case.toml").open("a", encoding="utf-8") as file:
        file.write("max_effects = 1\nnested = 0\n")
    return ["diagnose", str(folder), "--keep", str(folder / "kept")]


def posterior(folder: Path) -> list[str]:
    shutil.copytree(DEMOS / "bolted_beams", folder, dirs_exist_ok=True)
    return ["update", "--bayes", str(folder), "--keep", str(folder / "chains.nc")]


def branches(folder: Path) -> list[str]:
    from harmonic_case import write

    write(folder)
    return ["harmonic", str(folder), "--branches", str(folder / "branches")]


def rows(folder: Path) -> list[str]:
    command = "database sweep --bolt M12 --force 20kN,30kN --thickness 10mm,14mm --db"
    return [*command.split(), str(folder / "own.db")]


def run(command: list[str], ranks: int, seconds: float | None = None) -> bool:
    """Whether it ended by itself within this time; else it, and all it started, is killed."""
    mark = f"{time.monotonic_ns()}"
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    process = subprocess.Popen(
        [*launcher, sys.executable, "-m", "fenics_joints", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "KILLED_BY": mark},
    )
    try:
        out, _ = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        for pid in [p for p in Path("/proc").iterdir() if p.name.isdigit()]:
            try:
                if f"KILLED_BY={mark}".encode() in (pid / "environ").read_bytes():
                    os.kill(int(pid.name), signal.SIGKILL)
            except (OSError, ProcessLookupError):
                continue
        process.communicate()
        return False
    assert process.returncode == 0, out
    return True


def answers(value, where=()):
    """Numbers and words of a result, without what differs from run to run."""
    if isinstance(value, dict):
        for key, each in value.items():
            if key not in RUNTIME:
                yield from answers(each, (*where, key))
    elif isinstance(value, list):
        for i, each in enumerate(value):
            yield from answers(each, (*where, i))
    else:
        yield where, value


def tolerance(key: tuple) -> dict[str, float]:
    """How far runs may lie apart: fits that start from others end elsewhere in the same valley.

    What data leave open moves by some hundredths of its prior's standard deviation.
    """
    return {"rel": 2e-2, "abs": 0.05 if key[-1] == "prior_sigmas" else 5e-3}


def rows_of(database: str, csv: Path) -> list[list[str]]:
    """Samples and results of a database, without the times."""
    command = [*"-m fenics_joints database show --db".split(), database, "--csv", str(csv)]
    subprocess.run([sys.executable, *command], capture_output=True, check=True)
    return sorted(line.split(",")[:7] for line in csv.read_text().splitlines())


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("made", [diagnosis, branches, posterior, rows])
def test_killed_runs_go_on_to_the_same_answer(tmp_path, made, ranks):
    told = []
    for name in ("undisturbed", "killed"):
        folder = tmp_path / name
        folder.mkdir()
        command = made(folder)
        if made is not rows:
            command += ["--json", str(tmp_path / f"{name}.json")]
        told.append(command)
    run(told[0], ranks)  # forms are compiled from now on
    for path in tmp_path.glob("undisturbed/*"):
        if path.name in ("kept", "branches"):
            shutil.rmtree(path)
        elif path.suffix in (".nc", ".db"):
            path.unlink()
    begun = time.monotonic()
    run(told[0], ranks)
    length = time.monotonic() - begun
    draw, ended = random.Random(7), 0
    for _ in range(KILLS):
        ended += run(told[1], ranks, draw.uniform(0.15, 1.0) * length)
    assert ended < KILLS
    run(told[1], ranks)
    if made is rows:
        shown = [rows_of(t[-1], tmp_path / "rows.csv") for t in told]
        assert shown[0] == shown[1]
        return
    first, second = (
        dict(answers(json.loads((tmp_path / f"{name}.json").read_text())))
        for name in ("undisturbed", "killed")
    )
    assert first.keys() == second.keys()
    other = [
        f"{key}: {value} undisturbed, {second[key]} after kills"
        for key, value in first.items()
        if isinstance(value, float) and second[key] != pytest.approx(value, **tolerance(key))
    ]
    assert not other, "\n".join(other)
    left = [p for p in (tmp_path / "killed").rglob("*") if ".part" in p.name]
    assert np.size(left) <= KILLS, left

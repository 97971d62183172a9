"""What the benchmarks share: whole processes and calls with their times, arguments, results.

Imports Python's own library alone: some are started where there is no DOLFINx.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def parser(doc: str, parts: Mapping[str, Callable] = {}) -> argparse.ArgumentParser:  # noqa: B006
    """A parser with ``--json FILE``, and with parts of which all are run by default."""
    made = argparse.ArgumentParser(description=doc.splitlines()[0])
    if parts:
        made.add_argument("parts", nargs="*", choices=[*parts, []], help="all by default")
    made.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    return made


def across_processes(made: argparse.ArgumentParser, roles) -> argparse.ArgumentParser:
    """Add how FEniCSx is entered, and what a child process is told."""
    made.add_argument("--launcher", help="command that enters FEniCSx; '' for none")
    made.add_argument("--as", dest="role", choices=roles, help=argparse.SUPPRESS)
    made.add_argument("--output", type=Path, help=argparse.SUPPRESS)
    return made


def write(path: Path | None, found) -> None:
    """Write the numbers, if a file was asked for."""
    if path is not None:
        path.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


def timed(function: Callable):
    """Result, wall and processor time, s."""
    wall, processor = time.perf_counter(), time.process_time()
    result = function()
    return result, time.perf_counter() - wall, time.process_time() - processor


def launcher(given: str | None) -> list[str]:
    """Command that enters FEniCSx; none where DOLFINx is at hand."""
    if given is not None:
        return shlex.split(given)
    return [] if find_spec("dolfinx") else [str(ROOT / "with-fenicsx")]


def python_command(given: str | None, script: str, *words: object, ranks: int = 1) -> list[str]:
    """Command that runs a script on so many ranks, through the launcher if that is needed."""
    start = launcher(given)
    wide = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    python = "python3" if start else sys.executable
    return [*start, *wide, python, str(Path(script).resolve()), *map(str, words)]


def threads(count: int) -> dict[str, str]:
    """Environment of one process with so many threads."""
    return {
        "OMP_NUM_THREADS": str(count),
        "OPENBLAS_NUM_THREADS": str(count),
        "FENICS_JOINTS_RANKS": "1",
    }


def run(command, cwd: Path, environment: Mapping[str, str]) -> dict[str, float]:
    """Run a whole process; its wall-clock and processor seconds. Ends this one if it fails."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True
    )
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        said = done.stdout[-2000:] + done.stderr[-4000:]
        sys.exit(f"{shlex.join(map(str, command))} failed:\n{said}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall": wall, "cpu": cpu}

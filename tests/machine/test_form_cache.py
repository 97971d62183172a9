"""The cache of compiled forms against processes that are killed, and folders that fail."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from mpi4py import MPI

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")

#: Assembles a form that is slow enough to be killed in, and says so when it begins and ends.
SCRIPT = """
import dolfinx, ufl
from mpi4py import MPI
from fenics_joints.machine import form_cache
form_cache.install()
form_cache.install()
mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
x = ufl.SpatialCoordinate(mesh)
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
print("begins", flush=True)
form = dolfinx.fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * x[0] ** 3 * ufl.dx)
volume = dolfinx.fem.form(dolfinx.fem.Constant(mesh, 1.0) * (1 + {seed} * x[0]) * ufl.dx)
print(dolfinx.fem.assemble_scalar(volume))
"""


def start(cache: Path, seed: int = 0, **variables: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT.format(seed=seed)],
        text=True,
        start_new_session=True,
        env={**os.environ, "XDG_CACHE_HOME": str(cache), **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def answer(process: subprocess.Popen) -> float:
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return float(out.split()[-1])


def forms(cache: Path) -> list[Path]:
    return sorted(p for p in (cache / "fenics" / "fenics_joints").iterdir() if p.is_dir())


def watched(cache: Path) -> set[str]:
    """Suffixes of what is half made now."""
    return {p.suffix for p in (cache / "fenics" / "fenics_joints").glob(".*/*")}


@serial
@pytest.mark.parametrize("until", [".c", ".o"])
def test_a_killed_compile_blocks_nobody(tmp_path, until):
    victim = start(tmp_path)
    end = time.monotonic() + 60
    while until not in watched(tmp_path) and time.monotonic() < end:
        time.sleep(0.005)
    os.killpg(victim.pid, signal.SIGKILL)
    victim.communicate()
    assert until in watched(tmp_path)
    begun = time.monotonic()
    assert answer(start(tmp_path)) == pytest.approx(1.0)
    assert time.monotonic() - begun < 60
    # What it left goes with age.
    left = next((tmp_path / "fenics" / "fenics_joints").glob(".*"))
    os.utime(left, (1e9, 1e9))
    assert answer(start(tmp_path, seed=1)) == pytest.approx(1.5)
    assert not left.exists() and len(forms(tmp_path)) == 3


@serial
def test_several_at_once_compile_once(tmp_path):
    with ThreadPoolExecutor() as pool:
        found = list(pool.map(answer, [start(tmp_path) for _ in range(4)]))
    assert found == pytest.approx([1.0] * 4)
    assert len(forms(tmp_path)) == 2 and not watched(tmp_path)
    made = [p.stat().st_mtime_ns for f in forms(tmp_path) for p in f.glob("*.so")]
    assert answer(start(tmp_path)) == pytest.approx(1.0)
    assert made == [p.stat().st_mtime_ns for f in forms(tmp_path) for p in f.glob("*.so")]


@serial
def test_damaged_forms_are_made_anew(tmp_path):
    """Of two forms each in its own way, twice: an empty library, no library, no mark, no source."""
    assert answer(start(tmp_path)) == pytest.approx(1.0)
    for first, second in (
        (lambda f: next(f.glob("*.so")).write_bytes(b""), lambda f: next(f.glob("*.so")).unlink()),
        (lambda f: next(f.glob("*.cached")).unlink(), lambda f: next(f.glob("*.c")).unlink()),
    ):
        for damage, folder in zip((first, second), forms(tmp_path), strict=True):
            damage(folder)
        assert answer(start(tmp_path)) == pytest.approx(1.0)
        assert all(next(folder.glob("*.so")).stat().st_size > 0 for folder in forms(tmp_path))


@serial
@pytest.mark.parametrize("place", ["a file", "read-only", "open to all", "another's"])
def test_without_a_place_forms_are_compiled_all_the_same(tmp_path, place):
    cache = tmp_path / "cache"
    if place == "a file":
        cache.write_text("not a folder")
    else:
        cache.mkdir()
    if place == "open to all":  # what is loaded from there is anybody's code
        cache.chmod(0o777)
    elif place == "another's":
        if os.geteuid():
            pytest.skip("only the superuser can make a folder that is another user's")
        os.chown(cache, 12345, 12345)
    elif place == "read-only":
        cache.chmod(0o500)
        if os.access(cache, os.W_OK):
            pytest.skip("this user may write anywhere")
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    for words in (0, 1):
        process = start(cache, TMPDIR=str(temporary))
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0 and float(out.split()[-1]) == pytest.approx(1.0), err
        assert err.count("cannot be kept there") == words
        # The first run's are still there; then it is as if another user had been there first.
        own = temporary / f"fenics_joints_{os.geteuid()}"
        assert len(list(own.rglob("*.so"))) == 2
        own.chmod(0o777)


@serial
def test_the_first_run_of_a_case_says_that_it_compiles(tmp_path, write_case):
    """Once, and nothing the second time, on two ranks that begin without any forms."""
    write_case(tmp_path)
    command = [sys.executable, "-m", "fenics_joints", "modes", str(tmp_path), "--ranks", "2"]
    for said in (1, 0):
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
            env={**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")},
        )
        assert done.returncode == 0 and done.stderr.count("compiling forms") == said, done.stderr
    assert forms(tmp_path / "cache")

"""Importing and calling the library leaves the rest of the process unchanged."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes itself")
ROOT = Path(__file__).resolve().parents[2]

#: Compares the state of the process before and after the package is imported and used.
SCRIPT = """
import ctypes, importlib, locale, os, pkgutil, signal, sys, threading, warnings
import setuptools  # the compiler of DOLFINx's forms, which has an environment of its own
from distutils.util import check_environ
check_environ()
import dolfinx, dolfinx.fem.petsc, matplotlib, mpi4py.MPI, petsc4py.PETSc, sklearn.gaussian_process

def state():
    return {
        "signals": [signal.getsignal(n) for n in signal.valid_signals()],
        "environment": dict(os.environ),
        "folder": (os.getcwd(), os.umask(os.umask(0o77) or 0)),
        "imports": (list(sys.meta_path), list(sys.path), list(sys.path_hooks)),
        "hooks": (sys.excepthook, threading.excepthook, sys.stdout, sys.stderr),
        "forms": dolfinx.jit.ffcx_jit,
        "options": petsc4py.PETSc.Options().getAll(),
        "locale": locale.setlocale(locale.LC_ALL),
        "pictures": dict(matplotlib.rcParams),
        "recursion": sys.getrecursionlimit(),
    }

class Recorded(ctypes.CDLL):
    def __getattr__(self, name):
        assert name != "mallopt"
        return super().__getattr__(name)

ctypes.CDLL, before = Recorded, state()
import fenics_joints
for module in pkgutil.walk_packages(fenics_joints.__path__, "fenics_joints."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Structure, part
tagged = box(mpi4py.MPI.COMM_SELF, (1.0, 0.1, 0.1), (4, 1, 1))
solve_modes(Structure(tagged, [part("box", tuple(tagged.cell_names), E=2e11, nu=0.3, rho=8e3)]))
after = state()
print([key for key in before if before[key] != after[key]])
"""


def test_importing_and_calling_it_changes_nothing_in_the_process():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stdout + done.stderr


def test_only_the_command_line_asks_the_machine_to_hold_memory():
    files = (ROOT / "fenics_joints").rglob("*.py")
    uses = {p.stem for p in files if "hold_freed" in p.read_text(encoding="utf-8")}
    assert uses == {"cli", "memory"}


def test_folders_beside_it_are_no_part_of_it():
    beside = ("tests", "docs", "demos", "benchmarks", "build")
    assert [name for name in beside if find_spec(f"fenics_joints.{name}")] == []

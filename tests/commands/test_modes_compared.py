"""A model's modes beside a test's: which are pairs, and that others are named and left out."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

pytest.importorskip("gmsh")

from fenics_joints.case import load_case
from fenics_joints.commands.modes import run_modes
from fenics_joints.progress import Progress

#: Plates on a clamped beam: measured torsion of the beam, 859 Hz, which sensors near the middle see
#: faintly, and which is like no mode that they see well.
STACK = Path(__file__).parent / "data" / "stack"


def beside(folder):
    return run_modes(load_case(folder), MPI.COMM_SELF, Progress(silent=True)).result.beside


def test_a_mode_seen_faintly_is_the_partner_of_the_shape_that_is_like_it():
    """925 Hz, the seventh, with a MAC of 0.99; not 1705 Hz, whose MAC is 0.001."""
    found = beside(STACK)
    assert found.index.tolist() == [0, 1, 3, 4, 5, 6, 7, 8]
    assert found.model_hz[5] == pytest.approx(925.4, rel=0.02)
    assert found.mac.min() > 0.98 and found.partnered.all()
    assert found.rms < 0.04


def test_a_shape_that_is_like_none_has_no_partner(tmp_path):
    """One sensor alone moves: named, null in the JSON, and no part of the error."""
    folder = shutil.copytree(STACK, tmp_path / "stack")
    head, *_ = (folder / "shapes.csv").read_text(encoding="utf-8").splitlines()
    shapes = np.loadtxt(folder / "shapes.csv", delimiter=",", skiprows=1)
    shapes[:, 5] = np.eye(len(shapes))[4]
    np.savetxt(folder / "shapes.csv", shapes, delimiter=",", header=head, comments="")
    found = beside(folder)
    assert found.alone == ("mode 6",) and found.rms < 0.04
    written = found.to_json()
    assert written["without_partner"] == ["mode 6"]
    assert written["pairs"][5]["mode"] is None and written["pairs"][5]["test_hz"] > 0

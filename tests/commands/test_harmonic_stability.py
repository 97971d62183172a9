"""Bifurcations and branches that leave there, in results, summary and page."""

import io
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from harmonic_case import LAYER, write
from mpi4py import MPI
from oscillators import TURN, escape
from rich.console import Console

from fenics_joints.case import load_case
from fenics_joints.commands.harmonic.document import harmonic_document
from fenics_joints.commands.harmonic.run import run_harmonic
from fenics_joints.commands.harmonic.stability import level_stability
from fenics_joints.harmonic import Stability, solve_harmonic
from fenics_joints.progress import Progress
from fenics_joints.report.html import as_page
from fenics_joints.report.terminal import show

QUIET = Progress(silent=True)


def test_a_doubled_period_is_followed_and_told(tmp_path):
    """Of the escape oscillator; its rows in a report of another structure."""
    response = solve_harmonic(
        escape(), "push", 0.06, (0.65 / TURN, 0.9 / TURN), harmonics=7, direction="down"
    )
    assert level_stability("no", [response], QUIET) == ()
    (found,) = level_stability("find", [response], QUIET)
    assert not found.branches and len(found.records()) == 1
    (found,) = level_stability("follow", [response], QUIET)
    told = found.to_json()
    assert told["stable"][0] and not told["stable"][-1]
    (doubling,), (branch,) = told["bifurcations"], told["branches"]
    assert doubling["kind"] == "period doubling" and doubling["unstable"] == [0, 1]
    assert branch["bifurcation"] == 0 and branch["periods"] == 2
    assert branch["frequency_hz"][0] == pytest.approx(doubling["frequency_hz"], rel=1e-3)
    one = 'levels = ["0.01 N", "10 N"]', 'levels = ["0.01 N"]'
    narrow = 'band = ["25 Hz", "31 Hz"]', 'band = ["28 Hz", "28.3 Hz"]'
    plain = 'measured = "frf.csv"', "backbone = false"
    report = run_harmonic(
        load_case(write(tmp_path, LAYER, one, narrow, plain)), MPI.COMM_SELF, QUIET
    ).result
    assert report.to_json()["stability"] == []
    shown, told = io.StringIO(), replace(report, stability=(found,))
    show(Console(file=shown, width=110), harmonic_document(told))
    assert "period doubling" in shown.getvalue() and "0, 1" in shown.getvalue()
    # In the picture at its own level.
    unstable = np.arange(len(report.responses[0])) % 2
    (at,) = found.stability.bifurcations
    drawn = Stability(unstable, unstable, (replace(at, index=0),))
    branches = ((drawn.bifurcations[0], report.responses[0]),)
    drawn = replace(found, level=report.facts[0].level, stability=drawn, branches=branches)
    assert "period doubling" in as_page(harmonic_document(replace(report, stability=(drawn,))))

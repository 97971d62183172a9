"""The ``harmonic`` command with a mode over its amplitude: the law it was made with comes out."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from harmonic_case import LAYER, write
from mpi4py import MPI
from typer.testing import CliRunner

from fenics_joints.case import load_case
from fenics_joints.cli import app
from fenics_joints.commands.harmonic.model import harmonic_model
from fenics_joints.harmonic import solve_backbone
from fenics_joints.progress import Progress

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


@serial
@pytest.mark.slow
def test_a_backbone_identifies_the_law_and_the_answer_says_what_it_cannot(tmp_path):
    """Phase resonance of the truth, with noise; the case's damping and modulus are a bit wrong."""
    few = "interface_modes = 0\nmodes = 6\n"
    bare = LAYER.replace('measured = "frf.csv"\n', few).replace("500 kPa", "200 kPa")
    built = harmonic_model(load_case(write(tmp_path, bare)), MPI.COMM_SELF, Progress(silent=True))
    truth = solve_backbone(
        built.model, (1e-4, 5e-3), force="force", near=28, sensor="sensor", harmonics=3, samples=64
    )
    at, rng = np.linspace(0, len(truth) - 1, 8).astype(int), np.random.default_rng(3)
    rows = np.column_stack(
        [
            truth.amplitude("sensor", "acceleration")[at] / 9.80665,
            truth.frequencies_hz[at] * (1 + 2e-4 * rng.normal(size=8)),
            100 * truth.damping_ratios[at] * (1 + 0.01 * rng.normal(size=8)),
        ]
    )
    lines = ["level [g],frequency [Hz],damping [%]", *(",".join(map(str, r)) for r in rows)]
    (tmp_path / "data.csv").write_text("\n".join(lines), encoding="utf-8")
    write(
        tmp_path,
        bare + '[harmonic.identify]\nparameters = ["lap.S_y"]\n[test]\namplitude = '
        '{ "bending 1" = { files = "data.csv", noise = "0.02 %", damping_noise = "1 %" } }\n',
        ('S_y = "200 kPa"', 'S_y = "400 kPa"'),
        ('damping = "1 %"', 'damping = "0.8 %"'),
        ('E = "207 GPa"', 'E = "208 GPa"'),
        ('levels = ["0.01 N", "10 N"]', 'levels = ["0.1 N"]'),
    )
    found = tmp_path / "found.json"
    page = tmp_path / "page.html"
    run = CliRunner().invoke(
        app, ["harmonic", str(tmp_path), "--json", str(found), "--report", str(page)]
    )
    assert run.exit_code == 0, run.output
    (one,) = json.loads(found.read_text(encoding="utf-8"))["identified"]
    assert abs(np.log(one["values"]["lap.S_y"] / 200e3)) < 2.5 * one["sd_ln"]["lap.S_y"] < 0.1
    rest = one["backbone"]["at_rest"]
    assert rest["damping at rest"]["value"] == pytest.approx(2e-3, abs=3e-4)
    assert rest["frequency at rest"]["value"] < 0
    words = " ".join(run.output.split())
    assert "Identified from a mode at 8 amplitudes (backbone)" in words
    assert "below the model's" in words and "more than the model, at all" in words
    html = page.read_text(encoding="utf-8")
    assert "from a mode at 8 amplitudes" in html and "Crosses: the test." in html

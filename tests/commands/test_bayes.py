"""``fenics-joints update --bayes`` on a case, and what is wrong with a case, in words."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pytest
from mpi4py import MPI
from rich.console import Console
from typer.testing import CliRunner
from virtual_beams import DEMO, written

from fenics_joints.case import build_structure, load_case
from fenics_joints.cli import app
from fenics_joints.commands.bayes import run as bayes_run
from fenics_joints.commands.bayes.model import case_model
from fenics_joints.commands.bayes.run import run_bayes
from fenics_joints.errors import InputError
from fenics_joints.files import json_text
from fenics_joints.progress import Progress
from fenics_joints.reduction import ModalPrediction

pytest.importorskip("arviz")

SPECIMENS = 'specimens = "specimens_simulated.csv"'


@pytest.mark.parallel
def test_small_model_is_the_whole_one():
    """Within 0.01 % at 50 points of the prior, against the beams themselves."""
    case = load_case(DEMO)
    model = case_model(case, MPI.COMM_WORLD)
    assert model.check.n_points == 50 and model.check.error < 1e-4
    beams, sensors = build_structure(case, MPI.COMM_WORLD), case.sensors()
    exact = ModalPrediction(beams.arrays(sensors), sensors, 5, 16)
    values = model.prior.values(model.prior.sample(20, np.random.default_rng(77)))
    log_f = [exact(point)[0] for point in model.frequencies.by_name(values)]
    np.testing.assert_allclose(model.frequencies(values), log_f, atol=1e-4)
    assert model.n_basis < model.n_dofs / 4
    # A proposal beyond a law's limit is no end of the others.
    beyond = model.frequencies(np.vstack([values[:2], [[1763.0, -1.0]]]))
    np.testing.assert_allclose(beyond[:2], log_f[:2], atol=1e-4)
    assert np.all(np.isnan(beyond[2]))


@pytest.mark.parallel
def test_command(tmp_path_factory, keeps_rules):
    """The paper's likelihood; chains in a file; JSON, page and summary."""
    comm = MPI.COMM_WORLD
    folder = comm.bcast(tmp_path_factory.mktemp("bayes") if comm.rank == 0 else None)
    fitted = 'likelihood = "fitted"\nsamples = 2000\ndistributions = ["normal", "weibull"]'
    changes = {SPECIMENS: f"{SPECIMENS}\n{fitted}"}
    path = comm.bcast(written(folder, changes) if comm.rank == 0 else None)
    found = run_bayes(load_case(path), comm, Progress(silent=True), keep=folder / "chains.nc")
    content = json.loads(json_text(found.json()))
    rows = {row["name"]: row for row in content["parameters"]}
    assert set(rows) == {"lap.k1", "lap.k2"} and all(r["rhat"] <= 1.01 for r in rows.values())
    # Of the truth that the specimens were simulated from.
    assert rows["lap.k2"]["mean"] == pytest.approx(37402, rel=0.02)
    assert content["model"]["frequency_error"] < 1e-4
    assert len(content["likelihood"]) == 5 and (folder / "chains.nc").is_file()
    if comm.rank == 0:
        page, stream = found.page().html(), io.StringIO()
        keeps_rules(page)
        assert page.count("<svg") == 6 and "R-hat" in page and "Not converged" not in page
        found.summary(Console(file=stream, width=100))
        assert "lap.k1" in stream.getvalue() and "new specimens scatter" in stream.getvalue()


def test_without_specimens_and_held_modes(tmp_path):
    one_set = {SPECIMENS: "samples = 2500"}
    case = load_case(written(tmp_path, one_set))
    outcome = run_bayes(case, MPI.COMM_SELF, Progress(silent=True))
    found = outcome.result
    assert len(repr(found)) <= 120 and len(repr(found.predicted)) <= 120
    assert found.predicted.check is None and outcome.page().html().count("<svg") == 4
    # Jalali et al. 2019, Table 1: the updated model is within 0.15 % of the first five frequencies,
    # and 2.10 % below, 5.07 above and 2.50 below the others.
    rows = found.frequencies()
    off = np.array([row["median_hz"] / row["measured_hz"] - 1 for row in rows])
    assert np.max(np.abs(off[:5])) < 2.5e-3
    np.testing.assert_allclose(100 * off[5:], [-2.10, 5.07, -2.50], atol=0.4)
    assert [row["held"] for row in rows] == [False] * 5 + [True] * 3
    said = " ".join(line for line in found.doubts if "held out" in line)
    ways = re.findall(r"(mode \d), held out: predicted [\d.]+ % (\w+) the", said)
    assert ways == [("mode 6", "below"), ("mode 7", "above"), ("mode 8", "below")]
    assert any("update.bayes.noise = 0.0002 has no effect" in line for line in found.doubts)
    # The held modes move with k1 and k2 as the beams themselves say.
    beams, sensors = build_structure(case, MPI.COMM_SELF), case.sensors()
    mean = {row["name"]: row["mean"] for row in found.rows()}
    exact = ModalPrediction(beams.arrays(sensors), sensors, 8, 16)({**beams.values(), **mean})[0]
    np.testing.assert_allclose([row["median_hz"] for row in rows[5:]], np.exp(exact[5:]), rtol=2e-3)


def test_chains_that_did_not_converge(tmp_path, capfd, monkeypatch):
    """Written, marked, not used, an error; and gone on from."""
    changes = {SPECIMENS: SPECIMENS + "\nlikelihood = 'gaussian'\nsamples = 900\nburn_in = 300"}
    path = written(tmp_path, changes)
    model = case_model(load_case(path), MPI.COMM_SELF)
    monkeypatch.setattr(bayes_run, "case_model", lambda *given, **named: model)
    files = [tmp_path / n for n in ("j.json", "p.html", "c.nc")]
    options = [f"--{o}={f}" for o, f in zip(("json", "report", "keep"), files, strict=True)]
    command = ["update", str(path), "--bayes", *options]
    run = CliRunner().invoke(app, command)
    assert run.exit_code == 1
    errors = capfd.readouterr().err
    assert "the chains did not converge (lap.k1" in errors and "continues them" in errors
    content, page = json.loads(files[0].read_text(encoding="utf-8")), files[1].read_text("utf-8")
    assert content["converged"] is False and content["problems"]
    assert content["frequencies"] == [] and content["sampler"]["samples"] == 900
    assert "Not converged: not to be used" in page and "Predicted frequencies" not in page
    samples, command = [], [word for word in command if not word.startswith("--report")]
    while len(samples) < 4:
        run = CliRunner().invoke(app, command)
        content = json.loads(files[0].read_text(encoding="utf-8"))
        samples.append(content["sampler"]["samples"])
        if run.exit_code == 0:
            break
    assert content["converged"] is True and len(content["frequencies"]) == 8
    # The draws that are kept were doubled each time.
    assert samples == [300 + 600 * 2 ** (i + 1) for i in range(len(samples))]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('sd = "88.16 N m"', 'sd = "88.16 N"', "update.bayes.priors.lap.k1: sd = '88.16 N'"),
        ('mean = "1763.2 N m"', 'mean = "-1 N m"', "mean = -1: expected a positive number"),
        ('{ kind = "normal", mean = "37402', '{ kind = "norm", mean = "37402', "kind = 'norm'"),
        ('"lap.k2" = { kind', '"lap.k3" = { kind', "lap.k3: is not in update.parameters"),
        (SPECIMENS, 'likelihood = "fitted"', "expected update.bayes.specimens too"),
        (SPECIMENS, SPECIMENS + "\nchains = 1", "update.bayes.chains"),
        (SPECIMENS, SPECIMENS + "\nsamples = 20\nburn_in = 20", "expected below samples = 20"),
        (SPECIMENS, SPECIMENS + "\ndistributions = ['weibul']", "did you mean 'weibull'"),
        (SPECIMENS, SPECIMENS + "\ntolerance = 0", "update.bayes.tolerance = 0: expected above"),
        ('noise = "0.02 %"', "noise = 0", "noise = 0.0: expected from above 0"),
    ],
)
def test_bad_cases_are_named(tmp_path, old, new, words):
    with pytest.raises(InputError) as error:
        load_case(written(tmp_path, {old: new}))
    assert words in str(error.value)

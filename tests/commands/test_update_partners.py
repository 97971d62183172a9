"""``update`` where the model has fewer modes than the test: some are left out, and said."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from case_tables import write_frequencies
from mpi4py import MPI
from typer.testing import CliRunner
from virtual_beams import beams

from fenics_joints.case import build_structure, load_case
from fenics_joints.cli import app
from fenics_joints.commands.update.run import update_case
from fenics_joints.measurements.gap import TooFewModes
from fenics_joints.modal import solve_modes

#: Two beams of two elements each have eighteen degrees of freedom.
CASE = beams(elements=(2, 2), lap_elements=1, k1=2500.0, k2=50000.0)
CASE += """
[test]
frequencies = "f.csv"
noise = "0.5 %"
[test.sees]
points = [["0 mm", "0 mm", "0 mm"], ["300 mm", "0 mm", "0 mm"], ["570 mm", "0 mm", "0 mm"]]
direction = [0, 0, 1]
[update]
parameters = ["lap.k1", "lap.k2"]
[diagnose]
n_modes = 8
"""


TRUE = {"lap.k1": 1763.0, "lap.k2": 37400.0}


def case_of(folder, hz, more="", text=CASE):
    (folder / "case.toml").write_text(text + more, encoding="utf-8")
    write_frequencies(folder, hz, file="f.csv")
    return load_case(folder)


def test_modes_without_a_partner_are_left_out(tmp_path):
    """More of the model's modes are looked through than the case says; the others still do."""
    case = case_of(tmp_path, [200.0])
    modes = solve_modes(build_structure(case, MPI.COMM_WORLD), TRUE, n_modes=18)
    seen = modes.visibility(case.sensors()) > 0.3
    seen[: modes.n_rigid] = False
    hz = [*modes.frequencies_hz[seen], 50e3, 60e3]
    found = update_case(case_of(tmp_path, hz), MPI.COMM_WORLD)
    (note,) = [note for note in found.notes if "left out" in note]
    assert note.startswith(f"mode {len(hz) - 1}, mode {len(hz)}: left out")
    assert len(found.modes.names) == len(hz) - 2
    assert found.update.mapping() == pytest.approx(TRUE, rel=1e-3)


def test_a_held_mode_without_a_partner_is_refused(tmp_path):
    hz = [1000.0 * (i + 1) for i in range(20)]
    case = case_of(tmp_path, hz, '[update.held]\nmodes = ["mode 20"]\n')
    with pytest.raises(TooFewModes, match="expected at least 20"):
        update_case(case, MPI.COMM_WORLD)


#: Finer beams, which thirteen sensors see, and what was measured of them.
SENSORS = ", ".join(f'["{x:g} mm", "0 mm", "0 mm"]' for x in np.linspace(0, 570, 13))
FINE = CASE.replace("elements = [2, 2]", "elements = [8, 6]").replace("n_modes = 8", "n_modes = 24")
FINE = re.sub("points = .*", f"points = [{SENSORS}]", FINE)
SHAPED = 'noise = "0.5 %"\nshapes = "s.csv"\nshape_noise = "2 %"'


@pytest.fixture(scope="module")
def virtual(tmp_path_factory):
    """Five modes of the true beams, with a noise of 0.2 %, Hz, and their shapes."""
    case = case_of(tmp_path_factory.mktemp("virtual"), [200.0], text=FINE)
    modes = solve_modes(build_structure(case, MPI.COMM_WORLD), TRUE, n_modes=24)
    seen = np.flatnonzero(modes.visibility(case.sensors()) > 0.3)
    seen = seen[seen >= modes.n_rigid][:5]
    noise = 1 + 2e-3 * np.random.default_rng(0).standard_normal(5)
    return modes.frequencies_hz[seen] * noise, modes.at(case.sensors())[:, seen]


def of_data(folder, hz, shapes):
    """A case of these data, with shapes or without."""
    if shapes is None:
        return case_of(folder, hz, text=FINE)
    write_frequencies(folder, shapes, file="s.csv", unit="")
    return case_of(folder, hz, text=FINE.replace('noise = "0.5 %"', SHAPED))


#: What was done to five measured modes: frequencies and shapes.
WRONG = {
    "two frequencies exchanged": (lambda f: f[[1, 0, 2, 3, 4]], None),
    "two modes identical": (lambda f: f[[0, 0, 2, 3, 4]], lambda s: s[:, [0, 0, 2, 3, 4]]),
    "columns rotated": (None, lambda s: s[:, [1, 2, 3, 4, 0]]),
    "sensors rotated": (None, lambda s: np.roll(s, 1, axis=0)),
    "shapes identical": (None, lambda s: s[:, [0] * 5]),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_fit_to_wrong_data_explains_nothing(what, virtual, tmp_path):
    """Its standard deviations are no smaller than what the misfit leaves; with shapes each."""
    data = [change(x) if change else x for change, x in zip(WRONG[what], virtual, strict=True)]
    found = update_case(of_data(tmp_path, *data), MPI.COMM_WORLD)
    assert found.failure is not None
    if what != "shapes identical":  # by frequencies alone it is right
        assert max(found.update.relative_sd) > 0.5


def test_right_data_are_explained(virtual, tmp_path):
    found = update_case(of_data(tmp_path, *virtual), MPI.COMM_WORLD)
    off = found.update.values / [TRUE[name] for name in found.update.names] - 1
    assert found.failure is None and found.without_partner == ()
    assert np.all(np.abs(off) < 3 * found.update.relative_sd)
    assert max(found.update.relative_sd) < 0.2


@pytest.mark.parametrize("shaped", [False, True])
def test_a_mode_far_off_is_left_out_and_the_others_keep_their_partners(shaped, virtual, tmp_path):
    hz, shapes = virtual
    case = of_data(tmp_path, hz * [10, 1, 1, 1, 1], shapes if shaped else None)
    found = update_case(case, MPI.COMM_WORLD)
    assert found.without_partner == ("mode 1",) and found.failure is None
    assert found.update.values == pytest.approx([TRUE[n] for n in found.update.names], rel=0.05)
    assert found.to_json()["modes_without_partner"] == ["mode 1"]


def test_what_explains_nothing_is_written_and_ends_with_1(virtual, tmp_path):
    """All frequencies halved."""
    hz, shapes = virtual
    case = of_data(tmp_path, hz / 2, shapes)
    file = tmp_path / "found.json"
    run = CliRunner().invoke(app, ["update", str(case.path), "--json", str(file)])
    assert run.exit_code == 1
    assert json.loads(file.read_text(encoding="utf-8"))["fit"]["explains_nothing"]

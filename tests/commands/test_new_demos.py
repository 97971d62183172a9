"""The drawings of the demos: what ``new`` makes of them runs without editing; ``update`` ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from uff_files import mode_55, nodes_15

from fenics_joints.case import load_case
from fenics_joints.commands.modes import run_modes
from fenics_joints.commands.new.run import Source, run_new
from fenics_joints.commands.new.tests import TestFiles
from fenics_joints.commands.update.run import update_case
from fenics_joints.progress import Progress

pytestmark = [
    pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="new is for one process"),
    pytest.mark.slow,
]

DEMOS = Path(__file__).resolve().parents[2] / "demos"


def silent(question, answer, check):
    check(answer)
    return answer


def universal(case, path):
    """The shapes of a demo's test as a lab would send them: in inches, and without saying so."""
    data = case.measured
    places = np.round(data.sensors.points / 0.0254, 6)
    nodes, which = np.unique(places, axis=0, return_inverse=True)
    text = nodes_15(dict(enumerate(nodes, start=1)))
    for j, hz in enumerate(data.frequencies_hz[0]):
        shape = {i: np.zeros(3) for i in range(1, len(nodes) + 1)}
        for k, way in enumerate(data.sensors.directions):
            shape[int(which[k]) + 1] += way * data.shapes[k, j]
        text += mode_55(j + 1, hz, shape, ratio=float(data.damping[0, j]))
    path.write_text(text, encoding="utf-8")
    return path


def lab_files(name, folder):
    """The test's files of a demo, as a lab has them."""
    if name == "barc":
        return TestFiles(uff=(universal(load_case(DEMOS / name), folder / "box.uff"),))
    if name == "jim_beam":
        own = DEMOS / name
        return TestFiles(frequencies=own / "frequencies.csv", shapes=own / "shapes.csv")
    return TestFiles()


@pytest.mark.parametrize(
    "name, joints, bolts, least_mac",
    [("cad_bracket", 1, 4, None), ("barc", 4, 0, 0.7), ("jim_beam", 2, 0, 0.95)],
)
def test_a_drawing_of_the_demos(tmp_path, name, joints, bolts, least_mac):
    """Joints and bolts are found, nothing is wrong; six modes of a free body, then the test's."""
    (step,) = (DEMOS / name).glob("*.step")
    folder = tmp_path / "case"
    tests = lab_files(name, tmp_path)
    found = run_new(folder, Source(step=step), tests, silent, Progress(silent=True))
    assert found.checked.errors == () and found.checked.notes == ()
    case = load_case(folder)
    assert len(case.joints) == joints and len(found.checked.bolts) == bolts
    outcome = run_modes(case, MPI.COMM_SELF, Progress(silent=True), n_modes=26)
    hz = outcome.result.modes.frequencies_hz
    assert np.all(hz[:6] < 1e-3 * hz[6])
    beside = outcome.result.beside
    gap = "" if beside is None else f", error {beside.rms:.1%}, MAC {np.round(beside.mac, 2)}"
    print(f"{name}: {found.checked.dofs} unknowns, first at {hz[6]:.1f} Hz{gap}")
    if least_mac is not None:
        assert np.median(beside.mac) > least_mac and beside.rms < 0.2


def test_the_box_is_updated_to_its_end():
    """A model that is wrong, a mode with two partners, five open stiffnesses: it settles, and says
    which mode it left out; the small model is as good as the full one."""
    report = update_case(load_case(DEMOS / "barc"), MPI.COMM_WORLD)
    assert report.update.converged and report.update.widths.without == (8,)
    said = " ".join(report.notes)
    assert "mode 9 changes its partner" in said and "reduced model is still off" not in said
    errors = report.modes.error_after
    assert np.sqrt(np.mean(errors[:8] ** 2)) < 0.03

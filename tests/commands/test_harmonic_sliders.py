"""Sliders that go where the levels' responses are, and a joint that bears next to nothing."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from harmonic_case import LAYER, write
from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.commands.harmonic.model import harmonic_model
from fenics_joints.commands.harmonic.run import run_harmonic
from fenics_joints.harmonic import slider_ranges
from fenics_joints.harmonic.kept import kept_model
from fenics_joints.progress import Progress

QUIET, SELF = Progress(silent=True), MPI.COMM_SELF
LAW = LAYER.split("[nonlinear.lap]\n")[1].split("[harmonic]")[0]
NO_TEST = ('measured = "frf.csv"\n', "")


class Told(Progress):
    """Keeps the steps that it is told."""

    def __init__(self):
        super().__init__(silent=True)
        self.steps = []

    def step(self, text, total=None):
        self.steps.append(text)


def test_segalmans_law_has_its_power_over_a_decade_of_force(tmp_path):
    """Joint damping is as the amplitude to 1 + chi: Segalman, J. Appl. Mech. 72, 2005."""
    law = 'law = "segalman"\nF_S = "500 kPa"\nchi = -0.5\nbeta = 0.2\nsliders = 12\n'
    levels = ('levels = ["0.01 N", "10 N"]', 'levels = ["0.03 N", "0.3 N"]')
    band = ('band = ["25 Hz", "31 Hz"]', 'band = ["28 Hz", "28.3 Hz"]')
    small = (("harmonics = 3", "harmonics = 1"), ("samples = 64", "samples = 32"))
    case = load_case(write(tmp_path, LAYER, (LAW, law), levels, band, *small, NO_TEST))
    told = Told()
    found = run_harmonic(case, SELF, told).result
    assert 1 <= sum("sliders of lap" in step for step in told.steps) <= 3
    for response in found.responses:
        (sliders,) = slider_ranges(response)
        assert abs(sliders.error) < 0.05
    assert not found.slider_notes
    a = np.array([f.peak_displacement_m for f in found.facts])
    energy = np.array([f.joint_energy_j["lap"] for f in found.facts])
    slopes = np.diff(np.log(energy / a**2)) / np.diff(np.log(a))
    assert slopes == pytest.approx(0.5, abs=0.1)


def test_a_joint_far_below_the_levels_has_a_basis(tmp_path):
    """Perfectly plastic, at a hundred times its strength: the static loads begin below it."""
    law = 'law = "bilinear"\nS_y = "50 Pa"\nE_p = 0\n'
    case = load_case(write(tmp_path, LAYER, (LAW, law), NO_TEST))
    built = harmonic_model(case, SELF, QUIET)
    assert built.model.n_dofs > case.harmonic.modes


def test_a_kept_model_that_cannot_be_read_is_made_anew(tmp_path):
    """It is told why; then it is there."""
    case, told = load_case(write(tmp_path, LAYER, NO_TEST)), Told()
    made = harmonic_model(case, SELF, QUIET).model
    given = tmp_path, case.harmonic.band, SELF, told
    assert kept_model(made, *given) is made and not told.steps
    file = tmp_path / "model.h5"
    whole = file.read_bytes()
    file.write_bytes(whole[:-100])
    assert kept_model(made, *given) is made and len(told.steps) == 1 and str(file) in told.steps[0]
    assert kept_model(made, *given) is not made and len(told.steps) == 1

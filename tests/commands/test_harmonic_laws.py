"""Laws of contacts and layers in a case file; sliders that go where responses are; bifurcations."""

import io
from dataclasses import replace

import numpy as np
import pytest
from harmonic_case import CONTACT, LAYER, write
from mpi4py import MPI
from oscillators import TURN, escape
from rich.console import Console

from fenics_joints.case import load_case
from fenics_joints.commands.harmonic.document import harmonic_document
from fenics_joints.commands.harmonic.model import FORCE, SENSOR, harmonic_model
from fenics_joints.commands.harmonic.run import run_harmonic
from fenics_joints.commands.harmonic.stability import level_stability
from fenics_joints.errors import InputError
from fenics_joints.harmonic import Stability, slider_ranges, solve_harmonic
from fenics_joints.harmonic.kept import kept_model
from fenics_joints.progress import Progress
from fenics_joints.report.html import as_page
from fenics_joints.report.terminal import show

QUIET, SELF = Progress(silent=True), MPI.COMM_SELF
COULOMB = CONTACT.split("[nonlinear.lap]\n")[1].split("[harmonic]")[0]


def built(folder, law, *edits):
    """The reduced model of the small beam with another law in its contact."""
    return harmonic_model(load_case(write(folder, CONTACT, (COULOMB, law), *edits)), SELF, QUIET)


def peak(found):
    hz = found.frequencies_hz[found.mode]
    response = solve_harmonic(
        found.model, FORCE, 10.0, (0.8 * hz, 1.05 * hz), sensor=SENSOR, harmonics=1, samples=64
    )
    return response.peak.frequency_hz, response.peak.amplitude


def test_elastic_friction_is_a_bilinear_layer_as_thin(tmp_path):
    """Two ways to say the same; the peak is below that of a joint that sticks."""
    friction = built(
        tmp_path, 'law = "elastic_friction"\nstiffness = "30 GPa/m"\nstrength = "20 kPa"\n'
    )
    layer = 'law = "bilinear"\nthickness = "1 mm"\nE_e = "30 MPa"\nE_p = 0\nS_y = "20 kPa"\n'
    bilinear = built(tmp_path, layer + "sliders = 1\n")
    assert friction.frequencies_hz == pytest.approx(bilinear.frequencies_hz, rel=1e-9)
    made = peak(friction)
    assert made == pytest.approx(peak(bilinear), rel=1e-3)
    assert made[0] < 0.9998 * friction.frequencies_hz[friction.mode]


def test_within_a_gap_nothing_holds_and_beyond_it_a_spring(tmp_path):
    """The mode at rest is that without a spring; a gap of a nanometre is met at once."""
    gap = 'law = "gap"\nstiffness = "30 GPa/m"\ngap = "1 nm"\n'
    friction = 'law = "elastic_friction"\nstiffness = "{}"\nstrength = "1 TPa"\n'
    met = built(tmp_path, gap)
    none, sticks = (built(tmp_path, friction.format(k)) for k in ("1 Pa/m", "30 GPa/m"))
    assert met.frequencies_hz[met.mode] == pytest.approx(none.frequencies_hz[none.mode], rel=1e-6)
    ours, stuck = (
        solve_harmonic(b.model, FORCE, 10.0, at=[20.0], sensor=SENSOR, harmonics=3).amplitude()[0]
        for b in (met, sticks)
    )
    assert ours == pytest.approx(stuck, rel=5e-3)


def test_a_unilateral_contact_has_the_preloads_pressure_and_no_friction(tmp_path):
    found = built(tmp_path, 'law = "unilateral"\nnormal_stiffness = "100 GPa/m"\n')
    p = found.model.interfaces[0].law.parameters
    coulomb = built(tmp_path, COULOMB).model.interfaces[0].law.parameters
    assert p["pressure"] == pytest.approx(coulomb["pressure"])
    assert np.all(p["friction"] == 0) and found.model.interfaces[0].normal
    with pytest.raises(InputError, match=r"nonlinear\.lap\.gap.*the preload says it"):
        built(tmp_path, COULOMB + 'gap = "0.1 mm"\n')
    bolt = CONTACT[CONTACT.index("[bolts.bolt]") : CONTACT.index("[supports.clamp]")]
    band = 'band = ["25 Hz", "31 Hz"]', 'band = ["90 Hz", "96 Hz"]'  # of the beam that is held
    apart = built(tmp_path, COULOMB + 'gap = "0.1 mm"\n', (bolt, ""), band).model.interfaces[0]
    assert apart.law.parameters["pressure"] == pytest.approx(-100e9 * 1e-4)


LOADS = """
[loads.{0}]
facets = "washer_{0}"
force = [0, 0, "{1} N"]
"""
#: Rigid, a millimetre beyond the tip.
BALL = """
[obstacles.ball]
kind = "sphere"
facets = "tip"
centre = ["520 mm", "0 mm", "3 mm"]
radius = "99 mm"
"""


def test_loads_press_as_a_bolt_does_and_what_is_not_touched_holds_nothing(tmp_path):
    """Two opposed loads under the washers are the bolt; a ball out of reach is not there."""
    law = 'law = "unilateral"\nnormal_stiffness = "100 GPa/m"\n'
    bolt = CONTACT[CONTACT.index("[bolts.bolt]") : CONTACT.index("[supports.clamp]")]
    ours = LOADS.format("lower", 120) + LOADS.format("upper", -120) + BALL
    by_bolt, by_loads = built(tmp_path, law), built(tmp_path, law, (bolt, ours))
    pressures = [b.model.interfaces[0].law.parameters["pressure"] for b in (by_loads, by_bolt)]
    assert pressures[0] == pytest.approx(pressures[1], rel=1e-6, abs=1e-6 * pressures[1].max())
    # Without friction the upper beam slides: two ways and a turn have no stiffness.
    assert by_bolt.frequencies_hz[2] < 0.1 < 10 < by_bolt.frequencies_hz[3]
    assert by_loads.frequencies_hz[3:7] == pytest.approx(by_bolt.frequencies_hz[3:7], rel=1e-6)


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
    case = load_case(write(tmp_path, LAYER, one, narrow, plain))
    report = run_harmonic(case, SELF, QUIET).result
    assert report.to_json()["stability"] == []
    turned = [replace(fact, turning_points=2) for fact in report.facts]
    shown, told = io.StringIO(), replace(report, stability=(found,), facts=turned)
    show(Console(file=shown, width=110), harmonic_document(told))
    for words in ("period doubling", "0, 1", "turn back in frequency"):
        assert words in shown.getvalue()
    # In the picture at its own level.
    unstable = np.arange(len(report.responses[0])) % 2
    (at,) = found.stability.bifurcations
    drawn = Stability(unstable, unstable, (replace(at, index=0),))
    branches = ((drawn.bifurcations[0], report.responses[0]),)
    drawn = replace(found, level=report.facts[0].level, stability=drawn, branches=branches)
    assert "period doubling" in as_page(harmonic_document(replace(report, stability=(drawn,))))

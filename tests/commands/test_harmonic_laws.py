"""Ready-made laws of contacts in a case file."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from harmonic_case import CONTACT, write
from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.commands.harmonic.model import FORCE, SENSOR, harmonic_model
from fenics_joints.errors import InputError
from fenics_joints.harmonic import solve_harmonic
from fenics_joints.progress import Progress

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

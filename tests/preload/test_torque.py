"""Threads against the standards' tables, also by holes; torque against the paper's and inverses."""

import math

import pytest

from fenics_joints.errors import InputError
from fenics_joints.preload.clearance import guess_thread
from fenics_joints.preload.threads import thread, thread_names
from fenics_joints.preload.torque import (
    bearing_radius,
    friction_from,
    motosh_force,
    nut_factor_force,
)


@pytest.mark.parametrize(
    ("name", "pitch_mm", "d2_mm", "d1_mm", "area_mm2"),
    [  # ISO 724 and ISO 898-1; ASME B1.1 in inches (areas 0.0580, 0.0524, 0.1419, 0.969 in2)
        ("M12", 1.75, 10.863, 10.106, 84.3),
        ("M12x1.25", 1.25, 11.188, 10.647, 92.1),
        ("M3", 0.5, 2.675, 2.459, 5.03),
        ("M64", 6, 60.103, 57.505, 2676),
        ("5/16-24", 25.4 / 24, 0.2854 * 25.4, 0.2674 * 25.4, 0.0580 * 645.16),
        ("5/16-18 UNC", 25.4 / 18, 0.2764 * 25.4, 0.2524 * 25.4, 0.0524 * 645.16),
        ("1-1/8-12 UNF", 25.4 / 12, 1.0709 * 25.4, 1.0348 * 25.4, 0.856 * 645.16),
        ("#10-32", 25.4 / 32, 0.1697 * 25.4, 0.1562 * 25.4, 0.0200 * 645.16),
    ],
)
def test_thread_has_the_printed_diameters_and_stress_area(name, pitch_mm, d2_mm, d1_mm, area_mm2):
    t = thread(name)
    assert t.pitch * 1e3 == pytest.approx(pitch_mm, rel=1e-12)
    assert t.pitch_diameter * 1e3 == pytest.approx(d2_mm, abs=2e-3)
    assert t.minor_diameter * 1e3 == pytest.approx(d1_mm, abs=2e-3)
    assert t.stress_area * 1e6 == pytest.approx(area_mm2, rel=4e-3)


def test_every_thread_goes_with_its_hardware():
    for name in thread_names():
        t = thread(name)
        assert t.root_diameter < t.minor_diameter < t.pitch_diameter < t.diameter
        assert t.diameter < t.washer_inner_diameter < t.washer_outer_diameter
        assert t.diameter < t.hole_diameter < t.width_across_flats <= t.washer_outer_diameter
        assert 0.45 < t.head_height / t.diameter < 0.8
    assert thread("m12×1.75") is thread("M12") and thread("No. 10-32 unf") is thread("#10-32")


@pytest.mark.parametrize(
    ("name", "nearest"), [("M13", "M3"), ("M12x1.3", "M12x1.25"), ("5/16-24 UNC", "5/16-24 UNF")]
)
def test_an_unknown_thread_is_an_error_that_names_the_nearest(name, nearest):
    with pytest.raises(InputError, match=f"{name}.*nearest: .*{nearest}"):
        thread(name)


def test_motosh_gives_the_forces_of_the_seed_with_one_friction_found_by_inversion():
    """Fronk et al. 2019, Table 3: one pair gives the friction, two are then predictions."""
    mu = friction_from(25.1, 21.2e3, "5/16-24")
    assert mu == pytest.approx(0.107, abs=5e-4)
    for torque, printed in ((10.2, 8.6), (16.9, 14.3)):
        assert round(motosh_force(torque, "5/16-24", mu, mu) / 1e3, 1) == printed
    # The other reading of the table: a friction of 0.1 under a nut of effective radius 0.75 d.
    radius = 0.75 * thread("5/16-24").diameter
    for torque, printed in ((10.2, 8.6), (16.9, 14.3), (25.1, 21.2)):
        assert round(motosh_force(torque, "5/16-24", 0.1, 0.1, radius) / 1e3, 1) == printed


def test_torque_and_force_are_inverses_and_without_friction_work_is_kept():
    t = thread("M16x1.5")
    assert friction_from(90.0, motosh_force(90.0, t, 0.12, 0.12), t) == pytest.approx(0.12)
    assert nut_factor_force(120.0, 0.012) == pytest.approx(50e3)
    # One turn without friction: torque times 2 pi is force times pitch.
    assert motosh_force(15 / (2 * math.pi), t, 0.0, 0.0) * t.pitch == pytest.approx(15)
    # The head's friction alone: torque is friction times force times the mean radius.
    head = (t.width_across_flats + t.hole_diameter) / 4
    more = 90.0 / motosh_force(90.0, t, 0.1, 0.3) - 90.0 / motosh_force(90.0, t, 0.1, 0.1)
    assert more == pytest.approx(0.2 * head)


def test_bearing_radius_of_uniform_pressure_is_the_integral_of_r():
    outer, inner, n = 0.018, 0.0135, 2000
    r = [inner / 2 + (i + 0.5) / n * (outer - inner) / 2 for i in range(n)]
    integral = sum(x * x for x in r) / sum(r)
    assert bearing_radius(outer, inner, uniform_pressure=True) == pytest.approx(integral, rel=1e-6)


def test_bad_input_is_an_input_error():
    with pytest.raises(InputError, match="takes no friction at all"):
        friction_from(0.1, 50e3, "M12")
    with pytest.raises(InputError, match="expected the outer one larger"):
        bearing_radius(0.01, 0.02)


@pytest.mark.parametrize(
    "widest, narrowest, name",
    [
        (6.6, None, "M6"),
        (9.0, None, "M8"),
        (8.4, None, "M8"),
        (11.0, None, "M10"),
        (13.5, 10.2, "M12"),
        (14.5, None, "M12"),
        (17.5, None, "M16"),
        (22.0, 17.5, "M20"),
        (11.0, 8.5, "M10"),
        (9.0, 6.8, "M8"),
        (5.3, 4.2, "M5"),
        (26.0, 21.0, "M24"),
    ],
)
def test_threads_by_their_holes(widest, narrowest, name):
    small = None if narrowest is None else 1e-3 * narrowest
    assert guess_thread(1e-3 * widest, small).thread.name == name


def test_doubts_and_none():
    """12 mm is M10 coarse or M12 without clearance; a hole of 150 mm is no bolt's."""
    guess = guess_thread(12e-3)
    assert {guess.thread.name, *guess.others} >= {"M10", "M12"}
    assert guess_thread(0.15) is None
    with pytest.raises(InputError, match="widest"):
        guess_thread(-1.0)

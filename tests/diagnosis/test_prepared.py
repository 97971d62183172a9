"""Modes of a test that are none of the model's: left out, named, and no verdict rests on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_points import reduced
from virtual_plates import virtual_test, write_virtual_case

from fenics_joints.case import load_case
from fenics_joints.diagnosis.shrinkage import Shrinkage
from fenics_joints.diagnosis.verdict import confirmed, with_strangers
from fenics_joints.errors import InputError


def prepared(folder, measured, models):
    few = 'effects = ["accelerometer mass", "joint tangential compliance", "modulus error"]'
    case = load_case(write_virtual_case(folder, measured, few, shapes=True))
    return reduced(case, models)


def strange(measured, *which):
    """With shapes that no mode of plates has: one sensor alone moves."""
    shapes = measured.shapes.copy()
    for sensor, mode in enumerate(which, start=2):
        shapes[:, mode] = np.eye(len(shapes))[sensor]
    return replace(measured, shapes=shapes)


def test_a_mode_that_no_effect_makes_is_left_out_of_all(tmp_path, models):
    measured = virtual_test(mass=0.02).noisy()
    model = prepared(tmp_path, strange(measured, 2), models)
    assert model.without_partner == ("bending 3",)
    assert model.left_out.tolist() == [False, False, True, False]
    assert not model.evidence.used[:, 2].any() and model.evidence.used[:, [0, 1, 3]].all()
    assert np.isnan(model.data.frequencies_hz[:, 2]).all()
    assert any("bending 3" in note and "Hz" in note for note in model.notes)
    # The others keep the partners that they have without it.
    whole = prepared(tmp_path, measured, models)
    assert whole.without_partner == () and whole.left_out is None
    kept = [0, 1, 3]
    own, theirs = (m.forward.pairing(m.baseline).index[kept] for m in (model, whole))
    assert own.tolist() == theirs.tolist()


def test_a_test_of_something_else_is_refused(tmp_path, models):
    with pytest.raises(InputError, match="bending 2, bending 3, bending 4"):
        prepared(tmp_path, strange(virtual_test(mass=0.02).noisy(), 1, 2, 3), models)


def test_no_verdict_rests_on_a_mode_without_a_partner():
    assert with_strangers("no gap", "Fine.", ()) == ("no gap", "Fine.")
    verdict, summary = with_strangers("no gap", "Fine.", ("mode 6",))
    assert verdict == "unknown" and "mode 6" in summary
    verdict, summary = with_strangers("cause", "The gap comes from x.", ("mode 6",))
    assert verdict == "cause" and "mode 6" in summary


@pytest.mark.parametrize(("shrink", "expected"), [(0.14, False), (0.49, False), (0.51, True)])
def test_half_of_the_held_out_gap_beyond_noise_confirms(shrink, expected):
    """Better than chance and than the best wrong effect alone do not."""
    before, noise = 0.3739, 0.001
    found = Shrinkage(
        before=before,
        after=before - shrink * (before - noise),
        noise=noise,
        shrink=shrink,
        shrink_interval=(0.12, 0.85),
        claimed=True,
        folds=[None],
    )
    assert confirmed(found) == expected

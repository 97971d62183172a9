"""A mass that nobody put into the model: how many grams, and where."""

from __future__ import annotations

import numpy as np
import pytest
from measured_points import reduced
from virtual_plates import virtual_test, write_virtual_case

from fenics_joints.case import load_case
from fenics_joints.commands.diagnose.words import attached_words, point_mass_words
from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.localised_unknown import LocalisedUnknown, point_mass
from fenics_joints.reduction.matched import places_all_over


@pytest.mark.parametrize("grams", [58.0, 0.0])
def test_grams_of_a_mass_that_was_put_on_a_plate(grams, tmp_path, models):
    """On a virtual test with another mesh and noise, at (20, 40, 0) mm of 0.7 kg of plates: within
    the interval that is stated, and a cell from there; nothing where nothing was put on."""
    measured = virtual_test(mass=1e-3 * grams).noisy()
    few = 'effects = ["accelerometer mass", "joint tangential compliance", "modulus error"]'
    case = load_case(write_virtual_case(tmp_path, measured, few, shapes=True))
    model = reduced(case, models)
    unknown = model.hypothesis((), name="none of these", unknown=True)
    found = fit(unknown, model.forward, model.evidence, model.baseline)
    seen = model.surrogate
    point = point_mass(
        found,
        model.evidence,
        seen.nominal,
        seen.pairing,
        model.data.sensors,
        np.unique(places_all_over(model.full, 240).points, axis=0),
        model.full.total_mass(model.baseline),
    )
    if not grams:
        assert point is None
        return
    assert point.low < 1e-3 * grams < point.high < 1.4 * point.low
    assert np.linalg.norm(np.subtract(point.at, (0.02, 0.04, 0.0))) < 0.02
    assert f"{1e3 * point.kg:.0f} g" in point_mass_words(LocalisedUnknown(1.0, point))


def test_what_is_attached_is_said_in_grams_with_its_place():
    rows = [{"name": "mass", "value": 0.0583}, {"name": "place", "at": "(380, 20, 0) mm"}]
    assert attached_words(rows) == "about 58 g near (380, 20, 0) mm"
    assert attached_words(rows[1:]) == "near (380, 20, 0) mm" and not attached_words(rows[:1])

"""Cut-off-pressure updating: the sweep against full solutions, and the minimum from few of them."""

from functools import cache

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.meshes import c_beams
from fenics_joints.modal import solve_modes
from fenics_joints.preload import BeamBolt, Contact, PreloadModel, solve_preload
from fenics_joints.structure import Structure, part
from fenics_joints.updating import CutoffModel, minimise, sweep


@pytest.fixture(scope="module")
def result():
    mesh = c_beams(
        MPI.COMM_WORLD, element_size=6e-3, radial_size=3e-3, middle_size=12e-3, n_thickness=(2, 1)
    )
    parts = [part("beams", ("beam_1", "beam_2"), E=181e9, nu=0.29, rho=8000.0)]
    structure = Structure(mesh, parts, degree=1)
    bolts = [
        BeamBolt(f"bolt_{i}", f"washer_{i}_lower", f"washer_{i}_upper", 28e3, 7.9e-3)
        for i in (1, 2)
    ]
    pads = Contact("pads", "interface_lower", "interface_upper", friction=0.3)
    return solve_preload(PreloadModel(structure, [pads], bolts))


@pytest.fixture(scope="module")
def swept(result):
    """A function from a scheme to its model and sweep, which are made once."""

    @cache
    def of(scheme: str):
        model = CutoffModel(result, scheme=scheme)
        return model, sweep(model, interval=90)

    return of


@pytest.mark.parallel
@pytest.mark.parametrize("scheme", ["two", "three"])
def test_sweep_is_the_full_model_at_cutoffs_that_were_not_used(swept, scheme):
    model, found = swept(scheme)
    anchors = {a.step for a in found.anchors}
    assert model.solves == len(anchors) < len(model) / 3
    unused = [k for k in range(len(model)) if k not in anchors]
    worst = 0.0
    for step in unused[:: max(1, len(unused) // 4)]:
        joint = model.joint.change(model.conditions(step))
        exact = solve_modes(joint, n_modes=20).frequencies_hz[6:]
        nearest = np.abs(found.frequencies_hz[step][:, None] / exact - 1).min(axis=1)
        worst = max(worst, nearest.max())
    assert worst < 2e-4
    # What the sweep says of itself is no better than what it is.
    assert found.error < 2e-4 and worst < 3 * found.error + 1e-7


def test_frequencies_fall_with_the_cutoff_and_sliding_is_between(swept):
    """Holding less never raises a frequency (Courant-Fischer), and sliding holds more than open."""
    two, three = (swept(scheme)[1].frequencies_hz for scheme in ("two", "three"))
    for found in (two, three):
        ordered = np.sort(found, axis=1)
        assert np.all(np.diff(ordered, axis=0) < 2e-4 * ordered[1:])
    assert np.all(np.sort(three)[:, :4] >= np.sort(two)[:, :4] * (1 - 2e-4))
    assert three[-5, 0] > 1.02 * two[-5, 0]


def test_minimum_from_few_full_solutions_is_that_of_the_sweep(result, swept):
    model, found = swept("two")
    truth = len(model) // 2
    measured = found.frequencies_hz[truth] * (1 + 2e-3 * np.array([1, -1, 1, -1, 1, -1]))
    least = minimise(CutoffModel(result), measured, max_solves=15)
    assert len(least.visited) <= 15
    assert least.step == found.best(measured)
    assert least.objective == pytest.approx(found.objective(measured)[least.step], abs=2e-4)


def test_cutoffs_are_the_distinct_pressures(result):
    """By hand: both pads and both halves of each are equal: a pressure stands for four facets."""
    model = CutoffModel(result)
    p = result["pads"].facet_pressure
    pressed = p[p > 1e-9 * p.max()]
    assert 4 * len(model) == pytest.approx(len(pressed), rel=0.1)
    assert model.cutoffs[-1] == pytest.approx(p.max(), rel=1e-5)
    assert model.step_at(0.0) == 0 and model.step_at(p.max() * 2) == len(model) - 1
    lost = [len(model.held(k)) for k in range(len(model))]
    assert np.all(np.diff(lost) <= 0) and lost[0] > lost[-1]


def test_wrong_number_of_frequencies_is_an_error(result):
    with pytest.raises(InputError, match=r"measured_hz has shape \(2,\)"):
        minimise(CutoffModel(result), [258.0, 331.0])

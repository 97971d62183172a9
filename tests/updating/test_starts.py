"""Fits of frequencies alone where two modes exchange places between two valleys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from fenics_joints import meshes
from fenics_joints.errors import ConvergenceError
from fenics_joints.measurements import Target
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Parameter, Structure, joint, part
from fenics_joints.updating import update

TRUTH = {"E": 190e9, "G": 0.2e9}
PARAMETERS = [Parameter("E", 200e9, "Pa", 50e9, 400e9), Parameter("G", 0.4e9, "Pa", 1e7, 1e11)]
#: On either side of where the third and fourth mode exchange places.
STARTS = [{"E": 200e9, "G": 0.4e9}, {"E": 200e9, "G": 0.1e9}]


@pytest.fixture(scope="module")
def stack():
    """Two steel beams, free, with a soft layer between."""
    tagged = meshes.box(MPI.COMM_WORLD, (0.2, 0.04, 5.0), (6, 1, 5))
    box, x = tagged.mesh, tagged.mesh.geometry.x
    x[:, 2] = np.interp(x[:, 2], np.arange(6.0), [0, 0.005, 0.01, 0.011, 0.016, 0.021])
    index = box.topology.index_map(3)
    cells = np.arange(index.size_local + index.num_ghosts, dtype=np.int32)
    z = mesh.compute_midpoints(box, 3, cells)[:, 2]
    tags = np.where(z < 0.01, 1, np.where(z < 0.011, 2, 3)).astype(np.int32)
    names = {"lower": 1, "joint": 2, "upper": 3}
    tags = mesh.meshtags(box, 3, cells, tags)
    steel = part("steel", ("lower", "upper"), E="E", nu=0.3, rho=7850)
    layer = joint("layer", "joint", E=1e9, G="G", normal=(0, 0, 1))
    tagged = replace(tagged, cell_tags=tags, cell_names=names)
    return Structure(tagged, [steel, layer], parameters=PARAMETERS)


@pytest.fixture(scope="module")
def hz(stack):
    modes = solve_modes(stack, TRUTH, n_modes=12)
    return modes.frequencies_hz[modes.n_rigid :][:5]


@pytest.mark.parallel
@pytest.mark.parametrize("start", STARTS)
def test_the_truth_is_found_from_either_side_of_a_crossing(stack, hz, start):
    found = update(stack, PARAMETERS, Target(hz, 1e-3), start)
    assert found.mapping() == pytest.approx(TRUTH, rel=1e-5)
    assert found.history[0].values == pytest.approx([start["E"], start["G"]])
    assert np.diff([step.cost for step in found.history[1:]]).max() < 1e-6


def test_valleys_that_fit_about_as_well_identify_nothing(stack, hz):
    """Half-way between what the model says at the ends of both, it is off by several standard
    deviations at either: deviations are as wide, strict raises, and the repr says all."""
    # The end of the other valley, as least squares from the first start alone leave it.
    alone = update(stack, PARAMETERS, Target(hz, 1e-3), STARTS[0], elsewhere=False)
    off = abs(alone.values / [TRUTH["E"], TRUTH["G"]] - 1)
    assert np.all(off > 0.05) and np.all(off < 6 * alone.relative_sd)
    between = Target(np.sqrt(hz * alone.prediction.frequencies_hz), 1e-3)
    found = update(stack, PARAMETERS, between, STARTS[0], strict=False)
    assert not found.converged and "modes 3 and 4" in found.message
    assert found.message in repr(found)
    slopes = found.prediction.frequency_slopes / 1e-3
    noise = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    assert found.sd / noise == pytest.approx(np.sqrt(found.chi2 / 3) * np.ones(2), rel=1e-3)
    with pytest.raises(ConvergenceError, match="modes 3 and 4"):
        update(stack, PARAMETERS, between, STARTS[0])

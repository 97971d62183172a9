"""Models for a few parameters in stated ranges, against the model that they are made of."""

from __future__ import annotations

import numpy as np
import pytest

from fenics_joints.beams import Beam, BeamStructure, GenericJoint, LumpedMass
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import Forward, freeze, narrow
from fenics_joints.structure import Parameter, Sensors, Spring

VALUES = {
    "E": 208e9, "rho": 7860.0, "k1": 1763.0, "k2": 37400.0, "cord": 2e3, "mass": 0.05, "place": 0.01
}  # fmt: skip
SENSORS = Sensors(np.outer(np.linspace(0, 0.55, 9), [1.0, 0, 0]), [0.0, 0, 1])


@pytest.fixture(scope="module")
def model():
    beams = [Beam(n, 0.3, 0.02, 0.01, 10, "E", 0.3, "rho") for n in "ab"]
    structure = BeamStructure(
        beams,
        [GenericJoint("lap", 0.05, 5, "k1", "k2")],
        [Parameter(name, value, log=name != "place") for name, value in VALUES.items()],
        masses=[LumpedMass("m", "mass", (0.1, 0, 0), 0.01, "place", (-0.05, 0.05))],
        springs=[Spring("cord", "cord", (0.0, 0.0, 0.0))],
    )
    return structure.arrays(SENSORS)


def test_frozen_model_is_the_model(model):
    elsewhere = {"E": 1.9e11, "mass": 0.08, "place": -0.02, "cord": 4e3}
    for free in (["k1"], ["E", "cord", "place"], list(VALUES)):
        small = freeze(model, free, elsewhere)
        assert list(small.parameters) == free
        change = {name: 1.07 * small.values()[name] for name in free}
        full = {**elsewhere, **change}
        for key in ("stiffness", "mass"):
            exact = getattr(model, key)(full)
            off = np.abs(getattr(small, key)(change) - exact).max()
            assert off < 1e-12 * np.abs(exact).max()
        assert small.total_mass(change) == pytest.approx(model.total_mass(full))
        modes = solve_modes(model, full, n_modes=6)
        columns = [list(model.parameters).index(name) for name in free]
        gradients = small.pencil_gradients(modes.shapes, modes.eigenvalues, change)
        exact = modes.gradients(range(6))[:, columns]
        np.testing.assert_allclose(gradients, exact, rtol=1e-8, atol=1e-9 * np.abs(exact).max())


def test_narrow_model_keeps_its_word(model):
    """Within 0.01 % at 50 random points; gradients too."""
    ranges = {"k1": (900.0, 3500.0), "k2": (15e3, 80e3)}
    small = narrow(model, ranges, 10, tolerance=1e-4)
    assert small.error <= 1e-4
    assert small.model.n_dofs < model.n_dofs / 3
    rng = np.random.default_rng(5)
    exact, quick = (Forward(m, SENSORS, 5, 10) for m in (model, small.model))
    for _ in range(50):
        point = {k: float(np.exp(rng.uniform(*np.log(pair)))) for k, pair in ranges.items()}
        log_f, slopes = exact({**model.values(), **point})
        near, near_slopes = quick(point)
        assert np.abs(near - log_f).max() < 1e-4
        columns = [list(VALUES).index(name) for name in ranges]
        scale = np.abs(slopes[:, columns]).max(axis=0)
        assert np.all(np.abs(near_slopes - slopes[:, columns]) < 2e-2 * scale)
    better = narrow(model, ranges, 10, tolerance=1e-8)
    assert better.error <= 1e-8
    assert better.model.n_dofs > small.model.n_dofs


def test_bad_input_is_said(model):
    with pytest.raises(InputError, match="expected some of: E, rho"):
        freeze(model, ["k3"])
    with pytest.raises(InputError, match="of a part, joint or support"):
        freeze(model, ["mass"])
    with pytest.raises(InputError, match="range of k1"):
        narrow(model, {"k1": (0.0, 5.0)}, 8)
    with pytest.raises(ConvergenceError, match="narrower ranges"):
        narrow(model, {"k1": (1e3, 2e3)}, 8, tolerance=1e-18)

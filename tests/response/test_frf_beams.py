"""Functions of bolted beams: closed form, the matrices themselves, derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from fenics_joints.beams import Beam, BeamStructure, GenericJoint
from fenics_joints.errors import InputError
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import read_array_model, write_array_model
from fenics_joints.response import solve_frf
from fenics_joints.structure import Damping, Parameter, Sensors

STEEL = {"E": 208e9, "nu": 0.3, "rho": 7860.0}
BREADTH, HEIGHT = 0.021, 0.0106
UP = [0.0, 0.0, 1.0]


def lapped(**given) -> BeamStructure:
    """Two beams, their joint's numbers as parameters."""
    values = {"k1": 1763.2, "k2": 37402.0, "c": 3.0} | given
    beams = [Beam(n, x, BREADTH, HEIGHT, 12, **STEEL) for n, x in (("a", 0.36), ("b", 0.26))]
    lap = GenericJoint("lap", 0.05, 5, "k1", "k2", "c")
    parameters = [Parameter(k, v, log=k != "c") for k, v in values.items()]
    return BeamStructure(beams, [lap], parameters)


def exact_receptance(length: float, f: float, loss: float) -> tuple[complex, complex]:
    """w at both ends of a free Timoshenko beam under a unit force across its left end.

    (w, theta, V, M)' = A (w, theta, V, M), with a force V and a moment M on the part to the left.
    """
    omega2, area, inertia = (2 * np.pi * f) ** 2, BREADTH * HEIGHT, BREADTH * HEIGHT**3 / 12
    E = STEEL["E"] * (1 + 1j * loss)
    shear, rho = E / 2.6 * area / 1.2, STEEL["rho"]
    A = np.array(
        [
            [0, 1, 1 / shear, 0],
            [0, 0, 0, 1 / (E * inertia)],
            [-rho * area * omega2, 0, 0, 0],
            [0, -rho * inertia * omega2, -1, 0],
        ]
    )
    T = scipy.linalg.expm(A * length)
    # At x = 0 the force is on the beam: V = -1, M = 0. At the other end both vanish.
    left = np.linalg.solve(T[2:, :2], -T[2:, 2] * -1.0)
    return left[0], T[0, :2] @ left - T[0, 2]


def test_free_beam_has_the_closed_forms_receptance():
    length, loss = 0.5, 0.02
    beam = BeamStructure([Beam("beam", length, BREADTH, HEIGHT, 60, **STEEL)])
    lines = np.array([11.0, 150.0, 219.0, 700.0, 1500.0])
    found = solve_frf(
        beam,
        frequencies_hz=lines,
        damping=Damping(structural=loss),
        excitation=Sensors([[0.0, 0, 0]], UP),
        sensors=Sensors([[0.0, 0, 0], [length, 0, 0]], UP),
    )
    exact = [exact_receptance(length, f, loss) for f in lines]
    np.testing.assert_allclose(found.values[:, :, 0], exact, rtol=2e-3)
    # Across a free body a force moves its mass first.
    mass = STEEL["rho"] * BREADTH * HEIGHT * length
    slow = solve_frf(
        beam,
        frequencies_hz=[0.5],
        excitation=Sensors([[length / 2, 0, 0]], UP),
        sensors=Sensors([[length / 2, 0, 0]], UP),
    )
    assert slow.values[0, 0, 0] == pytest.approx(-1 / (mass * np.pi**2), rel=1e-3)


def test_joint_damping_is_that_of_the_matrix_and_has_derivatives(tmp_path):
    beams, lines = lapped(), np.linspace(30.0, 3000.0, 60)
    lines[14] = solve_modes(beams, n_modes=6).frequencies_hz[5]  # where only the joint's damping is
    hammer = Sensors([[0.01, 0, 0.01]], UP)
    read = Sensors([[0.57, 0, 0], [0.3333, 0, 0.01], [0.1, 0, 0.0106]], [UP, UP, [1.0, 0, 0]])
    common = {
        "frequencies_hz": lines,
        "excitation": hammer,
        "sensors": read,
        "kind": "accelerance",
        "damping": beams.joint_damping(),
    }
    found = solve_frf(beams, gradients=True, **common)
    K, M, C = beams.stiffness(), beams.mass(), beams.damping_matrix()
    force, rows = beams.loads(hammer).T, beams.loads(read).T
    for f, value in zip(lines[::7], found.values[::7], strict=True):
        w = 2 * np.pi * f
        direct = -w * w * rows @ np.linalg.solve(K + 1j * w * C - w * w * M, force.T)
        np.testing.assert_allclose(value, direct, rtol=1e-7)
    for i, (name, value) in enumerate(beams.values().items()):
        up, down = (solve_frf(beams, {name: value * s}, **common).values for s in (1.0001, 0.9999))
        slope = (up - down) / (2e-4 * value)
        off = np.abs(found.gradients[..., i] - slope).max() / np.abs(slope).max()
        assert off < 1e-5, name
    # The same as plain arrays, which know the points that they were made for.
    arrays = beams.arrays(None, hammer, read)
    np.testing.assert_allclose(solve_frf(arrays, **common).values, found.values, rtol=1e-10)
    write_array_model(arrays, tmp_path / "beams.h5")
    kept = read_array_model(tmp_path / "beams.h5")
    np.testing.assert_array_equal(
        solve_frf(kept, **common).values, solve_frf(arrays, **common).values
    )
    smaller = arrays.on(np.linalg.qr(np.random.default_rng(0).random((len(K), 9)))[0])
    assert smaller.dampers["lap.c"].shape == (9, 9)
    assert solve_frf(smaller, **common).values.shape == found.values.shape
    with pytest.raises(InputError, match="expected one of the"):
        solve_frf(arrays, **{**common, "sensors": Sensors([[0.2, 0, 0]], UP)})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"excitation": Sensors([[0.58, 0, 0]], UP)}, r"excitation at \[0\.58.*outside"),
        ({"sensors": Sensors([[0.5, 0]], [0.0, 1.0])}, "expected .x, y, z."),
        ({"damping": Damping(viscous={"lap.d": 1.0})}, "'lap.d'.*lap.c"),
        ({"damping": Damping(hysteretic={"lap.c": 0.1})}, "hysteretic names 'lap.c'"),
        ({"given": {"c": -1.0}}, r"lap\.c = -1\.0: expected a number of at least 0"),
    ],
)
def test_bad_input_is_said(change, words):
    beams, at = lapped(), Sensors([[0.1, 0, 0]], UP)
    usual = {"excitation": at, "sensors": at, "damping": beams.joint_damping()}
    with pytest.raises(InputError, match=words):
        solve_frf(beams, frequencies_hz=[100.0], **(usual | change))

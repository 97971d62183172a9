"""Gaps, stops and elastic dry friction against closed forms and an integration in time."""

from __future__ import annotations

import numpy as np
import pytest
from oscillators import oscillator
from scipy.integrate import solve_ivp

from fenics_joints.errors import InputError
from fenics_joints.harmonic import Balance
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import (
    CoulombStick,
    ElasticFriction,
    FluidFilm,
    GapSpring,
    LawKernel,
    UnilateralSpring,
)


def history(law, strain, normal=False):
    """Stress (T, d) of one point over a history of strain (T, d)."""
    kernel = LawKernel.of(law, strain.shape[1] - normal, normal)
    return kernel.history(np.asarray(strain, float)[None], None, law.values(1))[0][0]


def first_harmonic(law, a):
    """Cosine and sine of the first harmonic over the amplitude of a cosine."""
    balance = Balance(oscillator(law, 0.0), 3, samples=4096)
    X = np.zeros(balance.shape)
    X[0, 1] = a
    return balance.interface_force(X)[0][0, 1:3] / a


def test_describing_functions_of_gap_and_elastic_friction():
    """Gelb and Vander Velde (1968): dead zone, and a spring with a slider."""
    k, g, a = 3.0, 0.4, 1.1
    r = g / a
    exact = k * (1 - 2 / np.pi * (np.arcsin(r) + r * np.sqrt(1 - r**2)))
    assert first_harmonic(GapSpring(k, g), a) == pytest.approx([exact, 0.0], abs=1e-9)
    assert first_harmonic(GapSpring(k, 2 * a), a) == pytest.approx([0.0, 0.0], abs=1e-12)
    strength = k * g
    turn = np.arccos(1 - 2 * r)
    real, loss = k / np.pi * (turn - 0.5 * np.sin(2 * turn)), 4 * k * r * (1 - r) / np.pi
    assert first_harmonic(ElasticFriction(k, strength), a) == pytest.approx([real, -loss], rel=1e-5)


def test_gap_is_met_all_round_and_a_stop_from_one_side():
    path = np.random.default_rng(0).normal(size=(40, 2))
    length = np.linalg.norm(path, axis=1, keepdims=True)
    expected = 2.0 * np.maximum(length - 0.7, 0.0) * path / length
    assert np.allclose(history(GapSpring(2.0, 0.7), path), expected, atol=1e-13)
    x = np.linspace(-2, 2, 41)[:, None]
    assert np.allclose(history(UnilateralSpring(3.0, -0.5), x), 3.0 * np.maximum(x + 0.5, 0.0))
    with pytest.raises(InputError, match="2 components of slip; expected one"):
        history(UnilateralSpring(1.0), path)
    with pytest.raises(InputError, match=r"gap\.gap"):
        GapSpring(1.0, -0.1)


def test_a_slider_on_a_circle_lags_by_its_stretch():
    """On a circle of radius R the slider runs on one of sqrt(R^2 - (S/k)^2), pulled along it."""
    k, strength, R, N = 5.0, 2.0, 1.3, 4000
    turn = 2 * np.pi * np.arange(3 * N + 1) / N
    path = R * np.column_stack([np.cos(turn), np.sin(turn)])
    pull = history(ElasticFriction(k, strength), path)
    work = np.sum(0.5 * (pull[1:] + pull[:-1]) * np.diff(path, axis=0), axis=1)[-N:].sum()
    reach = np.sqrt(R**2 - (strength / k) ** 2)
    assert work == pytest.approx(2 * np.pi * strength * reach, rel=5e-4)


def test_friction_in_a_plane_under_a_load_that_varies():
    """Against the rate equations of a slider that slides all the time, by an ODE solver.

    With |t| = mu N: z' = t / |t| * (t . x' / |t| - mu N' / k).
    """
    k, k_n, mu = 4.0, 7.0, 0.3

    def motion(s):
        return np.array([1.2 * np.cos(s), 0.9 * np.sin(s)]), -1.0 - 0.4 * np.sin(2 * s + 0.3)

    def rates(s):
        return np.array([-1.2 * np.sin(s), 0.9 * np.cos(s)]), -0.8 * np.cos(2 * s + 0.3)

    def slide(s, z):
        t = k * (motion(s)[0] - z)
        t /= np.linalg.norm(t)
        v, opening = rates(s)
        speed = t @ v + mu * k_n * opening / k
        assert speed > 0
        return speed * t

    s = np.linspace(0, 3, 6001)
    begin = motion(0.0)[0] - mu * k_n * -motion(0.0)[1] / k * np.array([0.0, 1.0])
    z = solve_ivp(slide, (0, 3), begin, rtol=1e-10, atol=1e-12).y[:, -1]
    strain = np.array([[opening, *x] for x, opening in map(motion, s)])
    law = CoulombStick(k_n, k, mu)
    state = begin.reshape(1, 1, 2)
    stress, _ = LawKernel.of(law, 2, True).history(strain[None], state, law.values(1))
    assert stress[0, -1, 0] == pytest.approx(k_n * strain[-1, 0])
    expected = k * (strain[-1, 1:] - z)
    assert stress[0, -1, 1:] == pytest.approx(expected, rel=1e-3, abs=1e-3 * k_n * mu)


def test_a_squeezed_film_takes_what_reynolds_says():
    """Per cycle of h (1 + e cos w t): pi c w (h e)^2 / (1 - e^2)^1.5 with c = eta b^2 / h^3."""
    eta, h, b, area, e, omega = 0.08, 2e-5, 0.01, 3e-4, 0.4, 250.0
    one = np.ones((1, 1))
    rows = np.array([[[1.0], [0.5]]])  # it opens, and slips half as far
    film = InterfacePoints("film", FluidFilm(eta, h, b), rows, np.array([area]), True)
    model = InterfaceModel(one, one, (film,), one, {"push": one[0]}, {"mass": one[0]})
    balance = Balance(model, 9, samples=512)
    X = np.zeros(balance.shape)
    X[0, 1] = h * e
    work = -np.pi * h * e * balance.interface_force(X, omega)[0][0, 2]
    squeeze = np.pi * eta * b**2 / h**3 * omega * (h * e) ** 2 / (1 - e**2) ** 1.5
    # The integral of sin^2 / (1 + e cos) over a turn, of the shear.
    shear = 0.25 * eta / h * omega * (h * e) ** 2 * 2 * np.pi * (1 - np.sqrt(1 - e**2)) / e**2
    assert work == pytest.approx(area * (squeeze + shear), rel=1e-9)
    assert shear > 1e-7 * squeeze

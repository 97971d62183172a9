"""Joint laws at a point: backbones, sliders, memory, against closed forms and integrations."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from scipy.integrate import quad, solve_ivp, trapezoid

from fenics_joints import forms
from fenics_joints.errors import InputError
from fenics_joints.joint_laws import (
    Backbone,
    Bilinear,
    BoucWen,
    CoulombStick,
    CubicSpring,
    DilatantCoulomb,
    Iwan,
    JointLaw,
    LawKernel,
    RichardAbbott,
    Segalman,
    Valanis,
    iwan_sliders,
    slider_edges,
)

SEED = RichardAbbott(E_e=168.13e6, E_p=1.01e5, S_y=5.7426e5, n=2.5)
CURVES = [
    SEED,
    Segalman(F_S=100.0, K_T=1e6, chi=-0.5, beta=0.3),
    Bilinear(1e6, 10.0, 1e4),
    Segalman(F_S=2.0, K_T=10.0, chi=0.7, beta=0.1),
]


def history(law, strain, normal=False, state=None):
    """Stress (T, d) and states (E, m) of one point over a history of strain (T, d)."""
    strain = np.asarray(strain, dtype=float)
    kernel = LawKernel.of(law, strain.shape[1] - normal, normal)
    state = None if state is None else state[None]
    stress, state = kernel.history(strain[None], state, law.values(1))
    return stress[0], state[0]


@pytest.mark.parametrize("curve", CURVES, ids=lambda c: type(c).__name__)
def test_backbones_slope_and_dissipation(curve):
    """Slopes are derivatives; dissipation is Masing's, by another quadrature."""
    for share in (0.3, 0.99, 1.6):
        a = share * curve.reference
        h = 1e-6 * a
        slope = (curve.value(a + h) - curve.value(a - h)) / (2 * h)
        assert curve.slope(a) == pytest.approx(float(slope), rel=1e-6)
        area = quad(curve.value, 0, min(a, curve.limit), epsabs=0, epsrel=1e-12)[0]
        area += quad(curve.value, min(a, curve.limit), a, epsabs=0)[0]
        masing = 8 * area - 4 * a * float(curve.value(a))
        lost = float(curve.dissipation(a))
        assert lost == pytest.approx(masing, rel=1e-7, abs=1e-9 * curve.strength * a)
        assert Backbone.dissipation(curve, a) == pytest.approx(lost, rel=1e-9)
        assert curve.secant(-a) == pytest.approx(float(curve.value(a)) / a)
    far = 1e7 * curve.reference
    assert curve.value(far) - far * curve.final_slope == pytest.approx(curve.strength, rel=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 9, 10, 24])
@pytest.mark.parametrize("curve", CURVES, ids=lambda c: type(c).__name__)
def test_sliders_are_exact_where_they_should_be(curve, n):
    """Stiffness at rest and strength always; stress and dissipation at the edges of bins."""
    stiffness, strength = iwan_sliders(curve, n)
    whole = float(curve.slope(0.0)) - curve.final_slope
    assert stiffness.sum() == pytest.approx(whole, rel=1e-12)
    assert strength.sum() == pytest.approx(curve.strength, rel=1e-9)
    assert len(stiffness) == (1 if isinstance(curve, Bilinear) else n)
    for a in slider_edges(curve, n)[1:] if n >= 5 else ():
        stress = np.minimum(stiffness * a, strength).sum() + curve.final_slope * a
        assert stress == pytest.approx(float(curve.value(a)), rel=1e-7)
        loop = np.sum(4 * strength * np.maximum(a - strength / stiffness, 0.0))
        assert loop == pytest.approx(float(curve.dissipation(a)), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("curve", CURVES[:2], ids=["richard_abbott", "segalman"])
def test_dissipation_falls_with_the_square_of_the_sliders(curve):
    """Greatest error over a range of amplitudes, and its mean, against the closed form."""
    numbers = np.array([9, 17, 33, 65])
    low, high = 0.5 * curve.reference, curve.reference
    a = np.geomspace(low, high, 3001)
    exact = curve.dissipation(a)
    worst, mean = [], []
    for n in numbers:
        stiffness, strength = iwan_sliders(curve, int(n), (low, high))
        slid = np.maximum(a[:, None] - strength / stiffness, 0.0)
        error = 4 * slid @ strength / exact - 1
        worst.append(np.abs(error).max())
        mean.append(abs(error.mean()))
    order = np.polyfit(np.log(numbers - 3), np.log(worst), 1)[0]
    assert -2.2 < order < -1.8
    assert worst[0] < 0.013 and worst[1] < 0.004
    # What an interface sees, whose points move by different amplitudes.
    assert mean[0] < 1e-4


def test_few_sliders_dissipate_within_one_per_cent():
    """Eight sliders, at the amplitude they were made for and over the range below in the mean."""
    a = 0.8 * SEED.reference
    stiffness, strength = iwan_sliders(SEED, 8, (0.5 * a, a))
    loop = np.sum(4 * strength * np.maximum(a - strength / stiffness, 0.0))
    exact = float(SEED.dissipation(a))
    assert loop == pytest.approx(exact, rel=1e-6)
    law = Iwan(SEED, 8, amplitudes=(0.5 * a, a))
    x = a * np.concatenate([np.linspace(0, 1, 100), np.cos(np.linspace(0, 2 * np.pi, 2001))])
    stress, _ = history(law, x[:, None])
    assert trapezoid(stress[100:, 0], x[100:]) == pytest.approx(exact, rel=0.01)


def test_iwan_loads_on_its_backbone_and_unloads_by_masing():
    """Loading follows the curve within the sliders' error, unloading twice the curve, exactly."""
    law = Iwan(SEED, 48)
    a = 1.5 * SEED.reference
    up = np.linspace(0, a, 301)
    first, state = history(law, up[:, None])
    assert np.abs(first[:, 0] - SEED.value(up)).max() < 0.002 * SEED.strength
    down = a - 2 * up
    back, state = history(law, down[:, None], state=state)
    assert np.allclose(back[:, 0], first[-1, 0] - 2 * first[:, 0], rtol=0, atol=1e-9 * SEED.S_y)
    # A small cycle inside closes, and the path goes on as if it had not been.
    again, _ = history(law, -a + np.array([[0.4], [0.8], [0.5], [0.8], [1.2]]) * a, state=state)
    straight, _ = history(law, -a + np.array([[0.8], [1.2]]) * a, state=state)
    assert np.allclose(again[[1, 3, 4], 0], straight[[0, 0, 1], 0], rtol=1e-12)


@pytest.mark.parametrize(
    "law", [Iwan(SEED, 5), Valanis(1e6, 1e4, 80.0), CubicSpring(1e6, -1e9)], ids=lambda w: w.name
)
def test_isotropy(law):
    """A turned path gives the turned stress; a path along a line is that of one dimension."""
    path = np.cumsum(np.random.default_rng(1).normal(size=(30, 2)), axis=0) * 1e-3
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    stress, _ = history(law, path)
    turned, _ = history(law, path @ turn.T)
    scale = np.abs(stress).max()
    assert np.allclose(turned, stress @ turn.T, rtol=0, atol=1e-10 * scale)
    flat, _ = history(law, path[:, :1] * turn[:, 0])
    line, _ = history(law, path[:, :1])
    assert np.allclose(flat, line * turn[:, 0], rtol=0, atol=1e-10 * scale)


def test_coulomb_under_varying_pressure():
    """Against the play operator with a moving limit, and lift-off."""
    k_n, k_s, mu, p0 = 2e10, 1e10, 0.3, 1e6
    law = CoulombStick(k_n, k_s, mu, p0)
    t = np.linspace(0, 4 * np.pi, 801)
    opening, slip = 0.7e-4 * np.sin(1.3 * t), 1e-4 * np.sin(t)
    stress, _ = history(law, np.column_stack([opening, slip]), normal=True)
    pressure = np.maximum(p0 - k_n * opening, 0.0)
    assert pressure.min() == 0.0
    assert np.allclose(stress[:, 0], p0 - pressure, rtol=0, atol=1e-9 * p0)
    z, expected = 0.0, []
    for x, p in zip(slip, pressure, strict=True):
        z = np.clip(z, x - mu * p / k_s, x + mu * p / k_s)
        expected.append(k_s * (x - z))
    assert np.allclose(stress[:, 1], expected, rtol=0, atol=1e-9 * p0)


def sliding_state():
    """A dilatant joint that slides, in space: law, strain, state."""
    law = DilatantCoulomb(3e10, 1e10, 0.4, 2e6)
    path = np.linspace(0, 1, 200)[:, None] * np.array([-2e-5, 4e-4, 2.5e-4])
    stress, state = history(law, path, normal=True)
    return law, path[-1], state, stress[-1]


def test_matrix_of_sliding_is_the_seeds_without_its_misprint():
    """Eq. 1 against differences of the return: k_n (1 - mu^2 k_n / H), not mu^2 k_n^2."""
    law, strain, state, stress = sliding_state()
    k_n, k_s, mu, _ = (float(a) for a in law.parameters.values())
    tau = stress[1:]
    assert np.linalg.norm(tau) == pytest.approx(mu * (2e6 - stress[0]), rel=1e-9)
    matrix = forms.coulomb_matrix(ufl.as_vector([float(x) for x in tau]), k_n, k_s, mu)
    matrix = np.array([[matrix[i, j](()) for j in range(3)] for i in range(3)], dtype=float)
    # Along the path it slides on; the increment is small, so that the return is the rate's.
    for direction in np.array([[0.0, 4.0, 2.5], [-1.0, 4.0, 2.5], [-0.5, 5.0, 2.5]]):
        step = 1e-10 * direction
        moved, _ = history(law, (strain + step)[None], normal=True, state=state)
        assert np.allclose((moved[0] - stress) / 1e-10, matrix @ direction, rtol=1e-4)
    printed = k_n * (1 - mu**2 * k_n**2 / (k_n * mu**2 + k_s))
    assert abs(printed / matrix[0, 0]) > 1e6


def test_dilatant_sliding_opens_and_comes_apart_at_the_apex():
    """Opening grows by mu times the way; pulled apart, no stress is left."""
    law, strain, state, stress = sliding_state()
    moved, after = history(law, (strain + [0.0, 4e-5, 2.5e-5])[None], normal=True, state=state)
    way = np.linalg.norm(after[0, :2] - state[0, :2])
    assert after[0, 2] - state[0, 2] == pytest.approx(0.4 * way, rel=1e-9)
    apart, _ = history(law, (strain + [1e-3, 0.0, 0.0])[None], normal=True, state=state)
    # It returns what comes on top of the pressure at rest.
    assert np.allclose(apart[0], [2e6, 0.0, 0.0], atol=1e-3)


def path(t):
    return 0.02 * np.sin(t) * (1 + 0.5 * np.sin(2.3 * t))


def rate(t, h=1e-6):
    return (path(t + h) - path(t - h)) / (2 * h)


@pytest.mark.parametrize("n", [1.0, 1.7])
def test_bouc_wen_against_its_differential_equation(n):
    """Second order in the step, to solve_ivp's answer."""
    beta, gamma = 60.0 * 50 ** (n - 1), 30.0 * 50 ** (n - 1)
    law = BoucWen(1e6, 0.1, beta, gamma, n)
    ends = (0.0, 7.0)

    def equation(t, z):
        v = rate(t)
        return v - beta * abs(v) * abs(z) ** (n - 1) * z - gamma * v * abs(z) ** n

    exact = solve_ivp(equation, ends, [0.0], rtol=1e-10, atol=1e-14, max_step=0.01).y[0, -1]
    exact = 1e6 * (0.1 * path(7.0) + 0.9 * exact)
    errors = []
    for steps in (200, 400, 800):
        stress, _ = history(law, path(np.linspace(*ends, steps + 1))[:, None])
        errors.append(abs(stress[-1, 0] - exact) / 1e4)
    assert errors[-1] < 1e-4
    assert np.log2(errors[0] / errors[-1]) / 2 > 1.7


def test_valanis_against_its_differential_equation():
    """On a circle, where the direction of the path turns."""
    rate_of, radius = 80.0, 0.02
    law = Valanis(1e6, 1e4, rate_of)

    def circle(t):
        return radius * np.stack([np.sin(t), 1 - np.cos(t)], axis=-1)

    def equation(t, z):
        v = radius * np.array([np.cos(t), np.sin(t)])
        return v - rate_of * radius * z

    z = solve_ivp(equation, (0, 7), [0, 0], rtol=1e-10, atol=1e-14).y[:, -1]
    exact = 1e4 * circle(7.0) + 0.99e6 * z
    paths = [circle(np.linspace(0, 7, steps + 1)) for steps in (100, 400)]
    coarse, fine = (np.abs(history(law, p)[0][-1] - exact).max() for p in paths)
    assert fine < 1e-4 * 1e4 and np.log(coarse / fine) / np.log(4) > 1.9
    # Exact in one step along a line.
    line, _ = history(law, [[0.03]])
    closed = 1e4 * 0.03 + 0.99e6 * (1 - np.exp(-80 * 0.03)) / 80
    assert line[0, 0] == pytest.approx(closed, rel=1e-12)


class Ramberg(JointLaw):
    """A law of a user's own: Iranzad and Ahmadian 2012's backbone as a spring without memory."""

    def element(self, normal, slip, state, p):
        size = ufl.sqrt(ufl.dot(slip, slip) + 1e-30)
        stress = forms.richard_abbott(size, p["E_e"], p["E_p"], p["S_y"], p["n"])
        return ufl.as_ufl(0.0), stress / size * slip, None


def test_a_users_own_law():
    """It is compiled, differentiated, and equal to the backbone in numbers."""
    law = Ramberg(E_e=SEED.E_e, E_p=SEED.E_p, S_y=SEED.S_y, n=SEED.n)
    x = np.array([0.4, 1.0, 3.0]) * SEED.reference
    stress, _, tangent = LawKernel.of(law, 1, False).step(x[:, None], None, law.values(3))
    assert np.allclose(stress[:, 0], SEED.value(x), rtol=1e-12)
    assert np.allclose(tangent[:, 0, 0], SEED.slope(x), rtol=1e-9)


def test_change_is_smooth():
    """Sliders keep their bins: stress is a smooth function of the parameters."""
    law = Iwan(SEED, 9)
    assert np.allclose(law.change(S_y=SEED.S_y).parameters["strength"], law.parameters["strength"])
    x = 0.63 * SEED.reference * np.array([[1.0], [-0.4], [0.9]])
    middle = history(law, x)[0][-1, 0]
    for key, step in (("S_y", 1.0), ("n", 1e-5), ("E_p", 1.0)):
        value = getattr(SEED, key)
        above = history(law.change(**{key: value + step}), x)[0][-1, 0]
        below = history(law.change(**{key: value - step}), x)[0][-1, 0]
        assert abs(above + below - 2 * middle) < 1e-3 * abs(above - below)


@pytest.mark.parametrize(
    "make, word",
    [
        (lambda: RichardAbbott(1e6, 2e6, 1.0, 2.0), "E_p < E_e"),
        (lambda: Iwan(SEED, 9, amplitudes=(2.0, 1.0)), "amplitudes"),
        (lambda: Iwan(SEED).change(S_z=1.0), "S_z"),
        (lambda: BoucWen(1e6, 0.1, 1.0, 2.0), "gamma"),
        (lambda: Valanis(1e6, 2e6, 1.0), "E_t"),
        (lambda: Valanis(1e6, 1e5, 1.0).with_values(E_t=2e6), "E_t"),
    ],
)
def test_bad_input_is_named(make, word):
    with pytest.raises(InputError, match=word):
        make()

"""Offset beams and generic joints: closed forms, the paper's numbers, a solid of the same lap."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from eigen_slopes import difference
from mpi4py import MPI

from fenics_joints.beams import (
    Beam,
    BeamStructure,
    GenericJoint,
    Held,
    LumpedMass,
    element,
    identify_damping,
    slip_table,
)
from fenics_joints.beams.element import BEAM, BEAM_MASSES
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements import Target
from fenics_joints.meshes import lap_beam
from fenics_joints.modal import solve_modes
from fenics_joints.response import solve_complex_modes
from fenics_joints.structure import Parameter, Sensors, Spring, Structure, part
from fenics_joints.updating import update

E, NU, RHO = 208e9, 0.3, 7860.0
BREADTH, HEIGHT = 0.021, 0.0106
STEEL = {"E": E, "nu": NU, "rho": RHO}
#: Jalali et al. 2019, Table 1: measured, and the paper's model; Table 2 by torque.
MEASURED = np.array([158.41, 442.81, 860.93, 1383.5, 2045.7, 2869.4, 3438.9, 4279.7])
UPDATED = np.array([158.37, 443.5, 861.6, 1382.7, 2045.3, 2809.0, 3613.4, 4172.2])
TABLE_2 = {7: (1690.2, 31047.0), 15: (1715.9, 34810.0), 23: (1763.2, 37402.0)}


def one_beam(n, *, offset=None, held=(), length=0.5, offset_mass=True) -> BeamStructure:
    beam = Beam("beam", length, BREADTH, HEIGHT, n, **STEEL, offset=offset)
    return BeamStructure([beam], held=held, offset_mass=offset_mass)


def elastic_hz(model, n, given=None) -> np.ndarray:
    modes = solve_modes(model, given, n_modes=n + 3)
    return modes.frequencies_hz[modes.n_rigid :][:n]


def bolted_beams(offset_mass=False, each=False, bolt_at=None, **given) -> BeamStructure:
    """Jalali et al. 2019, with the geometry that was fitted to the paper's own model."""
    values = {"E": E, "nu": NU, "rho": RHO, "t": 1.0, "k1": 1763.2, "k2": 37402.0, "c": 0.15}
    names = {}
    for key in ("k1", "k2"):
        names[key] = [f"{key}[{i}]" for i in range(5)] if each else key
        if each:
            values |= dict.fromkeys(names[key], values.pop(key))
    values |= {"bolt": 0.012, "place": 0.0} | given
    log = {"nu": False, "c": False, "place": False}
    parameters = [Parameter(k, v, log=log.get(k, True)) for k, v in values.items()]
    beams = [
        Beam(name, length, BREADTH, HEIGHT, n, "E", "nu", "rho", stretch="t")
        for name, length, n in (("upper", 0.36, 30), ("lower", 0.26, 20))
    ]
    radius = (9.84e-8 / 0.0075) ** 0.5
    masses = [
        LumpedMass(f"sensor {i}", 0.0075, (x, 0.0, 0.0), radius)
        for i, x in enumerate((0.62 / 30, 0.31 * 29 / 30, 0.36))
    ]
    travel = ("place", (-0.02, 0.02)) if bolt_at is None else (bolt_at, None)
    masses.append(LumpedMass("bolt", "bolt", (0.335, 0, 0), (3.45e-6 / 0.012) ** 0.5, *travel))
    lap = GenericJoint("lap", 0.05, 5, **names, c="c")
    return BeamStructure(beams, [lap], parameters, masses=masses, offset_mass=offset_mass)


# -- elements --------------------------------------------------------------------------------------


def section(length, offset):
    q = {**STEEL, "stretch": 1.0, "width": 1.0, "height": HEIGHT, "breadth": BREADTH}
    return q | {"length": length, "shear": 1.2, "offset": offset, "mass_offset": offset}


#: A to F of the appendix (A2 to A7), factors of 1, phi and phi^2: what multiplies 1, and (r / L)^2.
#: The first of E is printed as 1/150; Przemieniecki 1968, eq. 11.83, has 1/105.
APPENDIX = [
    ((13 / 35, 7 / 10, 1 / 3), (6 / 5, 0, 0)),
    ((9 / 70, 3 / 10, 1 / 6), (-6 / 5, 0, 0)),
    ((11 / 210, 11 / 120, 1 / 24), (1 / 10, -1 / 2, 0)),
    ((13 / 420, 3 / 40, 1 / 24), (-1 / 10, 1 / 2, 0)),
    ((1 / 105, 1 / 60, 1 / 120), (2 / 15, 1 / 6, 1 / 3)),
    ((1 / 140, 1 / 60, 1 / 120), (1 / 30, 1 / 6, -1 / 6)),
]


@pytest.mark.parametrize("offset", [0.5, -0.5])
def test_element_is_the_integral_of_its_shape_functions(offset):
    """Stiffness against quadrature of its energy, mass against the paper's formulas."""
    L, q = 0.02, section(0.02, offset)
    area, inertia, arm = BREADTH * HEIGHT, BREADTH * HEIGHT**3 / 12, offset * HEIGHT
    phi = element.bending_number(NU, HEIGHT, L, 1.2)
    K, M = np.zeros((6, 6)), np.zeros((6, 6))
    places, weights = np.polynomial.legendre.leggauss(6)
    for t, weight in zip(0.5 + 0.5 * places, 0.5 * L * weights, strict=True):
        at, slope = element.shape_functions(t, L, phi)
        bend, shear = slope[2], slope[1] - at[2]
        # The displacement of the neutral axis, u - q theta, is linear between the nodes.
        stretch = np.array([-1, 0, arm, 1, 0, -arm]) / L
        K += weight * E * area * np.outer(stretch, stretch)
        K += weight * E * inertia * np.outer(bend, bend)
        K += weight * E / (2 * (1 + NU)) * area / 1.2 * np.outer(shear, shear)
        along = np.array([1 - t, 0, -arm * (1 - t), t, 0, -arm * t])
        M += weight * RHO * area * np.outer(along, along)
    by_mass, by_turn = np.moveaxis(APPENDIX, 1, 0)
    a, b, c, d, e, f = (by_mass + by_turn * HEIGHT**2 / 12 / L**2) @ phi ** np.arange(3)
    c, d, e, f = L * c, L * d, L**2 * e, L**2 * f
    across = np.array([[a, c, b, -d], [c, e, d, -f], [b, d, a, -c], [-d, -f, -c, e]])
    M[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] += RHO * area * L / (1 + phi) ** 2 * across
    stiff = np.tensordot(BEAM.stiffness_terms(q), element.stiffness_matrices(L), 1)
    heavy = [law.inertia_term(q) for law in (BEAM, *BEAM_MASSES)]
    mass = np.tensordot(heavy, element.mass_matrices(L), 1)
    np.testing.assert_allclose(stiff, K, atol=1e-10 * np.abs(K).max())
    np.testing.assert_allclose(mass, M, atol=1e-10 * np.abs(M).max())


@pytest.mark.parametrize("offset", [0.5, -0.5])
def test_no_energy_in_rigid_motions_and_the_right_inertia(offset):
    L, q = 0.013, section(0.013, offset)
    stiff = np.tensordot(BEAM.stiffness_terms(q), element.stiffness_matrices(L), 1)
    joint = np.tensordot([1.7e3, 3.1e4, 2e9], element.joint_matrices(L), 1)
    # Translations, and a turn about the point of the line at x = 0.
    rigid = np.array([[1, 0, 0, 1, 0, 0], [0, 1, 0, 0, 1, 0], [0, 0, 1, 0, L, 1.0]]).T
    for K in (stiff, joint):
        np.testing.assert_allclose(K, K.T, rtol=1e-12)
        assert np.abs(K @ rigid).max() < 1e-9 * np.abs(K).max()
        assert np.linalg.eigvalsh(K)[3] > 1e-9 * np.linalg.eigvalsh(K)[5]
    # As printed, entries (4, 6) and (6, 4) of eq. 1 have the other sign.
    printed = stiff.copy()
    printed[[3, 5], [5, 3]] *= -1
    assert np.abs(printed @ rigid[:, 2]).max() == pytest.approx(E * BREADTH * HEIGHT**2 / L)
    heavy = [law.inertia_term(q) for law in (BEAM, *BEAM_MASSES)]
    inertia = rigid.T @ np.tensordot(heavy, element.mass_matrices(L), 1) @ rigid
    m, arm = RHO * BREADTH * HEIGHT * L, offset * HEIGHT
    about = m * (L**2 / 3 + HEIGHT**2 / 12 + arm**2)
    exact = [[m, 0, -m * arm], [0, m, m * L / 2], [-m * arm, m * L / 2, about]]
    np.testing.assert_allclose(inertia, exact, atol=1e-12 * m, rtol=1e-9)


# -- closed forms ----------------------------------------------------------------------------------


def test_slender_beams_are_euler_bernoulli_beams():
    length = 3.0  # 283 heights
    root = np.sqrt(E * HEIGHT**2 / (12 * RHO)) / (2 * np.pi * length**2)
    free = one_beam(24, length=length, offset=0.0)
    clamped = one_beam(24, length=length, offset=0.0, held=[Held(0.0)])
    for model, roots, rel in (
        (free, [4.730041, 7.853205], 3e-4),
        (clamped, [1.875104, 4.694091, 7.854757], 5e-4),
    ):
        exact = np.array(roots) ** 2 * root
        np.testing.assert_allclose(elastic_hz(model, len(roots)), exact, rtol=rel)


@pytest.mark.parametrize(("length", "order"), [(3.0, 4), (0.1, 2)])
def test_convergence_to_timoshenko(length, order):
    """Hinged at both ends, where w = sin(n pi x / L) is exact.

    An element longer than its height is of fourth order, a shorter one, phi > 1, of second.
    """
    n = 3
    k, r2, modulus = n * np.pi / length, HEIGHT**2 / 12, E / (2 * (1 + NU)) / 1.2
    a, b = RHO * r2 / modulus, -(1 + k**2 * r2 * (1 + E / modulus))
    c = E * r2 * k**4 / RHO
    exact = np.sqrt((-b - np.sqrt(b**2 - 4 * a * c)) / (2 * a)) / (2 * np.pi)
    held = [Held(0.0, ("x", "z")), Held(length, ("z",))]
    sizes, errors = [8, 16, 32], []
    for n_elements in sizes:
        modes = solve_modes(one_beam(n_elements, offset=0.0, length=length, held=held), n_modes=5)
        errors.append(np.min(np.abs(modes.frequencies_hz / exact - 1)))
    slopes = np.diff(np.log(errors)) / np.diff(np.log(sizes))
    assert errors[-1] < 1e-3
    assert np.all(np.abs(slopes + order) < 0.3), slopes


def test_offset_moves_nothing_but_the_line():
    """A free beam does not know where its nodes are; with the paper's mass it does."""
    centred, above = one_beam(20, offset=0.0), one_beam(20)
    np.testing.assert_allclose(elastic_hz(above, 6), elastic_hz(centred, 6), rtol=1e-7)
    printed = elastic_hz(one_beam(20, offset_mass=False), 6)
    assert np.max(np.abs(printed / elastic_hz(centred, 6) - 1)) > 5e-3


# -- Jalali et al. 2019
# --------------------------------------------------------------------------------------


def test_published_stiffness_gives_the_published_frequencies():
    """Table 1's model, and Table 2 against the frequencies in the text at the other torques."""
    structure = bolted_beams()
    np.testing.assert_allclose(elastic_hz(structure, 8), UPDATED, rtol=2e-3)
    at = {t: elastic_hz(structure, 8, {"k1": a, "k2": b}) for t, (a, b) in TABLE_2.items()}
    assert at[15][3] == pytest.approx(1373.1, rel=2e-3)  # Fig. 7b
    assert at[7][4] == pytest.approx(2035.08 * np.log(2) ** (1 / 819.5), rel=2e-3)  # Fig. 7c
    moved = elastic_hz(bolted_beams(offset_mass=True), 8) / UPDATED - 1
    assert 5e-3 < np.max(np.abs(moved)) < 2e-2


def test_updating_on_five_modes_leaves_the_papers_errors_on_the_others():
    structure = bolted_beams()
    sensors = Sensors(np.outer(np.linspace(0, 0.57, 20), [1.0, 0, 0]), [0.0, 0, 1])
    data = Target(np.where(np.arange(8) < 5, MEASURED, np.nan), 1e-3, shape_sensors=sensors)
    start = structure.values({"k1": 900.0, "k2": 15000.0})
    unknown = [structure.parameters[name] for name in ("k1", "k2")]
    found = update(structure.arrays(sensors), unknown, data, start, regularisation=2.3)
    errors = 100 * (found.prediction.frequencies_hz / MEASURED - 1)
    assert np.all(np.abs(errors[:5]) < 0.25)
    np.testing.assert_allclose(errors[5:], [-2.10, 5.07, -2.50], atol=0.4)
    np.testing.assert_allclose(found.values, TABLE_2[23], rtol=0.04)
    assert found.values[1] == pytest.approx(TABLE_2[23][1], rel=0.01)


def test_gradients_by_taylor_and_what_sensors_see():
    structure = bolted_beams(offset_mass=True)
    modes = solve_modes(structure, n_modes=11)
    index = np.arange(3, 11)
    gradients = modes.gradients(index)
    for i, name in enumerate(structure.values()):
        # By a share of the value, or of a decimetre where it is zero.
        slope = difference(structure, {}, name, index, 1e-4, zero=0.1, n_modes=11)
        scale = np.abs(slope).max() + 1e-9 * np.abs(gradients).max()
        assert np.abs(slope - gradients[:, i]).max() < 1e-4 * scale, name
    # A bolt that may travel is the same as one that stands where it has come to.
    for place in (0.0, 0.007):
        moved = elastic_hz(structure, 8, {"place": place})
        np.testing.assert_allclose(
            moved, elastic_hz(bolted_beams(True, bolt_at=place), 8), rtol=3e-5
        )
    # A turn moves what stands above the line along it.
    turn = np.zeros((len(structure.layout.x), 3))
    turn[:, 1], turn[:, 2] = structure.layout.x, 1.0
    sensors = Sensors([[0.1, 0, 0.005], [0.333, 0, 0], [0.4, 0, 0]], np.eye(3)[[0, 2, 1]])
    read = structure.observe(turn.reshape(-1, 1), sensors)[:, 0]
    np.testing.assert_allclose(read, [-0.005, 0.333, 0.0], atol=1e-12)
    assert structure.total_mass() == pytest.approx(
        RHO * BREADTH * HEIGHT * 0.62 + 3 * 0.0075 + 0.012
    )


def test_springs_and_elements_with_their_own_stiffness():
    structure = bolted_beams(each=True)
    np.testing.assert_allclose(elastic_hz(structure, 8), elastic_hz(bolted_beams(), 8), rtol=1e-9)
    changed = {"k2[0]": 2e4, "k2[4]": 6e4}
    mirrored = {"k2[0]": 6e4, "k2[4]": 2e4}
    a, b = (elastic_hz(structure, 5, g) for g in (changed, mirrored))
    assert np.max(np.abs(a / b - 1)) > 1e-3  # the beams are unequal
    beam = Beam("beam", 0.5, BREADTH, HEIGHT, 10, **STEEL, offset=0.0)
    soft = [Spring(f"cord {i}", 50.0, (x, 0.0, 0.0)) for i, x in enumerate((0.0, 0.5))]
    hung = solve_modes(BeamStructure([beam], springs=soft), n_modes=4)
    mass = RHO * BREADTH * HEIGHT * 0.5
    bounce = np.sqrt(100.0 / mass) / (2 * np.pi)
    assert hung.frequencies_hz[1] == pytest.approx(bounce, rel=1e-3)


def test_against_a_solid_of_the_same_lap():
    """Two steel beams bonded over the lap, in 3-D, against a joint of the double section."""
    lap, length, n = 0.05, 0.26, 5
    sides = {"length": length, "width": BREADTH, "thickness": HEIGHT, "lap": lap, "washer": 0}
    cells = {"n_length": 10, "n_lap": 6, "n_width": 2, "n_thickness": 1}
    mesh = lap_beam(MPI.COMM_WORLD, bonded=True, **sides, **cells)
    x = np.linspace(0, 2 * length - lap, 15)
    z = np.where(x < length - lap, -HEIGHT / 2, np.where(x > length, HEIGHT / 2, 0.0))
    sensors = Sensors(np.column_stack([x, 0 * x, z]), [0.0, 0, 1])
    solid = solve_modes(Structure(mesh, [part("both", ("beam_1", "beam_2"), **STEEL)]), n_modes=18)
    seen = (solid.visibility(sensors) > 0.3) & (np.arange(18) >= solid.n_rigid)
    solid_hz = solid.frequencies_hz[seen][:5]
    phi = element.bending_number(NU, 2 * HEIGHT, lap / n, 1.2)
    EI = E * BREADTH * (2 * HEIGHT) ** 3 / 12
    values = {"k1": 3 * EI / (lap / n) / (1 + phi), "k2": EI / (lap / n)}
    parameters = [Parameter(k, v) for k, v in values.items()]
    beams = [Beam(name, length, BREADTH, HEIGHT, 20, **STEEL) for name in ("a", "b")]
    chain = BeamStructure(beams, [GenericJoint("lap", lap, n, "k1", "k2")], parameters)
    apart = elastic_hz(chain, 5) / solid_hz - 1
    # The plane sections of the lap's ends carry more than the solid's corners do.
    assert np.all(apart > 0)
    assert np.max(apart) < 0.02
    found = update(chain, parameters, Target(solid_hz, 1e-3), values, regularisation=10.0)
    assert np.max(np.abs(found.prediction.frequencies_hz / solid_hz - 1)) < 0.01
    assert found.values[1] < values["k2"]


# -- damping ---------------------------------------------------------------------------------------


def damped_modes(structure, n=5, given=None):
    damping = structure.joint_damping()
    return solve_complex_modes(structure, given, damping=damping, n_modes=3 + n, gradients=True)


def test_damped_modes_are_those_of_the_state_matrix():
    structure = bolted_beams(c=40.0)  # heavy: 7 % in the first mode
    K, M, C = structure.stiffness(), structure.mass(), structure.damping_matrix()
    n = len(K)
    below = -np.linalg.solve(M, np.hstack([K, C]))
    A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), below])
    s = scipy.linalg.eigvals(A)
    s = s[s.imag > 100]
    s = s[np.argsort(np.abs(s))][:5]
    damped = damped_modes(structure)
    assert damped.damping_ratios.max() > 0.05
    np.testing.assert_allclose(damped.eigenvalues, s, rtol=1e-5)
    x = damped.shapes
    left = M @ x * damped.eigenvalues**2 + C @ x * damped.eigenvalues + K @ x
    assert np.abs(left).max() < 1e-6 * np.abs(K @ x).max()
    up, down = (damped_modes(structure, given={"c": c}) for c in (40.04, 39.96))
    slope = (up.damping_ratios - down.damping_ratios) / 0.08
    column = list(structure.parameters).index("c")
    np.testing.assert_allclose(damped.gradients()[1][:, column], slope, rtol=1e-4)


def test_damping_is_identified_and_said_to_come_from_the_curvature():
    structure = bolted_beams()
    truth = damped_modes(structure, given={"c": 0.12}).damping_ratios
    noisy = truth * (1 + 0.1 * np.random.default_rng(3).standard_normal(5))
    found = identify_damping(structure, ["c"], noisy, {"c": 5.0})
    assert abs(found.values[0] - 0.12) < 3 * found.sd[0]
    # As the noise says, but for what this draw of it leaves beyond that.
    left = np.log(noisy / truth) / 0.1
    widened = np.sqrt(max(1.0, np.sum((left - left.mean()) ** 2) / 4))
    assert found.sd[0] == pytest.approx(widened * 0.12 * 0.1 / np.sqrt(5), rel=0.3)
    exact = identify_damping(structure, ["c"], truth)
    assert exact.values[0] == pytest.approx(0.12, rel=1e-6)
    table = slip_table(structure, {"c": 0.12}, n_modes=5)
    np.testing.assert_allclose(table.ratios, truth, rtol=5e-3)
    # Jalali et al. 2019, Fig. 15: modes 2 and 3 bend the joint less than modes 1 and 4 do.
    assert max(table.curvature[[1, 2]]) < min(table.curvature[[0, 3]])


# -- bad input -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.stiffness({"k1": -5.0}), r"lap\.k1 = -5 .*k1 > 0"),
        (lambda s: s.stiffness({"k2": 0.0}), r"lap\.k2 = 0 .*k2 > 0"),
        (lambda s: s.mass({"nu": 0.6}), r"upper\.nu = 0\.6"),
        (lambda s: s.stiffness({"k3": 1.0}), "'k3' does not exist"),
        (lambda s: s.damping_matrix({"c": -1.0}), r"lap\.c = -1"),
        (lambda s: s.layout.rows((0.6, 0, 0), "sensor"), "outside the structure"),
        (lambda s: identify_damping(s, ["k1"], [0.01]), "is not the damping c"),
        (lambda s: identify_damping(s, ["c"], [0.01, -0.2]), "positive damping ratios"),
        (lambda s: GenericJoint("lap", 0.05, 5, [1.0, 2.0], 1.0), "expected one, or 5"),
        (lambda s: LumpedMass("m", 0.1, (0.1, 0, 0), range=(0.1, 0.0)), "two ascending numbers"),
        (
            lambda s: BeamStructure([s.beams[0]] * 2, s.joints, list(s.parameters.values())),
            "name of two beams",
        ),
        (lambda s: one_beam(10, held=[Held(0.033)]), "a node of the beams"),
        (lambda s: BeamStructure([Beam("b", 1.0, 0.1, 0.1, 2, "Ey", NU, RHO)]), "'Ey'"),
    ],
)
def test_bad_input_is_said(change, words):
    with pytest.raises(InputError, match=words):
        change(bolted_beams())


def test_a_mode_that_does_not_swing_is_said():
    with pytest.raises(ConvergenceError, match="overdamped"):
        damped_modes(bolted_beams(c=1e6), n=165)

"""Updating on frequencies and FRFs together: Machines 2022's equations, its proof, and noise."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from mpi4py import MPI
from scipy.stats import chi2
from unlike_meshes import two_parts

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements import FRFTarget, MeasuredFRFs, Target
from fenics_joints.meshes import dumbbell
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import frf_basis
from fenics_joints.response import solve_complex_modes, solve_frf
from fenics_joints.structure import (
    Damping,
    Parameter,
    Sensors,
    Structure,
    Support,
    interface,
    part,
    transition,
)
from fenics_joints.updating import Predictor, update, update_weighted
from fenics_joints.updating.equations import real_rows, weighted_equations
from fenics_joints.updating.residuals import Residuals

BODY = {"E": 1.3e11, "nu": 0.27, "rho": 7850.0}  # Machines 2022, section 4.2
TRUE = {"E": 1e10, "nu": 0.24, "h": 0.01}  # Table 6, row 1
START = {"E": 3.5e10, "nu": 0.27, "h": 0.02}  # row 2
NAMES, WANTED = list(TRUE), np.array(list(TRUE.values()))
LIMITS = {"E": (1e7, 1e13), "nu": (0.01, 0.49), "h": (1e-4, 0.2)}
JOINT = [Parameter(n, TRUE[n], lower=LIMITS[n][0], upper=LIMITS[n][1]) for n in NAMES]
ETA = Parameter("eta", 0.01, lower=1e-5, upper=1.0)
DAMPING = Damping(structural="eta")
LINES = np.linspace(300.0, 3000.0, 40)
F_SD, H_SD = 1e-3, 0.02


def sandwich(h0, comm=MPI.COMM_SELF):
    """Dumbbells whose layer is h0 thick in the mesh; all of one density, as the paper's model."""
    layer = transition("layer", "joint", E="E", nu="nu", h="h", meshed=h0, rho=BODY["rho"])
    bodies = part("bodies", ("head_1", "neck_1", "neck_2", "head_2"), **BODY)
    return Structure(dumbbell(comm, layer=h0, element_size=0.065), [bodies, layer], [*JOINT, ETA])


def places(h0):
    """Force, responses, and three directions at the heads' corners; those above move with h0."""
    top = 0.13 + h0
    points = np.array([[0.12, 0.09, -0.13], [-0.05, 0.02, top], [0.12, -0.09, top]])
    ways = np.array([[0.3, 0.5, 1.0], [0.4, 1.0, 0.3], [1.0, 0.5, 0.2]])
    corners = [(x, y, z) for z in (-0.13, top) for x in (-0.12, 0.12) for y in (-0.09, 0.09)]
    everywhere = Sensors(np.repeat(corners, 3, axis=0), np.tile(np.eye(3), (8, 1)))
    return Sensors(points[:1], ways[:1]), Sensors(points, ways), everywhere


@functools.cache
def test_data():
    """Six frequencies and shapes, and FRFs by a direct solution, of a mesh with the true layer."""
    model, (excitation, sensors, corners) = sandwich(TRUE["h"]), places(TRUE["h"])
    modes = solve_modes(model, n_modes=14, tolerance=1e-10)
    frf = solve_frf(
        model, frequencies_hz=LINES, excitation=excitation, sensors=sensors, damping=DAMPING
    )
    return modes.frequencies_hz[6:12], modes.at(corners)[:, 6:12], frf.values


test_data.__test__ = False


def target(h0=START["h"], rng=None, **more):
    """The data for a model meshed with h0, with noise from ``rng``."""
    f, shapes, H = test_data()
    if rng is not None:
        f = f * np.exp(F_SD * rng.standard_normal(f.shape))
        noise = rng.standard_normal((2, *H.shape))
        H = H * (1 + H_SD * (noise[0] + 1j * noise[1]))
    excitation, sensors, corners = places(h0)
    frfs = FRFTarget(LINES, H, sensors, excitation, relative_sd=H_SD)
    return Target(f, F_SD, shapes, corners, frfs=frfs, **more)


@functools.cache
def full():
    return sandwich(START["h"])


@functools.cache
def reduced():
    """A reduced model over a factor of ten in E and five in h, with none of the true values."""
    low, high, thin, thick = 3e9, 3e10, 5e-3, 2.5e-2
    corners = [(low, 0.1, thin), (high, 0.4, thin), (low, 0.4, thick), (high, 0.1, thick)]
    corners += [(low, 0.4, thin), (high, 0.4, thick)]
    excitation, sensors, seen = places(START["h"])
    model = frf_basis(
        full(),
        [dict(zip(NAMES, values, strict=True)) for values in corners],
        n_modes=14,
        frequencies_hz=LINES,
        excitation=excitation,
        sensors=sensors,
        tolerance=1e-7,
    )
    return model.arrays(excitation, sensors, seen)


def errors(found):
    """Relative errors of the three parameters."""
    return np.abs(found.values[:3] / WANTED - 1)


# --- the equations -------------------------------------------------------------------------------


def test_weights_are_those_of_the_paper():
    """Eqs. 18 to 20 by hand; W_p changes the condition number and not the answer."""
    A = np.array([[2.0, -1e3], [4.0, 3e3], [1e-6, 2e-4], [-3e-6, 1e-4]])
    b = np.array([3.0, -5.0, 2e-6, 1e-6])
    w_f, w_H = np.array([2.0, 0.5]), 0.25
    found = weighted_equations(A, b, w_f=w_f, w_H=w_H, n_frequencies=2)
    left = [2 / 1002, 0.5 / 3004, 0.25 / 2.01e-4, 0.25 / 1.03e-4]
    columns = [1 / (2 + 4 + 1e-6 + 3e-6), 1 / (1e3 + 3e3 + 2e-4 + 1e-4)]
    assert found.left == pytest.approx(left, rel=1e-12)
    assert found.columns == pytest.approx(columns, rel=1e-12)
    whole = np.diag(left) @ A @ np.diag(columns)
    assert found.matrix == pytest.approx(whole, rel=1e-12)
    assert found.right == pytest.approx(np.array(left) * b)
    assert found.condition_before == pytest.approx(np.linalg.cond(A))
    assert found.condition_after == pytest.approx(np.linalg.cond(whole))
    assert found.condition_after < 0.05 * found.condition_before
    squares = np.diag(np.square(left))
    normal = np.linalg.solve(A.T @ squares @ A, A.T @ squares @ b)
    assert found.solve() == pytest.approx(normal, rel=1e-9)
    assert found.inverse() @ b == pytest.approx(normal, rel=1e-9)
    with pytest.raises(InputError, match="column 1 of A is zero"):
        weighted_equations(A * [1, 0], b, n_frequencies=2)


def test_what_the_weighted_equations_leave_open_is_not_known():
    """One frequency for E and h: their least-norm solution hardly moves with noise, yet the
    standard deviations are large, in the direction that the frequency does not see alone."""
    f, shapes, _ = test_data()
    few = Target(f, F_SD, shapes, places(START["h"])[2]).without_modes(range(1, 6))
    found = update_weighted(reduced(), [JOINT[0], JOINT[2]], few, {**TRUE, "E": 1.05 * TRUE["E"]})
    assert found.converged and found.relative_sd.min() > 100
    slopes = found.prediction.frequency_slopes
    sd = np.sqrt(np.einsum("mi,ij,mj->m", slopes, found.covariance, slopes))
    assert sd[0] == pytest.approx(F_SD, rel=0.1) and sd[1] > 1.0


def test_weighted_steps_that_become_nothing_are_told():
    """One parameter cannot do what three did: no 50 iterations to say so."""
    start = {**TRUE, "h": 1.2 * TRUE["h"]}
    with pytest.raises(ConvergenceError, match="steps became zero"):
        update_weighted(reduced(), JOINT[:1], target().only("frequencies"), start)


def test_complex_rows():
    """Both ways are the slope of what they compare."""
    rng = np.random.default_rng(1)
    numbers = rng.standard_normal((5, 4)) + 1j * rng.standard_normal((5, 4))
    slopes, H, other, step = numbers[:, :2], numbers[:, 2], numbers[:, 3], np.array([2e-6, -1e-6])
    moved = H + slopes @ step
    rows, right = real_rows(slopes, other, H, "magnitude")
    assert rows @ step == pytest.approx(np.abs(moved) - np.abs(H), rel=1e-4)
    assert right == pytest.approx(np.abs(other) - np.abs(H))
    rows, right = real_rows(slopes, other, H)
    assert rows @ step == pytest.approx(np.concatenate([(moved - H).real, (moved - H).imag]))
    assert right == pytest.approx(np.concatenate([(other - H).real, (other - H).imag]))


# --- derivatives ---------------------------------------------------------------------------------


def all_kinds():
    """A target with every kind of data, one frequency and some of a shape missing."""
    excitation, sensors, corners = places(START["h"])
    f, shapes, H = test_data()
    f, shapes = f.copy(), shapes.copy()
    f[3], shapes[:4, 1] = np.nan, np.nan
    zeta = np.array([0.004, 0.006, 0.005, np.nan, 0.005, 0.004])
    frfs = FRFTarget(LINES, H, sensors, excitation, "mobility")
    return Target(f, F_SD, shapes, corners, 0.02, zeta, 0.1, frfs)


@pytest.mark.parametrize("kind", ["full", "reduced"])
@pytest.mark.parametrize("moved", [False, True])
def test_slopes_of_all_residuals(kind, moved):
    """Beside central differences: frequencies, shapes, damping ratios, FRFs at fixed and moved
    lines. By modes of a full model an FRF's slope has an error of its own; on a basis it has not.
    """
    model, data = {"full": full, "reduced": reduced}[kind](), all_kinds()
    if kind == "reduced":
        data = data.only("frequencies", "shapes", "frfs")
    names = [*NAMES, "eta"]
    predict, residuals = Predictor(model, data, names, damping=DAMPING), Residuals(data)
    at = {"E": 1.4e10, "nu": 0.26, "h": 0.012, "eta": 0.013}
    slopes, n_frf = residuals.slopes(predict(at, moved)), 2 * LINES.size * 3
    for i, name in enumerate(names):
        step = 1e-4 * at[name]
        up, down = (
            residuals.values(predict({**at, name: at[name] + s}, moved)) for s in (step, -step)
        )
        off, size = np.abs((up - down) / (2 * step) - slopes[:, i]), np.abs(slopes[:, i]).max()
        assert off[:-n_frf].max() < 1e-5 * size, name
        assert off[-n_frf:].max() < (1e-2 if kind == "full" else 1e-4) * size, name


# --- the proof of section 4.2 --------------------------------------------------------------------


def test_frequencies_and_frfs_find_the_sandwich():
    """From Table 6's start to its true values, on another mesh and by another FRF solution."""
    found = update(full(), [*JOINT, ETA], target(), {**START, "eta": 0.02}, damping=DAMPING)
    assert errors(found).max() < 1e-4
    assert found.values[3] == pytest.approx(0.01, rel=1e-4)
    assert found.history[0].condition_before > 1e10 * found.history[0].condition_after
    limited = update_weighted(reduced(), JOINT, target(), START, damping=DAMPING, step_limit=0.5)
    assert errors(limited).max() < 5e-3
    values = np.array([it.values for it in limited.history])
    assert np.abs(values[1:] / values[:-1] - 1).max() <= 0.5 + 1e-12


def test_frequencies_alone_say_that_they_cannot():
    """Noise of 0.1 % leaves E and h open by more than 0.5 %, of which the covariance knows."""
    only = target().only("frequencies")
    found = update(reduced(), JOINT, only, START)
    assert errors(found).max() < 5e-3  # without noise they do
    assert found.relative_sd[[0, 2]].min() > 0.03
    assert found.identifiability.collinearity > 20
    off = []
    for seed in range(12):
        noisy = target(rng=np.random.default_rng(seed)).only("frequencies")
        off.append(np.log(update(reduced(), JOINT, noisy, START).values / WANTED))
    scatter = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all(scatter[[0, 2]] > 0.02)
    assert scatter == pytest.approx(found.relative_sd, rel=0.6)


@pytest.mark.parametrize("moves", ["first", "always"])
def test_noise_stays_within_the_stated_deviations(moves):
    """(x - x_true)^T C^-1 (x - x_true) over draws of the noise is chi-squared."""
    squares, count = 0.0, 24 if moves == "first" else 12
    for seed in range(count):
        noisy = target(rng=np.random.default_rng(100 + seed))
        found = update(reduced(), JOINT, noisy, START, damping=DAMPING, moves=moves)
        off = found.values - WANTED
        squares += off @ np.linalg.solve(found.covariance, off)
        assert np.all(np.abs(off) < 4.5 * found.sd)
    low, high = chi2.ppf([0.001, 0.999], 3 * count)
    assert low < squares < high
    if moves == "first":
        assert found.relative_sd.max() < 5e-3


def test_far_starts():
    """Where the paper's iteration leaves the law's range and unmoved lines mislead."""
    far = {"E": 1.02e9, "nu": 0.37, "h": 0.028}
    found = update(reduced(), JOINT, target(), far, damping=DAMPING)
    assert errors(found).max() < 5e-3
    with pytest.raises(ConvergenceError, match="weighted equations: diverged"):
        update_weighted(reduced(), JOINT, target(), far, damping=DAMPING)
    stuck = update(reduced(), JOINT, target(), far, damping=DAMPING, moves="never", strict=False)
    assert errors(stuck).max() > 0.1
    assert "differ by" in stuck.message


def test_damping_of_the_layer():
    """Its loss factor from damping ratios of complex modes, beside frequencies."""
    damping, true = Damping(structural=0.002, hysteretic={"layer": "eta"}), {"eta": 0.07}
    exact = solve_complex_modes(full(), {**TRUE, **true}, damping=damping, n_modes=16)
    f, _, _ = test_data()
    data = Target(f, F_SD, damping_ratios=exact.damping_ratios[:6], damping_log_sd=0.02)
    found = update(full(), [ETA], data, {**TRUE, "eta": 0.05}, damping=damping)
    assert found.values == pytest.approx([0.07], rel=1e-6)


@pytest.mark.parallel
def test_two_ranks_agree():
    data, near = target().only("frequencies", "frfs"), {n: 1.02 * v for n, v in TRUE.items()}
    found = [
        update(sandwich(START["h"], comm), JOINT, data, near, damping=DAMPING, moves="always")
        for comm in (MPI.COMM_SELF, MPI.COMM_WORLD)
    ]
    assert found[1].values == pytest.approx(found[0].values, rel=1e-6)
    assert found[1].sd == pytest.approx(found[0].sd, rel=1e-4)


# --- data ----------------------------------------------------------------------------------------


def test_target_of_measured_frfs():
    excitation, sensors, _ = places(0.01)
    _, _, H = test_data()
    coherence = np.full(H.shape, 0.9)
    coherence[:, 1] = 1.0
    where = sensors.points, sensors.directions, excitation.points, excitation.directions
    measured = MeasuredFRFs(LINES, H, "receptance", *where, coherence=coherence)
    made = FRFTarget.from_measured(measured, [3, 7, 9], measured.stated_sd(None, averages=10))
    assert made.frequencies_hz == pytest.approx(LINES[[3, 7, 9]])
    assert made.values == pytest.approx(H[[3, 7, 9]])
    # Bendat and Piersol: sqrt((1 - 0.9) / (2 * 0.9 * 10)); never below 0.1 %.
    assert made.relative_sd[:, 0] == pytest.approx(np.sqrt(0.1 / 18))
    assert made.relative_sd[:, 1] == pytest.approx(1e-3)


def test_bad_input_is_named():
    f, shapes, H = test_data()
    excitation, sensors, corners = places(0.01)

    def weighted(parameters, data, start=START):
        return update_weighted(reduced(), parameters, data, start)

    lossy, eta = [*JOINT, ETA], {**START, "eta": 0.01}
    for make, message in (
        (lambda: Target(), "expected data"),
        (lambda: Target(-f), "frequencies_hz"),
        (lambda: Target(f, 0.0), "log_sd"),
        (lambda: Target(f, shapes=shapes), "shape_sensors is missing"),
        (lambda: Target(f, shapes=shapes[1:], shape_sensors=corners), "24 x 6"),
        (lambda: FRFTarget(LINES, H[1:], sensors, excitation), r"expected \(40, 3, 1\)"),
        (lambda: FRFTarget(LINES, H, sensors, excitation, "dynamic"), "kind"),
        (lambda: FRFTarget(LINES, H, sensors, excitation, relative_sd=[1, 2]), "relative_sd"),
        (lambda: target().only("damping"), "damping"),
        (lambda: update(reduced(), JOINT, target(), START, moves="often"), "moves"),
        (lambda: update(reduced(), [], target(), START), "at least one"),
        (lambda: update(reduced(), JOINT, target(), {"E": 1e9}), "start of nu"),
        (lambda: update(reduced(), [Parameter("x", 1.0)], target(), {"x": 1.0}), "not the model's"),
        (lambda: weighted(JOINT, target(shape_sd=0.1)), "data 'shapes'"),
        (
            lambda: weighted(lossy, target().only("frequencies"), eta),
            "parameters eta: expected some that change",
        ),
    ):
        with pytest.raises(InputError, match=message):
            make()


def test_a_mode_that_the_sensors_do_not_see_is_named():
    """A strip glued end to end bends across the sensors' direction, too: that shape is noise, which
    any mode resembles more than its own."""
    blocks = [
        ([0, 0, 0], [0.12, 0.03, 0.008], (6, 2, 1)),
        ([0.12, 0, 0], [0.3, 0.03, 0.008], (9, 2, 1)),
    ]
    tagged = two_parts("hexahedron", blocks, faces=[("wall", 0, 0.0)])
    joint = interface("glue", "joint", k_n="k_n", k_t=2e12, meshed=1e-4, normal=(1.0, 0.0, 0.0))
    alloy = {"nu": 0.33, "rho": 2700}
    own = [Parameter("E", 70e9, "Pa", 1e10, 3e11), Parameter("k_n", 1e13, "Pa/m", 1e9, 1e15)]
    regions = [part("low", "low", E=70e9, **alloy), part("high", "high", E="E", **alloy), joint]
    model = Structure(tagged, regions, own, supports=[Support("wall")])
    x = np.linspace(0.02, 0.3, 8)
    across = Sensors(np.array([x, 0 * x + [0.0, 0.03] * 4, 0 * x + 0.008]).T, [0, 0, 1])
    modes, rng = (
        solve_modes(model, {"E": 63e9, "k_n": 1.5e12}, n_modes=6),
        np.random.default_rng(48),
    )
    assert modes.visibility(across)[1] < 1e-3
    hz = modes.frequencies_hz * (1 + 1e-3 * rng.standard_normal(6))
    shapes = modes.at(across) * (1 + 1e-3 * rng.standard_normal((8, 6)))
    target = Target(hz, 1e-3, shapes, across, shape_sd=1e-3)
    with pytest.raises(ConvergenceError, match=r"no mode of the model matches mode 2 \("):
        update(model, own, target, model.values())

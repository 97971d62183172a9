"""Adjoint derivatives of a preload against states solved anew at other values."""

from __future__ import annotations

import numpy as np
import pytest
from contact_blocks import COMM, pair, pressed

from fenics_joints.errors import InputError
from fenics_joints.meshes import stacked_blocks
from fenics_joints.preload import OPEN, SLIP, STICK, PreloadSolver, Traction, WasherForce
from fenics_joints.preload.adjoint import PreloadAdjoint
from fenics_joints.structure import Parameter

pytestmark = pytest.mark.parallel

PARAMETERS = [
    Parameter("E", 70e9),
    Parameter("nu", 0.3),
    Parameter("t", 1.0),
    Parameter("rho", 7800.0),
]


#: A soft body of parameters on a stiff one: the mismatch makes the interface slip.
SOFT = {"E": "E", "nu": "nu", "rho": "rho", "stretch": "t"}


def plates(friction=0.3, push=(-25e3, 25e3)):
    """Half section of two discs, pressed near the hole; they part further out."""
    r = np.concatenate([np.linspace(7e-3, 12e-3, 4), np.linspace(12e-3, 40e-3, 10)[1:]])
    z = np.linspace(0.0, 15e-3, 5)
    tagged = stacked_blocks(COMM, lower=(r, -z[::-1]), upper=z)

    def ring(x):
        return (x[:, 0] <= 12e-3 + 1e-9) * 1.0

    loads = [
        Traction("top", "top", (0.0, push[0]), ring),
        Traction("bottom", "bottom", (0.0, push[1]), ring),
    ]
    bodies = {"parts": pair({}, SOFT | {"normal": (0.0, 1.0, 0.0)}), "parameters": PARAMETERS}
    return pressed(tagged, loads, held=(), axisymmetric=True, friction=friction, **bodies)


def blocks(friction=0.2):
    """A soft block pressed unevenly on a stiff one and pushed sideways, in space."""
    x, y, z = (np.linspace(0.0, a, n + 1) for a, n in ((0.06, 5), (0.05, 4), (0.01, 2)))
    tagged = stacked_blocks(COMM, lower=(x, y, -z[::-1]), upper=z)

    def uneven(x):
        return np.exp(-((x[:, 0] - 0.025) ** 2 + (x[:, 1] - 0.021) ** 2) / 0.009**2)

    loads = [
        Traction("down", "top", (0.0, 0.0, -9e3), uneven),
        Traction("side", "top", (700.0, 300.0, 0.0)),
    ]
    parts = pair({}, SOFT)
    return pressed(tagged, loads, parts=parts, parameters=PARAMETERS, friction=friction)


STEPS = (1e-3, 5e-4)
MODELS = {"plates": plates, "blocks": blocks}


def options(method):
    return {"method": method, "penalty": 4e12 if method == "penalty" else None}


def solve_at(result, build, name, value):
    """The state with one quantity at another value, by its own route: a new solution."""
    if name in result.forces:
        return result.solver.solve({name: value})
    model = build(friction=value) if name == "friction" else result.model
    given = {} if name == "friction" else {name: value}
    return PreloadSolver(model, given, **options(result.solver.method)).solve()


def weights(state):
    """Weights without symmetry, so that no error cancels."""
    return np.cos(1 + np.arange(len(state.interface)))


def pressure_gradient(result, given):
    with PreloadAdjoint(result) as adjoint:
        return adjoint.pressure("c", given)


@pytest.mark.parametrize("method", ["semismooth", "penalty"])
@pytest.mark.parametrize("where", list(MODELS))
def test_taylor_remainder_is_of_second_order(where, method):
    build = MODELS[where]
    result = PreloadSolver(build(), **options(method)).solve()
    state = result["c"]
    # All three kinds are there, or the test would not see their equations.
    assert {OPEN, SLIP, STICK} == set(state.status)
    adjoint = PreloadAdjoint(result)
    limit = 0.3 * state.pressure.max()
    pressure, area = adjoint.pressure("c", weights(state)), adjoint.area("c", limit)
    adjoint.destroy()
    assert pressure.value == pytest.approx(weights(state) @ state.pressure)
    assert area.value == pytest.approx(state.area_above(limit))
    loads = {name: 1.0 for name in result.forces}
    nominal = {"friction": result.model.contacts[0].friction, "E": 70e9, "nu": 0.3, "t": 1.0}
    for name, base in (nominal | loads).items():
        states = [solve_at(result, build, name, base * (1 + h))["c"] for h in STEPS]
        assert all(np.array_equal(s.status, state.status) for s in states), name
        measured = [
            (pressure, [weights(s) @ s.pressure for s in states], state.pressure.max()),
            (area, [s.area_above(limit) for s in states], area.value),
        ]
        for gradient, values, size in measured:
            slope = base * by(gradient, name)
            left = [v - gradient.value - h * slope for v, h in zip(values, STEPS, strict=True)]
            assert abs(slope) > 1e-4 * size, name
            # Where the quantity is linear, as in most loads, only round-off is left.
            small = 1e-10 * size
            assert abs(left[1]) < small or left[0] / left[1] == pytest.approx(4.0, rel=0.05), name


def by(gradient, name):
    if name == "friction":
        return gradient.friction["c"]
    return {**gradient.forces, **gradient.parameters}[name]


def test_receding_contact_grows_with_the_force():
    """Without a gap the state is homogeneous in the loads and the moduli, so P grows as F."""
    result = PreloadSolver(plates()).solve()
    state = result["c"]
    adjoint = PreloadAdjoint(result)
    pressure = adjoint.pressure("c", weights(state))
    assert sum(pressure.forces.values()) == pytest.approx(pressure.value, rel=1e-9)
    limit = 0.3 * state.pressure.max()
    # The area above a limit depends on the limit over the force alone.
    area = adjoint.area("c", limit)
    above, below = (state.area_above(limit * (1 + h)) for h in (1e-6, -1e-6))
    assert sum(area.forces.values()) == pytest.approx((below - above) / 2e-6, rel=1e-6)
    force = adjoint.force("c")
    adjoint.destroy()
    # Equilibrium, whatever the bodies are: half of each load presses, by inertia relief.
    assert force.value == pytest.approx(25e3, rel=1e-9)
    assert force.friction["c"] == pytest.approx(0.0, abs=1e-6)
    assert abs(force.parameters["E"]) * 70e9 < 1e-6 * force.value


def test_inertia_that_balances_the_loads():
    """Unequal loads: what the inertia takes varies with the mass of a part."""

    def state(rho):
        return PreloadSolver(plates(push=(-25e3, 24e3)), {"rho": rho}).solve()

    result = state(7800.0)
    gradient = pressure_gradient(result, weights(result["c"]))
    values = [weights(s["c"]) @ s["c"].pressure for s in (state(7800 * 1.001), state(7800 * 0.999))]
    difference = (values[0] - values[1]) / (0.002 * 7800)
    assert gradient.parameters["rho"] == pytest.approx(difference, rel=1e-5)
    assert abs(difference) * 7800 > 1e-3 * result["c"].pressure.max()


def test_friction_without_a_limit_and_history():
    """No derivative by an infinite coefficient; the slips of the step before stay as they are."""
    result = PreloadSolver(plates(friction=np.inf)).solve()
    assert pressure_gradient(result, weights(result["c"])).friction == {}
    solver = PreloadSolver(plates())
    before = solver.solve()
    step = {"top": 0.6, "bottom": 0.6}
    result = solver.solve(step, initial=before)
    gradient = pressure_gradient(result, weights(result["c"]))
    other = solver.solve({name: 0.6 * (1 + 1e-4) for name in step}, initial=before)
    assert np.array_equal(other["c"].status, result["c"].status)
    change = weights(other["c"]) @ other["c"].pressure - gradient.value
    assert change == pytest.approx(0.6e-4 * sum(gradient.forces.values()), rel=1e-6)


def test_bolts_force_in_a_pressed_stack():
    """Under a bolt spread over the whole faces the mean pressure is force over area."""
    line = np.linspace(0.0, 1.0, 4)
    tagged = stacked_blocks(COMM, lower=(line, line - 1.0), upper=line)
    bolts = [WasherForce("bolt", "bottom", "top", 1e5)]
    result = PreloadSolver(pressed(tagged, held=(), bolts=bolts, degree=2)).solve()
    gradient = pressure_gradient(result, np.full(4, 0.25))
    assert gradient.forces == pytest.approx({"bolt": 1.0})
    assert gradient.parameters == {}


def test_refusals():
    result = PreloadSolver(plates()).solve()
    with PreloadAdjoint(result) as adjoint:
        with pytest.raises(InputError, match="weights of shape"):
            adjoint.pressure("c", np.ones(3))
        with pytest.raises(InputError, match="limit"):
            adjoint.area("c", 0.0)
        with pytest.raises(InputError, match="no contact 'd'"):
            adjoint.area("d", 1e6)
    with pytest.raises(InputError, match="no contact 'd' that can open"):
        result["d"]
    result.solver.destroy()
    with pytest.raises(InputError, match="destroyed"):
        PreloadAdjoint(result)

"""Fits that one trust region does not finish: wrong models, open directions, modes that swap."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements import Target
from fenics_joints.reduction.affine import AffinePencil, spring_term
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.structure import Parameter, Sensors
from fenics_joints.updating import update

N = 5
SENSORS = Sensors(np.column_stack([np.arange(N), np.zeros(N), np.zeros(N)]), [1.0, 0.0, 0.0])
PULL = 2.3


def springs() -> dict[str, np.ndarray]:
    """Rows of a chain of unit masses, held at its first; three parameters share its springs."""
    unit = np.eye(N)
    return {"a": unit[0], "b": unit[1] - unit[2], "c": unit[3] - unit[4]}


FIXED = sum(np.outer(r, r) for r in (np.eye(N)[0] - np.eye(N)[1], np.eye(N)[2] - np.eye(N)[3]))


def chain(rows: dict[str, np.ndarray], fixed=FIXED) -> ArrayModel:
    parameters = {name: Parameter(name, 1.0, lower=1e-4, upper=1e8) for name in rows}
    terms = [spring_term(name, name, 1.0, row) for name, row in rows.items()]
    pencil = AffinePencil(parameters, [], terms, fixed=(fixed, np.eye(N)), fixed_mass=N)
    return ArrayModel(pencil, 1e-6, np.eye(N), np.zeros((1, N, N)))


def modes(rows, values, fixed=FIXED):
    """Frequencies, Hz, and shapes, by another route."""
    K = fixed + sum(values[n] * np.outer(row, row) for n, row in rows.items())
    lam, X = np.linalg.eigh(K)
    return np.sqrt(lam) / (2 * np.pi), X


def fitted(rows, target, start, **more):
    model = chain(rows)
    return update(model, list(model.parameters.values()), target, start, **more)


def test_a_wrong_model_is_fitted_to_what_it_can():
    """A spring that the model has not: the fit ends where no other search finds more density, and
    its widths are the root mean squares of what is left."""
    rows = springs()
    hidden = FIXED + 0.8 * np.outer(np.eye(N)[1] - np.eye(N)[4], np.eye(N)[1] - np.eye(N)[4])
    f, X = modes(rows, {"a": 3.0, "b": 0.2, "c": 1.5}, hidden)
    target = Target(f[:4], 1e-3, X[:, :4], SENSORS, shape_sd=0.01)
    start = {"a": 1.0, "b": 1.0, "c": 1.0}
    found = fitted(rows, target, start, regularisation=PULL)
    assert found.converged and "in rounds" in found.message
    widths = found.widths
    assert min(widths.shapes) > 3 and widths.frequencies == pytest.approx(10.0)  # 1 % at most

    def density(x):
        values = dict(zip(rows, np.exp(x), strict=True))
        hz, shapes = modes(rows, values)
        match = (X[:, :4].T @ shapes) ** 2
        total = np.sum((x / PULL) ** 2)
        for i, width in enumerate(widths.shapes):
            if i in widths.without:
                continue
            j = int(np.argmax(match[i]))
            total += (np.log(hz[j] / f[i]) / 1e-2) ** 2
            # Of a shape of root mean square 1, what another's nearest multiple leaves is its sine.
            total += N * (1 - match[i, j]) / (0.01 * width) ** 2
        return 0.5 * total

    best = minimize(
        density, np.log(found.values), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8}
    )
    assert density(np.log(found.values)) < best.fun + 0.05


def test_an_open_direction_is_held_and_named():
    """Two springs side by side: their sum is known, their ratio stays that of the start."""
    rows = springs()
    twice = {**rows, "a2": rows["a"]}
    f, X = modes(rows, {"a": 3.0, "b": 0.2, "c": 1.5})
    target = Target(f, 1e-3, X, SENSORS)
    start = {"a": 1.0, "a2": 1.0, "b": 1.0, "c": 1.0}
    for pull in (None, PULL):
        found = fitted(twice, target, start, regularisation=pull)
        assert found.converged
        values = found.mapping()
        assert values["a"] + values["a2"] == pytest.approx(3.0, rel=2e-3)
        assert values["b"] == pytest.approx(0.2, rel=2e-3)
        assert values["a"] / values["a2"] == pytest.approx(1.0, rel=1e-3)
        assert found.identifiability.undetermined == ("a", "a2")


def test_too_few_evaluations_give_the_best_so_far():
    rows = springs()
    f, X = modes(rows, {"a": 30.0, "b": 0.02, "c": 15.0})
    target, start = Target(f, 1e-3, X, SENSORS), {"a": 1.0, "b": 1.0, "c": 1.0}
    few = fitted(rows, target, start, max_evaluations=4, strict=False)
    assert not few.converged and few.message.startswith("not converged: out of evaluations")
    assert few.chi2 < 2 * few.history[0].cost and np.isfinite(few.relative_sd).all()
    with pytest.raises(ConvergenceError, match="did not converge in 4 evaluations"):
        fitted(rows, target, start, max_evaluations=4)


@pytest.mark.parametrize("coupling", [0.0, 1e-3, 0.05])
def test_modes_that_swap_are_followed(coupling):
    """Oscillators whose order at the start is the reverse of the test's, coupled or not."""
    unit = np.eye(N)
    rows = {f"k{i}": unit[i] for i in range(N)}
    links = [unit[i] - unit[i + 1] for i in range(N - 1)]
    fixed = coupling * sum(np.outer(link, link) for link in links)
    true = dict(zip(rows, (1.0, 2.0, 3.0, 4.0, 5.0), strict=True))
    f, X = modes(rows, true, fixed)
    model = chain(rows, fixed)
    start = dict(zip(rows, (5.0, 4.1, 3.0, 2.1, 1.0), strict=True))
    found = update(model, list(model.parameters.values()), Target(f, 1e-3, X, SENSORS), start)
    assert found.converged
    assert found.values == pytest.approx(list(true.values()), rel=1e-4)


def test_a_step_into_what_the_model_refuses_is_shortened():
    """A law that ends at a third of the answer; from far above the first step goes beyond."""
    rows = {"a": 0.01 * np.eye(N)[0]}
    fixed = FIXED + sum(np.outer(row, row) for name, row in springs().items() if name != "a")
    f, X = modes(rows, {"a": 3e3}, fixed)
    model = chain(rows, fixed)
    stiffness, refused = model.stiffness, []

    def limited(given=None):
        if (given or {}).get("a", 1.0) < 1e3:
            refused.append(given)
            raise InputError("a is out of range")
        return stiffness(given)

    model.stiffness = limited
    low = Target(f[:1], 1e-3, X[:, :1], SENSORS)
    found = update(model, list(model.parameters.values()), low, {"a": 3e5})
    assert found.converged and found.values == pytest.approx([3e3], rel=1e-3)
    assert refused

"""Random stiffnesses: the expansion against its closed form, samples against sensitivities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from fenics_joints.beams import Beam, BeamStructure, GenericJoint
from fenics_joints.errors import InputError
from fenics_joints.random_fields import (
    FieldMap,
    RandomField,
    karhunen_loeve,
    propagate_samples,
    propagate_sensitivities,
)
from fenics_joints.random_fields.fields import covariance, one_variable
from fenics_joints.reduction import ModalPrediction
from fenics_joints.structure import Parameter

N = 5
PLACES = (np.arange(N) + 0.5) * 0.01
K1, K2 = ([f"{key}[{i}]" for i in range(N)] for key in ("k1", "k2"))


def both(*more) -> list[RandomField]:
    """Fields of k1 and of k2."""
    return [RandomField(tuple(names), *more) for names in (K1, K2)]


def forward_of(each: bool) -> ModalPrediction:
    """Five frequencies of two steel beams, of a joint in five elements or with one k1 and k2."""
    k1, k2 = (K1, K2) if each else ("k1", "k2")
    values = dict.fromkeys(K1, 1763.2) | dict.fromkeys(K2, 37402.0)
    if not each:
        values = {"k1": 1763.2, "k2": 37402.0}
    steel = {"E": 208e9, "nu": 0.3, "rho": 7860.0}
    beams = [Beam(n, length, 0.021, 0.0106, 8, **steel) for n, length in (("a", 0.36), ("b", 0.26))]
    lap = GenericJoint("lap", 0.05, N, k1, k2)
    structure = BeamStructure(beams, [lap], [Parameter(k, v) for k, v in values.items()])
    return ModalPrediction(structure.arrays(), None, 5, 9)


def test_expansion_has_the_closed_forms_eigenvalues():
    """exp(-|x - y| / l) on (-a, a): Ghanem and Spanos, Stochastic Finite Elements, 1991, 2.3.3."""
    a, length, n = 0.025, 0.02, 400
    points = (np.arange(n) + 0.5) / n * 2 * a - a
    found = karhunen_loeve(points, length, weights=np.full(n, 2 * a / n), n_terms=4)
    c, exact = 1 / length, []
    for i in range(4):
        low, high = (i * np.pi / 2 + 1e-9) / a, ((i + 1) * np.pi / 2 - 1e-9) / a

        def odd_or_even(w, i=i):
            return c - w * np.tan(w * a) if i % 2 == 0 else w + c * np.tan(w * a)

        exact.append(2 * c / (brentq(odd_or_even, low, high) ** 2 + c**2))
    np.testing.assert_allclose(found.eigenvalues, exact, rtol=2e-3)
    assert found.share == pytest.approx(np.sum(exact) / (2 * a), rel=2e-3)


@pytest.mark.parametrize("kind", ["exponential", "squared_exponential"])
def test_all_terms_give_the_covariance_back(kind):
    weights = np.linspace(1, 2, N)
    whole = karhunen_loeve(PLACES, 0.015, kind, weights=weights, n_terms=N)
    C = covariance(PLACES, 0.015, kind)
    np.testing.assert_allclose(whole.factors @ whole.factors.T, C, atol=1e-12)
    np.testing.assert_allclose(whole.modes.T * weights @ whole.modes, np.eye(N), atol=1e-12)
    distance = 0.01 / 0.015
    expected = np.exp(-distance) if kind == "exponential" else np.exp(-0.5 * distance**2)
    assert C[0, 1] == pytest.approx(expected)
    # A long field is one variable.
    long = karhunen_loeve(PLACES, 1e5, kind)
    assert long.factors.shape == (N, 1)
    np.testing.assert_allclose(long.factors, one_variable(N).factors, rtol=1e-3)


def test_one_variable_of_the_joint_is_its_long_field():
    whole, each = forward_of(False), forward_of(True)
    fields = [RandomField(("k1",), 0.05), RandomField(("k2",), 0.05)]
    a = propagate_sensitivities(whole, fields, whole.model.values())
    b = propagate_sensitivities(each, both(0.05), each.model.values())
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-6)
    # A field that varies along the lap averages out.
    short = both(0.05, karhunen_loeve(PLACES, 0.01, n_terms=N))
    c = propagate_sensitivities(each, short, each.model.values())
    assert np.all(c.sd < 0.9 * a.sd)


@pytest.mark.parametrize("distribution", ["normal", "lognormal"])
def test_samples_agree_with_sensitivities(distribution):
    forward, n, eps = forward_of(True), 500, 0.08
    fields = both(eps, karhunen_loeve(PLACES, 0.03), distribution)
    start, correlation = forward.model.values(), [[1.0, 0.6], [0.6, 1.0]]
    drawn = propagate_samples(forward, fields, start, n, seed=2, correlation=correlation)
    first, second = (
        propagate_sensitivities(forward, fields, start, order=o, correlation=correlation)
        for o in (1, 2)
    )
    np.testing.assert_allclose(drawn.sd, second.sd, rtol=4 / np.sqrt(2 * n))
    np.testing.assert_allclose(drawn.correlation, second.correlation, atol=0.05)
    # What is linear in the parameters has mean zero: without it the samples' mean is sharp.
    names = list(forward.model.parameters)
    columns = [names.index(name) for name in drawn.names]
    means = np.array([start[name] for name in drawn.names])
    log_f, slopes = forward(start)
    rest = drawn.samples - np.exp(log_f) * ((drawn.parameters - means) @ slopes[:, columns].T)
    error = rest.std(axis=0) / np.sqrt(n)
    assert np.all(np.abs(rest.mean(axis=0) - second.mean) < 0.1 * drawn.sd * eps + 4 * error)
    # A frequency is concave in stiffness: its mean is below that at the mean, by more than chance.
    assert np.all(rest.mean(axis=0) < np.exp(log_f) - 4 * error)
    if distribution == "normal":
        np.testing.assert_allclose(first.mean, np.exp(log_f))
    # Means, spread and correlation of the parameters themselves.
    np.testing.assert_allclose(drawn.parameters.mean(axis=0) / means, 1.0, atol=4 * eps / n**0.5)
    np.testing.assert_allclose(drawn.parameters.std(axis=0) / means, eps, rtol=0.15)
    k1, k2 = np.split(drawn.parameters, 2, axis=1)
    between = np.corrcoef(k1.mean(axis=1), k2.mean(axis=1))[0, 1]
    assert between == pytest.approx(0.6, abs=0.1)


def test_derivatives_by_the_variables():
    fields = FieldMap(
        [
            RandomField(tuple(K1), 0.1, karhunen_loeve(PLACES, 0.02), "lognormal"),
            RandomField(("k",), 0.2),
        ],
        dict.fromkeys([*K1, "k"], 3.0),
        [[1.0, -0.4], [-0.4, 1.0]],
    )
    xi = np.random.default_rng(0).standard_normal(fields.n_variables)
    _, slopes = fields.values(xi)
    for j, step in enumerate(1e-6 * np.eye(len(xi))):
        up, down = (fields.values(xi + s)[0] for s in (step, -step))
        slope = [(up[name] - down[name]) / 2e-6 for name in fields.names]
        np.testing.assert_allclose(slopes[:, j], slope, rtol=1e-6, atol=1e-8)


def test_fields_of_unequal_length_keep_their_correlations():
    sets = {"a": K1, "b": K2, "c": ["k"]}
    fields = [
        RandomField(tuple(sets["a"]), 0.1, karhunen_loeve(PLACES, 0.02, n_terms=4)),
        RandomField(("k",), 0.2),
        RandomField(tuple(sets["b"]), 0.1, karhunen_loeve(PLACES, 0.02, n_terms=3)),
    ]
    R = np.array([[1.0, 0.5, -0.6], [0.5, 1.0, 0.2], [-0.6, 0.2, 1.0]])
    found = FieldMap(fields, dict.fromkeys([*K1, *K2, "k"], 1.0), R)
    covariance = found.root @ found.root.T
    np.testing.assert_allclose(np.diag(covariance), 1.0)
    # The variables: four of the first field, one of the second, three of the third.
    expected = np.eye(8)
    for i, j, r in ((0, 4, 0.5), (0, 5, -0.6), (4, 5, 0.2), (1, 6, -0.6), (2, 7, -0.6)):
        expected[i, j] = expected[j, i] = r
    np.testing.assert_allclose(covariance, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: covariance(PLACES, 1.0, "gaussian"), "squared_exponential"),
        (lambda: karhunen_loeve(PLACES, 1.0, n_terms=9), "n_terms = 9: expected a whole number"),
        (lambda: karhunen_loeve(PLACES, 1.0, weights=np.zeros(5)), "expected numbers above 0"),
        (lambda: RandomField(("k1",), 0.1, one_variable(2)), "expected 1, one for each"),
        (lambda: RandomField(("k1",), 0.5).factors(np.array([-3.0])), "positive stiffness"),
        (lambda: FieldMap([RandomField(("k9",), 0.1)], {"k1": 1.0}), "'k9', which is no parameter"),
        (lambda: FieldMap([RandomField(("k1",), 0.1)], {"k1": -1.0}), "expected a positive mean"),
        (lambda: FieldMap([RandomField(("k1",), 0.1)] * 2, {"k1": 1.0}), "in one field"),
        (
            lambda: FieldMap([RandomField(("k1",), 0.1)], {"k1": 1.0}, [[2.0]]),
            "a correlation matrix",
        ),
    ],
)
def test_bad_input_is_said(make, words):
    with pytest.raises(InputError, match=words):
        make()

"""Random stiffnesses of joints, and what they do to frequencies (Jalali et al. 2019, below eq. 2).

A parameter varies over the interface as k_i = k_i0 (1 + eps f_i), where f is a field of mean zero
and variance one at the places of the parameters: the zones or elements of a joint. Its
Karhunen-Loeve expansion f = sum_j sqrt(lambda_j) phi_j xi_j has independent standard normal xi_j;
one random variable for the whole joint is its limit for a long correlation length.

Two fields may have correlated variables. `fenics_joints.random_fields.fields` takes them to
frequencies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, items, member, real, reals, text, wanted, whole

#: Correlation at a distance d, of the correlation length.
KINDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "exponential": lambda d: np.exp(-d),
    "squared_exponential": lambda d: np.exp(-0.5 * d**2),
}
#: Least share of a field's variance that its expansion keeps by default: chosen.
_SHARE = 0.99
_DISTRIBUTIONS = ("normal", "lognormal")


def covariance(points: np.ndarray, length: float, kind: str = "exponential") -> np.ndarray:
    """Correlation of a field between points.

    Args:
        points: Positions, m, shape (n,) or (n, d).
        length: Correlation length, m: exp(-d / length), or exp(-d^2 / (2 length^2)).
        kind: A key of `KINDS`.

    Returns:
        Shape (n, n), 1 on the diagonal.

    Raises:
        InputError: If the length is not positive or the kind is unknown.
    """
    member("kind", kind, KINDS)
    real("correlation length", length, "m", above=0)
    points = reals("points of a random field", points, unit="m")
    if not points.ndim or not points.size:
        raise wanted("points of a random field", points, "positions, m")
    points = points.reshape(len(points), -1)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    return KINDS[kind](distance / length)


@dataclass(frozen=True)
class KarhunenLoeve:
    """f = modes @ (sqrt(eigenvalues) * xi) at the points.

    Attributes:
        eigenvalues: Variances over the interface, in the unit of the weights, descending, (m,).
        modes: Orthonormal under the weights, shape (n, m).
        share: Share of the whole variance that the m terms hold.
    """

    eigenvalues: np.ndarray
    modes: np.ndarray
    share: float

    def __repr__(self) -> str:
        n, m = self.modes.shape
        return f"KarhunenLoeve({m} terms at {n} points, {100 * self.share:.4g} % of the variance)"

    @property
    def factors(self) -> np.ndarray:
        """f = factors @ xi, shape (n, m)."""
        return self.modes * np.sqrt(self.eigenvalues)


def karhunen_loeve(
    points: np.ndarray,
    length: float,
    kind: str = "exponential",
    *,
    weights: np.ndarray | None = None,
    share: float = _SHARE,
    n_terms: int | None = None,
) -> KarhunenLoeve:
    """Terms of the expansion, by Nystroem's method: the integral is a sum over the points.

    Args:
        points: Positions of the parameters, m, shape (n,) or (n, d).
        length: Correlation length, m.
        kind: A key of `KINDS`.
        weights: Size of the interface around each point, such as the length of an element, (n,).
        share: Least share of the variance that is kept.
        n_terms: Number of terms, in place of the share.

    Raises:
        InputError: For a bad length, kind, weight, share or number of terms.
    """
    correlation = covariance(points, length, kind)
    n = len(correlation)
    weights = np.ones(n) if weights is None else reals("weights", weights, (n,), above=0)
    real("share", share, above=0, most=1)
    if n_terms is not None:
        whole("n_terms", n_terms, 1, n)
    root = np.sqrt(weights)
    values, vectors = np.linalg.eigh(root[:, None] * correlation * root)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    held = np.cumsum(values) / np.sum(values)
    m = n_terms or min(int(np.searchsorted(held, share * (1 - 1e-12))) + 1, n)
    modes = vectors[:, :m] / root[:, None]
    # The sign of a vector is chance; the results should not depend on the library's.
    modes = modes * np.where(modes[np.argmax(np.abs(modes), axis=0), np.arange(m)] < 0, -1.0, 1.0)
    return KarhunenLoeve(values[:m], modes, float(held[m - 1]))


def one_variable(n: int) -> KarhunenLoeve:
    """The field that is one random variable for all n parameters.

    Raises:
        InputError: If there is none.
    """
    if n < 1:
        raise InputError(f"n = {n}: expected at least one parameter for a random variable.")
    return KarhunenLoeve(np.array([float(n)]), np.full((n, 1), n**-0.5), 1.0)


@dataclass(frozen=True)
class RandomField:
    """Random parameters of a model.

    Attributes:
        names: The parameters, in the order of the expansion's points.
        eps: Coefficient of variation.
        expansion: The field; one random variable by default.
        distribution: ``"normal"``, k0 (1 + eps f), as in the paper, or ``"lognormal"``,
            k0 exp(s f - s^2 v / 2) with s^2 = ln(1 + eps^2) and v the field's variance: never
            negative, with the same mean and, for v = 1, the same coefficient of variation.
    """

    names: tuple[str, ...]
    eps: float
    expansion: KarhunenLoeve | None = None
    distribution: str = "normal"

    def __post_init__(self):
        names = (
            (self.names,)
            if isinstance(self.names, str)
            else items("names of a random field", self.names, str, "names of parameters")
        )
        if not names or len(set(names)) != len(names):
            raise InputError(
                f"names of a random field = {list(names)}: expected some, each name once."
            )
        expansion = self.expansion or one_variable(len(names))
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "expansion", expansion)
        if len(expansion.modes) != len(names):
            raise InputError(
                f"the expansion has {len(expansion.modes)} points: expected {len(names)}, one for "
                "each parameter."
            )
        for name in names:
            text("names of a random field", name)
        if not 0 < real("eps", self.eps) < 1:
            raise InputError(f"eps = {self.eps}: expected a coefficient of variation, 0 < eps < 1.")
        member("distribution", self.distribution, _DISTRIBUTIONS)

    def __repr__(self) -> str:
        count = f"{len(self.names)} parameters, {self.n_variables} variables"
        return f"RandomField({count}, eps {self.eps:g}, {self.distribution})"

    @property
    def n_variables(self) -> int:
        """Number of the xi."""
        return len(self.expansion.eigenvalues)

    def factors(self, xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """k / k0 and its derivative by xi.

        Args:
            xi: Standard normal variables, shape (n_variables,).

        Returns:
            Shapes (n,), (n, n_variables).

        Raises:
            InputError: If a factor is not positive, which a normal field allows.
        """
        field, by_xi = self.expansion.factors @ xi, self.expansion.factors
        if self.distribution == "lognormal":
            s = np.sqrt(np.log1p(self.eps**2))
            k = np.exp(s * field - 0.5 * s**2 * np.sum(by_xi**2, axis=1))
            return k, s * k[:, None] * by_xi
        k = 1 + self.eps * field
        if np.any(k <= 0):
            worst = int(np.argmin(k))
            raise InputError(
                f"{self.names[worst]}: the sample of its random field is {k[worst]:.3g} times the "
                f"mean, expected a positive stiffness. With eps = {self.eps:g} the normal field "
                "goes below zero; take distribution = 'lognormal' or a smaller eps."
            )
        return k, self.eps * by_xi


class FieldMap:
    """Several fields as one map from independent standard normal xi to parameter values.

    Args:
        fields: The random fields.
        start: Values of all the model's parameters; of the random ones, the means.
        correlation: Of the fields, (n_fields, n_fields); none by default.

    Raises:
        InputError: For a parameter that does not exist, is in two fields or has no positive mean,
            or a matrix that is no correlation.

    Attributes:
        names: The random parameters.
        n_variables: Number of the xi.
    """

    def __init__(
        self,
        fields: Sequence[RandomField],
        start: Mapping[str, float],
        correlation: np.ndarray | None = None,
    ):
        self.fields, self.start = list(fields), dict(start)
        named = [name for field in self.fields for name in field.names]
        for name in named:
            if name not in self.start:
                raise InputError(
                    f"the random field names {name!r}, which is no parameter; expected some of: "
                    f"{', '.join(self.start)}."
                )
            if not self.start[name] > 0:
                raise InputError(f"{name} = {self.start[name]:g}: expected a positive mean.")
        if not named or len(set(named)) != len(named):
            raise InputError(f"random fields of {named}: expected each parameter in one field.")
        self.names = tuple(named)
        self.sizes = [field.n_variables for field in self.fields]
        self.n_variables = sum(self.sizes)
        self.root = self._root(correlation)
        self.columns = [list(self.start).index(name) for name in named]

    def _root(self, correlation) -> np.ndarray:
        """Square root of the correlation of all xi: that of the fields, term by term."""
        n = len(self.fields)
        R = np.eye(n) if correlation is None else np.asarray(correlation, dtype=float)
        good = R.shape == (n, n) and np.allclose(R, R.T) and np.allclose(np.diag(R), 1.0)
        if not good or np.linalg.eigvalsh(R)[0] < -1e-12:
            raise InputError(
                f"correlation of the fields = {R.tolist()}: expected a correlation matrix of shape "
                f"({n}, {n})."
            )
        first = np.concatenate([[0], np.cumsum(self.sizes)])
        whole = np.zeros((first[-1], first[-1]))
        for term in range(max(self.sizes)):
            # Only fields that have this term can be correlated in it.
            has = [i for i in range(n) if self.sizes[i] > term]
            values, vectors = np.linalg.eigh(R[np.ix_(has, has)])
            at = first[has] + term
            whole[np.ix_(at, at)] = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        return whole

    def values(self, xi: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
        """Parameter values and the derivatives of the random ones by xi, (n_names, n_variables)."""
        own = np.split(self.root @ xi, np.cumsum(self.sizes)[:-1])
        values, slopes = dict(self.start), np.zeros((len(self.names), self.n_variables))
        row, column = 0, 0
        for field, part in zip(self.fields, own, strict=True):
            k, by_xi = field.factors(part)
            for i, name in enumerate(field.names):
                values[name] = float(self.start[name] * k[i])
                slopes[row + i, column : column + len(part)] = self.start[name] * by_xi[i]
            row, column = row + len(k), column + len(part)
        return values, slopes @ self.root


#: Step of xi, of unit variance, for second derivatives by differences of exact gradients: chosen.
_STEP = 1e-3


@dataclass(frozen=True)
class Moments:
    """Moments of the frequencies of a model with random parameters.

    Attributes:
        mean: Hz, shape (m,).
        covariance: Hz^2, shape (m, m).
        samples: Frequencies, Hz, (n, m), of a propagation by samples; None otherwise.
        parameters: Parameter values of the samples, (n, n_names); None otherwise.
        names: Names of the random parameters.
    """

    mean: np.ndarray
    covariance: np.ndarray
    names: tuple[str, ...]
    samples: np.ndarray | None = None
    parameters: np.ndarray | None = None

    def __repr__(self) -> str:
        low, high = self.mean.min(), self.mean.max()
        return f"Moments({len(self.mean)} frequencies, means from {low:.4g} to {high:.4g} Hz)"

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations, Hz."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the frequencies."""
        return self.covariance / np.outer(self.sd, self.sd)


def propagate_samples(
    forward,
    fields: Sequence[RandomField],
    start: Mapping[str, float],
    n: int,
    *,
    seed: int = 0,
    correlation: np.ndarray | None = None,
) -> Moments:
    """Frequencies at independent samples of the fields.

    Args:
        forward: ``values -> (ln f, d ln f / d values)``, see `reduction.ModalPrediction`.
        fields: The random fields.
        start: Values of all the model's parameters; of the random ones, the means.
        n: Number of samples.
        seed: Of the random numbers.
        correlation: Of the fields, (n_fields, n_fields); none by default.

    Raises:
        InputError: For a bad field, or a sample with a stiffness that is not positive.
    """
    if n < 2:
        raise InputError(f"n = {n}: expected at least 2 samples.")
    fields = FieldMap(fields, start, correlation)
    xi = np.random.default_rng(seed).standard_normal((n, fields.n_variables))
    samples, drawn = [], []
    for row in xi:
        values, _ = fields.values(row)
        samples.append(np.exp(forward(values)[0]))
        drawn.append([values[name] for name in fields.names])
    samples = np.array(samples)
    spread = np.atleast_2d(np.cov(samples, rowvar=False))
    return Moments(samples.mean(axis=0), spread, fields.names, samples, np.array(drawn))


def propagate_sensitivities(
    forward,
    fields: Sequence[RandomField],
    start: Mapping[str, float],
    *,
    order: int = 2,
    correlation: np.ndarray | None = None,
) -> Moments:
    """Mean and covariance of frequencies from their derivatives by the fields' variables.

    With g and H of f(xi) at 0: mean f + tr H / 2, covariance g g^T + tr(H H) / 2; the terms in H
    with ``order`` 2 alone. H is the central difference of exact gradients.

    Args:
        forward: See `propagate_samples`.
        fields: The random fields.
        start: Values of all the model's parameters; of the random ones, the means.
        order: 1 or 2.
        correlation: Of the fields.

    Raises:
        InputError: For a bad field or order.
    """
    if order not in (1, 2):
        raise InputError(f"order = {order}: expected 1 or 2.")
    fields = FieldMap(fields, start, correlation)
    n = fields.n_variables

    def gradient(xi):
        values, by_xi = fields.values(xi)
        log_f, by_values = forward(values)
        f = np.exp(log_f)
        return f, f[:, None] * (by_values[:, fields.columns] @ by_xi)

    mean, g = gradient(np.zeros(n))
    spread = g @ g.T
    if order == 2:
        hessian = np.empty((len(mean), n, n))
        for j, step in enumerate(_STEP * np.eye(n)):
            hessian[:, :, j] = (gradient(step)[1] - gradient(-step)[1]) / (2 * _STEP)
        hessian = 0.5 * (hessian + hessian.transpose(0, 2, 1))
        mean = mean + 0.5 * np.trace(hessian, axis1=1, axis2=2)
        spread = spread + 0.5 * np.einsum("aij,bij->ab", hessian, hessian)
    return Moments(mean, spread, fields.names)

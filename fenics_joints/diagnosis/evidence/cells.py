"""Evidence of a hypothesis as a sum over Gaussian cells of its prior.

The prior of the parameters z is a mixture of Gaussian cells, each with a share c_w, a mean m_w and
standard deviations h_w; tolerances and other parameters that are uncertain in any case have one
cell. Within a cell the prediction is linear about a point z_w,

    g(z) = g_w + J_w (z - z_w),

so that its evidence, its posterior mean and its covariance are in closed form:

    p(y | hypothesis) = sum over w of  c_w N(y; g_w + J_w (m_w - z_w), S + J_w h_w^2 J_w^T).

The point z_w is moved to the cell's own posterior mean by Gauss-Newton steps. Cells do not depend
on each other and cover the whole prior, so that no local optimum hides a better one.

Where the model is bent within cells, the sum of their evidence is too small: by up to three nats
for two effects at eleven torques. `sampled_evidence` then draws from the cells by importance
sampling, whose result does not depend on how well they fit; only its scatter does. The number of
draws from each cell follows the draws before (population Monte Carlo; Cappe, Guillin, Marin and
Robert, J. Comput. Graph. Stat. 13, 2004), and every draw counts by the mixture of all rounds (Veach
and Guibas, SIGGRAPH 1995).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr, logsumexp, ndtr
from scipy.stats import multivariate_t, norm, qmc

from fenics_joints.diagnosis.effects.effect import Prior
from fenics_joints.diagnosis.evidence.linear import log_constant

#: Distance between cells over one, two and three smooth parameters, in standard deviations of the
#: prior. [numerical: error of the lattice by Poisson's sum, see `_smooth_cells`]
_SPACING = {1: 0.5, 2: 0.9, 3: 1.05}
#: Largest width of a cell, relative to the spacing and to the prior; ln of the share, relative to
#: the largest, below which cells are left out. [numerical: the same]
_OF_SPACING, _WIDEST, _LEAST = 0.8, 0.7, 11.0
#: Least number of cells within the limits of a prior. [numerical: chosen]
_WITHIN = 4
#: Distance of cells over one smooth parameter beside a stepped one (that acts in steps or at many
#: places); log2 of the number of cells over several beside a stepped one, and over four or more
#: without. [numerical: chosen for time]
_BESIDE, _MORE_BESIDE, _MORE = {1: 1.15}, 4, 7
#: Standard deviations of the prior up to which a stepped parameter has cells. [numerical: chosen]
_FARTHEST = 4.0
#: Least share of a stepped parameter's cell within the limits. [numerical: chosen]
_INSIDE = 0.1
#: Slope above which a cell is left out, in standard deviations of the data per one of the cell: a
#: sum of its square and the prior's 1 has the latter to a hundredth. [numerical: 1e-2 / 1e-16]
STEEPEST = 1e7


@dataclass(frozen=True)
class PriorCells:
    """Cells of a prior, each with what the model predicts about one point of it.

    Attributes:
        mean: Prior means of z, (n, p).
        width: Prior standard deviations, (n, p); 0 for what is fixed.
        log_share: ln of the share of the prior, (n,).
        at: Points about which the prediction is linear, (n, p).
        data: Predictions there, (n, N); nan where the model has no such modes.
        slopes: Their derivatives by z, (n, N, p).
    """

    mean: np.ndarray
    width: np.ndarray
    log_share: np.ndarray
    at: np.ndarray
    data: np.ndarray
    slopes: np.ndarray

    def __len__(self) -> int:
        return len(self.mean)

    def __getitem__(self, index) -> PriorCells:
        return PriorCells(*(getattr(self, f.name)[index] for f in fields(self)))

    def joined(self, *others: PriorCells) -> PriorCells:
        """These and others."""
        all_ = (self, *others)
        return PriorCells(
            *(np.concatenate([getattr(c, f.name) for c in all_]) for f in fields(self))
        )


@dataclass(frozen=True)
class CellPosterior:
    """Evidence and posterior of cells.

    Attributes:
        log_evidence: ln of each cell's evidence times its share, (n,); -inf where it cannot be.
        z: Posterior means of z, (n, p).
        covariance: Posterior covariances, (n, p, p).
        square: Squared whitened residual and distance from the prior at these means, (n,).
    """

    log_evidence: np.ndarray
    z: np.ndarray
    covariance: np.ndarray
    square: np.ndarray


def weigh(
    cells: PriorCells, data: np.ndarray, used: np.ndarray, lower: np.ndarray, limits: np.ndarray
) -> CellPosterior:
    """Weigh cells, in each of which predictions are linear, by data.

    A parameter whose posterior mean would lie beyond a limit of its prior is held at the limit.
    Only the part of a cell within the limits counts, relative to the part of the prior within.

    Args:
        cells: The cells.
        data: The data, (N,).
        used: Mask of the data that count, (N,); k of them.
        lower: Cholesky factor of their covariance, (k, k).
        limits: Least and largest z, (p, 2).
    """
    n, p = cells.mean.shape
    good = np.isfinite(cells.data[:, used]).all(1) & np.isfinite(cells.slopes[:, used]).all((1, 2))
    found = CellPosterior(
        np.full(n, -np.inf), cells.at.copy(), np.tile(np.eye(p), (n, 1, 1)), np.full(n, np.inf)
    )
    if not good.any():
        return found
    own = cells[good]
    away = own.mean - own.at
    columns = np.concatenate(
        [
            (own.data - data)[:, used, None] + own.slopes[:, used] @ away[:, :, None],
            own.slopes[:, used] * own.width[:, None, :],
        ],
        axis=2,
    )
    k, count = int(used.sum()), len(own)
    flat = columns.transpose(1, 0, 2).reshape(k, -1)
    white = solve_triangular(lower, flat, lower=True, check_finite=False)
    white = np.ascontiguousarray(white.reshape(k, count, p + 1).transpose(1, 2, 0))
    sane = np.all(np.abs(white[:, 1:]) < STEEPEST, axis=(1, 2))
    if not sane.all():
        good[good] = sane
        own, white = own[sane], white[sane]
        if not sane.any():
            return found
    residual, slope = white[:, 0], white[:, 1:]
    hessian = slope @ slope.transpose(0, 2, 1) + np.eye(p)
    u = -np.linalg.solve(hessian, np.einsum("npk,nk->np", slope, residual)[:, :, None])[:, :, 0]
    covariance = np.linalg.inv(hessian)
    width = np.where(own.width > 0, own.width, 1.0)
    low, high = (limits.T[:, None] - own.mean) / width
    held = ((u < low) | (u > high)) & (own.width > 0)
    if held.any():
        u = _held(residual, slope, np.clip(u, low, high), held)
    left = residual + np.einsum("npk,np->nk", slope, u)
    square = np.sum(left**2, axis=1) + np.sum(u**2, axis=1)
    pull = np.einsum("npk,nk->np", slope, left) + u
    # With others held, a parameter may be pulled back from its limit; a product of shares would
    # then be too large.
    pull = np.where(held & np.where(u >= high, pull < 0, pull > 0), pull, 0.0)
    inside = _inside(u, pull, np.diagonal(covariance, axis1=1, axis2=2), low, high, own.width > 0)
    found.log_evidence[good] = (
        own.log_share
        - 0.5 * square
        - 0.5 * np.linalg.slogdet(hessian)[1]
        - log_constant(lower)
        + inside
        - np.sum(np.log(np.diff(ndtr(limits), axis=1)))
    )
    found.z[good] = own.mean + own.width * u
    scale = own.width
    found.covariance[good] = covariance * (scale[:, :, None] * scale[:, None, :])
    found.square[good] = square
    return found


def _held(residual, slope, u, held) -> np.ndarray:
    """Least squares in u, (n, p), with some of them held where they are."""
    fixed = np.where(held, u, 0.0)
    residual = residual + np.einsum("npk,np->nk", slope, fixed)
    free = np.where(held[:, :, None], 0.0, slope)
    hessian = free @ free.transpose(0, 2, 1) + np.eye(u.shape[1])
    step = np.linalg.solve(hessian, np.einsum("npk,nk->np", free, residual)[:, :, None])
    return np.where(held, u, -step[:, :, 0])


def _inside(u, pull, variance, low, high, free) -> np.ndarray:
    """ln of the share of each posterior within the limits, (n,), over its density at u relative to
    that at its mean; parameters as if independent.

    Args:
        u: Where each is, (n, p), at a limit where it is held.
        pull: Slopes of the cost there, (n, p); 0 where it is not held.
        variance: Variances of the posterior without limits, (n, p).
        low: The least u, (n, p).
        high: The largest u, (n, p).
        free: Which parameters are not fixed, (n, p).
    """
    found, sd = np.zeros(u.shape), np.sqrt(variance)
    near = free & (np.minimum(u - low, high - u) < _FARTHEST * sd)
    sd, away = sd[near], pull[near] * sd[near]
    below, above = (low - u)[near] / sd + away, (high - u)[near] / sd + away
    # On the side where both are small.
    flip = below > 0
    below, above = np.where(flip, -above, below), np.where(flip, -below, above)
    more, less = log_ndtr(above), log_ndtr(below)
    found[near] = more + np.log1p(-np.exp(np.minimum(less - more, -1e-12))) + 0.5 * away**2
    return found.sum(axis=1)


def prior_cells(priors: Sequence[Prior]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, (n, d), standard deviations, (n, d), and ln shares, (n,), of cells of a prior.

    Smooth parameters have cells on a lattice, or at a Sobol sequence if there are many; each is
    combined with every value of the stepped ones. Some means are beyond the limits of the prior,
    where only the part of a cell within counts (`weigh`).

    Args:
        priors: The parameters'.
    """
    stepped = [j for j, prior in enumerate(priors) if prior.scan]
    smooth = [j for j, prior in enumerate(priors) if not prior.scan]
    known, more = (_BESIDE, _MORE_BESIDE) if stepped else (_SPACING, _MORE)
    z, width, own = _smooth_cells([priors[j] for j in smooth], known.get(len(smooth)), more)
    axes = [_steps(priors[j]) for j in stepped]
    places = list(product(*(range(len(axis[0])) for axis in axes)))
    n = len(z) * len(places)
    mean, widths, share = np.zeros((n, len(priors))), np.zeros((n, len(priors))), np.zeros(n)
    mean[:, smooth] = np.tile(z, (len(places), 1))
    widths[:, smooth] = width
    for i, (at, wide, log_share) in enumerate(axes):
        index = np.repeat([place[i] for place in places], len(z))
        mean[:, stepped[i]], widths[:, stepped[i]] = at[index], wide[index]
        share += log_share[index]
    return mean, widths, share + np.tile(own, len(places))


def prior_points(priors: Sequence[Prior], most: int) -> np.ndarray:
    """Means of some of a prior's cells, from all over it, (n, d).

    Args:
        priors: The parameters'.
        most: How many at most.
    """
    mean = prior_cells(priors)[0]
    return mean[np.linspace(0, len(mean) - 1, min(most, len(mean))).round().astype(int)]


def _smooth_cells(
    priors: Sequence[Prior], apart: float | None, more: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, (n, d), standard deviations, (d,), and ln shares, (n,), of cells that are the prior up
    to its limits; some are beyond these.

    On a lattice of spacing s, normal densities of variance h^2 with shares by a normal density of
    variance 1 - h^2 add up to the prior with its tails, except for a relative error of
    exp(-2 (pi h / s)^2 (1 - h^2)) (Poisson's sum). A Sobol sequence only covers the part of the
    prior in which it has points.
    """
    d = len(priors)
    if d == 0:
        return np.zeros((1, 0)), np.zeros(0), np.zeros(1)
    limits = np.array([prior.limits() for prior in priors]).T
    spacing = np.full(d, np.inf if apart is None else apart)
    spacing = np.minimum(spacing, np.diff(limits, axis=0)[0] / _WITHIN)
    width = np.minimum(_OF_SPACING * spacing, _WIDEST)
    low, high = limits + 2 * width * np.array([[-1], [1]])
    sd = np.sqrt(1 - width**2)
    if apart is None:
        unit = qmc.Sobol(d, seed=3).random_base2(more)
        low, high = ndtr(np.array([low, high]) / sd)
        z = norm.ppf(low + unit * (high - low)) * sd
        share = np.zeros(len(z))
    else:
        axes = [
            s * np.arange(np.ceil(a / s), b / s) for a, b, s in zip(low, high, spacing, strict=True)
        ]
        z = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
        share = -0.5 * np.sum((z / sd) ** 2, axis=1)
        z, share = (part[share > share.max() - _LEAST] for part in (z, share))
    inside = np.prod(np.diff(ndtr((limits[:, None] - z) / width), axis=0)[0], axis=1)
    own = np.sum(np.log(np.diff(ndtr(limits), axis=0)))
    return z, width, share + own - np.log(np.sum(np.exp(share) * inside))


def _steps(prior: Prior) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values of z of a stepped parameter, (n,), their cells' widths and ln of their shares."""
    low, high = prior.limits(_FARTHEST)
    z = np.linspace(low, high, prior.scan)
    if prior.even or prior.also:
        z = np.unique(prior.tried())
    middle = 0.5 * (z[1:] + z[:-1])
    edges = np.concatenate([[low], middle, [high]])
    share = np.diff(ndtr(edges))
    wide = np.diff(np.concatenate([[z[0]], middle, [z[-1]]])) / np.sqrt(12)
    limits = np.array(prior.limits())
    inside = np.diff(ndtr((limits[:, None] - z) / wide), axis=0)[0]
    share = np.maximum(share, 1e-12) / max(share.sum(), 1e-12) / np.maximum(inside, _INSIDE)
    return z, wide, np.log(share * np.diff(ndtr(limits)))


def total(log_evidence: np.ndarray) -> float:
    """ln of a sum; -inf of nothing."""
    if not len(log_evidence) or not np.isfinite(log_evidence).any():
        return -np.inf
    return float(logsumexp(log_evidence))


#: Draws of a round, rounds at most, and the effective number of draws that suffices: the standard
#: deviation of ln of the evidence is then 0.12. [numerical: chosen for time]
_DRAWS, _ROUNDS, _EFFECTIVE = 64, 8, 70.0
#: Degrees of freedom of the t distribution of draws, which has heavier tails than a posterior;
#: share of draws that goes to all cells equally. [numerical: chosen]
_TAILS, _ALIKE = 6, 0.1
#: Variances of the distribution that is made from the draws, over theirs. [numerical: bias of ln of
#: a banana's integral with 1, 2 and 4: -0.22, -0.12 and -0.05; 4 takes many draws in five
#: dimensions]
_WIDER = 2.0
#: Effective number of draws below which there is no result. [numerical: chosen]
_TOO_FEW = 10.0


def sampled_evidence(
    mean: np.ndarray,
    covariance: np.ndarray,
    share: np.ndarray,
    log_density: Callable[[np.ndarray, np.ndarray], np.ndarray],
    seed: int = 0,
) -> float | None:
    """ln of the integral of a density, by adaptive multiple importance sampling (Cornuet, Marin,
    Mira and Robert, Scand. J. Stat. 39, 2012): draws of all rounds count by the mixture of all.

    Args:
        mean: Means of cells' posteriors, which nearly cover what counts, (k, p).
        covariance: Their covariances, (k, p, p).
        share: Of each, (k,); their sum is 1.
        log_density: ln of the density at points (b, p), each of which was drawn from one of the
            cells, (b,), by index: (b,); -inf where it cannot be.
        seed: Of the random numbers.

    Returns:
        None if the effective number of draws is too small.
    """
    p = mean.shape[1]
    roots, rng = np.linalg.cholesky(covariance), np.random.default_rng(seed)
    unit = multivariate_t(np.zeros(p), df=_TAILS)
    z, density, drawn = np.zeros((0, p)), np.zeros(0), np.zeros(len(mean))
    near = np.arange(len(mean))
    for _ in range(_ROUNDS):
        wanted = (1 - _ALIKE) * share / share.sum() + _ALIKE / len(mean)
        counts = rng.multinomial(_DRAWS, wanted / wanted.sum())
        own = np.repeat(np.arange(len(mean)), counts)
        step = np.reshape(unit.rvs(len(own), rng), (len(own), p))
        new = mean[own] + np.einsum("nij,nj->ni", roots[own], step)
        z, density = np.vstack([z, new]), np.append(density, log_density(new, near[own]))
        drawn += counts
        each = (
            np.array(
                [
                    unit.logpdf(solve_triangular(root, (z - middle).T, lower=True).T)
                    for root, middle in zip(roots, mean, strict=True)
                ]
            ).reshape(len(mean), -1)
            - np.sum(np.log(np.diagonal(roots, axis1=1, axis2=2)), axis=1)[:, None]
        )
        with np.errstate(divide="ignore"):
            each += np.log(drawn / len(z))[:, None]
        mixture = logsumexp(each, axis=0)
        log_weight = density - mixture
        if not np.isfinite(log_weight).any():
            return None
        weight = np.exp(log_weight - log_weight.max())
        effective = weight.sum() ** 2 / np.sum(weight**2)
        if effective >= _EFFECTIVE:
            break
        weight /= weight.sum()
        share = np.exp(each - mixture) @ weight
        # One more distribution, by the moments of all draws but wider, as likely as all others
        # together. Of few draws its covariance is mostly that of the cells.
        middle = weight @ z
        away = z - middle
        wide = effective * (away.T * weight) @ away + 2 * p * covariance.mean(axis=0)
        mean, near = np.vstack([mean, middle]), np.append(near, near[np.argmax(share)])
        roots = np.concatenate([roots, [np.linalg.cholesky(_WIDER * wide / (effective + 2 * p))]])
        share, drawn = np.append(share, share.sum()), np.append(drawn, 0.0)
    found = float(logsumexp(log_weight) - np.log(len(z)))
    return found if effective >= _TOO_FEW else None

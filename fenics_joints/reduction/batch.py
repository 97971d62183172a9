"""Smaller models for a few parameters.

A reduced model serves all hypotheses and all priors, so that its basis is several times as large
as one of them needs. `narrow` projects on the modes that some parameters can make in their ranges,
and says how far its frequencies are off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from fenics_joints.errors import ConvergenceError, InputError, mapping, real, reals, wanted, whole
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.adaptive import Points, improve
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.compact import freeze

#: Sampled points for the basis, and rounds of checks that may add to it.
_SAMPLES, _ROUNDS = 16, 4
#: Directions whose share of a mode is below this times the root of the tolerance are left out: the
#: error of a frequency is of the order of the square. Each further round takes a tenth of it.
_SHARE = 0.1


@dataclass(frozen=True)
class Narrow:
    """A small model and how good it is.

    Attributes:
        model: The model; its parameters are the free ones.
        error: Largest relative error of a frequency at ``n_checked`` random points that the basis
            was not made from.
        n_checked: Number of those points.
    """

    model: ArrayModel
    error: float
    n_checked: int


def narrow(
    model: ArrayModel,
    ranges: Mapping[str, tuple[float, float]],
    n_modes: int,
    *,
    given: Mapping[str, float] | None = None,
    tolerance: float = 1e-5,
    n_check: int = 50,
    seed: int = 0,
) -> Narrow:
    """A model on the modes that parameters in their ranges can make.

    Args:
        model: A model of plain arrays.
        ranges: Least and largest value of each free parameter, positive; sampled evenly in the
            logarithm.
        n_modes: Modes that must be right, rigid-body modes included.
        given: Values of the other parameters that differ from their nominal value.
        tolerance: Largest accepted relative error of a frequency.
        n_check: Random points at which it is checked.
        seed: Of the random points.

    Raises:
        InputError: For a bad range or name.
        ConvergenceError: If the error stays above the tolerance.
    """
    whole("n_modes", n_modes)
    whole("n_check", n_check, most=10**6)
    whole("seed", seed, 0)
    real("tolerance", tolerance, above=0.0, most=0.1)
    if not ranges:
        raise wanted("ranges", ranges, "the range of a parameter at least")
    for name, pair in mapping("ranges", ranges, "ranges by name").items():
        low, high = reals(f"range of {name}", pair, (2,), above=0.0)
        if not low < high:
            raise InputError(f"range of {name} = {(low, high)}: expected 0 < low < high.")
    middle = {name: float(np.sqrt(low * high)) for name, (low, high) in ranges.items()}
    given = mapping("given", given, "values by the parameters' names")
    frozen = freeze(model, list(ranges), given | middle)
    low, high = np.log(list(ranges.values())).T

    def points(unit: np.ndarray) -> Points:
        at = np.exp(low + unit * (high - low))
        return [dict(zip(ranges, row.tolist(), strict=True)) for row in at]

    small = _Narrowing(frozen, n_modes, tolerance)
    small.extend([middle, *points(qmc.Sobol(len(ranges), seed=seed).random(_SAMPLES))])
    chance = np.random.default_rng(seed)
    errors = improve(
        small, lambda: points(chance.random((n_check, len(ranges)))), tolerance, _ROUNDS, least=1.0
    )
    error = float(errors.max())
    if error > tolerance:
        raise ConvergenceError(
            f"the frequencies of the small model are off by {error:.1e}, more than "
            f"{tolerance:.1e}, after {_ROUNDS} rounds: take narrower ranges, or a larger tolerance"
        )
    return Narrow(small.model, error, n_check)


class _Narrowing:
    """A model on the modes of another at some points; see `SmallModel`."""

    def __init__(self, full: ArrayModel, n_modes: int, tolerance: float):
        self.full, self.n_modes = full, n_modes
        self._share, self._snapshots = _SHARE * np.sqrt(tolerance), []

    def _modes(self, model: ArrayModel, values: Mapping[str, float]) -> Modes:
        return solve_modes(model, values, n_modes=min(self.n_modes, model.n_dofs))

    def errors(self, points: Points) -> np.ndarray:
        """Largest relative error of an elastic frequency at each point, (n,)."""
        found = []
        for values in points:
            exact, ours = (self._modes(model, values) for model in (self.full, self.model))
            ratio = ours.frequencies_hz[ours.n_rigid :] / exact.frequencies_hz[exact.n_rigid :]
            found.append(np.max(np.abs(ratio - 1)))
        return np.array(found)

    def extend(self, points: Points) -> None:
        """Take the modes at points into the basis, and a tenth of the share that is left out."""
        self._snapshots += [self._modes(self.full, values).shapes for values in points]
        vectors, sizes = pod(self.full, np.hstack(self._snapshots))
        self.model = self.full.on(vectors[:, sizes > self._share * sizes[0]])
        self._share /= 10


def pod(
    model: ArrayModel,
    snapshots: np.ndarray,
    weights: np.ndarray | None = None,
    given: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Vectors that hold most of the snapshots' energy, best first.

    Args:
        model: The model that the snapshots are of.
        snapshots: As columns, shape (n_dofs, n).
        weights: Of the snapshots, shape (n,); equal by default.
        given: Parameter values whose K + omega^2 M measures the energy; nominal by default.

    Returns:
        Vectors orthonormal in that energy, (n_dofs, k), and their singular values, (k,).
    """
    K, M = model.stiffness(given), model.mass(given)
    upper = np.linalg.cholesky(K + np.trace(K) / np.trace(M) * M).T
    energetic = upper @ snapshots
    energetic *= (1.0 if weights is None else weights) / np.linalg.norm(energetic, axis=0)
    left, sizes, _ = np.linalg.svd(energetic, full_matrices=False)
    return np.linalg.solve(upper, left), sizes

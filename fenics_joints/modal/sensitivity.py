"""Derivatives of frequencies by the parameters, and identifiability from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import capable, items, reals, wanted
from fenics_joints.modal.modes import Modes


def frequency_sensitivity(modes: Modes, index: Sequence[int]) -> np.ndarray:
    """Derivative of ln f by every parameter: d ln f / dp = (d lambda / dp) / (2 lambda).

    Args:
        modes: Modes of a structure.
        index: Modes wanted; elastic ones.

    Returns:
        Shape (len(index), n_parameters), 1 / unit of the parameter.

    Raises:
        InputError: If an index is out of range.
    """
    capable("modes", modes, ("gradients", "eigenvalues"), "modes, as solve_modes gives them")
    found = np.asarray(index)
    whole = found.ndim == 1 and (found.dtype.kind in "iu" or not found.size)
    if not whole or np.any((found < 0) | (found >= len(modes))):
        raise wanted("index", index, f"whole numbers from 0 to {len(modes) - 1}")
    index = found.astype(int)
    return modes.gradients(index) / (2 * modes.eigenvalues[index])[:, None]


@dataclass(frozen=True, repr=False)
class Identifiability:
    """How well a set of data determines a set of parameters.

    Attributes:
        names: Names of the parameters.
        condition: Condition number of the whitened sensitivity matrix.
        collinearity: Collinearity index of all parameters together: 1 if independent; above 20 the
            data do not tell them apart (Brun, Reichert and Kuensch, Water Resour. Res. 37, 2001).
        sd: Standard deviation of each parameter from the data alone, in its working unit.
        weakest: Direction in parameter space that the data determine least, unit vector.
        undetermined: Parameters that take a large part in directions the data leave open.
    """

    names: tuple[str, ...]
    condition: float
    collinearity: float
    sd: np.ndarray
    weakest: np.ndarray
    undetermined: tuple[str, ...]

    def __repr__(self) -> str:
        return (
            f"Identifiability({len(self.names)} parameters, condition {self.condition:.3g}, "
            f"collinearity {self.collinearity:.3g}, {len(self.undetermined)} undetermined)"
        )


#: Standard deviation of a log parameter, a factor e, above which the data leave a direction open.
_OPEN = 1.0


def identifiability(whitened: np.ndarray, names: Sequence[str]) -> Identifiability:
    """Condition number, collinearity index and undetermined parameters.

    Args:
        whitened: Sensitivities divided by the data's standard deviations, shape (n_data, p), by
            log parameters (or any with a common scale).
        names: Names of the p parameters.

    Raises:
        InputError: If these are no numbers, or the names are not of as many parameters.
    """
    whitened = reals("whitened", whitened, (None, None))
    names = items("names", names, str, "names of parameters")
    p = whitened.shape[1]
    if len(set(names)) != p or not whitened.size:
        raise wanted("names", names, f"{p} names, each once, for sensitivities to some data")
    _, s, vt = np.linalg.svd(whitened, full_matrices=True)
    s = np.concatenate([s, np.zeros(p - len(s))])
    s[s <= s[0] * max(whitened.shape) * np.finfo(float).eps] = 0.0  # round-off, as in matrix_rank
    with np.errstate(divide="ignore"):
        spread = np.where(s > 0, 1 / s, np.inf)
        condition = float(s[0] * spread[-1])
    norms = np.linalg.norm(whitened, axis=0)
    unit = whitened / np.where(norms > 0, norms, 1.0)
    least = np.linalg.eigvalsh(unit.T @ unit)[0]
    collinearity = float(1 / np.sqrt(least)) if least > 1e-15 else np.inf
    with np.errstate(invalid="ignore"):
        terms = np.where(np.abs(vt.T) > 1e-12, vt.T * spread, 0.0)
    sd = np.sqrt(np.sum(terms**2, axis=1))
    is_open = vt[spread > _OPEN]
    share = np.sqrt(np.sum(is_open**2, axis=0)) if len(is_open) else np.zeros(p)
    undetermined = tuple(name for name, part in zip(names, share, strict=True) if part > 0.5)
    return Identifiability(tuple(names), condition, collinearity, sd, vt[-1], undetermined)

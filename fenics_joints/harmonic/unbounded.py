"""Resonances without bound, which a branch climbs for ever."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fenics_joints.errors import ConvergenceError
from fenics_joints.harmonic.branch import Branch
from fenics_joints.harmonic.fourier import moving_size

#: Growth of the motion over the branch's least that no damping of a structure allows, and that at
#: which a branch that stopped was on its way there.
_MOST, _MUCH = 1e9, 1e4
#: Relative change of frequency, while the motion grows tenfold, below which it stands still.
_STILL = 1e-3


class BoundWatch:
    """Watches the points of a branch, and stops it at a resonance without bound.

    Args:
        shape: (n, K) of the coefficients, which come first in a point; omega is last.
        on_point: Told of every point.
    """

    def __init__(self, shape: tuple[int, int], on_point: Callable[[np.ndarray], object]):
        self.shape, self.on_point = shape, on_point
        self.omegas, self.sizes = [], []

    def __call__(self, z: np.ndarray) -> None:
        """Take one more point.

        Raises:
            ConvergenceError: If the motion has become too large to have a bound.
        """
        self.on_point(z)
        self.omegas.append(z[-1])
        self.sizes.append(_size(z, self.shape))
        if _grows(np.array(self.omegas), np.array(self.sizes), _MOST):
            raise _error(z[-1])


def unbounded(error: ConvergenceError, shape: tuple[int, int]) -> ConvergenceError:
    """What to say of a branch that stopped: that it has no bound, if it looks so.

    Args:
        error: The error, with its ``branch`` if it has one.
        shape: (n, K).
    """
    branch: Branch | None = getattr(error, "branch", None)
    if branch is None:
        return error
    sizes = np.array([_size(z, shape) for z in branch.z])
    if not _grows(branch.z[:, -1], sizes, _MUCH):
        return error
    found = _error(branch.z[-1, -1], str(error))
    found.branch = branch
    return found


def _size(z: np.ndarray, shape: tuple[int, int]) -> float:
    return moving_size(z[: shape[0] * shape[1]].reshape(shape))


def _grows(omegas: np.ndarray, sizes: np.ndarray, most: float) -> bool:
    """Whether a motion has grown so much, at a frequency that stands still in the end."""
    if not sizes[-1] > most * sizes.min():
        return False
    since = int(np.flatnonzero(sizes < 0.1 * sizes[-1])[-1])
    return bool(np.ptp(omegas[since:]) < _STILL * abs(omegas[-1]))


def _error(omega: float, reason: str | None = None) -> ConvergenceError:
    return ConvergenceError(
        f"the resonance at {omega / (2 * np.pi):.6g} Hz has no bound: the motion grows for ever, "
        "since nothing takes what the force puts in (no damping, or friction that slides all the "
        "way and takes less); expected some damping, or a smaller force",
        reason,
    )

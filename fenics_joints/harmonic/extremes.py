"""Conditions beside harmonic balance that single out responses, so that a force may follow them.

One more equation g(X, omega) = 0 and one more unknown, the share of the load.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.linalg

from fenics_joints.harmonic.balance import Balance
from fenics_joints.harmonic.fourier import moving_size
from fenics_joints.harmonic.loads import Loading

#: Step of the differences of Jacobians, relative to the motion.
_STEP = 1e-5
#: Share of the interfaces' force below which a harmonic of it is round-off.
_NONE = 1e-10


class Condition(Protocol):
    """A number of a response that vanishes at those looked for."""

    def value(self, X: np.ndarray, omega: float, J: np.ndarray) -> tuple[float, np.ndarray, float]:
        """The number and its derivatives by X, (n K,), and by omega; J: the residual's by X."""

    def at(self, X: np.ndarray, omega: float, J: np.ndarray) -> None:
        """Take a point of the branch as the present one."""


class Extreme:
    """Harmonic balance and a condition; unknowns X, omega and the load's share, the parameter.

    Args:
        balance: The equations.
        loading: The load at a share of one.
        condition: The condition.
        widths: Notable changes of omega, rad/s, and of the share.
    """

    def __init__(
        self, balance: Balance, loading: Loading, condition: Condition, widths: tuple[float, float]
    ):
        self.balance, self.loading, self.condition = balance, loading, condition
        self.widths, self.kinked = widths, balance.kinked

    def evaluate(self, z: np.ndarray, *, jacobian: bool = True):
        """Residual and its derivative, as `Problem` has it."""
        balance, (omega, share) = self.balance, z[-2:]
        X = z[:-2].reshape(balance.shape)
        load = self.loading.at(omega)
        R, J = balance.evaluate(X, omega, share * load)
        g, by_X, by_omega = self.condition.value(X, omega, J)
        R = np.append(R.reshape(-1), g)
        if not jacobian:
            return R, None
        N = balance.size
        found = np.zeros((N + 1, N + 2))
        found[:N, :N] = J
        found[:N, N] = (balance.by_omega(X, omega) - share * self.loading.slope(omega)).reshape(-1)
        found[:N, N + 1] = -load.reshape(-1)
        found[N, :N], found[N, N] = by_X, by_omega
        return R, found

    def scales(self, z: np.ndarray) -> np.ndarray:
        """The motion's size without its mean, and the widths."""
        size = moving_size(z[:-2].reshape(self.balance.shape))
        return np.concatenate([np.full(len(z) - 2, size), self.widths])

    def take(self, z: np.ndarray) -> None:
        """Take a point as the present one."""
        X = z[:-2].reshape(self.balance.shape)
        self.condition.at(X, z[-2], self.balance.evaluate(X, z[-2])[1])


class FoldCondition:
    """The residual's derivative by X is singular: the branch turns back in frequency.

    The number is that which a bordered system of equations makes (Govaerts, Numerical Methods for
    Bifurcations of Dynamical Equilibria, 2000, ch. 3), its derivatives from the null vectors and
    differences of the Jacobian along the right one.

    Args:
        balance: The equations.
    """

    def __init__(self, balance: Balance):
        self.balance = balance
        self._border = None

    def at(self, X: np.ndarray, omega: float, J: np.ndarray) -> None:
        """See `Condition`: the borders are the null vectors there."""
        left, _, right = scipy.linalg.svd(J)
        self._border = left[:, -1], right[-1], float(np.linalg.norm(J, 2))

    def vectors(self, J: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """The number, and the left and the right vector."""
        b, c, size = self._border
        N = len(J)
        B = np.zeros((N + 1, N + 1))
        B[:N, :N], B[:N, N], B[N, :N] = J / size, b, c
        last = np.append(np.zeros(N), 1.0)
        factors = scipy.linalg.lu_factor(B)
        right = scipy.linalg.lu_solve(factors, last)
        left = scipy.linalg.lu_solve(factors, last, trans=1)
        return float(right[N]), left[:N], right[:N]

    def value(self, X: np.ndarray, omega: float, J: np.ndarray) -> tuple[float, np.ndarray, float]:
        """See `Condition`."""
        if self._border is None:
            self.at(X, omega, J)
        g, w, v = self.vectors(J)
        V = v.reshape(X.shape)
        step = _STEP * moving_size(X) / max(float(np.abs(V).max()), 1e-300)
        ends = [self.balance.evaluate(X + s * step * V, omega)[1] for s in (1, -1)]
        slopes = [self.balance.by_omega(X + s * step * V, omega) for s in (1, -1)]
        scale = -1 / (2 * step * self._border[2])
        by_X = scale * (w @ (ends[0] - ends[1]))
        by_omega = scale * float(w @ (slopes[0] - slopes[1]).reshape(-1))
        return g, by_X, by_omega


class PhaseCondition:
    """A harmonic is a quarter of its period behind what the lower ones excite it with.

    Variable phase resonance (Porter and Brake 2024, doi.org/10.1016/j.ymssp.2024.111410, eqs. 9
    to 12): the interfaces' force in that harmonic under the lower harmonics alone does no work
    with the harmonic's displacement, in phase.

    Args:
        balance: The equations.
        harmonic: The harmonic, at least 2 and at most the balance's highest.
    """

    def __init__(self, balance: Balance, harmonic: int):
        self.balance, self.first = balance, balance.fourier.cosine(harmonic)

    def at(self, X: np.ndarray, omega: float, J: np.ndarray) -> None:
        """See `Condition`: nothing depends on it."""

    def value(self, X: np.ndarray, omega: float, J: np.ndarray) -> tuple[float, np.ndarray, float]:
        """See `Condition`."""
        balance, own = self.balance, slice(self.first, self.first + 2)
        n, K = balance.shape
        low = X.copy()
        low[:, self.first :] = 0
        F, J = balance.interface_force(low, omega)
        force, motion = F[:, own], X[:, own]
        size, reach = np.linalg.norm(force), np.linalg.norm(motion)
        if not size > _NONE * np.linalg.norm(F) or not reach > 0:
            return 0.0, np.zeros(X.size), 0.0
        g = float(np.sum(force * motion)) / (size * reach)
        by_force = motion / (size * reach) - g * force / size**2
        by_X = np.einsum("nk,nkml->ml", by_force, J.reshape(n, K, n, K)[:, own])
        by_X[:, self.first :] = 0
        by_X[:, own] = force / (size * reach) - g * motion / reach**2
        by_omega = float(np.sum(by_force * balance.rates_by_omega(low, omega)[:, own]))
        return g, by_X.reshape(-1), by_omega

"""Stability of periodic responses of structures whose interfaces have no memory (Hill's method)."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from fenics_joints.errors import InputError
from fenics_joints.harmonic.balance import Balance
from fenics_joints.harmonic.result import HarmonicResult


def floquet_exponents(balance: Balance, X: np.ndarray, omega: float) -> np.ndarray:
    """Floquet exponents, 1/s, complex, (2 n,), of a periodic solution.

    A disturbance e^(lambda t) times a Fourier series obeys J + lambda (C + 2 omega M d/d(wt)) +
    lambda^2 M; of its 2 n K eigenvalues, those with the smallest imaginary part are the exponents
    (Moore 2005).

    Args:
        balance: The equations.
        X: Coefficients of the solution, (n, K).
        omega: Its angular frequency, rad/s.

    Raises:
        InputError: If a law has memory: its disturbed states are not in the equations.
    """
    model = balance.model
    for points in model.interfaces:
        if points.kernel.m:
            raise InputError(
                f"{points.name}: the law {points.law.label} has memory; expected laws without for "
                "Hill's method."
            )
        if points.kernel.rated:
            raise InputError(
                f"{points.name}: the law {points.law.label} asks for the rate of strain; expected "
                "laws of the strain alone for Hill's method."
            )
    one, G = np.eye(balance.fourier.size), balance.fourier.derivative
    J = balance.evaluate(X, omega)[1]
    damping = np.kron(model.C, one) + 2 * omega * np.kron(model.M, G)
    N = balance.size
    A, B = np.zeros((2 * N, 2 * N)), np.eye(2 * N)
    A[:N, N:], A[N:, :N], A[N:, N:] = np.eye(N), -J, -damping
    B[N:, N:] = np.kron(model.M, one)
    values = scipy.linalg.eigvals(A, B)
    values = values[np.isfinite(values)]
    return values[np.argsort(np.abs(values.imag))][: 2 * model.n_dofs]


def hill_multipliers(balance: Balance, X: np.ndarray, omega: float) -> np.ndarray:
    """Floquet multipliers by Hill's method with linearised sliders, complex, the largest first.

    The derivative of harmonic balance stands for that of the laws' forces, which it is where a
    multiplier is 1: a disturbance that grows slowly moves sliders as a lasting one does. Of the
    exponents those count whose imaginary part is at most half the response's frequency.

    Args:
        balance: The equations; laws without the rate of strain.
        X: Coefficients of the solution, (n, K).
        omega: Its angular frequency, rad/s.
    """
    N, one, G = balance.size, np.eye(balance.fourier.size), balance.fourier.derivative
    J, model = balance.evaluate(X, omega)[1], balance.model
    damping = np.kron(model.C, one) + 2 * omega * np.kron(model.M, G)
    right = np.hstack([damping, np.kron(model.M, one)])
    # By the inverses of the exponents: a basis may have directions without mass.
    companion = np.zeros((2 * N, 2 * N))
    companion[:N], companion[N:, :N] = -scipy.linalg.solve(J, right), np.eye(N)
    inverses = scipy.linalg.eigvals(companion, overwrite_a=True)
    own = omega / balance.fourier.periods
    values = 1 / inverses[np.abs(inverses) > 1e-9 / own]
    values = values[np.argsort(np.abs(values.imag))]
    inside = int(np.sum(np.abs(values.imag) <= 0.5 * own * (1 + 1e-6)))
    values = values[: max(inside, 2)]
    found = np.exp(values * 2 * np.pi / own)
    return found[np.argsort(-np.abs(found))]


def stable(result: HarmonicResult, *, tolerance: float = 1e-6) -> np.ndarray:
    """Whether each response is stable, (N,).

    Args:
        result: Responses of a model without memory.
        tolerance: Largest growth rate that counts as none, relative to omega.

    Raises:
        InputError: If a law has memory.
    """
    growth = [
        floquet_exponents(result.balance, X, omega).real.max() / omega
        for X, omega in zip(result.coefficients, result.omegas, strict=True)
    ]
    return np.array(growth) < tolerance

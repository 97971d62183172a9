"""The number of harmonics that a response needs, from an estimate of the neglected ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fenics_joints.errors import ConvergenceError, real, whole
from fenics_joints.harmonic.balance import Balance
from fenics_joints.harmonic.frf import solve_harmonic
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.interfaces.model import InterfaceModel

if TYPE_CHECKING:
    from collections.abc import Sequence


#: Responses of a branch, beside its peak, at which the neglected harmonics are estimated; chosen.
_LOOKED_AT = 12


def neglected_harmonics(
    result: HarmonicResult, indices: Sequence[int] | None = None, *, up_to: int | None = None
) -> np.ndarray:
    """What harmonics beyond the highest would add, as shares of the motion, by kinetic norm.

    The joints' forces in them, on the motion as it is, act on the structure as it is at rest: a
    first estimate, not a bound.

    Args:
        result: Responses (`solve_harmonic`).
        indices: Which; all by default.
        up_to: The highest harmonic looked at; by default twice the result's and one more.

    Returns:
        Of each response and each harmonic left out, (N, harmonics).
    """
    balance, f = result.balance, result.balance.fourier
    most = 2 * f.harmonics + 1 if up_to is None else whole("up_to", up_to, f.harmonics + 1)
    samples = max(f.samples, 1 << (4 * (2 * most * f.periods + 1) - 1).bit_length())
    wider = balance.changed(harmonics=most, samples=samples)
    indices = range(len(result)) if indices is None else indices
    return np.array([_added(wider, result, i) for i in indices])


def _added(wider: Balance, result: HarmonicResult, i: int) -> np.ndarray:
    """The shares of one response."""
    X, omega, f = result.coefficients[i], result.omegas[i], result.balance.fourier
    n, K = X.shape
    padded = np.zeros(wider.shape)
    padded[:, :K] = X
    force, model = wider.interface_force(padded, omega, jacobian=False)[0], wider.model
    stiffness, size = model.stiffness_at_rest(), _norm(model, X[:, 1:])
    found = np.zeros(wider.fourier.harmonics - f.harmonics)
    for k in range(f.size // 2 + 1, wider.fourier.size // 2 + 1):
        h, own = k / f.periods, slice(2 * k - 1, 2 * k + 1)
        load = force[:, own] @ np.array([1.0, -1j])
        Z = stiffness - (h * omega) ** 2 * model.M + 1j * h * omega * model.C
        x = np.linalg.lstsq(Z, -load, rcond=None)[0]
        own_size = _norm(model, np.column_stack([x.real, x.imag]))
        place = int(np.ceil(h - 1e-9)) - f.harmonics - 1
        found[place] = np.hypot(found[place], own_size / size if size else 0.0)
    return found


def _norm(model: InterfaceModel, X: np.ndarray) -> float:
    return float(np.sqrt(max(np.einsum("nk,nm,mk->", X, model.M, X), 0.0)))


def solve_to_tolerance(
    model: InterfaceModel,
    force: str,
    amplitude: float,
    band: tuple[float, float] | None = None,
    *,
    tolerance: float = 1e-3,
    first: int = 3,
    most: int = 31,
    **options,
) -> HarmonicResult:
    """`solve_harmonic` with as many harmonics as are needed.

    What is left out is estimated at the peak and at a dozen other responses (see
    `neglected_harmonics`); while it is more than the tolerance, the branch is solved anew with as
    many harmonics as the estimate asks for.

    Args:
        model, force, amplitude, band: As for `solve_harmonic`.
        tolerance: Largest share of the motion that may be left out.
        first: The number of harmonics to begin with.
        most: The most that are tried.
        options: As for `solve_harmonic`, without ``harmonics``; ``at`` instead of the band too.

    Returns:
        The responses; `HarmonicResult.balance` has the number of harmonics.

    Raises:
        InputError: As `solve_harmonic`, and for a number out of range.
        ConvergenceError: As `solve_harmonic`, or if ``most`` harmonics do not suffice.
    """
    tolerance = real("tolerance", tolerance, above=0)
    H, most = whole("first", first), whole("most", most, first)
    while True:
        result = solve_harmonic(model, force, amplitude, band, harmonics=H, **options)
        looked = np.linspace(0, len(result) - 1, min(len(result), _LOOKED_AT)).astype(int)
        looked = np.unique(np.append(looked, result.peak.index))
        added = neglected_harmonics(result, looked)
        tails = np.sqrt(np.cumsum(added[:, ::-1] ** 2, axis=1))[:, ::-1].max(axis=0)
        if tails[0] <= tolerance:
            return result
        if most <= H:
            raise ConvergenceError(
                f"{H} harmonics leave out {tails[0]:.1g} of the motion, more than the tolerance "
                f"of {tolerance:g}; expected a larger one, or more than most = {most}"
            )
        enough = np.flatnonzero(tails <= tolerance)
        H = min(most, H + int(enough[0] if len(enough) else len(tails)))

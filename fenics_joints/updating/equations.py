"""The equations of the combined updating with left and right weights: Machines 2022, eqs. 15 to 20.

Frequencies and FRFs stand in one system A x = b (eqs. 15 to 17), of very different size, and so do
the sensitivities by E, mu and h. Eq. 18 weighs the rows from the left and the columns from the
right,

    W_m A W_p x_w = W_m b,   x = W_p x_w,
    W_m = diag(w_r / sum_i |A_ri|)                      (eq. 19),
    W_p = diag(1 / sum_r |A_ri|), over all rows of A    (eq. 20).

Two things follow from the equations that the paper does not say. In a least-squares solution of
more rows than unknowns W_m changes the answer, but W_p does not: it lowers the condition number
alone. And the sums of W_m add sensitivities by parameters of different units, so that the answer
depends on these: with h in metres a row is in effect divided by its sensitivity by h.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError

#: How the rows of complex FRFs are made real.
COMPLEX = ("parts", "magnitude")


@dataclass(frozen=True, eq=False, repr=False)
class WeightedEquations:
    """W_m A W_p x_w = W_m b (Machines 2022, eq. 18).

    Attributes:
        matrix: W_m A W_p, (r, p).
        right: W_m b, (r,).
        left: The diagonal of W_m, (r,).
        columns: The diagonal of W_p, (p,).
        condition_before: Condition number of A, in the 2-norm.
        condition_after: Condition number of W_m A W_p.
    """

    matrix: np.ndarray
    right: np.ndarray
    left: np.ndarray
    columns: np.ndarray
    condition_before: float
    condition_after: float

    def solve(self) -> np.ndarray:
        """x = W_p x_w, the change of the parameters in least squares, (p,)."""
        return self.columns * np.linalg.lstsq(self.matrix, self.right, rcond=None)[0]

    def inverse(self) -> np.ndarray:
        """The matrix G with x = G b, (p, r): what noise of the data does to the parameters."""
        return self.columns[:, None] * np.linalg.pinv(self.matrix) * self.left


def weighted_equations(
    A: np.ndarray,
    b: np.ndarray,
    *,
    w_f: float | np.ndarray = 1.0,
    w_H: float | np.ndarray = 1.0,
    n_frequencies: int,
) -> WeightedEquations:
    """The weighted system of Machines 2022, eqs. 18 to 20.

    Args:
        A: Sensitivities, (r, p): of frequencies in the first rows, then of FRFs (eq. 16), real.
        b: Differences, test less model, (r,) (eq. 17).
        w_f: Weights w_f of the frequencies, one or (n_frequencies,).
        w_H: Weights w_H of the FRFs, one or (r - n_frequencies,).
        n_frequencies: How many rows are those of frequencies.

    Raises:
        InputError: If shapes do not fit, a number is not finite, or a parameter changes nothing. A
            row that no parameter changes gets the weight 0: it says nothing.
    """
    A, b = np.asarray(A, dtype=float), np.asarray(b, dtype=float)
    if A.ndim != 2 or b.shape != A.shape[:1] or not 0 <= n_frequencies <= len(A):
        raise InputError(
            f"A has shape {A.shape}, b {b.shape}, n_frequencies = {n_frequencies}: expected "
            "(r, p), (r,) and at most r rows of frequencies"
        )
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        raise InputError("A and b: expected finite numbers")
    by_row, by_column = np.abs(A).sum(axis=1), np.abs(A).sum(axis=0)
    if not by_column.all():
        raise InputError(
            f"column {int(np.argmin(by_column))} of A is zero: expected parameters that change "
            "some frequency or FRF"
        )
    w = np.concatenate(
        [
            np.broadcast_to(np.asarray(w_f, dtype=float), n_frequencies),
            np.broadcast_to(np.asarray(w_H, dtype=float), len(A) - n_frequencies),
        ]
    )
    left = np.divide(w, by_row, out=np.zeros(len(A)), where=by_row > 0)
    columns = 1 / by_column
    matrix = left[:, None] * A * columns
    return WeightedEquations(
        matrix, left * b, left, columns, condition_number(A), condition_number(matrix)
    )


def condition_number(A: np.ndarray) -> float:
    """Condition number in the 2-norm, of columns; inf where they are dependent."""
    return np.inf if len(A) < A.shape[1] else float(np.linalg.cond(A))


def real_rows(
    slopes: np.ndarray, measured: np.ndarray, model: np.ndarray, how: str = "parts"
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of complex FRFs in A and b as real ones. The paper leaves open how it does it.

    Args:
        slopes: dH/dp, complex, (N, p).
        measured: H of the test, (N,).
        model: H of the model, (N,).
        how: ``"parts"``: real parts, then imaginary parts, 2 N rows. ``"magnitude"``: |H|, N rows,
            with d|H| = Re(conj(H) dH) / |H|.

    Returns:
        The rows of A and of b.

    Raises:
        InputError: For another word.
    """
    if how not in COMPLEX:
        raise InputError(f"complex FRFs by {how!r}: expected one of {', '.join(COMPLEX)}")
    if how == "parts":
        difference = measured - model
        return (
            np.concatenate([slopes.real, slopes.imag]),
            np.concatenate([difference.real, difference.imag]),
        )
    size = np.abs(model)
    return np.real(np.conj(model)[:, None] * slopes) / size[:, None], np.abs(measured) - size

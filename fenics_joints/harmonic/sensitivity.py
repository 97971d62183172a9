"""Derivatives of periodic responses by parameters of the model, through the equations.

R(X(p), p) = 0 gives dX/dp = -R_X^-1 R_p: the exact Jacobian, and R_p from two evaluations of the
residual at the same X. No response is solved again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.harmonic.balance import Balance
from fenics_joints.harmonic.fourier import amplitude_gradient, differentiated
from fenics_joints.interfaces.model import InterfaceModel


@dataclass(frozen=True, repr=False)
class ResponseGradient:
    """Derivatives of responses by parameters.

    Attributes:
        coefficients: d X / d p, (N, n, K, parameters).
        parameters: Their names.
        result: The `HarmonicResult` it belongs to.
        indices: The responses in it, N of them.
    """

    coefficients: np.ndarray
    parameters: tuple[str, ...]
    result: object
    indices: tuple[int, ...]

    def __repr__(self) -> str:
        return f"ResponseGradient({len(self.indices)} responses by {', '.join(self.parameters)})"

    @property
    def _fourier(self):
        return self.result.balance.fourier

    def sensor_coefficients(self, sensor: str, kind: str = "displacement") -> np.ndarray:
        """Derivatives of the harmonics at a sensor, (N, parameters, K)."""
        row = self.result.model.row("sensors", sensor)
        change = np.einsum("n,pnkj->pjk", row, self.coefficients)
        omegas, periods = self.result.omegas[list(self.indices)], self._fourier.periods
        return differentiated(change, omegas[:, None], kind, periods)

    def amplitude(
        self, sensor: str, kind: str = "displacement", measure: str | None = None
    ) -> np.ndarray:
        """Derivatives of the amplitude at a sensor, (N, parameters).

        At a peak that is the derivative of the peak's amplitude too, whose frequency may move.
        """
        c = self.result.sensor_coefficients(sensor, kind)[list(self.indices)]
        measure = measure or self.result.measure
        gradient = amplitude_gradient(c, measure, self._fourier.periods)
        return np.einsum("pk,pjk->pj", gradient, self.sensor_coefficients(sensor, kind))

    def frf(self, sensor: str, kind: str = "displacement") -> np.ndarray:
        """Derivatives of the complex first harmonic over the force, (N, parameters)."""
        change = self.sensor_coefficients(sensor, kind)
        force = self.result.force_amplitudes[list(self.indices)]
        first = self._fourier.cosine()
        return (change[..., first] - 1j * change[..., first + 1]) / force[:, None]


def response_gradient(
    result,
    indices: Sequence[int],
    change: Callable[[Mapping[str, float]], InterfaceModel],
    values: Mapping[str, float],
    step: float,
) -> np.ndarray:
    """d X / d p at responses X, shape (N, n, K, parameters).

    Args:
        result: The `HarmonicResult`.
        indices: The responses in it, N of them.
        change: The model for values of the parameters.
        values: Present values.
        step: Relative step of the central differences.

    Raises:
        InputError: If a value is zero, or the changed model has another size.
        ConvergenceError: At a turning point, where there are none.
    """
    balance, pairs = result.balance, {}
    for key, value in values.items():
        if value == 0:
            raise InputError(f"{key} = 0: expected a value that a relative step can change.")
        pairs[key] = [
            _changed(balance, change, values, key, value * (1 + s * step)) for s in (1, -1)
        ]
    found = np.empty((len(indices), *balance.shape, len(values)))
    for i, index in enumerate(indices):
        X, omega = result.coefficients[index], result.omegas[index]
        J = balance.evaluate(X, omega)[1]  # the loads are the same ones
        by_values = np.empty((X.size, len(values)))
        for j, (key, (up, down)) in enumerate(pairs.items()):
            difference = _residual(up, X, omega) - _residual(down, X, omega)
            by_values[:, j] = difference.reshape(-1) / (2 * step * values[key])
        try:
            found[i] = -scipy.linalg.solve(J, by_values).reshape(*X.shape, -1)
        except scipy.linalg.LinAlgError as error:
            raise ConvergenceError(
                f"the response at {omega / (2 * np.pi):.6g} Hz has no derivatives: it is at a "
                "turning point",
                str(error),
            ) from error
    return found


def _residual(balance: Balance, X, omega) -> np.ndarray:
    return balance.evaluate(X, omega, jacobian=False)[0]


def _changed(balance: Balance, change, values, key: str, value: float) -> Balance:
    model = change({**values, key: value})
    if model.n_dofs != balance.model.n_dofs:
        raise InputError(
            f"{key}: the changed model has {model.n_dofs} degrees of freedom, expected "
            f"{balance.model.n_dofs}."
        )
    return balance.with_model(model)

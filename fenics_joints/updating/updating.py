"""Model updating: bounded, weighted least squares on frequencies.

Seed 001, eqs. 17 and 18, in the logarithms of the parameters, with adjoint sensitivities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal.sensitivity import Identifiability, identifiability
from fenics_joints.reduction.forward import Forward
from fenics_joints.structure.components import Parameter
from fenics_joints.updating.coordinates import LogScale

__all__ = ["Update", "update"]


@dataclass(frozen=True, eq=False)
class Update:
    """Parameters identified from one set of frequencies.

    Attributes:
        names: Names of the parameters.
        values: Their values, SI.
        log_sd: Standard deviations of their logarithms, data and regularisation together.
        information: Inverse covariance of the logarithms, shape (p, p).
        frequencies_hz: The model's frequencies, shape (m,).
        identifiability: What the data alone determine.
        iterations: Number of accepted and rejected steps.
        message: Why the iteration ended.
    """

    names: tuple[str, ...]
    values: np.ndarray
    log_sd: np.ndarray
    information: np.ndarray
    frequencies_hz: np.ndarray
    identifiability: Identifiability
    iterations: int
    message: str


def update(
    forward: Forward,
    parameters: Sequence[Parameter],
    measured_hz: np.ndarray,
    log_sd: np.ndarray,
    start: Mapping[str, float],
    *,
    centre: Mapping[str, float] | None = None,
    regularisation: float = 2.3,
    max_evaluations: int = 100,
) -> Update:
    """Bounded, weighted least squares (seed 001, eqs. 17 and 18) in log parameters.

    Args:
        forward: Frequencies and sensitivities.
        parameters: What is identified; positive.
        measured_hz: Measured frequencies, Hz, shape (m,); nan where missing.
        log_sd: Standard deviations of their logarithms, shape (m,): the weights.
        start: Values of all the model's parameters at the start.
        centre: Values about which the regularisation holds the parameters; the start by default.
        regularisation: Its standard deviation, of the logarithm.
        max_evaluations: Model evaluations before giving up.

    Raises:
        InputError: For a parameter that is not positive, or without data.
        ConvergenceError: If the iteration does not converge.
    """
    names = tuple(p.name for p in parameters)
    for name in names:
        if not start[name] > 0:
            raise InputError(f"start of {name} = {start[name]:g}: expected a positive value.")
    used = np.isfinite(measured_hz)
    if not used.any():
        raise InputError("frequencies: expected at least one measured value.")
    problem = _Problem(
        forward, names, start, np.log(measured_hz[used]), log_sd[used], used,
        np.log([(centre or start)[n] for n in names]), regularisation,
    )  # fmt: skip
    scale = problem.scale
    low, high = scale.bounds(parameters)
    x = np.clip(scale.inverse(np.log([start[n] for n in names])), low + 1e-9, high - 1e-9)
    result = least_squares(
        problem.residual, x, problem.slope, bounds=(low, high), x_scale=1.0,
        ftol=1e-8, xtol=1e-7, gtol=1e-7, max_nfev=max_evaluations,
    )  # fmt: skip
    if result.status <= 0:
        raise ConvergenceError(
            f"updating {', '.join(names)} did not converge in {max_evaluations} evaluations; "
            "start nearer, or identify fewer parameters",
            result.message,
        )
    return problem.finish(result)


class _Problem:
    """Residuals and slopes of one identification, in the coordinates of `LogScale`."""

    def __init__(self, forward, names, start, log_f, log_sd, used, centre, regularisation):
        self.forward, self.names, self.start = forward, names, dict(start)
        self.log_f, self.log_sd, self.used = log_f, log_sd, used
        self.centre, self.regularisation = centre, regularisation
        self.scale = LogScale(names, forward.model)
        position = list(forward.model.parameters)
        self.columns = [position.index(name) for name in names]

    def values(self, x) -> dict[str, float]:
        at = np.exp(self.scale.logs(x)).tolist()
        return {**self.start, **dict(zip(self.names, at, strict=True))}

    def residual(self, x):
        log_f, _ = self.forward(self.values(x))
        pull = (self.scale.logs(x) - self.centre) / self.regularisation
        return np.concatenate([(log_f[self.used] - self.log_f) / self.log_sd, pull])

    def slope(self, x):
        return self._log_slope(x) @ self.scale.slope(x)

    def _log_slope(self, x):
        """Slope of all residuals by the log parameters."""
        return np.concatenate([self.data_slope(x), np.eye(len(x)) / self.regularisation])

    def data_slope(self, x):
        """Whitened sensitivities by the log parameters."""
        _, by_values = self.forward(self.values(x))
        slope = by_values[self.used][:, self.columns] * np.exp(self.scale.logs(x))
        return slope / self.log_sd[:, None]

    def finish(self, result) -> Update:
        slope = self._log_slope(result.x)
        information = slope.T @ slope
        log_f, _ = self.forward(self.values(result.x))
        return Update(
            self.names,
            np.exp(self.scale.logs(result.x)),
            np.sqrt(np.diag(np.linalg.inv(information))),
            information,
            np.exp(log_f),
            identifiability(self.data_slope(result.x), self.names),
            int(result.nfev),
            _WORDS.get(result.status, result.message),
        )


#: What scipy's status says, in words.
_WORDS = {
    1: "converged: the gradient vanishes",
    2: "converged: the sum of squares no longer falls",
    3: "converged: the parameters no longer change",
    4: "converged: neither the sum of squares nor the parameters change any more",
}

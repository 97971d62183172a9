"""Updating on frequencies and FRFs as Machines 2022, section 4.1, does it.

Newton's iteration for A x = b (eqs. 15 to 17), in least squares with the weights of eqs. 18 to 20,
until eq. 14 holds. It has no bounds, knows no noise and does not limit its steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.errors import (
    ConvergenceError,
    InputError,
    flag,
    member,
    real,
    reals,
    wanted,
    whole,
)
from fenics_joints.measurements.target import Target
from fenics_joints.structure import Damping, Parameter
from fenics_joints.updating.equations import WeightedEquations, weighted_equations
from fenics_joints.updating.identification import Identification
from fenics_joints.updating.residuals import raw_rows, row_sd
from fenics_joints.updating.result import Update

#: Relative steps below which an iteration stands still; round-off.
_STILL = 1e-9
#: Tolerances of eq. 14 in standard deviations of the noise, where that is above their usual values;
#: chosen.
_EPS = 4.0
#: Share of the largest singular value below which a direction is open: round-off; and the relative
#: standard deviation that it gets, which stands for any.
_NULL, _LARGE = 1e-10, 1e3


def update_weighted(
    model,
    parameters: Sequence[Parameter],
    target: Target,
    start: Mapping[str, float],
    *,
    damping: Damping | None = None,
    w_f: float | np.ndarray = 1.0,
    w_H: float | np.ndarray = 1.0,
    complex_rows: str = "parts",
    eps_1: float = 1e-4,
    eps_2: float = 1e-2,
    step_limit: float | None = None,
    max_iterations: int = 50,
    n_modes: int | None = None,
    strict: bool = True,
) -> Update:
    """Machines 2022, section 4.1: eqs. 15 to 20 until eq. 14. Collective for a full model.

    The paper gives no numbers for w_f, w_H, eps_1 and eps_2 and leaves open how complex FRFs become
    real equations, and what is to happen when a step leaves the law's range: here it is the end.

    Args:
        model: A `Structure`, or a reduced one that was made for the target's sensors.
        parameters: What is identified; their bounds are not used.
        target: Frequencies, FRFs or both; shapes pair modes only.
        start: Values at the start, of the parameters and of any other of the model's that differs
            from its nominal value.
        damping: The model's damping.
        w_f: Weights w_f of eq. 19, one or one for each frequency.
        w_H: Weights w_H, one or one for each row of the FRFs.
        complex_rows: ``"parts"`` or ``"magnitude"``, see `real_rows`.
        eps_1: Tolerance of the relative error of every frequency (eq. 14).
        eps_2: Of every FRF value.
        step_limit: Largest change of a parameter in a step, relative to its value. Not in the
            paper, and None as there: no limit.
        max_iterations: Steps before giving up.
        n_modes: Modes to compute; by default enough for the target.
        strict: Whether an iteration that does not converge is an exception; else it is a result.

    Raises:
        InputError: For a parameter, start or data that cannot be.
        ConvergenceError: If eq. 14 is not reached, or a step leaves the model's range.
    """
    _check(target, w_f, w_H)
    whole("max_iterations", max_iterations)
    flag("strict", strict)
    for key, tolerance in (("eps_1", eps_1), ("eps_2", eps_2)):
        real(key, tolerance, above=0.0)
    member("complex_rows", complex_rows, ("parts", "magnitude"))
    if step_limit is not None:
        real("step_limit", step_limit, above=0.0)
    search = _Weighted(complex_rows, model, parameters, target, start, damping, n_modes)
    message = f"not converged: {max_iterations} iterations"
    for _ in range(max_iterations + 1):
        equations = search.equations(w_f, w_H)
        if search.is_reached(eps_1, eps_2):
            message = "converged: eq. 14 holds"
            break
        reason = search.step(equations, step_limit)
        if reason is not None:
            message = reason
            break
    found = search.finish(message)
    if strict and not found.converged:
        raise ConvergenceError(
            f"updating {', '.join(found.names)} by the weighted equations: {message}; start "
            "nearer, limit the steps, or use the other method"
        )
    return found


def _check(target: Target, w_f: float | np.ndarray, w_H: float | np.ndarray) -> None:
    """Refuse data that eq. 16 has no rows for, and weights that do not fit them."""
    if not isinstance(target, Target):
        raise wanted("target", target, "a Target")
    for kind in ("shapes", "damping"):
        if kind in target.kinds:
            raise InputError(f"data {kind!r}: expected frequencies and FRFs, the data of eq. 16")
    for key, weights in (("w_f", w_f), ("w_H", w_H)):
        if not reals(key, weights, least=0.0).size:
            raise wanted(key, weights, "one weight, or one for each row")
    if np.shape(w_f) not in ((), (len(target),)):
        raise wanted("w_f", w_f, f"one weight, or {len(target)}, one for each frequency")


class _Weighted(Identification):
    """The iteration of Machines 2022."""

    method = "weighted"

    def __init__(self, complex_rows: str, *args):
        super().__init__(*args)
        self.how, self.values = complex_rows, self.first
        #: Sum of squared residuals at the best values so far, and what belongs to these.
        self._best = (np.inf, None)
        self.prediction = self.predictor(self.coordinates.mapping(self.values))

    def equations(self, w_f, w_H) -> WeightedEquations:
        """Eq. 18 where the iteration stands."""
        A, b, n = raw_rows(self.target, self.prediction, self.how)
        idle = [name for name, a in zip(self.names, A.T, strict=True) if not a.any()]
        if idle:
            raise InputError(
                f"parameters {', '.join(idle)}: expected some that change a frequency or FRF of "
                "the data; the weights of eq. 20 do not exist for others"
            )
        self.system = weighted_equations(A, b, w_f=w_f, w_H=w_H, n_frequencies=n)
        conditions = self.system.condition_before, self.system.condition_after
        self.record(self.values, self.prediction, conditions)
        off, _ = self.residuals.chi2(self.prediction)
        if off < self._best[0]:
            self._best = off, (self.values, self.prediction, self.system)
        return self.system

    def is_reached(self, eps_1: float, eps_2: float) -> bool:
        """Eq. 14."""
        last = self.history[-1]
        frequencies = last.frequency_errors[np.isfinite(last.frequency_errors)]
        largest = 0.0 if self.target.frfs is None else last.frf_errors[1]
        return bool(np.all(np.abs(frequencies) <= eps_1) and largest <= eps_2)

    def step(self, equations: WeightedEquations, limit: float | None) -> str | None:
        """Take a step; why it cannot be taken, in words, or None."""
        change = equations.solve()
        if limit is not None:
            change = change / max(1.0, np.max(np.abs(change / self.values)) / limit)
        values = self.values + change
        if np.all(np.abs(change) <= _STILL * np.abs(self.values)):
            return (
                "not converged: the steps became zero where eq. 14 does not hold: no values of "
                "these parameters nearby bring the model as close to the test as it requires"
            )
        bad = ~np.isfinite(values) | (self.coordinates.log & (values <= 0))
        if bad.any():
            names = np.array(self.names)[bad]
            return f"diverged: a step makes {', '.join(names)} negative"
        try:
            self.prediction = self.predictor(self.coordinates.mapping(values))
        except (InputError, ConvergenceError) as error:
            return f"diverged: a step leaves the model's range: {error}"
        self.values = values
        return None

    def _open(self) -> np.ndarray:
        """Directions of the parameters that the equations leave open, at their size, (p, k).

        The least-norm solution does not move along them, which is no knowledge.
        """
        _, s, directions = np.linalg.svd(self.system.matrix)
        s = np.concatenate([s, np.zeros(len(directions) - len(s))])
        found = self.system.columns[:, None] * directions[s <= _NULL * s[0]].T
        return _LARGE * found / np.max(np.abs(found / self.values[:, None]), axis=0, initial=1e-300)

    def finish(self, message: str) -> Update:
        """The result where the iteration stands; if it did not converge, at its best values."""
        converged = message.startswith("converged")
        if not converged and self._best[1] is not None:
            self.values, self.prediction, self.system = self._best[1]
        inverse, sd = self.system.inverse(), row_sd(self.target, self.prediction, self.how)
        scaled = np.hstack([inverse * sd, self._open()])
        excess = self.excess(self.prediction, len(self.names))
        covariance = excess * scaled @ scaled.T
        return self.result(self.values, self.prediction, covariance, excess, converged, message)


def noise_tolerances(target: Target) -> dict[str, float]:
    """Tolerances of Machines 2022, eq. 14, that data with noise can meet: arguments of the fit."""
    used = np.isfinite(target.frequencies_hz)
    found = {"eps_1": 1e-4, "eps_2": 1e-2}
    if used.any():
        found["eps_1"] = max(1e-4, _EPS * float(target.log_sd[used].max()))
    if target.frfs is not None:
        sd = target.frfs.relative_sd[target.frfs.used]
        found["eps_2"] = max(1e-2, _EPS * float(sd.max()))
    return found

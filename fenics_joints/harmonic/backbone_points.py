"""A nonlinear mode at given amplitudes, and its derivatives by parameters of the model.

As `solve_backbone` without a force, but only where somebody measured; each point starts from its
neighbour, or from that of a near model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, reals, wanted
from fenics_joints.harmonic.backbone import FreeMode, free_mode
from fenics_joints.harmonic.balance import Balance
from fenics_joints.harmonic.corrector import NotFound, Settings, check_settings, correct
from fenics_joints.harmonic.result import check_sensor
from fenics_joints.interfaces.model import InterfaceModel

#: How often the way from one amplitude to the next is halved where it is too far.
_HALVINGS = 6
#: Relative step of the differences of the residual by a parameter.
_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class BackbonePoints:
    """A mode at some amplitudes.

    Attributes:
        problem: Its equations.
        amplitudes: Displacement at the sensor, m, (N,).
        z: Unknowns of each point, as of `FreeMode`, (N, size + 3).
        iterations: Newton steps to each, (N,).
    """

    problem: FreeMode
    amplitudes: np.ndarray
    z: np.ndarray
    iterations: np.ndarray

    def __len__(self) -> int:
        return len(self.amplitudes)

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Hz, (N,)."""
        return self.z[:, -3] / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """(N,)."""
        return self.z[:, -2]

    def by_parameters(
        self, change: Callable[[Mapping[str, float]], InterfaceModel], values: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of frequencies, Hz, and damping ratios by parameters, each (N, parameters).

        Through the equations R(z, p) = 0 at the same amplitude: no point is solved again.

        Args:
            change: The model for values of the parameters.
            values: Present values, none of them zero.

        Raises:
            ConvergenceError: Where a point has none.
        """
        N, p = len(self), len(values)
        turned = np.empty((N, p, 2))
        pairs = [
            [self._changed(change({**values, key: v * (1 + s * _STEP)})) for s in (1, -1)]
            for key, v in values.items()
        ]
        for i, z in enumerate(self.z):
            J = self.problem.evaluate(z)[1][:, :-1]
            right = np.column_stack(
                [
                    (up.evaluate(z, jacobian=False)[0] - down.evaluate(z, jacobian=False)[0])
                    / (2 * _STEP * v)
                    for (up, down), v in zip(pairs, values.values(), strict=True)
                ]
            )
            try:
                turned[i] = -scipy.linalg.solve(J, right)[-2:].T
            except scipy.linalg.LinAlgError as error:
                raise ConvergenceError(
                    f"the mode at {self.amplitudes[i]:.3g} m has no derivatives", str(error)
                ) from error
        return turned[..., 0] / (2 * np.pi), turned[..., 1]

    def _changed(self, model: InterfaceModel) -> FreeMode:
        if model.n_dofs != self.problem.balance.model.n_dofs:
            raise InputError(
                f"the changed model has {model.n_dofs} degrees of freedom, expected "
                f"{self.problem.balance.model.n_dofs}."
            )
        problem = copy(self.problem)
        problem.balance = self.problem.balance.with_model(model)
        return problem


def solve_backbone_at(
    model: InterfaceModel,
    amplitudes: Sequence[float],
    *,
    sensor: str | None = None,
    near: float | None = None,
    settings: Settings | None = None,
    initial: BackbonePoints | None = None,
    **equations,
) -> BackbonePoints:
    """A mode by the extended periodic motion concept, at given amplitudes.

    Args:
        model: The structure.
        amplitudes: First harmonic of displacement at the sensor, m, in any order.
        sensor, near, settings, equations: As for `solve_backbone`.
        initial: The same points of a near model.

    Raises:
        InputError: For an unknown name or a value out of range.
        ConvergenceError: If a point is not found.
    """
    a = reals("amplitudes", amplitudes, (None,), "m", above=0)
    if not len(a):
        raise InputError("amplitudes: expected one or more, m.")
    settings = check_settings(settings)
    balance = Balance(model, **equations)
    problem = free_mode(balance, check_sensor(model, sensor), near)
    if initial is not None and not isinstance(initial, BackbonePoints):
        raise wanted("initial", initial, "BackbonePoints of a similar model, or None")
    warm = initial is not None and initial.z.shape == (len(a), balance.size + 3)
    found, iterations, last = np.empty((len(a), balance.size + 3)), np.zeros(len(a), int), None
    for i in np.argsort(a, kind="stable"):
        q = np.log10(a[i])
        start = initial.z[i] if warm else last
        if start is None:
            start = np.append(problem.start(), q)
        try:
            last, iterations[i] = _reached(problem, start, q, settings)
        except NotFound as error:
            if not warm or last is None:
                raise _lost(a[i], error) from error
            try:
                last, iterations[i] = _reached(problem, last, q, settings)
            except NotFound as again:
                raise _lost(a[i], again) from again
        found[i] = last
    return BackbonePoints(problem, a, found, iterations)


def _reached(problem: FreeMode, z: np.ndarray, q: float, settings: Settings):
    """(the point at q, Newton steps), from another one, in as many steps as it takes."""
    steps, halvings, to = 0, 0, q
    while True:
        try:
            point = correct(problem, np.append(z[:-1], to), None, settings)
        except NotFound:
            halvings += 1
            if halvings > _HALVINGS or abs(to - z[-1]) < 1e-9:
                raise
            to = 0.5 * (z[-1] + to)
            continue
        z, steps = point.z, steps + point.iterations
        if to == q:
            return z, steps
        to = q


def _lost(amplitude: float, error: NotFound) -> ConvergenceError:
    return ConvergenceError(f"the mode at {amplitude:.3g} m is not found", error.why)

"""What a hypothesis predicts of one row of a test: frequencies, damping, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from fenics_joints.diagnosis.hypothesis import Hypothesis
    from fenics_joints.surrogate import Forward

__all__ = ["Prediction"]

_DIFFERENCE = 1e-5


@dataclass(frozen=True)
class _Look:
    """The model as one mode sees it; ``mode`` is None where all modes see the same.

    Attributes:
        values: The model's parameter values.
        log_f: ln of all frequencies, (m,).
        by_values: Their derivatives by the values, (m, n_parameters).
    """

    mode: int | None
    values: dict[str, float]
    log_f: np.ndarray
    by_values: np.ndarray


class Prediction:
    """Frequencies and damping at one condition.

    The damping ratio of a mode is that at rest plus half the loss factor of each lossy stiffness
    times its share of the mode's strain energy, and that share is d ln lambda / d ln stiffness
    = 2 d ln f / d ln stiffness (the modal strain energy method; Ungar and Kerwin, J. Acoust. Soc.
    Am. 34, 1962).

    Args:
        hypothesis: The hypothesis.
        forward: Predicts frequencies.
        z: Parameters in prior standard deviations, shape (d,).
        condition: The torque or level.
        baseline: Parameter values of the nominal model.
        row: Which of the hypothesis' conditions it is; None for one that was not measured.

    Attributes:
        log_f: ln of the frequencies, shape (m,).
    """

    def __init__(
        self,
        hypothesis: Hypothesis,
        forward: Forward,
        z: np.ndarray,
        condition: float,
        baseline: dict[str, float],
        row: int | None = None,
    ):
        self._hypothesis, self._forward, self._z = hypothesis, forward, z
        self._condition, self._baseline, self._row = condition, baseline, row
        looks = [self._look(None)]
        self.log_f = looks[0].log_f
        if hypothesis.amplitudes:
            looks += [self._look(i) for i in range(1, len(self.log_f))]
            self.log_f = np.array([look.log_f[i] for i, look in enumerate(looks)])
        self._looks = looks

    def _look(self, mode: int | None) -> _Look:
        values = self._values(self._z, mode)
        return _Look(mode, values, *self._forward(values))

    def _values(self, z, mode) -> dict[str, float]:
        return self._hypothesis.values(z, self._condition, self._baseline, self._row, mode)

    def _seen(self, i: int) -> _Look:
        """The model as mode i sees it."""
        return self._looks[i] if len(self._looks) > 1 else self._looks[0]

    @property
    def data(self) -> np.ndarray:
        """ln f, and behind it ln damping if the hypothesis predicts it; (m,) or (2 m,)."""
        if not self._hypothesis.damped:
            return self.log_f
        return np.concatenate([self.log_f, np.log(self._at_rest() + self._lost())])

    def slopes(self) -> np.ndarray:
        """Derivative of `data` by z, shape (data.size, d)."""
        chains = [self._chain(look.mode) for look in self._looks]
        if len(chains) == 1:
            by_z = self._looks[0].by_values @ chains[0]
        else:
            pairs = enumerate(zip(self._looks, chains, strict=True))
            by_z = np.array([look.by_values[i] @ chain for i, (look, chain) in pairs])
        if not self._hypothesis.damped:
            return by_z
        return np.concatenate([by_z, self._damping_slopes(chains)])

    def _chain(self, mode: int | None) -> np.ndarray:
        """Derivative of the model's values by z, shape (n_parameters, d): central differences of
        formulas, no model solution."""
        names = list(self._forward.model.parameters)
        chain = np.zeros((len(names), len(self._z)))
        for j in range(len(self._z)):
            if not self._hypothesis.acts(j, self._row, mode):
                continue  # another tightening's scatter, another mode's amplitude
            step = np.zeros(len(self._z))
            step[j] = _DIFFERENCE
            up, down = self._values(self._z + step, mode), self._values(self._z - step, mode)
            chain[:, j] = [(up[n] - down[n]) / (2 * _DIFFERENCE) for n in names]
        return chain

    # -- damping -------------------------------------------------------------------------------

    def _at_rest(self) -> np.ndarray:
        """Damping ratio of every mode without what the effects dissipate, (m,)."""
        place = self._hypothesis.places["dampings"]
        priors = self._hypothesis.dampings
        return np.array([p.value(z) for p, z in zip(priors, self._z[place], strict=True)])

    def _losses(self, z, mode) -> dict[str, float]:
        return self._hypothesis.losses(z, self._condition, mode)

    def _lost(self) -> np.ndarray:
        """Damping ratio of every mode from the effects, (m,)."""
        total = np.zeros(len(self.log_f))
        for i in range(len(total)):
            look = self._seen(i)
            for key, eta in self._losses(self._z, look.mode).items():
                total[i] += 0.5 * eta * self._share(look, i, key)
        return total

    def _share(self, look: _Look, i: int, key: str) -> float:
        """Share of mode i's strain energy that is in the stiffness ``key``; all for ``""``."""
        if not key:
            return 1.0
        column = list(self._forward.model.parameters).index(key)
        return max(2 * look.by_values[i, column] * look.values[key], 0.0)

    def _damping_slopes(self, chains) -> np.ndarray:
        """Derivative of ln damping by z, shape (m, d).

        That of a share g by the stiffness itself is taken as for two springs in series,
        dg / d ln stiffness = -g (1 - g), the joint and the rest: only the search's way and the
        width of the posterior rest on it.
        """
        at_rest, lost = self._at_rest(), self._lost()
        slopes = np.zeros((len(lost), len(self._z)))
        names = list(self._forward.model.parameters)
        for i in range(len(lost)):
            look = self._seen(i)
            chain = chains[i if len(chains) > 1 else 0]
            losses = self._losses(self._z, look.mode)
            if losses:
                slopes[i] = self._loss_slopes(look, i)
            shares = {key: self._share(look, i, key) for key in losses if key}
            rest = 1 - sum(shares.values())
            for key, g in shares.items():
                log_stiffness = chain[names.index(key)] / look.values[key]
                slopes[i] -= 0.5 * losses[key] * g * rest * log_stiffness
        place = self._hypothesis.places["dampings"]
        for i, prior in enumerate(self._hypothesis.dampings):
            slopes[i, place.start + i] += prior.spread * at_rest[i]
        return slopes / (at_rest + lost)[:, None]

    def _loss_slopes(self, look: _Look, i: int) -> np.ndarray:
        """Derivative of mode i's lost part by z at fixed shares, (d,)."""
        slope = np.zeros(len(self._z))
        for j in range(len(self._z)):
            if not self._hypothesis.acts(j, self._row, look.mode):
                continue
            step = np.zeros(len(self._z))
            step[j] = _DIFFERENCE
            up, down = (self._losses(self._z + s, look.mode) for s in (step, -step))
            by_z = {key: (up[key] - down[key]) / (2 * _DIFFERENCE) for key in up}
            slope[j] = sum(0.5 * eta * self._share(look, i, key) for key, eta in by_z.items())
        return slope

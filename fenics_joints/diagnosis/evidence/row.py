"""What a hypothesis predicts of a test at one condition, and the derivatives of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter

import numpy as np

from fenics_joints.diagnosis.effects.sensing import Sensing
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.reduction.forward import Forward, Slopes

__all__ = ["RowPrediction"]

#: Step of differences, in standard deviations of the prior, and of ln f.
_DIFFERENCE = 1e-5


@dataclass(frozen=True)
class _Look:
    """The model as one mode sees it; ``mode`` is None where all modes see the same.

    Attributes:
        values: The model's parameter values.
        log_f: ln of all frequencies, (m,).
        by_values: Their derivatives by the values, (m, n_parameters), or what has them.
    """

    mode: int | None
    values: dict[str, float]
    log_f: np.ndarray
    by_values: np.ndarray | Slopes


class RowPrediction:
    """What a hypothesis predicts at one condition: frequencies, damping, shapes.

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
        steady: Derivatives of the model's values that are the same at all conditions: filled by the
            first of them, used by the others.
        near: Of a condition near by, whose modes are followed; None to match them to the test's.

    Attributes:
        log_f: ln of the frequencies in the order of the test's columns, shape (m,).
    """

    def __init__(
        self,
        hypothesis: Hypothesis,
        forward: Forward,
        z: np.ndarray,
        condition: float,
        baseline: dict[str, float],
        row: int | None = None,
        steady: dict | None = None,
        near: RowPrediction | None = None,
    ):
        self._near = near
        self._steady, self._chains = steady, {}
        self._hypothesis, self._forward, self._z = hypothesis, forward, z
        self._condition, self._baseline, self._row = condition, baseline, row
        self._beyond, self._order = False, None
        looks = [self._look(None)]
        self._m = len(looks[0].log_f)
        sensing = self._sensing(z)
        if sensing is not None:
            self._order = sensing.order
            # With a mode that the test missed, the model has one more.
            self._beyond = int(np.max(sensing.order)) >= self._m
            looks = [self._look(None)] if self._beyond else looks
        log_f, self._at = looks[0].log_f, [0] * len(looks[0].log_f)
        if len(hypothesis.looks) > 1:
            looks += [self._look(i) for i in hypothesis.looks[1:]]
            self._at = hypothesis.look_of(len(log_f))
            log_f = np.array([looks[at].log_f[i] for i, at in enumerate(self._at)])
        self._looks = looks
        self._log_f = log_f
        self.log_f = self._ordered(log_f)

    def _ordered(self, by_mode: np.ndarray) -> np.ndarray:
        """Rows for the model's modes as rows for the test's columns."""
        return by_mode if self._order is None else by_mode[self._order]

    def _look(self, mode: int | None) -> _Look:
        values = self._values(self._z, mode)
        forward = self._forward.further if self._beyond else self._forward
        if self._near is None or self._beyond or self._near.same(values):
            return _Look(mode, values, *forward(values))
        *found, shapes = forward.follow(values, *self._near.followed)
        if mode is None:
            self.__dict__["followed"] = shapes, found[0]
        return _Look(mode, values, *found)

    def same(self, values: Mapping[str, float]) -> bool:
        """Whether the model's values are these, as all modes see them."""
        return self._looks[0].values == values

    @cached_property
    def followed(self) -> tuple[np.ndarray, np.ndarray]:
        """Shapes of its modes on the model's basis, (n_dofs, m), and ln of their frequencies, (m,),
        from which those of conditions near by are followed."""
        if self._near is not None and not self._beyond:
            return self._near.followed
        look = self._looks[0]
        return self._forward.vectors(look.values), look.log_f

    def _values(self, z, mode) -> dict[str, float]:
        return self._hypothesis.values(z, self._condition, self._baseline, self._row, mode)

    def _seen(self, i: int) -> _Look:
        """The model as mode i sees it."""
        return self._looks[self._at[i]]

    @property
    def data(self) -> np.ndarray:
        """ln f, and behind it ln damping if the hypothesis predicts it; (m,) or (2 m,)."""
        if not self._hypothesis.damped:
            return self.log_f
        return np.concatenate(
            [self.log_f, self._ordered(np.log(self._at_rest() + self._lost()))]
        )

    @cached_property
    def slopes(self) -> np.ndarray:
        """Derivative of `data` by z, shape (data.size, d)."""
        chains = [self._chain(look.mode) for look in self._looks]
        if len(chains) == 1:
            by_z = self._looks[0].by_values @ chains[0]
        else:
            by_z = np.array(
                [
                    _along(self._looks[at].by_values, [i], chains[at])[0]
                    for i, at in enumerate(self._at)
                ]
            )
        by_z = self._ordered(by_z)
        if not self._hypothesis.damped:
            return by_z
        return np.concatenate([by_z, self._ordered(self._damping_slopes(chains))])

    def _chain(self, mode: int | None) -> np.ndarray:
        """Derivative of the model's values by z, shape (n_parameters, d): central differences of
        formulas, no model solution."""
        if mode not in self._chains:
            self._chains[mode] = self._differences(mode)
        return self._chains[mode]

    def _differences(self, mode: int | None) -> np.ndarray:
        names = list(self._forward.model.parameters)
        pick = itemgetter(*names) if len(names) > 1 else lambda values: (values[names[0]],)
        chain = np.zeros((len(names), len(self._z)))
        known = self._steady if self._steady is not None and mode is None else {}
        for j in range(len(self._z)):
            if not self._hypothesis.acts(j, self._row, mode):
                continue  # another tightening's scatter, another mode's amplitude
            if j in known:
                chain[:, j] = known[j]
                continue
            chain[:, j] = self._difference(j, lambda z: np.array(pick(self._values(z, mode))))
        if known is self._steady and not known:
            known.update(self._same_anywhere(chain))
        return chain

    def _difference(self, j: int, function):
        """Central difference of a function of z by its entry ``j``."""
        step = np.zeros(len(self._z))
        step[j] = _DIFFERENCE
        return (function(self._z + step) - function(self._z - step)) / (2 * _DIFFERENCE)

    def _same_anywhere(self, chain: np.ndarray) -> dict[int, np.ndarray]:
        """Columns that no condition changes: of effects that do not depend on it, in values that no
        effect that does has a hand in."""
        changing = np.array([not same for same in self._hypothesis.steady], dtype=bool)
        touched = np.any(chain[:, changing] != 0, axis=1)
        return {
            j: chain[:, j]
            for j in np.flatnonzero(~changing)
            if not np.any(touched & (chain[:, j] != 0))
        }

    # -- shapes --------------------------------------------------------------------------------

    def shapes(self, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shapes at the sensors, each scaled to the measured one, and their derivatives by z.

        A shape's own scale is not known: it is chosen to leave the least residual, and with it
        the derivative loses its part along the shape.

        Args:
            measured: Shape (n_s, m), nan where a sensor was missing.

        Returns:
            Shapes, (n_s, m), and derivatives, (n_s, m, d).
        """
        look = self._looks[0]
        at, along, slope, by_along = self._forward.shapes(look.values, self._chain(look.mode))
        read = self._read(self._z, at, along)
        sensing = self._sensing(self._z)
        if sensing is not None:
            shifts = sensing.shifts[: len(along)]
            slope = slope + np.einsum("ws,wsmp->smp", shifts, by_along)
            slope = sensing.gains[:, None, None] * slope + self._sensing_slopes(at, along)
        return _scaled_to(measured, read, slope)

    def read_shapes(self, measured: np.ndarray) -> np.ndarray:
        """`shapes` without their derivatives, which are most of the work, (n_s, m)."""
        at, along = self._forward.seen_shapes(self._looks[0].values)
        read = self._read(self._z, at, along)
        return read * _scales(measured, read)[0]

    def _sensing(self, z) -> Sensing | None:
        """How the test reads the structure; None if as it is."""
        if not self._hypothesis.senses:
            return None
        sensors = self._forward.sensors
        count = 0 if sensors is None else len(sensors)
        return self._hypothesis.sensing(z, self._m, count)

    def _read(self, z, at, along) -> np.ndarray:
        """What the sensors say, (n_s, m)."""
        sensing = self._sensing(z)
        if sensing is None:
            return at
        moved = np.einsum("ws,wsm->sm", sensing.shifts[: len(along)], along)
        return sensing.gains[:, None] * (at + moved)

    def _sensing_slopes(self, at, along) -> np.ndarray:
        """Derivative of what the sensors say by z, the structure unmoved, (n_s, m, d)."""
        slope = np.zeros((*at.shape, len(self._z)))
        for j, (effect, _) in enumerate(self._hypothesis.priors):
            if effect.sensing is not None:
                slope[:, :, j] = self._difference(j, lambda z: self._read(z, at, along))
        return slope

    # -- damping -------------------------------------------------------------------------------

    def _at_rest(self) -> np.ndarray:
        """Damping ratio of every mode without what the effects dissipate, (m,)."""
        place = self._hypothesis.places["dampings"]
        priors = self._hypothesis.dampings
        return np.array([p.value(z) for p, z in zip(priors, self._z[place], strict=True)])

    def _losses(self, z, i: int, mode) -> dict[str, float]:
        hz = float(np.exp(self._log_f[i]))
        return self._hypothesis.losses(z, self._condition, hz, mode)

    def _lost(self) -> np.ndarray:
        """Damping ratio of every mode from the effects, (m,)."""
        return np.array([self._lost_in(self._z, i) for i in range(len(self._log_f))])

    def _lost_in(self, z, i: int) -> float:
        """Damping ratio of mode i from the effects at ``z``, its shares those at hand."""
        look = self._seen(i)
        losses = self._losses(z, i, look.mode)
        return sum(0.5 * eta * self._share(look, i, key) for key, eta in losses.items())

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
            chain = chains[self._at[i]]
            losses = self._losses(self._z, i, look.mode)
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
            if self._hypothesis.acts(j, self._row, look.mode) and self._hypothesis.loses(j):
                slope[j] = self._difference(j, lambda z: self._lost_in(z, i))
        return slope


def _along(by_values: np.ndarray | Slopes, rows: Sequence[int], along: np.ndarray) -> np.ndarray:
    """Derivatives of some modes along directions, (len(rows), p)."""
    if isinstance(by_values, Slopes):
        return by_values.along(rows, along)
    return by_values[rows] @ along


def _scales(measured, read) -> tuple[np.ndarray, np.ndarray]:
    """Factors that bring columns nearest to the measured ones, and their squared lengths, (m,)."""
    there = np.isfinite(measured)
    y, x = np.where(there, measured, 0.0), np.where(there, read, 0.0)
    square = np.maximum(np.sum(x**2, axis=0), 1e-300)
    return np.sum(x * y, axis=0) / square, square


def _scaled_to(measured, read, slope) -> tuple[np.ndarray, np.ndarray]:
    """Columns scaled to the measured ones, and derivatives without their part along them."""
    there = np.isfinite(measured)
    y = np.where(there, measured, 0.0)
    x = np.where(there, read, 0.0)
    scale, square = _scales(measured, read)
    dx = np.where(there[:, :, None], slope, 0.0)
    by_x, by_y = np.einsum("im,imk->mk", x, dx), np.einsum("im,imk->mk", y, dx)
    by_scale = (by_y - 2 * scale[:, None] * by_x) / square[:, None]
    return read * scale, scale[None, :, None] * slope + read[:, :, None] * by_scale[None]

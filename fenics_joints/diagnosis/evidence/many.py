"""What a hypothesis predicts of a test at many values of its parameters together.

As `fenics_joints.diagnosis.evidence.prediction`, for a model that solves for many at a time
(`fenics_joints.reduction.LeanForward`): thousands of predictions of all modes a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_joints.diagnosis.effects.sensing import Sensing
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.errors import InputError
from fenics_joints.reduction import LeanForward
from fenics_joints.reduction.many import Change, ManyModes, change

__all__ = ["ManyPredictions"]

#: Step of differences, in standard deviations of the prior, and relative difference that is
#: round-off.
_STEP, _SAME = 1e-5, 1e-8


@dataclass(frozen=True, eq=False)
class _Look:
    """The model as one mode sees it; see `prediction._Look`."""

    mode: int | None
    modes: ManyModes
    along: dict[int, Change]
    values: dict[str, np.ndarray]

    @cached_property
    def slopes(self) -> dict[int, np.ndarray]:
        """Derivatives of ln f by the parameters that act, each (b, m)."""
        return {j: self.modes.slope(each) for j, each in self.along.items()}


class ManyPredictions:
    """Predictions of one hypothesis.

    Args:
        hypothesis: The hypothesis.
        forward: Predicts.
        evidence: The test.
        baseline: Parameter values of the nominal model.
    """

    def __init__(
        self, hypothesis: Hypothesis, forward: LeanForward, evidence: Evidence,
        baseline: dict[str, float],
    ):  # fmt: skip
        self.hypothesis, self.forward, self.evidence = hypothesis, forward, evidence
        self.baseline, self._singly = baseline, False
        effects = (*hypothesis.nuisances, *hypothesis.effects)
        self._changes = bool(hypothesis.tightenings or hypothesis.amplitudes) or any(
            e.depends_on_condition or e.by_level or e.drifts for e in effects
        )

    def __call__(
        self, z: np.ndarray, by: Sequence[int] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Everything in `Evidence.data`, (b, N), and its derivatives by some of z, (b, N, p).

        Args:
            z: Parameters in prior standard deviations, (b, d); nan stands where the model lacks a
                mode that the test saw, and beyond the laws' limits.
            by: Which of them derivatives are wanted by.
        """
        try:
            return self._together(np.asarray(z, dtype=float), list(by))
        except (InputError, np.linalg.LinAlgError):
            # One of them is beyond a law's limit, such as a specimen's.
            if len(z) == 1:
                n = len(self.evidence.data)
                return np.full((1, n), np.nan), np.full((1, n, len(by)), np.nan)
            halves = (self(half, by) for half in np.array_split(z, 2))
            return tuple(map(np.concatenate, zip(*halves, strict=True)))

    def _together(self, z, by) -> tuple[np.ndarray, np.ndarray]:
        evidence, rows, shapes = self.evidence, [], []
        for row in range(len(evidence.conditions)):
            if row and not self._changes:
                rows.append(rows[0])
            else:
                looks = self._looks(z, row, by)
                rows.append(self._row(z, row, looks, by))
            if evidence.shapes is not None and row == evidence.shape_row:
                shapes = [self._shapes(z, looks[0], by)]
        blocks = [*self._by_kind(rows), *shapes, *self._masses(z, by)]
        return tuple(np.concatenate(part, axis=1) for part in zip(*blocks, strict=True))

    def _by_kind(self, rows) -> list[tuple[np.ndarray, np.ndarray]]:
        """Frequencies of all conditions, then damping of all."""
        m = self.evidence.shape[1]
        kinds = range(0, rows[0][0].shape[1], m)
        return [(data[:, k : k + m], slope[:, k : k + m]) for k in kinds for data, slope in rows]

    # -- the model -----------------------------------------------------------------------------

    def _looks(self, z, row: int, by) -> list[_Look]:
        return [self._look(z, row, mode, by) for mode in self.hypothesis.looks]

    def _look(self, z, row: int, mode, by) -> _Look:
        values = self._values(z, row, mode, checked=True)
        modes, along = self.forward.many(values), {}
        for j in by:
            if self.hypothesis.acts(j, row, mode):
                low, high = (self._own(self._values(moved, row, mode)) for moved in _moved(z, j))
                along[j] = change(self.forward.model, low, high, 2 * _STEP)
        return _Look(mode, modes, along, values)

    def _own(self, values) -> dict[str, np.ndarray]:
        return {name: values[name] for name in self.forward.model.parameters}

    def _values(self, z, row, mode=None, checked: bool = False) -> dict[str, np.ndarray]:
        """The model's parameter values, each (b,): by effects that can be put in at many values
        together, as all of the library can, or else one by one."""
        h, condition = self.hypothesis, self.evidence.conditions[row or 0]

        def one(point) -> dict[str, float]:
            return h.values(point, condition, self.baseline, row, mode)

        if not self._singly:
            try:
                found = one(z.T)
                each = (len(z),)
                many = {k: v if np.shape(v) == each else np.full(each, v)
                        for k, v in found.items()}  # fmt: skip
                if not checked or _alike(many, one, z):
                    return many
            except (TypeError, ValueError):
                pass
            self._singly = True
        each = [one(point) for point in z]
        return {name: np.array([values[name] for values in each]) for name in each[0]}

    # -- frequencies and damping -----------------------------------------------------------------

    def _row(self, z, row: int, looks: Sequence[_Look], by) -> tuple[np.ndarray, np.ndarray]:
        """`RowPrediction.data` and its slopes, (b, m) or (b, 2 m)."""
        order, further = self._order(z), None
        if order is not None and np.max(order) >= self.evidence.shape[1]:
            # With a mode that the test missed, the model has one more.
            modes = self.forward.further.many(looks[0].values)
            further = _Look(None, modes, looks[0].along, looks[0].values)
        own = self.hypothesis.look_of(self.evidence.shape[1])
        looks = [further or looks[at] for at in own]
        log_f = _of_each(looks, lambda look: look.modes.log_f)
        slopes = [
            _of_each(looks, lambda look, j=j: look.slopes.get(j, np.zeros_like(log_f)))
            for j in by
        ]
        slope = np.stack(slopes, axis=2) if by else np.zeros((*log_f.shape, 0))
        blocks = [(log_f, slope)]
        if self.hypothesis.damped:
            # Where damping was not measured nobody asks what the effects dissipate.
            there = np.flatnonzero(np.isfinite(self.evidence.log_damping[row]))
            modes = there if order is None else range(log_f.shape[1])
            blocks.append(self._damping(z, row, looks, log_f, by, modes))
        if order is not None:
            blocks = [(data[:, order], slope[:, order]) for data, slope in blocks]
        return tuple(np.concatenate(part, axis=1) for part in zip(*blocks, strict=True))

    def _order(self, z) -> np.ndarray | None:
        h = self.hypothesis
        if not h.senses:
            return None
        count = 0 if self.forward.sensors is None else len(self.forward.sensors)
        return h.sensing(z[0], self.evidence.shape[1], count).order

    def _damping(self, z, row, looks, log_f, by, modes) -> tuple[np.ndarray, np.ndarray]:
        """ln of the damping ratios, (b, m), and their slopes; see `RowPrediction`. What the
        effects dissipate counts in some modes only."""
        h = self.hypothesis
        start = h.places["dampings"].start
        at_rest = np.stack(
            [p.value(z[:, start + i]) for i, p in enumerate(h.dampings)], axis=1
        )
        lost, slope = np.zeros_like(at_rest), np.zeros((*at_rest.shape, len(by)))
        for i in modes:
            look = looks[i]
            losses = self._losses(z, row, log_f[:, i], look.mode)
            shares = {key: self._share(look, i, key) for key in losses}
            lost[:, i] = sum((0.5 * eta * shares[key] for key, eta in losses.items()), 0.0)
            for k, j in enumerate(by if losses else ()):
                slope[:, i, k] = self._loss_slope(z, row, log_f[:, i], look, losses, shares, j)
        total = at_rest + lost
        for k, j in enumerate(by):
            i = j - start
            if 0 <= i < len(h.dampings):
                slope[:, i, k] += h.dampings[i].spread * at_rest[:, i]
        return np.log(total), slope / total[:, :, None]

    def _losses(self, z, row, log_f, mode) -> dict[str, np.ndarray]:
        h, condition, hz = self.hypothesis, self.evidence.conditions[row], np.exp(log_f)
        if not self._singly:
            try:
                found = h.losses(z.T, condition, hz, mode)
                return {key: np.broadcast_to(eta, len(z)) for key, eta in found.items()}
            except (TypeError, ValueError):
                self._singly = True
        each = [h.losses(point, condition, f, mode) for point, f in zip(z, hz, strict=True)]
        return {key: np.array([found[key] for found in each]) for key in each[0]}

    @staticmethod
    def _share(look: _Look, i: int, key: str) -> np.ndarray:
        """Share of mode i's strain energy in the stiffness ``key``, (b,); all for ``""``."""
        return look.modes.share(key)[:, i] if key else np.ones(len(look.modes.index))

    def _loss_slope(self, z, row, log_f, look, losses, shares, j) -> np.ndarray:
        """Derivative of mode i's lost part by parameter ``j``, (b,); see
        `RowPrediction._damping_slopes`."""
        found, h = np.zeros(len(z)), self.hypothesis
        if not h.acts(j, row, look.mode):
            return found
        if h.loses(j):
            low, high = (self._losses(moved, row, log_f, look.mode) for moved in _moved(z, j))
            for key, share in shares.items():
                found = found + 0.5 * (high[key] - low[key]) / (2 * _STEP) * share
        moved = [self._values(each, row, look.mode) for each in _moved(z, j)]
        rest = 1 - sum(share for key, share in shares.items() if key)
        for key, share in shares.items():
            if key:
                log_stiffness = np.log(moved[1][key] / moved[0][key]) / (2 * _STEP)
                found = found - 0.5 * losses[key] * share * rest * log_stiffness
        return found

    # -- shapes and masses -----------------------------------------------------------------------

    def _shapes(self, z, look: _Look, by) -> tuple[np.ndarray, np.ndarray]:
        """`RowPrediction.shapes` flat, (b, n_s m), and slopes by what is no effect in the test."""
        model, measured, modes = self.forward.model, self.evidence.shapes, look.modes
        gains, shifts = self._read(z)

        def read(shapes):
            at = model.sensor_rows @ shapes
            if shifts is not None:
                at = at + shifts[:, :, None] * (model.shift_rows @ shapes)
            return at if gains is None else gains[:, :, None] * at

        found = read(modes.x)
        there = np.isfinite(measured)
        y, seen = np.where(there, measured, 0.0), np.where(there, found, 0.0)
        square = np.maximum(np.sum(seen**2, axis=1), 1e-300)
        scale = np.sum(seen * y, axis=1) / square
        slope = np.zeros((*found.shape, len(by)))
        for k, j in enumerate(by):
            if j not in look.along:
                continue
            d = read(modes.shape_slope(look.along[j]))
            dx = np.where(there, d, 0.0)
            change = np.sum(y * dx, axis=1) - 2 * scale * np.sum(seen * dx, axis=1)
            slope[..., k] = scale[:, None] * d + found * (change / square)[:, None]
        found = np.where(modes.good[:, None, None], found * scale[:, None], np.nan)
        flat = len(z), measured.size
        return found.reshape(flat), slope.reshape(*flat, len(by))

    def _read(self, z) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Gains and shifts of the sensors, each (b, n_s); None where they are as they should."""
        h = self.hypothesis
        if not h.senses:
            return None, None
        count = len(self.forward.sensors)
        found = [h.sensing(point, self.evidence.shape[1], count) for point in z]
        true = Sensing.true(self.evidence.shape[1], count)
        return tuple(
            None if np.array_equal(all_, np.broadcast_to(none, all_.shape)) else all_
            for all_, none in (
                (np.array([each.gains for each in found]), true.gains),
                (np.array([each.shifts for each in found]), true.shifts),
            )
        )

    def _masses(self, z, by) -> list[tuple[np.ndarray, np.ndarray]]:
        weighed = self.evidence.weighed
        if not weighed:
            return []

        def at(z) -> np.ndarray:
            values = self._values(z, None)
            masses = (np.broadcast_to(w.log_mass(values), len(z)) for w in weighed)
            return np.stack(list(masses), axis=1)

        slope = np.zeros((len(z), len(weighed), len(by)))
        for k, j in enumerate(by):
            if j < self.hypothesis.own.stop:
                low, high = (at(moved) for moved in _moved(z, j))
                slope[..., k] = (high - low) / (2 * _STEP)
        return [(at(z), slope)]


def _of_each(looks: Sequence[_Look], what) -> np.ndarray:
    """What each mode has where it is looked at by itself, (b, m)."""
    if all(look is looks[0] for look in looks):
        return what(looks[0])
    return np.stack([what(look)[:, i] for i, look in enumerate(looks)], axis=1)


def _moved(z, j: int) -> tuple[np.ndarray, np.ndarray]:
    step = np.where(np.arange(z.shape[1]) == j, _STEP, 0.0)
    return z - step, z + step


def _alike(many, one, z) -> bool:
    """Whether values of a few points are what they are one by one."""
    for i in {0, len(z) // 2, len(z) - 1}:
        for name, value in one(z[i]).items():
            if not abs(many[name][i] - value) <= _SAME * abs(value):
                return False
    return True

"""Predictions of a test by a hypothesis, at many values of its parameters together.

Frequencies, damping, shapes and single numbers, and their derivatives. All points, and all
conditions of the test, are solved for together (`fenics_joints.reduction.BatchPrediction`):
thousands of predictions of all modes a second. A single point is a batch of one.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace

import numpy as np
from numpy.polynomial import chebyshev

from fenics_joints.diagnosis.effects.effect import Sensing
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.observations import scalars_at
from fenics_joints.diagnosis.thresholds import ROUND_OFF, STEP
from fenics_joints.errors import InputError
from fenics_joints.reduction.batch_modes import BatchModes, Change
from fenics_joints.reduction.prediction import Followed, ModalPrediction, batched


@dataclass(frozen=True, eq=False)
class ModelEvaluation:
    """The model at many points, at the level of one mode or at the common one.

    Attributes:
        mode: The mode whose level it is; None for the common level.
        modes: The model's modes.
        values: The model's parameter values, each (b,).
        along: Changes of the model along the directions of parameters; None if none moves it.
        columns: Index of each parameter's direction among them.
        felt: Points at which a parameter moves the model, (b, 1), where these are not all.
    """

    mode: int | None
    modes: BatchModes
    values: dict[str, np.ndarray]
    along: Change | None
    columns: dict[int, int]
    felt: dict[int, np.ndarray]

    def slopes(self, by: Sequence[int]) -> np.ndarray:
        """Derivatives of ln f by some parameters, (b, m, p)."""
        b, m = self.modes.index.shape
        found = np.zeros((b, m, len(by)))
        there = [k for k, j in enumerate(by) if j in self.columns]
        if there:
            columns = [self.columns[by[k]] for k in there]
            found[:, :, there] = self._all_slopes[:, :, columns]
        for k, j in enumerate(by):
            if j in self.felt:
                found[:, :, k] = np.where(self.felt[j], found[:, :, k], 0.0)
        return found

    @cached_property
    def _all_slopes(self) -> np.ndarray:
        """Along every direction, (b, m, n)."""
        return self.modes.slopes(self.along)


def model_of(names: Iterable[str]) -> SimpleNamespace:
    """A model of which nothing is known but its parameters.

    Args:
        names: Their names.
    """
    return SimpleNamespace(parameters=dict.fromkeys(names), n_dofs=1)


@dataclass(frozen=True, eq=False)
class PointwiseModes:
    """Modes without shapes, in place of `fenics_joints.reduction.batch_modes.BatchModes`.

    Attributes:
        values: Values of the model's parameters, each (b,).
        log_f: ln f, (b, m).
        by_values: Derivatives by these values, (b, m, n).
    """

    values: Mapping[str, np.ndarray]
    log_f: np.ndarray
    by_values: np.ndarray

    @property
    def index(self) -> np.ndarray:
        """Mode of each of the test's, (b, m): in order."""
        return np.zeros(self.log_f.shape, dtype=int)

    @property
    def x(self) -> np.ndarray:
        """Shapes, (b, 1, m); there are none."""
        b, m = self.log_f.shape
        return np.zeros((b, 1, m))

    def slopes(self, along: np.ndarray) -> np.ndarray:
        """Derivatives of `log_f`, (b, m, p), along directions of the values, (b, n, p)."""
        moves = np.any(along != 0, axis=(0, 2))  # others may have no derivative
        return np.einsum("bmn,bnp->bmp", self.by_values[:, :, moves], along[:, moves])

    def share(self, name: str) -> np.ndarray:
        """See `BatchModes.share`."""
        column = list(self.values).index(name)
        return np.maximum(2 * self.by_values[:, :, column] * self.values[name][:, None], 0.0)


class PointwiseForward:
    """A forward for `fit` whose subclass has ``model``, from `model_of`, and is called with values
    by name: it returns ln f, (m,), and its derivatives by the model's parameters, (m, n)."""

    batches, sensors, further = True, None, None

    def batch(self, values: Mapping[str, np.ndarray], every=True, followed=None) -> PointwiseModes:
        """See `BatchPrediction.batch`."""
        table = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        each = [self(dict(zip(table, row, strict=True))) for row in np.stack([*table.values()], 1)]
        own = {name: table[name] for name in self.model.parameters}
        return PointwiseModes(own, *(np.array(part) for part in zip(*each, strict=True)))

    def change(self, low, high, width: float, count: int = 1) -> np.ndarray:
        """Derivatives of the values along directions, (b, n, count); a value that is nan, since
        nothing has it, does not change."""
        pairs = [(low[name], high[name]) for name in self.model.parameters]
        moved = [np.where(np.isnan(a) & np.isnan(b), 0.0, b - a) / width for a, b in pairs]
        return np.reshape(moved, (len(moved), count, -1)).transpose(2, 0, 1)


#: Entries of the matrices of one batch, which should fit into the processor's cache. [numerical:
#: chosen for memory]
_ROOM = 4_000_000
#: Number of torques between which others are interpolated, and their reach beyond the test's, in
#: standard deviations of the tightening's scatter. [numerical: chosen; checked by
#: `HypothesisPredictor`]
_TORQUES, _SCATTERED = 4, 2.0


class ManyPredictions:
    """Predictions of one hypothesis.

    The damping ratio of a mode is that at rest plus half the loss factor of each lossy stiffness
    times its share of the mode's strain energy, and that share is d ln lambda / d ln stiffness
    = 2 d ln f / d ln stiffness (the modal strain energy method; Ungar and Kerwin, J. Acoust. Soc.
    Am. 34, 1962). A shape's own scale is not known: it is chosen to leave the least residual, and
    with it the derivative loses its part along the shape.

    Args:
        hypothesis: The hypothesis.
        forward: Predicts frequencies and shapes: of an `ArrayModel`, or with ``many`` and
            ``change`` as `BatchPrediction` has them.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        between: Whether many torques are interpolated between few, where that can be.
    """

    def __init__(
        self,
        hypothesis: Hypothesis,
        forward: ModalPrediction,
        evidence: Evidence,
        baseline: dict[str, float],
        between: bool = False,
    ):
        self.hypothesis, self.forward, self.evidence = hypothesis, batched(forward), evidence
        self.baseline = baseline
        #: Whether they are.
        self.between = between and self._is_alike
        #: Whether an effect has to be put in at one point at a time.
        self._singly = False
        self._filled: dict[tuple[float, int], np.ndarray] = {}

    def __call__(self, z: np.ndarray, by: Sequence[int] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Everything in `Evidence.data`, held out or not, (b, N), and its derivatives by some of z,
        (b, N, p).

        Args:
            z: Parameters in prior standard deviations, (b, d); nan stands where the model lacks a
                mode that the test saw, and beyond the laws' limits.
            by: Which of them derivatives are wanted by.
        """
        most = max(_ROOM // self.forward.model.n_dofs**2, 1)
        if len(z) > most:
            return self._parted(z, by, -(-len(z) // most))
        try:
            return self._solved(z, by)
        except (InputError, np.linalg.LinAlgError):
            # One of the points is beyond a limit of a law.
            if len(z) == 1:
                n = len(self.evidence.data)
                return np.full((1, n), np.nan), np.full((1, n, len(by)), np.nan)
            return self._parted(z, by, 2)

    def at(self, z: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """The same at one point, (N,), and its derivatives by all of z, (N, d).

        Args:
            z: Parameters in prior standard deviations, (d,).
            slopes: Whether derivatives are wanted; they are (N, 0) otherwise.

        Raises:
            InputError: If the model lacks a mode that the test saw, or an antiresonance, or the
                point is beyond a law's limit.
        """
        data, along = self._solved([z], range(len(z)) if slopes else ())
        if not np.all(np.isfinite(data)):
            raise InputError(
                f"{self.hypothesis.label or 'baseline model'}: it lacks a mode that the test has, "
                "or an antiresonance, at these values of its parameters."
            )
        return data[0], along[0]

    def values(self, z: np.ndarray, row: int) -> dict[str, np.ndarray]:
        """The model's parameter values at points (b, d) and one condition, each (b,)."""
        return self._values(z, np.full(len(z), row), checked=True)

    def _solved(self, z, by) -> tuple[np.ndarray, np.ndarray]:
        self._filled.clear()
        z, by = np.asarray(z, dtype=float), list(by)
        return self._interpolated(z, by) if self.between else self._together(z, by)

    def _parted(self, z, by, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The same, part by part."""
        parts = (self(part, by) for part in np.array_split(z, count))
        return tuple(map(np.concatenate, zip(*parts, strict=True)))

    @property
    def _is_alike(self) -> bool:
        """Whether rows differ in their torque alone, and are many."""
        h, test = self.hypothesis, self.evidence
        followed = test.shapes is not None or test.tracking[-1][1] is not None
        effects = (*h.nuisances, *h.effects)
        others = any(h.known) or any(e.by_level or e.drifts for e in effects)
        several = h.varies and len(test.conditions) > _TORQUES + 1 and np.all(test.conditions > 0)
        return several and not followed and not others

    def _interpolated(self, z, by) -> tuple[np.ndarray, np.ndarray]:
        """Predictions at all torques from those at a few, (b, N), and derivatives, (b, N, p):
        polynomials in the torque's logarithm through Chebyshev's points."""
        h, test, (n, m) = self.hypothesis, self.evidence, self.evidence.shape
        log_t = np.log(test.conditions)
        far = _SCATTERED * (h.scatter if h.tightenings else 0.0)
        low, high = log_t.min() - far, log_t.max() + far
        unit = -np.cos(np.pi * (np.arange(_TORQUES) + 0.5) / _TORQUES)
        nodes = 0.5 * (low + high) + 0.5 * (high - low) * unit
        part = _at(h, self.forward, np.exp(nodes), self.baseline, m)
        place = h.places["tightenings"]
        tightened = np.arange(place.start, place.stop)
        kept = np.delete(np.arange(z.shape[1]), tightened)
        others = [j for j in by if j not in tightened]
        data, slopes = part(z[:, kept], [int(np.searchsorted(kept, j)) for j in others])
        b, kinds = len(z), data.shape[1] // (_TORQUES * m)
        data = data.reshape(b, kinds, _TORQUES, m)
        slopes = slopes.reshape(b, kinds, _TORQUES, m, len(others))
        felt = np.broadcast_to(log_t, (b, n)).copy()
        if h.tightenings:
            felt += h.scatter * z[:, tightened]
        x = (2 * felt - low - high) / (high - low)
        fit = np.linalg.inv(chebyshev.chebvander(unit, _TORQUES - 1))
        weight = chebyshev.chebvander(x, _TORQUES - 1) @ fit
        found = np.einsum("bnk,bckm->bcnm", weight, data)
        every = np.zeros((*found.shape, len(by)))
        at = [by.index(j) for j in others]
        every[..., at] = np.einsum("bnk,bckmp->bcnmp", weight, slopes)
        if h.tightenings:
            derivative = chebyshev.chebder(np.eye(_TORQUES), scl=2 / (high - low))
            change = chebyshev.chebvander(x, _TORQUES - 2) @ derivative @ fit
            change = h.scatter * np.einsum("bnk,bckm->bcnm", change, data)
            for i, j in enumerate(by):
                if j in tightened:
                    row = j - place.start
                    every[:, :, row, :, i] = change[:, :, row]
        rows = found.reshape(b, -1), every.reshape(b, kinds * n * m, len(by))
        blocks = [rows, *self._scalars(z, by)]
        return tuple(np.concatenate(part, axis=1) for part in zip(*blocks, strict=True))

    def _together(self, z, by) -> tuple[np.ndarray, np.ndarray]:
        """At all rows, as many of them together as there is room for."""
        evidence, found, shapes, seen = self.evidence, {}, [], {}
        for rows in self._groups(len(z)):
            with_shapes = evidence.shapes is not None and rows[0] == self._shape_row
            # One row after the other, each at all points.
            points, row = np.tile(z, (len(rows), 1)), np.repeat(rows, len(z))
            followed = self._followed(rows, len(z), seen)
            with_slopes = with_shapes and bool(by)  # of shapes, which take all modes
            views = [
                self._evaluate(points, row, i, by, with_slopes, followed)
                for i in self.hypothesis.views
            ]
            if evidence.tracking[-1][1] is not None:
                seen |= _by_row(rows, views[0].modes.x, views[0].modes.log_f)
            found |= _by_row(rows, *self._rows(points, row, views, by))
            if with_shapes:
                shapes = [self._shapes(z, views[0], by)]
        count, varies = len(evidence.conditions), self.hypothesis.varies
        rows = [found[row if varies else 0] for row in range(count)]
        blocks = [*self._by_kind(rows), *shapes, *self._scalars(z, by)]
        return tuple(np.concatenate(part, axis=1) for part in zip(*blocks, strict=True))

    @property
    def _shape_row(self) -> int:
        return self.evidence.shape_row if self.hypothesis.varies else 0

    def _groups(self, count: int) -> list[list[int]]:
        """Rows that are solved for together at so many points; the row of the shapes alone, since
        derivatives of shapes take all modes."""
        tracking = self.evidence.tracking if self.hypothesis.varies else ((0, None),)
        rows = [row for row, _ in tracking]
        alone = [] if self.evidence.shapes is None else [self._shape_row]
        if tracking[-1][1] is not None:
            alone = rows[:1]  # the others are followed from it
        rows = [row for row in rows if row not in alone]
        size = max(_ROOM // (count * self.forward.model.n_dofs**2), 1)
        groups = [rows[i : i + size] for i in range(0, len(rows), size)]
        return [alone, *groups] if alone else groups

    def _followed(self, rows: Sequence[int], count: int, seen) -> Followed | None:
        """Modes at other rows to which those at some rows are matched; None for the test's
        shapes."""
        after = dict(self.evidence.tracking)
        if not self.hypothesis.varies or after[rows[0]] is None:
            return None
        place = np.array([rows.index(after[r]) if after[r] in rows else -1 for r in rows])
        points = np.where(place[:, None] < 0, -1, place[:, None] * count + np.arange(count))
        n, m = self.forward.model.n_dofs, self.evidence.shape[1]
        none = np.zeros((count, n, m)), np.zeros((count, m))
        given = (
            np.concatenate(part)
            for part in zip(*(seen.get(after[r], none) for r in rows), strict=True)
        )
        return Followed(points.ravel(), *given)

    def _by_kind(self, rows) -> list[tuple[np.ndarray, np.ndarray]]:
        """Frequencies of all conditions, then damping of all."""
        m = self.evidence.shape[1]
        kinds = range(0, rows[0][0].shape[1], m)
        return [(data[:, k : k + m], slope[:, k : k + m]) for k in kinds for data, slope in rows]

    # -- the model -----------------------------------------------------------------------------

    def _evaluate(self, z, rows, mode, by, every: bool, followed=None) -> ModelEvaluation:
        """The model at points, (b, d), each at its own row, (b,)."""
        h, directions, columns, felt = self.hypothesis, [], {}, {}
        values = self._values(z, rows, mode, True, self.forward.model.parameters)
        modes = self.forward.batch(values, every, followed)
        place = h.places["tightenings"]
        tightened = list(range(place.start, place.stop))
        for j in by:
            if j in tightened:
                own = h.tightening(rows) == j - place.start
                if not own.any():
                    continue
                # Each row feels its own alone: all are moved together.
                felt[j] = own[:, None]
                if tightened in directions:
                    columns[j] = directions.index(tightened)
                    continue
            elif not h.acts(j, None, mode):
                continue
            columns[j] = len(directions)
            directions.append(tightened if j in tightened else [j])
        along = self._change(z, rows, mode, directions) if directions else None
        return ModelEvaluation(mode, modes, values, along, columns, felt)

    def _change(self, z, rows, mode, directions: Sequence[list[int]]) -> Change:
        """Along each direction, in which some parameters are moved together: all at once."""
        moved = (
            np.concatenate(part) for part in zip(*(_moved(z, of) for of in directions), strict=True)
        )
        rows, own = np.tile(rows, len(directions)), self.forward.model.parameters
        low, high = (self._values(each, rows, mode, wanted=own) for each in moved)
        return self.forward.change(low, high, 2 * STEP, len(directions))

    def _values(
        self, z, rows=None, mode=None, checked: bool = False, wanted: Collection[str] = ()
    ) -> dict[str, np.ndarray]:
        """The model's parameter values, each (b,), all or those wanted. Effects of the library are
        put in at all points together, others if they can be."""
        h, conditions = self.hypothesis, self.evidence.conditions
        several = rows is not None and np.any(rows != rows[0])

        def one(i) -> dict[str, float]:
            row = None if rows is None else int(rows[i])
            return h.values(z[i], conditions[row or 0], self.baseline, row, mode)

        if not self._singly:
            row = rows if several or rows is None else int(rows[0])
            try:
                found = h.values(
                    z.T, conditions[0 if row is None else row], self.baseline, row, mode
                )
                many = {k: self._each(found[k], len(z)) for k in wanted or found}
                if not checked or _alike(many, one, len(z)):
                    return many
            except (TypeError, ValueError):
                pass
            self._singly = True
        each = [one(i) for i in range(len(z))]
        return {name: np.array([values[name] for values in each]) for name in wanted or each[0]}

    def _each(self, value, count: int) -> np.ndarray:
        """A value for each of so many points. A single number is filled in once, so that a value
        that is the same below and above a step is the same array and need not be compared."""
        if np.shape(value) == (count,):
            return value
        key = float(value), count
        if key not in self._filled:
            self._filled[key] = np.full(count, float(value))
        return self._filled[key]

    # -- frequencies and damping -----------------------------------------------------------------

    def _rows(self, z, rows, views: Sequence[ModelEvaluation], by) -> tuple[np.ndarray, np.ndarray]:
        """ln f, and behind it ln damping if the hypothesis predicts it, (b, m) or (b, 2 m), and
        their slopes."""
        order, further = self._order(z), None
        if order is not None and np.max(order) >= self.evidence.shape[1]:
            # With a mode that the test missed, the model has one more.
            view = views[0]
            modes = self.forward.further.batch(view.values, every=False)
            further = replace(view, mode=None, modes=modes)
        own = self.hypothesis.view_of(self.evidence.shape[1])
        views = [further or views[at] for at in own]
        log_f = _of_each(views, lambda view: view.modes.log_f)
        slope = _of_each(views, lambda view: view.slopes(by))
        blocks = [(log_f, slope)]
        if self.hypothesis.damped:
            blocks.append(self._damping(z, rows, views, log_f, by))
        if order is not None:
            blocks = [(data[:, order], slope[:, order]) for data, slope in blocks]
        return tuple(np.concatenate(part, axis=1) for part in zip(*blocks, strict=True))

    def _order(self, z) -> np.ndarray | None:
        h = self.hypothesis
        if not h.senses:
            return None
        count = 0 if self.forward.sensors is None else len(self.forward.sensors)
        return h.sensing(z[0], self.evidence.shape[1], count).order

    def _damping(self, z, rows, views, log_f, by) -> tuple[np.ndarray, np.ndarray]:
        """ln of the damping ratios, (b, m), and their slopes."""
        h = self.hypothesis
        start = h.places["dampings"].start
        at_rest = np.stack([p.value(z[:, start + i]) for i, p in enumerate(h.dampings)], axis=1)
        lost, slope = np.zeros_like(at_rest), np.zeros((*at_rest.shape, len(by)))
        for i, view in enumerate(views):
            loss_factors = self._loss_factors(z, rows, log_f[:, i], view.mode)
            shares = {key: self._share(view, i, key) for key in loss_factors}
            lost[:, i] = sum((0.5 * eta * shares[key] for key, eta in loss_factors.items()), 0.0)
            for k, j in enumerate(by if loss_factors else ()):
                slope[:, i, k] = self._loss_slope(
                    z, rows, log_f[:, i], view, loss_factors, shares, j
                )
        total = at_rest + lost
        for k, j in enumerate(by):
            i = j - start
            if 0 <= i < len(h.dampings):
                slope[:, i, k] += h.dampings[i].spread * at_rest[:, i]
        return np.log(total), slope / total[:, :, None]

    def _loss_factors(self, z, rows, log_f, mode) -> dict[str, np.ndarray]:
        h, conditions, hz = self.hypothesis, self.evidence.conditions[rows], np.exp(log_f)
        if not self._singly:
            try:
                condition = conditions if np.any(rows != rows[0]) else conditions[0]
                found = h.loss_factors(z.T, condition, hz, mode)
                return {key: np.broadcast_to(eta, len(z)) for key, eta in found.items()}
            except (TypeError, ValueError):
                self._singly = True
        each = [h.loss_factors(*point, mode) for point in zip(z, conditions, hz, strict=True)]
        return {key: np.array([found[key] for found in each]) for key in each[0]}

    @staticmethod
    def _share(view: ModelEvaluation, i: int, key: str) -> np.ndarray:
        """Share of mode i's strain energy in the stiffness ``key``, (b,); all for ``""``."""
        return view.modes.share(key)[:, i] if key else np.ones(len(view.modes.index))

    def _loss_slope(self, z, rows, log_f, view, loss_factors, shares, j) -> np.ndarray:
        """Derivative of mode i's lost part by parameter ``j``, (b,).

        The derivative of a share g by the stiffness itself is that for two springs in series, the
        joint and the rest: dg / d ln stiffness = -g (1 - g). Only the path of the search and the
        width of the posterior depend on it.
        """
        found, h = np.zeros(len(z)), self.hypothesis
        if j not in view.columns:
            return found
        moved = _moved(z, [j])
        if h.dissipates(j):
            low, high = (self._loss_factors(each, rows, log_f, view.mode) for each in moved)
            for key, share in shares.items():
                found = found + 0.5 * (high[key] - low[key]) / (2 * STEP) * share
        low, high = (self._values(each, rows, view.mode) for each in moved)
        rest = 1 - sum(share for key, share in shares.items() if key)
        for key, share in shares.items():
            if key:
                log_stiffness = np.log(high[key] / low[key]) / (2 * STEP)
                found = found - 0.5 * loss_factors[key] * share * rest * log_stiffness
        return found

    # -- shapes and single numbers ---------------------------------------------------------------

    def _shapes(self, z, view: ModelEvaluation, by) -> tuple[np.ndarray, np.ndarray]:
        """Shapes at the sensors, each scaled to the measured one, flat, (b, n_s m), and slopes."""
        model, measured, modes = self.forward.model, self.evidence.shapes, view.modes
        h, sensing = self.hypothesis, self._read(z)

        def read(shapes, gains, shifts):
            at = model.sensor_rows @ shapes
            if shifts is not None:
                along = model.shift_rows @ shapes[:, None]
                at = at + np.einsum("bws,bwsm->bsm", shifts[:, : along.shape[1]], along)
            return at if gains is None else gains[:, :, None] * at

        found = read(modes.x, *sensing)
        there = np.isfinite(measured)
        y, seen = np.where(there, measured, 0.0), np.where(there, found, 0.0)
        square = np.maximum(np.sum(seen**2, axis=1), 1e-300)
        scale = np.sum(seen * y, axis=1) / square
        slope = np.zeros((*found.shape, len(by)))
        for k, j in enumerate(by):
            if j not in view.columns:
                continue
            d = read(modes.shape_slope(view.along, view.columns[j]), *sensing)
            if h.priors[j][0].sensing is not None:  # the structure unmoved
                low, high = (read(modes.x, *self._read(each)) for each in _moved(z, [j]))
                d = d + (high - low) / (2 * STEP)
            dx = np.where(there, d, 0.0)
            change = np.sum(y * dx, axis=1) - 2 * scale * np.sum(seen * dx, axis=1)
            slope[..., k] = scale[:, None] * d + found * (change / square)[:, None]
        found = np.where(modes.good[:, None, None], found * scale[:, None], np.nan)
        flat = len(z), measured.size
        return found.reshape(flat), slope.reshape(*flat, len(by))

    def _read(self, z) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Gains, (b, n_s), and shifts, (b, n_ways, n_s), of the sensors; None where these are as
        the case says."""
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

    def _scalars(self, z, by) -> list[tuple[np.ndarray, np.ndarray]]:
        measured = self.evidence.scalars

        def at(points, row: int | None) -> dict[str, np.ndarray]:
            return self._values(points, None if row is None else np.full(len(points), row))

        return [scalars_at(measured, self.hypothesis, z, by, at)] if measured else []


def _by_row(rows: Sequence[int], *arrays: np.ndarray) -> dict[int, tuple[np.ndarray, ...]]:
    """Arrays that hold one row after the other, by row."""
    parts = (np.split(array, len(rows)) for array in arrays)
    return dict(zip(rows, zip(*parts, strict=True), strict=True))


def _of_each(views: Sequence[ModelEvaluation], what) -> np.ndarray:
    """A quantity of each mode, from the evaluation at that mode's level, (b, m, ...)."""
    if all(view is views[0] for view in views):
        return what(views[0])
    return np.stack([what(view)[:, i] for i, view in enumerate(views)], axis=1)


def _moved(z, of: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Points a step below and above in some of their parameters."""
    step = np.where(np.isin(np.arange(z.shape[1]), of), STEP, 0.0)
    return z - step, z + step


def _alike(many, one, count: int) -> bool:
    """Whether values at a few of so many points are the same as one by one."""
    for i in {0, count // 2, count - 1}:
        values = one(i)
        for name, own in many.items():
            other, value = own[i], values[name]
            none = value != value  # nan: nothing has this value
            if not (abs(other - value) <= ROUND_OFF * abs(value) or (none and other != other)):
                return False
    return True


def at_conditions(
    hypothesis: Hypothesis,
    forward: ModalPrediction,
    z: np.ndarray,
    conditions: Sequence[float],
    baseline: dict[str, float],
    n_modes: int,
) -> np.ndarray:
    """What a hypothesis predicts at conditions that were not measured, without known changes and
    without the scatter of a tightening.

    Args:
        hypothesis: The hypothesis.
        forward: See `ManyPredictions`.
        z: Parameters in prior standard deviations, (d,).
        conditions: Torques or levels, (n,).
        baseline: Parameter values of the nominal model.
        n_modes: Number of the test's modes, m.

    Returns:
        ln f, and behind it ln of the damping ratios if the hypothesis predicts them: (1, n, m) or
        (2, n, m).

    Raises:
        InputError: See `ManyPredictions.at`.
    """
    known = np.delete(z, np.r_[hypothesis.places["tightenings"]])
    data, _ = _at(hypothesis, forward, conditions, baseline, n_modes).at(known, slopes=False)
    return data.reshape(-1, len(conditions), n_modes)


def _at(hypothesis, forward, conditions, baseline, n_modes: int) -> ManyPredictions:
    """See `at_conditions`; of parameters without the tightenings'."""
    bare = replace(hypothesis, scatter=0.0, known=(), as_row=())
    flat = np.zeros((len(conditions), n_modes))
    blank = Evidence(np.asarray(conditions, dtype=float), flat, flat + 1.0, 1.0)
    return ManyPredictions(bare, forward, blank, baseline)

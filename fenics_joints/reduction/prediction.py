"""Frequencies and shapes of the modes that a test saw, from any model of its structure.

A sampler asks for the frequencies at ten thousands of parameter values: a `BatchPrediction` has
them for many values at a time, from a basis of twenty to forty vectors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg

from fenics_joints.errors import (
    ConvergenceError,
    InputError,
    capable,
    mapping,
    measured,
    real,
    reals,
    wanted,
    whole,
)
from fenics_joints.measurements.gap import (
    ALIKE,
    FAINT,
    VISIBLE,
    Pairing,
    assigned,
    check_sight,
    likeness,
    mac,
    nearest,
    pair_modes,
    with_untold,
)
from fenics_joints.modal import frequency_sensitivity
from fenics_joints.modal.modes import (
    NOTHING,
    SHIFT_SHARE,
    Modes,
    inverted_modes,
    rigid_below,
    solve_modes,
    upright,
)
from fenics_joints.reduction.arrays import ArrayModel, freeze
from fenics_joints.reduction.basis import Points, pod
from fenics_joints.reduction.batch_modes import BatchModes, BatchValues, Change, change
from fenics_joints.structure.points import Sensors

#: Number of modes searched for the test's at most, over `ModalPrediction.n_modes`: chosen.
_SEARCHED = 4
#: Largest spread of sensors across a line, relative to its length, at which they count as in line.
_STRAIGHT = 1e-3
#: Sine of the angle between that line and a face's normal below which it gives no direction along
#: the face: chosen, only to avoid a division by zero.
_STEEP = 0.1
#: Parameter sets whose frequencies are kept: chosen, for memory.
_MOST = 4000
#: Modes computed beyond the test's, so that none is missed when modes change places: chosen.
SPARE = 3


class Slopes:
    """Derivatives of ln f by all parameters, (m, n_parameters), formed when they are first used:
    samplers need none, and they cost more than the frequencies.

    Args:
        modes: Modes of a model of plain arrays.
        index: Modes wanted.
    """

    def __init__(self, modes: Modes, index: np.ndarray):
        self._model, self._given = modes.model, dict(modes.given)
        self._x, self._lam = modes.shapes[:, index], modes.eigenvalues[index]

    @cached_property
    def _whole(self) -> np.ndarray:
        found = self._model.pencil_gradients(self._x, self._lam, self._given)
        return found / (2 * self._lam)[:, None]

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.array(self._whole, dtype=dtype) if copy else np.asarray(self._whole, dtype=dtype)

    def __getitem__(self, key) -> np.ndarray:
        return self._whole[key]

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n_parameters)."""
        return len(self._lam), len(self._model.parameters)


class ModalPrediction:
    """Frequencies of the modes that the test saw, and their derivatives, at parameter values.

    Args:
        model: A reduced (or full) structure.
        sensors: The test's sensors; None takes elastic modes in order.
        n_test: Number of test modes.
        n_modes: Number of model modes to compute.
        reference: Shapes of the test's modes at the sensors, measured or of a near model; modes
            are matched to them by MAC.
        threshold: Least visibility of a mode that the test saw.

    Raises:
        InputError: If an argument is out of range or has the wrong shape.

    Attributes:
        further: Prediction of one mode more, where the test may have missed one; else None.
        batches: Whether it has ``batch``, for many parameter values at a time.
    """

    batches = False

    def __init__(
        self,
        model,
        sensors: Sensors | None,
        n_test: int,
        n_modes: int,
        reference: np.ndarray | None = None,
        threshold: float = VISIBLE,
    ):
        capable("model", model, ("parameters", "n_dofs"), "a model, whole or reduced")
        check_sight(n_test, sensors, threshold)
        whole("n_modes", n_modes)
        if reference is not None and sensors is not None:
            reference = measured("reference", reference)
            if reference.shape != (len(sensors), n_test):
                raise InputError(
                    f"reference has shape {reference.shape}: expected ({len(sensors)}, {n_test}), "
                    "a row for each sensor and a column for each mode."
                )
        self.model, self.sensors, self.n_test, self.n_modes = model, sensors, n_test, n_modes
        self.reference, self.threshold = reference, threshold
        self.further: ModalPrediction | None = None
        self._cache: dict[tuple, tuple] = {}
        self.calls = 0

    def __call__(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """(ln f, d ln f / d values) of the test's modes, shapes (m,) and (m, n_parameters)."""
        key = tuple(values[name] for name in self.model.parameters)
        if key not in self._cache:
            if len(self._cache) > _MOST:
                self._cache.clear()
            modes, pairing = self.solve(values)
            log_f = np.log(modes.frequencies_hz[pairing.index])
            self._cache[key] = log_f, self._slopes(modes, pairing.index)
            self.calls += 1
        return self._cache[key]

    @property
    def mass(self) -> np.ndarray:
        """The model's nominal mass, (n_dofs, n_dofs), in which modes are compared."""
        last = self.__dict__.get("_mass")
        if last is None or last[0] is not self.model:
            last = self.__dict__["_mass"] = self.model, self.model.mass()
        return last[1]

    def _slopes(self, modes: Modes, index: np.ndarray) -> np.ndarray | Slopes:
        lazy = isinstance(self.model, ArrayModel)
        return Slopes(modes, index) if lazy else frequency_sensitivity(modes, index)

    def log_f_at(self, wanted: Sequence[Mapping[str, float]]) -> np.ndarray:
        """ln f at several sets of values, (len(wanted), m); nan where the model has too few visible
        modes, and beyond the laws' limits.

        Args:
            wanted: Parameter values.
        """
        many = batched(self)
        if many.batches:
            table = {name: np.array([v[name] for v in wanted]) for name in many.model.parameters}
            try:
                return many.batch(table, every=False).log_f
            except (InputError, np.linalg.LinAlgError):
                pass  # some are beyond a law's limit: find which
        return np.array([self._or_nan(values) for values in wanted])

    def _or_nan(self, values) -> np.ndarray:
        try:
            return self(values)[0]
        except (InputError, np.linalg.LinAlgError):
            return np.full(self.n_test, np.nan)

    def solve(self, values):
        """Modes and their pairing; more modes where a soft joint puts others between the test's."""
        # Start from n_modes each time, so that the result does not depend on earlier calls.
        count = min(self.n_modes, self.model.n_dofs)
        while True:
            modes = solve_modes(self.model, values, n_modes=count)
            try:
                pairing = self.paired(modes)
            except InputError:
                if count >= min(_SEARCHED * self.n_modes, self.model.n_dofs):
                    raise
                count = min(count + self.n_test + SPARE, self.model.n_dofs)
                continue
            return modes, pairing

    def paired(self, modes: Modes) -> Pairing:
        """Which of a model's modes are the test's."""
        return pair_modes(
            modes, self.n_test, self.sensors, reference=self.reference, threshold=self.threshold
        )

    def of(self, model, n_modes: int | None = None) -> ModalPrediction:
        """The same prediction by another model of the structure.

        Args:
            model: The model.
            n_modes: Number of its modes to compute; by default the same.
        """
        count = self.n_modes if n_modes is None else n_modes
        return ModalPrediction(
            model, self.sensors, self.n_test, count, self.reference, self.threshold
        )

    def pairing(self, values: Mapping[str, float]) -> Pairing:
        """Which of the model's modes are the test's at these values."""
        return self.solve(values)[1]

    def track(self, values: Mapping[str, float]) -> None:
        """Match modes to those at these values from now on."""
        if self.sensors is not None:
            self.reference = self.solve(values)[1].shapes
            self.forget()

    def forget(self) -> None:
        """Drop kept results after the model has changed."""
        self._cache.clear()


def line_of(points: np.ndarray) -> np.ndarray:
    """Direction in which points extend furthest, (gdim,); the first axis for a single point."""
    spread = points - points.mean(axis=0)
    if not np.any(spread):
        return np.eye(points.shape[1])[0]
    line = np.linalg.svd(spread)[2][0]
    return line * np.sign(line[np.argmax(np.abs(line))])


def ways_of(sensors: Sensors, gdim: int) -> np.ndarray:
    """Unit directions in which each sensor's position may be wrong, (n_ways, n_sensors, gdim).

    One along the line of the sensors, if they are in line or the model is plane. Else two in the
    face that each sensor measures normal to: as nearly as possible along the longest extent of all
    sensors, and across it.
    """
    points = np.asarray(sensors.points)[:, :gdim]
    line = line_of(points)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if gdim < 3 or len(spread) < 2 or spread[1] < _STRAIGHT * spread[0]:
        return np.tile(line, (1, len(points), 1))
    normals, along = np.asarray(sensors.directions), np.empty((len(points), 3))
    for i, n in enumerate(normals):
        rest = np.eye(3) - np.outer(n, n)
        own = rest @ line
        if np.linalg.norm(own) < _STEEP:
            own = rest[int(np.argmin(np.abs(n)))]
        along[i] = own / np.linalg.norm(own)
    return np.stack([along, np.cross(normals, along)])


#: Factor by which the round-off of a rigid mode's eigenvalue must stay below the limit of rigid
#: modes at the nominal values; stiffnesses may grow by as much: chosen.
_MARGIN = 1e3
#: Size of a model, and ratio to the number of modes wanted, above which only these are solved for;
#: all modes of smaller models are found sooner. Measured; results do not depend on it.
_LARGE, _FEW = 100, 2.0


@dataclass(frozen=True, eq=False)
class Followed:
    """Reference modes from which the modes of each of b points are tracked.

    Attributes:
        after: Index of the earlier point whose modes are the reference, (b,); -1 for given modes.
        shapes: Shapes of the given modes on the model's basis, (b, n_dofs, m).
        log_f: ln of their frequencies, (b, m).
    """

    after: np.ndarray
    shapes: np.ndarray
    log_f: np.ndarray


class BatchPrediction(ModalPrediction):
    """A `ModalPrediction` that solves for many parameter values at a time.

    Args:
        forward: The prediction whose modes it matches.
        model: That prediction's model, or the same on fewer vectors.
        turned: Whether it may change to a basis of unit mass, on which it is solved sooner;
            otherwise modes stay on the model's basis.
    """

    batches = True

    def __init__(self, forward: ModalPrediction, model: ArrayModel, turned: bool = True):
        n_modes = min(forward.n_modes, model.n_dofs)
        unit = _of_unit_mass(model) if turned else None
        model = model if unit is None else unit
        self._unit = unit is not None
        self._asked = forward._asked if isinstance(forward, BatchPrediction) else forward
        super().__init__(
            model, forward.sensors, forward.n_test, n_modes, forward.reference, forward.threshold
        )
        if forward.further is not None:
            self.further = BatchPrediction(forward.further, model, turned)

    def solve(self, values: Mapping[str, float]) -> tuple[Modes, Pairing]:
        """See `ModalPrediction`."""
        return super().solve(self._own(values))

    def _own(self, values) -> dict[str, float]:
        """The values of the model's own parameters; a solution would refuse others."""
        return {name: values[name] for name in self.model.parameters}

    def batch(
        self, values: Mapping[str, np.ndarray], every: bool = True, followed: Followed | None = None
    ) -> BatchModes:
        """Modes at many parameter values together, and which of them are the test's.

        Args:
            values: Of every parameter of the model, (b,).
            every: Whether all modes are wanted, for derivatives of shapes; otherwise only the
                lowest, enough to hold the test's.
            followed: Modes to track; None to match the test's reference shapes.

        Raises:
            InputError: If any of the values is beyond a law's limit.
        """
        values = self._own(values)
        eigenvalues, vectors = self._modes(values, None if every else self.n_modes)
        if followed is None:
            index, good = self._among(values, eigenvalues, vectors)
        else:
            index, good = self._followed(eigenvalues, vectors, followed)
        most = min(_SEARCHED * self.n_modes, self.model.n_dofs)
        if not good.all() and eigenvalues.shape[1] < most:
            if followed is not None:
                return self.batch(values, followed=followed)
            eigenvalues, vectors = self._further(values, eigenvalues, vectors, index, good, most)
        self._asked.calls += len(good)
        return BatchModes(self.model, values, eigenvalues, vectors, index, good)

    def change(self, low: BatchValues, high: BatchValues, width: float, count: int = 1) -> Change:
        """Derivatives of the terms along directions; see `reduction.batch_modes.change`."""
        return change(self.model, low, high, width, count)

    def _further(self, values, eigenvalues, vectors, index, good, most: int):
        """Modes up to ``most`` at points where the test's are not among the lowest; those of other
        points are zero. Corrects ``index`` and ``good`` in place."""
        few, k = np.flatnonzero(~good), eigenvalues.shape[1]
        own = {name: value[few] for name, value in values.items()}
        found = self._modes(own, most)
        index[few], good[few] = self._among(own, *found)
        eigenvalues = np.pad(eigenvalues, [(0, 0), (0, most - k)])
        vectors = np.pad(vectors, [(0, 0), (0, 0), (0, most - k)])
        eigenvalues[few], vectors[few] = found
        return eigenvalues, vectors

    def _among(self, values, eigenvalues, vectors) -> tuple[np.ndarray, np.ndarray]:
        """`_paired` among ``n_modes`` modes, and among more where the test's are not all there."""
        most = min(_SEARCHED * self.n_modes, eigenvalues.shape[1])
        count = min(self.n_modes, most)
        index, good = self._paired(values, eigenvalues[:, :count], vectors[:, :, :count])
        while not good.all() and count < most:
            count, few = min(count + self.n_test + SPARE, most), ~good
            own = {name: value[few] for name, value in values.items()}
            index[few], good[few] = self._paired(
                own, eigenvalues[few, :count], vectors[few, :, :count]
            )
        return index, good

    def _followed(self, eigenvalues, vectors, followed: Followed) -> tuple[np.ndarray, np.ndarray]:
        """Index of the tracked modes, (b, m), and whether all of them are there, (b,)."""
        count, m = min(self.n_modes, eigenvalues.shape[1]), self.n_test
        heavy = self.mass @ vectors[:, :, :count]
        f = np.sqrt(np.maximum(eigenvalues[:, :count], 0.0)) / (2 * np.pi)
        index = np.zeros((len(f), m), dtype=int)
        n_rigid = self._count_rigid(eigenvalues)
        good = count - n_rigid >= m
        for i, after in enumerate(followed.after):
            x, hz = followed.shapes[i], np.exp(followed.log_f[i])
            if after >= 0:
                x, hz = vectors[after][:, index[after]], f[after, index[after]]
                good[i] &= good[after]
            good[i] &= np.all(np.isfinite(hz))
            if good[i]:
                own = slice(n_rigid[i], None)
                alike = (x.T @ heavy[i][:, own]) ** 2
                index[i] = n_rigid[i] + nearest(alike, f[i, own], hz)
        return index, good

    def _count_rigid(self, eigenvalues) -> np.ndarray:
        rigid = rigid_below(SHIFT_SHARE * self.model.scale_hz)
        return np.sum(np.abs(eigenvalues) < rigid, axis=1)

    def _modes(self, values, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Lowest eigenvalues, (b, count), and M-normalised vectors, (b, n_dofs, count); of all
        modes for None."""
        K, M = self.model.pencil.assemble(values)
        n = self.model.n_dofs
        few = count is not None and n > max(_LARGE, _FEW * count)
        if self._unit and not few:
            return tuple(found[..., :count] for found in np.linalg.eigh(K))
        k = n if count is None else count
        eigenvalues, vectors = np.empty((len(K), k)), np.empty((len(K), n, k))
        # In the order of `dense_modes`, which decides the last bit.
        shift = (2 * np.pi * (SHIFT_SHARE * self.model.scale_hz)) ** 2
        for i in range(len(K)):
            eigenvalues[i], vectors[i] = self._one(K[i], M[i], shift, k)
        return (eigenvalues, vectors) if self._unit else upright(eigenvalues, vectors, shift)

    def _one(self, K, M, shift: float, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Of one model: LAPACK one at a time takes two thirds of numpy's time for a stack."""
        if self._unit:
            return scipy.linalg.eigh(K, subset_by_index=[0, count - 1], check_finite=False)
        try:
            return inverted_modes(K, M, shift, count)
        except ConvergenceError as error:
            raise np.linalg.LinAlgError(str(error)) from error

    def _paired(self, values, eigenvalues, vectors) -> tuple[np.ndarray, np.ndarray]:
        """Index of the model's mode for each test mode, (b, m), and whether there are enough, (b,).

        By the rules of `measurements.gap.pair_modes`.
        """
        b, m = len(eigenvalues), self.n_test
        n_rigid = self._count_rigid(eigenvalues)
        elastic = np.arange(eigenvalues.shape[1])[None, :] >= n_rigid[:, None]
        seen = elastic
        if self.sensors is not None:
            shapes = self.model.sensor_rows @ vectors
            mass = self.model.pencil.total_mass(values)
            own = self.model.hung_share(vectors, values)
            rest = np.maximum(1.0 - own, NOTHING)
            visibility = np.sqrt(np.mean(shapes**2, axis=1) * mass[:, None] / rest)
            seen = elastic & (visibility > self.threshold)
        good = np.sum(seen, axis=1) >= m
        index = np.zeros((b, m), dtype=int)
        if self.sensors is None or self.reference is None:
            for i in np.flatnonzero(good):
                index[i] = np.flatnonzero(seen[i])[:m]
            return index, good
        told = np.isfinite(self.reference).any(axis=0)
        flat = mac(self.reference[:, told], np.concatenate(shapes, axis=1))
        match = flat.reshape(len(flat), b, -1).transpose(1, 0, 2)
        f = np.sqrt(np.maximum(eigenvalues, 0.0))
        candidates = elastic & (visibility > min(self.threshold, FAINT))
        own = _matched(match, f, seen, candidates, good)
        if told.all():
            return own, good
        for i in np.flatnonzero(good):
            index[i] = with_untold(own[i], told, np.flatnonzero(seen[i]))
        return index, good


def _matched(
    match: np.ndarray, f: np.ndarray, seen: np.ndarray, candidates: np.ndarray, good: np.ndarray
) -> np.ndarray:
    """Index of the model's mode matched to each test mode, (b, m), at many parameter values.

    If every test mode is most like a different model mode, and like it at all, these are the
    matches; only the other points need an assignment problem.

    Args:
        match: MAC, (b, m, n).
        f: Frequencies of the model's modes, in any unit, (b, n).
        seen: Which of them the test could see, (b, n).
        candidates: These and fainter ones, (b, n).
        good: At which points there are enough of them, (b,).
    """
    first = np.argsort(~seen, axis=1, kind="stable")[:, : match.shape[1]]
    alike = likeness(match, f, np.take_along_axis(f, first, axis=1))
    index = np.argmax(np.where(seen[:, None, :], alike, -np.inf), axis=2)
    ordered = np.sort(index, axis=1)
    best = np.take_along_axis(match, index[:, :, None], axis=2)
    hard = np.any(ordered[:, 1:] == ordered[:, :-1], axis=1) | np.any(best < ALIKE, axis=(1, 2))
    for i in np.flatnonzero(good & hard):
        own = np.flatnonzero(candidates[i])
        index[i] = own[assigned(match[i][:, own], f[i][own], seen[i][own])]
    return index


def _of_unit_mass(model: ArrayModel) -> ArrayModel | None:
    """The model on a basis in which its mass is the identity, which takes a third less time.

    None if the mass varies, or if round-off of the stiffest vectors would disturb rigid modes.
    """
    pencil, values = model.pencil, model.values()
    if pencil.moving or pencil.scalar_slopes(values)[1].any():
        return None
    inverse_root = np.linalg.inv(np.linalg.cholesky(model.mass()))
    highest = np.linalg.eigvalsh(inverse_root @ model.stiffness() @ inverse_root.T)[-1]
    if _MARGIN * np.finfo(float).eps * highest > rigid_below(SHIFT_SHARE * model.scale_hz):
        return None
    found = model.on(inverse_root.T)
    if pencil.reference is not None:
        found.pencil.set_reference(pencil.reference)
    return found


def batched(forward: ModalPrediction) -> ModalPrediction:
    """The same prediction for many parameter values at a time.

    The forward itself if its model is not one of plain arrays. Kept with the forward as long as it
    has this model and reference.
    """
    if forward.batches or type(forward.model) is not ArrayModel:
        return forward
    model = forward.model
    key = model, forward.reference, forward.further
    last = forward.__dict__.get("_batched")
    if last is None or any(a is not b for a, b in zip(last[0], key, strict=True)):
        last = forward.__dict__["_batched"] = key, BatchPrediction(forward, model)
    return last[1]


class MatchedAt(NamedTuple):
    """Modes of a model at parameter values, and which of them are the test's.

    Attributes:
        shapes: As columns, (n_dofs, n_modes).
        index: The test's, (n_test,).
    """

    shapes: np.ndarray
    index: np.ndarray


def match_modes_at(forward: BatchPrediction, wanted: Points) -> list[MatchedAt]:
    """Modes of a model at those of several values where all of the test's are there.

    Args:
        forward: See `batched`; shapes are on its model's basis.
        wanted: Parameter values.
    """
    table = {name: np.array([values[name] for values in wanted]) for name in wanted[0]}
    try:
        modes = forward.batch(table, every=False)
    except (InputError, np.linalg.LinAlgError):  # one of them is beyond a law's limit
        found = []
        for values in wanted:
            with suppress(InputError, np.linalg.LinAlgError):
                modes, pairing = forward.solve(values)
                found.append(MatchedAt(modes.shapes, pairing.index))
        return found
    most = np.maximum(modes.index.max(axis=1) + 1, forward.n_modes)
    each = zip(modes.vectors, most, modes.index, modes.good, strict=True)
    return [MatchedAt(x[:, :n], index) for x, n, index, good in each if good]


#: Draws whose modes make a small model, draws that check it in each round, and rounds: chosen; the
#: error is measured whatever they are.
_DRAWS, CHECKS, _ROUNDS = 64, 50, 3
#: Numbers of vectors that are tried.
_SIZES = (12, 16, 20, 24, 28, 32, 40, 50, 60, 80)
#: Modes computed beyond the highest of the test's at any draw: chosen.
_BEYOND = 2
#: Singular value, relative to the largest, below which a vector of snapshots is round-off.
_NOISE = 1e-7


def compress(
    forward: ModalPrediction, draw: Callable[[int], Points], tolerance: float
) -> tuple[BatchPrediction, float]:
    """The same prediction on the fewest vectors whose frequencies are good enough at draws.

    The vectors span modes at the nominal values and at draws of the parameters. Draws at which the
    model lacks a mode that the test saw are left out of the check.

    Args:
        forward: Of an `ArrayModel`.
        draw: ``n -> n`` sets of parameter values.
        tolerance: Error of ln f that is good enough.

    Returns:
        The prediction, and its largest error of ln f at `CHECKS` other draws, which is above
        ``tolerance`` if even the largest basis is not good enough.
    """
    wanted, snapshots = [forward.model.values(), *draw(_DRAWS)], []
    seen = match_modes_at(batched(forward), wanted)
    enough = max((int(each.index.max()) + 1 + _BEYOND for each in seen), default=forward.n_modes)
    forward = batched(forward.of(forward.model, min(forward.n_modes, enough)))
    model = forward.model
    for _ in range(_ROUNDS):
        snapshots += [each.shapes[:, : forward.n_modes] for each in match_modes_at(forward, wanted)]
        checks = draw(CHECKS)
        exact = forward.log_f_at(checks)
        there = np.isfinite(exact).all(axis=1)
        wanted, exact = [v for v, good in zip(checks, there, strict=True) if good], exact[there]
        vectors, sizes = pod(model, np.hstack(snapshots))
        most = int(np.sum(sizes > _NOISE * sizes[0]))
        for size in [s for s in _SIZES if 6 + forward.n_test <= s < most] + [most]:
            lean = BatchPrediction(forward, model.on(vectors[:, :size]))
            error = np.max(np.abs(lean.log_f_at(wanted) - exact), initial=0.0)
            if error <= tolerance:
                return lean, float(error)
    return lean, float(np.nan_to_num(error, nan=np.inf))


@dataclass(frozen=True)
class Narrow:
    """A small model and how good it is.

    Attributes:
        model: The model; its parameters are the free ones.
        error: Largest relative error of a frequency at ``n_checked`` random points that the basis
            was not made from.
        n_checked: Number of those points.
    """

    model: ArrayModel
    error: float
    n_checked: int


def narrow(
    model: ArrayModel,
    ranges: Mapping[str, tuple[float, float]],
    n_modes: int,
    *,
    tolerance: float = 1e-5,
) -> Narrow:
    """A model on the modes that parameters in their ranges can make.

    Args:
        model: A model of plain arrays.
        ranges: Least and largest value of each free parameter, positive; sampled evenly in the
            logarithm. The others stay at their nominal values.
        n_modes: Modes that must be right, rigid-body modes included.
        tolerance: Largest accepted relative error of a frequency.

    Raises:
        InputError: For a bad range or name.
        ConvergenceError: If the error stays above the tolerance.
    """
    whole("n_modes", n_modes)
    real("tolerance", tolerance, above=0.0, most=0.1)
    if not ranges:
        raise wanted("ranges", ranges, "the range of a parameter at least")
    for name, pair in mapping("ranges", ranges, "ranges by name").items():
        low, high = reals(f"range of {name}", pair, (2,), above=0.0)
        if not low < high:
            raise InputError(f"range of {name} = {(low, high)}: expected 0 < low < high.")
    low, high = np.log(list(ranges.values())).T
    middle = dict(zip(ranges, np.exp(0.5 * (low + high)).tolist(), strict=True))
    frozen, rng = freeze(model, list(ranges), middle), np.random.default_rng(0)

    def draw(count: int) -> Points:
        at = np.exp(low + rng.random((count, len(low))) * (high - low))
        return [dict(zip(ranges, row.tolist(), strict=True)) for row in at]

    n_rigid = solve_modes(frozen, n_modes=n_modes).n_rigid
    found, error = compress(
        ModalPrediction(frozen, None, n_modes - n_rigid, n_modes), draw, tolerance
    )
    if error > tolerance:
        raise ConvergenceError(
            f"the frequencies of the small model are off by {error:.1e}, more than "
            f"{tolerance:.1e}, after {_ROUNDS} rounds: take narrower ranges, or a larger tolerance"
        )
    return Narrow(found.model, error, CHECKS)

"""Forwards that are asked at many parameter values together.

A sampler asks for the frequencies at ten thousands of parameter values: a `LeanForward` has them
for many values at a time, from a basis of twenty to forty vectors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements.gap import (
    ALIKE,
    FAINT,
    Pairing,
    assigned,
    likeness,
    mac,
    nearest,
    with_untold,
)
from fenics_joints.modal.modes import NOTHING, Modes, inverted_modes, upright
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.forward import SPARE, Forward
from fenics_joints.reduction.many import Change, ManyModes, ManyValues, change

#: As in `fenics_joints.modal.modes`: the shift below zero, and what counts as rigid.
_SHIFT_SHARE, _RIGID_SHARE = 0.002, 0.01
#: Round-off of a rigid mode's eigenvalue is to be below its limit by this much, at the nominal
#: values: stiffnesses may grow from there.
_MARGIN = 1e3
#: Modes looked through for the test's, as `Forward.solve` does.
_SEARCHED = 4
#: Size of a model, and this over the number of modes wanted, from which these are solved for alone:
#: all modes of smaller ones are found sooner.
_LARGE, _FEW = 100, 2.0


@dataclass(frozen=True, eq=False)
class Followed:
    """Of which modes those at each of many points are what these have become.

    Attributes:
        after: Those of which other of the points, one before it, (b,); -1 for those given.
        shapes: Given shapes on the model's basis, (b, n_dofs, m).
        log_f: ln of the frequencies of these, (b, m).
    """

    after: np.ndarray
    shapes: np.ndarray
    log_f: np.ndarray


class LeanForward(Forward):
    """A forward of a lean model that solves for many parameter values at a time.

    Args:
        forward: The one whose modes it follows.
        model: Its model on fewer vectors.
        turned: Whether it may take another basis, on which it is solved sooner; else its modes are
            on the model's.
    """

    batches = True

    def __init__(self, forward: Forward, model: ArrayModel, turned: bool = True):
        n_modes = min(forward.n_modes, model.n_dofs)
        unit = _of_unit_mass(model) if turned else None
        model = model if unit is None else unit
        self._unit = unit is not None
        self._asked = forward._asked if isinstance(forward, LeanForward) else forward
        super().__init__(
            model, forward.sensors, forward.n_test, n_modes, forward.reference, forward.threshold
        )
        if forward.further is not None:
            self.further = LeanForward(forward.further, model, turned)

    def solve(self, values: Mapping[str, float]) -> tuple[Modes, Pairing]:
        """See `Forward`."""
        return super().solve(self._own(values))

    def _own(self, values) -> dict[str, float]:
        """Without parameters that the model does not have, which a solution would refuse."""
        return {name: values[name] for name in self.model.parameters}

    def log_f_at(self, wanted: Sequence[Mapping[str, float]]) -> np.ndarray:
        """See `Forward`; solved together."""
        table = {name: np.array([v[name] for v in wanted]) for name in self.model.parameters}
        try:
            return self.many(table, every=False).log_f
        except (InputError, np.linalg.LinAlgError):
            return super().log_f_at(wanted)  # one of them is beyond a law's limit, as a specimen's

    def many(
        self, values: Mapping[str, np.ndarray], every: bool = True, followed: Followed | None = None
    ) -> ManyModes:
        """The test's modes at many parameter values together, and what their changes need.

        Args:
            values: Of every parameter of the model, (b,).
            every: Whether all modes are wanted, which derivatives of shapes are made of; else the
                lowest alone are there, as many as the test's ask for.
            followed: Whose shapes modes are matched to; one's own reference for None.

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
                return self.many(values, followed=followed)
            eigenvalues, vectors = self._further(values, eigenvalues, vectors, index, good, most)
        self._asked.calls += len(good)
        return ManyModes(self.model, values, eigenvalues, vectors, index, good)

    def change(self, low: ManyValues, high: ManyValues, width: float, count: int = 1) -> Change:
        """What `many` has to know of changes of the values; see `reduction.many.change`."""
        return change(self.model, self._own(low), self._own(high), width, count)

    def _further(self, values, eigenvalues, vectors, index, good, most: int):
        """More modes, up to ``most``, where the test's are not among the lowest; of the other
        points as many are nought, and index and good are put right in place."""
        few, k = np.flatnonzero(~good), eigenvalues.shape[1]
        own = {name: value[few] for name, value in values.items()}
        found = self._modes(own, most)
        index[few], good[few] = self._among(own, *found)
        eigenvalues = np.pad(eigenvalues, [(0, 0), (0, most - k)])
        vectors = np.pad(vectors, [(0, 0), (0, 0), (0, most - k)])
        eigenvalues[few], vectors[few] = found
        return eigenvalues, vectors

    def _among(self, values, eigenvalues, vectors) -> tuple[np.ndarray, np.ndarray]:
        """`_paired` among as few modes as there must be, or more where the test's are not there."""
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
        """Index of what modes of other points have become, (b, m), and whether there are enough."""
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
        rigid = (2 * np.pi * _RIGID_SHARE * _SHIFT_SHARE * self.model.scale_hz) ** 2
        return np.sum(np.abs(eigenvalues) < rigid, axis=1)

    def _modes(self, values, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Lowest eigenvalues, (b, count), and M-normalised vectors, (b, n_dofs, count); of all
        modes for None."""
        K, M = self.model.pencil.matrices(values)
        n = self.model.n_dofs
        few = count is not None and n > max(_LARGE, _FEW * count)
        if self._unit and not few:
            return tuple(found[..., :count] for found in np.linalg.eigh(K))
        k = n if count is None else count
        eigenvalues, vectors = np.empty((len(K), k)), np.empty((len(K), n, k))
        for i in range(len(K)):
            eigenvalues[i], vectors[i] = self._one(K[i], M[i], k, few)
        return eigenvalues, vectors

    def _one(self, K, M, count: int, few: bool) -> tuple[np.ndarray, np.ndarray]:
        """Of one model: a third sooner than many together, whose products are not blocked."""
        if self._unit:
            return scipy.linalg.eigh(K, subset_by_index=[0, count - 1], check_finite=False)
        shift = (2 * np.pi * _SHIFT_SHARE * self.model.scale_hz) ** 2
        try:
            inverse, vectors = inverted_modes(K, M, shift, count if few else None)
        except ConvergenceError as error:
            raise np.linalg.LinAlgError(str(error)) from error
        return upright(inverse[:count], vectors[:, :count], shift)

    def _paired(self, values, eigenvalues, vectors) -> tuple[np.ndarray, np.ndarray]:
        """Index of the model's mode of each of the test's, (b, m), and whether there are enough.

        As `measurements.gap.pair_modes`.
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
    """Index of the mode that each of the test's is like, (b, m), at many parameter values.

    If each test mode is most like another model mode, and like it at all, these are the
    assignment; only the rest needs an assignment problem.

    Args:
        match: MAC, (b, m, n).
        f: Frequencies of the model's modes, in any unit, (b, n).
        seen: Which of them the test could see, (b, n).
        candidates: These, and fainter ones, (b, n).
        good: At which values these are enough, (b,).
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
    """The model on a basis in which its mass is the identity, a third cheaper to solve.

    None where the mass varies, or where round-off of the stiffest vectors would reach rigid modes.
    """
    pencil, values = model.pencil, model.values()
    travels = any(isinstance(m.travel, str) for m in pencil.masses)
    if travels or pencil.scalar_slopes(values)[1].any():
        return None
    inverse_root = np.linalg.inv(np.linalg.cholesky(model.mass()))
    highest = np.linalg.eigvalsh(inverse_root @ model.stiffness() @ inverse_root.T)[-1]
    rigid = (2 * np.pi * _RIGID_SHARE * _SHIFT_SHARE * model.scale_hz) ** 2
    if _MARGIN * np.finfo(float).eps * highest > rigid:
        return None
    found = model.on(inverse_root.T)
    if pencil.settled is not None:
        found.pencil.settle(pencil.settled)
    return found


def batched(forward: Forward) -> Forward:
    """The same for many parameter values at a time (`Forward.batches`).

    The forward itself where its model is not one of plain arrays. Kept with it as long as it has
    this model and follows these modes.
    """
    if forward.batches or type(forward.model) is not ArrayModel:
        return forward
    model = forward.model
    key = model, forward.reference, forward.further
    last = forward.__dict__.get("_batched")
    if last is None or any(a is not b for a, b in zip(last[0], key, strict=True)):
        last = forward.__dict__["_batched"] = key, LeanForward(forward, model)
    return last[1]

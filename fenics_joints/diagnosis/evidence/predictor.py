"""Predictions of hypotheses, each on a basis of some 40 vectors made for its effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.cells import prior_cells, prior_points
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.modal.modes import solve_modes
from fenics_joints.reduction.arrays import freeze
from fenics_joints.reduction.basis import pod
from fenics_joints.reduction.prediction import (
    SPARE,
    BatchPrediction,
    ModalPrediction,
    batched,
    match_modes_at,
)

#: Step of differences, in standard deviations of the prior. [numerical: chosen]
_STEP = 1e-4
#: Size of a reduced model from which a smaller basis pays, and number of bases that are kept.
#: [numerical: chosen for time]
_LARGE, _BASES = 80, 128
#: Points of the prior whose modes make a basis: of an effect of one or two parameters, of more
#: parameters, and of an effect at many places. [numerical: chosen]
_SAMPLES, _MORE_SAMPLES, _SAMPLES_OF_PLACES = {1: 6, 2: 8}, 12, 24
#: Factor by which these points lie further out than the means of the prior's cells; how far out
#: tolerances are sampled, in standard deviations; weight of modes that the test did not see.
#: [numerical: chosen]
_BEYOND, _WITHIN, _OTHERS = 1.6, 1.5, 0.1
#: Singular value, relative to the first, below which a vector is left out; share of a mode that is
#: not rigid below which the mode is. [numerical: chosen]
_SHARE, _SAME = 1e-3, 1e-3
#: Points at which interpolation between torques is checked, and the error that is allowed there, in
#: standard deviations of noise. [numerical: chosen]
_CHECKS, _AS_GOOD = 8, 0.1

#: Makes a hypothesis of effects, with all that is uncertain in any case.
Make = Callable[[Sequence[Effect]], Hypothesis]


class HypothesisPredictor:
    """Predicts everything in a test by hypotheses of any effects.

    Args:
        forward: Frequencies and shapes by the reduced model.
        evidence: The whole test.
        baseline: Parameter values of the nominal model.
        make: Makes a hypothesis of effects.
        lean: Whether every hypothesis is predicted on a basis of its own.
    """

    def __init__(self, forward, evidence: Evidence, baseline, make: Make, lean: bool = False):
        self.evidence, self.baseline, self.make = evidence, baseline, make
        self.forward = batched(forward)
        #: Whether every hypothesis has a basis of its own.
        self.lean = lean and self.forward.model.n_dofs > _LARGE
        #: Predictions on small bases, by the keys of the effects that each serves.
        self.bases: dict[tuple[str | bytes, ...], BatchPrediction] = {}
        #: Modes that bases are made of, and their weights, by the effect's key.
        self._samples: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        #: Points, (b, p), whose modes the basis of one hypothesis was found to lack.
        self._lacking: dict[str, tuple[np.ndarray, ...]] = {}
        #: Whether few torques tell of all, and which parameters change, by the effect's key.
        self._smooth: dict[str, bool] = {}
        self._changes: dict[str, set[str]] = {}

    def predict(
        self, h: Hypothesis, z: np.ndarray, by: Sequence[int] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Everything in `Evidence.data` at points (b, p): (b, N), and its derivatives by some of z,
        (b, N, q); nan where the model lacks modes of the test."""
        by, many = list(by), self._many(h)
        data, slopes = many(z, by)
        own = [i for i, j in enumerate(by) if h.own.start <= j < h.own.stop]
        if own and _by_differences(h):
            slopes = slopes.copy()
            for i in own:
                step, moved = np.where(z[:, by[i]] < 0, _STEP, -_STEP), z.copy()
                moved[:, by[i]] += step
                slopes[:, :, i] = (many(moved)[0] - data) / step[:, None]
        return data, slopes

    def on_whole_model(self, h: Hypothesis, z: np.ndarray) -> np.ndarray:
        """Everything in `Evidence.data` at points by the whole reduced model, (b, N): what a basis
        is checked against."""
        return self._many(h, forward=self.forward)(z)[0]

    def enrich(self, h: Hypothesis, z: np.ndarray) -> None:
        """Take the modes at points, (b, p), into the basis of one hypothesis."""
        self._lacking[h.label_of_keys] = (*self._lacking.get(h.label_of_keys, ()), z)

    def _many(
        self, h: Hypothesis, between: bool | None = None, forward: ModalPrediction | None = None
    ) -> ManyPredictions:
        """By default on its own basis, and between few torques where all effects let it."""
        between = all(map(self._is_smooth, h.effects)) if between is None else between
        forward = self._forward_of(h) if forward is None else forward
        return ManyPredictions(h, forward, self.evidence, self.baseline, between)

    def _is_smooth(self, effect: Effect) -> bool:
        """Whether interpolation between a few torques shows what an effect does, remembered; not
        where contact opens from one torque to the next."""
        if effect.key not in self._smooth:
            h, good = self.make((effect,)), True
            few = self._many(h, between=True)
            if few.between:
                z = np.array([h.at(own) for own in prior_points(effect.priors, _CHECKS)])
                z = z.clip(*h.limits.T)
                off = np.abs(few(z)[0] - self._many(h, between=False)(z)[0])
                good = bool(np.nanmax(off / self.evidence.noise_sd(), initial=0.0) < _AS_GOOD)
            self._smooth[effect.key] = good
        return self._smooth[effect.key]

    # -- bases -----------------------------------------------------------------------------------

    def _forward_of(self, h: Hypothesis) -> ModalPrediction:
        """Predictions on the vectors that hold the test's modes all over a hypothesis' prior."""
        if not self.lean:
            return self.forward
        # In one order, so that round-off is the same whichever hypothesis asks first.
        acting = sorted(
            (e for e in h.effects if e.apply is not None or e.loss is not None),
            key=lambda effect: effect.key,
        )
        key, lacking = tuple(effect.key for effect in acting), self._lacking.get(h.label_of_keys)
        if lacking is not None:
            # For this hypothesis alone, so that the order of work makes no difference to others.
            key = (h.label_of_keys, *(z.tobytes() for z in lacking))
        if key not in self.bases:
            parts = [self._sampled(None), *map(self._sampled, acting)]
            parts += [self._modes_at(h, z) for z in lacking or ()]
            shapes, weights = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
            model = self.forward.model
            vectors, sizes = pod(model, shapes, weights)
            vectors = np.hstack([self._rigid, vectors[:, sizes > _SHARE * sizes[0]]])
            free = sorted(set(model.parameters) & set().union(*map(self._moved, [None, *acting])))
            model = freeze(model, free, self.baseline) if free else model
            own = BatchPrediction(self.forward, model.on(vectors))
            own.model.pencil.set_reference(own.model.values())
            while len(self.bases) >= _BASES:
                del self.bases[next(iter(self.bases))]
            self.bases[key] = own
        return self.bases[key]

    def _alone(self, effect: Effect | None) -> tuple[str, Hypothesis]:
        """Key and hypothesis of one effect; of tolerances alone for None."""
        if effect is None:
            return "", self.make(())
        return effect.key, self.make((effect,))

    def _moved(self, effect: Effect | None) -> set[str]:
        """The model's parameters that an effect and the tolerances change anywhere in their priors,
        or whose energy their losses are shares of; remembered."""
        key, h = self._alone(effect)
        if key not in self._changes:
            mean = np.zeros((1, 0)) if effect is None else prior_cells(effect.priors)[0]
            z = np.repeat([[-1.0], [1.0]], len(mean), axis=0) * np.ones(len(h.priors))
            z[:, h.own] = np.tile(mean, (2, 1))
            z = z.clip(*h.limits.T)
            many = ManyPredictions(h, self.forward, self.evidence, self.baseline)
            found = {name for known in h.known for name in known}
            for row in range(len(self.evidence.conditions)):
                values = many.values(z, row)
                found |= {k for k, v in values.items() if np.any(v != self.baseline[k])}
            losses = (h.loss_factors(point, self.evidence.conditions[0], 1.0) for point in z)
            self._changes[key] = found.union(*losses)
        return self._changes[key]

    @cached_property
    def _rigid(self) -> np.ndarray:
        """Rigid motions as they are: nearly rigid ones are far too stiff."""
        modes = solve_modes(self.forward.model, self.baseline, n_modes=self.forward.n_modes)
        return modes.shapes[:, : modes.n_rigid]

    def _sampled(self, effect: Effect | None) -> tuple[np.ndarray, np.ndarray]:
        """The test's modes, and those between them, all over an effect's prior, (n_dofs, n), and
        their weights, (n,); of the nominal model within its tolerances for None. Remembered."""
        key, h = self._alone(effect)
        if key not in self._samples:
            if effect is None:
                tolerances = _WITHIN * np.eye(len(h.priors))
                z = np.vstack([np.zeros(len(h.priors)), tolerances, -tolerances])
            else:
                most = _SAMPLES.get(len(effect.priors), _MORE_SAMPLES)
                if any(prior.scan for prior in effect.priors):
                    most = _SAMPLES_OF_PLACES
                z = np.array([h.at(own) for own in _BEYOND * prior_points(effect.priors, most)])
            self._samples[key] = self._modes_at(h, z.clip(*h.limits.T))
        return self._samples[key]

    def _modes_at(self, h: Hypothesis, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same at points, (b, p), of a hypothesis and at all conditions or at three of them."""
        conditions = self.evidence.conditions
        rows = np.arange(len(conditions) if h.varies else 1)
        if not any(h.known):
            rows = np.unique(rows[[0, len(rows) // 2, -1]])
        wanted = [
            h.values(point, conditions[row], self.baseline, row) for point in z for row in rows
        ]
        model, shapes, weights = self.forward.model, [], []
        for seen in match_modes_at(self.forward, wanted):
            if len(seen.index):
                most = int(seen.index.max()) + 1 + SPARE
                there = np.isin(np.arange(seen.shapes.shape[1]), seen.index)
                shapes.append(seen.shapes[:, :most])
                weights.append(np.where(there, 1.0, _OTHERS)[:most])
        if not shapes:
            return np.zeros((model.n_dofs, 0)), np.zeros(0)
        x, weight = np.hstack(shapes), np.concatenate(weights)
        left = x - self._rigid @ (self._rigid.T @ (model.mass() @ x))
        elastic = np.linalg.norm(left, axis=0) > _SAME * np.linalg.norm(x, axis=0)
        return left[:, elastic], weight[elastic]


def _by_differences(h: Hypothesis) -> bool:
    """Whether derivatives by the effects' own parameters have to be differences: by those of
    sensors, and of damping by slip."""
    slips = h.damped and any(e.by_level and e.loss for e in h.effects)
    return slips or any(e.sensing is not None and e.priors for e in h.effects)

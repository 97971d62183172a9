"""A hypothesis on effects that the nominal model lacks: its parameters, and the model with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior, Sensing
from fenics_joints.structure.changes import OFFSETS

#: Stand in tables of parameters for the scatter of the preload, for the motion of the joint in a
#: mode at the common level, and for damping outside joints.
_TIGHTENING = Effect("preload scatter", "bolts", (), None)
_AMPLITUDE = Effect("motion of the joint at equal level", "", (), None)
_DAMPING = Effect("damping at rest", "", (), None)
#: Motion of the joint in one mode over that in another, at the same force or response at a sensor:
#: within a factor of five. [prior: chosen]
_MOTION = (1.0, np.log(5.0), "", True, (0.02, 50.0))
#: Damping of bolted metal structures, away from slip: 0.3 %, within a factor of 4 either way.
#: [prior: bolted metal structures; spread chosen]
_AT_REST = (0.003, np.log(4.0), "", True, (0.0, 0.5))
#: Distance from a limit, in prior standard deviations, up to which a parameter is at the limit.
#: [numerical: chosen]
_AT_LIMIT = 1e-3
#: Standard deviation after the test, relative to that before, below which a parameter is
#: identified. [decision: chosen: twice as certain]
_IDENTIFIED = 0.5


@dataclass(frozen=True, repr=False)
class Hypothesis:
    """The nominal model plus effects, with what is uncertain in any case.

    Attributes:
        effects: The effects; none for "no gap".
        nuisances: Effects within tolerance, free in every hypothesis.
        name: Name for people; by default the effects'.
        unknown: Whether this is the hypothesis that something else is at work: no effect of the
            library, and a wide discrepancy instead.
        scatter: Standard deviation of ln(preload / torque) from one tightening to the next, for
            effects that depend on the torque; about 0.2 with a torque wrench (VDI 2230).
        conditions: The torques of the test, each with a tightening of its own.
        modes: Names of the test's modes.
        damped: Whether it predicts damping too.
        driven: Indices of the modes that were measured at several levels, each with an amplitude of
            its own at the same level for effects that depend on it; None for all. The amplitude of
            the first is the level itself. Other modes are measured near rest.
        known: Values that parameters of the model are known to have, by row of ``conditions``; see
            `fenics_joints.measurements.TestData`.
        as_row: The row whose tightening each one has, where rows share one; none for their own.
    """

    effects: tuple[Effect, ...]
    nuisances: tuple[Effect, ...] = ()
    name: str = ""
    unknown: bool = False
    scatter: float = 0.0
    conditions: tuple[float, ...] = ()
    modes: tuple[str, ...] = ()
    damped: bool = False
    driven: tuple[int, ...] | None = None
    known: tuple[Mapping[str, float], ...] = ()
    as_row: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"Hypothesis({self.label}: {len(self.priors)} parameters)"

    @property
    def label(self) -> str:
        return self.name or " + ".join(effect.name for effect in self.effects)

    @property
    def label_of_keys(self) -> str:
        """A name that tells effects of one name at different places apart."""
        return self.name or " + ".join(effect.key for effect in self.effects)

    @cached_property
    def tightenings(self) -> tuple[Prior, ...]:
        """A factor on each torque, where the effects depend on it."""
        if self.scatter <= 0 or not any(e.depends_on_condition for e in self.effects):
            return ()
        return tuple(
            Prior(f"preload at {c:g}", 1.0, self.scatter, "", True, (0.2, 5.0))
            for row, c in enumerate(self.conditions)
            if self.tightening(row) == row
        )

    def tightening(self, row: int | np.ndarray) -> int | np.ndarray:
        """Index of a row's tightening; of many rows (b,)."""
        return np.array(self.as_row)[row] if self.as_row else row

    @cached_property
    def moved(self) -> tuple[int, ...]:
        """The modes with a factor on the level: all driven ones but the first, where the effects
        depend on it."""
        if not any(e.by_level for e in self.effects):
            return ()
        return (tuple(range(len(self.modes))) if self.driven is None else self.driven)[1:]

    @cached_property
    def amplitudes(self) -> tuple[Prior, ...]:
        """These factors, in the order of `moved`."""
        first = self.modes[self.driven[0] if self.driven else 0] if self.moved else ""
        return tuple(Prior(f"{self.modes[i]} over {first}", *_MOTION) for i in self.moved)

    @cached_property
    def views(self) -> tuple[int | None, ...]:
        """Evaluations of the model that each condition needs: one of all modes at the common level,
        None, and one for each mode in `moved`, at the mode's own level."""
        return (None, *self.moved)

    def view_of(self, n: int) -> list[int]:
        """Index in `views` of each of n modes."""
        return [self.moved.index(i) + 1 if i in self.moved else 0 for i in range(n)]

    @cached_property
    def dampings(self) -> tuple[Prior, ...]:
        """Damping ratio of every mode at rest, if damping is predicted."""
        return tuple(Prior(name, *_AT_REST) for name in (self.modes if self.damped else ()))

    @cached_property
    def priors(self) -> list[tuple[Effect, Prior]]:
        """Every free parameter with its effect: nuisances, effects, and the `shared` ones."""
        return self._own + [pair for group in self.shared.values() for pair in group]

    @cached_property
    def _own(self) -> list[tuple[Effect, Prior]]:
        return [(e, p) for e in (*self.nuisances, *self.effects) for p in e.priors]

    @cached_property
    def own(self) -> slice:
        """Where the effects' parameters stand in z: behind the nuisances', before the shared
        ones."""
        first = sum(len(e.priors) for e in self.nuisances)
        return slice(first, len(self._own))

    @cached_property
    def own_of(self) -> dict[str, slice]:
        """Where each effect's parameters stand in z, by its key."""
        at, found = self.own.start, {}
        for effect in self.effects:
            found[effect.key] = slice(at, at + len(effect.priors))
            at += len(effect.priors)
        return found

    def at(self, own: np.ndarray | float) -> np.ndarray:
        """z with the effects' parameters ``own`` and all others at their medians, (d,)."""
        z = np.zeros(len(self.priors))
        z[self.own] = own
        return z

    @cached_property
    def limits(self) -> np.ndarray:
        """Least and largest z of each parameter, (d, 2)."""
        return np.array([prior.limits() for _, prior in self.priors]).reshape(-1, 2)

    def at_limit(self, z: np.ndarray) -> np.ndarray:
        """Which parameters are at a limit of their prior, (d,), bool.

        Args:
            z: The point, (d,).
        """
        low, high = self.limits.T
        return np.minimum(z - low, high - z) < _AT_LIMIT

    @cached_property
    def shared(self) -> dict[str, list[tuple[Effect, Prior]]]:
        """Parameters that belong to no effect: tightenings, amplitudes, dampings."""
        return {
            "tightenings": [(_TIGHTENING, p) for p in self.tightenings],
            "amplitudes": [(_AMPLITUDE, p) for p in self.amplitudes],
            "dampings": [(_DAMPING, p) for p in self.dampings],
        }

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where each group of `shared` parameters stands in z."""
        at, found = len(self._own), {}
        for name, group in self.shared.items():
            found[name] = slice(at, at + len(group))
            at += len(group)
        return found

    def values(
        self,
        z: np.ndarray,
        condition: float,
        baseline: dict[str, float],
        row: int | np.ndarray | None = None,
        mode: int | None = None,
    ) -> dict:
        """The model's parameter values at ``z`` and a condition.

        Args:
            z: Parameters in prior standard deviations, in the order of `priors`, (d,); of many
                points (d, b).
            condition: The torque or level; of many points one for each, (b,), or the same.
            baseline: Parameter values of the nominal model.
            row: Which of ``conditions`` it is, likewise; None for a tightening that was not
                measured.
            mode: The mode of `views` at whose level it is; None for the common level.
        """
        values = dict(baseline)
        felt = self._condition(z, condition, row, mode)
        acting = list(self._acting(z))
        for effect, theta in sorted(acting, key=lambda pair: pair[0].by_level):
            if effect.apply is not None:
                effect.apply(values, theta, condition if effect.drifts else felt)
        if self.known and row is not None:
            self._put_in(values, row)
        return values

    def _put_in(self, values: dict, row: int | np.ndarray) -> None:
        """Put the known values at a row, or at each of many, into the values."""
        if not np.ndim(row):
            values.update(self.known[int(row)])
            return
        for key in {key: None for known in self.known for key in known}:
            at = np.array([known.get(key, np.nan) for known in self.known])[row]
            values[key] = np.where(np.isnan(at), values[key], at)

    @cached_property
    def senses(self) -> bool:
        """Whether an effect changes how the test reads the structure."""
        return any(effect.sensing is not None for effect in (*self.nuisances, *self.effects))

    def sensing(self, z: np.ndarray, n_modes: int, n_sensors: int = 0) -> Sensing:
        """How the test reads the structure at ``z``."""
        found = Sensing.true(n_modes, n_sensors)
        for effect, theta in self._acting(z) if self.senses else ():
            if effect.sensing is not None:
                effect.sensing(found, theta)
        return found

    def acts(self, j: int, row: int | None, mode: int | None) -> bool:
        """Whether parameter ``j`` of z acts on the model at a row and as a mode sees it."""
        tightened, moved, damped = (self.places[name] for name in self.shared)
        if tightened.start <= j < tightened.stop:
            return row is not None and j == tightened.start + self.tightening(row)
        if moved.start <= j < moved.stop:
            return mode in self.moved and j == moved.start + self.moved.index(mode)
        return not damped.start <= j < damped.stop

    @cached_property
    def varies(self) -> bool:
        """Whether its prediction may depend on the condition."""
        if self.tightenings or self.amplitudes or any(self.known):
            return True
        return any(
            e.depends_on_condition or e.by_level or e.drifts or e.loss
            for e in (*self.nuisances, *self.effects)
        )

    def dissipates(self, j: int) -> bool:
        """Whether the loss factors may depend on parameter ``j`` of z."""
        if j < len(self._own):
            return self._own[j][0].loss is not None
        return j < self.places["dampings"].start

    def loss_factors(
        self, z: np.ndarray, condition: float, hz: float, mode: int | None = None
    ) -> dict[str, float]:
        """Loss factors by parameter of the model, at ``z``, a condition and a frequency, Hz; see
        `Effect.loss`."""
        condition, total = self._condition(z, condition, None, mode), {}
        for effect, theta in self._acting(z):
            if effect.loss is not None:
                for key, eta in effect.loss(theta, condition, hz).items():
                    total[key] = total.get(key, 0.0) + eta
        return total

    def still(
        self, z: np.ndarray, condition: float, baseline: dict[str, float]
    ) -> dict[str, float]:
        """The model's parameter values at ``z`` and a condition, without effects of the level."""
        values = dict(baseline)
        for effect, theta in self._acting(z):
            if not effect.by_level and effect.apply is not None:
                effect.apply(values, theta, condition)
        return values

    def _acting(self, z: np.ndarray) -> Iterator[tuple[Effect, Mapping[str, float]]]:
        """Every effect with its parameters."""
        at = 0
        for effect in (*self.nuisances, *self.effects):
            theta = {}
            for prior in effect.priors:
                theta[prior.name] = prior.value(z[at])
                at += 1
            yield effect, theta

    def _condition(self, z, condition, row, mode) -> float:
        """The condition that the joint feels."""
        if self.tightenings and row is not None:
            at = self.places["tightenings"].start + self.tightening(row)
            own = z[at, np.arange(len(at))] if np.ndim(at) else z[at]
            condition = condition * self.tightenings[0].value(own)  # the priors of all are the same
        if mode in self.moved:
            own = self.moved.index(mode)
            at = self.places["amplitudes"].start + own
            condition = condition * self.amplitudes[own].value(z[at])
        return condition

    def _where(self, effect: Effect, z: np.ndarray) -> str:
        own = zip(effect.priors, z[self.own_of[effect.key]], strict=True)
        return effect.where({prior.name: float(prior.value(at)) for prior, at in own})

    def table(self, z: np.ndarray, covariance: np.ndarray) -> list[dict]:
        """The fitted parameters for people, with one-sigma intervals, and whether they are
        identified: whether the test makes them twice as certain as they were at least."""
        rows = []
        for i, (effect, prior) in enumerate(self.priors):
            if effect.where and prior.name in OFFSETS:
                continue  # said with its place
            sd = float(np.sqrt(covariance[i, i]))
            low, high = prior.value(z[i] - sd), prior.value(z[i] + sd)
            rows.append(
                {
                    "effect": effect.key,
                    "name": prior.name,
                    "value": float(prior.value(z[i])),
                    "low": float(low),
                    "high": float(high),
                    "unit": prior.unit,
                    "nuisance": effect in self.nuisances or i >= len(self._own),
                    "prior_sigmas": float(z[i]),
                    "identified": sd < _IDENTIFIED,
                    **({"at": self._where(effect, z)} if prior.even and effect.where else {}),
                }
            )
        return rows

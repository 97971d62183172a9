"""The model inside a likelihood: frequencies at many parameter values, and how good they are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fenics_joints.bayes.priors import PriorDensity
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.progress import Progress
from fenics_joints.reduction.arrays import ArrayModel, freeze
from fenics_joints.reduction.files import Cache, register
from fenics_joints.reduction.prediction import BatchPrediction, ModalPrediction, compress
from fenics_joints.structure.points import Sensors


@dataclass(eq=False)
class Frequencies:
    """ln f at many parameter values.

    Args:
        names: Names of the parameters.
        forward: What maps values by name to (ln f, derivatives).
        fixed: Values of its other parameters.
        error: Bound of the relative error of its frequencies, as stated by who made it.

    Attributes:
        calls: Parameter values asked for so far.
    """

    names: tuple[str, ...]
    forward: ModalPrediction
    fixed: Mapping[str, float]
    error: float = 0.0
    calls: int = 0

    def __repr__(self) -> str:
        return f"Frequencies({self.n_modes} modes of {len(self.names)} parameters)"

    def by_name(self, values: np.ndarray) -> list[dict[str, float]]:
        """Rows of values, (n, d), as dicts of all the model's values."""
        return [
            {**self.fixed, **dict(zip(self.names, row, strict=True))}
            for row in np.asarray(values, dtype=float).tolist()
        ]

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """ln f at values (n, d): (n, m); nan where the model lacks a mode that the test saw, and
        beyond the laws' limits.
        """
        wanted = self.by_name(values)
        self.calls += len(wanted)
        return self.forward.log_f_at(wanted)

    def log_slope(self, values: np.ndarray) -> np.ndarray:
        """d ln f / d ln p at one point, (m, d), by central differences of the model."""
        values, step = np.asarray(values, dtype=float), 1e-4
        shifts = step * np.eye(len(values))
        up, down = (self(values * np.exp(sign * shifts)) for sign in (1, -1))
        return ((up - down) / (2 * step)).T

    @property
    def n_modes(self) -> int:
        """Number of the test's modes."""
        return self.forward.n_test


def narrow_frequencies(
    forward: ModalPrediction,
    prior: PriorDensity,
    given: Mapping[str, float],
    *,
    tolerance: float = 1e-5,
    seed: int = 0,
) -> Frequencies:
    """A small model for the parameters of a prior that solves for many values together.

    On the modes at draws of the prior, as few vectors of them as are good enough.

    Args:
        forward: Of an `ArrayModel`.
        prior: What is sampled.
        given: Values of the model's other parameters.
        tolerance: Largest relative error of a frequency against ``forward``, at 50 other draws.
        seed: Of the draws.

    Returns:
        The frequencies; from the model as it is, but frozen, where none smaller is good enough.
    """
    names, start = prior.names, forward.model.values(given)
    frozen = freeze(forward.model, names, start)
    middle = ModalPrediction(
        frozen, forward.sensors, forward.n_test, forward.n_modes, forward.reference
    )
    rng = np.random.default_rng([seed, 6])

    def drawn(n: int) -> list[dict[str, float]]:
        rows = prior.values(prior.sample(n, rng)).tolist()
        return [dict(zip(names, row, strict=True)) for row in rows]

    lean, error = compress(middle, drawn, tolerance)
    if error > tolerance:
        lean, error = BatchPrediction(middle, frozen), 0.0
    rest = {name: value for name, value in start.items() if name not in names}
    return Frequencies(tuple(names), lean, rest, error)


@dataclass(frozen=True)
class ReducedCheck:
    """A reduced model against the full one.

    Attributes:
        error: Largest relative error of a frequency.
        median: Median over the points of the largest error there.
        n_points: Points of the prior at which they were compared.
        n_missing: Further points at which either lacked a mode that the test saw.
        errors: Largest relative error at each point, 0 where a mode was lacked, (n,).
    """

    error: float
    median: float
    n_points: int
    n_missing: int
    errors: np.ndarray = field(repr=False)

    def require(self, limit: float = 1e-4) -> None:
        """Raise ConvergenceError where the error is above a limit."""
        if not self.error <= limit:
            raise ConvergenceError(
                f"the reduced model's frequencies are off by {100 * self.error:.3g} % in the "
                f"prior, more than {100 * limit:g} %: narrow the prior, or take more samples"
            )


def check_reduced(
    frequencies: Frequencies,
    exact: Callable[[Sequence[Mapping[str, float]]], np.ndarray],
    values: np.ndarray,
) -> ReducedCheck:
    """Compare at points of the prior. Collective where ``exact`` is.

    Args:
        frequencies: Of the reduced model.
        exact: Gives the full model's ln f, (n, m), at parameter values; nan where it lacks a mode.
        values: Of the parameters, (n, d).

    Raises:
        InputError: If the model has the test's modes at none of the points.
    """
    off = np.abs(frequencies(values) - exact(frequencies.by_name(values)))
    there = np.all(np.isfinite(off), axis=1)
    if not there.any():
        raise InputError("prior: the model has the test's modes at none of its points.")
    worst = off[there].max(axis=1)
    return ReducedCheck(
        float(worst.max()),
        float(np.median(worst)),
        int(there.sum()),
        int((~there).sum()),
        np.where(there, off.max(axis=1), 0.0),
    )


@dataclass(frozen=True, eq=False)
class KeptFrequencies:
    """A small model as it is kept beside chains, so that a second run does not prepare it.

    Attributes:
        model: The small model.
        n_test: See `ModalPrediction`; so are the next two.
        n_modes: See `ModalPrediction`.
        reference: See `ModalPrediction`.
        error: Of its frequencies against the reduced model.
        check: Against the full model.
        bound: Estimated error.
    """

    model: ArrayModel
    n_test: int
    n_modes: int
    reference: np.ndarray | None
    error: float
    check: ReducedCheck
    bound: float


register(KeptFrequencies, ReducedCheck)


def write_frequencies(
    cache: Cache, name: str, frequencies: Frequencies, check: ReducedCheck, bound: float
) -> None:
    """Keep a small model, its check against the full model, and its estimated error. Collective."""
    f = frequencies.forward
    kept = f.model, f.n_test, f.n_modes, f.reference, frequencies.error, check, bound
    cache.write(name, KeptFrequencies(*kept))


def read_frequencies(
    cache: Cache, name: str, sensors: Sensors | None, progress: Progress
) -> tuple[Frequencies, ReducedCheck, float] | None:
    """What `write_frequencies` kept, for the sensors of the test; None if it cannot be read.
    Collective."""
    kept = cache.read(name, KeptFrequencies, progress)
    if kept is None:
        return None
    forward = ModalPrediction(kept.model, sensors, kept.n_test, kept.n_modes, kept.reference)
    lean = BatchPrediction(forward, kept.model)
    return Frequencies(tuple(kept.model.parameters), lean, {}, kept.error), kept.check, kept.bound

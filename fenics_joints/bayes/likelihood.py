"""How probable measured frequencies are, given those of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.bayes.distributions import FAMILIES, Fitted, choose, log_pdf
from fenics_joints.errors import InputError


@dataclass(frozen=True, eq=False)
class FittedLikelihood:
    """The product of distributions of each frequency over specimens, Jalali et al. 2019, eq. 8.

    Its posterior is neither the scatter of the specimens (the frequencies of one specimen count as
    independent evidence) nor the knowledge of their mean (25 specimens count as one); see
    `fenics_joints.bayes.hierarchical` for both.

    Attributes:
        mode_names: Names of the modes.
        fitted: The distribution of each.
    """

    mode_names: tuple[str, ...]
    fitted: tuple[Fitted, ...]

    def __post_init__(self):
        object.__setattr__(self, "_logs", [log_pdf(d.frozen) for d in self.fitted])

    def __repr__(self) -> str:
        return f"FittedLikelihood({len(self.mode_names)} modes)"

    @classmethod
    def from_specimens(
        cls,
        mode_names: Sequence[str],
        frequencies_hz: np.ndarray,
        families: Sequence[str] | None = None,
        *,
        seed: int = 0,
        accept_misfit: bool = False,
    ) -> FittedLikelihood:
        """Fit a distribution to each mode, see `fenics_joints.bayes.distributions.choose`.

        Args:
            mode_names: Names of the modes, m of them.
            frequencies_hz: Shape (n_specimens, m).
            families: Candidates; all by default.
            seed: Of the samples that give p-values.
            accept_misfit: Take distributions that do not fit all the same.
        """
        table = checked_specimens(mode_names, frequencies_hz)
        return cls(
            tuple(mode_names),
            tuple(
                choose(name, column, families, seed=seed, accept_misfit=accept_misfit)
                for name, column in zip(mode_names, table.T, strict=True)
            ),
        )

    def __call__(self, log_f: np.ndarray) -> np.ndarray:
        """ln of the likelihood at the model's ln f, (n, m): (n,)."""
        f = np.exp(log_f)
        total = np.zeros(len(f))
        for density, column in zip(self._logs, f.T, strict=True):
            total += density(column)
        return np.where(np.isfinite(total), total, -np.inf)

    def numbers(self) -> np.ndarray:
        """What the likelihood is made of, to be known again by."""
        found = [
            (d.frozen.mean(), d.frozen.std(), list(FAMILIES).index(d.family), d.n)
            for d in self.fitted
        ]
        return np.array(found).ravel()

    def describe(self) -> list[str]:
        """What was chosen, a sentence for each mode."""
        return [d.words(name) for name, d in zip(self.mode_names, self.fitted, strict=True)]

    def doubts(self) -> list[str]:
        """Modes whose distribution fits badly, in words."""
        return [
            f"{name}: its frequencies are unlikely to be {d.family} (p = {d.p_value:.3f})"
            for name, d in zip(self.mode_names, self.fitted, strict=True)
            if d.doubtful
        ]


@dataclass(frozen=True, eq=False)
class GaussianLikelihood:
    """ln f is normal about the model's, correlated over the modes.

    A covariance that is itself found of n specimens makes it a t's, (1 + q / (n - 1))^(-n / 2) with
    q the weighed square (Sellentin and Heavens, MNRAS Lett. 456, 2016). Where p parameters have to
    explain m modes, the m - p other contrasts are covariates that cost as many specimens (Rao,
    Biometrika 46, 1959): the power is (n - m + p) / 2, and intervals of a linear model hold what
    they say.

    Attributes:
        mode_names: Names of the modes.
        log_f: Measured, (m,); nan where a mode was not.
        covariance: Of the difference to the model, (m, m).
        said: What the covariance is made of, in words.
        n: Number of specimens that the covariance was found of; 0 for one that is known.
        n_parameters: Number of parameters that are to be found, p; 0 for one for each mode.
    """

    mode_names: tuple[str, ...]
    log_f: np.ndarray
    covariance: np.ndarray
    said: str = "Gaussian"
    n: int = 0
    n_parameters: int = 0

    def __post_init__(self):
        log_f = np.asarray(self.log_f, dtype=float)
        covariance = np.atleast_2d(np.asarray(self.covariance, dtype=float))
        m = len(self.mode_names)
        if log_f.shape != (m,) or covariance.shape != (m, m):
            raise InputError(
                f"frequencies {log_f.shape} and covariance {covariance.shape}: expected {(m,)} and "
                f"{(m, m)}, one for each of the modes."
            )
        used = np.isfinite(log_f)
        if not used.any():
            raise InputError("frequencies: expected at least one measured value.")
        try:
            lower = np.linalg.cholesky(covariance[np.ix_(used, used)])
        except np.linalg.LinAlgError as error:
            raise InputError(
                "covariance of the frequencies: expected a positive definite matrix; give the "
                "test's noise, or the model's discrepancy, or more specimens than modes."
            ) from error
        constant = np.sum(np.log(np.diag(lower))) + 0.5 * len(lower) * np.log(2 * np.pi)
        whiten = np.linalg.inv(lower)
        arrays = {
            "log_f": log_f,
            "covariance": covariance,
            "_used": used,
            "_whiten": whiten,
            "_constant": constant,
        }
        for key, value in arrays.items():
            object.__setattr__(self, key, value)

    def __repr__(self) -> str:
        return f"GaussianLikelihood({len(self.mode_names)} modes)"

    @classmethod
    def from_row(
        cls,
        mode_names: Sequence[str],
        frequencies_hz: np.ndarray,
        log_sd: np.ndarray,
        discrepancy: float = 0.0,
    ) -> GaussianLikelihood:
        """One set of frequencies with its noise.

        Args:
            mode_names: Names of the modes, m of them.
            frequencies_hz: Shape (m,); nan where not measured.
            log_sd: Standard deviation of ln f, (m,).
            discrepancy: Relative error that frequencies of the best model may have.
        """
        variance = np.where(np.isfinite(log_sd), log_sd, 1.0) ** 2 + discrepancy**2
        said = f"Gaussian: noise, and the model's discrepancy of {100 * discrepancy:g} %"
        return cls(tuple(mode_names), np.log(frequencies_hz), np.diag(variance), said)

    @classmethod
    def from_specimens(
        cls,
        mode_names: Sequence[str],
        frequencies_hz: np.ndarray,
        *,
        of: str = "mean",
        discrepancy: float = 0.0,
        n_parameters: int = 0,
    ) -> GaussianLikelihood:
        """Mean over specimens, and their covariance.

        Args:
            mode_names: Names of the modes, m of them.
            frequencies_hz: Shape (n_specimens, m), without gaps.
            of: What the model is of: the ``mean`` structure, known to the covariance over n; or
                any ``specimen``, which scatters by all of it.
            discrepancy: Relative error that frequencies of the best model may have.
            n_parameters: Number of parameters that are to be found; 0 for one for each mode.

        Raises:
            InputError: If there are gaps, or too few specimens for a covariance.
        """
        if of not in ("mean", "specimen"):
            raise InputError(f"of = {of!r}: expected 'mean' or 'specimen'.")
        logs = np.log(checked_specimens(mode_names, frequencies_hz))
        n, m = logs.shape
        if np.any(np.isnan(logs)) or n < m + 2:
            raise InputError(
                f"frequencies of {n} specimens: expected at least {m + 2} without gaps for the "
                f"covariance of {m} modes."
            )
        covariance = np.atleast_2d(np.cov(logs.T)) / (n if of == "mean" else 1)
        said = f"Gaussian: covariance of {n} specimens" + (" over their number" * (of == "mean"))
        if discrepancy:
            said += f", and the model's discrepancy of {100 * discrepancy:g} %"
        covariance = covariance + discrepancy**2 * np.eye(m)
        return cls(tuple(mode_names), logs.mean(axis=0), covariance, said, n, n_parameters)

    def __call__(self, log_f: np.ndarray) -> np.ndarray:
        """ln of the likelihood at the model's ln f, (n, m), up to a constant: (n,)."""
        off = (np.asarray(log_f) - self.log_f)[:, self._used]
        good = np.all(np.isfinite(off), axis=1)
        square = np.sum((np.where(good[:, None], off, 0.0) @ self._whiten.T) ** 2, axis=1)
        if self.n:
            m = len(self.mode_names)
            power = 0.5 * (self.n - m + min(self.n_parameters or m, m))
            half = power * np.log1p(square / (self.n - 1))
        else:
            half = 0.5 * square
        return np.where(good, -half - self._constant, -np.inf)

    def numbers(self) -> np.ndarray:
        """What the likelihood is made of, to be known again by."""
        sd = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.outer(sd, sd)
        counts = [self.n, self.n_parameters]
        return np.concatenate([self.log_f, np.log(sd), correlation.ravel(), counts])

    def describe(self) -> list[str]:
        """What it is, in a sentence."""
        return [self.said]

    def doubts(self) -> list[str]:
        """Nothing to doubt that is known of."""
        return []


def checked_specimens(mode_names: Sequence[str], frequencies_hz: np.ndarray) -> np.ndarray:
    """Frequencies over specimens as a table (n_specimens, m), nan where not measured.

    Raises:
        InputError: If a frequency is not positive, or the columns are not the modes.
    """
    table = np.atleast_2d(np.asarray(frequencies_hz, dtype=float))
    if table.ndim != 2 or table.shape[1] != len(mode_names):
        raise InputError(
            f"frequencies of specimens have shape {table.shape}: expected {len(mode_names)} "
            "columns, one for each mode."
        )
    for name, column in zip(mode_names, table.T, strict=True):
        bad = column[~np.isnan(column) & ~((column > 0) & np.isfinite(column))]
        if len(bad):
            raise InputError(f"{name}: a specimen's frequency is {bad[0]:g} Hz: expected above 0.")
    return table

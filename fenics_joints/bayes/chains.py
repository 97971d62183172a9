"""Chains of samples, and whether they may be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from fenics_joints.bayes.arviz_files import convergence
from fenics_joints.errors import ConvergenceError

#: Vehtari, Gelman, Simpson, Carpenter and Buerkner, Bayesian Anal. 16, 2021.
MOST_RHAT, LEAST_ESS = 1.01, 400.0


@dataclass(frozen=True, eq=False)
class Chains:
    """Samples of several chains, the burn-in left out.

    Attributes:
        names: Of the quantities, d of them.
        values: Shape (n_chains, n_draws, d).
        log_density: Of each draw, up to a constant, (n_chains, n_draws).
        acceptance: Share of accepted proposals of each chain, (n_chains,).
        sampler: How they were drawn.
        evaluations: Times that the model was asked for its frequencies, burn-in included.
        info: ``steps`` in all, those of the ``burn_in``, and ``walkers`` of a chain.
    """

    names: tuple[str, ...]
    values: np.ndarray
    log_density: np.ndarray
    acceptance: np.ndarray
    sampler: str
    evaluations: int = 0
    info: Mapping[str, object] = field(default_factory=dict)

    def __repr__(self) -> str:
        chains, draws, d = self.values.shape
        return f"Chains({chains} x {draws} draws of {d} quantities by {self.sampler.split(',')[0]})"

    @cached_property
    def convergence(self) -> dict[str, dict[str, float]]:
        """rhat, ess_bulk and ess_tail of each quantity."""
        return {n: convergence(self.values[:, :, i]) for i, n in enumerate(self.names)}

    @cached_property
    def problems(self) -> list[str]:
        """Why the chains must not be used, in words; empty if they may."""
        if self.values.shape[1] < 4:
            return [f"{self.values.shape[1]} draws were kept of each chain; expected many more"]
        found = []
        for name, c in self.convergence.items():
            if not np.isfinite(c["rhat"]):
                found.append(f"{name}: the chains do not move")
            elif c["rhat"] > MOST_RHAT:
                found.append(
                    f"{name}: the chains disagree, R-hat = {c['rhat']:.4f}, "
                    f"expected at most {MOST_RHAT}"
                )
            ess = min(c["ess_bulk"], c["ess_tail"])
            if np.isfinite(c["rhat"]) and not ess >= LEAST_ESS:
                found.append(
                    f"{name}: worth {ess:.0f} independent draws, expected at least {LEAST_ESS:.0f}"
                )
        return found

    def shortly(self) -> str:
        """The first three problems, and how many more there are."""
        more = len(self.problems) - 3
        return "; ".join(self.problems[:3]) + (f"; and {more} more" if more > 0 else "")

    @property
    def converged(self) -> bool:
        """Whether the chains may be used."""
        return not self.problems

    def require_converged(self) -> Chains:
        """These chains.

        Raises:
            ConvergenceError: If they did not converge: says which quantity and how far off.
        """
        if self.problems:
            raise ConvergenceError(
                f"the chains did not converge ({self.shortly()}): take more samples, a longer "
                "burn-in, or a narrower prior"
            )
        return self

    def draws(self, names: Sequence[str] | None = None) -> np.ndarray:
        """All draws of converged chains, (n_chains * n_draws, d).

        Raises:
            ConvergenceError: If they did not converge.
        """
        self.require_converged()
        flat = self.values.reshape(-1, len(self.names))
        return flat if names is None else flat[:, [self.names.index(n) for n in names]]

    def by_name(self) -> dict[str, np.ndarray]:
        """Draws of each quantity, (n_chains, n_draws)."""
        return {name: self.values[:, :, i] for i, name in enumerate(self.names)}

    def table(self) -> list[dict]:
        """Mean, standard deviation, median, 90 % interval and convergence of each quantity."""
        rows = []
        for i, name in enumerate(self.names):
            flat = self.values[:, :, i].ravel()
            low, median, high = np.quantile(flat, [0.05, 0.5, 0.95])
            rows.append(
                {
                    "name": name,
                    "mean": float(flat.mean()),
                    "sd": float(flat.std(ddof=1)),
                    "median": float(median),
                    "low": float(low),
                    "high": float(high),
                    **self.convergence[name],
                }
            )
        return rows

    def correlation(self) -> np.ndarray:
        """Between the quantities, (d, d)."""
        return np.atleast_2d(np.corrcoef(self.values.reshape(-1, len(self.names)).T))

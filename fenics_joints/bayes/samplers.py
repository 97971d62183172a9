"""Draws from a posterior: chains over the ranks, kept in a file and gone on from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.bayes.arviz_files import read_chains, write_chains
from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.posterior import Posterior, Starts
from fenics_joints.bayes.walks import Ensembles, Independence, RandomWalk, generator
from fenics_joints.errors import InputError
from fenics_joints.meshes.tagged import on_root

__all__ = ["SAMPLERS", "Settings", "sample"]

SAMPLERS = ("metropolis", "prior_metropolis", "emcee")
#: Steps between two writings of the file.
_CHUNK = 2500


@dataclass(frozen=True)
class Settings:
    """How to sample.

    Attributes:
        sampler: ``metropolis``: steps that are learnt in the burn-in; ``prior_metropolis``: the
            paper's, proposals from the prior; ``emcee``: ensembles of walkers.
        samples: Draws of each chain, burn-in included; an ensemble's are shared by its walkers.
        burn_in: How many of them are thrown away.
        chains: Number of independent chains, or ensembles.
        seed: Of the random numbers.
    """

    sampler: str = "metropolis"
    samples: int = 20000
    burn_in: int = 5000
    chains: int = 4
    seed: int = 1

    def __post_init__(self):
        if self.sampler not in SAMPLERS:
            raise InputError(f"sampler = {self.sampler!r}: expected one of: {', '.join(SAMPLERS)}.")
        if self.chains < 2:
            raise InputError(
                f"chains = {self.chains}: expected at least 2, to see whether they agree."
            )
        if not 0 <= self.burn_in < self.samples:
            raise InputError(
                f"burn_in = {self.burn_in}: expected from 0 to below samples = {self.samples}."
            )

    def walkers(self, d: int) -> int:
        """Walkers of a chain."""
        return max(16, 4 * d) if self.sampler == "emcee" else 1

    def steps(self, d: int) -> tuple[int, int]:
        """Steps of each walker, and those thrown away."""
        n = self.walkers(d)
        return -(-self.samples // n), self.burn_in // n


def sample(
    posterior: Posterior,
    settings: Settings,
    comm: MPI.Intracomm = MPI.COMM_SELF,
    *,
    keep: Path | None = None,
    told: Callable[[float], None] | None = None,
) -> Chains:
    """Draw from a posterior. Collective; every rank returns all chains.

    The chains are shared out over the ranks and are the same on any number of them.

    Args:
        posterior: What is drawn from; the same on every rank.
        settings: How.
        comm: Ranks that share the chains.
        keep: File of the chains: gone on from if it is there, and written as they grow; one with
            fewer samples than now asked for is prolonged.
        told: Told the share that is done.

    Raises:
        InputError: If the file is of another posterior, sampler or seed, or cannot be written.
    """
    d = posterior.prior.size
    n_steps, burn_in = settings.steps(d)
    starts = posterior.starts(settings.chains * settings.walkers(d), settings.seed)
    mine = range(comm.rank, settings.chains, comm.size)
    kept = None if keep is None else _kept(comm, keep, posterior, settings, starts)
    states = None if kept is None else [kept["states"][c] for c in mine]
    walk = _walk(posterior, settings, starts, mine, burn_in, states)
    done = 0 if kept is None else kept["steps"]
    parts = [] if kept is None else [kept["part"]]
    evaluations = settings.chains * settings.walkers(d) * (n_steps + 1)
    while done < n_steps:
        n = _next(done, n_steps, burn_in)
        part = _gathered(comm, walk.advance(n), settings)
        done += n
        if done > burn_in:
            parts.append(part)
        if keep is not None and done > burn_in:
            found = _joined(posterior, settings, parts, evaluations)
            states = _in_order(comm, walk.states(), settings.chains)
            resume = {"settings": asdict(settings), "steps": done, "states": states,
                      "starts": starts.points.tolist(), "at_starts": _at(posterior, starts),
                      "acceptance": found.acceptance.tolist()}  # fmt: skip
            on_root(comm, lambda: _write(keep, found, resume))  # noqa: B023
        if told is not None:
            told(done / n_steps)
    return _joined(posterior, settings, parts, evaluations)


def _next(done: int, n_steps: int, burn_in: int) -> int:
    """Steps to the next place where the file is written: never over the end of the burn-in."""
    end = burn_in if done < burn_in else n_steps
    return min(_CHUNK, end - done)


def _walk(posterior, settings: Settings, starts: Starts, mine, burn_in: int, states):
    rngs = [generator(settings.seed, c) for c in mine]
    points = starts.points.reshape(settings.chains, -1, posterior.prior.size)[list(mine)]
    if settings.sampler == "emcee":
        return Ensembles(posterior, points, rngs, states)
    if settings.sampler == "metropolis":
        return RandomWalk(posterior, points[:, 0], starts.covariance, rngs, burn_in, states)
    return Independence(
        posterior.log_likelihood, posterior.prior.sample, points[:, 0], rngs, states
    )


def _in_order(comm, own: list, n_chains: int) -> list:
    """What the ranks have of their chains, in the order of the chains. Collective."""
    every = comm.allgather(own)
    return [every[c % comm.size][c // comm.size] for c in range(n_chains)]


def _gathered(comm, found, settings: Settings):
    """Points, ln densities and acceptance of all walkers, in the order of the chains."""
    w = -1 if not len(found[1]) else settings.walkers(found[0].shape[2])
    mine = len(range(comm.rank, settings.chains, comm.size))
    return tuple(
        np.concatenate(
            _in_order(comm, [a[i * w : (i + 1) * w] for i in range(mine)], settings.chains)
        )
        for a in found
    )


def _joined(posterior, settings: Settings, parts, evaluations: int) -> Chains:
    x = np.concatenate([part[0] for part in parts], axis=1)
    lengths = np.array([part[0].shape[1] for part in parts], dtype=float)
    shares = np.array([part[2] for part in parts])
    label = {"metropolis": RandomWalk, "emcee": Ensembles, "prior_metropolis": Independence}
    return Chains(
        posterior.names,
        posterior.prior.values(x.reshape(-1, x.shape[2])).reshape(x.shape),
        np.concatenate([part[1] for part in parts], axis=1),
        lengths @ shares / lengths.sum(),
        label[settings.sampler].label,
        evaluations,
    )


# -- the file --------------------------------------------------------------------------------------


def _at(posterior: Posterior, starts: Starts) -> list:
    """ln density where the chains begin: what tells one posterior from another."""
    return [float(v) if np.isfinite(v) else None for v in posterior(starts.points)]


def _write(path: Path, chains: Chains, resume: dict) -> None:
    write_chains(path, chains.by_name(), {"lp": chains.log_density}, resume)


def _kept(comm, path: Path, posterior: Posterior, settings: Settings, starts: Starts):
    """What the file holds; None if it is not there. Collective."""
    found = comm.bcast(
        on_root(comm, lambda: _read(path, posterior.names) if path.exists() else None)
    )
    if found is None:
        return None
    draws, statistics, resume = found
    for key, now in asdict(settings).items():
        then = resume["settings"].get(key)
        if key != "samples" and then != now:
            raise InputError(
                f"{path}: holds chains with {key} = {then}, not {now}; expected the same to go on "
                "from them, or a new name"
            )
    then = np.array([np.nan if v is None else v for v in resume["at_starts"]])
    now = np.array([np.nan if v is None else v for v in _at(posterior, starts)])
    same = then.shape == now.shape and np.allclose(then, now, 1e-3, 1e-3, equal_nan=True)
    if not same or not np.allclose(resume["starts"], starts.points, 1e-6, 1e-6):
        raise InputError(
            f"{path}: holds chains of another posterior: the model, the prior or the data have "
            "changed. Expected the same to go on from them, or a new name."
        )
    values = np.stack([draws[name] for name in posterior.names], axis=2)
    x = posterior.prior.coordinates(values.reshape(-1, len(posterior.names))).reshape(values.shape)
    resume["part"] = x, statistics["lp"], np.array(resume["acceptance"])
    return resume


def _read(path: Path, names):
    return read_chains(path, names)

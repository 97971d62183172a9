"""Draws from a posterior: chains over the ranks, kept in a file and gone on from."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.bayes.arviz_files import read_chains, write_chains
from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.posterior import Posterior
from fenics_joints.bayes.walks import Ensembles, Independence, RandomWalk, generator
from fenics_joints.errors import InputError, member, whole
from fenics_joints.parallel import on_root

#: Largest difference of ln f between two reductions of one model: the default tolerance of both.
_ALIKE = 1e-4
_OTHER = {
    "prior": "another prior",
    "model": "another model",
    "data": "other data, noise or discrepancy",
}
SAMPLERS = ("metropolis", "prior_metropolis", "emcee")
#: Steps after which the file may be written, and the time, s, after which it is; chosen.
CHUNK, EVERY = 250, 5.0


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
        member("sampler", self.sampler, SAMPLERS)
        whole("chains", self.chains, 2)  # to see whether they agree
        whole("samples", self.samples)
        whole("seed", self.seed, 0)
        if not whole("burn_in", self.burn_in, 0) < self.samples:
            raise InputError(
                f"burn_in = {self.burn_in}: expected from 0 to below samples = {self.samples}."
            )

    def walkers(self, d: int) -> int:
        """Walkers of a chain."""
        return max(8, 4 * d) if self.sampler == "emcee" else 1

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
        keep: File of the chains: gone on from if it is there, also from within the burn-in, and
            written as they grow. Chains with fewer samples than now asked for are prolonged, and
            so are those that did not converge: twice as many are kept then. The file's burn-in
            stands.
        told: Told the share that is done.

    Raises:
        InputError: If the file is of another posterior, sampler or seed, and says what differs; or
            cannot be written.
    """
    d = posterior.prior.size
    w, (n_steps, burn_in) = settings.walkers(d), settings.steps(d)
    starts, covariance = posterior.starts(settings.chains * w, settings.seed)
    points = starts.reshape(settings.chains, w, d)

    def walk(mine, states, burn_in):
        rngs = [generator(settings.seed, c) for c in mine]
        own = points[list(mine)]
        if settings.sampler == "emcee":
            return Ensembles(posterior, own, rngs, states)
        if settings.sampler == "metropolis":
            return RandomWalk(posterior, own[:, 0], covariance, rngs, burn_in, states)
        return Independence(
            posterior.log_likelihood, posterior.prior.sample, own[:, 0], rngs, states
        )

    def values(x):
        return posterior.prior.values(x.reshape(-1, d)).reshape(x.shape)

    label = {"metropolis": RandomWalk, "emcee": Ensembles, "prior_metropolis": Independence}
    task = Task(
        posterior.names,
        walk,
        values,
        _marks(posterior),
        label[settings.sampler].label,
        w,
        n_steps,
        burn_in,
    )
    return grow(task, settings, comm, keep=keep, told=told)


def _marks(posterior: Posterior) -> dict[str, np.ndarray]:
    """Numbers by which a file's posterior is known again, by what they are of."""
    x = posterior.prior.sample(4, np.random.default_rng(9))
    log_f = posterior.frequencies(posterior.prior.values(x))
    own = getattr(posterior.likelihood, "numbers", None)
    data = posterior.likelihood(np.nan_to_num(log_f)) if own is None else own()
    return {"prior": np.append(x, posterior.prior.log_density(x)), "model": log_f, "data": data}


@dataclass(frozen=True, eq=False)
class Task:
    """Chains to be grown.

    Attributes:
        names: Of the quantities.
        walk: Makes the walk of some chains: from their numbers, their states or None, and the steps
            of the burn-in.
        values: From a walk's points (n_chains, n, d) to the quantities.
        marks: Numbers that tell this task from others, for files, by what they are of.
        label: How the draws are made.
        walkers: Rows of points for each chain.
        n_steps: Steps in all.
        burn_in: Those thrown away.
        cost: Times that the model is asked for frequencies in a step of a walker.
    """

    names: tuple[str, ...]
    walk: Callable
    values: Callable[[np.ndarray], np.ndarray]
    marks: Mapping[str, np.ndarray]
    label: str
    walkers: int
    n_steps: int
    burn_in: int
    cost: int = 1


def grow(
    task: Task,
    settings: Settings,
    comm: MPI.Intracomm,
    *,
    keep: Path | None = None,
    told: Callable[[float], None] | None = None,
) -> Chains:
    """Let the chains of a task grow to their length, see `sample`. Collective."""
    mine = range(comm.rank, settings.chains, comm.size)
    kept = None if keep is None else _kept(comm, keep, task, settings)
    done, parts, states = 0, [], None
    if kept is not None:
        done, parts, states = kept.steps, kept.parts, [kept.states[c] for c in mine]
        task = replace(task, burn_in=kept.burn_in, n_steps=max(task.n_steps, kept.burn_in + 1))
        if done >= task.n_steps and not _joined(task, parts, done).converged:
            task = replace(task, n_steps=2 * done - task.burn_in)
    walk = task.walk(mine, states, task.burn_in)
    first, written = done, time.monotonic()
    while done < task.n_steps:
        n = _next(done, task)
        points, lps, accepted = _gathered(comm, walk.advance(n), task.walkers, settings.chains)
        done += n
        if done > task.burn_in:
            parts.append((task.values(points), lps, accepted))
        due = done >= task.n_steps or time.monotonic() - written > EVERY
        if keep is not None and comm.bcast(due):
            states = _in_order(comm, walk.states(), settings.chains)
            found = _joined(task, parts, done) if parts else None
            on_root(comm, lambda: _write(keep, found, task, settings, done, states))  # noqa: B023
            written = time.monotonic()
        if told is not None:
            told((done - first) / (task.n_steps - first))
    return _joined(task, parts, done)


def _next(done: int, task: Task) -> int:
    """Steps to the next place where the file may be written: never over the burn-in's end."""
    end = task.burn_in if done < task.burn_in else task.n_steps
    return min(CHUNK, end - done)


def _in_order(comm, own: list, n_chains: int) -> list:
    """What the ranks have of their chains, in the order of the chains. Collective."""
    every = comm.allgather(own)
    return [every[c % comm.size][c // comm.size] for c in range(n_chains)]


def _gathered(comm, found, w: int, n_chains: int):
    """Points, ln densities and acceptance of all walkers, in the order of the chains."""
    mine = len(range(comm.rank, n_chains, comm.size))
    return tuple(
        np.concatenate(_in_order(comm, [a[i * w : (i + 1) * w] for i in range(mine)], n_chains))
        for a in found
    )


def _joined(task: Task, parts, steps: int) -> Chains:
    lengths = np.array([part[0].shape[1] for part in parts], dtype=float)
    shares = np.array([part[2] for part in parts])
    values = np.concatenate([part[0] for part in parts], axis=1)
    return Chains(
        task.names,
        values,
        np.concatenate([part[1] for part in parts], axis=1),
        lengths @ shares / lengths.sum(),
        task.label,
        len(values) * steps * task.cost,
        {"steps": steps, "burn_in": task.burn_in, "walkers": task.walkers},
    )


# -- the file --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Kept:
    """What a file holds: where the chains are, and their parts after the burn-in."""

    steps: int
    burn_in: int
    states: list
    parts: list


def _write(path: Path, found: Chains | None, task: Task, settings, steps: int, states) -> None:
    """Write draws, if there are any yet, and what the chains go on from."""
    marks = {
        key: [float(v) if np.isfinite(v) else None for v in np.ravel(mark)]
        for key, mark in task.marks.items()
    }
    resume = {
        "names": list(task.names),
        "settings": asdict(settings),
        "steps": steps,
        "burn_in": task.burn_in,
        "states": states,
        "marks": marks,
        "acceptance": None if found is None else found.acceptance.tolist(),
    }
    draws = {} if found is None else found.by_name()
    write_chains(path, draws, {} if found is None else {"lp": found.log_density}, resume)


def _kept(comm, path: Path, task: Task, settings: Settings) -> _Kept | None:
    """What the file holds; None if it is not there. Collective."""
    found = comm.bcast(on_root(comm, lambda: read_chains(path) if path.exists() else None))
    if found is None:
        return None
    draws, statistics, resume = found
    if resume["names"] != list(task.names):
        raise InputError(
            f"{path}: holds chains of {', '.join(resume['names'])}; expected "
            f"{', '.join(task.names)}. Choose another file."
        )
    again = "expected the same to go on from them, or a new name"
    for key, now in asdict(settings).items():
        then = resume["settings"].get(key)
        if key not in ("samples", "burn_in") and then != now:
            raise InputError(f"{path}: holds chains with {key} = {then}, not {now}; {again}")
    for key, mark in task.marks.items():
        then = np.array([np.nan if v is None else v for v in resume["marks"].get(key, [])])
        now = np.where(np.isfinite(mark), mark, np.nan).ravel()
        close = _ALIKE if key == "model" else 1e-12
        if then.shape != now.shape or not np.allclose(then, now, 1e-9, close, equal_nan=True):
            raise InputError(f"{path}: holds chains with {_OTHER[key]}; {again}")
    parts = []
    if draws:
        values = np.stack([draws[name] for name in task.names], axis=2)
        parts = [(values, statistics["lp"], np.array(resume["acceptance"]))]
    return _Kept(resume["steps"], resume["burn_in"], resume["states"], parts)

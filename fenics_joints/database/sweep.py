"""Fills the database from analyses: ranks split over the samples, nothing computed twice."""

from __future__ import annotations

import datetime
import getpass
import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

from fenics_joints import __version__
from fenics_joints.database.joints import RESULTS, JointRow, settings_text
from fenics_joints.database.store import Store
from fenics_joints.errors import InputError, real, text
from fenics_joints.progress import Progress

#: Most samples of one sweep: a second each is a day and more.
_SAMPLES = 100_000


@dataclass(frozen=True)
class Sample:
    """Conditions to analyse, SI units.

    Attributes:
        bolt: Name of the thread.
        diameter: Nominal diameter of the bolt.
        force: Of the tightened bolt.
        thickness: Of one plate.
        roughness: Ra; None for smooth surfaces.
    """

    bolt: str
    diameter: float
    force: float
    thickness: float
    roughness: float | None = None

    def __post_init__(self) -> None:
        text("bolt", self.bolt)
        real("diameter", self.diameter, "m", above=0)
        real("force", self.force, "N", above=0)
        real("thickness", self.thickness, "m", above=0)
        if self.roughness is not None:
            real("roughness", self.roughness, "m", above=0)


@dataclass(frozen=True)
class SweepReport:
    """Outcome of a sweep.

    Attributes:
        computed: Samples analysed now, by all ranks.
        finished_before: Samples that the database already had.
        failed: Message of each sample that failed, now or before.
    """

    computed: int
    finished_before: int
    failed: dict[Sample, str]

    def __repr__(self) -> str:
        counts = f"{self.computed} computed, {self.finished_before} there before"
        return f"SweepReport({counts}, {len(self.failed)} failed)"


def grid(
    bolts: Sequence[str],
    forces: Sequence[float],
    thicknesses: Sequence[float],
    roughnesses: Sequence[float | None] = (None,),
) -> list[Sample]:
    """Samples of all combinations; raises InputError for an unknown bolt or too many of them."""
    from fenics_joints.preload.threads import thread

    number = math.prod(map(len, (bolts, forces, thicknesses, roughnesses)))
    if number > _SAMPLES:
        raise InputError(f"{number} samples: expected at most {_SAMPLES}")
    threads = [thread(name) for name in bolts]
    combinations = itertools.product(threads, thicknesses, forces, roughnesses)
    return [Sample(t.name, t.diameter, force, b, ra) for t, b, force, ra in combinations]


def sweep(
    samples: Sequence[Sample],
    analyse: Callable[..., Mapping[str, float]],
    store: Store,
    comm=None,
    progress: Progress | None = None,
    *,
    model: str,
    settings: Mapping[str, object] | None = None,
    author: str | None = None,
    source: str | None = None,
    retry: bool = False,
) -> SweepReport:
    """Analyse all samples that the database does not have yet. Collective.

    Each rank takes every n-th sample, analyses it alone and commits its row before it goes on to
    the next. So a killed sweep that is started again computes only what was not finished. A sample
    whose analysis raises is recorded with its message, and the others go on.

    Args:
        samples: The same on every rank; each must make a valid row.
        analyse: Called as ``analyse(sample, **settings)``; it must work on ``MPI.COMM_SELF``, and
            returns radius, pressure, E, nu, h or some of them, in SI units.
        store: Every rank its own, of one file.
        comm: MPI communicator; the world by default.
        progress: Of rank 0.
        model: Name of the model, for the rows.
        settings: Keyword arguments of ``analyse``, recorded with the rows.
        author: For the rows; the user's name by default.
        source: For the rows.
        retry: Analyse again what failed before.

    Raises:
        InputError: If settings are no JSON, or several ranks share a database in memory.
    """
    from mpi4py import MPI

    comm = MPI.COMM_WORLD if comm is None else comm
    progress = Progress(silent=True) if progress is None else progress
    if comm.size > 1 and store.path == ":memory:":
        raise InputError("a database in memory cannot be filled by several ranks; expected a file")
    settings = dict(settings or {})
    common = {
        "model": model,
        "settings": settings_text(settings),
        "author": author or user_name(),
        "version": f"fenics-joints {__version__}",
        "source": source,
    }
    # A result of any value makes a whole row, whose task is known before the analysis.
    tasks = {JointRow(**asdict(s), **common, radius=1.0).task: s for s in samples}
    finished = todo = None
    if comm.rank == 0:
        finished = store.finished(tasks)
        skipped = () if retry else store.failed(tasks)
        todo = [t for t in tasks if t not in finished and t not in skipped]
    todo = comm.bcast(todo)
    own = todo[comm.rank :: comm.size]
    progress.step(f"analysing {len(todo)} samples", total=len(own))
    for task in own:
        _analyse(tasks[task], task, analyse, settings, common, store)
        progress.advance()
    comm.Barrier()
    report = None
    if comm.rank == 0:
        failed = {tasks[task]: message for task, message in store.failed(tasks).items()}
        report = SweepReport(len(store.finished(todo)), len(finished), failed)
    return comm.bcast(report)


def now() -> str:
    """Date and time, as ISO 8601."""
    return datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")


def user_name() -> str:
    """The name of who runs this, as the machine knows it."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user may have no name
        return "unknown"


def _analyse(sample: Sample, task: str, analyse, settings, common, store: Store) -> None:
    date = now()
    try:
        found = analyse(sample, **settings).items()
        # Numpy's numbers as Python's.
        results = {name: v.item() if hasattr(v, "item") else v for name, v in found}
        unknown = set(results) - set(RESULTS)
        if unknown:
            raise InputError(f"results {sorted(unknown)}, expected some of {', '.join(RESULTS)}")
        joint = JointRow(**asdict(sample), **common, **results, date=date)
    except Exception as error:  # whatever it is, the other samples are wanted
        message = f"{type(error).__name__}: {error}"
        store.fail(task, json.dumps(asdict(sample)), message, date)
    else:
        store.finish(joint)

"""Fits of many hypotheses, spread over the ranks: each needs nothing but arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from mpi4py import MPI

from fenics_joints.errors import JointsError

__all__ = ["spread"]

Task, Result = TypeVar("Task"), TypeVar("Result")


def spread(
    comm: MPI.Intracomm,
    tasks: Sequence[Task],
    work: Callable[[Task], Result],
    pack: Callable[[Result], object] | None = None,
    unpack: Callable[[Task, object], Result] | None = None,
) -> list[Result]:
    """Results of ``work`` on every task, on all ranks, each done on one rank. Collective.

    Args:
        comm: Communicator.
        tasks: The same on all ranks, in the same order.
        work: What to do with a task, without communication.
        pack: Makes a result something that can be sent; results may hold functions that cannot.
        unpack: Makes it a result again, with the task.

    Raises:
        JointsError: What a task raised, on all ranks; RuntimeError for any other exception.
    """
    if comm.size == 1:
        return [work(task) for task in tasks]
    own, failure = {}, None
    for i in range(comm.rank, len(tasks), comm.size):
        try:
            result = work(tasks[i])
        except JointsError as error:
            failure = error
            break
        except Exception as error:  # or the others would wait for ever
            failure = RuntimeError(f"{type(error).__name__}: {error}")
            failure.__cause__ = error
            break
        own[i] = result if pack is None else pack(result)
    failures = [f for f in comm.allgather(failure) if f is not None]
    if failures:
        raise failures[0]
    found = {i: r for part in comm.allgather(own) for i, r in part.items()}
    ordered = [found[i] for i in range(len(tasks))]
    if unpack is None:
        return ordered
    return [unpack(task, r) for task, r in zip(tasks, ordered, strict=True)]

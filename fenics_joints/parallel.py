"""Work shared by ranks, which also fail together: one message, one exit code, no rank waits."""

from __future__ import annotations

import errno
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NoReturn, TypeVar

from fenics_joints.errors import JointsError
from fenics_joints.formatting import printable
from fenics_joints.machine.ranks import report
from fenics_joints.machine.signals import Stop, Terminated, stoppable

if TYPE_CHECKING:
    from mpi4py import MPI


T, Task, Result = TypeVar("T"), TypeVar("Task"), TypeVar("Result")

#: Libraries' messages if the machine, or a limit such as ulimit -v, gives no more memory.
_NO_MEMORY = ("Cannot allocate memory", "failed to map segment", "Out of memory", "INFOG(1)=-13")
#: Errors that concern a file, though they may not name it: what is wrong is no fault of ours.
_OF_FILES = tuple(
    getattr(errno, name)
    for name in ("ENOSPC", "EDQUOT", "EFBIG", "EIO", "EROFS", "EACCES", "EPIPE", "EBADF")
)
#: How long a failed rank waits for the others to fail too, in seconds.
_PATIENCE = 2.0


def on_root(comm: MPI.Intracomm, build: Callable[[], T]) -> T | None:
    """Call ``build`` on rank 0 only; if it raises, raise the same on every rank.

    Args:
        comm: Communicator; the call is collective.
        build: Function without arguments.

    Returns:
        What ``build`` returned on rank 0, None on the others.
    """
    result, error = None, None
    if comm.rank == 0:
        try:
            result = build()
        except Exception as caught:
            error = caught
    error = comm.bcast(error, root=0)
    if error is not None:
        raise error
    return result


def fail_alike(comm: MPI.Intracomm, work: Callable[[], T]) -> T:
    """What ``work`` returns on this rank; if it raises on any rank, raise on all. Collective.

    Args:
        comm: Communicator.
        work: Function without arguments, and without communication.

    Raises:
        JointsError: What it raised, on all ranks; RuntimeError for any other exception.
    """
    if comm.size == 1:
        return work()
    result = failure = None
    try:
        result = work()
    except JointsError as error:
        failure = error
    except Exception as error:  # or the others would wait for ever
        failure = RuntimeError(f"{type(error).__name__}: {error}")
        failure.__cause__ = error
    failures = [f for f in comm.allgather(failure) if f is not None]
    if failures:
        raise failures[0]
    return result


def spread(
    comm: MPI.Intracomm,
    tasks: Sequence[Task],
    work: Callable[[Task], Result],
    pack: Callable[[Result], object] | None = None,
    unpack: Callable[[Task, object], Result] | None = None,
) -> list[Result]:
    """Results of ``work`` on every task, on all ranks, each done on one rank. Collective.

    A rank that is done takes the next task, so that which rank does which changes from run to run.

    Args:
        comm: Communicator.
        tasks: The same on all ranks, in the same order.
        work: What to do with a task, without communication.
        pack: Makes a result something that can be sent; results may hold functions that cannot.
        unpack: Makes it a result again, with the task.

    Raises:
        JointsError: See `fail_alike`.
    """
    if comm.size == 1:
        return [work(task) for task in tasks]

    def own() -> dict[int, object]:
        found, i = {}, comm.rank
        while i < len(tasks):
            result = work(tasks[i])
            found[i] = result if pack is None else pack(result)
            i = following(i)
        return found

    with _turns(comm) as following:
        parts = comm.allgather(fail_alike(comm, own))
    found = {i: r for part in parts for i, r in part.items()}
    ordered = [found[i] for i in range(len(tasks))]
    if unpack is None:
        return ordered
    return [unpack(task, r) for task, r in zip(tasks, ordered, strict=True)]


@contextmanager
def _turns(comm: MPI.Intracomm) -> Iterator[Callable[[int], int]]:
    """Gives the number of the next task after one: that which no rank has taken, if all ranks share
    a memory, where a rank can count without another one's help. Collective."""
    from mpi4py import MPI

    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    together = comm.allreduce(node.size) == comm.size**2
    node.Free()
    if not together:
        yield lambda task: task + comm.size
        return
    window = MPI.Win.Allocate(8 * (comm.rank == 0), 8, comm=comm)
    one, taken = bytearray((1).to_bytes(8, sys.byteorder)), bytearray(8)
    if comm.rank == 0:
        memoryview(window)[:] = bytes(8)
    comm.Barrier()

    def following(_: int) -> int:
        window.Lock(0)
        window.Fetch_and_op([one, MPI.INT64_T], [taken, MPI.INT64_T], 0)
        window.Unlock(0)
        return comm.size + int.from_bytes(taken, sys.byteorder)

    try:
        yield following
    except Exception:  # on all ranks alike; a signal may come to one of them alone
        window.Free()
        raise
    window.Free()


@contextmanager
def guarded(debug: bool = False) -> Iterator[None]:
    """Turn what is raised inside into a message on standard error and an exit code.

    Exit codes: 1 for an error, 130 for Ctrl-C, 143 for SIGTERM, 129 for SIGHUP. Under MPI rank 0
    speaks; a rank that fails alone speaks itself and ends the others, which would wait for it for
    ever. Collective.

    Args:
        debug: Show the traceback as well.
    """
    with stoppable() as stop:
        from mpi4py import MPI

        # Its own channel: the failed rank may have left a message pending on the common one.
        comm = MPI.COMM_WORLD.Dup()
        try:
            yield
        except (KeyboardInterrupt, Terminated):
            _end(comm, stop)
        except Exception as error:
            if stop.number is not None:  # its exception was lost in a callback
                _end(comm, stop)
            stop.leaving = True
            if debug:
                traceback.print_exc(file=sys.__stderr__)
            alone = not _all_arrive(comm)
            _say(_message(error, comm.rank, alone) if comm.rank == 0 or alone else None)
            if alone:
                _abort(comm, 1)
            if _no_memory(error):  # the interpreter's and MPI's own ends would fail too, at length
                _leave(1)
            sys.exit(1)
        comm.Free()


def _end(comm, stop: Stop) -> NoReturn:
    stop.leaving = True
    _say("stopped; no file is left half-written" if comm.rank == 0 else None)
    if comm.size > 1:
        # If all ranks got the signal, as by Ctrl-C, none needs MPI_Abort and the page it prints.
        # MPI_Finalize would wait for lost messages.
        if not _all_arrive(comm):
            _abort(comm, stop.exit_code)
        _leave(stop.exit_code)
    sys.exit(stop.exit_code)


def _abort(comm, exit_code: int) -> None:
    report(exit_code)
    comm.Abort(exit_code)


def _leave(exit_code: int) -> NoReturn:
    """End here, without what the interpreter and MPI do at their ends."""
    report(exit_code)
    with suppress(OSError, MemoryError):
        sys.stdout.flush()
    os._exit(exit_code)


def _message(error: Exception, rank: int, alone: bool) -> str:
    where = f" (on rank {rank})" if alone else ""
    if isinstance(error, JointsError):
        return f"error{where}: {error}"
    said = printable(str(error))
    if _no_memory(error):
        return f"error{where}: there is no memory left for this process" + (said and f" ({said})")
    file = getattr(error, "filename", None) if isinstance(error, OSError) else None
    if isinstance(file, str | bytes):
        return f"error{where}: {printable(os.fsdecode(file))}: {error.strerror or said}"
    if isinstance(error, OSError) and error.errno in _OF_FILES:  # a full disk, a closed stream
        named = "standard output" if _is_stuck(sys.stdout) else "a file"
        return f"error{where}: {named}: {error.strerror or said}"
    return (
        f"error{where}: unexpected {type(error).__name__}: {said}\n"
        "Run again with --debug to see where, and please report it."
    )


def _no_memory(error: BaseException | None) -> bool:
    """Whether memory ran out: an import that fails for it may raise something else from that."""
    met: list[BaseException] = []
    while error is not None and error not in met:  # an error raised again may be its own cause
        met.append(error)
        said = str(error)
        if isinstance(error, MemoryError) or any(words in said for words in _NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False


def _is_stuck(stream) -> bool:
    """Whether printed output cannot be written: a full disk, a closed stream."""
    try:
        stream.flush()
    except OSError:
        return True
    return False


def _say(message: str | None) -> None:
    if message is not None:
        with suppress(OSError):  # a full disk under standard error
            print(message, file=sys.__stderr__, flush=True)


def _all_arrive(comm) -> bool:
    """Whether all ranks come here in time: most errors are the same on every rank."""
    if comm.size == 1:
        return True
    request = comm.Ibarrier()
    # Ranks give up one after the other, so that the first to do so is the only one to speak.
    end = time.monotonic() + _PATIENCE + 0.5 * comm.rank
    while time.monotonic() < end:
        if request.Test():
            return True
        time.sleep(0.01)
    return False

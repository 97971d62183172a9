"""Tasks spread over ranks: each is done once, all ranks know it, none waits for a failed one."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.parallel import guarded, spread

pytestmark = pytest.mark.parallel


def test_every_task_is_done_once_and_known_everywhere():
    comm, done = MPI.COMM_WORLD, []

    def work(task):
        done.append(task)
        return {"twice": 2 * task, "by": lambda: None}  # cannot be sent

    tasks = list(range(7))
    found = spread(
        comm, tasks, work, pack=lambda r: r["twice"], unpack=lambda t, r: {"twice": r, "task": t}
    )
    assert [r["twice"] for r in found] == [2 * t for t in tasks]
    assert sorted(sum(comm.allgather(done), [])) == tasks
    assert spread(comm, [], work) == []
    if comm.size > 1:
        assert [r["task"] for r in found] == tasks and len(done) < len(tasks)


@pytest.mark.parametrize("failing", [0, 1, 4])
def test_a_failure_is_raised_on_all_ranks(failing):
    comm = MPI.COMM_WORLD

    def work(task):
        if task == failing:
            raise ConvergenceError(f"task {task}")
        return task

    with pytest.raises(ConvergenceError, match=f"task {failing}"):
        spread(comm, range(5), work)
    # Nobody waits: the next call finds all ranks at one place.
    assert spread(comm, range(3), lambda task: task) == [0, 1, 2]


def test_of_several_failures_all_ranks_raise_the_same():
    comm = MPI.COMM_WORLD

    def work(task):
        raise InputError(f"task {task}")

    with pytest.raises(InputError) as caught:
        spread(comm, range(4), work)
    assert comm.allgather(str(caught.value)) == ["task 0"] * comm.size


def test_errors_that_cause_each_other_end_the_command():
    """As one that a search raises again after others."""
    first, second = InputError("first"), InputError("second")
    first.__cause__, second.__cause__ = second, first
    with pytest.raises(SystemExit) as end, guarded():
        raise first
    assert end.value.code == 1

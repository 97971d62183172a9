"""What all tests share. Imports no DOLFINx, so that the launcher's tests run without it."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave slow tests out of any selection that does not speak of them, as ``-m parallel``."""
    if "slow" in (config.getoption("markexpr") or ""):
        return
    slow = [item for item in items if item.get_closest_marker("slow")]
    if slow:
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if item not in slow]


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    """Destroy PETSc objects at the same place on all ranks: their destructors are collective."""
    gc.collect()
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is not None and mpi.Is_initialized():
        mpi.COMM_WORLD.barrier()


@pytest.fixture
def shared_tmp_path(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty directory that all ranks know by the same path; rank 0 makes it."""
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    yield comm.bcast(tmp_path_factory.mktemp("shared") if comm.rank == 0 else None)
    comm.barrier()

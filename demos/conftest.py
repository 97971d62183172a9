"""What the tests of the demos share."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
#: What Open MPI asks for in containers and on machines with few cores, where other tests run too.
_MPI = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}
#: The tests' own process may itself be a rank; its children must not take themselves for one.
_RANK = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_")


@pytest.fixture
def run_script() -> Callable[..., str]:
    """``run_script(script, *arguments, ranks=1)`` runs it from the repository; its output."""

    def run(script: Path, *arguments: str, ranks: int = 1, seconds: float = 600) -> str:
        environment = {k: v for k, v in os.environ.items() if not k.startswith(_RANK)}
        environment |= _MPI | {"OMP_NUM_THREADS": "1"}
        mpirun = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
        done = subprocess.run(
            [*mpirun, sys.executable, str(script), *arguments],
            cwd=REPOSITORY,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=seconds,
        )
        if done.returncode:
            pytest.fail(f"{script.name} on {ranks} ranks:\n{done.stdout}\n{done.stderr}")
        return done.stdout

    return run

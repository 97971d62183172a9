"""What a result comes from: the command, its inputs and the programs that made it."""

from __future__ import annotations

import hashlib
import platform
import shlex
import sys
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

import fenics_joints
from fenics_joints.files import file_digest, shown_path
from fenics_joints.formatting import printable
from fenics_joints.parallel import on_root

if TYPE_CHECKING:
    from mpi4py import MPI

    from fenics_joints.case import Case


def provenance(
    comm: MPI.Intracomm, case: Case | None, changes: Sequence[str] = ()
) -> dict[str, object]:
    """What makes a result traceable, plain values for JSON; empty on ranks other than 0.

    Returns:
        ``date`` (UTC), ``command``, ``case`` (its file), ``changes`` (of ``--set``), ``inputs``
        (SHA-256 of each file that the case is read from, by its name beside the case),
        ``inputs_sha256`` (of all of them and the changes), ``seed`` (of the case's random numbers;
        those of a diagnosis are fixed), ``ranks``, and the versions of ``fenics_joints``,
        ``dolfinx``, ``petsc`` and ``python``. Collective.
    """
    return on_root(comm, lambda: _collected(comm.size, case, changes)) or {}


def _collected(ranks: int, case: Case | None, changes: Sequence[str]) -> dict[str, object]:
    import dolfinx
    from petsc4py import PETSc

    sampled = None if case is None or case.update is None else case.update.bayes
    found = [] if case is None else [(path, _sha256(path)) for path in case.files()]
    inputs = {_beside(path, case.path.parent): digest for path, digest in found if digest}
    whole = hashlib.sha256("\n".join([*inputs.values(), *changes]).encode()).hexdigest()
    words = ["fenics-joints", *map(printable, sys.argv[1:])]
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "command": shlex.join(words),
        "case": "" if case is None else shown_path(case.path),
        "changes": list(map(printable, changes)),
        "inputs": inputs,
        "inputs_sha256": whole,
        "seed": None if sampled is None else sampled.seed,
        "ranks": ranks,
        "fenics_joints": fenics_joints.__version__,
        "dolfinx": dolfinx.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "python": platform.python_version(),
    }


def _beside(path: Path, folder: Path) -> str:
    """A file's name as the case may give it."""
    resolved, folder = path.resolve(), folder.resolve()
    return shown_path(resolved.relative_to(folder) if resolved.is_relative_to(folder) else resolved)


def _sha256(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal; empty if it cannot be read."""
    try:
        return file_digest(path)
    except OSError:
        return ""

"""Keep libraries from reading settings in the working folder, which may be a stranger's.

PETSc reads ``petscrc`` there, which can name a library to load, DOLFINx
``dolfinx_jit_options.json``, which can name any program as the compiler, UCX below MPI
``ucx.conf``, matplotlib ``matplotlibrc``, ArviZ ``arvizrc``. The ``fenics-joints`` command may be
run in a folder that came with a case, so it ignores these files; settings in the home folder and
the environment hold as ever. A script of the user's own keeps its settings: importing
`fenics_joints` changes nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from importlib.machinery import ModuleSpec, PathFinder

from fenics_joints.machine.private import empty_folder

_NAMES = ("mpi4py.MPI", "petsc4py.PETSc", "matplotlib", "arviz_base", "arviz.rcparams")


class _Finder:
    """Finds these modules as Python does, and imports them in an empty working folder."""

    def find_spec(self, name: str, path, target=None) -> ModuleSpec | None:
        """The specification of one of these modules; None for any other."""
        spec = PathFinder.find_spec(name, path, target) if name in _NAMES else None
        if spec is not None and spec.loader is not None:
            for step in ("create_module", "exec_module"):
                setattr(spec.loader, step, _elsewhere(getattr(spec.loader, step)))
        return spec


def _elsewhere(step: Callable) -> Callable:
    def done(argument):
        with empty_folder():
            return step(argument)

    return done


def guard() -> None:
    """Ignore settings in the working folder, from here on in this process."""
    if not _guarded():
        sys.meta_path.insert(0, _Finder())


def without_local_settings() -> AbstractContextManager:
    """An empty working folder once `guard` was called; otherwise the working folder stays."""
    return empty_folder() if _guarded() else nullcontext()


def _guarded() -> bool:
    return any(isinstance(finder, _Finder) for finder in sys.meta_path)

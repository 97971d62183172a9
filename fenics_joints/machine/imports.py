"""Libraries that would take settings from the working folder, which may be a stranger's.

PETSc reads ``petscrc`` there, which can name a library to load, UCX below MPI ``ucx.conf``,
matplotlib ``matplotlibrc``, ArviZ ``arvizrc``. They are imported in an empty folder; settings in
the home folder and the environment hold as ever.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.machinery import ModuleSpec, PathFinder

from fenics_joints.machine.private import empty_folder

__all__ = ["guard"]

_NAMES = ("mpi4py.MPI", "petsc4py.PETSc", "matplotlib", "arviz_base", "arviz.rcparams")


class _Finder:
    """Finds these modules as Python does, and lets them be made in an empty folder."""

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
    """Let these libraries be imported so, from here on in this process; again does nothing."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())

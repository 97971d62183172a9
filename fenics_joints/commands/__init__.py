"""What ``fenics-joints`` runs: from a case to an `Outcome`, a folder for each command.

The functions are imported when they are first asked for: ``--help`` needs none of them.
"""

from __future__ import annotations

from importlib import import_module

from fenics_joints.commands.outcome import Outcome

#: Files of the commands.
_FILES = {
    "bayes": "bayes.run",
    "check": "check.run",
    "cutoff": "cutoff",
    "diagnose": "diagnose.run",
    "harmonic": "harmonic.run",
    "modes": "modes",
    "plan": "plan",
    "preload": "preload",
    "update": "update.run",
}
_RUNS = {f"run_{command}": f"{__name__}.{file}" for command, file in _FILES.items()}

__all__ = ["Outcome", *_RUNS]


def __getattr__(name: str):
    """A command's function, imported when it is first asked for."""
    if name not in _RUNS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_RUNS[name]), name)

"""What ``fenics-joints`` runs: from a case to an `Outcome`, a file or a folder for each command.

The functions are imported when they are first asked for: ``--help`` needs none of them.
"""

from __future__ import annotations

from fenics_joints.commands.outcome import Outcome
from fenics_joints.machine.lazy import lazy

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
_RUNS = {f"run_{command}": (file,) for command, file in _FILES.items()}

__all__ = ["Outcome", *_RUNS]

__getattr__ = lazy(__name__, _RUNS)

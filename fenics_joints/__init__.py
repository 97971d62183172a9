"""Bolted joints for FEniCSx: models, preload, updating and diagnosis of the sim-to-real gap.

Each room imports from those before it only. From the mesh to the command line:

- ``forms``, ``meshes``: UFL of joints; meshes with their parts, rings and faces by name.
- ``structure``, ``modal``: K(p) and M(p) of parts and joints; modes and their sensitivities.
- ``joint_laws``, ``preload``, ``response``: laws with memory; contact under bolt forces; frequency
  response and complex modes.
- ``measurements``, ``reduction``, ``beams``, ``interfaces``: what a test gave; small models of
  large ones; bolted beams; small models that keep their joints.
- ``harmonic``, ``transient``, ``random_fields``: nonlinear response; joints that vary in space.
- ``updating``, ``bayes``, ``database``: parameters from a test, and how surely; published joints.
- ``case``, ``diagnosis``: the case file; where a model is wrong, which effect causes it.
- ``report``, ``commands``: pages and pictures; what ``fenics-joints`` runs.

``fenics_joints.modal.solve_modes`` works after ``import fenics_joints`` alone: rooms are imported
when they are first asked for.
"""

from __future__ import annotations

from importlib.util import find_spec

from fenics_joints.machine.lazy import lazy

_NEEDED = ("mpi4py", "petsc4py", "slepc4py", "dolfinx")
_MISSING = [name for name in _NEEDED if find_spec(name) is None]
if _MISSING:
    raise ImportError(
        "fenics_joints needs FEniCSx, which pip cannot provide; missing here: "
        f"{', '.join(_MISSING)}. "
        "Install it with 'conda install -c conda-forge fenics-dolfinx slepc4py python-gmsh', "
        "or 'apt install python3-dolfinx-real python3-slepc4py-real python3-gmsh' "
        "(Debian 13, Ubuntu 25.04 or newer), "
        "or run everything through ./with-fenicsx from a checkout."
    )

__version__ = "0.2.0"

_ROOMS = (
    "forms",
    "meshes",
    "structure",
    "modal",
    "joint_laws",
    "preload",
    "response",
    "measurements",
    "reduction",
    "beams",
    "interfaces",
    "harmonic",
    "transient",
    "random_fields",
    "updating",
    "bayes",
    "database",
    "case",
    "diagnosis",
    "report",
    "commands",
)

__all__ = ["__version__"]


__getattr__ = lazy(__name__, {room: (room,) for room in _ROOMS})


def __dir__() -> list[str]:
    return sorted({*globals(), *_ROOMS})

"""Bolted joints for FEniCSx: models, preload, updating and diagnosis of the sim-to-real gap."""

from __future__ import annotations

from importlib.util import find_spec

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

__version__ = "0.1.0"

"""A short name for a model that is kept in a file: of everything that it depends on."""

from __future__ import annotations

import hashlib
import json

from fenics_joints import __version__
from fenics_joints.case.case import Case
from fenics_joints.structure import Sensors, Structure

__all__ = ["fingerprint"]

_TABLES = (
    "mesh", "parts", "joints", "contacts", "bolts", "masses", "springs", "supports", "attached",
)  # fmt: skip


def fingerprint(case: Case, full: Structure, sensors: Sensors | None, *more: object) -> str:
    """16 hexadecimal digits. Collective.

    Args:
        case: The case, of which the tables that make the model count.
        full: The full model; a mesh from a file is known by its cells and the regions' volumes.
        sensors: What the test saw.
        more: What else the kept model depends on, for JSON.
    """
    said = case.model_dump(mode="json", include=set(_TABLES), warnings=False)
    seen = [] if sensors is None else [sensors.points.tolist(), sensors.directions.tolist()]
    cells = full.mesh.topology.index_map(full.mesh.topology.dim).size_global
    sizes = [f"{volume:.6e}" for volume in full.volumes()]
    content = [__version__, said, seen, cells, full.n_dofs, sizes, case.diagnose.n_modes, more]
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]

"""A short name for a model that is kept in a file: of everything that it depends on."""

from __future__ import annotations

import dolfinx

from fenics_joints import __version__
from fenics_joints.case.case import Case
from fenics_joints.files import json_digest
from fenics_joints.structure import Sensors, Structure

_TABLES = (
    "mesh",
    "parts",
    "joints",
    "contacts",
    "bolts",
    "masses",
    "springs",
    "supports",
    "attached",
)


def fingerprint(case: Case, full: Structure, sensors: Sensors | None, *more: object) -> str:
    """16 hexadecimal digits, the same on any number of ranks. Collective.

    Args:
        case: The case, of which the tables that make the model count.
        full: The full model, of solids or beams; a mesh from a file counts by its content, not by
            the file's name.
        sensors: What the test saw.
        more: What else the kept model depends on, for JSON.
    """
    said = case.model_dump(mode="json", include=set(_TABLES), warnings=False)
    said["mesh"].pop("file", None)
    seen = [] if sensors is None else [sensors.points.tolist(), sensors.directions.tolist()]
    content = [
        __version__,
        dolfinx.__version__,
        said,
        seen,
        full.n_dofs,
        full.tagged.digest if full.is_meshed else "",
        [region.law.digest for region in getattr(full, "regions", ())],
        case.diagnose.n_modes,
        case.diagnose.samples,
        more,
    ]
    return json_digest(content, default=str)[:16]

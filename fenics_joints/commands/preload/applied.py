"""What is said of obstacles, displacements and loads in a preload state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.formatting import number, prefixed
from fenics_joints.preload import Displacement, Obstacle, PreloadResult

#: Components below this share of the largest are round-off.
_ZERO = 1e-9


def applied_facts(result: PreloadResult) -> list[dict]:
    """What acts on faces beside bolts, and what comes of it. Collective.

    Returns:
        Of each a dict with ``name``, ``kind`` (``obstacle``, ``displacement``, ``load``),
        ``displacement_m`` by direction (of an obstacle its own; None where a face is free, and of a
        load) and ``force_n`` on the bodies by direction: of a displacement what holds the face.
    """
    model, found = result.model, []
    for moved in sorted(model.moved, key=lambda m: isinstance(m, Displacement)):
        kind = "obstacle" if isinstance(moved, Obstacle) else "displacement"
        way = result.motion(moved.name).tolist()
        if isinstance(moved, Displacement):
            way = [None if v is None else w for v, w in zip(moved.value, way, strict=True)]
        force = result.reaction(moved.name)
        found.append(_facts(moved.name, kind, way, force))
    for name, force in model.resultants.items():
        found.append(_facts(name, "load", None, result.forces[name] * force))
    return found


def _facts(name: str, kind: str, way: list | None, force: np.ndarray) -> dict:
    return {"name": name, "kind": kind, "displacement_m": way, "force_n": force.tolist()}


def applied_rows(facts: list[dict]) -> list[tuple[str, str, str, str]]:
    """Name, kind, displacement and force on the bodies of each, in words."""
    return [
        (
            f["name"],
            f["kind"],
            "" if f["displacement_m"] is None else _words(f["displacement_m"], "m"),
            _words(f["force_n"], "N"),
        )
        for f in facts
    ]


def _words(vector: Sequence[float | None], unit: str) -> str:
    """A vector in the unit that suits its largest component."""
    size = max(abs(v or 0.0) for v in vector)
    factor, unit = prefixed(size, unit)
    parts = (
        "free" if v is None else number(v * factor if abs(v) > _ZERO * size else 0.0)
        for v in vector
    )
    return f"({', '.join(parts)}) {unit}"

"""What is solved once for a geometry and kept in files."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np

from .whole import Whole

#: Outside version control; safe to delete.
CACHE = Path(__file__).resolve().parent.parent / "cache"


def kept(what: str, whole: Whole, more: bytes = b"") -> Path:
    """The file for something that follows from a rig, its mesh and these bytes."""
    key = repr(whole.rig).encode() + whole.points.round(9).tobytes() + more
    key += b"".join(body.reference.round(9).tobytes() for body in whole.bodies)
    return CACHE / f"{what}_{whole.rig.name}_{hashlib.sha256(key).hexdigest()[:12]}.npz"


def keep(file: Path, **arrays: np.ndarray) -> None:
    """Write arrays so that no other process ever reads half of them."""
    file.parent.mkdir(exist_ok=True)
    part = file.with_name(f"{file.stem}.{os.getpid()}.npz")
    np.savez_compressed(part, **arrays)
    part.replace(file)

"""The world of the blind check: structures and tests whose truth is known, and nobody's model.

It shares no code with the package that it checks.
"""

from .cases import (
    GEOMETRIES,
    NOISE,
    Truth,
    clean,
    generate,
    nominal_spec,
    plan,
    signature,
)
from .effects import EFFECTS, FINAL_ONLY, LIBRARY, UNKNOWN, draw, regions
from .specimen import Spec

__all__ = [
    "EFFECTS", "FINAL_ONLY", "GEOMETRIES", "LIBRARY", "NOISE", "UNKNOWN", "Spec", "Truth", "clean",
    "draw", "generate", "nominal_spec", "plan", "regions", "signature",
]  # fmt: skip

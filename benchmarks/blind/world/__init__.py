"""The world of the blind check: structures and tests whose truth is known, and nobody's model.

It shares no code with the package that it checks.
"""

from .cases import (
    GEOMETRIES,
    NOISE,
    Truth,
    clean,
    generate,
    noise_word,
    nominal_spec,
    plan,
    signature,
    write_nominal,
)
from .effects import EFFECTS, FINAL_ONLY, LIBRARY, UNKNOWN, draw, regions
from .specimen import Spec

#: Whether an answer by class counts only while the class is small.
SMALL_CLASSES = False

__all__ = [
    "EFFECTS",
    "FINAL_ONLY",
    "GEOMETRIES",
    "LIBRARY",
    "NOISE",
    "SMALL_CLASSES",
    "UNKNOWN",
    "Spec",
    "Truth",
    "clean",
    "draw",
    "generate",
    "noise_word",
    "nominal_spec",
    "plan",
    "regions",
    "signature",
    "write_nominal",
]

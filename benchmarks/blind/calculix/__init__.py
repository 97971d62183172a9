"""The second world of the blind check: structures solved by CalculiX, and nobody's model.

Other geometries, other meshes, other joints and other unknown causes than those of `world`; it
shares no code with the package that it checks, nor with the first world.
"""

from . import cases, effects, specimen
from .cases import GEOMETRIES, generate, noise_word, nominal_spec, plan, write_nominal
from .effects import EFFECTS, LIBRARY, UNKNOWN, draw, regions, touching
from .program import MISSING, CalculixError, find_program
from .specimen import Spec, clean

#: Whether an answer by class counts only while the class is small.
SMALL_CLASSES = True

__all__ = [
    "EFFECTS",
    "GEOMETRIES",
    "LIBRARY",
    "MISSING",
    "SMALL_CLASSES",
    "UNKNOWN",
    "CalculixError",
    "Spec",
    "cases",
    "clean",
    "draw",
    "effects",
    "find_program",
    "generate",
    "noise_word",
    "nominal_spec",
    "plan",
    "regions",
    "specimen",
    "touching",
    "write_nominal",
]

"""Names of the package are the field's words. Reads the sources; imports none of them."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: Names that readers had to have explained, and the word of the field that took their place.
EXPLAINED = {
    "LeanForward": "BatchPrediction",
    "Leans": "nothing",
    "leanest": "compress",
    "SeenModes": "MatchedModes",
    "seen_at": "match_modes",
    "likes": "ModeMatch",
    "Likes": "ModeMatch",
    "Surrogate": "ReducedModel",
    "lacking": "residual_directions",
    "bends": "shape_curvature",
    "settle": "reconverged",
    "nearer": "refine_location",
    "several": "add_effect",
    "together": "swap_effect",
    "Weighed": "MassMeasurement",
    "unlisted": "unknown_cause",
    "somewhere": "localised_unknown",
    "look_alike": "misattribution",
    "one_of_alike": "merge_indistinguishable",
    "stand_ins": "confusable_effects",
    "in_turn": "sequential",
    "told": "labelled",
    "Said": "FileMetadata",
    "hung": "attached_oscillator",
}


def test_names_are_plain_and_those_of_classes_mean_one_thing():
    """Names that had to be explained do not come back."""
    found, places = {}, {}
    for folder in ("fenics_joints", "forms", "meshes"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name in EXPLAINED:
                    found[path, node.name] = f"expected a name such as {EXPLAINED[node.name]}"
                if isinstance(node, ast.ClassDef):
                    places.setdefault(node.name, []).append(str(path))
    assert found == {}
    assert {name: paths for name, paths in places.items() if len(paths) > 1} == {}

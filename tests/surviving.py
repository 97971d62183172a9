#!/usr/bin/env python3
"""Tests that any rewriting has to leave: ``tests/surviving.txt``, a line each, and why.

    python3 tests/surviving.py            is each of them still there? exit status 1 if one is not
    python3 tests/surviving.py --write    put in what the rules below find besides

Nothing is ever dropped from the list by this script: who moves or joins tests edits it by hand, and
so shows it to who reads the change. Reads sources only, and imports none of them.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_name("surviving.txt")

#: Tests of refusals and of words elsewhere: these may be written anew.
NOT = r"refus|mistake|bad_|impossible|is_said|are_said|is_named$|odd_|wrong_requests|what_cannot_be"

#: Where refusals stay too.
FAILING = "a way to fail"
#: Chosen by reading: why, and patterns of test ids without ``tests/`` and ``test_``.
CHOSEN = {
    "closed form, or another route": """
        forms/*::* structure/*laws*::* structure/*supports::* structure/structure::* modal/modes::*
        modal/sensitivity::* joint_laws/*::* preload/beam::* preload/components::*
        preload/conditions::* preload/linear_joint::* preload/mortar::* preload/*obstacles::*
        preload/solve::* response/frf*::* reduction/*curvature::* reduction/reduced::*bound*
        beams/structure::* interfaces/*rigid::* interfaces/reduced::modal_damping*
        harmonic/backbone::* harmonic/events::* harmonic/frf::* harmonic/loads::*
        harmonic/static_mode::* harmonic/tracking::* transient/transient::*
        random_fields/fields::* updating/rounds::* updating/cutoff::* bayes/distributions::*
        bayes/samplers::conjugate* bayes/samplers::proposals* bayes/likelihood::*
        measurements/amplitude::* measurements/gap::*by_hand measurements/identification::*
        diagnosis/library::*evidence_is* diagnosis/library::p_value*
        diagnosis/library::compliances* diagnosis/library::more_torques*
        diagnosis/library::folds* diagnosis/library::detectable*
        diagnosis/library::classes* diagnosis/library::two_causes*
        diagnosis/cells::* diagnosis/evidence::* diagnosis/scales::*
        diagnosis/score_tests::* diagnosis/somewhere::its_evidence* diagnosis/bonded::*
        diagnosis/antiresonances::a_beam* diagnosis/functions::of_a_free_bar*
        diagnosis/static_stiffness::a_cantilever* diagnosis/weighed::* diagnosis/effects_joint::*
        meshes/*::*measures* meshes/*::*polygons* meshes/rings::* meshes/cad::* meshes/check::*
        case/applied::bar* case/applied::loads* system/own_mesh::*
        system/blind::*oracle* system/blind::*levels* system/blind::*pairs*
        system/blind_world::*balances* system/blind_world::*harmonic system/blind_calculix::*cone
        hall/units::*
    """,
    "derivatives by differences or Taylor's test": """
        *::*remainder* *::*taylor* *::*derivative* *::*gradient* *::*slopes* *::*differences*
        *::*jacobian* preload/adjoint::* response/shape_sensitivity::* harmonic/sensitivity::*
        meshes/engraving_machine::bolts*
    """,
    "another code or library": """
        modal/eigensolver::* modal/iterative::* harmonic/events::*stop_with_a_gap*
        database/process::* diagnosis/cells::*another_sampler* system/nonlinear_checks*::*
        system/blind_calculix::calculix* system/blind_calculix::the_world* joint_laws/*equation*
        database/kriging::*conditional* structure/model::*dense* interfaces/full::*
        harmonic/bifurcations::* harmonic/switching::* system/blind_world::*
        system/failure_modes::*
    """,
    "a paper's numbers": """
        forms/kinematics::* preload/torque::* beams/structure::*paper* beams/structure::*published*
        bayes/distributions::*figure* database/kriging::*papers* database/query::torque*
        database/analysis::* diagnosis/location::* diagnosis/effects_amplitude::*
        updating/fit::* case/beams::update* case/beams::functions*
        meshes/lap_beam::*papers_layer* case/cad::radius* harmonic/tracking::an_isola*
        diagnosis/score_tests::holm* demos/demos::*
    """,
    "a diagnosis with a known cause": """
        diagnosis/diagnose::* diagnosis/amplitude::* diagnosis/contacts::* diagnosis/sited::*
        diagnosis/location::* diagnosis/patches::*softened*
        diagnosis/held_out::*intervals* diagnosis/held_out::the_right* diagnosis/held_out::forecast*
        diagnosis/plan::*confus* diagnosis/search::the_true_pair* diagnosis/search::odds*
        diagnosis/search::an_effect* diagnosis/search::near_best* diagnosis/simulated::*
        diagnosis/linear_fits::* diagnosis/merging::* diagnosis/resolution::*
        diagnosis/somewhere::it_says* diagnosis/misattribution::* system/beam_diagnosis::*
    """,
    FAILING: """
        system/failure_modes::* system/bad_files::* system/fuzz::* system/kills::*
        system/parallel::* system/too_much::* system/blind::* machine/signals::*
        database/store::* database/sweep::* database/web/server::*
        reduction/files::* preload/solve::divergence measurements/tables::*
        measurements/measured_shapes::* measurements/frfs::* system/universal_shapes::*
        bayes/checks::intervals* bayes/checks::prior_that* bayes/hierarchical::intervals*
    """,
    "the order of the rooms": "system/rooms::*no_circle system/rooms::*imports*",
}


def tests() -> dict[str, set[str]]:
    """Ids of all tests, without parameters, and their marks."""
    found = {}
    for path in sorted([*ROOT.glob("tests/**/test_*.py"), *ROOT.glob("demos/test_*.py")]):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        of_file = {
            mark
            for line in tree.body
            if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "pytestmark"
            for mark in _marks(line.value)
        }
        name = path.relative_to(ROOT).as_posix()
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                marks = {mark for line in node.decorator_list for mark in _marks(line)}
                found[f"{name}::{node.name}"] = of_file | marks
            elif isinstance(node, ast.ClassDef) and node.name.startswith("Test"):
                for inner in node.body:
                    if isinstance(inner, ast.FunctionDef) and inner.name.startswith("test_"):
                        found[f"{name}::{node.name}::{inner.name}"] = of_file
    return found


def _marks(node: ast.AST) -> set[str]:
    return set(re.findall(r"pytest\.mark\.(\w+)", ast.unparse(node)))


def reasons() -> dict[str, list[str]]:
    """By the rules: each test that has to stay, and why."""
    found: dict[str, list[str]] = {}
    for name, marks in tests().items():
        plain = name.replace("tests/", "", 1).replace("test_", "").replace(".py::", "::")
        why = ["two ranks"] if "parallel" in marks else []
        refusal = re.search(NOT, plain.split("::")[-1])
        for reason, patterns in CHOSEN.items():
            if refusal and reason != FAILING:
                continue
            if any(fnmatch(plain, pattern) for pattern in patterns.split()):
                why.append(reason)
        if "survives" in marks:
            why.append("marked so")
        if why:
            found[name] = why
    return found


def listed() -> dict[str, str]:
    """The list: ids and reasons."""
    if not LIST.exists():
        return {}
    lines = LIST.read_text(encoding="utf-8").splitlines()
    rows = [line.split("  # ") for line in lines if line and not line.startswith("#")]
    return {name: why for name, why in rows}


def gone() -> list[str]:
    """Tests of the list that are no longer there."""
    return sorted(set(listed()) - set(tests()))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="add what the rules find")
    asked = parser.parse_args()
    if asked.write:
        rows = listed() | {name: ", ".join(why) for name, why in reasons().items()}
        text = "# By tests/surviving.py --write. A line that goes is a test that was given up.\n"
        text += "".join(f"{name}  # {rows[name]}\n" for name in sorted(rows))
        LIST.write_text(text, encoding="utf-8")
    lost = gone()
    print("".join(f"gone: {name}\n" for name in lost), end="")
    print(f"{len(listed()) - len(lost)} of {len(listed())} tests that have to stay are there")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())

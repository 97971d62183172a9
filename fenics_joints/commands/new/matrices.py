"""A case from stiffness and mass matrices of another code."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from fenics_joints.commands.new.draft import (
    UNBOLTED,
    Ask,
    Draft,
    guess,
    material_of,
    millimetres,
    parts_of,
    springs_joint,
)
from fenics_joints.commands.new.sources import UNITS, likely_unit
from fenics_joints.errors import InputError, member
from fenics_joints.files import is_file, shown_path
from fenics_joints.matrices import MatrixPart, NodeInterface
from fenics_joints.matrices.files import NAMES, matrix_part, read_dofs, read_matrix, read_nodes

#: Suffixes of the mass of files that hold one matrix each, by that of the stiffness.
_MASS = {".sti": (".mas",)}
#: Endings, after the name of the stiffness' file, of the nodes and of the table of DOFs.
_NODES, _DOFS = (".inp", "_nodes.csv", ".csv"), (".dof", "_dofs.csv")
#: What a user is to know who has no other code's file of these names.
_EXPECTED = (
    "expected NAME.sti with NAME.mas, NAME.dof and NAME.inp of CalculiX; or NAME.op4, .npz, .mat, "
    ".pch or .full with K and M, or NAME_K.mtx with NAME_M.mtx; with NAME_nodes.csv (node, x, y, "
    "z) and NAME_dofs.csv (node, direction from 1 to 6)"
)


def matrices_draft(
    paths: Sequence[Path], named: Callable[[Path], str], places: np.ndarray, material: str, ask: Ask
) -> Draft:
    """The case of parts by matrices, joined where they touch.

    Args:
        paths: The stiffness of each part.
        named: Name of a file in the case.
        places: Sensors of the test, m, which say the unit; (n, 3).
        material: Of parts whose name says none.
        ask: Asks the user.

    Raises:
        InputError: If a file is missing or wrong.
    """
    files = {_stem(path): _files(path) for path in paths}
    if len(files) < len(paths):
        raise InputError(f"expected files of different names: {', '.join(map(str, paths))}")
    said = {name: read_nodes(own["nodes"]) for name, own in files.items()}
    extent = max(np.ptp(np.array(list(s.points.values())), axis=0).max() for s in said.values())
    span = np.ptp(places, axis=0).max() if len(places) > 2 else 0.0
    likely = likely_unit([extent], None if not span else np.array([span]))
    question = f"Unit of lengths in the matrices' files (nodes span {extent:.6g})"
    unit = ask(question, likely, lambda answer: member("unit", answer, UNITS))
    parts, tables = {}, {}
    for name, own in files.items():
        parts[name], tables[name] = _part(name, own, said[name], UNITS[unit], named)
    values = {name: (name, "", material_of(name, material)) for name in parts}
    section = parts_of(values, ask)
    found = [f"{name}: {p.total_mass:.4g} kg, {len(p.dofs)} rows" for name, p in parts.items()]
    interfaces, joints = {}, {}
    for (one, two), area in _touching(parts):
        name = f"{one}_{two}"
        interfaces[name] = {"between": [one, two]}
        joints[name] = springs_joint((name,), f"{1e6 * area:.4g} mm2", UNBOLTED)
        found.append(f"{one} and {two} touch over {1e6 * area:.4g} mm2")
    mesh = {
        "length_unit": guess("in" if unit == "inch" else unit, "of the files"),
        "force_unit": guess("N", "of the files"),
        "matrices": tables,
        **({"interfaces": interfaces} if interfaces else {}),
    }
    questions = [
        "The units of the matrices: mass is in force times s2 over length, such as tonnes with N "
        "and mm.",
        "E and rho of the parts scale the matrices: give the values used in the other code.",
    ]
    if len(parts) > 1 and not interfaces:
        questions.append("No parts touch: [mesh.interfaces] says where to join them.")
    return Draft(
        {"mesh": mesh, "parts": section, "joints": joints}, (), tuple(found), tuple(questions)
    )


def _stem(path: Path) -> str:
    stem = path.stem
    return stem[:-2] if stem.upper().endswith(("_K", "-K")) else stem


def _files(path: Path) -> dict[str, Path | None]:
    """Files of a part beside that of its stiffness."""
    stem, suffix = path.with_name(_stem(path)), path.suffix.lower()

    def first(endings: Sequence[str], what: str) -> Path | None:
        found = [stem.with_name(stem.name + ending) for ending in endings]
        there = next((each for each in found if is_file(each)), None)
        if there is None and what:
            raise InputError(f"{shown_path(path)}: its {what} is not beside it; {_EXPECTED}")
        return there

    mass = path
    if suffix in _MASS:
        mass = first(_MASS[suffix], "mass")
    elif suffix == ".mtx":
        mass = first((f"_M{path.suffix}", f"-M{path.suffix}"), "mass")
    nodes, dofs = first(_NODES, "table of nodes"), first(_DOFS, "")
    return {"stiffness": path, "mass": mass, "nodes": nodes, "dofs": dofs}


def _part(
    name: str, own: Mapping[str, Path | None], said, length: float, named
) -> tuple[MatrixPart, dict]:
    read = {what: read_matrix(own[what], what) for what in list(NAMES)[:2]}
    dofs = None if own["dofs"] is None else read_dofs(own["dofs"])
    table = {key: named(path) for key, path in own.items() if path is not None}
    thickness = None
    if "*SHELL SECTION" in said.values:
        thickness = length * said.values["*SHELL SECTION"][0]
        table["thickness"] = millimetres(thickness)
    part = matrix_part(name, *read.values(), said, dofs, length=length, thickness=thickness)
    return part, table


def _touching(parts: Mapping[str, MatrixPart]) -> Iterator[tuple[tuple[str, str], float]]:
    """Pairs of parts with an interface, and its area, m2."""
    for one, two in itertools.combinations(parts, 2):
        try:
            yield (one, two), float(NodeInterface.between(parts[one], parts[two]).areas.sum())
        except InputError:
            continue

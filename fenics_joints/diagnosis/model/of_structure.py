"""A structure and a test from a script as the case that a diagnosis takes.

A diagnosis builds its own model, with the joints in zones and more parameters: it takes parts,
joints, masses, springs and supports from the structure, and not its matrices.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from pydantic import PrivateAttr, ValidationError, model_validator

from fenics_joints.case import Case
from fenics_joints.case.build_matrices import MatrixMesh
from fenics_joints.case.mesh import MatricesMesh, MeshSection, PartMatrices
from fenics_joints.case.messages import case_error, describe, did_you_mean
from fenics_joints.case.sections import Diagnose, SupportSection
from fenics_joints.case.test import Test
from fenics_joints.case.values import AXES, PerArea, named
from fenics_joints.diagnosis.zones.joints import bolt_points
from fenics_joints.errors import InputError, items, mapping, wanted
from fenics_joints.matrices import MatrixStructure
from fenics_joints.measurements import TestData
from fenics_joints.meshes import TaggedMesh
from fenics_joints.structure import PointMass, Region, Spring, Structure, Support
from fenics_joints.structure.laws import LAYER_LAWS, SOLID, SPRINGS, TRANSITION, WIDE_SOLID

#: Keys of a case's sections that are options; of ``[diagnose]`` all that say something of a model
#: of solids without contact.
DIAGNOSE = [
    key
    for key in Diagnose.model_fields
    if key not in ("effects", "zones", "mesh", "nested", "frfs")
]
TEST = ["mass", "mass_noise", "stiffness", "antiresonances"]
#: Parameters that may have a tolerance, by the table of their sections.
_TOLERATED = {
    "parts": ("E", "nu", "rho", "thickness", "width"),
    "masses": ("mass",),
    "springs": ("stiffness",),
}
#: What a part calls the properties of its law, and a joint; others have their own names.
_CALLED = {"stretch": "thickness"}
#: Poisson's ratio of parts by matrices. [decision: of metals]
_NU = 0.3
#: Normal of a part that nobody gave. [numerical: default of a case]
_UPWARDS = (0.0, 0.0, 1.0)
#: Cosine from which a direction is along an axis. [numerical: chosen]
_ALONG = 0.999


class _Mesh(MeshSection):
    """The structure's own mesh."""

    origin = "file"
    degree: int
    _tagged: TaggedMesh = PrivateAttr()

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """See `MeshSection.build`."""
        return self._tagged


class _Test(Test):
    """A test whose modes are in no file."""

    __test__ = False

    @model_validator(mode="after")
    def _measured_or_planned(self) -> _Test:
        return self


class _Support(SupportSection):
    """Facets on springs, if it gives their stiffness."""

    k_n: PerArea | None = None
    k_t: PerArea | None = None


class ScriptedCase(Case):
    """A case without a file."""

    mesh: _Mesh
    test: _Test
    supports: named(_Support) = {}
    _path: Path = PrivateAttr(Path("structure"))


class _Matrices(MatricesMesh):
    """Parts by matrices from a script."""

    matrices: dict[str, PartMatrices] = {}
    _made: MatrixMesh = PrivateAttr()

    @property
    def made(self) -> MatrixMesh:
        """What stands in place of a mesh."""
        return self._made


class MatrixCase(ScriptedCase):
    """A case of parts by matrices without a file."""

    mesh: _Matrices


def case_of(
    structure: Structure | MatrixStructure,
    test: TestData,
    *,
    effects: Sequence[str] | None = None,
    bolts: Mapping[str, Any] | None = None,
    bolted: Iterable[str] = (),
    tolerances: Mapping[str, float] | None = None,
    attached: Mapping[str, Mapping] | None = None,
    title: str = "structure",
    **options: Any,
) -> Case:
    """The case that describes a structure and its test.

    Args:
        structure: The nominal model.
        test: What was measured.
        effects: Names of the library's effects; None for all.
        bolts: Points on the axes of the bolts through a joint, m, by the joint's name.
        bolted: Names of the joints that lie under bolts.
        tolerances: Relative standard deviations by parameter of the case.
        attached: Sections of what the structure lacks, by name.
        title: For people.
        options: Keys of ``[diagnose]`` and of ``[test]``.

    Raises:
        InputError: If the structure has something that a diagnosis cannot take, or an option is
            unknown or out of range; names it and says what was expected.
    """
    by_matrices = isinstance(structure, MatrixStructure)
    if not isinstance(structure, Structure | MatrixStructure):
        raise wanted("structure", structure, "a Structure, or a Case with a communicator")
    if not isinstance(test, TestData):
        raise wanted("test", test, "a TestData")
    if not by_matrices and (structure.axisymmetric or structure.changes):
        what = "axisymmetric" if structure.axisymmetric else "with changes"
        raise InputError(f"structure: is {what}; expected a solid, or a section in plane strain.")
    for key in options:
        if key not in DIAGNOSE + TEST:
            raise InputError(f"{key}: unknown option{did_you_mean(key, DIAGNOSE + TEST)}")
    said = {
        "title": title,
        "mesh": {} if by_matrices else {"degree": structure.degree},
        **(_matrix_tables(structure) if by_matrices else _tables(structure)),
        "attached": mapping("attached", attached, "sections of masses and springs by name"),
        "test": {key: value for key, value in options.items() if key in TEST},
        "diagnose": {"effects": effects}
        | {key: value for key, value in options.items() if key in DIAGNOSE},
    }
    _put_bolts(said["joints"], bolts, items("bolted", bolted, str, "names of joints"))
    _put_tolerances(said, mapping("tolerances", tolerances, "standard deviations by parameter"))
    kind = MatrixCase if by_matrices else ScriptedCase
    try:
        case = kind.model_validate(said)
    except ValidationError as error:
        lines = [describe(e, kind) for e in error.errors()]
        raise case_error(Path("structure"), lines) from None
    case._measured = test
    if by_matrices:
        parts, joints = (
            {each.name: each for each in s} for s in (structure.parts, structure.joints)
        )
        interfaces = {name: joint.interface for name, joint in joints.items()}
        made = MatrixMesh(parts, interfaces, {}, structure.viscous, held=structure.held)
        case.mesh._made = made
    else:
        case.mesh._tagged = structure.tagged
    case._joint_notes = _notes(case, structure)
    return case


def _matrix_tables(structure: MatrixStructure) -> dict[str, dict[str, dict]]:
    """Sections of parts by matrices, their joints, masses and springs."""
    parts = {}
    for name, own in structure.parts_of_regions.items():
        values = structure.properties_of(name)
        # Poisson's ratio is in the matrices: it says only how stiff what is bonded is.
        parts[name] = {"cells": [part.name for part in own], "nu": _NU, **values}
    joints = {}
    for joint in structure.joints:
        if joint.law is not SPRINGS or joint.which is not None:
            raise InputError(
                f"structure: {joint.name}: expected a joint of springs on a whole interface, in a "
                "diagnosis"
            )
        q = {k: _value(structure, f"{joint.name}.{k}", joint.properties[k]) for k in ("k_n", "k_t")}
        joints[joint.name] = {"cells": [joint.name], "law": "springs", **q}
    return {
        "parts": parts,
        "joints": joints,
        "masses": _at_points(structure, structure.masses, "mass"),
        "springs": _at_points(structure, structure.springs, "stiffness"),
    }


def _notes(case: Case, structure: Structure) -> tuple[str, ...]:
    """What is left out since nobody said where the bolts are."""
    without = [name for name, joint in case.joints.items() if joint.bolts is None]
    if not without or (case.mesh.origin == "file" and len(bolt_points(structure.tagged))):
        return ()
    return (
        f"no bolts of {', '.join(without)} are known (bolts = {{name: points}}): loose bolts, and "
        "effects that depend on the distance from a bolt, are not looked for there",
    )


def _put_bolts(joints: dict[str, dict], bolts: Mapping | None, bolted: Sequence[str]) -> None:
    bolts = mapping("bolts", bolts, "points on the bolts' axes, m, by joint")
    for key, named_joints in (("bolts", bolts), ("bolted", bolted)):
        for name in named_joints:
            if name not in joints:
                raise InputError(f"{key}: {name!r} is no joint{did_you_mean(name, list(joints))}")
    for name, points in bolts.items():
        joints[name]["bolts"] = np.asarray(points).tolist()
    for name in bolted:
        joints[name]["bolted"] = True


def _put_tolerances(said: dict[str, Any], tolerances: Mapping[str, float]) -> None:
    places = {
        f"{owner}.{key}": (said[table][owner], key if table == "parts" else "")
        for table, keys in _TOLERATED.items()
        for owner in said[table]
        for key in keys
    }
    for name, value in tolerances.items():
        if name not in places:
            raise InputError(
                f"tolerances: {name!r} is no parameter of a part, mass or spring"
                f"{did_you_mean(name, list(places))}"
            )
        section, key = places[name]
        if key:
            section.setdefault("tolerance", {})[key] = value
        else:
            section["tolerance"] = value


# -- what the structure says -----------------------------------------------------------------------


def _tables(structure: Structure) -> dict[str, dict[str, dict]]:
    """Sections of all that a structure is made of, by table and name."""
    regions = {
        joined: [r for r in structure.regions if r.is_joint == joined] for joined in (False, True)
    }
    return {
        "parts": _named("parts", [(r.name, _part(structure, r)) for r in regions[False]]),
        "joints": _named("joints", [(r.name, _joint(structure, r)) for r in regions[True]]),
        "masses": _at_points(structure, structure.masses, "mass"),
        "springs": _at_points(structure, structure.springs, "stiffness"),
        "supports": _supports(structure),
    }


def _named(table: str, sections: Sequence[tuple[str, dict]]) -> dict[str, dict]:
    found = dict(sections)
    if len(found) < len(sections):
        names = [name for name, _ in sections]
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"structure: two {table} are called {twice!r}; expected each name once.")
    return found


def _value(structure: Structure, where: str, given: Any) -> float:
    """The nominal value of what may be a number or the name of a parameter."""
    if callable(given):
        raise InputError(
            f"structure: {where} is a function of position: expected a number or the name of a "
            "parameter, since a diagnosis changes a region as a whole"
        )
    return float(structure.parameters[given].value if isinstance(given, str) else given)


def _properties(structure: Structure, region: Region) -> dict[str, float]:
    """Nominal values of a region's properties, those as meshed left out."""
    found = {
        _CALLED.get(key, key): _value(structure, f"{region.name}.{key}", region.properties[key])
        for key in region.law.properties
    }
    for key in ("thickness", "width"):
        size = found.pop(key, 1.0)
        if size != 1.0:
            raise InputError(
                f"structure: {region.name}.{key} = {size:g}: expected 1 in the baseline model, "
                "whose mesh is as thick and wide as the body is; give what is known of it as a "
                "tolerance"
            )
    return found


def _part(structure: Structure, region: Region) -> dict[str, Any]:
    if region.law.name not in (SOLID.name, WIDE_SOLID.name):
        raise InputError(f"structure: {region.name}: a diagnosis knows no law {region.law.name!r}.")
    found = {"cells": list(region.cells), **_properties(structure, region)}
    if region.across is not None:
        found["across"] = list(region.across)
    # Of a part that nobody wants to stretch it is no more than a default.
    meant = isinstance(region.properties["stretch"], str) or tuple(region.normal) != _UPWARDS
    return found | ({"normal": list(region.normal)} if meant or region.across is not None else {})


def _joint(structure: Structure, region: Region) -> dict[str, Any]:
    if region.law.name == TRANSITION.name:
        raise InputError(
            f"structure: {region.name} is of transition material: expected a joint with E and G, "
            "or an interface with k_n and k_t, in a diagnosis"
        )
    found = _properties(structure, region)
    if region.law.name not in LAYER_LAWS or not found["rho"]:
        found.pop("rho")
    law = "springs" if region.law.name == SPRINGS.name else region.law.name
    if callable(region.normal):
        raise InputError(
            f"structure: {region.name}.normal is a function of position: expected a vector, since "
            "a diagnosis knows flat joints only"
        )
    return {"cells": list(region.cells), "law": law, "normal": list(region.normal), **found}


def _at_points(
    structure: Structure, components: Sequence[PointMass | Spring], key: str
) -> dict[str, dict]:
    """Sections of point masses or springs: one for all of the same parameter and size."""
    groups: dict[tuple, list] = {}
    for each in components:
        value = getattr(each, key)
        name = value.removesuffix(f".{key}") if isinstance(value, str) else each.name
        travel = getattr(each, "travel", None)
        way = each.direction if key == "stiffness" or travel else ()
        groups.setdefault((name, value, each.share, way, travel), []).append(each)
    found: dict[str, dict] = {}
    for (name, value, share, way, travel), group in groups.items():
        of_each = share * _value(structure, f"{name}.{key}", value)
        # A mass is the total of all its points, a stiffness that of each.
        section = {key: of_each * (len(group) if key == "mass" else 1)}
        points = [each.point for each in group]
        if key == "stiffness":
            section["direction"] = list(way)
        elif isinstance(travel, str):
            section |= _travel(structure, travel, group[0])
        elif travel:
            points = [np.asarray(point) + travel * np.asarray(way) for point in points]
        section["points"] = [np.asarray(point, dtype=float).tolist() for point in points]
        names = (name, *(f"{name}_{k}" for k in range(2, len(groups) + 1)))
        found[next(n for n in names if n not in found)] = section
    return found


def _travel(structure: Structure, name: str, mass: PointMass) -> dict[str, Any]:
    """Where a mass may sit that moves with a parameter."""
    parameter, way = structure.parameters[name], np.asarray(mass.direction)
    ends = np.array([parameter.lower, parameter.upper])
    if parameter.value or np.count_nonzero(way > _ALONG) != 1 or not np.isfinite(ends).all():
        raise InputError(
            f"structure: {mass.name}.travel: expected a parameter of value 0 with bounds, and a "
            "direction along an axis"
        )
    axis = int(np.argmax(way))
    return {"along": AXES[axis], "travel": (mass.point[axis] + ends).tolist()}


def _supports(structure: Structure) -> dict[str, dict]:
    found: dict[str, dict] = {}
    for i, support in enumerate(structure.supports):
        at = support.points if isinstance(support.points, str) else ""
        name = support.facets or at or "points"
        found[name if name not in found else f"{name}_{i + 1}"] = _held(support)
    for support in structure.elastic_supports:
        values = {
            key: _value(structure, f"{support.name}.{key}", given)
            for key, given in support.properties.items()
        }
        found[support.name] = {"facets": support.facets, **values}
    return found


def _held(support: Support) -> dict[str, Any]:
    where = (
        {"facets": support.facets}
        if support.facets
        else {
            "points": support.points
            if isinstance(support.points, str)
            else np.atleast_2d(np.asarray(support.points, dtype=float)).tolist()
        }
    )
    return {**where, "directions": [AXES[way] for way in support.directions]}

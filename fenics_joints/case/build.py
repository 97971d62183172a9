"""The mesh and the structure that a case describes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI

from fenics_joints.beams import BeamStructure
from fenics_joints.case.build_beams import build_beams, springs_of
from fenics_joints.case.build_matrices import build_matrices
from fenics_joints.case.case import Case
from fenics_joints.case.check_structure import (
    PRESSES,
    matching,
    refuse_applied,
    refuse_beams,
    unknown_groups,
)
from fenics_joints.case.dimensions import directed_parts
from fenics_joints.case.parameters import parameters
from fenics_joints.case.preload import APPLIED
from fenics_joints.case.sections import JointSection, MassSection, SupportSection
from fenics_joints.case.values import AXES
from fenics_joints.errors import InputError, MeshError, located
from fenics_joints.matrices import MatrixStructure
from fenics_joints.meshes import TaggedMesh, extent, layer_thickness
from fenics_joints.meshes.rings import check_normal, layer_normal, measure_layer
from fenics_joints.preload import Contact, PreloadModel
from fenics_joints.structure.components import (
    ElasticSupport,
    PointMass,
    Region,
    Support,
    interface,
    joint,
    part,
    transition,
)
from fenics_joints.structure.laws import SPRINGS
from fenics_joints.structure.points import round_bolts
from fenics_joints.structure.structure import Structure

#: Ratio of thicknesses that no choice of a mesh explains, but a wrong unit (1000) does.
_FAR = 300.0


def build_mesh(case: Case, comm: MPI.Intracomm) -> TaggedMesh:
    """The mesh of a case. Collective.

    Raises:
        MeshError: If it cannot be built or read, or lacks a group that the case names.
    """
    try:
        tagged = case.mesh.build(case.folder, comm)
    except MeshError as error:
        raise MeshError(f"{case.path}: mesh: {error}") from error
    except InputError as error:
        raise InputError(f"{case.path}: {error}") from error
    missing = unknown_groups(case, tagged.cell_names, tagged.facet_names)
    if missing:
        notes = [f"note: {note}" for note in tagged.notes]
        lines = [f"{case.path}: names groups of the mesh:", *missing, *notes]
        raise MeshError("\n  ".join(lines))
    return tagged


def build_structure(
    case: Case,
    comm: MPI.Intracomm,
    *,
    law: str | None = None,
    attached: bool = False,
    tagged: TaggedMesh | None = None,
    width: bool = False,
    elastic_supports: bool = False,
    damping: bool = False,
) -> Structure | BeamStructure | MatrixStructure:
    """The structure of a case, all its numbers as parameters. Collective.

    The parameters are named NAME.KEY: E, nu, rho and thickness of a part; E, G, thickness, and rho
    if given, of a joint; E, nu, h of a transition layer; k1, k2, c, and k_axial if given, of a lap
    of beams; mass, stiffness. A thickness is relative to the mesh's, 1; h is in metres.

    Args:
        case: The case.
        comm: Communicator.
        law: Law of all joints, instead of the case's own.
        attached: Whether to add what ``[attached]`` names, with parameters at zero: not there.
            ``NAME.mass`` is the total of all points, ``NAME.stiffness`` that of each spring, and
            ``NAME.travel`` the distance from the points in the case.
        tagged: The case's mesh, if it exists already.
        width: Whether the parts' widths, relative to the mesh's, are parameters NAME.width too.
            They double the terms that a reduced model has of a part.
        elastic_supports: Whether the ``[supports]`` that hold all directions are springs spread
            over their facets, as good as rigid at their nominal NAME.k_n and NAME.k_t.
        damping: Whether the values of ``[damping]`` are parameters too; see `model_damping`.

    Raises:
        InputError: For a value that is out of range, or contacts, obstacles, displacements or
            loads, for which there is `build_preload`.
        MeshError: As `build_mesh`.
    """
    options = {
        "attached": attached,
        "width": width,
        "elastic_supports": elastic_supports,
        "damping": damping,
    }
    if case.mesh.origin == "beams":
        return build_beams(case, **options)
    if case.mesh.origin == "matrices":
        return build_matrices(case, comm, **options)
    refuse_applied(case, "a model without contact", ("contacts", *APPLIED))
    return _build_solid(case, comm, law, tagged, **options)


def _build_solid(
    case: Case, comm: MPI.Intracomm, law: str | None, tagged: TaggedMesh | None, **options: bool
) -> Structure:
    """The structure of solid parts of a case, without what acts on its faces. Collective."""
    tagged = build_mesh(case, comm) if tagged is None else tagged
    pointed = {**case.masses, **case.springs}
    pointed |= case.attached if options.get("attached") else {}
    elastic, width = options.get("elastic_supports", False), options.get("width", False)
    with located(case.path):
        return Structure(
            tagged,
            [*_parts(directed_parts(case, tagged), width), *_joints(case, tagged, law)],
            parameters(case, **options),
            masses=[m for name, section in pointed.items() for m in _masses(name, section, tagged)],
            springs=[s for name, section in pointed.items() for s in springs_of(name, section)],
            supports=[_support(name, s, elastic) for name, s in case.supports.items()],
            degree=case.mesh.degree,
        )


def build_preload(
    case: Case, comm: MPI.Intracomm, *, tagged: TaggedMesh | None = None, at_rest: bool = False
) -> PreloadModel:
    """The bodies of a case, their contacts, and what presses them at nominal forces. Collective.

    Args:
        case: The case.
        comm: Communicator.
        tagged: The case's mesh, if it exists already.
        at_rest: Whether it will do if nothing presses the bodies: for linear contacts.

    Raises:
        InputError: If the case has no contacts or obstacles or nothing presses them, or a value is
            out of range.
        MeshError: As `build_structure`; if faces are not opposite, or bodies share vertices.
    """
    refuse_beams(case, "contact under preload")
    if not (case.contacts or case.obstacles):
        sections = "[contacts.NAME], or [obstacles.NAME]"
        raise InputError(f"{case.path}: contacts is missing, expected sections {sections}")
    if not (at_rest or case.is_pressed):
        raise InputError(f"{case.path}: bolts is missing: {PRESSES}")
    structure = _build_solid(case, comm, None, tagged)
    gdim = structure.gdim
    contacts = [Contact(name, **section.model_dump()) for name, section in case.contacts.items()]
    bolts = [section.bolt(name) for name, section in case.bolts.items()]
    with located(case.path):
        contacts += [s.obstacle(name, gdim) for name, s in case.obstacles.items()]
        loads = [s.load(name, gdim) for name, s in case.loads.items()]
        loads += [s.displacement(name, gdim) for name, s in case.displacements.items()]
        return PreloadModel(structure, contacts, bolts, loads)


def _support(name: str, section: SupportSection, elastic: bool) -> Support | ElasticSupport:
    if elastic and section.holds_all:
        return ElasticSupport(name, section.facets, f"{name}.k_n", f"{name}.k_t")
    ways = tuple(AXES.index(d) for d in section.directions)
    return Support(section.facets or "", ways, section.points or "")


def _parts(case: Case, width: bool) -> list[Region]:
    return [
        part(
            name,
            tuple(p.cells),
            E=f"{name}.E",
            nu=f"{name}.nu",
            rho=f"{name}.rho",
            stretch=f"{name}.thickness",
            normal=p.normal,
            width=f"{name}.width" if width else 1.0,
            across=p.widens(),
        )
        for name, p in case.parts.items()
    ]


def measured_joints(case: Case, tagged: TaggedMesh) -> Case:
    """The case with names, normals and thickness of layers of springs as the mesh has them.

    Raises:
        MeshError: If one of them is not a flat layer.
    """
    joints = dict(case.joints)
    for name, section in case.joints.items():
        if not section.is_measured:
            continue
        cells = _cells(section, tagged)
        normal = section.normal if "normal" in section.model_fields_set else None
        with located(f"joints.{name}"):
            if tagged.mesh.geometry.dim == 3:
                meshed, normal = measure_layer(tagged, cells, normal)
                normal = tuple(normal.tolist())
            else:
                normal = normal or layer_normal(tagged, cells)
                meshed = extent(tagged, cells, normal)
        update = {"cells": list(cells), "meshed": section.meshed or meshed, "normal": normal}
        joints[name] = section.model_copy(update=update)
    return case.model_copy(update={"joints": joints})


def _joints(case: Case, tagged: TaggedMesh, law: str | None) -> Iterator[Region]:
    solid = tagged.mesh.geometry.dim == 3
    for name, section in measured_joints(case, tagged).joints.items():
        cells, rho = _cells(section, tagged), 0.0 if section.rho is None else f"{name}.rho"
        own = {"normal": section.normal}
        # Where the thickness is measured, the normal is checked by it.
        measured = section.law == "transition" and section.meshed is None
        if solid and not section.is_measured and not measured:
            with located(f"joints.{name}"):
                check_normal(tagged, cells, section.normal)
        if section.is_measured:
            names = {key: f"{name}.{key}" for key in section.nominal()}
            own |= {"law": section.own_law or SPRINGS, "meshed": section.meshed}
            yield interface(name, cells, **names, **own)
        elif section.law == "transition":
            with located(f"joints.{name}"):
                meshed = section.meshed or _thickness(case, section, tagged)
            values = {key: f"{name}.{key}" for key in ("E", "nu", "h")}
            yield transition(name, cells, **values, meshed=meshed, rho=rho, **own)
        else:
            values = {key: f"{name}.{key}" for key in ("E", "G")}
            stretch = f"{name}.thickness"
            yield joint(
                name,
                tuple(section.cells),
                **values,
                law=law or section.law,
                rho=rho,
                stretch=stretch,
                **own,
            )


def _cells(section: JointSection, tagged: TaggedMesh) -> tuple[str, ...]:
    """Names of a joint's cells, patterns resolved."""
    there = sorted(tagged.cell_names, key=tagged.cell_names.get)
    return tuple(dict.fromkeys(c for pattern in section.cells for c in matching(pattern, there)))


def _thickness(case: Case, section: JointSection, tagged: TaggedMesh) -> float:
    """Thickness of a transition layer as meshed, m."""
    measure = layer_thickness if tagged.mesh.geometry.dim == 3 else extent
    meshed = measure(tagged, _cells(section, tagged), section.normal)
    # A layer that was grown is as thin as can be, whatever h is.
    if not case.mesh.grows and not 1 / _FAR <= meshed / section.h <= _FAR:
        raise MeshError(
            f"its layer is {1e3 * meshed:.6g} mm thick in the mesh, and h is "
            f"{1e3 * section.h:.6g} mm; expected both in the same unit (see scale in [mesh])"
        )
    return meshed


def _masses(name: str, section, tagged: TaggedMesh) -> list[PointMass]:
    if not isinstance(section, MassSection):
        return []
    moves = section.travel is not None
    axis = np.eye(3)[AXES.index(section.along) if moves else 0]
    # The hole of a bolt is empty: a mass on the bolt sits on the ring around the hole.
    rings = [] if moves else round_bolts(tagged, np.array(section.points, dtype=float))
    found = []
    for i, (label, point) in enumerate(section.labelled(name)):
        around = rings[i] if rings else None
        places = [point] if around is None else [tuple(place.tolist()) for place in around]
        names = [label] if len(places) == 1 else [f"{label}.{k + 1}" for k in range(len(places))]
        found += [
            PointMass(
                own,
                f"{name}.mass",
                place,
                direction=tuple(axis.tolist()),
                travel=f"{name}.travel" if moves else 0.0,
                share=1 / len(section.points) / len(places),
            )
            for own, place in zip(names, places, strict=True)
        ]
    return found

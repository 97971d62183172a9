"""The parts by matrices that a case describes: ``[mesh.matrices]``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from fenics_joints.case.build_beams import springs_of
from fenics_joints.case.case import Case
from fenics_joints.case.check_structure import refuse_applied, unknown_groups
from fenics_joints.case.mesh import MatrixInterface
from fenics_joints.case.parameters import parameters
from fenics_joints.case.preload import APPLIED
from fenics_joints.case.sections import JointSection, MassSection
from fenics_joints.case.values import AXES
from fenics_joints.errors import InputError, located
from fenics_joints.matrices import MatrixJoint, MatrixPart, MatrixStructure, NodeInterface
from fenics_joints.matrices.faces import face_of
from fenics_joints.matrices.files import (
    Nodes,
    held_note,
    matrix_part,
    read_dofs,
    read_matrix,
    read_nodes,
    unit_of,
)
from fenics_joints.parallel import on_root
from fenics_joints.structure import Parameter, PointMass
from fenics_joints.structure.laws import LAYER_LAWS, SPRINGS

#: Thickness, m, of the layer that stands for an interface where moduli are spoken of: as thin as
#: the layer of a mesh that grows one.
LAYER = 1e-4


@dataclass
class MatrixMesh:
    """What stands in place of a mesh.

    Attributes:
        parts: Parts by name.
        interfaces: Interfaces by name.
        nodes: Part, and places of its nodes, by the name of a set.
        damping: Viscous matrices by part.
        zones: NodeInterface and mask of its points, by the name of a zone; others are whole.
        held: Rows that cannot move, by part, beside those of ``[supports]``.
        notes: What was found that a user should know.
    """

    parts: dict[str, MatrixPart]
    interfaces: dict[str, NodeInterface]
    nodes: dict[str, tuple[str, np.ndarray]]
    damping: dict[str, sp.csr_matrix] = field(default_factory=dict)
    zones: Mapping[str, tuple[str, np.ndarray]] = field(default_factory=dict)
    held: Sequence[tuple[str, np.ndarray]] = ()
    notes: tuple[str, ...] = ()


def read_matrices(case: Case, comm: MPI.Intracomm) -> MatrixMesh:
    """The parts and interfaces of a case. Collective.

    Raises:
        InputError: Names the file or section, what is wrong and what was expected.
    """
    made = getattr(case.mesh, "made", None)  # of a script, there already
    return comm.bcast(on_root(comm, lambda: _read(case))) if made is None else made


def _read(case: Case) -> MatrixMesh:
    mesh, parts, nodes, damping, notes = case.mesh, {}, {}, {}, []
    units = {"length": unit_of(mesh.length_unit, "m"), "force": unit_of(mesh.force_unit, "N")}
    sets: dict[str, Nodes] = {}
    for name, files in mesh.matrices.items():
        own = dict(zip(("stiffness", "mass", "damping"), files.names or (), strict=False))
        read = {
            what: read_matrix(case.folder / getattr(files, what), what, own.get(what))
            for what in ("stiffness", "mass", "damping")
            if getattr(files, what) is not None
        }
        sets[name] = read_nodes(case.folder / files.nodes)
        dofs = None if files.dofs is None else read_dofs(case.folder / files.dofs)
        with located(f"{case.path}: mesh.matrices"):
            more = units | {"thickness": files.thickness}
            K, M = read["stiffness"], read["mass"]
            parts[name] = matrix_part(name, K, M, sets[name], dofs, **more)
            if not parts[name].total_mass > 0:
                raise InputError(
                    f"{name}: its mass is {parts[name].total_mass:.4g} kg, expected more than 0"
                )
            parts[name].scale(*_factors(case, name))
            if "damping" in read:
                damped = matrix_part(name, K, read["damping"], sets[name], dofs, **more)
                damping[name] = damped.mass
        note = held_note(parts[name])
        notes += [] if note is None else [note]
    for name, asked in mesh.nodes.items():
        where = f"{case.path}: mesh.nodes.{name}"
        if asked.part not in parts:
            raise InputError(f"{where}.part = {asked.part!r}: expected one of {', '.join(parts)}")
        nodes[name] = asked.part, _picked(asked, parts[asked.part], sets[asked.part], where)
    interfaces, pairs = {}, set()
    for name, asked in mesh.interfaces.items():
        pair = frozenset(asked.between)
        if asked.nodes is None and (pair in pairs or len(pair) < 2):
            raise InputError(
                f"{case.path}: mesh.interfaces.{name}: expected nodes = two sets, as "
                + ("there is another between these parts" if len(pair) > 1 else "it is one part")
            )
        pairs.add(pair)
        with located(f"{case.path}: mesh.interfaces.{name}"):
            interfaces[name] = _interface(asked, parts, nodes)
            if interfaces[name].covered < 0.99:
                notes.append(
                    f"interface {name}: {1e6 * interfaces[name].areas.sum():.4g} mm2, "
                    f"{100 * interfaces[name].covered:.0f} % of the finer face, is opposite the "
                    "other face"
                )
    return MatrixMesh(parts, interfaces, nodes, damping, notes=tuple(notes))


def _factors(case: Case, name: str) -> tuple[float, float]:
    """Of stiffness and mass: the case's E and rho over those that matrices were made with."""
    files = case.mesh.matrices[name]
    part = next((p for p in case.parts.values() if name in p.cells), None)
    if part is None:
        return 1.0, 1.0
    return part.E / (files.E or part.E), part.rho / (files.rho or part.rho)


def _picked(asked, part: MatrixPart, nodes: Nodes, where: str) -> np.ndarray:
    """Places of the nodes of a set among those of its part."""
    if asked.box is not None:
        low, high = np.sort(np.array(asked.box), axis=0)
        slack = 1e-6 * np.ptp(part.points, axis=0).max()
        inside = np.all((part.points >= low - slack) & (part.points <= high + slack), axis=1)
        found = np.intersect1d(np.flatnonzero(inside), part.moved)
    else:
        numbers = asked.numbers
        if asked.set is not None:
            if asked.set.upper() not in nodes.sets:
                there = ", ".join(nodes.sets) or "none, as the file has no *NSET"
                raise InputError(f"{where}.set = {asked.set!r}: expected one of {there}")
            numbers = nodes.sets[asked.set.upper()]
        unknown = np.setdiff1d(numbers, part.numbers)
        if len(unknown):
            raise InputError(f"{where}: {part.name} has no node {unknown[0]}")
        found = np.flatnonzero(np.isin(part.numbers, numbers))
    if not len(found):
        raise InputError(f"{where}: no node of {part.name} is in it")
    return found


def _interface(asked: MatrixInterface, parts, nodes) -> NodeInterface:
    first, second = (parts[name] for name in asked.between)
    if asked.nodes is None:
        return NodeInterface.between(first, second, area=asked.area)
    own = []
    for name, part in zip(asked.nodes, (first, second), strict=True):
        if name not in nodes or nodes[name][0] != part.name:
            there = ", ".join(n for n, (owner, _) in nodes.items() if owner == part.name)
            raise InputError(
                f"nodes: {name!r}: expected a set [mesh.nodes.NAME] of {part.name}: "
                f"{there or 'none'}"
            )
        own.append(nodes[name][1])
    return NodeInterface(first, own[0], second, own[1], area=asked.area)


def as_layers(case: Case, mesh: MatrixMesh) -> Case:
    """The case with the thickness and the normal of its joints as the interfaces have them."""
    joints = {}
    for name, section in case.joints.items():
        (cells,) = section.cells
        normal = mesh.interfaces[mesh.zones.get(cells, (cells,))[0]].normal
        update = {"meshed": section.meshed or LAYER, "normal": tuple(normal.tolist())}
        joints[name] = section.model_copy(update=update if section.is_measured else {})
    return case.model_copy(update={"joints": joints})


def build_matrices(
    case: Case, comm: MPI.Intracomm, mesh: MatrixMesh | None = None, **options: bool
) -> MatrixStructure:
    """The structure of a case of matrices, all its numbers as parameters. Collective.

    Args:
        case: The case.
        comm: Communicator.
        mesh: Its parts and interfaces, if they were read already.
        options: As of `fenics_joints.case.build.build_structure`.

    Raises:
        InputError: For what matrices do not have, or a file or section that is wrong.
    """
    refuse_applied(case, "a model by matrices", ("contacts", "bolts", *APPLIED))
    mesh = read_matrices(case, comm) if mesh is None else mesh
    missing = unknown_groups(case, [*mesh.parts, *mesh.interfaces, *mesh.zones], mesh.nodes)
    if missing:
        raise InputError("\n  ".join([f"{case.path}: names parts of the mesh:", *missing]))
    owners = {cell: name for name, part in case.parts.items() for cell in part.cells}
    for cells in mesh.parts:
        if cells not in owners:
            raise InputError(
                f"{case.path}: matrices {cells!r} are in no part: expected [parts.NAME]"
            )
    pointed = {**case.masses, **case.springs}
    pointed |= case.attached if options.get("attached") else {}
    elastic = options.pop("elastic_supports", False)
    known = parameters(case, elastic_supports=elastic, **options)
    with located(case.path):
        supports, springs = list(mesh.held), []
        for name, section in case.supports.items():
            own = _support(name, section, mesh, elastic)
            (springs if elastic and section.holds_all else supports).extend(own)
        found = MatrixStructure(
            list(mesh.parts.values()),
            [_joint(case, *item, mesh) for item in case.joints.items()],
            _movable(known),
            properties={name: {k: f"{name}.{k}" for k in ("E", "rho")} for name in case.parts},
            regions={name: part.cells for name, part in case.parts.items()},
            masses=[m for item in pointed.items() for m in _masses(*item)],
            springs=[s for item in pointed.items() for s in springs_of(*item)],
            supports=supports,
            elastic=springs,
            damping=mesh.damping,
            comm=comm,
        )
    found.notes = mesh.notes
    return found


def _movable(known: Sequence[Parameter]) -> list[Parameter]:
    for parameter in known:
        if parameter.name.endswith(".travel"):
            raise InputError(
                f"{parameter.name}: expected none in a model by matrices, whose masses stay where "
                "they are"
            )
    return list(known)


def _joint(case: Case, name: str, section: JointSection, mesh: MatrixMesh) -> MatrixJoint:
    if len(section.cells) != 1:
        raise InputError(f"joints.{name}.cells: expected one interface")
    (cells,) = section.cells
    whole, which = mesh.zones.get(cells, (cells, None))
    if whole not in mesh.interfaces:
        raise InputError(
            f"joints.{name}.cells = {cells!r}: expected an interface: "
            f"{', '.join(mesh.interfaces) or 'none is there'}"
        )
    names = {key: f"{name}.{key}" for key in section.nominal() if key not in case.mesh.lacks}
    own = {"which": which, "properties": names}
    if section.own_law is not None or section.law == "springs":
        law = section.own_law or SPRINGS
        return MatrixJoint(name, mesh.interfaces[whole], law=law, **own)
    if section.law != "uncoupled":
        raise InputError(
            f"joints.{name}.law = {section.law!r}: expected 'springs', 'uncoupled' or a law of the "
            "jump of your own, between matrices"
        )
    thickness = section.meshed or LAYER
    law = LAYER_LAWS["uncoupled"]
    return MatrixJoint(name, mesh.interfaces[whole], law=law, thickness=thickness, **own)


def _masses(name: str, section) -> Iterator[PointMass]:
    if isinstance(section, MassSection):
        share = 1 / len(section.points)
        for label, point in section.labelled(name):
            yield PointMass(label, f"{name}.mass", point, share=share)


def _support(name: str, section, mesh: MatrixMesh, elastic: bool) -> Iterator[tuple]:
    """Held rows of a part; or the matrices of springs spread over a face."""
    if section.facets is not None:
        owner, nodes = mesh.nodes[section.facets]
        places = [(mesh.parts[owner], nodes)]
    else:
        at = np.atleast_2d(np.asarray(section.points, dtype=float))
        places = []
        for point in at:
            part = min(mesh.parts.values(), key=lambda p, x=point: p.distance(x))
            part.displacement(point)  # refuses a point beside it
            near = np.linalg.norm(part.points[part.moved] - point, axis=1)
            places.append((part, part.moved[near <= near.min() + 1e-9]))
    ways = [AXES.index(way) for way in section.directions]
    for part, nodes in places:
        if elastic and section.holds_all:
            matrices = [(part.name, A) for A in face_of(part, nodes)]
            yield name, matrices, f"{name}.k_n", f"{name}.k_t"
            continue
        # What is held in all directions is clamped, rotations too.
        columns = [*ways, 3, 4, 5] if len(ways) == 3 else ways
        rows = part.rows[nodes][:, columns].ravel()
        yield part.name, rows[rows >= 0]


def layer_thickness(case: Case) -> dict[str, float]:
    """Thickness, m, of the layer that stands for each joint."""
    return {name: section.meshed or LAYER for name, section in case.joints.items()}


def with_zones(mesh: MatrixMesh, zones: Mapping[str, tuple[str, np.ndarray]]) -> MatrixMesh:
    """The same with interfaces split into zones."""
    return replace(mesh, zones={**mesh.zones, **zones})

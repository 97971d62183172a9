"""The beams that a case describes: ``builder = "offset_beams"``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from fenics_joints.beams import Beam, BeamStructure, Clamp, GenericJoint, Held, LumpedMass
from fenics_joints.case.case import Case
from fenics_joints.case.parameters import parameters
from fenics_joints.case.sections import MassSection, SpringSection
from fenics_joints.errors import InputError, located
from fenics_joints.structure.components import Parameter, Spring

#: Bounds of the actual over the nominal axial stiffness of a lap.
_AXIAL = (1e-3, 1e3)


@dataclass(frozen=True)
class ZonedLap:
    """A lap whose joint elements are in zones, each a section of the case.

    Attributes:
        name: Its name.
        zones: Name of the joint section of each of its elements.
        k_axial: Its axial stiffness, N/m, if it is not the beams' own.
    """

    name: str
    zones: tuple[str, ...]
    k_axial: float | None = None

    @property
    def along(self) -> str:
        """What it is along the beams; ``ALONG.axial`` is the parameter of that, actual over nominal
        stiffness."""
        return f"{self.name}_along"


def build_beams(
    case: Case,
    *,
    attached: bool = False,
    width: bool = False,
    elastic_supports: bool = False,
    damping: bool = False,
    laps: Sequence[ZonedLap] | None = None,
) -> BeamStructure:
    """The beams of a case, all its numbers as parameters; the same on every rank.

    Args:
        case: The case.
        attached: See `fenics_joints.case.build.build_structure`.
        width: See there.
        elastic_supports: See there.
        damping: See there.
        laps: Its laps in zones, in their order; by default as the case has them.

    Raises:
        InputError: For a value that is out of range, or a section that beams have not.
    """
    pointed = {**case.masses, **case.springs, **(case.attached if attached else {})}
    known = parameters(
        case, attached=attached, width=width, elastic_supports=elastic_supports, damping=damping
    )
    known += [Parameter(f"{lap.along}.axial", 1.0, "", *_AXIAL) for lap in laps or ()]
    with located(case.path):
        return BeamStructure(
            _beams(case, width),
            _joints(case) if laps is None else _zoned(case, laps),
            known,
            masses=[m for item in pointed.items() for m in _masses(*item)],
            springs=[s for item in pointed.items() for s in springs_of(*item)],
            held=_held(case, elastic_supports),
            clamps=_clamps(case) if elastic_supports else [],
            offset_mass=case.mesh.offset_mass,
        )


def _owners(sections) -> dict[str, str]:
    """Name of the section that each beam, or lap, is in."""
    return {cell: name for name, section in sections.items() for cell in section.cells}


def _beams(case: Case, width: bool) -> list[Beam]:
    mesh, owners = case.mesh, _owners(case.parts)
    keys = ("lengths", "width", "thickness", "elements")
    found = []
    for i, sizes in enumerate(zip(*(mesh.of(key) for key in keys), strict=True)):
        part = owners[f"beam_{i + 1}"]
        names = {key: f"{part}.{key}" for key in ("E", "nu", "rho")}
        stretch, wide = f"{part}.thickness", f"{part}.width" if width else 1.0
        found.append(
            Beam(f"beam_{i + 1}", *sizes, **names, stretch=stretch, width=wide, shear=mesh.shear)
        )
    return found


def _joints(case: Case) -> list[GenericJoint]:
    mesh, owners = case.mesh, _owners(case.joints)
    found = []
    for cells, length in zip(mesh.lap_cells(), mesh.of("laps"), strict=True):
        joints = [owners[cell] for cell in cells]
        alone = len(set(joints)) == 1
        names = {
            key: f"{joints[0]}.{key}" if alone else [f"{joint}.{key}" for joint in joints]
            for key in ("k1", "k2", "c")
        }
        axial = lap_axial(case, joints)
        k_axial = None if axial is None else f"{joints[0]}.k_axial"
        name = lap_name(case, cells, joints)
        found.append(GenericJoint(name, length, len(cells), **names, k_axial=k_axial))
    return found


def lap_name(case: Case, cells: Sequence[str], joints: Sequence[str]) -> str:
    """Name of a lap: its joint's where that has no other lap.

    Args:
        case: The case.
        cells: Name of each of its elements.
        joints: Joint section of each.
    """
    if len(set(joints)) == 1 and len(set(case.joints[joints[0]].cells)) == len(set(cells)):
        return joints[0]
    return cells[0] if len(set(cells)) == 1 else "lap"


def lap_axial(case: Case, joints: Sequence[str]) -> float | None:
    """Axial stiffness of a lap's elements, N/m; None for that of its beams.

    Args:
        case: The case.
        joints: Joint section of each element.

    Raises:
        InputError: If a lap of several sections has one.
    """
    given = [joint for joint in joints if case.joints[joint].k_axial is not None]
    if given and len(set(joints)) > 1:
        raise InputError(
            f"joints.{given[0]}.k_axial: expected none where a lap has zones of several joints"
        )
    return case.joints[given[0]].k_axial if given else None


def _zoned(case: Case, laps: Sequence[ZonedLap]) -> list[GenericJoint]:
    return [
        GenericJoint(
            lap.name,
            length,
            len(lap.zones),
            **{key: [f"{zone}.{key}" for zone in lap.zones] for key in ("k1", "k2", "c")},
            k_axial=lap.k_axial,
            axial=f"{lap.along}.axial",
        )
        for lap, length in zip(laps, case.mesh.of("laps"), strict=True)
    ]


def _clamps(case: Case) -> list[Clamp]:
    return [
        Clamp(name, section.facets == "right", f"{name}.k_n", f"{name}.k_t")
        for name, section in case.supports.items()
        if section.holds_all
    ]


def _held(case: Case, elastic: bool) -> list[Held]:
    mesh = case.mesh
    x = {"left": 0.0, "right": sum(mesh.lengths) - sum(mesh.of("laps"))}
    found = []
    for section in case.supports.values():
        if section.holds_all and elastic:
            continue
        motions = tuple(d for d in section.directions if d != "y")
        if section.holds_all:
            motions = "x", "z", "turn"
        if motions:
            found.append(Held(x[section.facets], motions))
    return found


def _masses(name: str, section) -> list[LumpedMass]:
    if not isinstance(section, MassSection):
        return []
    n, moves = len(section.points), section.travel is not None
    if moves and section.along != "x":
        raise InputError(f"{name}.along = {section.along!r}: expected 'x', along the beams")
    return [
        LumpedMass(
            label,
            f"{name}.mass",
            point,
            radius=math.sqrt((section.inertia or 0.0) * n / section.mass),
            travel=f"{name}.travel" if moves else 0.0,
            range=section.shift(),
            share=1 / n,
        )
        for label, point in section.labelled(name)
    ]


def springs_of(name: str, section) -> list[Spring]:
    """The springs of a section, if it has some."""
    if not isinstance(section, SpringSection):
        return []
    length = math.hypot(*section.direction)
    direction = tuple(c / length for c in section.direction)
    return [
        Spring(label, f"{name}.stiffness", point, direction)
        for label, point in section.labelled(name)
    ]

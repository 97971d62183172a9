"""Beams, joints, masses and springs as terms of K(p) and M(p) on the nodes of a layout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.beams.components import Beam, Clamp, GenericJoint, LumpedMass
from fenics_joints.beams.element import (
    joint_damping_matrix,
    joint_matrices,
    mass_matrices,
    stiffness_matrices,
)
from fenics_joints.beams.laws import AXIAL, BEAM, BEAM_MASSES, LAPPED, SECTION, SLAP, SLIP
from fenics_joints.beams.layout import Layout, Stretch
from fenics_joints.errors import InputError
from fenics_joints.reduction.terms import MassTerm, RegionTerm, SpringTerm
from fenics_joints.structure.components import Spring
from fenics_joints.structure.laws import ELASTIC_SUPPORT

#: Stations per element of the path of a mass that may move: rotation has kinks at the nodes, and
#: with fewer of them rotary inertia between two nodes moves frequencies by 1e-4.
_STATIONS = 8


@dataclass(frozen=True, eq=False)
class Assembly:
    """What `BeamStructure` is made of, as terms.

    Attributes:
        layout: Nodes and elements.
        beams: The beams.
        joints: Their laps.
        offset_mass: Whether the offset enters the mass too.
    """

    layout: Layout
    beams: Sequence[Beam]
    joints: Sequence[GenericJoint]
    offset_mass: bool

    def regions(self) -> tuple[list[RegionTerm], tuple]:
        """Regions of all beams and joints, and (label, c, matrix) of the joints' dashpots."""
        regions, dampers = [], []
        for stretch in self.layout.stretches:
            joint = None if stretch.joint is None else self.joints[stretch.joint]
            for i in stretch.beams:
                regions += self._beam(i, stretch, joint)
            if joint is not None:
                regions += self._joint(stretch, joint)
                dampers += self._dampers(stretch, joint)
        # The first region is the first beam's: its size is the model's.
        return regions, tuple(dampers)

    def _beam(self, i: int, stretch: Stretch, joint: GenericJoint | None) -> list[RegionTerm]:
        """A beam, or its share of a lap: its mass, and its axial stiffness unless that is given."""
        beam, layout = self.beams[i], self.layout
        name = beam.name if joint is None else f"{joint.name}.{beam.name}"
        elements = range(stretch.first, stretch.first + stretch.n)
        heavy = layout.assemble(mass_matrices(stretch.length), elements)
        stiff = layout.assemble(stiffness_matrices(stretch.length), elements)
        if joint is not None:
            stiff = stiff[:1] * (joint.k_axial is None)
        usual = 0.5 if i % 2 == 0 else -0.5
        offset = usual if beam.offset is None else beam.offset
        numbers = {
            "height": beam.height,
            "breadth": beam.breadth,
            "length": stretch.length,
            "shear": beam.shear,
            "offset": offset,
            "mass_offset": offset if self.offset_mass else 0.0,
        }
        q = {key: numbers.get(key, getattr(beam, key, None)) for key in SECTION}
        law, more = (BEAM, {}) if joint is None else (LAPPED, {"axial": joint.axial})
        own = RegionTerm(name, law, q | more, stiff, heavy[0], stretch.n * stretch.length)
        return [own] + [
            RegionTerm(f"{name}.mass[{k}]", law, q, stiff[:0], matrix, 0.0)
            for k, (law, matrix) in enumerate(zip(BEAM_MASSES, heavy[1:], strict=True), 1)
        ]

    def _joint(self, stretch: Stretch, joint: GenericJoint) -> list[RegionTerm]:
        slap, slip, axial = joint_matrices(stretch.length)
        found = []
        for key, law, matrix in (("k1", SLAP, slap), ("k2", SLIP, slip)):
            for label, value, elements in joint.groups(key):
                at = [stretch.first + e for e in elements]
                found.append(self._term(f"{label}.{law.name}", law, {key: value}, matrix, at))
        if joint.k_axial is not None:
            elements = range(stretch.first, stretch.first + stretch.n)
            q = {"k_axial": joint.k_axial, "axial": joint.axial}
            found.append(self._term(f"{joint.name}.axial", AXIAL, q, axial, elements))
        return found

    def _term(self, name, law, q, matrix, elements) -> RegionTerm:
        stiff = self.layout.assemble(matrix[None], elements)
        return RegionTerm(name, law, q, stiff, np.zeros_like(stiff[0]), 0.0)

    def _dampers(self, stretch: Stretch, joint: GenericJoint):
        for label, c, elements in joint.groups("c"):
            at = [stretch.first + e for e in elements]
            yield label, c, self.layout.assemble(joint_damping_matrix()[None], at)[0]

    def mass(self, mass: LumpedMass) -> MassTerm:
        """A lumped mass, with the path that it may take."""
        moves = isinstance(mass.travel, str)
        if moves and mass.range is None:
            raise InputError(f"{mass.name}.range is missing: expected the range of its travel, m.")
        low, high = mass.range if moves else (float(mass.travel),) * 2
        step = np.min(np.diff(self.layout.x)) / _STATIONS
        n = 1 if low == high else max(4, int(np.ceil((high - low) / step)) + 1)
        stations = np.linspace(low, high, n)
        x, y, z = mass.point
        rows = np.array([self.layout.rows((x + s, y, z), mass.name)[0] for s in stations])
        # Scaled by the radius of gyration, the rotation's share of the mass is the rotary inertia.
        rows[:, 2] *= mass.radius
        travel = mass.travel if moves else low
        return MassTerm(mass.name, mass.mass, travel, mass.share, stations, rows)

    def clamp(self, clamp: Clamp) -> RegionTerm:
        """Springs over a face of the nominal section."""
        i = len(self.beams) - 1 if clamp.last else 0
        beam, (u, w, turn) = self.beams[i], np.eye(3)
        usual = 0.5 if i % 2 == 0 else -0.5
        arm = beam.height * (usual if beam.offset is None else beam.offset)
        middle = u - arm * turn
        stiff = np.array(
            [np.outer(middle, middle) + beam.height**2 / 12 * np.outer(turn, turn), np.outer(w, w)]
        )
        n = 3 * len(self.layout.x)
        whole, at = np.zeros((2, n, n)), slice(n - 3, n) if clamp.last else slice(0, 3)
        whole[:, at, at] = beam.breadth * beam.height * stiff
        whole = whole[:, self.layout.free[:, None], self.layout.free]
        q = {"k_n": clamp.k_n, "k_t": clamp.k_t}
        return RegionTerm(clamp.name, ELASTIC_SUPPORT, q, whole, np.zeros_like(whole[0]), 0.0)

    def spring(self, spring: Spring) -> SpringTerm:
        """A grounding spring."""
        at, _ = self.layout.rows(spring.point, spring.name)
        direction = np.asarray(spring.direction, dtype=float)
        if direction.shape != (3,) or not np.any(direction[[0, 2]]):
            raise InputError(
                f"{spring.name}.direction = {spring.direction}: expected (x, y, z) with a share "
                "along x or z, in which beams move."
            )
        row = direction[[0, 2]] @ at[:2]
        return SpringTerm(spring.name, spring.stiffness, spring.share, row)

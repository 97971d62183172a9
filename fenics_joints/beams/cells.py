"""Elements of beams and of their laps as boxes, and what a change in one does to the modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fenics_joints.beams.components import Beam
from fenics_joints.beams.layout import Layout

if TYPE_CHECKING:
    from fenics_joints.beams.structure import BeamStructure

#: Stiffness that joint elements have of their own.
JOINT_KEYS = ("k1", "k2", "k_axial")
#: Height of the box of a joint element, over that of its beams: the interface itself has none.
_INTERFACE = 0.05


@dataclass(frozen=True)
class BeamCells:
    """A box for each element of each beam, laps included, then one for each joint element.

    Attributes:
        vertices: Corners, m, in the order of DOLFINx's hexahedra, (n_cells, 8, 3).
        beam: Number of the beam of each cell; -1 for a joint element.
        lap: Number of the lap that it is in, or -1.
        element: Number of its element.
        volume: Volume, m3; of a joint element that of both beams there, whose bending stiffness
            it has.
    """

    vertices: np.ndarray
    beam: np.ndarray
    lap: np.ndarray
    element: np.ndarray
    volume: np.ndarray


def beam_cells(layout: Layout, beams: Sequence[Beam]) -> BeamCells:
    """The cells of beams."""
    of_beams, of_joints = [], []
    for stretch in layout.stretches:
        there = [beams[i] for i in stretch.beams]
        volumes = [b.breadth * b.height * stretch.length for b in there]
        lap = -1 if stretch.joint is None else stretch.joint
        for e in stretch.elements:
            ends = layout.x[e : e + 2]
            for i, b, volume in zip(stretch.beams, there, volumes, strict=True):
                z = (0.0, b.height) if i % 2 == 0 else (-b.height, 0.0)
                of_beams.append((_box(ends, b.breadth, z), i, lap, e, volume))
            if lap >= 0:
                z = 0.5 * _INTERFACE * min(b.height for b in there)
                box = _box(ends, min(b.breadth for b in there), (-z, z))
                of_joints.append((box, -1, lap, e, sum(volumes)))
    return BeamCells(*map(np.array, zip(*of_beams, *of_joints, strict=True)))


def _box(x: Sequence[float], width: float, z: tuple[float, float]) -> list:
    y = -width / 2, width / 2
    return [(x[i], y[j], z[k]) for k in range(2) for j in range(2) for i in range(2)]


def cell_energies(
    structure: BeamStructure, vectors: np.ndarray, given: Mapping[str, float] | None = None
) -> dict[str, np.ndarray]:
    """x^T K x of each cell by E, k1, k2 and k_axial, and x^T M x by rho, (n_cells, m).

    Args:
        structure: The beams.
        vectors: x as columns, (n_dofs, m).
        given: Values of parameters that differ from their nominal value.
    """
    cells, whole = structure.cells, structure.layout.at_nodes(vectors).reshape(-1, len(vectors.T))
    place = {key: c for c, key in enumerate(zip(cells.beam, cells.element, strict=True))}
    found = {key: np.zeros((len(place), len(vectors.T))) for key in ("E", "rho", *JOINT_KEYS)}
    values = structure.values(given)
    for term, region in zip(structure.element_terms, structure.regions, strict=False):
        q = region.values(values)
        stiff = np.tensordot(np.asarray(region.law.stiffness_terms(q)), term.stiffness, 1)
        heavy = region.law.inertia_term(q) * term.mass
        for e in term.elements:
            x, c = whole[3 * e : 3 * e + 6], place[term.beam, e]
            # The first property of each law is what its stiffness is in proportion to.
            found[region.law.properties[0]][c] += np.sum(x * (stiff @ x), axis=0)
            found["rho"][c] += np.sum(x * (heavy @ x), axis=0)
    return found

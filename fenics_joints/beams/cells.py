"""Elements of beams and of their laps as boxes, and what a change in each does to the modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.beams.element import joint_matrices, mass_matrices, stiffness_matrices
from fenics_joints.beams.laws import BEAM_MASSES
from fenics_joints.beams.structure import BeamStructure
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.values import number

__all__ = ["JOINT_KEYS", "BeamCells", "beam_cells", "cell_energies", "log_slopes"]

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


def beam_cells(structure: BeamStructure) -> BeamCells:
    """The cells of beams."""
    x, boxes, rows = structure.layout.x, [], []
    for joints in (False, True):
        for stretch in structure.layout.stretches:
            if joints and stretch.joint is None:
                continue
            beams = [structure.beams[i] for i in stretch.beams]
            lap = -1 if stretch.joint is None else stretch.joint
            for e in range(stretch.first, stretch.first + stretch.n):
                ends = x[e], x[e + 1]
                if joints:
                    z = 0.5 * _INTERFACE * min(b.height for b in beams)
                    boxes.append((ends, min(b.breadth for b in beams), (-z, z)))
                    volume = sum(b.breadth * b.height for b in beams) * stretch.length
                    rows.append((-1, lap, e, volume))
                    continue
                for i, b in zip(stretch.beams, beams, strict=True):
                    boxes.append((ends, b.breadth, (0.0, b.height) if i % 2 == 0 else
                                  (-b.height, 0.0)))  # fmt: skip
                    rows.append((i, lap, e, b.breadth * b.height * stretch.length))
    beam, lap, element, volume = map(np.array, zip(*rows, strict=True))
    return BeamCells(np.array([_box(*box) for box in boxes]), beam, lap, element, volume)


def _box(x: tuple[float, float], width: float, z: tuple[float, float]) -> list:
    y = -width / 2, width / 2
    return [(x[i], y[j], z[k]) for k in range(2) for j in range(2) for i in range(2)]


def log_slopes(
    structure: BeamStructure, cells: BeamCells, modes: Modes, index: Sequence[int]
) -> dict[str, np.ndarray]:
    """Derivatives of ln f by the logarithm of a property of each cell alone.

    Args:
        structure: The beams.
        cells: Their cells.
        modes: Modes.
        index: Which of them.

    Returns:
        By E, rho, k1, k2 and k_axial, (n_cells, m): nought where a cell has no such property. In a
        lap E is that of the axial stiffness alone, unless that is given as k_axial.
    """
    lam = modes.eigenvalues[index]
    found = cell_energies(structure, cells, modes.shapes[:, index], modes.given)
    return {
        key: -values / 2 if key == "rho" else values / (2 * lam) for key, values in found.items()
    }


def cell_energies(
    structure: BeamStructure,
    cells: BeamCells,
    vectors: np.ndarray,
    given: Mapping[str, float] | None = None,
) -> dict[str, np.ndarray]:
    """x^T K x of each cell by E, k1, k2 and k_axial, and x^T M x by rho, (n_cells, m).

    Args:
        structure: The beams.
        cells: Their cells.
        vectors: x as columns, (n_dofs, m).
        given: Values of parameters that differ from their nominal value.
    """
    n, m = len(structure.layout.x), vectors.shape[1]
    whole = np.zeros((3 * n, m))
    whole[structure.layout.free] = vectors
    stiffness, inertia = _element_matrices(structure, structure.values(given))
    found = {key: np.zeros((len(cells.beam), m)) for key in ("E", "rho", *JOINT_KEYS)}
    for c, (beam, e) in enumerate(zip(cells.beam, cells.element, strict=True)):
        x = whole[3 * e : 3 * e + 6]
        if beam >= 0:
            found["E"][c] = _squares(stiffness[beam, e], x)
            found["rho"][c] = _squares(inertia[beam, e], x)
        else:
            for key in JOINT_KEYS:
                found[key][c] = _squares(stiffness[key, e], x) if (key, e) in stiffness else 0.0
    return found


def _squares(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.sum(x * (A @ x), axis=0)


def _element_matrices(structure: BeamStructure, values) -> tuple[dict, dict]:
    """Stiffness and mass, (6, 6), of each beam in each element; stiffness of joint elements."""
    regions = {region.name: region for region in structure.regions}
    stiffness, inertia = {}, {}
    for stretch in structure.layout.stretches:
        joint = None if stretch.joint is None else structure.joints[stretch.joint]
        elements = range(stretch.first, stretch.first + stretch.n)
        for i in stretch.beams:
            name = structure.beams[i].name
            region = regions[name if joint is None else f"{joint.name}.{name}"]
            q = region.values(values)
            terms = np.asarray(region.law.stiffness_terms(q))
            stiff = np.tensordot(terms, stiffness_matrices(stretch.length)[: len(terms)], 1)
            if joint is not None and joint.k_axial is not None:
                stiff = np.zeros((6, 6))
            heavy = [law.inertia_terms(q)[0] for law in (region.law, *BEAM_MASSES)]
            mass = np.tensordot(heavy, mass_matrices(stretch.length), 1)
            for e in elements:
                stiffness[i, e], inertia[i, e] = stiff, mass
        if joint is None:
            continue
        slap, slip, axial = joint_matrices(stretch.length)
        for key, matrix in (("k1", slap), ("k2", slip)):
            for _, value, group in joint.groups(key):
                for e in group:
                    stiffness[key, stretch.first + e] = number(value, values) * matrix
        if joint.k_axial is not None:
            k = number(joint.k_axial, values) * number(joint.axial, values)
            stiffness.update({("k_axial", e): k * axial for e in elements})
    return stiffness, inertia

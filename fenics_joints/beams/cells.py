"""What a change in one element of beams or of their laps does to the modes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_joints.beams.boxes import BeamCells
from fenics_joints.beams.element import joint_matrices, mass_matrices, stiffness_matrices
from fenics_joints.beams.laws import BEAM_MASSES
from fenics_joints.beams.structure import BeamStructure
from fenics_joints.structure.values import number

#: Stiffness that joint elements have of their own.
JOINT_KEYS = ("k1", "k2", "k_axial")


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
            heavy = [law.inertia_term(q) for law in (region.law, *BEAM_MASSES)]
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

"""What a change of stiffness or mass in each patch of a mesh does to frequencies and shapes."""

from __future__ import annotations

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.signatures import Signatures
from fenics_joints.diagnosis.where.cells import Cells
from fenics_joints.diagnosis.where.patches import Patches
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED
from fenics_joints.measurements.gap import Pairing
from fenics_joints.modal.modes import Modes
from fenics_joints.structure import Sensors

#: How near two eigenvalues may be, relative to them, before what turns their shapes into one
#: another is bounded: a change of the expected size turns them all the way. [decision: chosen]
_CLOSE = 0.03


def signatures(
    cells: Cells,
    modes: Modes,
    pairing: Pairing,
    evidence: Evidence,
    split: Patches,
    sensors: Sensors | None,
    soft: tuple[Modes, Pairing] | None = None,
) -> Signatures:
    """Signatures of the patches, to first order. Collective.

    With K_p and M_p the parts of a patch, of mode i

    d ln f = (x_i^T K_p x_i - lambda_i x_i^T M_p x_i) / (2 lambda_i) and
    d x_i = sum over k of x_k (x_k^T K_p x_i - lambda_i x_k^T M_p x_i) / (lambda_i - lambda_k)

    by ln of its stiffness and of its mass (Fox and Kapoor, AIAA J. 6, 1968), the sum over the modes
    at hand, rigid ones among them. A patch of a joint is taken where all joints give way, and by
    twice the compliance.

    Args:
        cells: The full model's cells.
        modes: Its modes at the baseline.
        pairing: Which of them the test saw.
        evidence: The test.
        split: The patches.
        sensors: Of the shapes; None without shapes.
        soft: Modes with all joints giving way, and which of them the test saw; None without joints.
    """
    of_joint = np.array([region in cells.joints for region in split.region], dtype=bool)
    log_f, shapes = _by_patch(cells, modes, pairing, evidence, split, sensors)
    expected = np.array([EXPECTED["E"], EXPECTED["rho"]])
    log_f = log_f * expected
    shapes = None if shapes is None else shapes * expected
    if of_joint.any() and soft is not None:
        yielding, turning = _by_patch(cells, *soft, evidence, split, sensors)
        mass_stays = np.array([-1.0, 0.0])
        log_f[:, of_joint] = yielding[:, of_joint] * mass_stays
        if shapes is not None:
            shapes[:, :, of_joint] = turning[:, :, of_joint] * mass_stays
    return Signatures(
        split.names,
        split.region,
        split.middle,
        split.volume,
        of_joint,
        log_f,
        shapes,
        (EXPECTED["E"], EXPECTED["rho"]),
    )


def _by_patch(cells, modes, pairing, evidence, split, sensors):
    """Derivatives of ln f, (m, P, 2), and of the scaled shapes, (n_s, m, P, 2) or None, by ln of
    the stiffness and the mass of each patch."""
    lam, count = modes.eigenvalues, len(split)
    seen = None if evidence.shapes is None else modes.at(sensors)
    log_f, shapes = [], []
    for i, crossed in zip(pairing.index, cells.crossed(modes, pairing.index), strict=True):
        stiff, mass = (cells.sums(split.number, by_cell, count) for by_cell in crossed)
        pulls = np.stack([stiff, -lam[i] * mass], axis=-1)  # (P, M, 2)
        log_f.append(pulls[:, i] / (2 * lam[i]))
        if seen is not None:
            apart = lam[i] - lam
            turns = apart / (apart**2 + (_CLOSE * lam[i]) ** 2)
            turns[i] = 0.0
            shapes.append(np.einsum("sk,k,pkw->spw", seen, turns, pulls))
    if seen is None:
        return np.array(log_f), None
    at = seen[:, pairing.index]
    return np.array(log_f), _scaled(evidence.shapes, at, np.stack(shapes, axis=1))


def _scaled(measured: np.ndarray, at: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Changes of shapes, (n_s, m, P, 2), as the measured ones are scaled, (n_s, m), without their
    part along the shape, which has no scale of its own."""
    there = np.isfinite(measured)
    y, x = np.where(there, measured, 0.0), np.where(there, at, 0.0)
    change = np.where(there[:, :, None, None], change, 0.0)
    square = np.maximum(np.sum(x**2, axis=0), 1e-300)
    scale = np.sum(x * y, axis=0) / square
    along = np.einsum("sm,smpw->mpw", x, change) / square[:, None, None]
    return scale[None, :, None, None] * (change - x[:, :, None, None] * along[None])

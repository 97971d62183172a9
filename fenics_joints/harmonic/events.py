"""Harmonics of stress of laws without memory whose branches change within the cycle.

Where a stop is met or friction turns, stress has a kink. Sampled evenly, its harmonics are off by
the square of the step, and as functions of the motion they have a kink each time the contact
passes a sample: Newton's method and the continuation stumble over these, the more the stiffer the
stop. Here the times at which a law's switches change their signs are found, and Gauss's rule
integrates between them (`events.c` of the laws), so that the harmonics are as smooth as the
motion's physics allows.
"""

from __future__ import annotations

import numpy as np

from fenics_joints.harmonic.fourier import Fourier
from fenics_joints.joint_laws.kernel import HarmonicStress, LawKernel


def memoryless_stress(
    kernel: LawKernel,
    X: np.ndarray,
    omega: float,
    fourier: Fourier,
    values: np.ndarray,
    *,
    jacobian: bool = True,
) -> HarmonicStress:
    """Harmonics of stress by those of strain, of a law without memory.

    Args:
        kernel: The law.
        X: Harmonics of strain, (P, d, K).
        omega: Angular frequency, rad/s.
        fourier: Harmonics and samples.
        values: Parameters, (P, E, n_parameters).
        jacobian: Whether the derivatives are wanted.
    """
    d, G = X.shape[1], fourier.derivative
    Z = np.concatenate([X, omega * (X @ G.T)], axis=1) if kernel.rated else X
    inputs = Z @ fourier.synthesis.T
    stress = kernel.history(inputs.transpose(0, 2, 1), None, values)[0]
    changes = fourier.periods * Z @ G.T
    F, J = kernel.memoryless(Z, changes, fourier.synthesis, values, jacobian=jacobian)
    by_omega = None
    if kernel.rated and jacobian:
        by_rate = J[..., d:, :]
        by_omega = np.einsum("pakbl,pbl->pak", by_rate, X @ G.T)
        J = np.ascontiguousarray(J[..., :d, :] + omega * by_rate @ G)
    state = np.zeros((*values.shape[:2], 0))
    strain = np.ascontiguousarray(inputs[:, :d].transpose(0, 2, 1))
    return HarmonicStress(F, J, strain, stress, state, 0.0, by_omega)

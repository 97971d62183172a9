"""Frequency response functions of models of plain arrays.

All modes of the reduced matrices are found at once; on them K and M are diagonal, and so is the
dynamic stiffness unless a layer has damping of its own. Then a small dense system is solved at each
line, all lines in one call of LAPACK. Both are exact on the basis, and so are the derivatives:
dH/dp = -psi^T dZ/dp u, with matrices dZ/dp that are sums of the affine terms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fenics_joints.modal.modes import SHIFT_SHARE, Modes, count_rigid, inverted_modes
from fenics_joints.response.modal_basis import ModalPencil
from fenics_joints.response.pencil import DampedPencil
from fenics_joints.structure import Damped, Damping

#: Vectors with less than this share of the largest mass over energy have none.
_MASSLESS = 1e-15


def reduced_pencil(
    model: Damped,
    given: Mapping[str, float] | None = None,
    damping: Damping | None = None,
    *,
    gradients: bool = False,
) -> ModalPencil:
    """A reduced model on all of its modes, with its damping.

    Args:
        model: A model of plain arrays.
        given: Values of parameters that differ from their nominal value.
        damping: The damping; modal ratios, too.
        gradients: Whether derivatives by the parameters are wanted.

    Returns:
        The modes; their ``basis`` is in the coordinates of the reduced model.

    Raises:
        InputError: If a value is out of range or unknown, or a region is graded and derivatives
            are wanted.
        ConvergenceError: If the matrices are singular.
    """
    pencil = DampedPencil(model, given, damping)
    shift_hz = SHIFT_SHARE * model.dilation_frequency(given)
    stiff, heavy, basis, n_rigid = _modes(pencil.K, pencil.M, shift_hz)
    massive = heavy > 0
    modes = Modes(model, dict(given or {}), stiff[massive], basis[:, massive], n_rigid)
    terms = None
    if gradients:
        terms = [replace(term, form=_on(basis, term.form)) for term in pencil.terms()]
    parts = {name: _on(basis, A) for name, A in pencil.parts.items()}
    return ModalPencil(
        modes,
        basis,
        stiff,
        heavy,
        parts,
        terms,
        pencil.damping,
        pencil.named,
        tuple(model.parameters),
        pencil.comm,
    )


def _modes(K: np.ndarray, M: np.ndarray, shift_hz: float) -> tuple[np.ndarray, ...]:
    """Stiffness and mass, (n,), on all modes, (n, n), and the number of rigid-body modes.

    Those with mass are M-normalised; those without, of massless layers, have energy 1.
    """
    shift = (2 * np.pi * shift_hz) ** 2
    inverse, vectors = inverted_modes(K, M, shift)
    massive = inverse > _MASSLESS * inverse[0]
    scale = np.where(massive, inverse, 1.0)
    stiff = np.where(massive, 1 / scale - shift, 1.0)
    n_rigid = count_rigid(stiff[massive], shift_hz)  # a massless one has energy 1, near 0 too
    stiff[:n_rigid] = 0.0
    return stiff, massive.astype(float), vectors / np.sqrt(scale), n_rigid


def _on(basis: np.ndarray, A: np.ndarray) -> np.ndarray:
    return basis.T @ A @ basis

"""Frequency response functions of reduced models, `ReducedStructure` or `ArrayModel`.

All modes of the reduced matrices are found at once; on them K and M are diagonal, and so is the
dynamic stiffness unless a layer has damping of its own. Then a small dense system is solved at each
line, all lines in one call of LAPACK. Both are exact on the basis, and so are the derivatives:
dH/dp = -psi^T dZ/dp u, with matrices dZ/dp that are sums of the affine terms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import SHIFT_SHARE, Modes, count_rigid, inverted_modes
from fenics_joints.response.modal_basis import ModalPencil
from fenics_joints.response.pencil import Term, imaginary, linear
from fenics_joints.structure.damping import Damping
from fenics_joints.structure.values import parameter_values

__all__ = ["reduced_pencil"]

#: Vectors with less than this share of the largest mass over energy have none.
_MASSLESS = 1e-15


def reduced_pencil(
    model,
    given: Mapping[str, float] | None = None,
    damping: Damping | None = None,
    *,
    gradients: bool = False,
) -> ModalPencil:
    """A reduced model on all of its modes, with its damping.

    Args:
        model: A `ReducedStructure` or `ArrayModel`.
        given: Values of parameters that differ from their nominal value.
        damping: The damping; modal ratios, too.
        gradients: Whether derivatives by the parameters are wanted.

    Returns:
        The modes; their ``basis`` is in the coordinates of the reduced model.

    Raises:
        InputError: If a value is out of range or unknown, the model is of another kind, or a
            region is graded and derivatives are wanted.
        ConvergenceError: If the matrices are singular.
    """
    if not hasattr(model, "region_stiffness"):
        raise InputError(
            f"model: expected a Structure, ReducedStructure or ArrayModel, not a "
            f"{type(model).__name__}."
        )
    values = parameter_values(model.parameters, given)
    named = damping or Damping()
    named.check(getattr(model, "full", model))
    K, M = model.stiffness(values), model.mass(values)
    stiff, heavy, basis, n_rigid = _modes(K, M, SHIFT_SHARE * model.scale_hz)
    parts = {n: _on(basis, model.region_stiffness(n, values)) for n in named.layers}
    massive = heavy > 0
    modes = Modes(model, dict(given or {}), stiff[massive], basis[:, massive], n_rigid)
    numbers = named.at(values)
    terms = list(_terms(model, values, named, numbers, basis, parts)) if gradients else None
    return ModalPencil(
        modes, basis, stiff, heavy, parts, terms, numbers, named, tuple(model.parameters),
        MPI.COMM_SELF,
    )  # fmt: skip


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


def _terms(model, values, named: Damping, numbers: Damping, basis, parts) -> Iterator[Term]:
    """dZ/dp on the basis, but for modal damping ratios; see `DampedPencil.terms`."""
    position = {name: i for i, name in enumerate(model.parameters)}
    for p, kind, name, A in model.slopes(values, named.layers):
        factor = numbers.mass_factor if kind == "M" else _stiffness_factor(numbers, name)
        yield Term(p, kind, factor, _on(basis, A))
    alpha, beta = named.rayleigh
    own = [(named.structural, imaginary, model.stiffness), (alpha, linear, model.mass),
           (beta, linear, model.stiffness)]  # fmt: skip
    for value, factor, matrix in own:
        if isinstance(value, str):
            yield Term(position[value], "D", factor, _on(basis, matrix(values)))
    own = [(v, imaginary, n) for n, v in named.hysteretic.items()]
    own += [(v, linear, n) for n, v in named.viscous.items()]
    for value, factor, name in own:
        if isinstance(value, str):
            yield Term(position[value], "D", factor, parts[name])


def _stiffness_factor(numbers: Damping, name: str | None):
    return lambda s: numbers.stiffness_factor(s, name)

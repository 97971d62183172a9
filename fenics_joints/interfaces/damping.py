"""Viscous damping of models with nonlinear interfaces, by their modes at rest or by factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.errors import InputError, capable, real, reals, wanted
from fenics_joints.interfaces.model import InterfaceModel


def with_modal_damping(
    model: InterfaceModel, ratios: float | Sequence[float], rest: float = 0.0
) -> InterfaceModel:
    """The model with viscous damping of its modes at rest, C = M Phi diag(2 zeta omega) Phi^T M.

    Args:
        model: The model.
        ratios: Damping ratio of all modes, or of the first ones, rigid-body modes included.
        rest: Ratio of the modes beyond those.

    Raises:
        InputError: If a ratio is negative, or there are more of them than modes.
    """
    capable("model", model, ("M", "modes_at_rest"), "an InterfaceModel")
    n = model.n_dofs
    ratios, rest = reals("ratios", ratios, least=0.0), real("rest", rest, least=0.0)
    zeta = np.full(n, float(ratios) if ratios.ndim == 0 else rest)
    if ratios.ndim:
        if ratios.ndim > 1 or not len(ratios):
            raise wanted("ratios", ratios, "one number, or a list of them")
        if len(ratios) > n:
            raise InputError(f"ratios: {len(ratios)} of them; expected at most {n}, one per mode.")
        zeta[: len(ratios)] = ratios
    s, inverse, X = model.modes_at_rest()
    # 2 zeta omega / mu with x^T (K + s M) x = 1, mu = x^T M x = 1 / (omega^2 + s).
    omega = np.sqrt(np.maximum(1.0 - s * inverse, 0.0))
    # A direction without mass moves with the others' forces; damping of it has no meaning.
    heavy = inverse > 1e-14 * inverse[0]
    weight = np.divide(2 * zeta * omega, np.abs(inverse) ** 1.5, out=np.zeros(n), where=heavy)
    MX = model.M @ X
    return replace(model, C=(MX * weight) @ MX.T)


def with_rayleigh_damping(
    model: InterfaceModel, mass: float = 0.0, stiffness: float = 0.0
) -> InterfaceModel:
    """The model with C = mass M + stiffness K, K that of small vibrations at rest.

    Args:
        model: The model.
        mass: Factor of the mass, 1/s.
        stiffness: Factor of the stiffness, s.

    Raises:
        InputError: If a factor is negative or not finite.
    """
    capable("model", model, ("M", "stiffness_at_rest"), "an InterfaceModel")
    for key, value in (("mass", mass), ("stiffness", stiffness)):
        real(key, value, least=0)
    return replace(model, C=mass * model.M + stiffness * model.stiffness_at_rest())

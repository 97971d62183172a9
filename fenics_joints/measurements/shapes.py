"""Shapes of modes from the residues that poles have in measured functions."""

from __future__ import annotations

import numpy as np

from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.measurements.poles import PoleFit

__all__ = ["ShapeFit"]


class ShapeFit:
    """The shape of a mode from its residues A = shape parts^T, and its scale."""

    def __init__(self, data: MeasuredFRFs, fit: PoleFit, r: int):
        self.data, self.there, self.pole = data, data.measured, fit.poles[r]
        self.weight = np.zeros(self.there.shape)
        self.weight[self.there] = 1 / np.maximum(fit.residues_sd[:, r], 1e-300) ** 2
        self.weight /= self.weight.max()
        residues = np.zeros(self.there.shape)
        residues[self.there] = np.abs(fit.residues[:, r])
        self.strongest = int(np.argmax((self.weight * residues**2).sum(axis=1)))
        self.largest = self.strongest
        first, _ = self._rank_one(fit.residues[:, r])
        # The component that says the sign, and of a shape without modal mass the scale.
        self.largest = int(np.nanargmax(np.abs(first.real)))
        self.value, parts = self._rank_one(fit.residues[:, r])
        self.scale = self._modal_scale(self.value, parts)

    def _rank_one(self, residues: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shape of unit length, as real as it can be turned, and parts of the references.

        Least squares, weighted by the residues' deviations; nan where nothing was measured. Of one
        set of residues or of many, shape (..., n_functions).
        """
        A = np.zeros((*residues.shape[:-1], *self.there.shape), dtype=complex)
        A[..., self.there] = residues
        parts = A[..., self.strongest, :].copy()
        parts[parts == 0] = 1e-6 * np.abs(parts).max()
        for _ in range(100):
            shape, before = _solve(self.weight, A, parts), parts
            parts = _solve(self.weight.T, A.swapaxes(-1, -2), shape)
            if np.linalg.norm(parts - before) <= 1e-9 * np.linalg.norm(parts):
                break
        # The sum of squares of a shape turned by an angle is turned by twice that.
        turn = np.exp(0.5j * np.angle((shape**2).sum(axis=-1, keepdims=True)))
        turn = turn * np.linalg.norm(shape, axis=-1, keepdims=True)
        turn = turn * np.where((shape / turn)[..., [self.largest]].real < 0, -1, 1)
        return np.where(self.there.any(axis=1), shape / turn, np.nan), parts * turn

    def _modal_scale(self, shape: np.ndarray, parts: np.ndarray) -> np.ndarray:
        """Factor from a shape to the mass-normalised one; 0 if no driving point tells.

        A residue is A_ij = phi_i phi_j / (2 i w_d) of a mass-normalised real mode (Ewins, Modal
        Testing, 2nd ed., 2.5), so that at driving points parts = Q shape with Q 2 i w_d = scale^2.
        """
        above, below = np.zeros(shape.shape[:-1], dtype=complex), 1e-300
        for i, j, sign in self.data.driving_points():
            above = above + parts[..., j] * sign * np.conj(shape[..., i])
            below = below + np.abs(shape[..., i]) ** 2
        square = np.where(below > 1e-6, (2j * self.pole.imag * above / below).real, 0.0)
        return np.sqrt(np.maximum(square, 0.0))

    def spread(self, draws: np.ndarray, normalised: bool) -> np.ndarray:
        """Standard deviation of the scaled real shape over draws of the residues."""
        shapes, parts = self._rank_one(draws)
        scale = self._modal_scale(shapes, parts) if normalised else 1 / shapes[:, self.largest].real
        return np.std(scale[:, None] * shapes.real, axis=0)


def _solve(weight: np.ndarray, A: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Least-squares x of A = x parts^T, row by row."""
    parts = parts[..., None, :]
    below = (weight * np.abs(parts) ** 2).sum(axis=-1)
    return (weight * A * parts.conj()).sum(axis=-1) / np.where(below > 0, below, 1.0)

"""A parametric reduced model of plain arrays: what a fit needs, on every rank, without a mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from fenics_joints.affine import AffinePencil, slopes
from fenics_joints.components import Parameter
from fenics_joints.points import Sensors

__all__ = ["ArrayModel"]

_DIFFERENCE = 1e-6


@dataclass(frozen=True)
class ArrayModel:
    """Takes the same calls as the reduced structure it was made from; see its ``arrays``.

    Attributes:
        pencil: K(p) and M(p) on the basis.
        scale_hz: Dilation frequency, Hz, below which by far a mode is rigid.
        sensor_rows: What the sensors read of the basis, shape (n_sensors, n_dofs); None without.
        shift_rows: The same per metre that a sensor sits further along their line; or None.
    """

    pencil: AffinePencil
    scale_hz: float
    sensor_rows: np.ndarray | None = None
    shift_rows: np.ndarray | None = None

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        return self.pencil.parameters

    @cached_property
    def n_dofs(self) -> int:
        """Size of the basis."""
        return len(self.pencil.regions[0].inertia)

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters' values."""
        return self.pencil.values(given)

    def stiffness(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Reduced K(p), shape (n_dofs, n_dofs)."""
        return self._matrices(given)[0]

    def mass(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Reduced M(p), shape (n_dofs, n_dofs)."""
        return self._matrices(given)[1]

    def _matrices(self, given) -> tuple[np.ndarray, np.ndarray]:
        """(K, M); kept for the next call, since both are asked for one after the other."""
        values = self.values(given)
        key = tuple(values.values())
        last = self.__dict__.get("_last")
        if last is None or last[0] != key:
            last = key, self._assemble(values)
            self.__dict__["_last"] = last
        return last[1]

    def _assemble(self, values) -> tuple[np.ndarray, np.ndarray]:
        n, (stiffness, inertia) = self.n_dofs, self._stacks
        theta, heavy = [], []
        for region in self.pencil.regions:
            q = region.values(values)
            theta.append(region.law.stiffness_terms(q))
            heavy.append(region.law.inertia_terms(q)[0])
        K = (np.concatenate(theta) @ stiffness).reshape(n, n)
        M = (np.array(heavy) @ inertia).reshape(n, n)
        rest_K, rest_M = self._rest.matrices(values)
        return K + rest_K, M + rest_M

    @cached_property
    def _stacks(self) -> tuple[np.ndarray, np.ndarray]:
        """All regions' stiffness terms and inertias as rows: one product instead of many sums."""
        size = self.n_dofs**2
        terms = [r.stiffness.reshape(-1, size) for r in self.pencil.regions]
        return np.concatenate(terms), np.array([r.inertia.ravel() for r in self.pencil.regions])

    @cached_property
    def _rest(self) -> AffinePencil:
        """Everything but the regions."""
        return replace(self.pencil, regions=())

    def pencil_gradients(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x by every parameter, shape (k, n_parameters).

        Args:
            shapes: Vectors x as columns, shape (n_dofs, k).
            eigenvalues: lambda of each, shape (k,).
            given: Values of parameters that differ from their nominal value.
        """
        values = self.values(given)
        squares = np.einsum("ik,jk->ijk", shapes, shapes).reshape(-1, shapes.shape[1])
        stiff, heavy = (stack @ squares for stack in self._stacks)
        return self._combine(stiff.T, heavy.T, np.asarray(eigenvalues), values) + (
            self._rest.gradients(shapes, eigenvalues, values)
        )

    def _combine(self, stiff, heavy, eigenvalues, values) -> np.ndarray:
        """Chain rule from the regions' terms, (k, n_terms, ...), to the parameters."""
        position = {name: i for i, name in enumerate(self.parameters)}
        extra = stiff.shape[2:]
        total = np.zeros((len(eigenvalues), len(position), *extra))
        lam = eigenvalues.reshape(-1, *(1 for _ in extra))
        at = 0
        for number, region in enumerate(self.pencil.regions):
            count = len(region.stiffness)
            q = region.values(values)
            for key, name in region.properties.items():
                if not isinstance(name, str):
                    continue
                by_stiff = slopes(region.law.stiffness_terms, q, key)
                by_heavy = slopes(region.law.inertia_terms, q, key)[0]
                change = np.tensordot(stiff[:, at : at + count], by_stiff, axes=(1, 0))
                total[:, position[name]] += change - lam * by_heavy * heavy[:, number]
            at += count
        return total

    def pencil_products(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """(dK/dp - lambda dM/dp) x for every parameter, shape (k, n_parameters, n_dofs)."""
        values, n = self.values(given), self.n_dofs
        eigenvalues = np.asarray(eigenvalues)
        stiff, heavy = (
            np.einsum("tij,jk->kti", stack.reshape(-1, n, n), shapes, optimize=True)
            for stack in self._stacks
        )
        total = self._combine(stiff, heavy, eigenvalues, values)
        owned = {p for r in self.pencil.regions for p in r.properties.values()}
        for i, name in enumerate(self.parameters):
            if name in owned:
                continue
            step = _DIFFERENCE * max(abs(values[name]), 1e-3)
            up, down = (
                self._rest.matrices({**values, name: values[name] + s}) for s in (step, -step)
            )
            dK, dM = ((a - b) / (2 * step) for a, b in zip(up, down, strict=True))
            if np.ndim(dK):
                total[:, i] += (dK @ shapes).T
            if np.ndim(dM):
                total[:, i] -= eigenvalues[:, None] * (dM @ shapes).T
        return total

    def shape_slopes(self, index, given=None) -> tuple[np.ndarray, np.ndarray]:
        """Mass-normalised shapes of some modes and their derivatives by every parameter.

        By expansion in all modes of the reduced model, which is exact on its basis (Fox and Kapoor,
        AIAA J. 6, 1968). Derivatives of modes of nearly equal frequency are large, and mean little.

        Args:
            index: Which modes, by ascending eigenvalue.
            given: Values of parameters that differ from their nominal value.

        Returns:
            Shapes, (n_dofs, k); derivatives, (n_dofs, k, n_parameters).
        """
        K, M = self._matrices(given)
        eigenvalues, vectors = _all_modes(K, M, self.scale_hz)
        x, lam = vectors[:, index], eigenvalues[index]
        products = self.pencil_products(x, lam, given) @ vectors
        gap = lam[:, None] - eigenvalues[None, :]
        gap[np.arange(len(lam)), index] = np.inf
        weights = products / gap[:, None, :]
        own = self._mass_slopes(x, given)
        change = np.einsum("nj,kpj->nkp", vectors, weights, optimize=True)
        return x, change - 0.5 * x[:, :, None] * own[None]

    def _mass_slopes(self, x: np.ndarray, given) -> np.ndarray:
        """x^T dM/dp x, shape (k, n_parameters): from the pencil's slope at two eigenvalues."""
        zero, one = np.zeros(x.shape[1]), np.ones(x.shape[1])
        return self.pencil_gradients(x, zero, given) - self.pencil_gradients(x, one, given)

    def observe(self, shapes: np.ndarray, sensors: Sensors | None = None) -> np.ndarray:
        """Shapes at the sensors that the model was made with, shape (n_sensors, n_shapes)."""
        return self.sensor_rows @ shapes

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg."""
        return self.pencil.total_mass(self.values(given))


def _all_modes(K: np.ndarray, M: np.ndarray, scale_hz: float):
    """All eigenvalues and mass-normalised vectors, ascending; inverted as in `solve_modes`."""
    shift = (2 * np.pi * 0.002 * scale_hz) ** 2
    inverse, vectors = scipy.linalg.eigh(M, K + shift * M, check_finite=False)
    inverse, vectors = inverse[::-1], vectors[:, ::-1]
    return 1 / inverse - shift, vectors / np.sqrt(inverse)

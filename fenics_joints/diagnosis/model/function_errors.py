"""What any model of a structure, and a test's own resonances, make wrong of a function's lines."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np

from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.grounded import PointBasis
from fenics_joints.reduction.many import ManyModes
from fenics_joints.reduction.receptances import Lines, Poles, Receptances

#: `fenics_joints.diagnosis.model.prepared.Prepared`.
Prepared = Any
#: How far a line may be off by the model's errors, and by where resonances are and how they are
#: damped alone, relative to it: beyond, what it says is not linear in these any more. [decision:
#: chosen]
_MOST, _NEAR = 0.3, 0.1
#: Error of what modes beyond those at hand add, mostly what bends about the point, of itself.
#: [decision: chosen]
_BEYOND = 0.2
#: Eigenvalue, over that of the lowest mode of the test, below which a mode is a rigid motion.
#: [numerical: chosen]
_RIGID = 1e-4
#: What an unknown cause may do to a shape, in errors of any model of it. [decision: as of shapes:
#: 0.2 over the usual 0.05]
_UNKNOWN = 4.0


class Errors:
    """Errors of lines, by their cause, relative to the measured function.

    A function's residues are products of shapes, which any model has wrong by
    ``shape_discrepancy``, in phase and out of it; where the test has no resonance the model's is
    wrong as its others are.

    Args:
        model: The case.
        basis: A model with the functions' points.
        forward: Tells the test's modes of it.
        row: The test's row.
        poles: Its resonances.
        damping_sd: Standard deviation of ln of their damping, (m,).
    """

    def __init__(
        self,
        model: Prepared,
        basis: PointBasis,
        forward: Forward,
        row: int,
        poles: Poles,
        damping_sd: np.ndarray,
    ):
        self.basis, self.forward, self.poles = basis, forward, poles
        self._evidence, self._baseline = model.evidence, model.baseline
        self._log_sd, self._damping_sd = model.data.log_sd()[row], damping_sd
        self._n_modes = min(model.case.diagnose.n_modes, basis.model.n_dofs)
        self.modes: ManyModes = self._receptances(Lines(*np.zeros((3, 0)))).modes(self._baseline)
        self._lam, self._index = self.modes.eigenvalues[0], self.modes.index[0]
        self._n_rigid = int(np.sum(self._lam < _RIGID * self._lam[self._index].min()))
        self._moves = basis.rows @ self.modes.vectors[0]
        everywhere = basis.model.sensor_rows @ self.modes.vectors[0]
        # Of a motion's length, three directions to each place.
        self._size = np.sqrt(basis.everywhere.points.shape[1] * np.mean(everywhere**2, axis=0))
        own = np.isfinite(poles.frequencies_hz)
        away = self.modes.log_f[0][own] - np.log(poles.frequencies_hz[own])
        self._off = float(np.hypot(self._evidence.discrepancy, np.sqrt(np.mean(away**2))))
        self._last = self._highest(away, own)

    def receptances(self, lines: Lines) -> np.ndarray:
        """The nominal model's, m/N, (n,)."""
        return self._receptances(lines).at(self._baseline)[0]

    def _receptances(self, lines: Lines) -> Receptances:
        return Receptances(self.basis, lines, self.poles, self.forward)

    def _highest(self, away: np.ndarray, own: np.ndarray) -> float:
        """Up to where resonances are known, Hz: half way from the test's last one to the next."""
        hz = self.poles.frequencies_hz[own]
        last, shift = hz.max(), away[np.argmax(hz)]
        model = np.sqrt(np.maximum(self._lam[: self._n_modes], 0.0)) / (2 * np.pi)
        above = model[model > last * np.exp(shift) * (1 + 1e-6)] * np.exp(-shift)
        return float(np.sqrt(last * above.min())) if len(above) else float(last)

    def small(self, lines: Lines, values: np.ndarray, sd: np.ndarray) -> np.ndarray:
        """Which lines say something, (n,), of values (n,) with their noise: the lesser of what was
        measured and of what the model has, which errors shall be little of either."""
        of_shapes, of_poles = self._columns(lines)
        near, all_ = (
            np.sqrt(sum(np.abs(c) ** 2 for c in parts.values())) / np.abs(values)
            for parts in (of_poles, of_shapes | of_poles)
        )
        known = lines.frequencies_hz <= self._last
        return known & (near < _NEAR) & (np.hypot(all_, sd) < _MOST)

    def common(self, lines: Lines, n: int, value: complex) -> dict[Hashable, complex]:
        """Errors of one of the lines that others have too, by their cause."""
        one = Lines(
            *(each[n : n + 1] for each in (lines.frequencies_hz, lines.response, lines.reference))
        )
        of_shapes, of_poles = self._columns(one)
        return {name: complex(c[0] / value) for name, c in (of_shapes | of_poles).items()}

    def unknown(self, common: Mapping[Hashable, complex]) -> float:
        """What an unknown cause may do to a line with such errors, one standard deviation."""
        shapes = [abs(c) for name, c in common.items() if name[0] == "shape"]
        return float(_UNKNOWN * np.sqrt(np.sum(np.square(shapes))))

    def _columns(self, lines: Lines) -> tuple[dict, dict]:
        """Errors of the functions, m/N, each (n,): of shapes and what is beyond the modes; and of
        resonances."""
        square, shapes, poles = lines.omega**2, {}, {}
        one, other = self._moves[lines.response], self._moves[lines.reference]
        given, mode_of = self.poles.dynamic_stiffness(lines.omega), {}
        for i, k in enumerate(self._index):
            if np.isfinite(self.poles.frequencies_hz[i]):
                mode_of[int(k)] = i
        for k in range(self._n_rigid, self._n_modes):
            i = mode_of.get(k)
            stiffness = self._lam[k] - square + 0j if i is None else given[i]
            residue = one[:, k] * other[:, k]
            self._add_shape(shapes, lines, k, i, stiffness)
            if i is None:
                poles["resonance", k] = residue * 2 * self._off * self._lam[k] / stiffness**2
                continue
            own = 2 * np.pi * self.poles.frequencies_hz[i]
            lost = 2j * self.poles.damping[i] * own * lines.omega
            sd = np.nan_to_num(self._log_sd[i])
            poles["resonance", k] = residue * 2 * sd * own**2 / stiffness**2
            poles["damping", k] = residue * self._damping_sd[i] * lost / stiffness**2
        rest = one[:, self._n_modes :] * other[:, self._n_modes :]
        rest = (rest / (self._lam[self._n_modes :] - square[:, None])).sum(axis=1)
        for i, j in set(zip(lines.response.tolist(), lines.reference.tolist(), strict=True)):
            own = (lines.response == i) & (lines.reference == j)
            shapes["beyond", i, j] = np.where(own, _BEYOND * rest, 0.0)
        return shapes, poles

    def _add_shape(self, shapes: dict, lines: Lines, k: int, i: int | None, stiffness) -> None:
        """What is wrong of a mode's shape at either point."""
        error = self._evidence.shape_error
        if i is not None and self._evidence.mesh_shape is not None:
            error = max(error, float(self._evidence.mesh_shape[i]))
        size = error * self._size[k]
        for at, others in ((lines.response, lines.reference), (lines.reference, lines.response)):
            for point in np.unique(at):
                change = np.where(at == point, size * self._moves[others, k], 0.0) / stiffness
                name = "shape", k, int(point)
                shapes[name] = shapes.get(name, 0.0) + change

"""Antiresonances of a structure as functions of its parameters.

Where a force acts and the motion at its own point along it is read, that motion vanishes at the
natural frequencies of the structure held there (Bishop and Johnson, The Mechanics of Vibration,
1960): the antiresonances. Modes alone are a poor basis for these, as a hold bends the structure
about its point; so the basis has, at each sample of the parameters, what a force there bends, too.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.linalg
from petsc4py import PETSc

from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.lean import batched
from fenics_joints.reduction.many import ManyModes, ManyValues, change, own_arrays
from fenics_joints.reduction.reduced import reduce
from fenics_joints.structure import Sensors
from fenics_joints.structure.sparse import combination

#: See `PointBasis`: for antiresonances, which are where little is left of large sums.
_BASIS = 1e-10
#: How far, in ln f, an antiresonance is from the nearest resonance at least: where both fall
#: together neither is seen at the point.
_APART = 2e-3


class PointBasis:
    """A model on its modes and what forces at points bend, at samples. Collective.

    Args:
        full: The full model.
        at: Points and directions of the forces.
        everywhere: Places all over it, by whose motion modes are told.
        samples: Parameter values; the first are the nominal ones. None of beams, which need none.
        n_modes: Modes at each.
        travel: See `reduce`.
        tolerance: Share of the largest energy below which a direction is left out of the basis.

    Attributes:
        model: The model, whose ``sensor_rows`` are those of ``everywhere``.
        rows: What the points read of its basis, (n, n_dofs).
        everywhere: See above.
    """

    def __init__(
        self,
        full,
        at: Sensors,
        everywhere: Sensors,
        samples: Points,
        n_modes: int,
        travel: Mapping | None = None,
        tolerance: float = _BASIS,
    ):
        self.everywhere = everywhere
        self._basis: list[PETSc.Vec] | None = None
        if full.is_dense:
            self.model, self.rows = full.arrays(everywhere), full.loads(at).T
            return
        loads = full.loads(at)
        reduced = reduce(
            full,
            samples,
            n_modes,
            travel=travel,
            tolerance=tolerance,
            more=lambda modes: _beyond(modes, loads, at),
        )
        self._basis = reduced.basis
        self.model = reduced.arrays(sensors=everywhere)
        self.rows = full.observe(self._basis, at)

    def in_full(self, y: np.ndarray):
        """A vector of the basis in the full model's unknowns, as a vector of its kind."""
        return y if self._basis is None else combination(self._basis, y)


def _beyond(modes: Modes, loads: np.ndarray, at: Sensors) -> np.ndarray:
    """This rank's rows of what forces bend besides the modes at hand, of which a free body's rigid
    ones would hide it, (n_local, n_sensors)."""
    own = np.column_stack([shape.array_r for shape in modes.shapes])
    share = modes.at(at).T / (modes.eigenvalues - modes.solver.shift)[:, None]
    return modes.solver.inverse(loads) - own @ share


class Antiresonances:
    """Those of the motion at a point under a force there, some of which a test saw.

    What hangs on the structure and moves by itself (`fenics_joints.structure.changes`) is not in
    this model: an attached resonator leaves antiresonances as they are.

    Args:
        basis: The model.
        index: Which of its points.
        baseline: Parameter values of the nominal model.
        n_modes: Modes that are looked through.
    """

    def __init__(self, basis: PointBasis, index: int, baseline: Mapping[str, float], n_modes: int):
        self.basis = basis
        # Vectors that do not move the point.
        self._held = scipy.linalg.null_space(basis.rows[index][None])
        self._model: ArrayModel = basis.model.on(self._held)
        self._n_modes = min(n_modes, self._model.n_dofs)
        free = solve_modes(basis.model, baseline, n_modes=self._n_modes)
        self.nominal: Modes = solve_modes(self._model, baseline, n_modes=self._n_modes)
        own = np.arange(self.nominal.n_rigid, self._n_modes)
        poles = np.log(free.frequencies_hz[free.n_rigid :])
        zeros = np.log(self.nominal.frequencies_hz[own])
        apart = np.min(np.abs(zeros[:, None] - poles), axis=1)
        seen = (apart > _APART) & (zeros < poles[-1])
        self._own, self.log_f = own[seen], zeros[seen]
        self.forward: Forward | None = None
        self._last: tuple | None = None

    def follow(self, which: np.ndarray) -> None:
        """Which of the nominal ones, by their place in ``log_f``, are asked for from now on."""
        index = self._own[which]
        shapes = self.nominal.at(self.basis.everywhere)[:, index]
        self.forward = Forward(
            self._model, self.basis.everywhere, len(index), self._n_modes, reference=shapes
        )

    def at(self, values: Mapping[str, float | np.ndarray]) -> ManyModes:
        """Those that are asked for, at values (b,)."""
        own = own_arrays(self._model, values)
        key = tuple(each.tobytes() for each in own.values())
        if self._last is None or self._last[0] != key:
            self._last = key, batched(self.forward).many(own, every=False)
        return self._last[1]

    def slopes(
        self, values: ManyValues, low: ManyValues, high: ManyValues, width: float
    ) -> np.ndarray:
        """Derivatives of ln f along directions in the parameters, (b, m, p).

        Args:
            values: Parameter values, each (b,).
            low: See `fenics_joints.reduction.many.change`.
            high: Likewise.
            width: Likewise.
        """
        modes, (low, high) = self.at(values), (own_arrays(self._model, v) for v in (low, high))
        count = len(next(iter(low.values()))) // len(modes.index)
        return modes.slopes(change(modes.model, low, high, width, count))

    def shape(self, i: int, values: Mapping[str, float]):
        """The full model's motion in one that is asked for, of unit modal mass; and its omega^2.

        Raises:
            InputError: If the model has it not at these values.
        """
        modes, pairing = self.forward.solve({name: values[name] for name in self._model.parameters})
        k = int(pairing.index[i])
        moved = self.basis.in_full(self._held @ modes.shapes[:, k])
        return moved, float(modes.eigenvalues[k])

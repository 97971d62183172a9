"""Modes of a structure that a test saw, and which modes of two models are the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fenics_joints._compat import geometry_dofmap
from fenics_joints.measurements.gap import FAINT, Pairing, pair_modes, same_modes
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.basis import SmallModel
from fenics_joints.reduction.prediction import SPARE, ModalPrediction
from fenics_joints.structure.points import Sensors


class MatchedModes:
    """Base of every `fenics_joints.reduction.basis.SmallModel` of a test's modes.

    Args:
        full: The full model.
        start: Values at which order and visibility decide which modes are the test's.
        sensors: The test's sensors; None takes elastic modes in order.
        n_test: Number of modes that the test saw.
        n_modes: Number of modes of the full model among which the test's are sought.
        shapes: Measured shapes at the sensors, (n_sensors, n_test), that modes are matched to by
            MAC; by default the shapes at ``start``.

    Attributes:
        forward: Frequencies and derivatives from the small model.
        nominal: Modes of the full model at ``start``.
        pairing: Which of them the test saw.
        reference: Shapes that modes are matched to.
        crossings: Pairs of test modes that were found to change order.
        n_samples: Number of samples that the small model was made from.
    """

    #: Motions that a test may miss, for messages.
    unseen = "torsion, in-plane motion"
    #: What `errors` does, for progress.
    checking = "checking the reduced model against the full one"
    #: Tolerance of a solution of the full model.
    tolerance: float | None = None

    forward: ModalPrediction
    n_samples = 0

    def __init__(
        self,
        full,
        start: Mapping[str, float],
        *,
        sensors: Sensors | None,
        n_test: int,
        n_modes: int,
        shapes: np.ndarray | None = None,
    ):
        self.full, self.sensors, self.n_test, self.n_modes = full, sensors, n_test, n_modes
        self._solver = None
        self.nominal = self.modes("nominal", start)
        self.pairing = pair_modes(self.nominal, n_test, sensors, reference=shapes)
        self.reference = self.pairing.shapes if shapes is None else shapes
        self.crossings: set[tuple[int, int]] = set(self.pairing.crossing)
        self._solver = self.nominal.solver
        self._solved: dict[tuple, Modes] = {}

    def modes(self, name: str, values: Mapping[str, float]) -> Modes:
        """Modes of the full model that every test of it needs. Collective.

        Args:
            name: Name of the file in which they may be kept.
            values: Parameter values.
        """
        return solve_modes(self.full, values, n_modes=self.n_modes, solver=self._solver)

    @property
    def model(self) -> ArrayModel:
        """The small model."""
        return self.forward.model

    @property
    def quick(self) -> SmallModel:
        """The same model with a check that takes less time, if there is one."""
        return self

    def is_solved(self, values: Mapping[str, float]) -> bool:
        """Whether `solve` remembers the modes there."""
        return tuple(values.items()) in self._solved

    def solve(self, values: Mapping[str, float]) -> Modes:
        """Modes of the full model; remembered until they are in the basis. Collective."""
        key = tuple(values.items())
        if key not in self._solved:
            found = solve_modes(
                self.full,
                values,
                n_modes=self.n_modes,
                solver=self._solver,
                tolerance=self.tolerance,
            )
            self._solver, self._solved[key] = found.solver, found
        return self._solved[key]

    def log_f(self, values: Mapping[str, float]) -> np.ndarray:
        """ln f of the test's modes of the full model, (n_test,). Collective.

        Raises:
            InputError: If they are not all there.
        """
        modes, pairing = self._paired(values)
        return np.log(modes.frequencies_hz[pairing.index])

    def _paired(
        self, values: Mapping[str, float], solve: Callable[..., Modes] | None = None
    ) -> tuple[Modes, Pairing]:
        """Modes of the full model, and which are the test's; records those that change order."""
        modes = (solve or self.solve)(values)
        pairing = self.forward.paired(modes)
        self.crossings.update(pairing.crossing)
        return modes, pairing

    def crossing_names(self, mode_names: Sequence[str]) -> list[str]:
        """Pairs of test modes that were found to change order, in words."""
        return [f"{mode_names[i]} and {mode_names[j]}" for i, j in sorted(self.crossings)]

    def untell(self, lost: np.ndarray) -> None:
        """Ignore the shapes of some of the test's modes, mask (n_test,), from now on, so that they
        take no mode from the others."""
        self.reference = np.where(lost, np.nan, self.reference)
        self.forward.reference = self.reference
        self.forward.forget()

    def _seen(self, modes: Modes) -> np.ndarray:
        """Elastic modes that enter the basis, by index."""
        index = np.arange(modes.n_rigid, len(modes))
        if self.sensors is None:
            return index
        return index[modes.visibility(self.sensors)[index] > FAINT][: self.n_test + SPARE]

    def _forward(self, model: ArrayModel) -> ModalPrediction:
        """Prediction by a reduced model, whose basis with sensors holds visible modes and six
        rigid-body modes."""
        enough = self.n_modes if self.sensors is None else 6 + 3 * self.n_test + SPARE
        return ModalPrediction(model, self.sensors, self.n_test, enough, self.reference)


def places_all_over(full, count: int) -> Sensors:
    """Points spread over a structure, each in all directions. Collective.

    They are middles and corners of cells, each the farthest from those before it; of parts by
    matrices nodes. Middles alone would miss the torsion of a strip.

    Args:
        full: A structure with a mesh, or of parts by matrices.
        count: Number of points.
    """
    if hasattr(full, "mesh"):
        msh = full.mesh
        owned = msh.topology.index_map(msh.topology.dim).size_local
        cells = msh.geometry.x[geometry_dofmap(msh)[:owned]]
        own = np.concatenate([cells.mean(axis=1), cells.reshape(-1, 3)])
        there = np.concatenate(msh.comm.allgather(own))[:, : full.gdim]
    else:
        there = full.nodes
    there = there[np.unique(np.round(there, 9), axis=0, return_index=True)[1]]
    there = there[np.lexsort(np.round(there, 9).T)]
    chosen = [0]
    away = np.linalg.norm(there - there[0], axis=1)
    while len(chosen) < min(count, len(there)):
        chosen.append(int(np.argmax(np.round(away, 9))))
        away = np.minimum(away, np.linalg.norm(there - there[chosen[-1]], axis=1))
    points = np.repeat(there[chosen], full.gdim, axis=0)
    return Sensors(points, np.tile(np.eye(full.gdim), (len(chosen), 1)))


#: Number of points at which shapes are compared: chosen.
PLACES = 60
#: MAC below which two modes are different: chosen.
_SAME = 0.7
#: Difference of ln f within which modes of two models may be mixtures of one another: chosen.
TURNED = 0.01


class ModeMatch(NamedTuple):
    """The best match in another model of each of m modes.

    Attributes:
        index: Index of the match, (m,).
        same: Whether it is the same mode, which the other model may lack, (m,).
    """

    index: np.ndarray
    same: np.ndarray


def match_modes(modes: Modes, own: np.ndarray, other: Modes, places: Sensors) -> ModeMatch:
    """Match modes of one model to those of another. Collective.

    They are compared all over the body: at a test's sensors two modes may look alike, and by order
    a mode that one model lacks would shift all above it. Close modes are compared by their span.

    Args:
        modes: Modes of the one model.
        own: Modes wanted, by index, (m,); at most as many as the other model has elastic ones.
        other: Modes of the other.
        places: Where shapes are compared; see `fenics_joints.reduction.matched.places_all_over`.
    """
    shapes, there = modes.at(places)[:, own], other.at(places)
    index = same_modes(other, places, shapes, modes.frequencies_hz[own])
    hz, share = other.frequencies_hz, np.empty(len(index))
    for i, j in enumerate(index):
        near = np.abs(np.log(hz[other.n_rigid :] / hz[j])) < TURNED
        span = np.linalg.qr(there[:, other.n_rigid :][:, near])[0]
        share[i] = np.sum((span.T @ shapes[:, i]) ** 2) / np.sum(shapes[:, i] ** 2)
    return ModeMatch(index, share > _SAME)

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
    """What every `fenics_joints.reduction.basis.SmallModel` of a test's modes has.

    Args:
        full: The full model.
        start: Values whose modes say, by order and visibility, which the test's are.
        sensors: What the test saw; None takes elastic modes in order.
        n_test: Number of modes that the test saw.
        n_modes: Number of modes of the full model that are looked through.
        shapes: Measured shapes at the sensors, (n_sensors, n_test), to match modes to by MAC; the
            shapes at ``start`` take their place where there are none.

    Attributes:
        forward: Frequencies and derivatives from the small model.
        nominal: Modes of the full model at ``start``.
        pairing: Which of them the test saw.
        reference: Shapes that modes are matched to.
        crossings: Pairs of test modes whose order the model changes, where it was looked.
        n_samples: Number of samples that it was made from.
    """

    #: Motions that a test may not see.
    unseen = "torsion, in-plane motion"
    #: What `errors` does.
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
        """Modes of the full model that every test of it asks for. Collective.

        Args:
            name: What they are called where they are kept.
            values: Parameter values.
        """
        return solve_modes(self.full, values, n_modes=self.n_modes, solver=self._solver)

    @property
    def model(self) -> ArrayModel:
        """The small model."""
        return self.forward.model

    @property
    def quick(self) -> SmallModel:
        """A check that takes less time, where there is one."""
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
        """Modes of the full model and which the test's are; those that cross are noted."""
        modes = (solve or self.solve)(values)
        pairing = self.forward.paired(modes)
        self.crossings.update(pairing.crossing)
        return modes, pairing

    def crossing_names(self, mode_names: Sequence[str]) -> list[str]:
        """Pairs of test modes that were seen to change places, in words; MAC followed them."""
        return [f"{mode_names[i]} and {mode_names[j]}" for i, j in sorted(self.crossings)]

    def untell(self, lost: np.ndarray) -> None:
        """Leave some of the test's modes, mask (n_test,), unmatched from now on: no shape of theirs
        then takes a mode from the others."""
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
        """Of a model on a basis, which with sensors holds what they see alone, besides six
        rigid-body modes."""
        enough = self.n_modes if self.sensors is None else 6 + 3 * self.n_test + SPARE
        return ModalPrediction(model, self.sensors, self.n_test, enough, self.reference)


def places_all_over(full, count: int) -> Sensors:
    """Points all over a structure, middles and corners of cells that are the farthest from each
    other, in all directions: middles alone do not see a strip's torsion. Collective.

    Args:
        full: A structure with a mesh.
        count: Number of points.
    """
    msh = full.mesh
    owned = msh.topology.index_map(msh.topology.dim).size_local
    cells = msh.geometry.x[geometry_dofmap(msh)[:owned]]
    own = np.concatenate([cells.mean(axis=1), cells.reshape(-1, 3)])
    there = np.concatenate(msh.comm.allgather(own))[:, : full.gdim]
    there = there[np.unique(np.round(there, 9), axis=0, return_index=True)[1]]
    there = there[np.lexsort(np.round(there, 9).T)]
    chosen = [0]
    away = np.linalg.norm(there - there[0], axis=1)
    while len(chosen) < min(count, len(there)):
        chosen.append(int(np.argmax(np.round(away, 9))))
        away = np.minimum(away, np.linalg.norm(there - there[chosen[-1]], axis=1))
    points = np.repeat(there[chosen], full.gdim, axis=0)
    return Sensors(points, np.tile(np.eye(full.gdim), (len(chosen), 1)))


#: At how many places shapes are compared.
PLACES = 60
#: MAC below which two modes are not the same one.
_SAME = 0.7
#: Difference of ln f within which modes may turn into one another by any small difference.
TURNED = 0.01


class ModeMatch(NamedTuple):
    """For each of some modes of one model its like in another.

    Attributes:
        index: The like's index, (m,).
        same: Whether it is the same mode: the other model need not have it, (m,).
    """

    index: np.ndarray
    same: np.ndarray


def match_modes(modes: Modes, own: np.ndarray, other: Modes, places: Sensors) -> ModeMatch:
    """Which modes of another model are these. Collective.

    All over the body: to a test's sensors two modes may look alike, and by order a mode that one of
    the models lacks would set all above it beside others. Close modes are the same if what they
    span is.

    Args:
        modes: Modes of the one model.
        own: Which of them, by index, (m,); not more than the other has that are elastic.
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

"""Which modes of two models of one structure are the same, all over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fenics_joints.measurements.gap import same_modes
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.points import Sensors

#: At how many places shapes are compared.
PLACES = 60
#: MAC below which two modes are not the same one.
_SAME = 0.7
#: Difference of ln f within which modes may turn into one another by any small difference.
TURNED = 0.01


class Likes(NamedTuple):
    """For each of some modes of one model its like in another.

    Attributes:
        index: The like's index, (m,).
        same: Whether it is the same mode: the other model need not have it, (m,).
    """

    index: np.ndarray
    same: np.ndarray


def likes(modes: Modes, own: np.ndarray, other: Modes, places: Sensors) -> Likes:
    """Which modes of another model are these. Collective.

    All over the body: to a test's sensors two modes may look alike, and by order a mode that one of
    the models lacks would set all above it beside others. Close modes are the same if what they
    span is.

    Args:
        modes: Modes of the one model.
        own: Which of them, by index, (m,); not more than the other has that are elastic.
        other: Modes of the other.
        places: Where shapes are compared; see `fenics_joints.reduction.seen.places_all_over`.
    """
    shapes, there = modes.at(places)[:, own], other.at(places)
    index = same_modes(other, places, shapes, modes.frequencies_hz[own])
    hz, share = other.frequencies_hz, np.empty(len(index))
    for i, j in enumerate(index):
        near = np.abs(np.log(hz[other.n_rigid :] / hz[j])) < TURNED
        span = np.linalg.qr(there[:, other.n_rigid :][:, near])[0]
        share[i] = np.sum((span.T @ shapes[:, i]) ** 2) / np.sum(shapes[:, i] ** 2)
    return Likes(index, share > _SAME)

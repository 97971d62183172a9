"""The error of a model's own mesh: its modes against those of one degree higher."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.measurements.gap import ALIKE, mac, pair_modes
from fenics_joints.modal.modes import Modes
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress
from fenics_joints.reduction.files import Cache
from fenics_joints.reduction.kept import kept_modes
from fenics_joints.reduction.matched import (
    PLACES,
    TURNED,
    MatchedModes,
    match_modes,
    places_all_over,
)

#: Degrees of freedom of the finer model at most: it is solved once, in some three times the memory
#: of the other (the box, 66,645 and 199,476: 0.9 and 2.9 GB, 4 and 16 s). [numerical: measured on
#: the box]
MOST = 200_000
_TINY = np.finfo(float).tiny


class MeshErrors(NamedTuple):
    """What a mesh does to the test's modes.

    Attributes:
        frequencies: How much too high it makes each frequency, relative, (m,).
        shapes: Length of the part of each shape at the test's sensors that is orthogonal to the
            finer model's, relative to its own, (m,); 0 without sensors.
        change: The finer model's part that is orthogonal to the shape, as large as the measured
            shape, of root mean square 1, has it, (n_sensors, m); None without measured shapes.

    The first two are nan for a mode that the mesh does not resolve: it has no match in the finer
    model, or the finer model takes another one for the test's.
    """

    frequencies: np.ndarray
    shapes: np.ndarray
    change: np.ndarray | None = None


def mesh_errors(
    small: MatchedModes,
    values: Mapping[str, float],
    progress: Progress,
    keep: Cache | None = None,
    ranks: MPI.Intracomm = MPI.COMM_SELF,
) -> MeshErrors | None:
    """What the mesh does to the frequencies and shapes of the test's modes. Collective.

    The same mesh with displacements of one degree more, solved once, is taken for the truth: its
    own error is smaller by more than the order between them (Babuska and Guo, Comput. Mech. 1,
    1986), but for edges where stresses are singular.

    Args:
        small: Knows the full model, its modes at ``values``, and which of them the test saw.
        values: Parameter values of the nominal model.
        progress: Told before the solution.
        keep: Cache of the finer model's modes, for every test of the structure; None to keep
            nothing.
        ranks: Ranks that have the whole structure each, of which one computes.

    Returns:
        The errors; None for a model without a finer one, or one that would be too large.
    """
    if not small.full.is_meshed:
        return None
    finer = small.full.finer()
    if finer is None or finer.n_dofs > MOST:
        return None
    progress.step("discretisation error, by elements one degree higher")

    def found() -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        own = None if keep is None else keep.on(small.full.comm)
        better = kept_modes(finer, values, small.n_modes, own, "finer")
        # The same body has as many rigid motions, whatever round-off makes of their frequencies.
        return _measured(small, replace(better, n_rigid=small.nominal.n_rigid))

    # Round-off may differ on another rank.
    return MeshErrors(*ranks.bcast(small.full.comm.bcast(on_root(ranks, found))))


def _measured(
    small: MatchedModes, better: Modes
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """What `MeshErrors` are made of."""
    modes, sensors = small.nominal, small.sensors
    # The highest of one may have no match among the other's.
    own = small.pairing.visible[: len(better) - better.n_rigid]
    index, same = match_modes(modes, own, better, places_all_over(small.full, PLACES))
    errors = modes.frequencies_hz[own] / better.frequencies_hz[index] - 1.0
    like = dict(zip(own.tolist(), index.tolist(), strict=True))
    known = dict(zip(own[same].tolist(), errors[same].tolist(), strict=True))
    found = np.array([known.get(i, np.nan) for i in small.pairing.index.tolist()])
    found[_told_otherwise(small, better, like)] = np.nan
    if sensors is None:
        return found, 0.0 * found, None
    theirs = [like.get(i, i) for i in small.pairing.index.tolist()]
    seen = modes.at(sensors)[:, small.pairing.index], better.at(sensors)[:, theirs]
    shape = np.sqrt(np.maximum(1.0 - np.diag(mac(*seen)), 0.0))
    change = None if small.pairing.mac is None else _changed(*seen, small.reference)
    return found, np.where(np.isfinite(found), shape, np.nan), change


def _changed(ours: np.ndarray, theirs: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Parts of measured shapes along those of others that are orthogonal to ours, all (n_s, m); see
    `MeshErrors.change`."""
    there = np.isfinite(measured)
    measured = np.where(there, measured, 0.0)
    size = np.sqrt(np.sum(measured**2, axis=0) / np.maximum(there.sum(axis=0), 1))
    measured = measured / np.maximum(size, _TINY)
    theirs, ours = (x / np.maximum(np.linalg.norm(x, axis=0), _TINY) for x in (theirs, ours))
    new = theirs - np.sum(theirs * ours, axis=0) * ours
    return (
        new
        * np.sum(measured * theirs, axis=0)
        / np.maximum(np.sum(there * theirs**2, axis=0), _TINY)
    )


def _told_otherwise(small: MatchedModes, better: Modes, like: Mapping[int, int]) -> np.ndarray:
    """Mask of the test's modes, (m,), for which the finer model has another partner than the one
    that matches their partner here. Without shapes modes are counted, in either model.

    Args:
        small: Knows the test's shapes and their pairing.
        better: Modes of the finer model.
        like: The finer model's mode that matches each of this model's, by index.
    """
    own, sensors = small.pairing, small.sensors
    other, shaped = np.zeros(small.n_test, dtype=bool), own.mac is not None
    try:
        reference = small.reference if shaped else None
        finer = pair_modes(better, small.n_test, sensors, reference=reference)
    except InputError:
        return other  # too few modes that the test could see
    log_f = np.log(np.maximum(better.frequencies_hz, _TINY))
    for i, (mine, theirs) in enumerate(zip(own.index.tolist(), finer.index.tolist(), strict=True)):
        apart = abs(log_f[like[mine]] - log_f[theirs]) if mine in like else np.inf
        unlike = apart > TURNED
        if shaped:
            unlike = finer.mac[i] >= ALIKE and (unlike or own.mac[i] < ALIKE)
        other[i] = unlike
    return other

"""The error of a model's own mesh: its modes against those of one degree higher."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fenics_joints.measurements.gap import VISIBLE, mac, same_modes
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.kept import read_vectors, write_vectors
from fenics_joints.reduction.seen import SeenModes, places_all_over
from fenics_joints.structure import Structure

__all__ = ["MOST", "MeshErrors", "mesh_errors"]

#: Degrees of freedom of the finer model at most: it is solved once, in some three times the memory
#: of the other (the box, 66,645 and 199,476: 0.9 and 2.9 GB, 4 and 16 s).
MOST = 200_000
#: MAC below which two modes are not the same one, and at how many places it is taken.
_SAME, _PLACES = 0.7, 60
#: Difference of ln f within which modes may turn into one another by any small error.
_TURNED = 0.01


class MeshErrors(NamedTuple):
    """What a mesh does to the test's modes.

    Attributes:
        frequencies: How much too high it makes each frequency, relative, (m,).
        shapes: Length of what each shape has at the test's sensors that the finer model's has not,
            relative to its own, (m,); 0 without sensors.

    Both are nan of a mode that has no like in the finer model.
    """

    frequencies: np.ndarray
    shapes: np.ndarray


def mesh_errors(
    small: SeenModes,
    values: Mapping[str, float],
    progress: Progress,
    keep: Callable[[], Path] | None = None,
) -> MeshErrors | None:
    """What the mesh does to the frequencies and shapes of the test's modes. Collective.

    The same mesh with displacements of one degree more, solved once, is taken for the truth: its
    own error is smaller by more than the order between them (Babuska and Guo, Comput. Mech. 1,
    1986), but for edges where stresses are singular.

    Args:
        small: Knows the full model, its modes at ``values``, and which of them the test saw.
        values: Parameter values of the nominal model.
        progress: Told before the solution.
        keep: Gives the file of the finer model's modes, for every test of the structure: read if
            it is there, else written; None to keep nothing.

    Returns:
        The errors; None for a model without a finer one, or one that would be too large.
    """
    if not small.full.is_meshed:
        return None
    errors = _measured(small, values, progress, keep)
    return None if errors is None else MeshErrors(*errors[:, small.pairing.index])


def _measured(small: SeenModes, values, progress: Progress, keep) -> np.ndarray | None:
    """Errors of frequencies and shapes of all modes of the full model, (2, n)."""
    finer = small.full.finer()
    if finer is None or finer.n_dofs > MOST:
        return None
    progress.step("measuring the mesh's own error, one degree higher")
    modes, better = small.nominal, _solved(finer, values, small.n_modes, keep)
    # The same body has as many rigid motions, whatever round-off makes of their frequencies.
    better = replace(better, n_rigid=modes.n_rigid)
    own = np.arange(modes.n_rigid, len(modes))
    if small.sensors is not None:
        own = own[modes.visibility(small.sensors)[own] > VISIBLE]
    # The highest of one may have no like among those of the other.
    own = own[: len(better) - better.n_rigid]
    # All over the body: to the test's sensors two modes may look alike.
    places = places_all_over(small.full, _PLACES, corners=True)
    shapes, hz = modes.at(places)[:, own], modes.frequencies_hz[own]
    index = same_modes(better, places, shapes, hz)
    same = _share_within(shapes, better, places, index) > _SAME
    found, shape = np.full((2, len(modes)), np.nan), 0.0
    if small.sensors is not None:
        at = small.sensors
        agree = np.diag(mac(modes.at(at)[:, own], better.at(at)[:, index]))
        shape = np.sqrt(np.maximum(1.0 - agree, 0.0))
    errors = np.stack([hz / better.frequencies_hz[index] - 1.0, shape + np.zeros(len(own))])
    found[:, own[same]] = errors[:, same]
    return small.full.comm.bcast(found)


def _solved(finer: Structure, values, n_modes: int, keep) -> Modes:
    """Modes of the finer model, from the file or into it."""
    if keep is None:
        return solve_modes(finer, values, n_modes=n_modes)
    file, more = keep(), {}
    shapes = read_vectors(finer, file, "finer", more)
    squares = more.get("eigenvalues")
    if shapes is not None and squares is not None and len(squares) == len(shapes) == n_modes:
        return Modes(finer, dict(values), squares, shapes, 0)
    found = solve_modes(finer, values, n_modes=n_modes)
    write_vectors(finer, file, found.shapes, "finer", eigenvalues=found.eigenvalues)
    return found


def _share_within(shapes: np.ndarray, better: Modes, places, index: np.ndarray) -> np.ndarray:
    """MAC of shapes, (p, m), with what their partners and modes as near as makes them turn span."""
    hz, there = better.frequencies_hz, better.at(places)
    found = np.empty(len(index))
    for i, j in enumerate(index):
        near = np.abs(np.log(hz[better.n_rigid :] / hz[j])) < _TURNED
        span = np.linalg.qr(there[:, better.n_rigid :][:, near])[0]
        found[i] = np.sum((span.T @ shapes[:, i]) ** 2) / np.sum(shapes[:, i] ** 2)
    return found

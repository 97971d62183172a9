"""The reduced model that the branches in a folder are made with.

A branch holds coordinates in a basis. Made anew, the basis spans the same space, but on several
ranks its columns may differ in sign, and those of equal frequencies in direction: a branch can go
on only in the basis that it began in. So the model is kept beside the branches.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.interfaces.reduced import ReducedInterfaceModel
from fenics_joints.modal.modes import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.files import Cache

#: Largest difference, relative to the largest value, of the numbers that the case gives: some of
#: them come from the solution of a contact's preload, which has a tolerance.
_GIVEN = 1e-6
#: The same of numbers that two reductions of one structure give: their bases also hold directions
#: from iterative solutions.
_SOLVED = 1e-4
#: Modes that are compared; chosen.
_MODES = 6


def kept_model(
    model: ReducedInterfaceModel,
    folder: Path,
    band: tuple[float, float],
    comm: MPI.Intracomm,
    progress: Progress | None = None,
) -> ReducedInterfaceModel:
    """The model of a folder of branches if it can be read, else this one, kept there. Collective.

    Args:
        model: The model as it is made now.
        folder: The folder, which exists.
        band: Frequencies, Hz, at which the two are compared.
        comm: Communicator.
        progress: Told why a model that is there cannot be read.

    Raises:
        InputError: If the folder's model is another one, or none can be written.
    """
    cache = Cache(folder, "branches", comm)
    kept = cache.read("model", ReducedInterfaceModel, progress)
    if kept is None:
        cache.write("model", model)
        return model
    if not _same(kept, model, band):
        raise InputError(
            f"{cache.path('model')}: holds another model than the case describes; expected the one "
            "that the branches beside it were made with. Empty the folder, or choose another."
        )
    return kept


def _same(kept: ReducedInterfaceModel, model: ReducedInterfaceModel, band) -> bool:
    def names(m: ReducedInterfaceModel) -> list:
        interfaces = [(p.name, p.law.label, p.normal, len(p)) for p in m.interfaces]
        return [m.n_dofs, sorted(m.forces), sorted(m.sensors), interfaces]

    if names(kept) != names(model):
        return False
    pairs = zip(_traits(kept, band), _traits(model, band), strict=True)
    return all(
        a.shape == b.shape and np.allclose(a, b, rtol=0, atol=tol * np.abs(b).max(initial=0.0))
        for (a, tol), (b, _) in pairs
    )


def _traits(model: ReducedInterfaceModel, band) -> Iterator[tuple[np.ndarray, float]]:
    """What does not depend on the basis, with how well it is known."""
    values = model.values()
    for region in model.pencil.regions:
        for value in region.values(values).values():
            yield np.array(value), _GIVEN
    for p in model.interfaces:
        yield p.weights, _GIVEN
        yield np.asarray(p.points), _GIVEN
        for parameter in p.law.values(len(p)).transpose(2, 0, 1):
            yield parameter, _GIVEN
    modes = solve_modes(model, n_modes=min(_MODES, model.n_dofs))
    elastic = modes.shapes[:, modes.n_rigid :]
    yield modes.eigenvalues[modes.n_rigid :], _SOLVED
    yield np.einsum("ik,ij,jk->k", elastic, model.C, elastic), _SOLVED
    sensors = np.array([model.sensors[name] for name in sorted(model.sensors)])
    forces = np.array([model.forces[name] for name in sorted(model.forces)]).T
    K = model.stiffness_at_rest()
    for omega in 2 * np.pi * np.asarray(band):
        X = np.linalg.solve(K + 1j * omega * model.C - omega**2 * model.M, forces)
        yield sensors @ X, _SOLVED

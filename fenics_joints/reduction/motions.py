"""Motions of what hangs on a structure by springs, beside those of a reduced model's basis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.projection import Projection
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.reduction.terms import RegionTerm
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.changes import PlacedResonator


class MovingModel(ArrayModel):
    """A reduced model with motions of what hangs on it, that any sensors may look at.

    Args:
        reduced: The model without them.
    """

    def __init__(self, reduced: ReducedStructure):
        found = with_motions(reduced.arrays(), reduced.full, reduced.basis)
        super().__init__(found.pencil, found.scale_hz, hung=found.hung)
        self.reduced = reduced

    def observe(self, shapes: np.ndarray, sensors: Sensors) -> np.ndarray:
        """Displacement shapes at sensors, shape (n_sensors, n_shapes)."""
        return self.reduced.observe(shapes[: self.reduced.n_dofs], sensors)

    def points(self, points: np.ndarray) -> np.ndarray:
        """Displacement of the basis at points, shape (n_points, gdim, n_dofs)."""
        found = self.reduced.projection.points(points)
        return np.pad(found, [(0, 0), (0, 0), (0, self.n_dofs - self.reduced.n_dofs)])


def with_motions(model: ArrayModel, full: Structure, basis: Sequence[PETSc.Vec]) -> ArrayModel:
    """A reduced model with a displacement of its own, in each direction, of what hangs on the
    structure at one of its places; the model itself where nothing does. Collective.

    The spring is stretched by what the structure moves at a place less that displacement, in units
    in which its idle stiffness is 1 N/m. Sensors see nothing of it.

    Args:
        model: The model, of plain arrays, without it.
        full: The structure.
        basis: The model's basis, with no force of its own on masses that move.
    """
    hung = [c for c in full.changes if isinstance(c, PlacedResonator)]
    if not hung:
        return model
    n, gdim = model.n_dofs, full.gdim
    wider = _wider(model, gdim)
    unit = 1.0 / np.sqrt(hung[0].values(full.values())["stiffness"])
    terms, on = [], Projection(full, basis)
    for c in hung:
        still = [-unit * np.eye(gdim), *[np.zeros((gdim, gdim))] * gdim]
        a, b = (np.hstack([on.moves(c)[way], still[way]]) for way in c.pair)
        stiff = a.T @ b if c.pair[0] == c.pair[1] else a.T @ b + b.T @ a
        own = np.zeros((n + gdim, n + gdim))
        own[n:, n:] = unit**2 * c.volume * np.eye(gdim)
        terms.append(RegionTerm(c.name, c.law, c.properties, stiff[None], own, c.volume))
    pencil = replace(wider.pencil, regions=[*wider.regions, *terms])
    name = hung[0].properties["mass"]
    return replace(wider, pencil=pencil, hung=(name, unit * np.eye(gdim, n + gdim, n)))


def _wider(model: ArrayModel, more: int) -> ArrayModel:
    """A model with so many further displacements, which nothing holds or moves yet."""

    def rows(a: np.ndarray) -> np.ndarray:
        return np.pad(a, [*[(0, 0)] * (a.ndim - 1), (0, more)])

    def both(a: np.ndarray) -> np.ndarray:
        return np.pad(a, [*[(0, 0)] * (a.ndim - 2), *[(0, more)] * 2])

    pencil, sensors, shifts = model.pencil, model.sensor_rows, model.shift_rows
    return replace(
        model,
        pencil=replace(
            pencil,
            regions=[
                replace(r, stiffness=both(r.stiffness), inertia=both(r.inertia))
                for r in pencil.regions
            ],
            springs=[replace(s, row=rows(s.row)) for s in pencil.springs],
            masses=[replace(m, rows=rows(m.rows)) for m in pencil.masses],
            fixed=pencil.fixed and tuple(map(both, pencil.fixed)),
        ),
        sensor_rows=None if sensors is None else rows(sensors),
        shift_rows=None if shifts is None else rows(shifts),
        places=model.places and model.places.on(np.eye(model.n_dofs, model.n_dofs + more)),
        dampers={name: both(D) for name, D in model.dampers.items()},
    )

"""Full finite-element models with nonlinear layers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interfaces.assembly import as_vectors
from fenics_joints.interfaces.layer_points import LayerPoints, layer_points
from fenics_joints.interfaces.layers import layer_numbers, layer_stretch, linear_moduli
from fenics_joints.interfaces.rigid import FreeMotions, unresisted
from fenics_joints.interfaces.sparse import FullModel, SparsePoints, point_blocks
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.modal.iterative import structure_motions
from fenics_joints.structure.loads import Places, place_loads
from fenics_joints.structure.sparse import absolute, product
from fenics_joints.structure.structure import Structure

#: Share of a layer's shear stiffness that stays beside its law.
_LEFT = 1e-6
_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


def full_layers(
    structure: Structure,
    laws: Mapping[str, JointLaw],
    *,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
    points_degree: int | None = None,
) -> FullModel:
    """A structure whose thin layers follow nonlinear laws, not reduced. Collective.

    Arguments as `interfaces.reduce_layers`, which makes the reduced model of
    the same equations. A millionth of the layer's shear stiffness stays, which holds the nodes
    within the layer: its points do not feel them.

    Raises:
        InputError: As there.
    """
    numbers = layer_numbers(structure, laws)
    values = structure.values(given)
    K, M = structure.stiffness(given), structure.mass(given)
    interfaces = []
    for name, number in numbers.items():
        q, law = structure.field.region_values(number, values), laws[name]
        K.axpy(-1.0, _shear_stiffness(structure, number, q), structure=_SUBSET)
        found = layer_points(structure, number, points_degree)
        points = _points(name, law, found, layer_stretch(q))
        if law.coupled:
            _take_normal(K, points, linear_moduli(structure, number, q)[0])
        interfaces.append(points)
    placed = [
        dict(zip(found, as_vectors(K, loads), strict=True))
        for found, loads in (
            place_loads(structure, "forces", forces),
            place_loads(structure, "sensors", sensors),
        )
    ]
    free = _free_motions(structure, K, M, interfaces)
    return FullModel(M, K, tuple(interfaces), None, *placed, free)


def _shear_stiffness(structure: Structure, number: int, q: Mapping[str, float]) -> PETSc.Mat:
    """Stiffness of a layer's shear, but for the share that stays."""
    law, share = structure.regions[number].law.name, 1 - _LEFT
    if law == "springs":
        only = {"k_n": 0.0, "k_t": share * q["k_t"]}
    else:
        G = share * q["G"]
        # Of a constrained layer the normal modulus is lambda + 2 G, zero for E = 4 G.
        only = {"E": 4 * G if law == "constrained" else 0.0, "G": G}
    K, _ = structure.region_matrices(number, {**q, **only})
    return K


def _take_normal(K: PETSc.Mat, points: SparsePoints, modulus: float) -> None:
    """Take the normal stress at the points out of K.

    What the points do not see, strain that varies through the thickness, stays elastic: without it
    the nodes within the layer would be free, and shape themselves so that there is no shear.
    """
    normal = np.zeros((points.n_components,) * 2)
    normal[0, 0] = modulus
    block = point_blocks(points, points.weights[:, None, None] * normal)
    taken = block.ptap(points.rows)
    K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    K.axpy(-1.0, taken, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    taken.destroy(), block.destroy()


def _free_motions(structure: Structure, K, M, interfaces: Sequence[SparsePoints]) -> FreeMotions:
    """Motions of the whole that cost no energy and strain no interface. Collective."""
    comm, rigid = structure.comm, structure_motions(structure)

    def dots(left, right) -> np.ndarray:
        return comm.allreduce(left.T @ right)

    def positive(A: PETSc.Mat) -> np.ndarray:
        magnitudes = absolute(A)
        found = product(magnitudes, np.abs(rigid))
        magnitudes.destroy()
        return found

    terms = [(dots(rigid, product(K, rigid)), dots(np.abs(rigid), positive(K)).diagonal())]
    for points in interfaces:
        root = np.sqrt(np.repeat(points.weights, points.n_components))[:, None]
        strain, most = (root * f for f in (product(points.rows, rigid), positive(points.rows)))
        terms.append((dots(strain, strain), dots(most, most).diagonal()))
    free = unresisted(rigid, terms, comm)
    inertia = product(M, free)
    factor = np.linalg.inv(np.linalg.cholesky(dots(free, inertia))).T
    return FreeMotions(free @ factor, inertia @ factor, comm)


def _points(name: str, law: JointLaw, found: LayerPoints, stretch: float) -> SparsePoints:
    """This rank's points of a layer, without the rows that the law does not ask for."""
    rows = found.rows(stretch)
    gdim = found.points.shape[1]
    first, last = (i // gdim for i in rows.getOwnershipRange())
    mine = np.argsort(found.order)[first:last]
    if law.n_points is not None:
        raise InputError(f"{law.label}: expected the same parameters at all points of a layer.")
    if not law.coupled:
        kept = np.arange(first * gdim, last * gdim, dtype=PETSc.IntType)
        index = PETSc.IS().createGeneral(kept[kept % gdim > 0], comm=rows.comm)
        rows = rows.createSubMatrix(index)
    return SparsePoints(
        name,
        law,
        rows,
        found.weights[mine] * stretch,
        law.coupled,
        found.points[mine],
        n_components=gdim - (not law.coupled),
    )

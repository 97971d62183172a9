"""Bases of structures with an interface: modes, attachment modes and constraint modes.

Free-interface: modes of the structure with its interface elastic, and what static stress at the
interface adds to them (MacNeal 1971; Rubin 1975). Fixed-interface: modes with the interface held,
and constraint modes (Hurty 1965; Craig and Bampton 1968). A large interface is reduced to its own
modes (Castanier, Tan and Pierre, AIAA J. 39, 2001). Arrays here are this rank's rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
import scipy.linalg
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interfaces.model import InterfacePoints
from fenics_joints.interfaces.reduced import LayerTerm, ReducedInterfaceModel
from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.structure.sparse import cross, product, project, vectors_like
from fenics_joints.structure.structure import Structure

#: Places by name, and this rank's rows of their loads, (n_local, m).
Placed = tuple[Mapping[str, np.ndarray | None], np.ndarray]


def assemble(
    basis: np.ndarray,
    source: ReducedStructure,
    interfaces: Sequence[InterfacePoints],
    pencil: AffinePencil,
    layers: Mapping[str, LayerTerm],
    given: Mapping[str, float] | None,
    forces: Placed,
    sensors: Placed,
) -> ReducedInterfaceModel:
    """The model on a basis, at the parameters given. Collective.

    Args:
        basis: This rank's rows of the basis, (n_local, n).
        source: The structure in that basis, with its mesh.
        interfaces: Points with their strain rows in the basis.
        pencil: K without the interfaces' stress, and M, on the basis.
        layers: Strains of interfaces that are layers, by name.
        given: Parameters that differ from their nominal value.
        forces: The forces and their loads.
        sensors: The sensors and their rows.
    """
    comm = source.full.comm
    rows = [comm.allreduce(basis.T @ loads).T for _, loads in (forces, sensors)]
    identity = np.eye(basis.shape[1])  # replaced by `at`
    model = ReducedInterfaceModel(
        identity,
        identity,
        tuple(interfaces),
        forces=dict(zip(forces[0], rows[0], strict=True)),
        sensors=dict(zip(sensors[0], rows[1], strict=True)),
        pencil=pencil,
        layers=layers,
        given=dict(given or {}),
        scale_hz=source.scale_hz,
        places=sensors[0],
        source=source,
    )
    return model.at({})


def check_uniform(structure: Structure) -> None:
    """Refuse properties that vary in space: K is not affine in them.

    Raises:
        InputError: If there are any.
    """
    for region in structure.regions:
        if any(callable(p) for p in region.properties.values()):
            raise InputError(
                f"{region.name}: its properties vary in space; expected uniform ones in a model "
                "with nonlinear interfaces."
            )


def as_vectors(A: PETSc.Mat, columns: np.ndarray) -> list[PETSc.Vec]:
    """Columns of this rank's rows, (n_local, m), as vectors that a matrix can be applied to."""
    return vectors_like(A.createVecRight(), columns.T)


#: Columns that are solved for at once: chosen, memory against time.
_CHUNK = 64
#: Share of its stiffness that the interface keeps in modes of sliding: chosen; the next one is
#: taken if the structure is not positive definite, as with too few points of integration.
_SLIDING = (0.01, 0.1, 1.0)
#: Share of the largest energy below which a direction of a basis is dependent on the others.
_DEPENDENT = 1e-9


class Strains(Protocol):
    """Strains at the points of all interfaces, as one list of components.

    Each is weighted by the root of its point's area or volume.

    Attributes:
        size: Number of components, q.
    """

    size: int

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Those of this rank's rows of displacements, (q, m), equal on all ranks. Collective."""

    def stresses(self) -> np.ndarray:
        """Their work conjugates: loads of unit stress in each, (n_local, q). Collective."""

    def tangent(self) -> np.ndarray:
        """The interface's stiffness that is in K, stress by strain, (q, q)."""


class Basis:
    """Columns of a reduction basis of (K, M).

    Args:
        K: Stiffness with the interface elastic.
        M: Mass.
        shift: s of the shifted stiffness K + s M that static solutions use, (rad/s)^2.
        modes: M-orthonormal modes, (n_local, k).
        more: Further columns, (n_local, m).

    Attributes:
        columns: The basis of their span in which K and M are diagonal, (n_local, n), modes first.
            Its vectors have unit mass up to the highest of the k modes; beyond, where some have
            hardly any mass, unit stiffness times that mode's eigenvalue.
        more: The further columns as given.
    """

    def __init__(self, K: PETSc.Mat, M: PETSc.Mat, shift: float, modes, more):
        self._comm, self.more = K.comm.tompi4py(), more
        more = more / _length(np.sqrt(self._energy(K, M, shift, more)))
        for _ in range(2):
            more = more - modes @ cross(M, modes, more)
        norms = _length(np.sqrt(self._energy(K, M, shift, more)))
        # What is left of a column in the span of the modes is round-off.
        more = (more / norms)[:, norms > np.sqrt(_DEPENDENT)]
        gram = project(K, more) + shift * project(M, more)
        values, vectors = np.linalg.eigh(gram) if len(gram) else (np.ones(0), gram)
        keep = values > _DEPENDENT * values.max(initial=0.0)
        more = more @ (vectors[:, keep] / np.sqrt(values[keep]))
        self.columns = self._diagonal(K, M, shift, np.hstack([modes, more]), modes.shape[1])

    def _energy(self, K, M, shift, X) -> np.ndarray:
        return self._comm.allreduce(np.sum(X * (product(K, X) + shift * product(M, X)), axis=0))

    def _diagonal(self, K, M, shift, X, n_modes: int) -> np.ndarray:
        heavy = project(M, X)
        theta, Y = scipy.linalg.eigh(heavy, project(K, X) + shift * heavy)
        theta, Y = theta[::-1], Y[:, ::-1]
        return X @ (Y / np.sqrt(np.maximum(theta, theta[n_modes - 1])))


def _length(norms: np.ndarray) -> np.ndarray:
    return np.where(norms > 0, norms, 1.0)


def solve(solver: EigenSolver, loads: np.ndarray) -> np.ndarray:
    """Static response (K - shift M)^-1 to columns of loads, some at a time. Collective."""
    starts = range(0, loads.shape[1], _CHUNK)
    return np.hstack([solver.inverse(loads[:, i : i + _CHUNK]) for i in starts] or [loads])


def free_interface(
    K,
    M,
    solver: EigenSolver,
    modes,
    loads,
    strains: Strains,
    choose: Callable | None,
    extra: np.ndarray | None = None,
) -> Basis:
    """Modes of the elastic interface with residual attachment modes. Collective.

    Args:
        K: Stiffness with the interface elastic.
        M: Mass.
        solver: The modes' solver.
        modes: M-orthonormal modes, (n_local, k).
        loads: Loads of which the static response is kept, (n_local, m).
        strains: The interface's strains.
        choose: ``energies -> n``, how many interface modes to keep; energies descend. None for
            no interface modes.
        extra: Further columns, (n_local, k).

    All attachment modes together span the exact static response to any stress at the interface,
    whatever stiffness they were found with (Woodbury). Half of the vectors kept are the lowest
    modes with the interface sliding, the other half a proper orthogonal decomposition of the rest:
    stress patterns of unit norm in the order of the energy of their responses.
    """
    more = [solve(solver, loads)] + ([] if extra is None else [extra])
    if choose is None:
        return Basis(K, M, -solver.shift, modes, np.hstack(more))
    response = solve(solver, strains.stresses())
    for _ in range(2):
        response = response - modes @ cross(M, modes, response)
    flexibility = strains(response)
    energies, patterns = np.linalg.eigh(0.5 * (flexibility + flexibility.T))
    energies, patterns = energies[::-1], patterns[:, ::-1]
    n, real = choose(energies), energies > _DEPENDENT * energies[0]
    root = np.sqrt(energies[real])
    span = response @ (patterns[:, real] / root)
    sliding = _sliding(K, M, -solver.shift, modes, span, strains)
    kept = sliding[:, : (n + 1) // 2]
    rest = root[:, None] * np.eye(len(root))
    rest = rest - kept @ (kept.T @ rest)
    kept = np.hstack([kept, np.linalg.svd(rest)[0]])
    more.append(span @ kept[:, :n])
    return Basis(K, M, -solver.shift, modes, np.hstack(more))


def _sliding(K, M, shift: float, modes, span, strains: Strains) -> np.ndarray:
    """Components of the modes with a sliding interface in a span, as orthonormal coordinates.

    The span is orthonormal in K + shift M and orthogonal to the modes. As many modes of sliding are
    taken as there are modes; those with most energy in the span come first, low ones before high.
    """
    k = modes.shape[1]
    both = np.hstack([modes, span])
    stiff = np.eye(both.shape[1])
    stiff[:k, :k] = project(K, modes) + shift * project(M, modes)
    heavy = project(M, both)
    rows = strains(both)
    own = rows.T @ strains.tangent() @ rows
    for share in _SLIDING:
        soft = stiff - (1 - share) * own
        if np.linalg.eigvalsh(soft)[0] > 0:
            break
    inverse, vectors = scipy.linalg.eigh(heavy, 0.5 * (soft + soft.T))
    # Of unit energy over frequency: the lowest weigh most.
    weighted = (vectors * np.sqrt(np.maximum(inverse, 0.0)))[k:, ::-1][:, :k]
    return np.linalg.svd(weighted, full_matrices=False)[0]


def fixed_interface(
    K, M, solver: EigenSolver, modes, loads, interface: np.ndarray, choose: Callable
) -> Basis:
    """Modes of the held interface with constraint modes. Collective.

    Args:
        K: Stiffness with the interface elastic. Constraint modes do not depend on its stiffness,
            but their order does.
        M: Mass.
        solver: The solver of the modes with the interface held.
        modes: Those modes, (n_local, k).
        loads: Loads of which the static response is kept, (n_local, m).
        interface: Local row of each interface coordinate, (q,), -1 on all ranks but its own.
        choose: ``(stiffness, mass) -> (q, n)``, combinations of the constraint modes to keep.
    """
    shift, rows = -solver.shift, np.flatnonzero(interface >= 0)
    unit = np.zeros((modes.shape[0], len(interface)))
    unit[interface[rows], rows] = 1.0
    held = loads.copy()
    held[interface[rows]] = 0.0
    pull = -(product(K, unit) + shift * product(M, unit))
    pull[interface[rows]] = 0.0
    constraint = unit + solve(solver, pull)
    stiff, heavy = project(K, constraint), project(M, constraint)
    combine = choose(stiff + shift * heavy, heavy)
    more = np.hstack([constraint @ combine, solve(solver, held)])
    return Basis(K, M, shift, modes, more)


def energy_share(n: int | None, tolerance: float | None, default: int, size: int) -> Callable:
    """How many interface modes to keep: a number, or all above a share of the largest energy.

    Raises:
        InputError: If the number or the share is out of range.
    """
    _check_count(n, size)
    if tolerance is not None and not 0.0 <= tolerance < 1.0:
        raise InputError(f"tolerance = {tolerance}: expected a number from 0 to 1.")

    def choose(energies: np.ndarray) -> int:
        if n is None and tolerance is not None:
            return int(np.sum(energies > tolerance * energies[0]))
        return min(default, size) if n is None else n

    return choose


def characteristic(n: int | None, size: int) -> Callable:
    """Constraint modes to keep: all, or the n lowest eigenmodes of the elastic interface.

    Raises:
        InputError: If the number is out of range.
    """
    _check_count(n, size)

    def choose(stiffness: np.ndarray, mass: np.ndarray) -> np.ndarray:
        if n is None:
            return np.eye(size)
        vectors = scipy.linalg.eigh(mass, stiffness, subset_by_index=[size - n, size - 1])[1]
        return vectors[:, ::-1]

    return choose


def _check_count(n: int | None, size: int) -> None:
    if n is not None and not 1 <= n <= size:
        raise InputError(
            f"interface_modes = {n}: expected 1 to {size}, the interface's components."
        )

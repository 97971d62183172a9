"""The equation of motion M a + C v + K u + f(u, history) = load, as all models share it.

PETSc's integrators and nonlinear solvers ask for nothing else, so that a law goes one way to
statics and to time integration: that of a layer or of a contact, in a reduced model or a full one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any, ClassVar

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.joint_laws import JointLaw, LawKernel

#: Energy, over that of the same terms without their signs, below which round-off is all there is.
_ROUND_OFF = 100 * float(np.finfo(float).eps)
#: Strain of a motion, over the largest of any, below which it counts as zero: chosen.
_STRAINLESS = 1e-6


@dataclass(frozen=True)
class FreeMotions:
    """Rigid motions without resistance.

    Attributes:
        shapes: M-orthonormal, this rank's rows, (n_local, k).
        inertia: M times them, (n_local, k).
        comm: Ranks that share the rows.
    """

    shapes: np.ndarray
    inertia: np.ndarray
    comm: MPI.Comm

    def __len__(self) -> int:
        return self.shapes.shape[1]

    def balance(self, load: PETSc.Vec) -> float:
        """Remove the part of a load that accelerates the structure as a rigid body. Collective.

        Returns:
            The norm of that part over the load's.
        """
        size = load.norm()
        if not len(self) or size == 0.0:
            return 0.0
        work = self.comm.allreduce(self.shapes.T @ load.array_r)
        taken = self.inertia @ work
        load.array[:] -= taken
        return float(np.sqrt(self.comm.allreduce(float(taken @ taken)))) / size

    def take_off(self, u: PETSc.Vec) -> None:
        """Remove the mean displacement and rotation from u. Collective."""
        if len(self):
            u.array[:] -= self.shapes @ self.comm.allreduce(self.inertia.T @ u.array_r)

    def pins(self, start: int) -> np.ndarray:
        """Global rows, one for each motion, that hold the motions if they are held. Collective.

        Args:
            start: Number of this rank's first row.
        """
        rows, pins = self.shapes.copy(), []
        for _ in range(len(self)):
            size = np.einsum("ij,ij->i", rows, rows)
            best = int(np.argmax(size)) if len(size) else 0
            sizes = self.comm.allgather(float(size[best]) if len(size) else -1.0)
            rank = int(np.argmax(sizes))
            mine = (rows[best].copy(), best + start) if self.comm.rank == rank else None
            row, number = self.comm.bcast(mine, root=rank)
            pins.append(number)
            row = row / np.linalg.norm(row)
            rows -= np.outer(rows @ row, row)
        return np.array(pins, dtype=PETSc.IntType)


def no_motions(n_local: int, comm: MPI.Comm) -> FreeMotions:
    """No free motions: those of a structure that is held."""
    return FreeMotions(np.zeros((n_local, 0)), np.zeros((n_local, 0)), comm)


def unresisted(candidates: np.ndarray, terms, comm: MPI.Comm) -> np.ndarray:
    """Combinations of a few motions whose energy is round-off. Collective.

    Args:
        candidates: This rank's rows, (n_local, m).
        terms: Of each kind of stiffness: twice the energy of pairs of motions, (m, m), and of each
            motion with all signs positive, (m,).
        comm: Ranks that share the rows.

    Returns:
        Combinations of the candidates, (n_local, k).
    """
    resisted = np.zeros((candidates.shape[1],) * 2)
    for energy, positive in terms:
        size = np.sqrt(np.where(positive > 0, positive, 1.0))
        resisted += energy / np.outer(size, size)
    values, vectors = scipy.linalg.eigh(0.5 * (resisted + resisted.T))
    return candidates @ vectors[:, values < _ROUND_OFF]


def strainless(shapes: np.ndarray, strains: np.ndarray, largest: float) -> np.ndarray:
    """Combinations of M-orthonormal motions that strain no interface, M-orthonormal again.

    A joint that is open, or a spring that is weak, at rest resists nevertheless.

    Args:
        shapes: M-orthonormal motions, (n, m).
        strains: Their strains at all points, (q, m).
        largest: Norm of the strains of the motion of unit mass that has the most.
    """
    if not shapes.shape[1] or not strains.size:
        return shapes
    _, sizes, V = np.linalg.svd(strains, full_matrices=True)
    sizes = np.append(sizes, np.zeros(len(V) - len(sizes)))
    return shapes @ V[sizes <= _STRAINLESS * largest].T


@dataclass(frozen=True, repr=False)
class LawPoints:
    """The points of one interface, their strains as rows, and the law that holds there.

    Each kind says its ``n_components``, the components of strain, d.

    Attributes:
        name: Name of the joint.
        law: The law of stress by strain.
        rows: Strain of each point by the degrees of freedom: the normal strain first, if there is
            one, then one or two tangential ones.
        weights: Area (zero-thickness, m2) or volume (layer, m3) of each point, (P,); 1 for a
            discrete spring, whose stress then is a force.
        normal: Whether the first component is the normal strain.
        points: Positions, m, (P, gdim); None for a discrete one.
    """

    name: str
    law: JointLaw
    rows: Any
    weights: np.ndarray
    normal: bool = False
    points: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.weights)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {self.law.label}, {len(self)} points)"

    @property
    def kernel(self) -> LawKernel:
        """The compiled law."""
        return LawKernel.of(self.law, self.n_components - self.normal, self.normal)


class Motion(ABC):
    """The motion of one model: vectors and matrices are PETSc's, states and strains arrays.

    Args:
        interfaces: The interfaces, this rank's points of them.
        comm: Ranks that share the motion.
    """

    #: PETSc's options that its linear systems ask for.
    options: ClassVar[Mapping[str, object]] = {}

    def __init__(self, interfaces: Sequence[LawPoints], comm: PETSc.Comm):
        self.interfaces, self.comm = interfaces, comm
        self._kernels = [p.kernel for p in interfaces]
        self._values = [p.law.values(len(p)) for p in interfaces]
        self.rated = any(kernel.rated for kernel in self._kernels)

    def rest(self) -> list[np.ndarray]:
        """States of interfaces that never moved, of this rank's points."""
        pairs = zip(self._kernels, self._values, strict=True)
        return [np.zeros((*values.shape[:2], kernel.m)) for kernel, values in pairs]

    def step(
        self,
        u: PETSc.Vec,
        states: Sequence[np.ndarray],
        v: PETSc.Vec | None = None,
        shift_v: float = 0.0,
    ) -> list[tuple]:
        """(strain, stress, new state, tangent) of this rank's points after a step to u.

        Of a law with the rate of strain at the velocity v, none without; its tangent is by u, with
        dv = shift_v du.
        """
        found = []
        for i, (kernel, values) in enumerate(zip(self._kernels, self._values, strict=True)):
            strain = asked = self._strain(i, u).reshape(-1, kernel.d)
            if kernel.rated:
                rate = np.zeros_like(strain) if v is None else self._strain(i, v)
                asked = np.hstack([strain, rate.reshape(strain.shape)])
            stress, new, tangent = kernel.step(asked, states[i], values)
            if kernel.rated:
                tangent = tangent[..., : kernel.d] + shift_v * tangent[..., kernel.d :]
            found.append((strain, stress, new, tangent))
        return found

    @abstractmethod
    def _strain(self, i: int, u: PETSc.Vec) -> np.ndarray:
        """Strains of interface i, (P d,), which the caller may keep."""

    @abstractmethod
    def vector(self) -> PETSc.Vec:
        """A vector of zeros."""

    @abstractmethod
    def matrix(self) -> PETSc.Mat:
        """A matrix for `jacobian`, with room for the interfaces' tangents."""

    @abstractmethod
    def free(self) -> FreeMotions:
        """Rigid motions that nothing resists. Collective."""

    @abstractmethod
    def place(self, kind: str, name: str) -> PETSc.Vec:
        """The row of one of the ``forces`` or ``sensors``."""

    @abstractmethod
    def residual(self, u, v, a, load, states, out: PETSc.Vec) -> None:
        """M a + C v + K u + f(u, v, states) - load into ``out``. Collective."""

    @abstractmethod
    def jacobian(self, u, states, shift_v: float, shift_a: float, out: PETSc.Mat, v=None) -> None:
        """K + d f/d u + shift_v C + shift_a M into ``out``, at the velocity v. Collective."""

    @abstractmethod
    def product(self, name: str, x: PETSc.Vec) -> PETSc.Vec:
        """The model's matrix of this name times a vector; zero without that matrix. Collective."""

    def inertia(self, a: PETSc.Vec) -> PETSc.Vec:
        """Force of the inertia, M a. Collective."""
        return self.product("M", a)

    @abstractmethod
    def elastic_modes(self, K: PETSc.Mat) -> tuple[np.ndarray, Callable[[int], PETSc.Vec]]:
        """Modes of the mass and a stiffness, such as `jacobian`'s, without rigid motions.

        Collective.

        Returns:
            (Eigenvalues, (rad/s)^2, ascending; M-normalised shape of the i-th). A full model has
            only its lowest.

        Raises:
            InputError: If mass or stiffness is not positive (semi-)definite.
        """

    def drag(self, v: PETSc.Vec) -> PETSc.Vec:
        """Force of the viscous damping, C v. Collective."""
        return self.product("C", v)

    @abstractmethod
    def acceleration(self, force: PETSc.Vec, u: PETSc.Vec, states, step: float) -> PETSc.Vec:
        """a with M a = force, as steps of a length, s, from u would find it. Collective."""

    @abstractmethod
    def energy(self, u: PETSc.Vec, v: PETSc.Vec) -> float:
        """Kinetic energy and that of K, J: what interfaces store is not in it. Collective."""

    def total(self, local: float) -> float:
        """Sum over ranks. Collective."""
        return self.comm.tompi4py().allreduce(local)


def named(rows: Mapping[str, Any], kind: str, name: str):
    """One of a model's forces or sensors.

    Raises:
        InputError: If there is none of that name.
    """
    if not isinstance(name, str) or name not in rows:
        raise InputError(f"{kind}: no {name!r}; expected one of: {', '.join(rows) or 'none'}.")
    return rows[name]


def named_points(interfaces: Sequence[LawPoints]) -> str:
    """Interfaces in a few words."""
    return shorten(", ".join(f"{p.name}: {len(p)} points" for p in interfaces), 80) or "linear"

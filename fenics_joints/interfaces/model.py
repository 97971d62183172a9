"""A linear structure with nonlinear interfaces, on few degrees of freedom.

What `harmonic` and `transient` work on: dense matrices of the structure without the stress of its
nonlinear interfaces, and for each interface the rows that make its strains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.joint_laws.kernel import LawKernel
from fenics_joints.joint_laws.law import JointLaw

__all__ = ["InterfaceModel", "InterfacePoints"]


@dataclass(frozen=True)
class InterfacePoints:
    """The points of one interface, their strains as rows, and the law that holds there.

    Attributes:
        name: Name of the joint.
        law: What makes stress of strain.
        rows: Strain of each point by the degrees of freedom, (P, d, n): the normal strain first,
            if there is one, then one or two tangential ones.
        weights: Area (zero-thickness, m2) or volume (layer, m3) of each point, (P,); 1 for a
            discrete spring, whose stress then is a force.
        normal: Whether the first component is the normal strain.
        points: Positions, m, (P, gdim); None for a discrete one.
    """

    name: str
    law: JointLaw
    rows: np.ndarray
    weights: np.ndarray
    normal: bool = False
    points: np.ndarray | None = None

    def __post_init__(self):
        shape = np.shape(self.rows)
        if len(shape) != 3 or shape[1] not in ((2, 3) if self.normal else (1, 2)):
            raise InputError(
                f"{self.name}.rows has shape {shape}: expected (points, components, n_dofs) with "
                f"{'2 or 3' if self.normal else '1 or 2'} components."
            )
        if np.shape(self.weights) != shape[:1]:
            raise InputError(
                f"{self.name}.weights has shape {np.shape(self.weights)}: expected ({shape[0]},)."
            )
        if self.law.coupled and not self.normal:
            raise InputError(
                f"{self.name}: the law {self.law.label} needs the normal strain; expected rows "
                "with it, and normal = True."
            )
        self.law.values(shape[0])

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def kernel(self) -> LawKernel:
        """The compiled law."""
        return LawKernel.of(self.law, self.rows.shape[1] - self.normal, self.normal)

    def tangent(self) -> np.ndarray:
        """Stress by strain at rest, Pa, (P, d, d)."""
        P, d, _ = self.rows.shape
        return self.kernel.step(np.zeros((P, d)), None, self.law.values(P))[2]


@dataclass(frozen=True)
class InterfaceModel:
    """Mass, damping and stiffness, nonlinear interfaces, places of forces and sensors.

    Attributes:
        M: Mass, kg, (n, n).
        K: Stiffness without the interfaces' stress, N/m, (n, n).
        interfaces: The nonlinear interfaces.
        C: Viscous damping, N s/m, (n, n); None for none.
        forces: Load per unit force at the places of forces, by name, (n,).
        sensors: Rows of displacement at sensors, by name, (n,).
    """

    M: np.ndarray
    K: np.ndarray
    interfaces: Sequence[InterfacePoints] = ()
    C: np.ndarray | None = None
    forces: Mapping[str, np.ndarray] = field(default_factory=dict)
    sensors: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self):
        n = len(self.M)
        square = {"M": self.M, "K": self.K} | ({} if self.C is None else {"C": self.C})
        for key, array in square.items():
            if np.shape(array) != (n, n):
                raise InputError(f"{key} has shape {np.shape(array)}: expected {(n, n)}.")
        for what in ("forces", "sensors"):
            for key, array in getattr(self, what).items():
                if np.shape(array) != (n,):
                    shape = np.shape(array)
                    raise InputError(f"{what}[{key!r}] has shape {shape}: expected {(n,)}.")
        for points in self.interfaces:
            if points.rows.shape[2] != n:
                raise InputError(
                    f"{points.name}.rows has {points.rows.shape[2]} columns: expected {n}."
                )
        if self.C is None:
            object.__setattr__(self, "C", np.zeros((n, n)))

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom, n."""
        return len(self.M)

    def with_laws(self, **laws: JointLaw) -> InterfaceModel:
        """The same model with other laws at some interfaces, by the interface's name.

        Raises:
            InputError: For an unknown interface.
        """
        names = [points.name for points in self.interfaces]
        for name in laws:
            if name not in names:
                raise InputError(f"no interface {name!r}; expected one of: {', '.join(names)}.")
        changed = [replace(p, law=laws.get(p.name, p.law)) for p in self.interfaces]
        return replace(self, interfaces=tuple(changed))

    def stiffness_at_rest(self) -> np.ndarray:
        """Stiffness of small vibrations: K and the interfaces' tangents, N/m, (n, n)."""
        K = np.array(self.K, dtype=float)
        for points in self.interfaces:
            weighted = points.weights[:, None, None] * points.tangent()
            K += np.einsum("pin,pij,pjm->nm", points.rows, weighted, points.rows, optimize=True)
        return 0.5 * (K + K.T)

    def row(self, kind: str, name: str) -> np.ndarray:
        """A place of force or a sensor by its name.

        Args:
            kind: ``forces`` or ``sensors``.
            name: Its name.

        Raises:
            InputError: If there is none of that name.
        """
        rows = getattr(self, kind)
        if name not in rows:
            raise InputError(f"{kind}: no {name!r}; expected one of: {', '.join(rows) or 'none'}.")
        return np.asarray(rows[name], dtype=float)

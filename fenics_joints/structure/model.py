"""The contract of models: parameters and K(p), M(p), whatever the model is made of.

Solids, beams, reduced models, plain arrays, preloaded contacts and interfaces at rest fulfil it, so
that modes, their derivatives and FRFs never ask what kind a model is. Matrices are either plain
arrays, whole on every rank, or PETSc's, shared out over the ranks, where calls are collective; a
shape is a column or a PETSc vector accordingly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from fenics_joints.structure.components import Parameter
from fenics_joints.structure.damping import Damping
from fenics_joints.structure.points import Sensors

if TYPE_CHECKING:
    import numpy as np

    from fenics_joints.meshes import Ring


Values = Mapping[str, float] | None


@runtime_checkable
class Model(Protocol):
    """K(p) and M(p): what modes, their derivatives and their pairing with a test need.

    ``given`` are values of parameters that differ from the nominal ones. An unknown name, or a
    value that is not finite or that a law refuses, is an `InputError`.
    """

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """The parameters by name, in the order of all derivatives."""

    @property
    def is_dense(self) -> bool:
        """Whether K, M and shapes are plain arrays, the same on every rank."""

    @property
    def is_meshed(self) -> bool:
        """Whether DOFs are displacements of a mesh's nodes, as the iterative solver needs."""

    @property
    def n_dofs(self) -> int:
        """Size of K and M."""

    def values(self, given: Values = None) -> dict[str, float]:
        """All parameters' values."""

    def stiffness(self, given: Values = None) -> Any:
        """K(p), N/m, symmetric, positive semi-definite; a PETSc matrix is the caller's."""

    def mass(self, given: Values = None) -> Any:
        """M(p), kg, likewise; DOFs without mass are allowed."""

    def dilation_frequency(self, given: Values = None) -> float:
        """About the frequency, Hz, at which the body would grow evenly: a scale for shifts."""

    def total_mass(self, given: Values = None) -> float:
        """Mass, kg."""

    def observe(self, shapes: Any, sensors: Sensors) -> np.ndarray:
        """Shapes at sensors, (n_sensors, n_shapes), the same on every rank."""

    def pencil_gradients(
        self, shapes: Any, eigenvalues: Sequence[float], given: Values = None
    ) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x at fixed x, (n_shapes, n_parameters)."""


@runtime_checkable
class Damped(Model, Protocol):
    """A model with what FRFs, complex modes and derivatives of shapes need."""

    @property
    def layers(self) -> tuple[str, ...]:
        """Parts, joints and elastic supports, which may have damping of their own."""

    @property
    def dampers(self) -> Mapping[str, Any]:
        """Matrices of dashpots by name, which are in neither K nor M."""

    def resolved(self, damping: Damping) -> Damping:
        """A damping that names parts and joints as a user does, by names of `layers`."""

    def region_stiffness(self, name: str, given: Values = None) -> Any:
        """Matrix before a layer's own damping: its share of K, or the matrix of a dashpot."""

    def slopes(
        self, given: Values = None, apart: Sequence[str] = ()
    ) -> Iterator[tuple[int, str, str | None, Any]]:
        """Shares of dK/dp and dM/dp.

        Args:
            given: Values of parameters that differ from their nominal value.
            apart: Layers whose shares of dK/dp have their name.

        Yields:
            Index of the parameter; ``"K"`` or ``"M"``; a name from ``apart``, or None; what blocks
            of columns are multiplied by, with ``@``. Several may belong to one parameter.
        """

    def loads(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """Loads of one newton at points, (n_local, n), which also read the displacement there."""


@runtime_checkable
class Pictured(Model, Protocol):
    """A model that pages can draw."""

    @property
    def size_m(self) -> np.ndarray:
        """Extents along the axes, m."""

    def rings(self) -> tuple[Ring, ...]:
        """The bolts' rings of the mesh."""

    def corner_motion(self, shapes: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
        """Corners of all cells, m, (n_cells, n_corners, 3), and how they move, (n_shapes, ...)."""

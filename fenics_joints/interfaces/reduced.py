"""Reduced models with nonlinear interfaces whose linear parameters live on, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

import fenics_joints.beams.element  # noqa: F401, files may hold them
from fenics_joints.errors import InputError
from fenics_joints.interfaces.model import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.modal.modes import SHIFT_SHARE, rigid_below
from fenics_joints.parallel import on_root
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.files import read_model, register, write_model
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.structure import Parameter, Sensors

_FORMAT = "fenics_joints interface model"


@dataclass(frozen=True)
class LayerTerm:
    """Strains of a nonlinear layer, whose stretch may change.

    Attributes:
        region: Its index in the pencil's regions.
        thin: Strain rows of the gradient across the meshed layer, (P, d, n).
        flat: Those of the gradient in its plane, (P, d, n).
        volumes: Volume as meshed of each point, m3, (P,).
    """

    region: int
    thin: np.ndarray
    flat: np.ndarray
    volumes: np.ndarray

    def rows(self, stretch: float) -> np.ndarray:
        """Strain rows at a stretch, (P, d, n)."""
        return self.thin / stretch + self.flat


@dataclass(frozen=True, repr=False)
class ReducedInterfaceModel(InterfaceModel):
    """An `InterfaceModel` whose linear parameters live on; a `fenics_joints.structure.model.Model`.

    As such it is the model of small vibrations, with the laws' tangents at rest.

    Attributes:
        pencil: K(p) without the interfaces' stress, and M(p).
        layers: Strains of interfaces that are layers, by name.
        given: Parameters that differ from their nominal value.
        scale_hz: The structure's dilation frequency, see `ReducedStructure`.
        places: Position, m, and direction of each sensor, by name, (2, gdim).
        source: The reduced structure with its mesh, to see it anywhere; None if read from a file.
    """

    pencil: AffinePencil | None = None
    layers: Mapping[str, LayerTerm] = field(default_factory=dict)
    given: Mapping[str, float] = field(default_factory=dict)
    scale_hz: float = 0.0
    places: Mapping[str, np.ndarray] = field(default_factory=dict)
    source: ReducedStructure | None = field(default=None, repr=False, compare=False)

    #: See `fenics_joints.structure.model.Model`.
    is_dense, is_meshed = True, False

    # -- parameters ----------------------------------------------------------------------------

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """The linear structure's parameters, by name."""
        return self.pencil.parameters

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """Values of all parameters: nominal, the model's own `given`, then ``given``.

        Raises:
            InputError: For an unknown parameter or a value that is not finite.
        """
        return self.pencil.values({**self.given, **(given or {})})

    def at(self, given: Mapping[str, float]) -> ReducedInterfaceModel:
        """The model at other values of some linear parameters; laws and damping stay.

        Raises:
            InputError: For an unknown parameter, or a value out of range.
        """
        values = self.values(given)
        K, M = self.pencil.assemble(values)
        interfaces = tuple(self._at(points, values) for points in self.interfaces)
        return replace(
            self, K=0.5 * (K + K.T), M=M, interfaces=interfaces, given={**self.given, **given}
        )

    def _at(self, points: InterfacePoints, values) -> InterfacePoints:
        if points.name not in self.layers:
            return points
        layer = self.layers[points.name]
        s = self.pencil.regions[layer.region].values(values).get("stretch", 1.0)
        return replace(points, rows=layer.rows(s), weights=layer.volumes * s)

    def _rigid_below(self) -> float:
        """As the structure's modes have it."""
        return rigid_below(SHIFT_SHARE * self.scale_hz) if self.scale_hz else super()._rigid_below()

    def with_laws(self, **laws: JointLaw) -> ReducedInterfaceModel:
        """See `InterfaceModel.with_laws`; a coupled law cannot take an uncoupled one's place.

        Raises:
            InputError: For an unknown interface, or a law of the other kind.
        """
        for points in self.interfaces:
            if points.name in laws and laws[points.name].coupled != points.normal:
                kind = "coupled" if points.normal else "uncoupled"
                raise InputError(
                    f"{points.name}: the law {laws[points.name].label} differs in whether it takes "
                    f"the normal stress; expected a law that is {kind}, or a new reduction."
                )
        return super().with_laws(**laws)

    # -- the calls of a structure, at rest -----------------------------------------------------

    def stiffness(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Stiffness of small vibrations, N/m, (n, n)."""
        return (self.at(given) if given else self).stiffness_at_rest()

    def mass(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Mass, kg, (n, n)."""
        return self.pencil.assemble(self.values(given))[1] if given else self.M

    def dilation_frequency(self, given: Mapping[str, float] | None = None) -> float:
        """The structure's at its nominal parameters, Hz."""
        return self.scale_hz

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg, as the full structure's."""
        return self.pencil.total_mass(self.values(given))

    def pencil_gradients(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x by the linear parameters, (k, n_parameters).

        K is the stiffness at rest; its laws' tangents do not depend on the parameters, but for a
        layer's stretch.
        """
        values = self.values(given)
        gradient = self.pencil.gradients(shapes, eigenvalues, values)
        for points in self.interfaces:
            layer = self.layers.get(points.name)
            region = None if layer is None else self.pencil.regions[layer.region]
            if region is not None and isinstance(region.properties.get("stretch"), str):
                column = list(self.parameters).index(region.properties["stretch"])
                s = region.values(values)["stretch"]
                gradient[:, column] += _stretching(points, layer, s, shapes)
        return gradient

    def observe(self, shapes: np.ndarray, sensors: Sensors) -> np.ndarray:
        """Displacement shapes at sensors, (n_sensors, n_shapes); of a model read from a file only
        those that it was made with.

        Raises:
            InputError: If the model knows no such sensor and has no mesh to find it on.
        """
        if self.source is not None:
            return self.source.observe(shapes, sensors)
        rows = [self._sensor(p, d) for p, d in zip(sensors.points, sensors.directions, strict=True)]
        return np.array(rows).reshape(len(sensors), self.n_dofs) @ shapes

    def _sensor(self, point, direction) -> np.ndarray:
        for name, (at, along) in self.places.items():
            near = np.allclose(at, point[: len(at)], rtol=0, atol=1e-9)
            if near and np.isclose(abs(along @ direction[: len(at)]), 1.0, rtol=0, atol=1e-9):
                return np.sign(along @ direction[: len(at)]) * self.sensors[name]
        raise InputError(
            f"there is no sensor at {list(point)} along {list(direction)}, and the model has no "
            f"mesh; expected one of: {', '.join(self.places) or 'none'}."
        )

    def write(self, path: str | Path) -> None:
        """Write the model to an HDF5 file, whole or not at all. Collective if it has its mesh.

        Args:
            path: The file; one that exists is replaced.

        Raises:
            InputError: If it cannot be written, or a law has an attribute that no file can hold.
        """
        if self.source is None:
            write_model(self, path, _FORMAT)
        else:
            on_root(self.source.full.comm, lambda: write_model(self, path, _FORMAT))


def _stretching(points: InterfacePoints, layer: LayerTerm, s: float, shapes) -> np.ndarray:
    """Derivative by the stretch of the energy of the tangents, twice, (k,)."""
    tangent = points.tangent()
    strain = layer.rows(s) @ shapes
    change = -(layer.thin @ shapes) / s**2
    stress = np.einsum("pij,pjk->pik", tangent, strain)
    energy = np.einsum("p,pik,pik->k", layer.volumes, strain, stress)
    return energy + 2 * s * np.einsum("p,pik,pik->k", layer.volumes, change, stress)


register(InterfacePoints, LayerTerm, ReducedInterfaceModel)


def read_interface_model(path: str | Path) -> ReducedInterfaceModel:
    """Read a model that `ReducedInterfaceModel.write` wrote. Any rank may do so by itself.

    Args:
        path: The file.

    Raises:
        InputError: As `fenics_joints.reduction.files.read_model`.
    """
    return read_model(path, _FORMAT, ReducedInterfaceModel)

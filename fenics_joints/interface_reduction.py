"""Reduced models of structures whose joints are nonlinear.

`reduce_layers` makes thin layers nonlinear, `reduce_contacts` zero-thickness contacts; both give a
`ReducedInterfaceModel`, which harmonic balance and time integration work on, which takes the calls
of a linear structure for small vibrations, and whose linear parameters can still be changed.

A layer's law takes the place of its linear stress at points on the middle plane, two in each
direction of a box cell. What one point through the thickness does not see (strain that varies
through it, or within a cell by more than the points resolve) keeps the linear layer's stiffness;
otherwise the nodes within the layer would be free. So a law whose tangent at rest is the layer's
gives the linear structure exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import scipy.linalg
from petsc4py import PETSc

from fenics_joints.affine import AffinePencil, slopes
from fenics_joints.components import Parameter
from fenics_joints.eigensolver import product
from fenics_joints.errors import InputError
from fenics_joints.interface_basis import energy_share, free_interface
from fenics_joints.interface_model import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.laws import Law
from fenics_joints.layer_points import LayerPoints, layer_points
from fenics_joints.modal import solve_modes
from fenics_joints.points import Sensors
from fenics_joints.reduction import ReducedStructure
from fenics_joints.structure import Structure

__all__ = [
    "LayerTerm",
    "ReducedInterfaceModel",
    "reduce_layers",
    "with_modal_damping",
    "with_rayleigh_damping",
]

Places = Mapping[str, tuple[Sequence[float], Sequence[float]]]


def layer_moduli(law: Law, q: Mapping[str, float], normal: bool) -> np.ndarray:
    """Moduli, Pa, of a linear layer's normal (if asked for) and shear stress.

    Raises:
        InputError: For the normal stress of a layer where other strains have a part in it.
    """
    if not normal:
        return np.array([q["G"]])
    if law.name == "uncoupled":
        return np.array([q["E"], q["G"]])
    if law.name == "constrained":
        # lambda + 2 mu, the first of its scalars at unit stretch.
        return np.array([law.stiffness_terms({**q, "stretch": 1.0})[0], q["G"]])
    raise InputError(
        f"a coupled law cannot take the place of the normal stress of a layer with the law "
        f"{law.name!r}; expected 'uncoupled' or 'constrained'."
    )


@dataclass(frozen=True)
class LayerTerm:
    """What a nonlinear layer takes out of the linear stiffness.

    Attributes:
        region: Its index in the pencil's regions.
        thin: Strain rows of the gradient across the meshed layer, (P, d, n).
        flat: Those of the gradient in its plane, (P, d, n).
        volumes: Volume as meshed of each point, m3, (P,).
        normal: Whether the normal strain is among the rows.
    """

    region: int
    thin: np.ndarray
    flat: np.ndarray
    volumes: np.ndarray
    normal: bool

    def rows(self, stretch: float) -> np.ndarray:
        """Strain rows at a stretch, (P, d, n)."""
        return self.thin / stretch + self.flat

    def scalars(self, law: Law, q: Mapping[str, float]) -> np.ndarray:
        """Scalars of `stiffness`, for each modulus: c / s, c and c s."""
        s = q["stretch"]
        return np.array([c * f for c in layer_moduli(law, q, self.normal) for f in (1 / s, 1, s)])

    def products(self) -> np.ndarray:
        """Matrices that go with `scalars`, (n_scalars, n, n)."""
        found, normal = [], int(self.normal)
        for part in ([slice(0, 1)] if normal else []) + [slice(normal, None)]:
            thin, flat = self.thin[:, part], self.flat[:, part]
            mixed = self._product(thin, flat)
            found += [self._product(thin, thin), mixed + mixed.T, self._product(flat, flat)]
        return np.array(found)

    def _product(self, left, right) -> np.ndarray:
        n = left.shape[2]
        weighted = self.volumes[:, None, None] * left
        return weighted.reshape(-1, n).T @ right.reshape(-1, n)


@dataclass(frozen=True)
class ReducedInterfaceModel(InterfaceModel):
    """An `InterfaceModel` whose linear parameters live on; takes the calls of a `Structure`.

    As a structure it is the model of small vibrations, with the laws' tangents at rest.

    Attributes:
        pencil: Linear K(p) and M(p), layers included.
        layers: What nonlinear layers take out of it, by the interface's name.
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
        K, M = self._matrices(values)
        interfaces = tuple(self._at(points, values) for points in self.interfaces)
        return replace(self, K=K, M=M, interfaces=interfaces, given={**self.given, **given})

    def _at(self, points: InterfacePoints, values) -> InterfacePoints:
        if points.name not in self.layers:
            return points
        layer = self.layers[points.name]
        s = self.pencil.regions[layer.region].values(values)["stretch"]
        return replace(points, rows=layer.rows(s), weights=layer.volumes * s)

    def _matrices(self, values) -> tuple[np.ndarray, np.ndarray]:
        K, M = self.pencil.matrices(values)
        for layer in self.layers.values():
            region = self.pencil.regions[layer.region]
            scalars = layer.scalars(region.law, region.values(values))
            K = K - np.tensordot(scalars, layer.products(), axes=1)
        return 0.5 * (K + K.T), M

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
        return self.pencil.matrices(self.values(given))[1] if given else self.M

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
        position = {name: i for i, name in enumerate(self.parameters)}
        for points in self.interfaces:
            if points.name not in self.layers:
                continue
            layer = self.layers[points.name]
            region = self.pencil.regions[layer.region]
            q = region.values(values)
            products = layer.products()
            for key, name in region.properties.items():
                if not isinstance(name, str):
                    continue
                change = slopes(lambda q, r=region, y=layer: y.scalars(r.law, q), q, key)
                taken = np.tensordot(change, products, axes=1)
                gradient[:, position[name]] -= np.sum(shapes * (taken @ shapes), axis=0)
                if key == "stretch":
                    gradient[:, position[name]] += _stretching(points, layer, q[key], shapes)
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
        """Write the model to an HDF5 file, see `fenics_joints.interface_files`."""
        from fenics_joints.interface_files import write_interface_model

        write_interface_model(self, path)


def _stretching(points: InterfacePoints, layer: LayerTerm, s: float, shapes) -> np.ndarray:
    """Derivative by the stretch of the energy of the tangents, twice, (k,)."""
    tangent = points.tangent()
    strain = layer.rows(s) @ shapes
    change = -(layer.thin @ shapes) / s**2
    stress = np.einsum("pij,pjk->pik", tangent, strain)
    energy = np.einsum("p,pik,pik->k", layer.volumes, strain, stress)
    return energy + 2 * s * np.einsum("p,pik,pik->k", layer.volumes, change, stress)


def reduce_layers(
    structure: Structure,
    laws: Mapping[str, JointLaw],
    *,
    n_modes: int = 20,
    interface_modes: int | None = None,
    tolerance: float = 1e-4,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
    points_degree: int | None = None,
) -> ReducedInterfaceModel:
    """Reduced model of a structure whose thin layers follow nonlinear laws. Collective.

    The basis is of free interfaces: the modes of the structure with its layers as linear as they
    are in it (so give them the laws' stiffness at rest), what is missing of the static response to
    loads at ``forces`` and ``sensors``, and interface modes, see
    `fenics_joints.interface_basis.free_interface`. A fixed-interface basis has no place here: an
    elastic layer has no state in which its strains are held.

    Args:
        structure: The structure; every region's properties uniform.
        laws: Law of each layer that becomes nonlinear, by its region's name. A law that is not
            `coupled` takes the shear stress, a coupled one the normal stress too.
        n_modes: Modes of the linear structure, rigid-body modes included.
        interface_modes: Number of interface modes; by default as many as have this share of energy:
        tolerance: Smallest energy of an interface mode, relative to the largest.
        forces: Position, m, and direction of each force, by name.
        sensors: Those of each sensor.
        given: Parameters that differ from their nominal value; the basis is best there.
        points_degree: See `fenics_joints.layer_points.layer_points`.

    Raises:
        InputError: For an unknown layer, graded properties, a place outside the mesh, or a number
            out of range.
    """
    numbers = _layer_numbers(structure, laws)
    found = {n: layer_points(structure, i, points_degree) for n, i in numbers.items()}
    values = structure.values(given)
    stretch = {n: structure.field.region_values(i, values)["stretch"] for n, i in numbers.items()}
    forces, force_loads = _places(structure, "forces", forces)
    sensors, sensor_loads = _places(structure, "sensors", sensors)
    modes = solve_modes(structure, given, n_modes=n_modes)
    M, K = structure.mass(given), structure.stiffness(given)
    strains = _LayerStrains(found, stretch, {n: law.coupled for n, law in laws.items()})
    basis = free_interface(
        K, M, modes.solver,
        np.column_stack([x.array_r for x in modes.shapes]),
        np.hstack([force_loads, sensor_loads]),
        strains.stresses(), strains,
        energy_share(interface_modes, tolerance, strains.size),
    )  # fmt: skip
    reduced = ReducedStructure(structure, _vectors(K, basis.columns))
    layers = {}
    for name, number in numbers.items():
        p, first = found[name], 0 if laws[name].coupled else 1
        thin, flat = (p.gather(product(B, basis.columns))[:, first:] for B in (p.thin, p.flat))
        layers[name] = LayerTerm(number, thin, flat, p.weights, laws[name].coupled)
    interfaces = [
        InterfacePoints(
            name, laws[name], layer.rows(stretch[name]), layer.volumes * stretch[name],
            layer.normal, found[name].points,
        )
        for name, layer in layers.items()
    ]  # fmt: skip
    model = _assemble(structure, basis.columns, reduced, interfaces, reduced.affine, layers, given,
                      (forces, force_loads), (sensors, sensor_loads))  # fmt: skip
    modes.solver.destroy()
    for A in (K, M, *(B for p in found.values() for B in (p.thin, p.flat))):
        A.destroy()
    return model


def _assemble(structure, columns, source, interfaces, pencil, layers, given, forces, sensors):
    comm = structure.comm
    rows = [comm.allreduce(columns.T @ loads).T for _, loads in (forces, sensors)]
    n = columns.shape[1]
    model = ReducedInterfaceModel(
        np.eye(n), np.eye(n), tuple(interfaces),
        forces=dict(zip(forces[0], rows[0], strict=True)),
        sensors=dict(zip(sensors[0], rows[1], strict=True)),
        pencil=pencil, layers=layers, given=dict(given or {}), scale_hz=source.scale_hz,
        places=sensors[0], source=source,
    )  # fmt: skip
    return model.at({})


def _layer_numbers(structure: Structure, laws: Mapping[str, JointLaw]) -> dict[str, int]:
    names = {r.name: i for i, r in enumerate(structure.regions) if r.is_joint}
    if not laws:
        raise InputError(f"laws: expected a law for one of the layers {', '.join(names)}.")
    for name, law in laws.items():
        if name not in names:
            raise InputError(
                f"laws: {name!r} is no thin layer; expected: {', '.join(names) or 'none'}."
            )
        if law.coupled and structure.regions[names[name]].law.name == "isotropic":
            layer_moduli(structure.regions[names[name]].law, {}, True)
    for region in structure.regions:
        if any(callable(p) for p in region.properties.values()):
            raise InputError(
                f"{region.name}: its properties vary in space; expected uniform ones in a model "
                "with nonlinear interfaces."
            )
    return {name: names[name] for name in laws}


class _LayerStrains:
    """Strains of all layers as one list of components, weighted by the root of their volume."""

    def __init__(self, found: Mapping[str, LayerPoints], stretch, normal):
        self.parts = []
        for name, p in found.items():
            s = stretch[name]
            B = p.thin.copy()
            B.scale(1 / s)
            B.axpy(1.0, p.flat, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            self.parts.append((p, B, np.sqrt(p.weights * s), 0 if normal[name] else 1))
        self.size = sum(r.size * (B.getSize()[0] // len(r) - first)
                        for _, B, r, first in self.parts)  # fmt: skip

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        rows = []
        for p, B, root, first in self.parts:
            strain = root[:, None, None] * p.gather(product(B, columns))[:, first:]
            rows.append(strain.reshape(-1, columns.shape[1]))
        return np.concatenate(rows)

    def stresses(self) -> np.ndarray:
        """Loads of unit stress in every component, (n_local, size)."""
        loads = []
        for p, B, root, first in self.parts:
            gdim = p.points.shape[1]
            begin, end = B.getOwnershipRange()
            # Column of each row of B, in the order of `__call__`; -1 for components left out.
            column = np.full((len(root), gdim), -1)
            kept = np.arange(len(root) * (gdim - first)).reshape(len(root), -1)
            column[p.order, first:] = kept
            scale = np.empty(len(root))
            scale[p.order] = root
            mine = column.ravel()[begin:end]
            unit = np.zeros((end - begin, kept.size))
            rows = np.flatnonzero(mine >= 0)
            unit[rows, mine[rows]] = np.repeat(scale, gdim)[begin:end][rows]
            transposed = B.transpose(PETSc.Mat())
            loads.append(product(transposed, unit))
            transposed.destroy()
        return np.hstack(loads)


def _places(structure: Structure, what: str, given: Places | None):
    """Positions and directions by name, and the unit load of each, (n_local, m)."""
    gdim, found = structure.gdim, {}
    for name, place in (given or {}).items():
        try:
            point, direction = (np.asarray(part, dtype=float)[:gdim] for part in place)
            one = Sensors(point, direction)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{what}[{name!r}] = {place}: expected (position, direction), each of {gdim} "
                f"numbers, the direction not zero."
            ) from error
        if point.shape != (gdim,):
            raise InputError(f"{what}[{name!r}] = {place}: expected {gdim} coordinates, in metres.")
        found[name] = np.array([one.points[0], one.directions[0]])
    imap = structure.V.dofmap.index_map
    loads = np.zeros((imap.size_local * gdim, len(found)))
    if not found:
        return found, loads
    points, directions = np.array(list(found.values())).transpose(1, 0, 2)
    rows = structure.rows(points, what[:-1])
    held = np.zeros((imap.size_local + imap.num_ghosts) * gdim, dtype=bool)
    for bc in structure.bcs:
        held[bc.dof_indices()[0]] = True
    for column in range(len(found)):
        v = PETSc.Vec().createMPI((imap.size_local * gdim, None), comm=structure.comm)
        for at in np.flatnonzero(rows.index == column):
            dofs = rows.nodes[at][:, None] * gdim + np.arange(gdim)
            value = np.outer(rows.values[at], directions[column])
            blocks = imap.local_to_global(rows.nodes[at])
            columns = (blocks[:, None] * gdim + np.arange(gdim)).astype(PETSc.IntType)
            value = np.where(held[dofs], 0.0, value)
            v.setValues(columns.ravel(), value.ravel(), PETSc.InsertMode.ADD_VALUES)
        v.assemble()
        loads[:, column] = v.array_r
        v.destroy()
    return found, loads


def _vectors(K: PETSc.Mat, columns: np.ndarray) -> list[PETSc.Vec]:
    vectors = []
    for column in columns.T:
        v = K.createVecRight()
        v.array[:] = column
        vectors.append(v)
    return vectors


def with_modal_damping(
    model: InterfaceModel, ratios: float | Sequence[float], rest: float = 0.0
) -> InterfaceModel:
    """The model with viscous damping of its modes at rest, C = M Phi diag(2 zeta omega) Phi^T M.

    Args:
        model: The model.
        ratios: Damping ratio of all modes, or of the first ones, rigid-body modes included.
        rest: Ratio of the modes beyond those.

    Raises:
        InputError: If a ratio is negative, or there are more of them than modes.
    """
    n = model.n_dofs
    zeta = np.full(n, float(ratios if np.ndim(ratios) == 0 else rest))
    if np.ndim(ratios):
        ratios = np.asarray(ratios, dtype=float)
        if len(ratios) > n:
            raise InputError(f"ratios: {len(ratios)} of them; expected at most {n}, one per mode.")
        zeta[: len(ratios)] = ratios
    if not np.all(np.isfinite(zeta) & (zeta >= 0)):
        raise InputError(f"ratios = {ratios}, rest = {rest}: expected damping ratios >= 0.")
    K, M = model.stiffness_at_rest(), model.M
    # Scaled by the diagonal and inverted, K + s M is positive definite also for a free body.
    s = 1e-6 * np.trace(K) / np.trace(M)
    inverse, X = scipy.linalg.eigh(M, K + s * M)
    inverse, X = inverse[::-1], X[:, ::-1]
    # 2 zeta omega / mu with x^T (K + s M) x = 1, mu = x^T M x = 1 / (omega^2 + s).
    omega = np.sqrt(np.maximum(1.0 - s * inverse, 0.0))
    # A direction without mass moves with the others' forces; damping of it has no meaning.
    heavy = inverse > 1e-14 * inverse[0]
    weight = np.divide(2 * zeta * omega, np.abs(inverse) ** 1.5, out=np.zeros(n), where=heavy)
    MX = M @ X
    return replace(model, C=(MX * weight) @ MX.T)


def with_rayleigh_damping(
    model: InterfaceModel, mass: float = 0.0, stiffness: float = 0.0
) -> InterfaceModel:
    """The model with C = mass M + stiffness K, K that of small vibrations at rest.

    Args:
        model: The model.
        mass: Factor of the mass, 1/s.
        stiffness: Factor of the stiffness, s.

    Raises:
        InputError: If a factor is negative or not finite.
    """
    for key, value in (("mass", mass), ("stiffness", stiffness)):
        if not (np.isfinite(value) and value >= 0):
            raise InputError(f"{key} = {value}: expected a number >= 0.")
    return replace(model, C=mass * model.M + stiffness * model.stiffness_at_rest())

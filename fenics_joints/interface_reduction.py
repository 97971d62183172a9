"""Reduced models of structures whose joints are nonlinear.

`reduce_layers` makes thin layers nonlinear, `reduce_contacts` zero-thickness contacts; both give a
`ReducedInterfaceModel`, which harmonic balance and time integration work on, which takes the calls
of a linear structure for small vibrations, and whose linear parameters can still be changed.

A law takes the place of a layer's whole shear stress, and of its normal stress if it is coupled, at
points on the middle plane, two in each direction of a box cell. What is left is positive
semi-definite, so that a joint that slides freely is not unstable. With a law whose tangent at rest
is the layer's the frequencies are the linear structure's, but for what one point through the
thickness and two along a cell do not see: less than 1e-4 of a frequency on cells of 40 mm in a
layer of 0.5 mm between plates of 8 mm, 2e-5 on cells of 10 mm; up to 7e-4 on the former with a
coupled law, since the normal stress varies more within a cell (more points: ``points_degree``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.affine import AffinePencil
from fenics_joints.eigensolver import EigenSolver, product
from fenics_joints.errors import InputError
from fenics_joints.interface_basis import energy_share, fixed_interface, free_interface
from fenics_joints.interface_model import InterfacePoints
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.layer_points import LayerPoints, layer_points
from fenics_joints.modal import solve_modes
from fenics_joints.points import Sensors
from fenics_joints.preload.conditions import OPEN, SLIP
from fenics_joints.preload.interface import Interface
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.preload.model import PreloadModel
from fenics_joints.reduced_interface import (
    LayerTerm,
    ReducedInterfaceModel,
    with_modal_damping,
    with_rayleigh_damping,
)
from fenics_joints.reduction import ReducedStructure
from fenics_joints.structure import Structure

__all__ = [
    "Places",
    "ReducedInterfaceModel",
    "layer_numbers",
    "places",
    "reduce_contacts",
    "reduce_layers",
    "with_modal_damping",
    "with_rayleigh_damping",
]

Places = Mapping[str, tuple[Sequence[float], Sequence[float]]]

#: The shift of static solutions and modes, as `fenics_joints.modal` takes it: its frequency as a
#: share of the dilation frequency.
_SHIFT_SHARE = 0.002
#: Layers whose normal and shear stress are apart.
_SEPARATE = ("uncoupled", "constrained")


def reduce_layers(
    structure: Structure,
    laws: Mapping[str, JointLaw],
    *,
    n_modes: int = 20,
    interface_modes: int | None = None,
    tolerance: float | None = None,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
    points_degree: int | None = None,
    extra: Sequence[PETSc.Vec] = (),
) -> ReducedInterfaceModel:
    """Reduced model of a structure whose thin layers follow nonlinear laws. Collective.

    The basis is of free interfaces: the modes of the structure with its layers as linear as they
    are in it (so give them the laws' stiffness at rest), what is missing of the static response to
    loads at ``forces`` and ``sensors``, and interface modes, see
    `fenics_joints.interface_basis.free_interface`. A fixed-interface basis has no place here: an
    elastic layer has no state in which its strains are held.

    Args:
        structure: The structure; every region's properties uniform, its nonlinear layers
            ``uncoupled`` or ``constrained``.
        laws: Law of each layer that becomes nonlinear, by its region's name. A law that is not
            `coupled` takes the shear stress, a coupled one the normal stress too.
        n_modes: Modes of the linear structure, rigid-body modes included.
        interface_modes: Number of interface modes, 0 for none; by default as many as modes.
        tolerance: Instead of a number, the least energy of an interface mode under unit stress,
            relative to the largest.
        forces: Position, m, and direction of each force, by name.
        sensors: Those of each sensor.
        given: Parameters that differ from their nominal value; the basis is best there.
        points_degree: See `fenics_joints.layer_points.layer_points`.
        extra: Displacements to keep in the basis, such as
            `fenics_joints.full_model.loading_shapes`: a dozen of those show it how the layer gives
            way, which takes interface modes by the hundred.

    Raises:
        InputError: For an unknown layer, graded properties, a place outside the mesh, or a number
            out of range.
    """
    numbers = layer_numbers(structure, laws)
    found = {n: layer_points(structure, i, points_degree) for n, i in numbers.items()}
    values = structure.values(given)
    stretch = {n: structure.field.region_values(i, values)["stretch"] for n, i in numbers.items()}
    forces, force_loads = places(structure, "forces", forces)
    sensors, sensor_loads = places(structure, "sensors", sensors)
    modes = solve_modes(structure, given, n_modes=n_modes)
    M, K = structure.mass(given), structure.stiffness(given)
    strains = _LayerStrains(found, numbers, stretch, {n: law.coupled for n, law in laws.items()})
    basis = free_interface(
        K, M, modes.solver,
        _columns(modes.shapes),
        np.hstack([force_loads, sensor_loads]),
        None if interface_modes == 0 else strains.stresses(), strains,
        strains.tangent(structure, values),
        None if interface_modes == 0 else energy_share(
            interface_modes, tolerance, n_modes, strains.size
        ),
        _columns(extra) if len(extra) else None,
    )  # fmt: skip
    reduced = ReducedStructure(structure, _vectors(K, basis.columns))
    layers = {}
    for name, number in numbers.items():
        p, first = found[name], 0 if laws[name].coupled else 1
        thin, flat = (p.gather(product(B, basis.columns))[:, first:] for B in (p.thin, p.flat))
        layers[name] = LayerTerm(number, thin, flat, p.weights)
    interfaces = [
        InterfacePoints(
            name, laws[name], layer.rows(stretch[name]), layer.volumes * stretch[name],
            laws[name].coupled, found[name].points,
        )
        for name, layer in layers.items()
    ]  # fmt: skip
    pencil = _without_stress(reduced.affine, {numbers[n]: law for n, law in laws.items()})
    model = _assemble(structure, basis.columns, reduced, interfaces, pencil, layers, given,
                      (forces, force_loads), (sensors, sensor_loads))  # fmt: skip
    modes.solver.destroy()
    for A in (K, M, *(B for p in found.values() for B in (p.thin, p.flat))):
        A.destroy()
    return model


def reduce_contacts(
    joint: LinearJoint | PreloadModel,
    laws: Mapping[str, JointLaw],
    *,
    method: str = "craig-bampton",
    n_modes: int = 20,
    interface_modes: int | None = None,
    tolerance: float | None = None,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
) -> ReducedInterfaceModel:
    """Reduced model of bodies whose zero-thickness contacts follow nonlinear laws. Collective.

    The strains are the jumps of pairs, m: opening (of a coupled law) and slips; the weights are the
    pairs' areas. With a law that is not `coupled` the interface is the pairs that are not OPEN in
    ``joint``: they stay closed, and slip against the law. With a coupled law all pairs are, and
    what ``joint`` says of the contact does not matter. Other contacts stay as in ``joint``.

    Args:
        joint: Bodies and contacts, about a preload state or all closed.
        laws: Law of each contact that becomes nonlinear, by name.
        method: ``"craig-bampton"``: modes with all pairs stuck, and constraint modes, or as many
            characteristic constraint modes as `interface_modes`, with the laws' tangents at rest;
            ``"free-interface"``: modes with those tangents, and interface modes.
        n_modes: Modes, rigid-body modes included.
        interface_modes: Number of interface modes; by default all constraint modes, or of a free
            interface as many as modes.
        tolerance: Instead of a number, of a free interface: the least energy of an interface mode
            under unit stress, relative to the largest.
        forces: Position, m, and direction of each force, by name. Bolts and loads of the model are
            forces too, by their names, per newton or factor.
        sensors: Position and direction of each sensor.
        given: Parameters that differ from their nominal value; the basis is best there.

    Raises:
        InputError: For an unknown contact, one with springs or without closed pairs, an unknown
            method, or a number out of range.
    """
    joint = LinearJoint(joint) if isinstance(joint, PreloadModel) else joint
    if method not in ("craig-bampton", "free-interface"):
        raise InputError(f"method = {method!r}: expected 'craig-bampton' or 'free-interface'.")
    structure, jumps = joint.structure, joint.jumps
    _check_uniform(structure)
    pairs = _kept_pairs(joint, laws)
    free = joint.change(_released(joint, laws), joint.springs)
    K, M = free.stiffness(given), free.mass(given)
    _hold(joint, (K, M), _bubbles(joint, pairs, laws))
    entries = {n: _entries(jumps, c, kept, laws[n].coupled) for n, (c, kept) in pairs.items()}
    jump = _Entries(jumps, list(entries.values()))
    forces, force_loads = _jump_places(joint, "forces", forces)
    for name in joint.model.forces:
        if name in forces:
            raise InputError(f"forces: {name!r} is a bolt or load; expected another name.")
    bolts = [joint.model.unit_load(name).array_r for name in joint.model.forces]
    forces = {**forces, **dict.fromkeys(joint.model.forces)}
    force_loads = np.column_stack([force_loads, *bolts])
    sensors, sensor_loads = _jump_places(joint, "sensors", sensors)
    loads = np.hstack([force_loads, sensor_loads])
    _zero_held(joint, free, pairs, laws, loads)
    areas = {n: c.areas[kept] for n, (c, kept) in pairs.items()}
    shift = -((2 * np.pi * _SHIFT_SHARE * joint.dilation_frequency(given)) ** 2)
    solver = EigenSolver(n_modes, shift=shift)
    elastic = _with_tangents(K, laws, areas, entries, jumps)
    if method == "craig-bampton":
        held = [A.copy() for A in (K, M)]
        _hold(joint, held, jump.numbers)
        modes = _columns(solver.solve(*held).shapes)
        choose = _characteristic(interface_modes, len(jump.numbers))
        basis = fixed_interface(elastic, M, solver, modes, loads, jump.local, choose)
        for A in held:
            A.destroy()
    else:
        modes = _columns(solver.solve(elastic, M).shapes)
        root = np.concatenate([np.repeat(areas[n], e.shape[1]) for n, e in entries.items()]) ** 0.5
        basis = free_interface(
            elastic, M, solver, modes, loads, jump.unit(len(modes)) * root,
            lambda columns: root[:, None] * jump.rows(columns), _tangents(laws, areas, entries),
            energy_share(interface_modes, tolerance, n_modes, len(root)),
        )  # fmt: skip
    elastic.destroy(), solver.destroy()
    columns = basis.columns
    interfaces, at = [], 0
    rows = jump.rows(columns)
    for name, numbers in entries.items():
        c, kept = pairs[name]
        part = rows[at : at + numbers.size].reshape(*numbers.shape, -1)
        at += numbers.size
        interfaces.append(
            InterfacePoints(name, laws[name], part, areas[name], laws[name].coupled, c.points[kept])
        )
    source = ReducedStructure(structure, joint.displacements(_vectors(K, columns)))
    K_all, M_all = (_projected(A, columns) for A in (K, M))
    K_parts, M_parts = source.affine.matrices(structure.values(given))
    pencil = replace(
        source.affine, fixed=(K_all - K_parts, M_all - M_parts),
        fixed_mass=joint.total_mass(given) - structure.total_mass(given),
    )  # fmt: skip
    K.destroy(), M.destroy()
    return _assemble(structure, columns, source, interfaces, pencil, {}, given,
                     (forces, force_loads), (sensors, sensor_loads))  # fmt: skip


def _kept_pairs(joint: LinearJoint, laws) -> dict[str, tuple[Interface, np.ndarray]]:
    """Contact and rows of the pairs that are the interface, by name."""
    contacts = {c.name: c for c in joint.jumps.contacts}
    if not laws:
        raise InputError(f"laws: expected a law for one of the contacts {', '.join(contacts)}.")
    found = {}
    for name, law in laws.items():
        if name not in contacts:
            raise InputError(
                f"laws: there is no contact {name!r}; expected: {', '.join(contacts) or 'none'}."
            )
        if name in joint.springs:
            raise InputError(f"laws: {name} has springs already; expected one or the other.")
        closed = joint.conditions[name] > OPEN
        kept = np.flatnonzero(closed | law.coupled)
        if not len(kept):
            raise InputError(
                f"{name}: all its pairs are open; expected closed ones, or a coupled law."
            )
        found[name] = (contacts[name], kept)
    return found


def _released(joint: LinearJoint, laws) -> dict[str, np.ndarray]:
    """Conditions without the interfaces' stress: closed pairs slide, or all are open."""
    conditions = {n: c for n, c in joint.conditions.items() if n not in joint.springs}
    for name, law in laws.items():
        conditions[name] = np.where(law.coupled, OPEN, np.minimum(conditions[name], SLIP))
    return conditions


def _entries(jumps, c: Interface, kept: np.ndarray, coupled: bool) -> np.ndarray:
    """Global numbers in x of the interface's strains, (P, d)."""
    slips = jumps.slips(c)
    numbers = np.column_stack([jumps.opening(c), slips]) if coupled else slips
    return numbers[kept]


def _bubbles(joint: LinearJoint, pairs, laws) -> np.ndarray:
    """Bubbles between pairs of an interface: its jump is piecewise linear."""
    found = [np.empty(0, dtype=np.int64)]
    for c, kept in pairs.values():
        if len(c.edges):
            inside = np.isin(c.edges, kept).all(axis=1)
            found.append(joint.jumps.bubbles(c)[inside].ravel())
    return np.concatenate(found)


def _hold(joint: LinearJoint, pencil, numbers: np.ndarray) -> None:
    mine = numbers[joint.jumps.owned(numbers)].astype(PETSc.IntType)
    for A, diagonal in zip(pencil, (1.0, 0.0), strict=True):
        A.zeroRowsColumns(mine, diag=diagonal)


def _zero_held(joint: LinearJoint, free: LinearJoint, pairs, laws, loads: np.ndarray) -> None:
    """Take loads off entries that are held, in place."""
    numbers = np.concatenate([free.held(), _bubbles(joint, pairs, laws)])
    mine = np.union1d(numbers[joint.jumps.owned(numbers)], joint.model.supported)
    loads[joint.jumps.local(mine)] = 0.0


class _Entries:
    """Single entries of x as strains."""

    def __init__(self, jumps, numbers: list[np.ndarray]):
        self.numbers = np.concatenate([n.ravel() for n in numbers])
        self._comm = jumps.comm
        self._mine = jumps.owned(self.numbers)
        #: Local row of each entry, or -1 where another rank owns it.
        self.local = np.where(self._mine, jumps.local(self.numbers), -1)

    def rows(self, columns: np.ndarray) -> np.ndarray:
        """Entries of columns, (q, m), equal on all ranks."""
        found = np.zeros((len(self.numbers), columns.shape[1]))
        found[self._mine] = columns[self.local[self._mine]]
        self._comm.Allreduce(MPI.IN_PLACE, found)
        return found

    def unit(self, n_local: int) -> np.ndarray:
        """A column for each entry, with a one there, (n_local, q)."""
        columns = np.zeros((n_local, len(self.numbers)))
        columns[self.local[self._mine], np.flatnonzero(self._mine)] = 1.0
        return columns


def _characteristic(n: int | None, size: int) -> Callable:
    """All constraint modes, or the n lowest eigenmodes of the elastic interface."""
    if n is not None and not 1 <= n <= size:
        raise InputError(
            f"interface_modes = {n}: expected 1 to {size}, the interface's components."
        )

    def choose(stiffness: np.ndarray, mass: np.ndarray) -> np.ndarray:
        if n is None:
            return np.eye(size)
        vectors = scipy.linalg.eigh(mass, stiffness, subset_by_index=[size - n, size - 1])[1]
        return vectors[:, ::-1]

    return choose


def _with_tangents(K: PETSc.Mat, laws, areas, entries, jumps) -> PETSc.Mat:
    """K with the laws' tangents at rest as springs between the pairs."""
    stiff = K.copy()
    stiff.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    blocks = _tangents(laws, areas, entries)
    numbers = np.concatenate([e.ravel() for e in entries.values()]).astype(PETSc.IntType)
    root = np.concatenate([np.repeat(areas[n], e.shape[1]) for n, e in entries.items()]) ** 0.5
    for i, j in np.argwhere(blocks):
        if jumps.owned(numbers[i : i + 1])[0]:
            value = root[i] * blocks[i, j] * root[j]
            stiff.setValue(numbers[i], numbers[j], value, PETSc.InsertMode.ADD_VALUES)
    stiff.assemble()
    return stiff


def _tangents(laws, areas, entries) -> np.ndarray:
    """Stress by strain at rest of all interfaces' components, (q, q)."""
    blocks = []
    for name, numbers in entries.items():
        rows = np.zeros((*numbers.shape, 1))
        points = InterfacePoints(name, laws[name], rows, areas[name], laws[name].coupled)
        blocks.extend(points.tangent())
    return scipy.linalg.block_diag(*blocks)


def _jump_places(joint: LinearJoint, what: str, given: Places | None):
    """As `places`, the loads in x."""
    found, loads = places(joint.structure, what, given)
    T = joint.jumps.T
    transposed = T.transpose(PETSc.Mat())
    loads = product(transposed, loads) if found else np.zeros((joint.jumps.n_local, 0))
    transposed.destroy()
    return found, loads


def _projected(A: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    matrix = A.comm.tompi4py().allreduce(columns.T @ product(A, columns))
    return 0.5 * (matrix + matrix.T)


def _columns(vectors: list[PETSc.Vec]) -> np.ndarray:
    return np.column_stack([v.array_r for v in vectors])


def _without_stress(pencil: AffinePencil, laws: Mapping[int, JointLaw]) -> AffinePencil:
    """The pencil without the stress that laws take over, by the region's index."""
    regions = list(pencil.regions)
    for number, law in laws.items():
        # Of these layers the first scalar is the normal modulus', the others the shear modulus'.
        kept = np.zeros(len(regions[number].stiffness))
        kept[0] = 0.0 if law.coupled else 1.0
        stiffness = kept[:, None, None] * regions[number].stiffness
        regions[number] = replace(regions[number], stiffness=stiffness)
    return replace(pencil, regions=regions)


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


def layer_numbers(structure: Structure, laws: Mapping[str, JointLaw]) -> dict[str, int]:
    names = {r.name: i for i, r in enumerate(structure.regions) if r.is_joint}
    if not laws:
        raise InputError(f"laws: expected a law for one of the layers {', '.join(names)}.")
    for name in laws:
        if name not in names:
            raise InputError(
                f"laws: {name!r} is no thin layer; expected: {', '.join(names) or 'none'}."
            )
        linear = structure.regions[names[name]].law.name
        if linear not in _SEPARATE:
            raise InputError(
                f"{name}: a layer with the law {linear!r} has no shear stress of its own that a "
                f"nonlinear law could replace; expected {' or '.join(_SEPARATE)}."
            )
    _check_uniform(structure)
    return {name: names[name] for name in laws}


def _check_uniform(structure: Structure) -> None:
    for region in structure.regions:
        if any(callable(p) for p in region.properties.values()):
            raise InputError(
                f"{region.name}: its properties vary in space; expected uniform ones in a model "
                "with nonlinear interfaces."
            )


class _LayerStrains:
    """Strains of all layers as one list of components, weighted by the root of their volume."""

    def __init__(self, found: Mapping[str, LayerPoints], numbers, stretch, normal):
        self.parts, self.numbers = [], [numbers[name] for name in found]
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

    def tangent(self, structure: Structure, values) -> np.ndarray:
        """The linear layers' stress by strain of these components, (size, size)."""
        moduli = []
        for (p, _, _, first), number in zip(self.parts, self.numbers, strict=True):
            q = structure.field.region_values(number, values)
            # At unit stretch the first scalar of these laws is the normal modulus.
            normal = structure.regions[number].law.stiffness_terms({**q, "stretch": 1.0})[0]
            each = [normal] + [q["G"]] * (p.points.shape[1] - 1)
            moduli.append(np.tile(each[first:], len(p.points)))
        return np.diag(np.concatenate(moduli))

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


def places(structure: Structure, what: str, given: Places | None):
    """Positions and directions by name, and the unit load of each, (n_local, m)."""
    gdim, found = structure.gdim, {}
    for name, place in (given or {}).items():
        try:
            point, direction = (np.asarray(part, dtype=float)[:gdim] for part in place)
            one = Sensors(point, direction)
        except (IndexError, TypeError, ValueError) as error:
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

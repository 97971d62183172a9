"""Cells of a structure, of its mesh or elements of its beams, with their energies in motions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np
from mpi4py import MPI

from fenics_joints._compat import geometry_dofmap
from fenics_joints.beams.structure import JOINT_KEYS, BeamStructure, cell_energies
from fenics_joints.diagnosis.zones.joints import bolt_points
from fenics_joints.matrices import MatrixStructure
from fenics_joints.modal.modes import Modes
from fenics_joints.structure import FormModel, Structure
from fenics_joints.structure.grids import cell_volumes
from fenics_joints.structure.structure import CellForces


class StructureCells(ABC):
    """The cells that this rank owns.

    Attributes:
        structure: What they are the cells of.
        comm: Its communicator.
        replicated: Whether every rank owns all of them, as of beams.
        side_view: Whether they are to be seen from the side.
        stiffness: Properties that together are a cell's whole stiffness.
        regions: Names of the regions.
        joints: Names of those that are joints.
        region: Region of each cell, (n_owned,).
        groups: Region of each group of cells that belong together.
        group: Group of each cell, (n_owned,).
        corners: Corners of each cell, m, (n_owned, n_corners, 3).
        volume: Volume of each cell, m3, (n_owned,).
        bolts: Places of the bolts, m, (n_bolts, 3).
    """

    structure: Structure | BeamStructure
    comm: MPI.Intracomm
    replicated: bool
    side_view: bool
    stiffness: tuple[str, ...]
    regions: tuple[str, ...]
    joints: Collection[str]
    region: np.ndarray
    groups: Sequence[str]
    group: np.ndarray
    corners: np.ndarray
    volume: np.ndarray
    bolts: np.ndarray

    @abstractmethod
    def crossed(
        self, modes: Modes, index: Sequence[int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Of mode after mode i, x_i^T K x_k and x_i^T M x_k of each cell with every mode k.
        Collective.

        Args:
            modes: Modes, M of them.
            index: Which of them i is, one after the other.

        Yields:
            Both (n_owned, M).
        """

    @abstractmethod
    def energies(self, x, omega: float, given: Mapping[str, float] | None):
        """x^T K x and omega^2 x^T M x of each cell, each (n_owned,). Collective.

        Args:
            x: A motion: a vector laid out like the rows of K; of beams an array.
            omega: Circular frequency, rad/s.
            given: Values of parameters that differ from their nominal value.
        """

    def sums(self, number: np.ndarray, by_cell: np.ndarray, n: int) -> np.ndarray:
        """Sums of values by cell over numbered sets of them, (n,) or (n, m). Collective.

        Args:
            number: Set of each cell, (n_owned,).
            by_cell: Values, (n_owned,) or (n_owned, m).
            n: Number of sets.
        """
        total = np.zeros((n, *by_cell.shape[1:]))
        if n:
            np.add.at(total, number, by_cell)
        return total if self.replicated else self.comm.allreduce(total)

    def gather(self, *arrays: np.ndarray) -> list[np.ndarray] | None:
        """Arrays by cell of all ranks behind each other, on rank 0; None elsewhere. Collective."""
        parts = [arrays] if self.replicated else self.comm.gather(arrays, root=0)
        if self.comm.rank != 0:
            return None
        return [np.concatenate(pieces) for pieces in zip(*parts, strict=True)]

    def scatter(self, by_cell: np.ndarray | None) -> np.ndarray:
        """The part of this rank's cells of an array that rank 0 has. Collective."""
        if self.replicated:
            return self.comm.bcast(by_cell)
        counts = self.comm.gather(len(self.volume))
        pieces = None
        if self.comm.rank == 0:
            pieces = np.split(by_cell, np.cumsum(counts)[:-1])
        return self.comm.scatter(pieces)


class MeshCells(StructureCells):
    """Cells of a mesh, each owned by one rank."""

    replicated, side_view = False, False
    stiffness = ("E", "G")

    def __init__(self, structure: Structure):
        self.structure, self.comm = structure, structure.comm
        self.regions = tuple(region.name for region in structure.regions)
        self.joints = {region.name for region in structure.regions if region.is_joint}
        self.volume, self.bolts = structure.cell_volumes(), bolt_points(structure.tagged)
        owned = len(self.volume)
        self.corners = structure.mesh.geometry.x[geometry_dofmap(structure.mesh)[:owned]]
        self.region, self.group = np.zeros(owned, dtype=int), np.zeros(owned, dtype=int)
        self.groups = []
        for number, region in enumerate(structure.regions):
            for name in region.cells:
                cells = structure.tagged.cell_tags.find(structure.tagged.cell_tag(name))
                cells = cells[cells < owned]
                self.region[cells], self.group[cells] = number, len(self.groups)
                self.groups.append(region.name)

    def _by_log(self, gradient: np.ndarray, key: str) -> np.ndarray:
        """Derivative by a property's logarithm, (n_owned,), from `Structure.cell_gradient`."""
        field = self.structure.field
        q, out = field.by_cell(field.q.x.array), np.zeros(len(gradient))
        for region, cells in field.regions:
            if key in region.law.properties:
                slot = region.law.properties.index(key)
                cells = cells[cells < len(gradient)]
                out[cells] = gradient[cells, slot] * q[cells, slot]
        return out

    def crossed(self, modes: Modes, index: Sequence[int]):
        forces = CellForces(self.structure)
        motions = np.array([forces.motion(modes.vector(k)) for k in range(len(modes))])
        for i in index:
            yield tuple(
                np.einsum("cd,kcd->ck", by_cell, motions)
                for by_cell in forces.of(modes.vector(int(i)), modes.given)
            )

    def energies(self, x, omega: float, given) -> tuple[np.ndarray, np.ndarray]:
        gradient = self.structure.cell_gradient(x, omega**2, given)
        # Stiffness is of the first degree in all moduli together, mass in the density.
        stiff = sum(self._by_log(gradient, key) for key in self.stiffness)
        return stiff, -self._by_log(gradient, "rho")


class FormCells(StructureCells):
    """Cells of the mesh of a model by forms; what its forms integrate over facets is left out."""

    replicated, side_view, stiffness, joints = False, False, (), ()

    def __init__(self, model: FormModel):
        self.structure, self.comm = model, model.comm
        mesh = model.mesh
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        self.regions, self.groups = ("model",), ("model",)
        self.corners = mesh.geometry.x[geometry_dofmap(mesh)[:owned]]
        self.region = self.group = np.zeros(owned, dtype=int)
        self.volume, self.bolts = cell_volumes(mesh), np.empty((0, 3))

    def crossed(self, modes: Modes, index: Sequence[int]):
        for i in index:
            own = modes.vector(int(i))
            found = [
                self.structure.cell_energies(own, modes.vector(k), modes.given)
                for k in range(len(modes))
            ]
            yield tuple(np.array(part).T for part in zip(*found, strict=True))

    def energies(self, x, omega: float, given) -> tuple[np.ndarray, np.ndarray]:
        stiff, mass = self.structure.cell_energies(x, x, given)
        return stiff, omega**2 * mass


#: Thickness of the box that shows a joint, over its length. [numerical: chosen for the eye]
_THIN = 1e-3


class MatrixCells(StructureCells):
    """Parts and joints of a model by matrices, each one cell: no finer energies are known."""

    replicated, side_view, stiffness = True, False, ()

    def __init__(self, model: MatrixStructure):
        self.structure, self.comm = model, model.comm
        self.regions, self.groups = model.layers, [name for name, _ in model.cells]
        self.joints = {joint.name for joint in model.joints}
        self.region = np.array([self.regions.index(name) for name in self.groups])
        self.group = np.arange(len(self.groups))
        low, high = (np.array([end(p, axis=0) for _, p in model.cells]) for end in (np.min, np.max))
        # A joint is flat: as a box it has two faces.
        size = np.maximum(high - low, _THIN * (high - low).max(axis=1, keepdims=True))
        unit = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
        self.corners = 0.5 * ((low + high)[:, None] + unit * size[:, None])
        self.volume, self.bolts = np.prod(size, axis=1), np.empty((0, 3))

    def crossed(self, modes: Modes, index: Sequence[int]):
        vectors = [modes.vector(k) for k in range(len(modes))]
        for i in index:
            yield self.structure.cell_energies(modes.vector(int(i)), vectors, modes.given)

    def energies(self, x, omega: float, given) -> tuple[np.ndarray, np.ndarray]:
        stiff, mass = self.structure.cell_energies(x, [x], given)
        return stiff[:, 0], omega**2 * mass[:, 0]


class BeamElements(StructureCells):
    """Elements of beams and of their laps as boxes, all of them on every rank.

    Args:
        structure: The beams.
        comm: Communicator.
        owner: Name of the part of each beam.
        zones: Name of the zone of each joint element, lap by lap.
        bolts: Places of the bolts, m, (n_bolts, 3).
    """

    replicated, side_view = True, True
    stiffness = ("E", *JOINT_KEYS)

    def __init__(
        self,
        structure: BeamStructure,
        comm: MPI.Intracomm,
        owner: Sequence[str],
        zones: Sequence[Sequence[str]],
        bolts: np.ndarray,
    ):
        self.structure, self.comm, self.bolts = structure, comm, bolts
        self.joints = {name for lap in zones for name in lap}
        firsts = {s.joint: s.first for s in structure.layout.stretches if s.joint is not None}
        cells = structure.cells
        labels = [
            owner[beam] if beam >= 0 else zones[lap][element - firsts[lap]]
            for beam, lap, element in zip(cells.beam, cells.lap, cells.element, strict=True)
        ]
        self.corners, self.volume = cells.vertices, cells.volume
        self.regions = tuple(dict.fromkeys(labels))
        self.region = np.array([self.regions.index(label) for label in labels])
        # Each beam by itself, though several be of one part.
        pairs = list(zip(labels, cells.beam.tolist(), strict=True))
        groups = list(dict.fromkeys(pairs))
        self.group = np.array([groups.index(pair) for pair in pairs])
        self.groups = [label for label, _ in groups]

    def crossed(self, modes: Modes, index: Sequence[int]):
        for i in index:
            x = modes.shapes[:, [int(i)]]
            # x^T K y is a quarter of what the squares of x + y and x - y differ by.
            ends = [cell_energies(self.structure, modes.shapes + y, modes.given) for y in (x, -x)]
            with_it, less = ((sum(end[key] for key in self.stiffness), end["rho"]) for end in ends)
            yield tuple((a - b) / 4 for a, b in zip(with_it, less, strict=True))

    def energies(self, x, omega: float, given) -> tuple[np.ndarray, np.ndarray]:
        found = cell_energies(self.structure, x[:, None], given)
        stiff = sum(found[key] for key in self.stiffness)
        return stiff[:, 0], omega**2 * found["rho"][:, 0]

"""Bodies, contacts, bolts and loads as K x = f with conditions on single entries of x."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError, MeshError, items, mapping, real, wanted
from fenics_joints.preload.beam import beam_matrices, condense_to_ends
from fenics_joints.preload.bodies import at_blocks
from fenics_joints.preload.components import (
    BeamBolt,
    Contact,
    Displacement,
    Obstacle,
    Pressure,
    PretensionSection,
    Traction,
    WasherForce,
)
from fenics_joints.structure.faces import (
    Interface,
    couple_faces,
    face_obstacle,
    frames,
    matching,
    pair_faces,
    read_face,
)
from fenics_joints.structure.jumps import Jumps, Moved, Section, Spider
from fenics_joints.structure.structure import Structure
from fenics_joints.structure.ties import edge_middle

Bolt = WasherForce | PretensionSection | BeamBolt
_BOLTS = (WasherForce, PretensionSection, BeamBolt)
Load = Traction | Pressure | Displacement
_LOADS = (Traction, Pressure, Displacement)

#: Stiffness of supports of vertices that follow others, relative to the mean of K's diagonal.
#: Chosen: they give way by a millionth, and K loses six of sixteen digits.
_STIFF = 1e6


class PreloadModel:
    """A structure of several bodies with contacts, bolts and loads.

    Args:
        structure: Bodies that share no vertices; its supports hold, its springs act.
        contacts: Contacts between faces, of which those with ``bonded`` are glued, and obstacles.
        bolts: Bolts, in any of their three forms.
        loads: Further loads, and faces that are moved.

    Raises:
        InputError: For a name or a bolt's face given twice, or a value out of range.
        MeshError: If faces do not exist or do not lie on one another.

    Attributes:
        contacts: The contacts that can open, in order.
        interfaces: Their pairs of vertices, in the same order.
        jumps: The map u = T x and its numbering.
        forces: Nominal force of every bolt, N, and 1 for every load, displacement or pushed
            obstacle, by name.
        resultants: Force of every load as given, N, (gdim,), by name.
        supported: Global numbers of the entries of x that supports hold at zero, owned ones.
    """

    def __init__(
        self,
        structure: Structure,
        contacts: Iterable[Contact | Obstacle],
        bolts: Iterable[Bolt] = (),
        loads: Iterable[Load] = (),
    ):
        if not isinstance(structure, Structure):
            raise wanted("structure", structure, "a Structure")
        if structure.ties is not None:
            raise MeshError(
                "structure: the mesh has layers between faces that do not match; expected a mesh "
                'made with joint = "contact", whose contacts may have such faces too.'
            )
        contacts = list(items("contacts", contacts, (Contact, Obstacle), "Contact, Obstacle"))
        self.bolts = list(items("bolts", bolts, _BOLTS, "WasherForce, PretensionSection, BeamBolt"))
        self.loads = list(items("loads", loads, _LOADS, "Traction, Pressure, Displacement"))
        self.structure, self.comm = structure, structure.comm
        self.V, self.tagged = structure.V, structure.tagged
        self.axisymmetric = structure.axisymmetric
        self._check_names([c.name for c in (*contacts, *self.bolts, *self.loads)])
        self._check_washers()
        self._faces: dict[str, object] = {}
        self._surfaces = FaceIntegrals(structure)
        self.contacts = [c for c in contacts if isinstance(c, Obstacle) or not c.bonded]
        self.interfaces = [self._pair(c) for c in self.contacts]
        bonded = [self._pair(c) for c in contacts if c not in self.contacts]
        self.beams = [b for b in self.bolts if isinstance(b, BeamBolt)]
        self.cuts = [b for b in self.bolts if isinstance(b, PretensionSection)]
        spiders = [self._spider(b, side) for b in self.beams for side in ("lower", "upper")]
        sections = [self._section(b) for b in self.cuts]
        self.moved = [
            *(s for s in self.loads if isinstance(s, Displacement)),
            *(c for c in self.contacts if isinstance(c, Obstacle)),
        ]
        moved = [self._move(m) for m in self.moved]
        self.jumps = Jumps(self.V, self.interfaces, bonded, sections, spiders, moved)
        self._held, self._following = self._supports()
        driven = self._driven()
        self.supported = np.concatenate([self._held, driven[self.jumps.owned(driven)]])
        self.forces = {b.name: float(b.force) for b in self.bolts}
        resting = [c.name for c in self.contacts if isinstance(c, Obstacle) and c.rests]
        self.forces |= {s.name: 1.0 for s in (*self.loads, *self.moved) if s.name not in resting}
        self.resultants: dict[str, np.ndarray] = {}
        self._units = self._unit_loads()

    @staticmethod
    def _check_names(names: list[str]) -> None:
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    f"{name} is the name of two contacts, bolts or loads; expected one."
                )

    def moves(self, forces: Mapping[str, float] | None = None) -> list[tuple]:
        """Given displacements at these factors: numbers in x, (gdim,), and values, m, (gdim,)."""
        factors = self.force_values(forces)
        found = []
        for i, moved in enumerate(self.moved):
            way = moved.travel if isinstance(moved, Obstacle) else moved.value
            value = np.array([v or 0.0 for v in way or (0.0,) * self.structure.gdim])
            found.append((self.jumps.shift(i), factors.get(moved.name, 0.0) * value))
        return found

    def _check_washers(self) -> None:
        """Two bolts on one face would each be spread over all of it."""
        taken: dict[str, str] = {}
        for bolt in self.bolts:
            for key in ("lower", "upper"):
                face = getattr(bolt, key)
                if face in taken:
                    raise InputError(
                        f"{bolt.name}.{key} = {face!r}: the bolt {taken[face]} has this face "
                        "already; expected one for each end of a bolt."
                    )
                taken[face] = bolt.name

    # -- set-up ------------------------------------------------------------------------------

    def face(self, name: str):
        """The gathered face, cached. Collective."""
        if name not in self._faces:
            self._faces[name] = read_face(self.V, self.tagged, name)
        return self._faces[name]

    def weight(self, x) -> np.ndarray:
        """Weight of the surface measure at positions x, (n, gdim): 2 pi r or 1."""
        return 2 * np.pi * x[:, 0] if self.axisymmetric else np.ones(len(x))

    def _pair(self, contact: Contact | Obstacle) -> Interface:
        shared = {"gap": contact.gap, "weight": self.weight}
        if isinstance(contact, Obstacle):
            face = self.face(contact.facets)
            shape = _checked_shape(f"{contact.name}.shape", contact.shape)
            return face_obstacle(contact.name, face, shape, **shared)
        lower, upper = self.face(contact.lower), self.face(contact.upper)
        shared |= {"tolerance": contact.tolerance, "held": self._held_directions}
        if matching(lower, upper, contact.tolerance):
            return pair_faces(contact.name, lower, upper, **shared)
        return couple_faces(
            contact.name,
            lower,
            upper,
            bubble=edge_middle(self.structure),
            bonded=contact.bonded,
            **shared,
        )

    def _move(self, moved: Displacement | Obstacle) -> Moved:
        if isinstance(moved, Obstacle):
            self._along(moved.name, "travel", moved.travel)
            self._along(moved.name, "force", moved.force)
            none = np.empty(0, np.int64)
            if moved.force is None:
                return Moved(moved.name, none, ())
            force = np.asarray(moved.force, dtype=float)
            return Moved(moved.name, none, (), frames(force[None] / np.linalg.norm(force))[0])
        self._along(moved.name, "value", moved.value)
        face = self.face(moved.facets)
        return Moved(moved.name, np.concatenate([face.nodes, face.midsides]), moved.directions)

    def _driven(self) -> np.ndarray:
        """Global numbers in x of displacements that are given; a pushed obstacle's first is not."""
        pushed = [isinstance(m, Obstacle) and m.force is not None for m in self.moved]
        numbers = [self.jumps.shift(i)[int(p) :] for i, p in enumerate(pushed)]
        return np.concatenate([np.empty(0, int), *numbers])

    def _along(self, name: str, key: str, vector) -> None:
        if vector is not None and len(vector) != self.structure.gdim:
            raise InputError(f"{name}.{key} = {vector}: expected {self.structure.gdim} components.")

    def _held_directions(self, nodes: np.ndarray) -> np.ndarray:
        """Whether supports hold blocks, by global number, in each direction, (n, gdim)."""
        held = self.structure.held_dofs[: self.structure.n_local].astype(np.int8)
        return at_blocks(self.V, held.reshape(-1, self.structure.gdim), nodes).astype(bool)

    def _axis(self, bolt) -> np.ndarray:
        self._along(bolt.name, "axis", bolt.axis)
        axis = np.eye(self.structure.gdim)[-1] if bolt.axis is None else np.array(bolt.axis)
        return axis / np.linalg.norm(axis)

    def _spider(self, bolt: BeamBolt, side: str) -> Spider:
        face = self.face(getattr(bolt, side))
        nodes = np.concatenate([face.nodes, face.midsides])
        points = np.vstack([face.points, face.points[face.edges].mean(axis=1)])
        centre = self._surfaces.centre(getattr(bolt, side))
        return Spider(f"{bolt.name}.{side}", nodes, points, centre)

    def _section(self, bolt: PretensionSection) -> Section:
        pairs = pair_faces(bolt.name, self.face(bolt.lower), self.face(bolt.upper))
        lower = np.concatenate([pairs.lower, pairs.lower_midsides])
        upper = np.concatenate([pairs.upper, pairs.upper_midsides])
        return Section(bolt.name, lower, upper, self._axis(bolt))

    def _supports(self) -> tuple[np.ndarray, np.ndarray]:
        """Supported displacements: those that are entries of x, and those that follow others.

        Both as global numbers, owned ones.
        """
        low, high = self.jumps.range
        numbers = np.flatnonzero(self.structure.held_dofs[: high - low]) + low
        indptr, indices, _ = self.jumps.T.getValuesCSR()
        lone = np.diff(indptr) == 1
        same = np.zeros(high - low, dtype=bool)
        same[lone] = indices[indptr[:-1][lone]] == np.flatnonzero(lone) + low
        free = same[numbers - low]
        return numbers[free], numbers[~free]

    # -- loads -------------------------------------------------------------------------------

    def _unit_loads(self) -> dict[str, PETSc.Vec]:
        """Load in x of each bolt at 1 N and of each load as given."""
        units, surfaces = {}, self._surfaces
        for bolt in self.bolts:
            if isinstance(bolt, WasherForce):
                axis = self._axis(bolt)
                pressed = [(bolt.lower, axis), (bolt.upper, -axis)]
                units[bolt.name] = self._in_x(surfaces.forces(pressed))
            else:
                units[bolt.name] = self._extra_load(bolt)
        for load in self.loads:
            if isinstance(load, Displacement):
                continue
            if isinstance(load, Pressure):
                spread = surfaces.pressure(load.facets, load.pressure)
            else:
                self._along(load.name, "force", load.force)
                spread = surfaces.forces([(load.facets, np.asarray(load.force))], load.profile)
            self.resultants[load.name] = surfaces.resultant(spread)
            units[load.name] = self._in_x(spread)
        for i, moved in enumerate(self.moved):
            units[moved.name] = self.jumps.T.createVecRight()
            units[moved.name].set(0.0)
            if isinstance(moved, Obstacle) and moved.force is not None:
                size = float(np.linalg.norm(moved.force))
                self.jumps.put(units[moved.name].array, self.jumps.shift(i)[:1], size)
        return units

    def _in_x(self, b: PETSc.Vec) -> PETSc.Vec:
        """A load in u, which is freed, as one in x; supports take their part."""
        for numbers in (self._held, self._following):
            b.array[numbers - self.jumps.range[0]] = 0.0
        load = self.jumps.T.createVecRight()
        self.jumps.T.multTranspose(b, load)
        b.destroy()
        return load

    def _extra_load(self, bolt) -> PETSc.Vec:
        load = self.jumps.T.createVecRight()
        load.set(0.0)
        if isinstance(bolt, PretensionSection):
            self.jumps.put(load.array, self.jumps.shortening(self.cuts.index(bolt)), 1.0)
        else:
            i, axis = 2 * self.beams.index(bolt), self.beam_axis(bolt)
            for k, force in enumerate((axis, -axis)):
                self.jumps.put(load.array, self.jumps.reference(i + k)[:3], force)
        return load

    def ends(self, bolt: BeamBolt) -> tuple[np.ndarray, np.ndarray]:
        """Centres of a bolt's lower and upper spider, m, (3,) each."""
        i = 2 * self.beams.index(bolt)
        return self.jumps.spiders[i].centre, self.jumps.spiders[i + 1].centre

    def beam_axis(self, bolt: BeamBolt) -> np.ndarray:
        """Unit vector from the lower spider's centre to the upper's."""
        lower, upper = self.ends(bolt)
        axis = upper - lower
        length = np.linalg.norm(axis)
        if not length > 0:
            raise InputError(f"{bolt.name}: its two spiders have one centre; expected a length.")
        return axis / length

    def bolt_mass(self, bolt: BeamBolt) -> float:
        """Mass, kg, of a bolt that is a beam, its heads included."""
        lower, upper = self.ends(bolt)
        shank = bolt.rho * np.pi / 4 * bolt.diameter**2 * np.linalg.norm(upper - lower)
        return float(shank + 2 * bolt.head_mass)

    def force_values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All bolts' forces, N, and factors of the loads; nominal with ``given`` put in.

        Raises:
            InputError: If ``given`` names none of them, or is not finite or a bolt's negative.
        """
        values = dict(self.forces)
        bolts = {b.name for b in self.bolts}
        for name, value in mapping("forces", given, "forces by name").items():
            if name not in values:
                raise InputError(
                    f"{name!r} is neither a bolt nor a load; expected one of: {', '.join(values)}."
                )
            bounds = {"least": 0.0} if name in bolts else {}
            values[name] = real(name, value, "N" if bounds else "", **bounds)
        return values

    def load(self, forces: Mapping[str, float] | None = None) -> PETSc.Vec:
        """The load f in x at these forces. Collective."""
        f = self.jumps.T.createVecRight()
        f.set(0.0)
        for name, value in self.force_values(forces).items():
            if value:
                f.axpy(value, self._units[name])
        return f

    def unit_load(self, name: str) -> PETSc.Vec:
        """Derivative of the load by the force of this name."""
        return self._units[name]

    # -- matrices ----------------------------------------------------------------------------

    def stiffness(
        self,
        given: Mapping[str, float] | None = None,
        *,
        axial: bool = False,
        bodies: PETSc.Mat | None = None,
    ) -> PETSc.Mat:
        """T^T K T with the bolts' beams; entries that nothing depends on have a one.

        Args:
            given: Values of the structure's parameters that differ from their nominal value.
            axial: Whether the beams resist stretching: yes about a preload state, not during it.
            bodies: The structure's stiffness K at these values, if it is at hand; it is freed.
        """
        K = self.structure.stiffness(given) if bodies is None else bodies
        self._stiffen(K)
        return self._with_extras(self.jumps.project(K), 0, axial, 1.0)

    def _stiffen(self, K: PETSc.Mat) -> None:
        """Hold supported displacements that follow others: their row of K has but its diagonal."""
        diagonal = K.getDiagonal()
        mean = diagonal.sum() / diagonal.getSize()
        if self.comm.allreduce(len(self._following)):
            diagonal.array[self._following - self.jumps.range[0]] = _STIFF * mean
            K.setDiagonal(diagonal)
        diagonal.destroy()

    def mass(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """T^T M T with the bolts' beams and their head masses."""
        A = self.jumps.project(self.structure.mass(given))
        return self._with_extras(A, 1, True, 0.0)

    def _with_extras(self, A: PETSc.Mat, which: int, axial: bool, diagonal: float) -> PETSc.Mat:
        jumps = self.jumps
        B = PETSc.Mat().createAIJ(A.getSizes(), nnz=(12, 12), comm=self.comm)
        B.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        if jumps.owned(np.array([jumps.n - 1]))[0] and self.beams:
            for i, bolt in enumerate(self.beams):
                numbers = np.concatenate([jumps.reference(2 * i), jumps.reference(2 * i + 1)])
                block = self._beam(bolt, axial)[which]
                B.setValues(numbers.astype(np.int32), numbers.astype(np.int32), block)
        for number in jumps.unused:
            B.setValue(int(number), int(number), diagonal)
        B.assemble()
        A.axpy(1.0, B, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        B.destroy()
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        A.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        return A

    def _beam(self, bolt: BeamBolt, axial: bool):
        """Stiffness and mass, (12, 12), of a bolt condensed to its two reference points."""
        K, M = beam_matrices(
            *self.ends(bolt),
            diameter=bolt.diameter,
            E=bolt.E,
            nu=bolt.nu,
            rho=bolt.rho,
            n_elements=bolt.n_elements,
            axial=axial,
        )
        K, M = condense_to_ends(K, M)
        heads = np.zeros(12)
        heads[[0, 1, 2, 6, 7, 8]] = bolt.head_mass
        return K, M + np.diag(heads)


def _checked_shape(name: str, shape: Callable) -> Callable:
    """The function, which refuses to return other arrays than distances and normals."""

    def checked(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance, normal = (np.asarray(q, dtype=float) for q in shape(x))
        if distance.shape != x.shape[:1] or normal.shape != x.shape:
            raise InputError(
                f"{name}: expected distances, ({len(x)},), and normals, {x.shape}; got "
                f"{distance.shape} and {normal.shape}."
            )
        return distance, normal

    return checked


class FaceIntegrals:
    """Integrals over named faces of a structure, and the loads spread over them.

    On a half section they have the weight 2 pi r.

    Args:
        structure: The structure.
    """

    def __init__(self, structure: Structure):
        self.structure, self.V, self.tagged = structure, structure.V, structure.tagged

    def _ds(self, name: str):
        return ufl.Measure(
            "ds",
            domain=self.V.mesh,
            subdomain_data=self.tagged.facet_tags,
            metadata={"quadrature_degree": 4},
        )(self.tagged.facet_tag(name))

    def _weight(self):
        """Weight of the surface measure, as UFL."""
        x = ufl.SpatialCoordinate(self.V.mesh)
        return 2 * ufl.pi * x[0] if self.structure.axisymmetric else ufl.as_ufl(1.0)

    def _integral(self, form) -> float:
        return self.V.mesh.comm.allreduce(fem.assemble_scalar(fem.form(form)), op=MPI.SUM)

    def centre(self, name: str) -> np.ndarray:
        """Centroid of a face, m, (gdim,). Collective."""
        ds, x = self._ds(name), ufl.SpatialCoordinate(self.V.mesh)
        area = self._integral(1.0 * ds)
        return np.array([self._integral(x[i] * ds) / area for i in range(self.structure.gdim)])

    def forces(
        self, given: Iterable[tuple[str, np.ndarray]], profile: Callable | None = None
    ) -> PETSc.Vec:
        """Load in u of forces, N, (gdim,), spread over faces, evenly or by a profile. Collective.

        Raises:
            InputError: If the profile has no resultant.
        """
        v, weight, total = ufl.TestFunction(self.V), self._weight(), None
        q = ufl.as_ufl(1.0) if profile is None else self._function(profile)
        for name, force in given:
            ds = self._ds(name)
            area = self._integral(weight * q * ds)
            if not abs(area) > 0:
                raise InputError(f"{name}: the load's profile has no resultant there.")
            # A constant, so that one compiled form serves all forces and areas.
            traction = fem.Constant(self.V.mesh, np.asarray(force, dtype=float) / area)
            form = weight * q * ufl.dot(traction, v) * ds
            total = form if total is None else total + form
        return self._assembled(total)

    def pressure(self, name: str, pressure: float) -> PETSc.Vec:
        """Load in u of an even pressure, Pa, against a face's outward normal. Collective."""
        v, n = ufl.TestFunction(self.V), ufl.FacetNormal(self.V.mesh)
        size = fem.Constant(self.V.mesh, -float(pressure))
        return self._assembled(size * self._weight() * ufl.dot(n, v) * self._ds(name))

    def resultant(self, load: PETSc.Vec) -> np.ndarray:
        """Resultant of a load in u, N, (gdim,). Collective."""
        # Shape functions sum to one, those of moments too.
        own = load.array_r.reshape(-1, self.structure.gdim).sum(axis=0)
        return self.V.mesh.comm.allreduce(own, op=MPI.SUM)

    def _function(self, profile: Callable) -> fem.Function:
        Q = fem.functionspace(self.V.mesh, ("Lagrange", self.structure.degree))
        q = fem.Function(Q)
        q.interpolate(lambda x: profile(x[: self.structure.gdim].T))
        return q

    def _assembled(self, form) -> PETSc.Vec:
        b = fem_petsc.assemble_vector(fem.form(form))
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return b

"""Lapped beams with generic joints as a model like the solid ones (Jalali et al. 2019)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fenics_joints.beams.components import Beam, Clamp, GenericJoint, Held, LumpedMass
from fenics_joints.beams.element import (
    AXIAL,
    BEAM,
    BEAM_MASSES,
    LAPPED,
    SECTION,
    SLAP,
    SLIP,
    joint_matrices,
    mass_matrices,
    stiffness_matrices,
)
from fenics_joints.beams.layout import Layout, Stretch, lay_out
from fenics_joints.errors import InputError
from fenics_joints.reduction.affine import (
    AffinePencil,
    RegionTerm,
    TravellingMass,
    mass_term,
    spring_term,
)
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.structure import Damping, Parameter, Sensors, Spring
from fenics_joints.structure.components import by_name, number
from fenics_joints.structure.laws import ELASTIC_SUPPORT
from fenics_joints.structure.points import PlaceRows

#: Stiffness that joint elements have of their own.
JOINT_KEYS = ("k1", "k2", "k_axial")
#: Height of the box of a joint element, over that of its beams: the interface itself has none.
_INTERFACE = 0.05


@dataclass(frozen=True)
class BeamCells:
    """A box for each element of each beam, laps included, then one for each joint element.

    Attributes:
        vertices: Corners, m, in the order of DOLFINx's hexahedra, (n_cells, 8, 3).
        beam: Number of the beam of each cell; -1 for a joint element.
        lap: Number of the lap that it is in, or -1.
        element: Number of its element.
        volume: Volume, m3; of a joint element that of both beams there, whose bending stiffness
            it has.
    """

    vertices: np.ndarray
    beam: np.ndarray
    lap: np.ndarray
    element: np.ndarray
    volume: np.ndarray


def beam_cells(layout: Layout, beams: Sequence[Beam]) -> BeamCells:
    """The cells of beams."""
    of_beams, of_joints = [], []
    for stretch in layout.stretches:
        there = [beams[i] for i in stretch.beams]
        volumes = [b.breadth * b.height * stretch.length for b in there]
        lap = -1 if stretch.joint is None else stretch.joint
        for e in stretch.elements:
            ends = layout.x[e : e + 2]
            for i, b, volume in zip(stretch.beams, there, volumes, strict=True):
                z = (0.0, b.height) if i % 2 == 0 else (-b.height, 0.0)
                of_beams.append((_box(ends, b.breadth, z), i, lap, e, volume))
            if lap >= 0:
                z = 0.5 * _INTERFACE * min(b.height for b in there)
                box = _box(ends, min(b.breadth for b in there), (-z, z))
                of_joints.append((box, -1, lap, e, sum(volumes)))
    return BeamCells(*map(np.array, zip(*of_beams, *of_joints, strict=True)))


def _box(x: Sequence[float], width: float, z: tuple[float, float]) -> list:
    y = -width / 2, width / 2
    return [(x[i], y[j], z[k]) for k in range(2) for j in range(2) for i in range(2)]


#: Stations per element of the path of a mass that may move: rotation has kinks at the nodes, and
#: with fewer of them rotary inertia between two nodes moves frequencies by 1e-4.
_STATIONS = 8


@dataclass(frozen=True)
class ElementTerm:
    """Element matrices of a region of beams or joints.

    Attributes:
        beam: Number of the beam; -1 for a joint.
        elements: Numbers of its elements.
        stiffness: Matrices of an element, (m, 6, 6).
        mass: Matrix of an element, (6, 6).
    """

    beam: int
    elements: Iterable[int]
    stiffness: np.ndarray
    mass: np.ndarray


class BeamStructure(ArrayModel):
    """Beams in a row, each lapped with the next: above, below, above, ... the line of the nodes.

    K and M are exact sums over the parameters: it is an `ArrayModel` that needs no samples and no
    basis, small and dense, and the same on every rank. `arrays` gives the plain `ArrayModel`.
    Regions are beams and joints; ``NAME.slap`` and ``NAME.slip`` are a joint's k1 and k2. Dampers
    are the dashpots of slip, ``NAME.c``: see `joint_damping`.

    The plane of motion is x, z: x along the beams from the free end of the first one, z above the
    interfaces, which lie at z = 0. Sensors, masses and springs stand at (x, y, z), y of no account.

    Args:
        beams: The beams.
        joints: Their laps, one fewer.
        parameters: Parameters that the components name.
        masses: Bolts, accelerometers.
        springs: Grounding springs.
        held: Places that cannot move.
        clamps: Ends that are held elastically.
        offset_mass: Whether the mass knows of the offset, as it does in nature; False as in the
            paper, see `fenics_joints.beams.element`.

    Raises:
        InputError: For a bad dimension, an unknown parameter, a value out of range, or something
            that stands beside the beams.

    Attributes:
        layout: Nodes and elements.
        element_terms: Element matrices of the regions of beams and joints, in their order.
        slips: (label, c, matrix) of each group of joint elements with one c.
    """

    #: Coordinates of a point.
    gdim = 3

    def __init__(
        self,
        beams: Sequence[Beam],
        joints: Sequence[GenericJoint] = (),
        parameters: Sequence[Parameter] = (),
        *,
        masses: Sequence[LumpedMass] = (),
        springs: Sequence[Spring] = (),
        held: Sequence[Held] = (),
        clamps: Sequence[Clamp] = (),
        offset_mass: bool = True,
    ):
        self.beams, self.joints, self.offset_mass = tuple(beams), tuple(joints), offset_mass
        known = by_name(parameters)
        _check_distinct([*self.beams, *self.joints])
        _check_names(known, [*self.beams, *self.joints, *masses, *springs, *clamps])
        nominal = {name: p.value for name, p in known.items()}
        sections = [(number(b.nu, nominal), b.height * number(b.stretch, nominal)) for b in beams]
        self.layout = lay_out(self.beams, self.joints, held, sections)
        self.element_terms: list[ElementTerm] = []
        self.slips: list[tuple] = []
        # The first region is the first beam's: its size is the model's.
        regions = [region for stretch in self.layout.stretches for region in self._regions(stretch)]
        pencil = AffinePencil(
            known,
            [*regions, *map(self._clamp, clamps)],
            [*(_spring(self.layout, s) for s in springs), *(_mass(self.layout, m) for m in masses)],
        )
        scale_hz = _dilation_frequency(pencil, self.layout)
        super().__init__(
            pencil, scale_hz, dampers={f"{n}.c": matrix for n, _, matrix in self.slips}
        )

    # -- terms of K(p) and M(p) --------------------------------------------------------------

    def _region(self, name, law, q, term: ElementTerm, volume: float = 0.0) -> RegionTerm:
        self.element_terms.append(term)
        stiffness = self.layout.assemble(term.stiffness, term.elements)
        mass = self.layout.assemble(term.mass[None], term.elements)[0]
        return RegionTerm(name, law, q, stiffness, mass, volume)

    def _regions(self, stretch: Stretch) -> Iterator[RegionTerm]:
        """A beam, or a lap: mass and axial stiffness of the two beams, then the joint elements."""
        joint = None if stretch.joint is None else self.joints[stretch.joint]
        for i in stretch.beams:
            yield from self._beam(i, stretch, joint)
        if joint is None:
            return
        slap, slip, axial = joint_matrices(stretch.length)

        def elastic(name, law, q, matrix, elements) -> RegionTerm:
            term = ElementTerm(-1, elements, matrix[None], np.zeros((6, 6)))
            return self._region(f"{name}.{law.name}", law, q, term)

        for key, law, matrix in (("k1", SLAP, slap), ("k2", SLIP, slip)):
            for label, value, at in joint.groups(key):
                elements = [stretch.first + e for e in at]
                yield elastic(label, law, {key: value}, matrix, elements)
        if joint.k_axial is not None:
            q = {"k_axial": joint.k_axial, "axial": joint.axial}
            yield elastic(joint.name, AXIAL, q, axial, stretch.elements)
        for label, c, at in joint.groups("c"):
            damper = self.layout.assemble(slip[None], [stretch.first + e for e in at])[0]
            self.slips.append((label, c, damper))

    def _beam(self, i: int, stretch: Stretch, joint: GenericJoint | None) -> Iterator[RegionTerm]:
        """A beam, or its share of a lap: its mass, and its axial stiffness unless that is given."""
        beam, elements = self.beams[i], stretch.elements
        name = beam.name if joint is None else f"{joint.name}.{beam.name}"
        stiff, heavy = stiffness_matrices(stretch.length), mass_matrices(stretch.length)
        offset = self._offset(i)
        q = {key: getattr(beam, key, None) for key in SECTION}
        q |= {"length": stretch.length, "offset": offset}
        q["mass_offset"] = offset if self.offset_mass else 0.0
        law, more = BEAM, {}
        if joint is not None:
            law, more = LAPPED, {"axial": joint.axial}
            stiff = stiff[:1] * (joint.k_axial is None)
        volume = stretch.n * stretch.length
        yield self._region(name, law, q | more, ElementTerm(i, elements, stiff, heavy[0]), volume)
        for k, (law, mass) in enumerate(zip(BEAM_MASSES, heavy[1:], strict=True), 1):
            term = ElementTerm(i, elements, stiff[:0], mass)
            yield self._region(f"{name}.mass[{k}]", law, q, term)

    def _offset(self, i: int) -> float:
        """Height of a beam's neutral axis above the line of the nodes, over its own height."""
        given = self.beams[i].offset
        return (0.5 if i % 2 == 0 else -0.5) if given is None else given

    def _clamp(self, clamp: Clamp) -> RegionTerm:
        """Springs over a face of the nominal section."""
        i = len(self.beams) - 1 if clamp.last else 0
        beam, (u, w, turn) = self.beams[i], np.eye(3)
        middle = u - beam.height * self._offset(i) * turn
        along = np.outer(middle, middle) + beam.height**2 / 12 * np.outer(turn, turn)
        n = 3 * len(self.layout.x)
        whole, at = np.zeros((2, n, n)), slice(n - 3, n) if clamp.last else slice(0, 3)
        whole[:, at, at] = beam.breadth * beam.height * np.array([along, np.outer(w, w)])
        whole = whole[:, self.layout.free[:, None], self.layout.free]
        q = {"k_n": clamp.k_n, "k_t": clamp.k_t}
        return RegionTerm(clamp.name, ELASTIC_SUPPORT, q, whole, np.zeros_like(whole[0]), 0.0)

    # -- the calls of a model ----------------------------------------------------------------

    @property
    def size_m(self) -> np.ndarray:
        """Extents along x, y and z, nominal, m, shape (3,)."""
        z = [b.height * (1 if i % 2 == 0 else -1) for i, b in enumerate(self.beams)]
        width = max(b.breadth for b in self.beams)
        return np.array([np.ptp(self.layout.x), width, max(z) - min(*z, 0.0)])

    @cached_property
    def cells(self) -> BeamCells:
        """A box for each element."""
        return beam_cells(self.layout, self.beams)

    def corner_motion(self, shapes: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the elements of beams, m, (n_cells, 8, 3), and how they move in shapes,
        (n_shapes, n_cells, 8, 3); the same on every rank."""
        corners = self.cells.vertices[self.cells.beam >= 0]
        rows = self.displacement_rows(corners.reshape(-1, 3))
        return corners, np.array([(rows @ x).reshape(corners.shape) for x in shapes])

    def rings(self) -> tuple:
        """None: these joints have no layers."""
        return ()

    def observe(self, shapes: np.ndarray, sensors: Sensors) -> np.ndarray:
        """Shapes at sensors, shape (n_sensors, n_shapes)."""
        return self.read(sensors)[0] @ shapes

    def loads(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """Loads of one newton at points, and what sensors there read, (n_dofs, n_sensors).

        Raises:
            InputError: If one is beside the beams; ``what`` is its name there.
        """
        return self.read(sensors, what)[0].T

    def read(self, sensors: Sensors, what: str = "sensor") -> tuple[np.ndarray, np.ndarray]:
        """Readings of sensors, and their derivatives by the sensors' positions along x.

        Returns:
            Two arrays (n_sensors, n_dofs).

        Raises:
            InputError: If a sensor is beside the beams.
        """
        if sensors.points.shape[1] != 3:
            raise InputError(
                f"{what}s have points of {sensors.points.shape[1]} components: expected (x, y, z)."
            )
        found = np.array([self.layout.rows(point, what) for point in sensors.points])
        return tuple(np.einsum("sd,skdn->ksn", sensors.directions[:, [0, 2]], found[:, :, :2]))

    def displacement_rows(self, points: np.ndarray) -> np.ndarray:
        """The whole displacement at points (x, y, z), m: shape (n_points, 3, n_dofs), y of it zero.

        Raises:
            InputError: If a point is beside the beams.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        rows = np.zeros((len(points), 3, self.n_dofs))
        for i, point in enumerate(points):
            rows[i, [0, 2]] = self.layout.rows(point)[0][:2]
        return rows

    def arrays(self, sensors: Sensors | None = None, *places: Sensors) -> ArrayModel:
        """The structure as plain arrays: exact, no reduction.

        Args:
            sensors: Sensors of its ``sensor_rows``.
            places: Further excitations and sensors, for functions.

        Raises:
            InputError: If a point is beside the beams.
        """
        rows = None, None
        if sensors is not None:
            at, along = self.read(sensors)
            rows = at, along[None]
        there = [s for s in (sensors, *places) if s is not None]
        points = np.unique(np.vstack([np.zeros((0, 3)), *(s.points for s in there)]), axis=0)
        places = PlaceRows(points, self.displacement_rows(points))
        return ArrayModel(self.pencil, self.scale_hz, *rows, places, self.dampers)

    # -- damping -----------------------------------------------------------------------------

    def damping_matrix(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """C(p) of eq. 3, N s/m, shape (n_dofs, n_dofs).

        Raises:
            InputError: If a c is negative.
        """
        values = self.values(given)
        total = np.zeros((self.n_dofs, self.n_dofs))
        for label, c, matrix in self.slips:
            c = number(c, values)
            if not 0 <= c < np.inf:
                raise InputError(f"{label}.c = {c:g}: expected a damping >= 0 N m s.")
            total += c * matrix
        return total

    def resolved(self, damping: Damping) -> Damping:
        """A damping that names beams and joints, by names of regions, and `joint_damping`.

        A beam or joint is all of its stiffness: of a beam itself, with its axial stiffness in the
        laps; of a joint slap, slip and its own axial stiffness.
        """
        viscous, hysteretic = (
            {region: value for name, value in own.items() for region in self._stiff(name)}
            for own in (damping.viscous, damping.hysteretic)
        )
        viscous |= self.joint_damping().viscous
        return replace(damping, viscous=viscous, hysteretic=hysteretic)

    def _stiff(self, name: str) -> Iterator[str]:
        """Regions with stiffness whose properties are those of a section of a case."""
        for region in self.regions:
            owners = {p.partition(".")[0] for p in region.properties.values() if isinstance(p, str)}
            if name in owners and len(region.stiffness):
                yield region.name

    def joint_damping(self) -> Damping:
        """The same damping as FRFs and complex modes take it: a dashpot ``NAME.c`` of each joint.

        A c that is a parameter stays one, so that both have derivatives by it. Damping of other
        kinds can be put beside it: ``replace(beams.joint_damping(), structural=1e-3)``.
        """
        return Damping(viscous={f"{label}.c": c for label, c, _ in self.slips})


def _mass(layout: Layout, mass: LumpedMass) -> RegionTerm | TravellingMass:
    """A lumped mass, with the path that it may take."""
    moves = isinstance(mass.travel, str)
    if moves and mass.range is None:
        raise InputError(f"{mass.name}.range is missing: expected the range of its travel, m.")
    low, high = mass.range if moves else (float(mass.travel),) * 2
    step = np.min(np.diff(layout.x)) / _STATIONS
    n = 1 if low == high else max(4, int(np.ceil((high - low) / step)) + 1)
    stations = np.linspace(low, high, n)
    x, y, z = mass.point
    rows = np.array([layout.rows((x + s, y, z), mass.name)[0] for s in stations])
    # Scaled by the radius of gyration, the rotation's share of the mass is the rotary inertia.
    rows[:, 2] *= mass.radius
    travel = mass.travel if moves else low
    return mass_term(mass.name, mass.mass, travel, mass.share, stations, rows)


def _spring(layout: Layout, spring: Spring) -> RegionTerm:
    """A grounding spring."""
    at, _ = layout.rows(spring.point, spring.name)
    direction = np.asarray(spring.direction, dtype=float)
    if direction.shape != (3,) or not np.any(direction[[0, 2]]):
        raise InputError(
            f"{spring.name}.direction = {spring.direction}: expected (x, y, z) with a share "
            "along x or z, in which beams move."
        )
    return spring_term(spring.name, spring.stiffness, spring.share, direction[[0, 2]] @ at[:2])


def _dilation_frequency(pencil: AffinePencil, layout: Layout) -> float:
    """Frequency, Hz, at which the beams would stretch evenly along x: a scale for shifts.

    Clamps, which may be as good as rigid, are left out.
    """
    values = pencil.values()
    x = np.repeat(layout.x - layout.x.mean(), 3)[layout.free]
    shape = np.where(layout.free % 3 == 0, x, 0.0)
    bodies = [r for r in pencil.regions if r.law is not ELASTIC_SUPPORT]
    K, M = replace(pencil, regions=bodies).assemble(values)
    if not pencil.total_mass(values) > 0:
        raise InputError("the structure has no mass: expected a density > 0 in some beam.")
    return float(np.sqrt((shape @ K @ shape) / (shape @ M @ shape)) / (2 * np.pi))


def _check_distinct(components: Sequence) -> None:
    names = [component.name for component in components]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"{name} is the name of two beams or joints: expected each once.")


def _check_names(known: Mapping[str, Parameter], components: Sequence) -> None:
    """Every string but a component's own name must be a parameter's."""
    for component in components:
        for key, value in vars(component).items():
            if key == "name":
                continue
            for one in value if isinstance(value, tuple | list) else [value]:
                if isinstance(one, str) and one not in known:
                    raise InputError(
                        f"{component.name}.{key} = {one!r}: no such parameter; expected a number "
                        f"or one of: {', '.join(known) or 'none'}."
                    )


def cell_energies(
    structure: BeamStructure, vectors: np.ndarray, given: Mapping[str, float] | None = None
) -> dict[str, np.ndarray]:
    """x^T K x of each cell by E, k1, k2 and k_axial, and x^T M x by rho, (n_cells, m).

    Args:
        structure: The beams.
        vectors: x as columns, (n_dofs, m).
        given: Values of parameters that differ from their nominal value.
    """
    cells, whole = structure.cells, structure.layout.at_nodes(vectors).reshape(-1, len(vectors.T))
    place = {key: c for c, key in enumerate(zip(cells.beam, cells.element, strict=True))}
    found = {key: np.zeros((len(place), len(vectors.T))) for key in ("E", "rho", *JOINT_KEYS)}
    values = structure.values(given)
    for term, region in zip(structure.element_terms, structure.regions, strict=False):
        q = region.values(values)
        stiff = np.tensordot(np.asarray(region.law.stiffness_terms(q)), term.stiffness, 1)
        heavy = region.law.inertia_term(q) * term.mass
        for e in term.elements:
            x, c = whole[3 * e : 3 * e + 6], place[term.beam, e]
            # The first property of each law is what its stiffness is in proportion to.
            found[region.law.properties[0]][c] += np.sum(x * (stiff @ x), axis=0)
            found["rho"][c] += np.sum(x * (heavy @ x), axis=0)
    return found

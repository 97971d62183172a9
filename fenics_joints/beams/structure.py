"""Lapped beams with generic joints as a model like the solid ones (Jalali et al. 2019)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from fenics_joints.beams.assembly import Assembly
from fenics_joints.beams.boxes import BeamCells, beam_cells
from fenics_joints.beams.components import Beam, Clamp, GenericJoint, Held, LumpedMass
from fenics_joints.beams.layout import Layout, lay_out
from fenics_joints.errors import InputError
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.structure import Damping, Parameter, Sensors, Spring
from fenics_joints.structure.laws import ELASTIC_SUPPORT
from fenics_joints.structure.rows import PlaceRows
from fenics_joints.structure.values import by_name, number


class BeamStructure(ArrayModel):
    """Beams in a row, each lapped with the next: above, below, above, ... the line of the nodes.

    K, M are exact sums over the parameters, so that it is an `ArrayModel`, without a sample or a
    basis; `arrays` has it without what is of beams alone. All of it is small and dense, and the
    same on every rank. Regions are beams and joints; ``NAME.slap``, ``NAME.slip`` are a joint's k1,
    k2. Dampers are the dashpots of slip, ``NAME.c``: see `joint_damping`.

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
        assembly = Assembly(self.layout, self.beams, self.joints, offset_mass)
        regions, self.slips = assembly.regions()
        regions += [assembly.clamp(clamp) for clamp in clamps]
        dampers = {f"{label}.c": matrix for label, _, matrix in self.slips}
        pencil = AffinePencil(
            known,
            regions,
            [assembly.spring(s) for s in springs],
            [assembly.mass(m) for m in masses],
        )
        scale_hz = _dilation_frequency(pencil, self.layout)
        super().__init__(pencil, scale_hz, dampers=dampers)

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
        """What sensors read, and the same per metre that they sit further along x.

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
            sensors: What its ``sensor_rows`` see.
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
            total += _damping(label, number(c, values)) * matrix
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


def _dilation_frequency(pencil: AffinePencil, layout: Layout) -> float:
    """Frequency, Hz, at which the beams would stretch evenly along x: a scale for shifts.

    Clamps, which may be as good as rigid, are left out.
    """
    values = pencil.values()
    x = np.repeat(layout.x - layout.x.mean(), 3)[layout.free]
    shape = np.where(layout.free % 3 == 0, x, 0.0)
    bodies = [r for r in pencil.regions if r.law is not ELASTIC_SUPPORT]
    K, M = replace(pencil, regions=bodies).matrices(values)
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


def _damping(label: str, c: float) -> float:
    if not 0 <= c < np.inf:
        raise InputError(f"{label}.c = {c:g}: expected a damping >= 0 N m s.")
    return c

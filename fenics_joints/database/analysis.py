"""Contact radius and pressure of two plates under one bolt, as the database's sweep asks for it.

The plates are round, equal unless said, and a body of revolution; what presses them is, by choice,
rings on their outer faces, washers as bodies, or a whole bolt with its pretension (Machines 2022,
section 3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from fenics_joints.database.sweep import Sample
from fenics_joints.errors import InputError, member, real, whole
from fenics_joints.preload.threads import Thread, thread

MODELS = ("plates", "washers", "bolt")
#: Most cells near the joint of one analysis.
_CELLS = 1e6


@dataclass(frozen=True)
class BoltedPlates:
    """Settings of the analysis; lengths in m. None for what the thread's table says.

    Attributes:
        model: ``plates`` (rings on the plates carry the force), ``washers`` (bodies in contact with
            the plates, with rings on them), or ``bolt`` (with washers and a bolt cut at the plates'
            interface, whose force is given).
        friction: Coulomb's coefficient between the plates.
        washer_friction: Under washers and heads.
        loaded_diameter: Outer diameter of the loaded ring: on the plates that of the washer, on
            washers the width across flats; with ``bolt`` the diameter of head and nut.
        washer_diameter: Outer diameter of washers that are bodies.
        washer_thickness: Of washers that are bodies.
        hole_diameter: Of the plates' holes.
        plate_radius: Outer radius of the plates.
        upper_thickness: Thickness of the upper plate over that of the lower one.
        E: Young's modulus of all parts, Pa. With rigid contact nothing here depends on it.
        nu: Poisson's ratio of all parts.
        penalty: Stiffness of the plates' contact, Pa/m, for soft contact; None for contact without
            penetration. Of frictionless ``plates`` only.
        size: Longest side of a cell near the joint.
        degree: Of the elements, 1 or 2.
        P_lim: Pressure that ends the contact radius, Pa (eq. 10).
    """

    model: str = "plates"
    friction: float = 0.0
    washer_friction: float = 0.0
    loaded_diameter: float | None = None
    washer_diameter: float | None = None
    washer_thickness: float | None = None
    hole_diameter: float | None = None
    plate_radius: float = 0.15
    upper_thickness: float = 1.0
    E: float = 210e9
    nu: float = 0.3
    penalty: float | None = None
    size: float = 1e-3
    degree: int = 1
    P_lim: float = 1e6

    def __post_init__(self) -> None:
        member("model", self.model, MODELS)
        whole("degree", self.degree, 1, 2)
        if not -1 < real("nu", self.nu) < 0.5:
            raise InputError(f"nu = {self.nu!r}: expected a number between -1 and 0.5")
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name in ("model", "degree", "nu") or (value is None and f.default is None):
                continue
            real(f.name, value, **{"least" if "friction" in f.name else "above": 0.0})
        if self.penalty is not None and (self.model != "plates" or self.friction > 0):
            raise InputError("penalty: expected only with model = 'plates' and friction = 0")

    @classmethod
    def of(cls, settings: Mapping[str, object]) -> BoltedPlates:
        """From keyword arguments.

        Raises:
            InputError: For a name that is no setting, or a value out of range.
        """
        names = [f.name for f in fields(cls)]
        for name in settings:
            if name not in names:
                raise InputError(f"setting {name!r}: expected one of {', '.join(names)}")
        return cls(**settings)

    def dimensions(self, bolt: Thread, thickness: float) -> dict[str, object]:
        """Arguments of the mesh builders, but for communicator and counts."""
        loaded = {"plates": bolt.washer_outer_diameter}.get(self.model, bolt.width_across_flats)
        loaded = self.loaded_diameter or loaded
        washer = self.washer_diameter or max(bolt.washer_outer_diameter, loaded)
        washer = loaded if self.model == "plates" else washer
        pair = thickness, thickness * self.upper_thickness
        # The contact ends at about the loaded radius and 1.1 of the thickness.
        fine = min(self.plate_radius, washer / 2 + 1.3 * max(pair))
        least = math.sqrt(fine * sum(pair) / _CELLS)
        if self.size < least:
            raise InputError(
                f"size = {self.size:g}: expected at least {least:.2g} m for plates of "
                f"{thickness:g} m, which are {_CELLS:g} cells then"
            )
        return {
            "parts": self.model,
            "thickness": pair,
            "radius": self.plate_radius,
            "hole_diameter": self.hole_diameter or bolt.hole_diameter,
            "washer_diameter": washer,
            "washer_thickness": self.washer_thickness or bolt.washer_thickness,
            "washer_hole": bolt.washer_inner_diameter,
            "head_diameter": loaded,
            "head_height": bolt.head_height,
            "bolt_diameter": bolt.diameter,
            "size": self.size,
            "fine_radius": fine,
        }


def bolted_plates_radius(sample: Sample, **settings) -> dict[str, float]:
    """Contact radius and mean pressure of a sample, for `fenics_joints.database.sweep.sweep`.

    Args:
        sample: Bolt, force and thickness of one plate. Its roughness must be None: the surfaces
            of this model are smooth.
        settings: See `BoltedPlates`.

    Returns:
        radius: R_wai = max {r : P(r) >= P_lim}, m, within the element (Machines 2022, eq. 10).
        pressure: Mean inside that radius, Pa.

    Raises:
        InputError: For a setting or dimension out of range, or if the pressure reaches P_lim
            nowhere, or up to the rim.
        ConvergenceError: If the contact is not solved.
    """
    given = BoltedPlates.of(settings)
    if sample.roughness is not None:
        raise InputError(
            f"roughness = {sample.roughness!r}: this model's surfaces are smooth; expected none"
        )
    result = solve_bolted_plates(sample.bolt, sample.thickness, sample.force, given)
    result.solver.destroy()  # a sweep has many samples
    state = result["plates"]
    radius = state.radius(given.P_lim)
    if radius == 0.0:
        raise InputError(f"the pressure reaches P_lim = {given.P_lim:g} Pa nowhere")
    if radius >= given.plate_radius * (1 - 1e-9):
        raise InputError(
            f"the pressure is P_lim = {given.P_lim:g} Pa up to the rim, plate_radius = "
            f"{given.plate_radius:g} m; expected a larger one"
        )
    return {"radius": radius, "pressure": state.mean_pressure(given.P_lim)}


def solve_bolted_plates(
    bolt: str,
    thickness: float,
    force: float,
    settings: BoltedPlates | None = None,
    *,
    comm=None,
    gap=0.0,
    tagged=None,
):
    """Preload two plates; the contact between them is called ``plates``.

    Args:
        bolt: Name of the thread.
        thickness: Of the lower plate, m.
        force: Of the bolt, N.
        settings: Settings of the model.
        comm: Communicator, of this process alone by default.
        gap: Initial gap of the plates, m, as `fenics_joints.preload.Contact` takes it.
        tagged: Mesh in place of the section, from `fenics_joints.meshes.bolted_plates` with
            ``settings.dimensions``; may be three-dimensional.

    Returns:
        `fenics_joints.preload.PreloadResult`.
    """
    from mpi4py import MPI

    from fenics_joints.meshes import bolted_plates_section
    from fenics_joints.preload import PreloadModel, solve_preload
    from fenics_joints.structure import Structure, Support, part

    s = settings or BoltedPlates()
    if tagged is None:
        dimensions = s.dimensions(thread(bolt), thickness)
        tagged = bolted_plates_section(MPI.COMM_SELF if comm is None else comm, **dimensions)
    parts = [part("all", tuple(tagged.cell_names), E=s.E, nu=s.nu, rho=7850.0)]
    faces = {"symmetry_x": 0, "symmetry_y": 1, "axis": 0}
    planes = [Support(f, (i,)) for f, i in faces.items() if f in tagged.facet_names]
    flat = tagged.mesh.geometry.dim == 2
    structure = Structure(tagged, parts, supports=planes, degree=s.degree, axisymmetric=flat)
    share = 0.25 if "symmetry_x" in tagged.facet_names else 1.0
    model = PreloadModel(structure, _contacts(s, gap), [_bolt(s, force * share)])
    options = {} if s.penalty is None else {"method": "penalty", "penalty": s.penalty}
    return solve_preload(model, **options)


def _contacts(s: BoltedPlates, gap) -> list:
    from fenics_joints.preload import Contact

    faces = "interface_lower", "interface_upper"
    contacts = [Contact("plates", *faces, friction=s.friction, gap=gap)]
    for name in {"plates": (), "washers": ("seat",), "bolt": ("seat", "head")}[s.model]:
        for pair in (f"{name}_1", f"{name}_2"):
            faces = f"{pair}_lower", f"{pair}_upper"
            contacts.append(Contact(pair, *faces, friction=s.washer_friction))
    return contacts


def _bolt(s: BoltedPlates, force: float):
    from fenics_joints.preload import PretensionSection, WasherForce

    if s.model == "bolt":
        return PretensionSection("bolt", "section_lower", "section_upper", force)
    face = {"plates": "washer", "washers": "load"}[s.model]
    return WasherForce("bolt", f"{face}_1", f"{face}_2", force)

"""The ``[mesh]`` section of a case file that reads an assembly from CAD."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from mpi4py import MPI
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from fenics_joints.case.mesh_section import MeshSection
from fenics_joints.case.preload import known_thread
from fenics_joints.case.values import (
    Count,
    File,
    Length,
    Positive,
    Section,
    Size,
    listed,
    named,
    quantity,
)
from fenics_joints.database import Surfaces, TorqueToForce, query, seed_database
from fenics_joints.errors import InputError
from fenics_joints.meshes import TaggedMesh, read_step
from fenics_joints.parallel import on_root
from fenics_joints.preload.clearance import cone_radius
from fenics_joints.preload.threads import thread
from fenics_joints.preload.torque import nut_factor_force
from fenics_joints.units import to_si

STEP_SUFFIXES = (".step", ".stp", ".p21")
#: Least and largest hole of a thread as shares of its diameter: tapped, and coarse (ISO 273).
_HOLES = (0.8, 1.25)

_Space = Annotated[list[Length], Field(min_length=3, max_length=3)]
_Sizes = Annotated[list[Size], BeforeValidator(listed), Field(min_length=1)]
_OneOrTwo = Annotated[list[Size], BeforeValidator(listed), Field(min_length=1, max_length=2)]
_Pair = Annotated[list[str], Field(min_length=2, max_length=2)]


def _place(value: Any) -> str | int | list[float]:
    """A solid by its label, its number, or a point inside."""
    if isinstance(value, list) and len(value) == 3:
        return [to_si(item, "m") for item in value]
    if isinstance(value, str | int) and not isinstance(value, bool):
        return value
    raise ValueError("expected a label in the file, a number from 1, or a point inside")


def _points(value: Any) -> Any:
    """A list of points, also of a single one."""
    nested = isinstance(value, list) and value and isinstance(value[0], list)
    return value if nested else [value]


_Place = Annotated[Any, BeforeValidator(_place)]
_Points = Annotated[list[_Space], BeforeValidator(_points), Field(min_length=1)]


class MeshFile(MeshSection):
    """``[mesh]`` with a file."""

    origin = "file"
    file: File
    degree: Literal[1, 2] = 2


class BoltsSection(Section):
    """``[mesh.bolts]``: rings of the transition layer around the bolts.

    ``r_wai`` is their outer radius, one or one for each; or the contact radius of the thread and
    ``torque`` (T = K d F with ``nut_factor`` K) in plates of a ``thickness``, from the database
    that comes with the package (Machines 2022, Table 2). ``r_nei`` is the wider hole's radius by
    default. ``at`` has the bolts' centres; without it they are in all pairs of holes whose
    diameter is ``hole``, or within [low, high], or fits the ``thread``.

    Without ``r_wai`` and ``torque``, or with ``spread = "cone"``, it is that of a cone under the
    bolt's head through a plate of that ``thickness``
    (`fenics_joints.preload.clearance.cone_radius`). ``force``, or ``torque``, of one bolt is also
    what the joints' starting stiffness is from (`fenics_joints.case.starting`).
    """

    r_wai: _Sizes | None = None
    r_nei: Size | None = None
    at: _Points | None = None
    hole: _OneOrTwo | None = None
    thread: Annotated[str, AfterValidator(known_thread)] | None = None
    torque: quantity("N*m", 0, above=True) | None = None
    force: quantity("N", 0, above=True) | None = None
    spread: Literal["database", "cone"] | None = None
    thickness: Size | None = None
    nut_factor: Positive = 0.2

    @model_validator(mode="after")
    def _one_way(self) -> BoltsSection:
        if (self.r_wai is None) == (self.thickness is None):
            raise ValueError(
                "expected either r_wai, or thread, torque and thickness (or thread and thickness, "
                "for a cone under the head)"
            )
        if self.thread is None and (self.torque is not None or self.thickness is not None):
            key = "thickness" if self.torque is None else "torque"
            raise ValueError(f"{key} needs the thread, such as thread = 'M12'")
        if self.torque is not None and self.force is not None:
            raise ValueError("expected either force or torque, not both")
        if self.spread == "database" and self.torque is None and self.r_wai is None:
            raise ValueError("spread = 'database' needs the torque")
        return self

    def preload(self) -> float | None:
        """Force of one bolt, N; T = K d F."""
        if self.torque is None:
            return self.force
        return nut_factor_force(self.torque, thread(self.thread).diameter, self.nut_factor)

    def extent(self) -> tuple[list[float], str]:
        """Outer radius of the rings, m, one or one for each, and where it is from, in words.

        Raises:
            InputError: If the database has no answer.
        """
        if self.r_wai is not None:
            return self.r_wai, "as given"
        if self.torque is None or self.spread == "cone":
            words = f"a cone of 30 degrees under the head of {self.thread}, Shigley, after Osgood"
            head = thread(self.thread).width_across_flats / 2
            return [cone_radius(head, self.thickness)], words
        return [self.radius()], "contact radius from the package's database, Machines 2022, Table 2"

    def inner(self) -> float:
        """Inner radius of the rings, m, as far as it is known without the mesh."""
        if self.r_nei is not None:
            return self.r_nei
        if self.hole is not None:
            return max(self.hole) / 2
        return 0.0 if self.thread is None else thread(self.thread).hole_diameter / 2

    def arguments(self) -> dict[str, Any]:
        """Arguments of `fenics_joints.meshes.read_step`.

        Raises:
            InputError: If the database has no answer.
        """
        hole = None
        if self.hole is not None:
            hole = min(self.hole), max(self.hole)
        elif self.thread is not None:
            hole = tuple(share * thread(self.thread).diameter for share in _HOLES)
        radii, _ = self.extent()
        return {
            "r_wai": radii[0] if len(radii) == 1 else radii,
            "r_nei": self.r_nei,
            "bolts": self.at,
            "hole": hole,
        }

    def radius(self) -> float:
        """Contact radius of the thread and the torque, m, from the package's database."""
        try:
            with seed_database() as store:
                answer = query(
                    Surfaces.fit(store, outputs=["radius"]),
                    bolt=self.thread,
                    thickness=self.thickness,
                    torque=self.torque,
                    torque_to_force=TorqueToForce(self.nut_factor),
                )
        except InputError as error:
            raise InputError(f"mesh.bolts: {error}; expected r_wai, or spread = 'cone'") from error
        return answer.radius.value


class JoinedMesh(MeshFile):
    """``[mesh]`` with a file of parts that are to be joined where they touch.

    There are rings with ``[mesh.bolts]``; ``joint = "layer"`` is a layer on all that touches, and
    ``joint = "contact"`` separate parts. ``layer`` is the layers' thickness; without it they are
    so thin that nothing is moved.
    """

    joint: Literal["rings", "layer", "contact"] | None = None
    layer: Size | None = None
    bonded: list[_Pair] | None = None
    between: list[_Pair] | None = None
    bolts: BoltsSection | None = None

    @property
    def grows(self) -> bool:
        """See `MeshSection.grows`."""
        return self.layer is None and self.joint != "contact"

    def bolt_points(self) -> tuple[str, Any]:
        """See `MeshSection.bolt_points`."""
        return "mesh.bolts.at", None if self.bolts is None else self.bolts.at

    @model_validator(mode="after")
    def _bolts_for_rings(self) -> JoinedMesh:
        rings = self.joint in (None, "rings")
        if self.joint == "rings" and self.bolts is None:
            raise ValueError("joint = 'rings' needs a section [mesh.bolts]")
        if self.bolts is not None and not rings:
            raise ValueError(f"[mesh.bolts] is given: expected joint = 'rings', not {self.joint!r}")
        return self


class StepMesh(JoinedMesh):
    """``[mesh]`` with a STEP file: arguments of `fenics_joints.meshes.read_step`.

    ``size`` is its ``element_size``. There are rings with ``[mesh.bolts]``, else a ``layer`` on all
    that touches, or with ``joint = "contact"`` separate parts. Without ``layer`` nothing is moved.
    """

    size: Size
    n_layer: Count | None = None
    ring_size: Size | None = None
    circle: Annotated[int, Field(ge=6, le=10_000, strict=True)] | None = None
    parts: named(_Place) | None = None
    faces: named(_Points) | None = None

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """See `MeshSection.build`."""
        given = self.model_dump(exclude={"file", "degree", "size", "bolts"}, exclude_none=True)
        given["joint"] = self.joint or ("layer" if self.bolts is None else "rings")
        more = {} if self.bolts is None else comm.bcast(on_root(comm, self.bolts.arguments))
        return read_step(folder / self.file, comm, element_size=self.size, **given, **more)

"""The ``[mesh]`` section of a case file that reads an assembly from CAD."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from mpi4py import MPI
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

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
from fenics_joints.preload.threads import thread
from fenics_joints.units import to_si

__all__ = ["STEP_SUFFIXES", "BoltsSection", "MeshFile", "StepMesh"]

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


class MeshFile(Section):
    """``[mesh]`` with a file."""

    file: File
    degree: Literal[1, 2] = 2

    def read(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh; ``folder`` is the case's. Collective."""
        raise NotImplementedError


class BoltsSection(Section):
    """``[mesh.bolts]``: rings of the transition layer around the bolts.

    ``r_wai`` is their outer radius, one or one for each; or the contact radius of the thread and
    ``torque`` (T = K d F with ``nut_factor`` K) in plates of a ``thickness``, from the database
    that comes with the package (seed 000, Table 2). ``r_nei`` is the wider hole's radius by
    default. ``at`` has the bolts' centres; without it they are in all pairs of holes whose
    diameter is ``hole``, or within [low, high], or fits the ``thread``.
    """

    r_wai: _Sizes | None = None
    r_nei: Size | None = None
    at: _Points | None = None
    hole: _OneOrTwo | None = None
    thread: Annotated[str, AfterValidator(known_thread)] | None = None
    torque: quantity("N*m", 0, above=True) | None = None
    thickness: Size | None = None
    nut_factor: Positive = 0.2

    @model_validator(mode="after")
    def _one_way(self) -> BoltsSection:
        asked = [self.torque is not None, self.thickness is not None]
        if (self.r_wai is None) != all(asked) or any(asked) != all(asked):
            raise ValueError("expected either r_wai, or thread, torque and thickness")
        if all(asked) and self.thread is None:
            raise ValueError("torque needs the thread, such as thread = 'M12'")
        return self

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
        radii = [self.radius()] if self.r_wai is None else self.r_wai
        return {
            "r_wai": radii[0] if len(radii) == 1 else radii, "r_nei": self.r_nei,
            "bolts": self.at, "hole": hole,
        }  # fmt: skip

    def radius(self) -> float:
        """Contact radius of the thread and the torque, m, from the package's database."""
        try:
            with seed_database() as store:
                answer = query(
                    Surfaces.fit(store, outputs=["radius"]), bolt=self.thread,
                    thickness=self.thickness, torque=self.torque,
                    torque_to_force=TorqueToForce(self.nut_factor),
                )  # fmt: skip
        except InputError as error:
            raise InputError(f"mesh.bolts: {error}; expected r_wai instead") from error
        return answer.radius.value


class StepMesh(MeshFile):
    """``[mesh]`` with a STEP file: arguments of `fenics_joints.meshes.read_step`.

    ``size`` is its ``element_size``. There are rings with ``[mesh.bolts]``, else a ``layer`` on all
    that touches, or with ``joint = "contact"`` separate parts.
    """

    size: Size
    joint: Literal["rings", "layer", "contact"] | None = None
    layer: Size | None = None
    n_layer: Count | None = None
    ring_size: Size | None = None
    circle: Annotated[int, Field(ge=6, le=10_000, strict=True)] | None = None
    bonded: list[_Pair] | None = None
    between: list[_Pair] | None = None
    parts: named(_Place) | None = None
    faces: named(_Points) | None = None
    bolts: BoltsSection | None = None

    @model_validator(mode="after")
    def _bolts_for_rings(self) -> StepMesh:
        rings = self.joint in (None, "rings")
        if self.joint == "rings" and self.bolts is None:
            raise ValueError("joint = 'rings' needs a section [mesh.bolts]")
        if self.bolts is not None and not rings:
            raise ValueError(f"[mesh.bolts] is given: expected joint = 'rings', not {self.joint!r}")
        return self

    def read(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh; ``folder`` is the case's. Collective."""
        given = self.model_dump(exclude={"file", "degree", "size", "bolts"}, exclude_none=True)
        given["joint"] = self.joint or ("layer" if self.bolts is None else "rings")
        more = {} if self.bolts is None else comm.bcast(on_root(comm, self.bolts.arguments))
        return read_step(folder / self.file, comm, element_size=self.size, **given, **more)

"""The case: a structure, its test, and what to do with them, as data; `load_case` reads one."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from fenics_joints.case.harmonic import HarmonicSection, NonlinearSection
from fenics_joints.case.mesh import Mesh
from fenics_joints.case.own_code import find_all, reading
from fenics_joints.case.preload import (
    APPLIED,
    Bolt,
    ContactSection,
    DisplacementSection,
    LoadSection,
    ObstacleSection,
)
from fenics_joints.case.sections import (
    Attached,
    AttachedMass,
    DampingSection,
    Diagnose,
    JointSection,
    MassSection,
    PartSection,
    SpringSection,
    SupportSection,
    with_average_densities,
)
from fenics_joints.case.test import Test
from fenics_joints.case.update import UpdateSection
from fenics_joints.case.values import CaseSection, FileName, named
from fenics_joints.errors import InputError, located
from fenics_joints.formatting import printable
from fenics_joints.measurements import (
    MeasuredBackbone,
    MeasuredCurves,
    MeasuredFRFs,
    MeasuredShapes,
    TestData,
)
from fenics_joints.measurements.amplitude import by_mode, test_by_level, with_modes_at_rest
from fenics_joints.structure.points import Sensors
from fenics_joints.units import parameter_unit, to_si


class Case(CaseSection):
    """A whole case; make one with `load_case`.

    Attributes:
        title: Title for people.
        mesh: Where the mesh comes from.
        parts: Solid parts by name.
        joints: Thin layers by name.
        contacts: Contacts between bodies, by name.
        bolts: Bolts that press them, by name.
        obstacles: Rigid planes, balls and cylinders that faces may touch, by name. Each rests, is
            moved by its ``travel``, or is pushed by a ``force`` against the bodies.
        displacements: Faces that are moved by given displacements in the preload, by name.
        loads: Forces and pressures on faces in the preload, by name.
        masses: Known masses, by name.
        springs: Known springs to the ground, by name.
        supports: Held facets and points, by name.
        attached: Masses and springs on the structure that are not in the nominal model, by name.
        test: The test, or None.
        update: What to update, or None.
        diagnose: What a diagnosis may assume.
        nonlinear: Laws of nonlinear joints and contacts, by the name of the joint or contact.
        harmonic: Responses to sinusoidal forces that are wanted, or None.
        damping: Linear damping of the model, or None.
    """

    title: str = ""
    mesh: Mesh
    parts: Annotated[named(PartSection), Field(min_length=1)]
    joints: named(JointSection) = {}
    contacts: named(ContactSection) = {}
    bolts: named(Bolt) = {}
    obstacles: named(ObstacleSection) = {}
    displacements: named(DisplacementSection) = {}
    loads: named(LoadSection) = {}
    masses: named(MassSection) = {}
    springs: named(SpringSection) = {}
    supports: named(SupportSection) = {}
    attached: named(Attached) = {}
    test: Test | None = None
    update: UpdateSection | None = None
    diagnose: Diagnose = Diagnose()
    nonlinear: named(NonlinearSection) = {}
    harmonic: HarmonicSection | None = None
    damping: DampingSection | None = None

    def __repr__(self) -> str:
        tables = ("parts", "joints", "contacts", "bolts", *APPLIED, "masses", "springs", "supports")
        sizes = ", ".join(f"{len(getattr(self, t))} {t}" for t in tables if getattr(self, t))
        return f"Case({self._path.name}: {sizes})"

    @model_validator(mode="after")
    def _averages(self) -> Case:
        self.joints.update(with_average_densities(self.joints, self.parts))
        return self

    _path: Path = PrivateAttr(Path("case.toml"))
    _coarse: Mesh | None = PrivateAttr(None)
    _measured: TestData | None = PrivateAttr(None)
    _planned: TestData | None = PrivateAttr(None)
    _changed: dict[str, TestData] = PrivateAttr(default_factory=dict)
    _validation: TestData | None = PrivateAttr(None)
    _joint_notes: tuple[str, ...] = PrivateAttr(())
    _curves: MeasuredCurves | None = PrivateAttr(None)
    _backbones: dict[str, MeasuredBackbone] = PrivateAttr({})
    _frfs: MeasuredFRFs | None = PrivateAttr(None)
    _shapes: MeasuredShapes | None = PrivateAttr(None)

    @property
    def path(self) -> Path:
        """The case file."""
        return self._path

    @property
    def name(self) -> str:
        """The title, or else the name of the folder."""
        return self.title or printable(self._path.resolve().parent.name)

    @property
    def folder(self) -> Path:
        """The folder of the case file, to which names of files are relative."""
        return self._path.parent

    def file(self, name: str) -> Path:
        """The path of a file that the case names, free of ``..`` if that is the same file."""
        path = self.folder / name
        short = Path(os.path.normpath(path))
        try:
            return short if os.path.samefile(path, short) else path
        except OSError:
            return path

    def files(self) -> list[Path]:
        """All files that the case is read from, its own first."""
        return [self._path, *(self.folder / name for name in _file_names(self))]

    def diagnosed(self) -> Case:
        """The case as a diagnosis models it: with the mesh of [diagnose.mesh] and, as attached
        masses, those of [test.changed]; the case itself if it has neither."""
        changed = {} if self.test is None else self.test.changed
        put_on = {
            name: AttachedMass(kind="mass", mass=section.mass, points=section.points)
            for name, section in changed.items()
            if section.mass is not None and name not in self.attached
        }
        if not put_on and self._coarse is None:
            return self
        mesh = self._coarse or self.mesh
        case = self.model_copy(update={"attached": {**self.attached, **put_on}, "mesh": mesh})
        case._coarse = None
        return case

    @property
    def measured(self) -> TestData | None:
        """The measured modes, or None; `measurements` raises an error instead."""
        return self._measured

    def with_modes(self, kept: Sequence[int]) -> Case:
        """The case with only these modes of the test, by index."""
        return self._with_test(self.measurements().with_modes(kept))

    def without_modes(self, out: Sequence[int]) -> Case:
        """The case without some of the test's modes, by index; see `TestData.without_modes`."""
        return self._with_test(self.measurements().without_modes(out))

    def _with_test(self, data: TestData) -> Case:
        """The case with some of its test's modes, and the published frequencies of these."""
        names, changed, update = self.measurements().mode_names, {}, self.update
        if update is not None and update.published is not None and update.published.frequencies:
            theirs = dict(zip(names, update.published.frequencies, strict=True))
            hz = [theirs[name] for name in data.mode_names]
            published = update.published.model_copy(update={"frequencies": hz})
            changed["update"] = update.model_copy(update={"published": published})
        case = self.model_copy(update=changed)
        case._measured = data
        return case

    def measurements(self) -> TestData:
        """The measured data.

        Raises:
            InputError: If the case has no test, or only a planned one.
        """
        if self.test is None:
            raise InputError(f"{self._path}: test is missing, expected a section [test]")
        if self._measured is None:
            raise InputError(
                f"{self._path}: test.frequencies is missing: expected measured data; "
                + (
                    "the test is planned only, which is enough for diagnose --plan"
                    if self._frfs is None
                    else "or a section [test.frfs.identify], for modes from the functions"
                )
            )
        return self._measured

    def diagnosed_test(self) -> TestData:
        """The measured data of a diagnosis, with ``[test.amplitude]`` if it is there.

        Driven modes, each at its levels, and the other modes together make one test. If there are
        frequencies at several torques, the amplitude data are left out, with a note.

        Raises:
            InputError: As `measurements`, or if the data cannot be combined.
        """
        data = self.measurements()
        for name, section in self.test.changed.items():
            known = {
                f"{each}.{'mass' if each in self.masses else 'stiffness'}": 0.0
                for each in section.without
            }
            if section.mass is not None:
                known[f"{name}.mass"] = section.mass
            with located(f"{self._path}: test.changed.{name}"):
                data = data.again(name, self._changed[name].frequencies_hz[0], known, section.at)
        if not self.test.amplitude or self.test.is_by_amplitude:
            return data
        if len(data) > 1:
            note = (
                f"test.amplitude is no part of the diagnosis, since there are frequencies at "
                f"{len(data)} values of {data.condition_name}; it would be with one row of them"
            )
            return replace(data, notes=(*data.notes, note))
        with located(f"{self._path}: test.amplitude"):
            return with_modes_at_rest(test_by_level(self._backbones), data)

    def planned(self) -> TestData:
        """The planned test, or else the measured one, for its layout and noise alone.

        Frequencies and damping ratios of a planned test are placeholders.

        Raises:
            InputError: If the case has no test.
        """
        return self.diagnosed_test() if self._planned is None else self._planned

    def looking_for(self, effects: Sequence[str] | None) -> Case:
        """The case with other ``[diagnose] effects``; itself for None."""
        if effects is None:
            return self
        with reading(self.folder):
            find_all(effects)
        diagnose = self.diagnose.model_copy(update={"effects": list(effects)})
        return self.model_copy(update={"diagnose": diagnose})

    def validation(self) -> TestData | None:
        """Data that are never fitted, or None."""
        return self._validation

    def curves(self) -> MeasuredCurves | None:
        """Measured responses to sinusoidal forces, or None."""
        return self._curves

    def backbones(self) -> dict[str, MeasuredBackbone]:
        """Frequency and damping over amplitude, by name of the mode.

        From ``[test.amplitude]``, or else from a test by level.
        """
        if self._backbones or self._measured is None or not self._measured.by_level:
            return self._backbones
        return by_mode(self._measured)

    def frfs(self) -> MeasuredFRFs | None:
        """Measured frequency response functions, in their band, or None."""
        return self._frfs

    def shapes(self) -> MeasuredShapes | None:
        """Mode shapes from universal files, with their sensors, or None."""
        return self._shapes

    def test_notes(self, by_amplitude: bool = True) -> tuple[str, ...]:
        """What was left out or is doubtful in the files of the test, in sentences.

        Args:
            by_amplitude: Whether to include the files of [test.amplitude] beside other modes.
        """
        files = [self._measured, self._validation, self._shapes, self._frfs]
        if by_amplitude and self.test is not None and not self.test.is_by_amplitude:
            files += self._backbones.values()
        return tuple(note for data in files if data is not None for note in data.notes)

    def joint_notes(self) -> tuple[str, ...]:
        """What was assumed of joints whose stiffness the case does not give, in sentences."""
        return self._joint_notes

    def sensors(self) -> Sensors | None:
        """Points and directions of the test's sensors, or None if the case does not say them."""
        if self.test is None or self.test.sees is None:
            # Modes identified from functions have the sensors of these functions.
            if self._shapes is not None:
                return self._shapes.sensors
            seen = self.test is not None and self.test.frequencies is None
            if seen and self._measured is not None:
                return self._measured.sensors
            return self._frfs.sensors() if seen and self._frfs is not None else None
        return Sensors(self.test.sees.points(), self.test.sees.directions())

    def start(self) -> dict[str, float]:
        """Values at which updating starts, SI, by parameter; those in ``update.start``."""
        return {} if self.update is None else self._si(self.update.start)

    def published(self) -> dict[str, float]:
        """Published values of parameters, SI; those in ``update.published.parameters``."""
        published = None if self.update is None else self.update.published
        return {} if published is None else self._si(published.parameters)

    def _si(self, given: Mapping[str, float | str]) -> dict[str, float]:
        return {name: to_si(value, self.unit_of(name)) for name, value in given.items()}

    def unit_of(self, name: str) -> str:
        """SI unit of a parameter; ``""`` for a ratio."""
        owner, _, key = name.rpartition(".")
        law = self.joints[owner].own_law if owner in self.joints else None
        return parameter_unit(name) if law is None else law.units.get(key, "")

    def combined(self) -> bool:
        """Whether an update fits more than frequencies, or names its data, at one condition."""
        update = self.update
        if update is None or update.cutoff is not None:
            return False
        return bool(update.combined_keys()) or bool({"damping", "frfs"} & set(self.fitted_data()))

    def fitted_data(self) -> tuple[str, ...]:
        """Kinds of data that a combined update fits: those of ``update.data``, or else all it can.

        Frequency response functions need a damped model: ``[damping]``, or the c of a lap of beams.
        Damping ratios are fitted by default if a parameter of damping is, unless they were
        identified from functions that are fitted themselves.
        """
        if self.update is not None and self.update.data is not None:
            return tuple(dict.fromkeys(self.update.data))
        functions = self._frfs is not None and self.is_damped
        wanted = self.update is not None and self.damping_names() & set(self.update.parameters)
        derived = functions and not self.test.has_modes
        there = {
            "frequencies": self._measured is not None,
            "shapes": self._measured is not None and self._measured.shapes is not None,
            "damping": bool(wanted) and not derived and self.has_ratios(),
            "frfs": functions,
        }
        return tuple(kind for kind, has in there.items() if has)

    def has_ratios(self) -> bool:
        """Whether damping ratios were measured at the condition of the update."""
        data, row = self._measured, self.row()
        if row is None or data.damping is None:
            return False
        return bool(np.isfinite(data.damping[row]).any())

    def row(self) -> int | None:
        """Row of the measured data at the condition of the update, or None."""
        try:
            at = None if self.update is None else self.update.at
            return None if self._measured is None else self._measured.row(at)
        except InputError:
            return None  # check_update.py reports it

    def damping_names(self) -> set[str]:
        """Names of the parameters of damping: of ``[damping]``, and the c of laps of beams."""
        own = {} if self.damping is None else self.damping.nominal()
        return {*own, *(f"{n}.c" for n, j in self.joints.items() if "c" in j.nominal())}

    @property
    def is_pressed(self) -> bool:
        """Whether something presses the bodies together, or on obstacles."""
        gaps = any(contact.gap < 0 for contact in self.contacts.values())
        pushed = any(obstacle.presses for obstacle in self.obstacles.values())
        return bool(self.bolts or self.displacements or self.loads or gaps or pushed)

    @property
    def is_damped(self) -> bool:
        """Whether the model has damping: ``[damping]``, or the c of a lap of beams."""
        return self.damping is not None or any(joint.c for joint in self.joints.values())

    def nominal(
        self, attached: bool = False, width: bool = False, damping: bool = False
    ) -> dict[str, float]:
        """Value of every parameter of the model, SI, by name (such as ``near.E``), in order.

        Args:
            attached: Whether to add those of ``[attached]``, as zero: absent.
            width: Whether to add the widths of the parts, relative to the mesh's: 1.
            damping: Whether to add those of ``[damping]``.
        """
        values = {name: part.nominal(width) for name, part in self.parts.items()}
        sections = {**self.joints, **self.masses, **self.springs}
        values |= {name: section.nominal() for name, section in sections.items()}
        if attached:
            values |= {name: section.absent() for name, section in self.attached.items()}
        lacks = self.mesh.lacks
        found = {
            f"{name}.{key}": v
            for name, own in values.items()
            for key, v in own.items()
            if key not in lacks
        }
        return found | (self.damping.nominal() if damping and self.damping is not None else {})

    def tolerances(self) -> dict[str, float]:
        """Relative standard deviations that the case gives, by parameter.

        Those of ``[attached]`` are relative to the mass or stiffness in the case.
        """
        found = {}
        for name, section in {**self.parts, **self.joints}.items():
            given = section.tolerance.model_dump(exclude_none=True)
            found |= {f"{name}.{key}": value for key, value in given.items()}
        for name, section in {**self.masses, **self.springs, **self.attached}.items():
            key = next(iter(section.nominal()))
            if section.tolerance is not None:
                found[f"{name}.{key}"] = section.tolerance
        return found


def _file_names(value: object) -> Iterator[FileName]:
    """Names of files anywhere in a section."""
    if isinstance(value, FileName):
        yield value
    elif isinstance(value, CaseSection):
        for inside in vars(value).values():
            yield from _file_names(inside)
    elif isinstance(value, dict | list | tuple):
        for inside in value.values() if isinstance(value, dict) else value:
            yield from _file_names(inside)

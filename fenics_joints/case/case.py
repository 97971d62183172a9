"""The case file: a structure, its test, and what to do with them, in one validated TOML file.

`load_case` is the way in. Every message names the file, the key, the value and what was expected,
and all errors that can be found together are reported together.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, PrivateAttr, ValidationError, model_validator

from fenics_joints.case.bayes import Update, check_bayes
from fenics_joints.case.beams import check_beams
from fenics_joints.case.combined import check_combined
from fenics_joints.case.damping import DampingSection
from fenics_joints.case.densities import with_average_densities
from fenics_joints.case.harmonic import HarmonicSection, NonlinearSection, check_harmonic
from fenics_joints.case.mesh import Mesh, MeshFile
from fenics_joints.case.messages import case_error, describe, did_you_mean, said
from fenics_joints.case.preload import Bolt, ContactSection
from fenics_joints.case.sections import (
    Attached,
    Diagnose,
    FRFSection,
    Joint,
    MassSection,
    Part,
    Section,
    SpringSection,
    SupportSection,
    Test,
    ValidationTest,
    named,
)
from fenics_joints.errors import InputError
from fenics_joints.measurements.curves import MeasuredCurves, read_curves
from fenics_joints.measurements.data import TestData, read_table, read_test_data
from fenics_joints.measurements.files import read_frfs
from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.units import parameter_unit, to_si

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from fenics_joints.structure.points import Sensors

__all__ = ["Case", "load_case", "matching", "unknown_groups"]


class Case(Section):
    """A whole case; make one with `load_case`.

    Attributes:
        title: Title for people.
        mesh: Where the mesh comes from.
        parts: Solid parts by name.
        joints: Thin layers by name.
        contacts: Contacts between bodies, by name.
        bolts: Bolts that press them, by name.
        masses: Known masses, by name.
        springs: Known springs to the ground, by name.
        supports: Held facets, by name.
        attached: Masses and springs that are there, but not in the nominal model, by name.
        test: The test, or None.
        update: What to update, or None.
        diagnose: What a diagnosis may assume.
        nonlinear: Laws of nonlinear joints and contacts, by their name.
        harmonic: What response to sinusoidal forces is wanted, or None.
        damping: Linear damping of the model, or None.
    """

    title: str = ""
    mesh: Mesh
    parts: Annotated[named(Part), Field(min_length=1)]
    joints: named(Joint) = {}
    contacts: named(ContactSection) = {}
    bolts: named(Bolt) = {}
    masses: named(MassSection) = {}
    springs: named(SpringSection) = {}
    supports: named(SupportSection) = {}
    attached: named(Attached) = {}
    test: Test | None = None
    update: Update | None = None
    diagnose: Diagnose = Diagnose()
    nonlinear: named(NonlinearSection) = {}
    harmonic: HarmonicSection | None = None
    damping: DampingSection | None = None

    @model_validator(mode="before")
    @classmethod
    def _averages(cls, raw: Any) -> Any:
        return with_average_densities(raw)

    _path: Path = PrivateAttr(Path("case.toml"))
    _coarse: Mesh | None = PrivateAttr(None)
    _measured: TestData | None = PrivateAttr(None)
    _planned: TestData | None = PrivateAttr(None)
    _validation: TestData | None = PrivateAttr(None)
    _curves: MeasuredCurves | None = PrivateAttr(None)
    _frfs: MeasuredFRFs | None = PrivateAttr(None)
    _start: dict[str, float] = PrivateAttr(default_factory=dict)
    _published: dict[str, float] = PrivateAttr(default_factory=dict)

    @property
    def path(self) -> Path:
        """The case file."""
        return self._path

    @property
    def folder(self) -> Path:
        """The folder that the files named in the case stand in."""
        return self._path.parent

    def diagnosed(self) -> Case:
        """The case with the mesh that a diagnosis takes; of such a case, itself."""
        if self._coarse is None:
            return self
        case = self.model_copy(update={"mesh": self._coarse})
        case._coarse = None
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

    def planned(self) -> TestData:
        """The planned test, or what was measured; nothing but its layout and noise count.

        The frequencies (and damping ratios) of a planned test are placeholders.

        Raises:
            InputError: If the case has no test.
        """
        return self.measurements() if self._planned is None else self._planned

    def validation(self) -> TestData | None:
        """The data that is never fitted, or None."""
        return self._validation

    def curves(self) -> MeasuredCurves | None:
        """Measured responses to sinusoidal forces, or None."""
        return self._curves

    def frfs(self) -> MeasuredFRFs | None:
        """Measured frequency response functions, in their band, or None."""
        return self._frfs

    def sensors(self) -> Sensors | None:
        """Where and how the test saw the structure, or None if the case does not say."""
        if self.test is None or self.test.sees is None:
            # Modes that were identified are seen by what measured the functions.
            seen = self.test is not None and self.test.frequencies is None
            if seen and self._measured is not None:
                return self._measured.sensors
            return self._frfs.sensors() if seen and self._frfs is not None else None
        from fenics_joints.structure.points import Sensors

        return Sensors(self.test.sees.points(), self.test.sees.directions())

    def start(self) -> dict[str, float]:
        """Values at which updating starts, SI, by parameter; those in ``update.start``."""
        return dict(self._start)

    def published(self) -> dict[str, float]:
        """Somebody's values of the parameters, SI; those in ``update.published.parameters``."""
        return dict(self._published)

    def combined(self) -> bool:
        """Whether an update takes more than frequencies (or says what), at one condition."""
        update = self.update
        if update is None or update.cutoff is not None:
            return False
        return bool(update.combined_keys()) or bool({"damping", "frfs"} & set(self.fitted_data()))

    def fitted_data(self) -> tuple[str, ...]:
        """Kinds of data that a combined update fits: what there is, unless the case says it.

        Without ``[damping]``, or the c of a lap of beams, the model has no functions to compare
        with those of the test. Damping ratios are data by default where a parameter of damping is
        to be fitted, unless they were identified from functions that are fitted themselves.
        """
        if self.update is not None and self.update.data is not None:
            return tuple(dict.fromkeys(self.update.data))
        functions = self._frfs is not None and self.is_damped
        wanted = self.update is not None and self.damping_names() & set(self.update.parameters)
        derived = functions and self.test.frequencies is None
        there = {
            "frequencies": self._measured is not None,
            "shapes": self._measured is not None and self._measured.shapes is not None,
            "damping": bool(wanted) and not derived and self.has_ratios(),
            "frfs": functions,
        }
        return tuple(kind for kind, has in there.items() if has)

    def has_ratios(self) -> bool:
        """Whether damping ratios were measured at the condition of the update."""
        data = self._measured
        if data is None or data.damping is None:
            return False
        at = None if self.update is None else self.update.at
        try:
            row = len(data) - 1 if at is None else data.row(at)
        except InputError:
            return False  # said where the condition is checked
        return bool(np.isfinite(data.damping[row]).any())

    def damping_names(self) -> set[str]:
        """Names of the parameters of damping: of ``[damping]``, and the c of laps of beams."""
        own = {} if self.damping is None else self.damping.nominal()
        return {*own, *(f"{n}.c" for n, j in self.joints.items() if "c" in j.nominal())}

    @property
    def is_damped(self) -> bool:
        """Whether the model has damping: ``[damping]``, or the c of a lap of beams."""
        return self.damping is not None or any(joint.c for joint in self.joints.values())

    def nominal(
        self, attached: bool = False, width: bool = False, damping: bool = False
    ) -> dict[str, float]:
        """Value of every parameter of the model, SI, by name (``near.E``), in order.

        Args:
            attached: Whether to add those of ``[attached]``, at zero: not there.
            width: Whether to add the widths of the parts, relative to the mesh's: 1.
            damping: Whether to add those of ``[damping]``.
        """
        values = {name: part.nominal(width) for name, part in self.parts.items()}
        sections = {**self.joints, **self.masses, **self.springs}
        values |= {name: section.nominal() for name, section in sections.items()}
        if attached:
            values |= {name: section.absent() for name, section in self.attached.items()}
        found = {f"{name}.{key}": v for name, own in values.items() for key, v in own.items()}
        return found | (self.damping.nominal() if damping and self.damping is not None else {})

    def tolerances(self) -> dict[str, float]:
        """Relative standard deviations that the case gives, by parameter.

        For what is in ``[attached]`` they are relative to the mass or stiffness in the case.
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


# -- reading ---------------------------------------------------------------------------------------


def load_case(path: str | Path) -> Case:
    """Read and check a case and its measured data. Needs no MPI.

    Args:
        path: The case file, or a folder with a ``case.toml``.

    Raises:
        InputError: Names the file and, for each error, the key, the value and what was expected.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "case.toml"
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a case file or a folder with case.toml")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read as TOML ({error})") from error
    try:
        case = Case.model_validate(raw)
    except ValidationError as error:
        raise case_error(path, [describe(e, Case) for e in error.errors()]) from None
    case._path = path
    case._coarse = _diagnosed_mesh(case, raw)
    errors = [*_check_names(case), *_check_mesh(case), *_read_tests(case), *_read_frfs(case)]
    errors += _check_update(case) if case.update else []
    errors += [*check_bayes(case), *check_beams(case), *check_combined(case)]
    errors += [*check_harmonic(case), *_read_curves(case)]
    if errors:
        raise case_error(path, errors)
    return case


def _diagnosed_mesh(case: Case, raw: dict) -> Mesh | None:
    """The mesh with what [diagnose.mesh] changes."""
    if not case.diagnose.mesh:
        return None
    changed = {**raw, "mesh": {**raw["mesh"], **case.diagnose.mesh}}
    try:
        return Case.model_validate(changed).mesh
    except ValidationError as error:
        lines = [describe(e, Case) for e in error.errors()]
        raise case_error(case.path, [f"diagnose.{line}" for line in lines]) from None


# -- checks across sections ------------------------------------------------------------------------


def _check_names(case: Case) -> list[str]:
    seen: dict[str, str] = {}
    errors = []
    for table in ("parts", "joints", "contacts", "bolts", "masses", "springs", "attached"):
        for name in getattr(case, table):
            if name in seen:
                errors.append(f"{table}.{name}: the name is used by {seen[name]}; expected another")
            seen[name] = f"{table}.{name}"
    for table in ("parts", "joints"):
        for name, section in getattr(case, table).items():
            errors += _check_bounds(f"{table}.{name}", section)
    return errors


def _check_bounds(key: str, section: Part | Joint) -> list[str]:
    values = section.nominal() | ({"width": 1.0} if isinstance(section, Part) else {})
    return [
        said(f"{key}.bounds.{name}", list(pair), f"expected a range that holds {values[name]:g}")
        for name, pair in section.bounds.model_dump(exclude_none=True).items()
        if name in values and not pair[0] <= values[name] <= pair[1]
    ]


def _check_mesh(case: Case) -> list[str]:
    """Names of cells and facets against the builder's; a file's are checked when it is read."""
    if isinstance(case.mesh, MeshFile):
        file = case.folder / case.mesh.file
        missing = said("mesh.file", case.mesh.file, f"no such file, expected a mesh at {file}")
        return [] if file.is_file() else [missing]
    return unknown_groups(case, *case.mesh.groups())


def unknown_groups(case: Case, cells: Iterable[str], facets: Iterable[str]):
    """A line for each group that the case names and the mesh does not have.

    Args:
        case: The case.
        cells: Names of the mesh's groups of cells.
        facets: Names of the mesh's groups of facets.
    """
    cells, facets = list(cells), list(facets)
    named = [
        (f"{table}.{name}.cells", cell, cells)
        for table in ("parts", "joints")
        for name, section in getattr(case, table).items()
        for cell in section.cells
        if not (getattr(section, "law", "") == "transition" and matching(cell, cells))
    ] + [(f"supports.{name}.facets", s.facets, facets) for name, s in case.supports.items()]
    named += [
        (f"{table}.{name}.{side}", getattr(section, side), facets)
        for table in ("contacts", "bolts")
        for name, section in getattr(case, table).items()
        for side in ("lower", "upper")
    ]
    return [
        said(key, name, f"is not in the mesh{did_you_mean(name, there)}")
        for key, name, there in named
        if name not in there
    ]


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Those of the names of cells that a pattern such as ``ring_*`` stands for, in their order."""
    names = list(names)
    if pattern in names:
        return [pattern]
    return [name for name in names if fnmatchcase(name, pattern)]


def _read_tests(case: Case) -> list[str]:
    test = case.test
    if test is None:
        return []
    try:
        if test.planned is not None:
            case._planned = _plan_test(case, test)
        if test.frequencies is None:
            return []
        case._measured = _read_test(case, "test", test)
        if test.validation is not None:
            case._validation = _read_test(case, "test.validation", test.validation)
    except InputError as error:
        return [str(error)]
    measured, validation = case._measured, case._validation
    if validation is not None and measured.condition_unit != validation.condition_unit:
        return [
            f"test.validation: {test.condition} is in {validation.condition_unit!r}, "
            f"expected {measured.condition_unit!r} as in test.frequencies"
        ]
    return []


def _read_frfs(case: Case) -> list[str]:
    section = None if case.test is None else case.test.frfs
    if section is None:
        return []
    try:
        frfs = read_frfs(
            [case.folder / file for file in section.files], kind=section.kind, units=section.units,
            length_unit=section.length_unit, points=section.points, directions=section.directions,
            keys=section.keys,
        )  # fmt: skip
        case._frfs = frfs.band(*section.band) if section.band else frfs
        if section.identify is not None:
            case._measured = _identified(case, section)
        elif section.at is not None and case._measured is not None:
            case._measured.row(section.at)
    except InputError as error:
        return [f"test.frfs: {error}"]
    return []


def _identified(case: Case, section: FRFSection) -> TestData:
    """The modes of the measured functions; noise that the case gives is of the test as a whole."""
    # The libraries that it needs are an option.
    from fenics_joints.measurements.identification import identify_modes

    test, identify = case.test, section.identify
    found = identify_modes(
        case._frfs, near=identify.near, order=identify.order, max_damping=identify.max_damping
    )
    noise = _per_mode("noise", test.noise, len(found.frequencies_hz))
    data = found.test_data(
        test.modes, 1.0 if section.at is None else section.at, test.condition or "row", noise=noise
    )
    given = {"damping_noise": test.damping_noise}
    if "shape_noise" in test.model_fields_set:
        given["shape_noise"] = test.shape_noise
    return replace(data, **{key: value for key, value in given.items() if value is not None})


def _read_curves(case: Case) -> list[str]:
    if case.harmonic is None or case.harmonic.measured is None:
        return []
    try:
        curves = read_curves(case.folder / case.harmonic.measured, case.harmonic.response)
    except InputError as error:
        return [f"harmonic.measured: {error}"]
    case._curves = curves
    identify = case.harmonic.identify
    if identify is not None and identify.level not in curves.levels:
        there = ", ".join(f"{level:g} N" for level in curves.levels)
        expected = f"not among the measured curves; expected one of: {there}"
        return [said("harmonic.identify.level", identify.level, expected)]
    return []


def _read_test(case: Case, key: str, source: Test | ValidationTest) -> TestData:
    test = case.test
    files = {}
    for name in ("frequencies", "damping", "shapes"):
        file = getattr(source, name, None)
        files[name] = None if file is None else case.folder / file
        if file is not None and not files[name].is_file():
            expected = f"no such file, expected CSV or TOML at {files[name]}"
            raise InputError(said(f"{key}.{name}", file, expected))
    # Modes that are not named are all columns of the test; the validation must have the same.
    modes = test.modes or (case._measured.mode_names if case._measured else None)
    try:
        data = read_test_data(
            files["frequencies"], condition=test.condition, modes=modes, damping=files["damping"]
        )
    except InputError as error:
        raise InputError(f"{key}: {error}") from error
    try:
        return replace(
            data,
            resolution_hz=_per_mode("resolution", test.resolution, len(data.mode_names)),
            noise=_per_mode("noise", test.noise, len(data.mode_names)),
            damping_noise=test.damping_noise,
            sensors=case.sensors(),
            shapes=_read_shapes(files["shapes"], data.mode_names),
            shape_noise=test.shape_noise,
            shapes_at=test.shapes_at if files["shapes"] is not None else None,
        )
    except InputError as error:
        raise InputError(f"{key}: {error}") from error


def _plan_test(case: Case, test: Test) -> TestData:
    """The layout of the planned test, its values placeholders."""
    names, (condition, unit) = test.planned.names(), test.planned.head()
    conditions = sorted(test.planned.conditions)
    values = np.ones((len(conditions), len(names)))
    return TestData(
        conditions, values, names, condition, unit,
        damping=1e-3 * values if test.planned.damping else None,
        resolution_hz=_per_mode("resolution", test.resolution, len(names)),
        noise=_per_mode("noise", test.noise, len(names)),
        damping_noise=test.damping_noise,
        shape_noise=test.shape_noise,
        sensors=case.sensors(),
    )  # fmt: skip


def _read_shapes(file: Path | None, modes) -> np.ndarray | None:
    """Measured shapes: a row for each sensor, in their order, and a column for each mode."""
    if file is None:
        return None
    table = read_table(file)
    missing = [mode for mode in modes if mode not in table.names]
    if missing:
        hint = did_you_mean(missing[0], list(table.names))
        raise InputError(f"shapes: {file}: no column for the mode {missing[0]!r}{hint}")
    return table.values[:, [table.names.index(mode) for mode in modes]]


def _per_mode(name: str, values: list[float], n: int) -> list[float] | float:
    if len(values) not in (1, n):
        expected = f"expected one value, or {n}: one for each of the modes"
        raise InputError(said(f"test.{name}", values, expected))
    return values if len(values) == n else values[0]


def _check_cutoff(case: Case) -> list[str]:
    cutoff, errors = case.update.cutoff, []
    contacts = [name for name, section in case.contacts.items() if not section.bonded]
    if not contacts or not case.bolts:
        return ["update.cutoff: expected [contacts] that can open, and [bolts] that press them"]
    for i, name in enumerate(cutoff.contacts or []):
        if name not in contacts:
            expected = f"no such contact{did_you_mean(name, contacts)}"
            errors.append(said(f"update.cutoff.contacts[{i}]", name, expected))
    if case._measured is None:
        errors.append("update.cutoff: expected a section [test] with frequencies")
    if cutoff.calibrate is not None:
        names = {
            "parameter": list(case.nominal()),
            "mode": list(case._measured.mode_names) if case._measured else [],
        }
        for key, known in names.items():
            value = getattr(cutoff.calibrate, key)
            if known and value not in known:
                expected = f"no such {key}{did_you_mean(value, known)}"
                errors.append(said(f"update.cutoff.calibrate.{key}", value, expected))
    return errors


def _check_update(case: Case) -> list[str]:
    update, measured = case.update, case._measured
    errors = [] if update.cutoff is None else _check_cutoff(case)
    known = case.nominal(damping=True)
    for i, name in enumerate(update.parameters):
        if name not in known:
            key = f"update.parameters[{i}]"
            errors.append(said(key, name, f"no such parameter{did_you_mean(name, list(known))}"))
    sources = [("update.start", update.start, case._start)]
    if update.published is not None:
        sources.append(
            ("update.published.parameters", update.published.parameters, case._published)
        )
    for table, given, into in sources:
        for name, value in given.items():
            key = f"{table}.{name}"
            if name not in update.parameters:
                hint = did_you_mean(name, update.parameters)
                errors.append(said(key, value, f"is not in update.parameters{hint}"))
                continue
            try:
                into[name] = to_si(value, parameter_unit(name))
            except InputError as error:
                errors.append(said(key, value, str(error)))
    if measured is None:
        return errors
    theirs = update.published.frequencies if update.published else []
    if theirs and len(theirs) != len(measured.mode_names):
        expected = f"expected {len(measured.mode_names)} frequencies, one for each mode of the test"
        errors.append(said("update.published.frequencies", theirs, expected))
    given = [] if update.at is None else [("update.at", update.at)]
    given += [(f"update.hold_out[{i}]", c) for i, c in enumerate(update.hold_out)]
    for key, condition in given:
        try:
            measured.row(condition)
        except InputError as error:
            errors.append(said(key, condition, str(error)))
    if not errors and not len(measured.without(update.hold_out)):
        expected = f"expected some {measured.condition_name} left to fit"
        errors.append(said("update.hold_out", update.hold_out, expected))
    return errors

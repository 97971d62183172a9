"""Read and check a case file and the measured data that it names."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
from pydantic import ValidationError

from fenics_joints.case import own_code
from fenics_joints.case.case import Case
from fenics_joints.case.check_structure import check_applied, check_beams, check_mesh, check_names
from fenics_joints.case.check_update import check_combined, check_harmonic, check_update
from fenics_joints.case.mesh import Mesh
from fenics_joints.case.messages import case_error, describe, message
from fenics_joints.case.starting import start_joints
from fenics_joints.case.test import ChangedTest, FRFSection, Test, ValidationTest
from fenics_joints.errors import InputError, Problems, located, raised
from fenics_joints.files import is_file, read_toml, shown_path, toml_value
from fenics_joints.formatting import printable
from fenics_joints.measurements import (
    MeasuredBackbone,
    MeasuredShapes,
    TestData,
    TimeSettings,
    read_amplitude,
    read_curves,
    read_frfs,
    read_shapes,
    read_table,
    read_test_data,
)
from fenics_joints.measurements.amplitude import test_by_level


def load_case(path: str | Path, *, changes: Sequence[str] = (), allow_code: bool = False) -> Case:
    """Read and check a case and its measured data. Needs no MPI.

    Args:
        path: The case file, or a folder with a ``case.toml``.
        changes: Keys with other values than in the file, such as ``mesh.size=5 mm``.
        allow_code: Whether laws, effects and meshes that the case names as ``module:name`` may be
            of modules beside it, which run; otherwise these are of installed packages that declare
            them.

    Raises:
        InputError: Names the file and, for each error, the key, the value and what was expected.
    """
    path, raw = read_case(path, changes)
    with own_code.reading(path.parent, allow_code):
        try:
            case = Case.model_validate(raw)
        except ValidationError as error:
            errors = [describe(e, Case) for e in error.errors()]
        else:
            errors = finish_case(case, path, raw)
    if errors:
        changed = f" (changed by --set {', '.join(map(printable, changes))})" if changes else ""
        raise case_error(f"{path}{changed}", errors) from None
    return case


def read_case(path: str | Path, changes: Sequence[str] = ()) -> tuple[Path, dict]:
    """The case file that a path means, and what stands in it; raises InputError as `load_case`."""
    path = Path(path)
    if os.path.isdir(path):
        path = path / "case.toml"
    raw = read_toml(path, "a case file or a folder with case.toml")
    for change in changes:
        _change(raw, change)
    return path, raw


def _change(raw: dict, change: str) -> None:
    """Give a key of a case the value behind the first "=", a text where it is no TOML.

    Raises:
        InputError: If it is no ``KEY=VALUE``, or the key leads through something without keys.
    """
    said = f"--set {printable(change)[:200]}: "
    key, equals, text = change.partition("=")
    found = toml_value(f"{key} = 0") if equals and change.isprintable() else None
    if not isinstance(found, dict):
        raise InputError(f"{said}expected KEY=VALUE, such as parts.NAME.E='70 GPa'")
    names = []
    while isinstance(found, dict):
        ((name, found),) = found.items()
        names.append(name)
    value = toml_value(f"value = {text}")
    value = value["value"] if isinstance(value, dict) and len(value) == 1 else text.strip()
    inside: dict | list = raw
    for depth, name in enumerate(names):
        last = depth == len(names) - 1
        if isinstance(inside, list) and name.isdecimal() and int(name) < len(inside):
            at: str | int = int(name)
        elif isinstance(inside, dict):
            at = name
            if not last:
                inside.setdefault(name, {})
        else:
            raise InputError(f"{said}{'.'.join(names[:depth])} has no key {name!r}")
        if last:
            inside[at] = value  # type: ignore[index]
        else:
            inside = inside[at]  # type: ignore[index]


def finish_case(case: Case, path: Path, raw: dict) -> list[str]:
    """Read the files that a case names; a line for each thing that is wrong in it and in them."""
    case._path = path
    case._coarse = _diagnosed_mesh(case, raw)
    return [
        *start_joints(case),
        *check_names(case),
        *check_mesh(case),
        *check_applied(case),
        *_read_tests(case),
        *check_update(case),
        *check_beams(case),
        *check_combined(case),
        *check_harmonic(case),
        *_read_curves(case),
    ]


def read_part(case: Case, path: Path, has_mesh: bool) -> list[str]:
    """Check a case that lacks sections, as far as a check needs none of these; as `finish_case`."""
    case._path = path
    meshed = check_mesh(case) if has_mesh else []
    return [*check_names(case), *meshed, *_read_tests(case), *_read_curves(case)]


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


def _read_tests(case: Case) -> list[str]:
    """Read the files of the test; a line for each thing that is wrong in them."""
    test, problems = case.test, Problems()
    if test is None:
        return []
    if test.planned is not None:
        case._planned = problems.tried(lambda: _plan_test(case, test))
    if test.has_modes:
        _read_modes(case, test, problems)
    if test.frfs is not None:
        problems.tried(lambda: _read_frfs(case, test.frfs))
    return problems.texts()


def _read_modes(case: Case, test: Test, problems: Problems) -> None:
    backbones = {
        name: problems.tried(lambda name=name: _read_amplitude(case, name))
        for name in test.amplitude
    }
    case._backbones = {name: one for name, one in backbones.items() if one is not None}
    if test.has_universal_shapes:
        case._shapes = problems.tried(lambda: _read_universal(case))
    # Tables are read whatever is wrong in the files beside them.
    if not problems or (test.frequencies is not None and not test.has_universal_shapes):
        case._measured = problems.tried(lambda: _read_test(case, "test", test))
    measured = case._measured
    if measured is None:
        return
    if test.validation is not None:
        read = partial(_read_test, case, "test.validation", test.validation)
        case._validation = problems.tried(read)
    for name, section in test.changed.items():
        case._changed[name] = problems.tried(partial(_read_changed, case, name, section))
    other = case._validation
    if not problems and other is not None and measured.condition_unit != other.condition_unit:
        problems.add(
            f"test.validation: {test.condition} is in {other.condition_unit!r}, expected "
            f"{measured.condition_unit!r} as in test.frequencies"
        )


def _read_frfs(case: Case, section: FRFSection) -> None:
    with located("test.frfs"):
        keys = ("kind", "units", "length_unit", "points", "directions", "keys")
        files = [case.file(file) for file in section.files]
        time = None if section.time is None else TimeSettings(**section.time.model_dump())
        frfs = read_frfs(files, **{key: getattr(section, key) for key in keys}, time=time)
        case._frfs = frfs.band(*section.band) if section.band else frfs
        if section.identify is not None:
            case._measured = _identified(case, section)
        elif section.at is not None and case._measured is not None:
            case._measured.row(section.at)


def _identified(case: Case, section: FRFSection) -> TestData:
    """The modes of the measured functions; noise that the case gives is of the test as a whole."""
    # The libraries that it needs are an option.
    from fenics_joints.measurements.identification import identify_modes

    test, how = case.test, section.identify.model_dump()
    if section.time is not None and how["exponential_window"] is None:
        how["exponential_window"] = section.time.exponential
    found = identify_modes(case._frfs, **how)
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
        curves = read_curves(case.file(case.harmonic.measured), case.harmonic.response)
    except InputError as error:
        return [f"harmonic.measured: {error}"]
    case._curves = curves
    level = case.harmonic.identify and case.harmonic.identify.level
    if level is not None and level not in curves.levels:
        there = ", ".join(f"{level:g} N" for level in curves.levels)
        expected = f"not among the measured curves; expected one of: {there}"
        return [message("harmonic.identify.level", level, expected)]
    return []


def _read_test(case: Case, key: str, source: Test | ValidationTest) -> TestData:
    test, shapes = case.test, case._shapes
    files = {}
    for name in ("frequencies", "damping"):
        file = getattr(source, name, None)
        files[name] = None if file is None else _existing(case, f"{key}.{name}", file)
    # Modes that are not named are all columns of the test; the validation must have the same.
    modes = test.modes or (case._measured.mode_names if case._measured else None)
    if test.is_by_amplitude and source is test:
        with located(f"{key}.amplitude"):
            data = test_by_level(case._backbones)
        return replace(data, sensors=case.sensors(), shape_noise=test.shape_noise)
    if files["frequencies"] is None:
        with located(f"{key}.shapes"):
            data = TestData.of_modes(
                shapes.frequencies_hz,
                modes,
                1.0 if test.shapes_at is None else test.shapes_at,
                test.condition or "row",
                damping=None if np.isnan(shapes.damping).all() else shapes.damping[None],
                sensors=shapes.sensors,
                shapes=shapes.shapes,
            )
        return replace(data, **_noise(test, len(data.mode_names)))
    if source is test and test.reader is not None:
        with located("test.reader"):
            return _own_read(case, files["frequencies"])
    with located(key):
        data = read_test_data(
            files["frequencies"], condition=test.condition, modes=modes, damping=files["damping"]
        )
        data = replace(data, **_noise(test, len(data.mode_names)), sensors=case.sensors())
        if source is not test or test.shapes is None:
            return data
        data = replace(data, shapes_at=test.shapes_at)
        if shapes is not None:
            found = _shapes_of(shapes, data)
        else:
            file = _existing(case, f"{key}.shapes", test.shapes.files[0])
            with located("shapes"):
                table = read_table(file)
                found = np.column_stack([table.column(mode) for mode in data.mode_names])
        return replace(data, shapes=found)


def _own_read(case: Case, file: Path) -> TestData:
    """A test by the user's own reader; its noise is the case's where that gives any."""
    test = case.test
    read = own_code.find(test.reader, FunctionType, "a function that returns a TestData")
    try:
        data = read(file)
    except Exception as error:  # whatever somebody's own code may raise
        raise InputError(raised(f"{test.reader}: {shown_path(file)}", error)) from error
    if not isinstance(data, TestData):
        raise InputError(f"{test.reader}: returned {type(data).__name__}, expected a TestData")
    given = {"resolution_hz" if key == "resolution" else key for key in test.model_fields_set}
    noise = {k: v for k, v in _noise(test, len(data.mode_names)).items() if k in given}
    seen = case.sensors() if data.sensors is None else data.sensors
    return replace(data, **noise, sensors=seen)


def _read_changed(case: Case, name: str, section: ChangedTest) -> TestData:
    """The row of frequencies after a change."""
    key = f"test.changed.{name}"
    file = _existing(case, f"{key}.frequencies", section.frequencies)
    with located(key):
        data = read_test_data(file, modes=case._measured.mode_names)
        if len(data) != 1:
            raise InputError(f"{shown_path(file)}: has {len(data)} rows, expected one")
        if section.at is not None:
            case._measured.row(section.at)
    return data


def _read_amplitude(case: Case, name: str) -> MeasuredBackbone:
    """One mode over its amplitude, with the noise of the test where its section says none."""
    test, section = case.test, case.test.amplitude[name]
    with located(f"test.amplitude.{name}"):
        given = {
            **{key: getattr(section, key) for key in ("levels", "band", "sensor", "units")},
            "noise": section.noise or (test.noise[0] if len(test.noise) == 1 else None) or None,
            "damping_noise": section.damping_noise or test.damping_noise,
        }
        found = read_amplitude([case.file(file) for file in section.files], **given)
        if found.kind != "backbone":
            return found
        # A plain table was read off the analyser's lines; the others say their own scatter.
        lines = _per_mode("resolution", test.resolution, len(test.amplitude))
        line = lines[list(test.amplitude).index(name)] if isinstance(lines, list) else lines
        return found.with_noise(line / math.sqrt(12) / found.frequencies_hz)


def _existing(case: Case, key: str, file: str) -> Path:
    path = case.file(file)
    if not is_file(path):
        expected = f"no such file, expected CSV or TOML at {shown_path(path)}"
        raise InputError(message(key, file, expected))
    return path


def _noise(test: Test, n: int) -> dict[str, object]:
    """How good a test is, by the names of `TestData`, for n modes."""
    return {
        "resolution_hz": _per_mode("resolution", test.resolution, n),
        "noise": _per_mode("noise", test.noise, n),
        "damping_noise": test.damping_noise,
        "shape_noise": test.shape_noise,
    }


def _plan_test(case: Case, test: Test) -> TestData:
    """The layout of the planned test, its values placeholders."""
    names, (condition, unit) = test.planned.names(), test.planned.head()
    conditions = sorted(test.planned.conditions)
    values = np.ones((len(conditions), len(names)))
    planned = TestData(
        conditions,
        values,
        names,
        condition,
        unit,
        damping=1e-3 * values if test.planned.damping else None,
        sensors=case.sensors(),
        **_noise(test, len(names)),
    )
    # A diagnosis asks for the noise of measured damping ratios; planned ones get the usual noise.
    return replace(planned, damping_noise=planned.damping_sd) if test.planned.damping else planned


def _read_universal(case: Case) -> MeasuredShapes:
    """The modes in universal files."""
    section = case.test.shapes
    with located("test.shapes"):
        files = [case.folder / file for file in section.files]
        return read_shapes(files, length_unit=section.length_unit)


def _per_mode(name: str, values: list[float], n: int) -> list[float] | float:
    if len(values) not in (1, n):
        expected = f"expected one value, or {n}: one for each of the modes"
        raise InputError(message(f"test.{name}", values, expected))
    return values if len(values) == n else values[0]


def _shapes_of(found: MeasuredShapes, data: TestData) -> np.ndarray:
    """The shapes of a test's modes, (n_sensors, m), by the frequencies where they were measured.

    Raises:
        InputError: If a mode has no shape near its frequency.
    """
    hz = data.frequencies_hz[data.shape_row]
    if np.isnan(hz).any():
        raise InputError(
            f"{', '.join(found.sources)}: {data.mode_names[int(np.argmax(np.isnan(hz)))]} has no "
            "frequency where the shapes were measured; expected one for each mode, or shapes_at"
        )
    order = np.argsort(hz, kind="stable")
    index = np.empty(len(hz), dtype=int)
    index[order] = found.nearest(hz[order])
    return found.shapes[:, index]


#: Stands for a mesh that cannot be read, or for parts of which none can.
_NO_MESH = {"file": "no mesh.msh"}
_NO_PARTS = {"none": {"cells": "none", "E": 1e11, "nu": 0.3, "rho": 1e3}}


@dataclass(frozen=True, eq=False)
class Examined:
    """What `examine_case` found.

    Attributes:
        path: The case file.
        case: The case; or what can be read of it, for a picture and for masses; None if nothing.
        errors: A line for each thing that is wrong.
        whole: Whether nothing was left out of it.
        has_mesh: Whether its mesh is the file's.
    """

    path: Path
    case: Case | None
    errors: tuple[str, ...]
    whole: bool = True
    has_mesh: bool = True


def examine_case(path: str | Path, changes: Sequence[str] = ()) -> Examined:
    """Read a case as `load_case` does; what is wrong does not end it, as far as it can go on.

    A key that cannot be read is left out, then its section, then its table, so that all other
    sections, and the files that they name, are checked too. Needs no MPI.
    """
    try:
        path, raw = read_case(path, changes)
    except InputError as error:
        return Examined(Path(path), None, (str(error),))
    try:
        case = Case.model_validate(raw)
    except ValidationError as error:
        return _partly(path, raw, error)
    try:
        errors = finish_case(case, path, raw)
    except InputError as error:
        errors = [str(error).removeprefix(f"{path}: ")]
    return Examined(path, case, _all_of(case, errors))


def _partly(path: Path, raw: dict, error: ValidationError) -> Examined:
    """What can be read of a case with errors."""
    errors = [describe(e, Case) for e in error.errors()]
    kept = copy.deepcopy(raw)
    for level in (None, 2, 1):
        for e in error.errors():
            _drop(kept, e["loc"], level)
        kept.setdefault("mesh", dict(_NO_MESH))
        kept["parts"] = kept.get("parts") or dict(_NO_PARTS)
        try:
            case = Case.model_validate(kept)
            break
        except ValidationError as again:
            error = again
    else:
        return Examined(path, None, tuple(errors), whole=False)
    has_mesh = kept["mesh"] != _NO_MESH
    if kept["parts"] == _NO_PARTS:
        case = case.model_copy(update={"parts": {}})
    found = read_part(case, path, has_mesh)
    return Examined(path, case, (*errors, *_all_of(case, found)), whole=False, has_mesh=has_mesh)


def _drop(raw: dict, loc: tuple, level: int | None) -> None:
    """Remove the key of an error of pydantic from the file's content, or its first levels.

    Lists are left out as a whole.
    """
    keys = [key for key in loc if not (isinstance(key, str) and key.startswith(("<", "[")))]
    keys = list(takewhile(lambda key: isinstance(key, str), keys))[:level]
    inside: Any = raw
    for key in keys[:-1]:
        inside = inside.get(key) if isinstance(inside, dict) else None
    if keys and isinstance(inside, dict):
        inside.pop(keys[-1], None)


def _all_of(case: Case, errors: list[str]) -> tuple[str, ...]:
    """The errors, and files that are not there and that none of them names: readers end at one."""
    missing = [
        f"{path.name}: no such file, expected one at {shown_path(path)}"
        for path in case.files()[1:]
        if not is_file(path)
        and path.name != _NO_MESH["file"]
        and not any(path.name in error for error in errors)
    ]
    return (*errors, *missing)

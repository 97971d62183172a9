"""The test of a case from the files of a lab: tables, universal files, functions, amplitudes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fenics_joints.commands.new.draft import OPEN, Ask, Remark, guess
from fenics_joints.commands.new.sources import UNITS, likely_unit
from fenics_joints.errors import InputError, Problems, member
from fenics_joints.measurements import (
    MeasuredBackbone,
    read_amplitude,
    read_frfs,
    read_shapes,
    read_table,
)
from fenics_joints.measurements.amplitude.files import histories_of, history_of, is_history
from fenics_joints.measurements.files import UFF_SUFFIXES, FileMetadata
from fenics_joints.measurements.readers import reader_of
from fenics_joints.measurements.tables import DataTable
from fenics_joints.measurements.uff import read_sets
from fenics_joints.units import factor_to_si, to_si

#: Datasets of nodes and of mode shapes in universal files.
_NODES, _SHAPES = {15, 2411}, {55, 2414}
#: Names of a condition's column without a unit.
_CONDITIONS = ("torque", "level", "force", "preload", "amplitude", "run", "row", "test")
_NO_SENSORS = guess(
    {"points": [["0 mm", "0 mm", "0 mm"]], "direction": [0, 0, 1]},
    "places and directions of the sensors; without them modes are the model's lowest",
)
_WHAT_IT_SAW = "The test's sensors: without them its modes are taken as the model's lowest."
_NO_UNIT = "The unit of the sensors' places, which the files do not say."

#: Extents of the structure, m, or None; looked for where a file does not say its unit.
Extents = Callable[[], np.ndarray | None]


@dataclass(frozen=True)
class TestFiles:
    """The files that are there: tables of frequencies and shapes, functions, universal files, and
    modes over their amplitude."""

    __test__ = False

    frequencies: Path | None = None
    shapes: Path | None = None
    frfs: tuple[Path, ...] = ()
    uff: tuple[Path, ...] = ()
    amplitude: tuple[Path, ...] = ()

    def all(self) -> list[Path]:
        """All of them."""
        one = [path for path in (self.frequencies, self.shapes) if path is not None]
        return [*one, *self.frfs, *self.uff, *self.amplitude]


def _taken(question: str, answer: str, check: Callable[[str], object]) -> str:
    """The answer that is taken for granted."""
    return answer


@dataclass(eq=False)
class TestDraft:
    """The test of a case, to which the files of a lab are added one after another.

    Attributes:
        refer: The name that a file has in the case.
        ask: Asks the user.
        extents: Extents of the structure.
        table: ``[test]``; empty without a test.
        found: What the files hold, in sentences.
        questions: What was guessed, in sentences.
        n_modes: How many modes were measured.
        at: The condition that an update would take; None for one condition.
        places: Sensors, m, shape (n, 3).
        known: Frequencies, Hz, by the modes' names.
    """

    __test__ = False

    refer: Callable[[Path], str] = str
    ask: Ask = _taken
    extents: Extents = lambda: None
    table: dict[str, object] = field(default_factory=dict)
    found: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)
    n_modes: int = 0
    at: float | None = None
    places: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    known: dict[str, float] = field(default_factory=dict)

    def add_frequencies(self, path: Path) -> None:
        """A table of frequencies."""
        table = read_table(path)
        self.table["frequencies"] = self.refer(path)
        conditions = [name for name in table.names if _is_condition(table, name)]
        modes = [name for name in table.names if name not in conditions]
        count = len(table.values)
        if conditions:
            unit = table.unit(conditions[0])
            words = f"in {unit}" if unit else "? without a unit"
            self.table |= {"condition": Remark(conditions[0], words), "modes": modes}
            values = table.column(conditions[0])
        else:
            values = np.arange(1.0, count + 1)
        self.at = float(values[-1]) if count > 1 else None
        units = {name: "Hz" if table.unit(name) else None for name in modes}
        self.known = {name: float(table.column(name, units[name])[-1]) for name in modes}
        self.n_modes = len(modes)
        self.found.append(f"{self.n_modes} modes in {path.name}")

    def add_universal(self, paths: Sequence[Path]) -> None:
        """Universal files with mode shapes."""
        unit = None
        if not _says_unit(paths):
            unit = self._unit_of(paths, read_shapes(paths, length_unit="m").sensors.points)
        shapes = read_shapes(paths, length_unit=unit)
        self.places = shapes.sensors.points
        if not self.n_modes:
            self.n_modes = len(shapes.frequencies_hz)
            self.known = {f"mode {i + 1}": hz for i, hz in enumerate(shapes.frequencies_hz)}
        self.found.append(repr(shapes).removeprefix("MeasuredShapes(").removesuffix(")"))
        names = [self.refer(path) for path in paths]
        self.table["shapes"] = names[0] if len(names) == 1 else names
        if unit is not None:
            unit = guess(unit, "the files do not say it")
            self.table["shapes"] = {"files": names, "length_unit": unit}

    def add_shape_table(self, path: Path) -> None:
        """A table with a row for each sensor, whose place may stand in columns x, y and z."""
        table, file = read_table(path), self.refer(path)
        names = {name.lower(): name for name in table.names}
        if not {"x", "y", "z"} <= names.keys():
            words = "with the places of its rows, the sensors, in [test.sees]"
            self.table |= {f"{OPEN}shapes": guess(file, words), f"{OPEN}sees": _NO_SENSORS}
            self.questions.append(
                f"Where the sensors of {path.name} are: columns 'x [mm]', 'y [mm]', 'z [mm]' in it"
                " are enough."
            )
            return
        units = [table.unit(names[axis]) for axis in "xyz"]
        if any(units) and not all(units):
            raise InputError(
                f"{path}: units of x, y and z are {', '.join(unit or 'none' for unit in units)}; "
                "expected all three, such as 'x [mm]', or none"
            )
        columns = [table.column(names[axis], "m" if units[0] else None) for axis in "xyz"]
        points, words = np.column_stack(columns), ""
        if not units[0]:
            unit = self._unit_of([path], points)
            points, words = UNITS[unit] * points, f"? m, the table's numbers taken as {unit}"
        sees = {"points": Remark([Remark(p.tolist(), "") for p in points], words)}
        ways = [names.get(f"d{axis}") for axis in "xyz"]
        if all(ways):
            directions = np.column_stack([table.column(way) for way in ways])
            sees["directions"] = [Remark(d.tolist(), "") for d in directions]
        else:
            thin = np.eye(3, dtype=int)[int(np.ptp(points, axis=0).argmin())]
            sees["direction"] = guess(thin.tolist(), "columns dx, dy, dz would give it")
            self.questions.append("The directions of the sensors.")
        self.table |= {"shapes": file, "sees": sees}
        self.places = points

    def add_functions(self, paths: Sequence[Path]) -> None:
        """Measured functions; the test's modes, too, where nothing else gives any."""
        universal = [path for path in paths if path.suffix.lower() in UFF_SUFFIXES]
        unit = None
        if not _says_unit(universal):
            frfs = read_frfs(paths, length_unit="m")
            unit = self._unit_of(
                universal, np.vstack([frfs.response_points, frfs.reference_points])
            )
        frfs = read_frfs(paths, length_unit=unit)
        section: dict[str, object] = {"files": [self.refer(path) for path in paths]}
        if unit is not None:
            section["length_unit"] = guess(unit, "the files do not say it")
        if not self.n_modes:
            near = guess(["100 Hz", "200 Hz"], "the modes, roughly; else all stable poles")
            section["identify"] = {f"{OPEN}near": near}
        self.table["frfs"] = section if len(section) > 1 else section["files"]
        hz = frfs.frequencies_hz
        self.found.append(f"{int(frfs.measured.sum())} FRFs, {hz[0]:g} to {hz[-1]:g} Hz")
        self.n_modes = self.n_modes or 1

    def add_amplitude(self, paths: Sequence[Path]) -> None:
        """Modes over their amplitude, as a test of their own where nothing else gives modes.

        Each file is of one mode; files of one mode and kind are put together.
        """
        problems, groups = Problems(), []
        for path in paths:
            one = problems.tried(lambda path=path: _read_file(path, self.refer, self.ask))
            if one is not None:
                _merge(groups, one)
        problems.check()
        sections, found, questions = {}, [], [_NAMED]
        for name, data in zip(_mode_names(groups, self.known), groups, strict=True):
            files, section = ", ".join(data.files), {"files": data.files, **data.options}
            if data.backbone is None:  # what was held constant no file says
                questions.append(f"The levels of the {data.functions} FRFs in {files}.")
                found.append(f"{data.functions} FRFs of one mode, of unknown levels, in {files}")
                likely = [f"{5 * (i + 1)} m/s2" for i in range(data.functions)]
                levels = guess(likely, "of each FRF, in the file's order, with their unit")
                sections[f"{OPEN}{name}"] = {"files": data.files, "levels": levels}
                continue
            kind = data.backbone.kind
            if kind == "backbone":
                words = "of these frequencies alone; or a column frequency sd [Hz]"
                section[f"{OPEN}noise"] = guess("0.1 %", words)
                section[f"{OPEN}damping_noise"] = guess("10 %", "or a column damping sd [%]")
            sections[name] = guess(section, f"{data.hz:.4g} Hz at its lowest level")
            found.append(f"{name} at {len(data.backbone)} amplitudes ({kind}) in {files}")
            if "sensor" in data.options:
                questions.append(f"The sensor that the amplitude in {files} is of.")
        read = sum(data.backbone is not None for data in groups)
        if not (read or self.n_modes):
            raise InputError(
                f"{'; '.join(found)}: expected the levels (answer for them, without --yes), "
                "or frequencies beside them"
            )
        self.table["amplitude"] = sections
        self.found += found
        self.questions += questions
        self.n_modes = self.n_modes or read

    def _unit_of(self, paths: Sequence[Path], points: np.ndarray) -> str:
        """The unit of places, by the size of the structure."""
        spans = np.ptp(points, axis=0)
        names, across = ", ".join(p.name for p in paths), " x ".join(f"{s:.6g}" for s in spans)
        question = f"Unit of the sensors' places in {names} (they span {across})"
        likely = likely_unit(spans, self.extents())
        if _NO_UNIT not in self.questions:
            self.questions.append(_NO_UNIT)
        return self.ask(question, likely, lambda answer: member("unit", answer, UNITS))

    def finish(self, seen: bool) -> None:
        """Ask for the noise; ``seen`` if something says where the sensors were."""
        if not seen:
            self.table[f"{OPEN}sees"] = _NO_SENSORS
            self.questions.append(_WHAT_IT_SAW)
        noise = self.ask(
            "Scatter of the measured frequencies", "0.2 %", lambda text: to_si(text, "")
        )
        self.table["noise"] = guess(noise, "how much frequencies differ between tests")
        self.table[f"{OPEN}mass"] = "1 kg"
        self.questions.append("The scatter of the test: take it apart and test again.")


def draft_test(
    files: TestFiles, refer: Callable[[Path], str], ask: Ask, extents: Extents = lambda: None
) -> TestDraft:
    """The ``[test]`` of some files.

    Args:
        files: The files.
        refer: The name that a file has in the case.
        ask: Asks the user.
        extents: Of the structure; called where a file does not say the unit of its places.

    Raises:
        InputError: For what is wrong in a file.
    """
    test, problems = TestDraft(refer, ask, extents), Problems()
    if not files.all():
        return test
    modal, functions = problems.tried(lambda: _sorted(files)) or ([], [])
    table = files.shapes
    if table is not None and table.suffix.lower() in UFF_SUFFIXES:
        table = None
    steps = (
        (test.add_frequencies, files.frequencies),
        (test.add_universal, modal),
        (test.add_shape_table, None if modal else table),
        (test.add_amplitude, files.amplitude),
        (test.add_functions, functions),
    )
    for add, given in steps:
        if given:
            problems.tried(lambda add=add, given=given: add(given))
    problems.check()
    test.finish(seen=bool(modal or functions or table))
    return test


def _sorted(files: TestFiles) -> tuple[list[Path], list[Path]]:
    """Universal files with shapes, and files with functions; files of nodes alone go with both."""
    modal, functions = [], list(files.frfs)
    uff = list(files.uff)
    if files.shapes is not None and files.shapes.suffix.lower() in UFF_SUFFIXES:
        uff.append(files.shapes)
    nodes = []
    for path in dict.fromkeys(uff):
        kinds = {int(data["type"]) for _, data in read_sets(path, (*_SHAPES, 58, *_NODES))}
        if kinds & _SHAPES:
            modal.append(path)
        if 58 in kinds and path not in functions:
            functions.append(path)
        if kinds and kinds <= _NODES:
            nodes.append(path)
        elif not kinds & {*_SHAPES, 58}:
            raise InputError(
                f"{path}: holds neither mode shapes (datasets 55 or 2414) nor FRFs (58): "
                "expected one"
            )
    universal = [p for p in functions if p.suffix.lower() in UFF_SUFFIXES]
    return modal + nodes * bool(modal), functions + nodes * bool(universal)


def _is_condition(table: DataTable, name: str) -> bool:
    """Whether a column is what the test was repeated at, by its unit, or its name."""
    unit = table.unit(name)
    if not unit:
        return name.lower() in _CONDITIONS
    try:
        factor_to_si(unit, "Hz")
    except InputError:
        return True
    return False


def _says_unit(paths: Sequence[Path]) -> bool:
    """Whether universal files say the unit of their nodes' places, or have none."""
    kinds = {data["type"] for path in paths for _, data in read_sets(path, (164, *_NODES))}
    return 164 in kinds or not kinds


# -- modes over their amplitude --------------------------------------------------------------------


#: A mode of a table is that of amplitude data if their frequencies differ by less, relative.
_ONE_MODE = 0.05
#: Type of a response over time in datasets 58.
_TIME = 1
_NAMED = (
    "The mode of the amplitude data: by its frequency where there are others, else the lowest that "
    "the sensors see."
)


@dataclass(frozen=True, eq=False)
class _ModeFiles:
    """Files of one mode: their names in the case, options of the section, and what they say.

    Without a backbone the levels of so many ``functions`` are not known.
    """

    files: tuple[str, ...]
    options: Mapping[str, object] = field(default_factory=dict)
    backbone: MeasuredBackbone | None = None
    functions: int = 0

    @property
    def hz(self) -> float:
        """Frequency at its lowest level, Hz; nan where that is not known."""
        return np.nan if self.backbone is None else float(self.backbone.frequencies_hz[0])


def _read_file(path: Path, refer, ask: Ask) -> _ModeFiles:
    """One file, with what it leaves open."""
    files, suffix = (refer(path),), path.suffix.lower()
    sensors: list[str] = []
    if suffix in UFF_SUFFIXES and _holds_time(path):
        sensors = list(dict.fromkeys(n for history in histories_of(path) for n in history.signals))
    elif suffix in (*UFF_SUFFIXES, ".mat"):
        count, units = _count_functions(path, ask)
        options = {} if units is None else {"units": units}
        if not (levels := _asked_levels(path, count, ask)):
            return _ModeFiles(files, options, functions=count)
        read = read_amplitude(path, levels=levels, units=units)
        return _ModeFiles(files, {"levels": levels, **options}, read)
    elif suffix in (".csv", ".toml", ".txt") and is_history(table := read_table(path)):
        sensors = list(history_of(table).signals)
    if len(sensors) < 2:
        return _ModeFiles(files, {}, read_amplitude(path))
    question = f"Sensor that the amplitude in {path.name} is of ({', '.join(sensors)})"
    sensor = ask(question, sensors[0], lambda answer: member("sensor", answer, sensors))
    others = [other for other in sensors if other != sensor]
    options = {"sensor": guess(sensor, f"or {', '.join(others)}")}
    return _ModeFiles(files, options, read_amplitude(path, sensor=sensor))


def _holds_time(path: Path) -> bool:
    """Whether a universal file holds responses over time."""
    return any(data["func_type"] == _TIME for _, data in read_sets(path, (58,)))


def _count_functions(path: Path, ask: Ask) -> tuple[int, str | None]:
    """How many functions a file has, and their unit where it had to be asked for."""

    def read(units: str | None) -> int:
        return len(reader_of(path)(path, FileMetadata(units=units)).functions)

    try:
        return read(None), None
    except InputError as error:
        question = f"{error}. Unit of the FRFs, such as m/s2/N (or none)"
        units = ask(question, "", lambda answer: answer and read(answer))
        if not units:
            raise
        return read(units), units


def _asked_levels(path: Path, count: int, ask: Ask) -> list[str]:
    """The levels of functions, which only the user knows; none if he does not say them."""

    def known(answer: str) -> None:
        if answer.strip() and len(_levels_in(answer)) != count:
            raise ValueError(f"{answer!r}: expected {count} levels, such as 5 m/s2, 10 m/s2")

    question = f"Levels of the {count} FRFs in {path.name}, such as 5 m/s2, 10 m/s2 (or none)"
    return _levels_in(ask(question, "", known))


def _levels_in(answer: str) -> list[str]:
    return [part.strip() for part in answer.split(",") if part.strip()]


def _merge(groups: list[_ModeFiles], one: _ModeFiles) -> None:
    """Add a file to the group of its mode and kind, or begin a new group."""
    for i, there in enumerate(groups):
        same = np.isfinite(there.hz) and abs(there.hz - one.hz) < _ONE_MODE * there.hz
        kinds = {(d.backbone.kind, d.backbone.response) for d in (there, one)} if same else ()
        if same and len(kinds) == 1 and there.options == one.options == {}:
            groups[i] = _ModeFiles((*there.files, *one.files), {}, there.backbone)
            return
    groups.append(one)


def _mode_names(groups: Sequence[_ModeFiles], known: Mapping[str, float]) -> list[str]:
    """A name for each: that of the test's mode of that frequency, or by its place."""
    taken, names = set(), []
    free = (f"mode {i}" for i in range(1, len(groups) + len(known) + 1))
    for data in groups:
        name = None
        if known and np.isfinite(data.hz):
            near = min(known, key=lambda n: abs(known[n] - data.hz))
            if abs(known[near] - data.hz) < _ONE_MODE * data.hz and near not in taken:
                name = near
        if name is None:
            name = next(n for n in free if n not in taken and n not in known)
        taken.add(name)
        names.append(name)
    return names

"""The test of a case from the files of a lab: tables, universal files, measured functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.commands.new.amplitude import draft_amplitude
from fenics_joints.commands.new.draft import OPEN, Ask, Remark, TestDraft, guess
from fenics_joints.commands.new.extents import UNITS, likely_unit
from fenics_joints.errors import InputError, Problems, member
from fenics_joints.measurements import read_frfs, read_shapes, read_table
from fenics_joints.measurements.files import UFF_SUFFIXES
from fenics_joints.measurements.tables import Table
from fenics_joints.measurements.uff import read_sets
from fenics_joints.units import factor_to_si, to_si

_NODES, _SHAPES = {15, 2411}, {55, 2414}
#: Names of a condition's column without a unit.
_CONDITIONS = ("torque", "level", "force", "preload", "amplitude", "run", "row", "test")
_NO_SENSORS = guess(
    {"points": [["0 mm", "0 mm", "0 mm"]], "direction": [0, 0, 1]},
    "places and directions of the sensors; without them the modes are the model's lowest",
)
_WHAT_IT_SAW = "What the test saw: without sensors its modes are the model's lowest."
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
    if not files.all():
        return TestDraft()
    reading, problems = _Reading(refer, ask, extents), Problems()
    modal, functions = problems.tried(lambda: _sorted(files)) or ([], [])
    table = files.shapes
    if table is not None and table.suffix.lower() in UFF_SUFFIXES:
        table = None
    if files.frequencies is not None:
        problems.tried(lambda: reading.add_frequencies(files.frequencies))
    if modal:
        problems.tried(lambda: reading.add_universal(modal))
    elif table is not None:
        problems.tried(lambda: reading.add_shape_table(table))
    if files.amplitude:
        problems.tried(lambda: reading.add_amplitude(files.amplitude))
    if functions:
        problems.tried(lambda: reading.add_functions(functions))
    problems.check()
    return reading.done(seen=bool(modal or functions or table))


class _Reading:
    """What the files of a test say so far."""

    def __init__(self, refer: Callable[[Path], str], ask: Ask, extents: Extents):
        self.refer, self.ask, self.extents = refer, ask, extents
        self.table: dict[str, object] = {}
        self.found, self.questions = [], []
        self.n_modes, self.at, self.places = 0, None, np.empty((0, 3))
        self.known: dict[str, float] = {}  # frequencies, Hz, by the modes' names

    def add_frequencies(self, path: Path) -> None:
        """A table of them."""
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
        """Files with mode shapes."""
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
            self.table["shapes"] = {"files": names, "length_unit": _guessed_unit(unit)}

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
            sees["direction"] = guess(thin.tolist(), "columns dx, dy, dz would say it")
            self.questions.append("Which way the sensors look.")
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
            section["length_unit"] = _guessed_unit(unit)
        if not self.n_modes:
            near = guess(["100 Hz", "200 Hz"], "about where they are; else all that are stable")
            section["identify"] = {f"{OPEN}near": near}
        self.table["frfs"] = section if len(section) > 1 else section["files"]
        hz = frfs.frequencies_hz
        self.found.append(f"{int(frfs.measured.sum())} functions, {hz[0]:g} to {hz[-1]:g} Hz")
        self.n_modes = self.n_modes or 1

    def add_amplitude(self, paths: Sequence[Path]) -> None:
        """Modes over their amplitude, as a test of their own where nothing else gives modes."""
        sections, found, questions = draft_amplitude(paths, self.refer, self.ask, self.known)
        read = [name for name in sections if not name.startswith(OPEN)]
        if not (read or self.n_modes):
            raise InputError(
                f"{'; '.join(found)}: expected the levels (answer for them, without --yes), "
                "or frequencies beside them"
            )
        self.table["amplitude"] = sections
        self.found += found
        self.questions += questions
        self.n_modes = self.n_modes or len(read)

    def _unit_of(self, paths: Sequence[Path], points: np.ndarray) -> str:
        """The unit of places, by the size of the structure."""
        spans = np.ptp(points, axis=0)
        names, across = ", ".join(p.name for p in paths), " x ".join(f"{s:.6g}" for s in spans)
        question = f"Unit of the sensors' places in {names} (they span {across})"
        likely = likely_unit(spans, self.extents())
        if _NO_UNIT not in self.questions:
            self.questions.append(_NO_UNIT)
        return self.ask(question, likely, lambda answer: member("unit", answer, UNITS))

    def done(self, seen: bool) -> TestDraft:
        """The test; ``seen`` if something says where its sensors were."""
        if not seen:
            self.table[f"{OPEN}sees"] = _NO_SENSORS
            self.questions.append(_WHAT_IT_SAW)
        noise = self.ask(
            "Scatter of the measured frequencies", "0.2 %", lambda text: to_si(text, "")
        )
        self.table["noise"] = guess(noise, "how much frequencies differ between tests")
        self.table[f"{OPEN}mass"] = Remark("1 kg", "what all of it weighs, for check")
        self.questions.append("The scatter of the test: take it apart and test again.")
        return TestDraft(
            self.table, tuple(self.found), self.n_modes, self.at, self.places, tuple(self.questions)
        )


def _guessed_unit(unit: str) -> Remark:
    return guess(unit, "the files do not say it")


def _sorted(files: TestFiles) -> tuple[list[Path], list[Path]]:
    """Universal files with shapes, and files with functions; those of nodes alone go with both."""
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
                f"{path}: holds neither mode shapes (datasets 55 or 2414) nor functions (58): "
                "expected one"
            )
    universal = [p for p in functions if p.suffix.lower() in UFF_SUFFIXES]
    return modal + nodes * bool(modal), functions + nodes * bool(universal)


def _is_condition(table: Table, name: str) -> bool:
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

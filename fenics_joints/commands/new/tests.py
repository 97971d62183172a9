"""The test of a case from the files of a lab: tables, universal files, measured functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.commands.new.amplitude import amplitude_sketch, check_any
from fenics_joints.commands.new.extents import UNITS, likely_unit
from fenics_joints.commands.new.sketch import Ask, TestSketch, toml
from fenics_joints.errors import InputError, Problems, member
from fenics_joints.measurements import read_frfs, read_shapes, read_table
from fenics_joints.measurements.files import UFF_SUFFIXES
from fenics_joints.measurements.tables import Table
from fenics_joints.measurements.uff_sets import read_sets
from fenics_joints.units import factor_to_si, to_si

_NODES, _SHAPES = {15, 2411}, {55, 2414}
#: Names of a condition's column without a unit.
_CONDITIONS = ("torque", "level", "force", "preload", "amplitude", "run", "row", "test")
_NO_SENSORS = (
    "# [test.sees]  # ? where the sensors were and which way they looked: modes that they cannot",
    "# see are then left out; without it the test's modes are the model's lowest, in their order",
    '# points = [["0 mm", "0 mm", "0 mm"]]',
    "# direction = [0, 0, 1]",
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


def test_sketch(
    files: TestFiles, refer: Callable[[Path], str], ask: Ask, extents: Extents = lambda: None
) -> TestSketch:
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
        return TestSketch()
    draft, problems = _Draft(refer, ask, extents), Problems()
    modal, functions = problems.tried(lambda: _sorted(files)) or ([], [])
    table = files.shapes
    if table is not None and table.suffix.lower() in UFF_SUFFIXES:
        table = None
    if files.frequencies is not None:
        problems.tried(lambda: draft.add_frequencies(files.frequencies))
    if modal:
        problems.tried(lambda: draft.add_universal(modal))
    elif table is not None:
        problems.tried(lambda: draft.add_shape_table(table))
    if files.amplitude:
        problems.tried(lambda: draft.add_amplitude(files.amplitude))
    if functions:
        problems.tried(lambda: draft.add_functions(functions))
    problems.check()
    return draft.done(seen=bool(modal or functions or table))


class _Draft:
    """A test in the making."""

    def __init__(self, refer: Callable[[Path], str], ask: Ask, extents: Extents):
        self.refer, self.ask, self.extents = refer, ask, extents
        self.lines, self.tables = ["[test]"], []
        self.found, self.questions = [], []
        self.n_modes, self.at, self.places = 0, None, np.empty((0, 3))
        self.known: dict[str, float] = {}  # frequencies, Hz, by the modes' names

    def add_frequencies(self, path: Path) -> None:
        """A table of them."""
        head, self.known, self.at = _frequencies(path, self.refer)
        self.n_modes = len(self.known)
        self.lines += head
        self.found.append(f"{self.n_modes} modes in {path.name}")

    def add_universal(self, paths: Sequence[Path]) -> None:
        """Files with mode shapes."""
        shapes, unit = _universal(paths, self.ask, self.extents)
        self.places = shapes.sensors.points
        if not self.n_modes:
            self.n_modes = len(shapes.frequencies_hz)
            self.known = {f"mode {i + 1}": hz for i, hz in enumerate(shapes.frequencies_hz)}
        self.found.append(repr(shapes).removeprefix("MeasuredShapes(").removesuffix(")"))
        names = [self.refer(path) for path in paths]
        if unit is None:
            self.lines.append(f"shapes = {toml(names[0] if len(names) == 1 else names)}")
            return
        self.tables += [
            "",
            "[test.shapes]",
            f"files = {toml(names)}",
            f"length_unit = {toml(unit)}  # ? the files do not say it",
        ]
        self.questions.append(_NO_UNIT)

    def add_shape_table(self, path: Path) -> None:
        """A table with a row for each sensor."""
        head, sees, asked, self.places = _shape_table(path, self.refer, self.ask, self.extents)
        self.lines += head
        self.tables += sees
        self.questions += asked

    def add_functions(self, paths: Sequence[Path]) -> None:
        """Measured functions; the test's modes, too, where nothing else gives any."""
        frfs, unit = _read_functions(paths, self.ask, self.extents)
        names = [self.refer(path) for path in paths]
        more = _functions(names, unit, identify=not self.n_modes)
        (self.tables if more[0] == "" else self.lines).extend(more)
        self.found.append(
            f"{int(frfs.measured.sum())} functions, {frfs.frequencies_hz[0]:g} to "
            f"{frfs.frequencies_hz[-1]:g} Hz"
        )
        self.questions += [_NO_UNIT] * (unit is not None and _NO_UNIT not in self.questions)
        self.n_modes = self.n_modes or 1

    def add_amplitude(self, paths: Sequence[Path]) -> None:
        """Modes over their amplitude, as a test of their own where nothing else gives modes."""
        found = amplitude_sketch(paths, self.refer, self.ask, self.known)
        check_any(found, alone=not self.n_modes)
        self.tables += found.lines
        self.found += found.found
        self.questions += found.questions
        self.n_modes = self.n_modes or found.n_modes

    def done(self, seen: bool) -> TestSketch:
        """The test; ``seen`` if something says where its sensors were."""
        if not seen:
            self.tables += ("", *_NO_SENSORS)
            self.questions.append(_WHAT_IT_SAW)
        noise = self.ask(
            "Scatter of the measured frequencies", "0.2 %", lambda text: to_si(text, "")
        )
        self.lines.append(f"noise = {toml(noise)}  # ? how much frequencies differ between tests")
        self.lines.append('# mass = "1 kg"  # what all of it weighs, for check')
        self.questions.append("The scatter of the test: take it apart and test again.")
        return TestSketch(
            (*self.lines, *self.tables),
            tuple(self.found),
            self.n_modes,
            self.at,
            self.places,
            tuple(self.questions),
        )


#: Not a test, whatever pytest thinks of the name.
test_sketch.__test__ = False


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


def _frequencies(path: Path, refer) -> tuple[list[str], dict[str, float], float | None]:
    """Lines for a table of frequencies; its modes, with what stands in its last row, Hz; the last
    condition."""
    table = read_table(path)
    conditions = [name for name in table.names if _is_condition(table, name)]
    lines = [f"frequencies = {toml(refer(path))}"]
    if not conditions:
        at = None if len(table.values) == 1 else float(len(table.values))
        return lines, _last(table, table.names), at
    name = conditions[0]
    modes = [other for other in table.names if other not in conditions]
    unit = f"  # in {table.unit(name)}" if table.unit(name) else "  # ? without a unit"
    lines += [f"condition = {toml(name)}{unit}", f"modes = {toml(modes)}"]
    values = table.column(name)
    return lines, _last(table, modes), float(values[-1]) if len(values) > 1 else None


def _last(table: Table, modes: Sequence[str]) -> dict[str, float]:
    """Frequencies, Hz, of the last row; nan where it has none."""
    values = {name: table.column(name, "Hz" if table.unit(name) else None) for name in modes}
    return {name: float(column[-1]) for name, column in values.items()}


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


def _universal(paths: Sequence[Path], ask: Ask, extents: Extents):
    """The shapes, and the unit of length that the files leave out, or None."""
    if _says_unit(paths):
        return read_shapes(paths), None
    points = read_shapes(paths, length_unit="m").sensors.points
    unit = _asked_unit(paths, points, ask, extents)
    return read_shapes(paths, length_unit=unit), unit


def _says_unit(paths: Sequence[Path]) -> bool:
    """Whether universal files say the unit of their nodes' places, or have none."""
    kinds = {data["type"] for path in paths for _, data in read_sets(path, (164, *_NODES))}
    return 164 in kinds or not kinds


def _asked_unit(paths: Sequence[Path], points: np.ndarray, ask: Ask, extents: Extents) -> str:
    """The unit of places, by the size of the structure."""
    spans = np.ptp(points, axis=0)

    def known(answer: str) -> None:
        member("unit", answer, UNITS)

    names, across = ", ".join(p.name for p in paths), " x ".join(f"{s:.6g}" for s in spans)
    question = f"Unit of the sensors' places in {names} (they span {across})"
    return ask(question, likely_unit(spans, extents()), known)


def _shape_table(
    path: Path, refer, ask: Ask, extents: Extents
) -> tuple[list[str], list[str], list[str], np.ndarray]:
    """Lines for a table of shapes, whose places may stand in it as columns x, y and z."""
    table = read_table(path)
    names = {name.lower(): name for name in table.names}
    file = toml(refer(path))
    if not {"x", "y", "z"} <= names.keys():
        lines = [
            f"# shapes = {file}  # ? with the places of its rows, the sensors:",
            "# [test.sees]",
            '# points = [["0 mm", "0 mm", "0 mm"], ...]',
            "# direction = [0, 0, 1]",
        ]
        asked = (
            f"Where the sensors of {path.name} are: columns 'x [mm]', 'y [mm]', 'z [mm]' in it"
            " are enough."
        )
        return [lines[0]], ["", *lines[1:]], [asked], np.empty((0, 3))
    said = [table.unit(names[axis]) for axis in "xyz"]
    if any(said) and not all(said):
        raise InputError(
            f"{path}: units of x, y and z are {', '.join(unit or 'none' for unit in said)}; "
            "expected all three, such as 'x [mm]', or none"
        )
    points = np.column_stack(
        [table.column(names[axis], "m" if said[0] else None) for axis in "xyz"]
    )
    asked, guess = [], ""
    if not said[0]:
        unit = _asked_unit([path], points, ask, extents)
        points, asked = UNITS[unit] * points, [_NO_UNIT]
        guess = f"  # ? m, the table's numbers taken as {unit}"
    sees = [
        "",
        "[test.sees]",
        f"points = [{guess}",
        *(f"  {toml(p.tolist())}," for p in points),
        "]",
    ]
    ways = [names.get(f"d{axis}") for axis in "xyz"]
    if all(ways):
        directions = np.column_stack([table.column(way) for way in ways])
        sees += ["directions = [", *(f"  {toml(d.tolist())}," for d in directions), "]"]
        return [f"shapes = {file}"], sees, asked, points
    thin = np.eye(3, dtype=int)[int(np.ptp(points, axis=0).argmin())]
    sees.append(f"direction = {toml(thin.tolist())}  # ? columns dx, dy, dz would say it")
    return [f"shapes = {file}"], sees, [*asked, "Which way the sensors look."], points


def _read_functions(paths: Sequence[Path], ask: Ask, extents: Extents):
    """The functions, and the unit of length that the files leave out, or None."""
    universal = [path for path in paths if path.suffix.lower() in UFF_SUFFIXES]
    if _says_unit(universal):
        return read_frfs(paths), None
    frfs = read_frfs(paths, length_unit="m")
    points = np.vstack([frfs.response_points, frfs.reference_points])
    unit = _asked_unit(universal, points, ask, extents)
    return read_frfs(paths, length_unit=unit), unit


def _functions(names: Sequence[str], unit: str | None, identify: bool) -> list[str]:
    """Lines for measured functions; with modes from them where nothing else gives any."""
    if not identify and unit is None:
        return [f"frfs = {toml(names)}"]
    lines = ["", "[test.frfs]", f"files = {toml(names)}"]
    if unit is not None:
        lines.append(f"length_unit = {toml(unit)}  # ? the files do not say it")
    if identify:
        lines += [
            "",
            "[test.frfs.identify]",
            '# near = ["100 Hz", "200 Hz"]  # ? about where they are; else all that are stable',
        ]
    return lines

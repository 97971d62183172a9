"""Modes over their amplitude in a new case: each file by what it holds, questions on the rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fenics_joints.commands.new.draft import OPEN, Ask, Remark, guess
from fenics_joints.errors import InputError, Problems, member
from fenics_joints.measurements import MeasuredBackbone, read_amplitude, read_table
from fenics_joints.measurements.amplitude.files import history_of, is_history
from fenics_joints.measurements.files import UFF_SUFFIXES, FileMetadata, reader_of
from fenics_joints.measurements.uff import read_sets

#: A mode of a table is that of amplitude data if their frequencies differ by less, relative.
_ONE_MODE = 0.05
#: Type of a response over time in datasets 58.
_TIME = 1
_NAMED = (
    "The mode of the amplitude data: by its frequency where there are others, else the lowest that "
    "the sensors see."
)


@dataclass(frozen=True, eq=False)
class _Data:
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


def draft_amplitude(
    paths: Sequence[Path], refer: Callable[[Path], str], ask: Ask, known: Mapping[str, float]
) -> tuple[dict[str, Remark], list[str], list[str]]:
    """What files of modes over their amplitude say.

    Args:
        paths: The files: each of one mode; those of one mode are put together.
        refer: The name that a file has in the case.
        ask: Asks the user.
        known: Frequencies, Hz, of the test's other modes by their names.

    Returns:
        ``[test.amplitude]``, what was found, and what was guessed.

    Raises:
        InputError: For what is wrong in the files, all of them.
    """
    problems, groups = Problems(), []
    for path in paths:
        one = problems.tried(lambda path=path: _looked(path, refer, ask))
        if one is not None:
            _put(groups, one)
    problems.check()
    sections, found, questions = {}, [], [_NAMED]
    for name, data in zip(_names(groups, known), groups, strict=True):
        files = ", ".join(data.files)
        if data.backbone is None:  # what was held constant no file says
            questions.append(f"The levels of the {data.functions} functions in {files}.")
            found.append(f"{data.functions} functions of one mode, of unknown levels, in {files}")
            likely = [f"{5 * (i + 1)} m/s2" for i in range(data.functions)]
            levels = guess(likely, "of each function, in the file's order, with their unit")
            sections[f"{OPEN}{name}"] = {"files": data.files, "levels": levels}
            continue
        section = {"files": data.files, **data.options}
        if data.backbone.kind == "backbone":
            words = "of these frequencies alone; or a column frequency sd [Hz]"
            section[f"{OPEN}noise"] = guess("0.1 %", words)
            section[f"{OPEN}damping_noise"] = guess("10 %", "or a column damping sd [%]")
        sections[name] = guess(section, f"{data.hz:.4g} Hz at its lowest level")
        kind = data.backbone.kind
        found.append(f"{name} at {len(data.backbone)} amplitudes ({kind}) in {files}")
        if "sensor" in data.options:
            questions.append(f"The sensor that the amplitude in {files} is of.")
    return sections, found, questions


def _looked(path: Path, refer, ask: Ask) -> _Data:
    """One file, with what it leaves open."""
    if path.suffix.lower() in (*UFF_SUFFIXES, ".mat") and not _is_record(path):
        count, units = _functions(path, ask)
        levels = _asked_levels(path, count, ask)
        options = {} if units is None else {"units": units}
        if not levels:
            return _Data((refer(path),), options, functions=count)
        read = read_amplitude(path, levels=levels, units=units)
        return _Data((refer(path),), {"levels": levels, **options}, read)
    sensors = _sensors(path)
    if len(sensors) > 1:
        question = f"Sensor that the amplitude in {path.name} is of ({', '.join(sensors)})"
        sensor = ask(question, sensors[0], lambda answer: member("sensor", answer, sensors))
        others = [other for other in sensors if other != sensor]
        options = {"sensor": guess(sensor, f"or {', '.join(others)}")}
        return _Data((refer(path),), options, read_amplitude(path, sensor=sensor))
    return _Data((refer(path),), {}, read_amplitude(path))


def _functions(path: Path, ask: Ask) -> tuple[int, str | None]:
    """How many functions a file has, and their unit where it had to be asked for."""

    def read(units: str | None) -> int:
        return len(reader_of(path)(path, FileMetadata(units=units)).functions)

    try:
        return read(None), None
    except InputError as error:
        question = f"{error}. Unit of the functions, such as m/s2/N (or none)"
        units = ask(question, "", lambda answer: answer and read(answer))
        if not units:
            raise
        return read(units), units


def _is_record(path: Path) -> bool:
    """Whether a universal file holds responses over time."""
    if path.suffix.lower() not in UFF_SUFFIXES:
        return False
    return any(data["func_type"] == _TIME for _, data in read_sets(path, (58,)))


def _sensors(path: Path) -> list[str]:
    """Sensors of records over time; none of other files."""
    if path.suffix.lower() in UFF_SUFFIXES:
        from fenics_joints.measurements.amplitude.files import histories_of

        return list(dict.fromkeys(n for history in histories_of(path) for n in history.signals))
    table = read_table(path) if path.suffix.lower() in (".csv", ".toml", ".txt") else None
    return list(history_of(table).signals) if table is not None and is_history(table) else []


def _asked_levels(path: Path, count: int, ask: Ask) -> list[str]:
    """The levels of functions, which no file says; none if nobody does."""

    def known(answer: str) -> None:
        if answer.strip() and len(_split(answer)) != count:
            raise ValueError(f"{answer!r}: expected {count} levels, such as 5 m/s2, 10 m/s2")

    question = f"Levels of the {count} functions in {path.name}, such as 5 m/s2, 10 m/s2 (or none)"
    return _split(ask(question, "", known))


def _split(answer: str) -> list[str]:
    return [part.strip() for part in answer.split(",") if part.strip()]


def _put(groups: list[_Data], one: _Data) -> None:
    """Add a file to those of its mode and kind, or as a mode of its own."""
    for i, there in enumerate(groups):
        same = np.isfinite(there.hz) and abs(there.hz - one.hz) < _ONE_MODE * there.hz
        kinds = {(d.backbone.kind, d.backbone.response) for d in (there, one)} if same else ()
        if same and len(kinds) == 1 and there.options == one.options == {}:
            groups[i] = _Data((*there.files, *one.files), {}, there.backbone)
            return
    groups.append(one)


def _names(groups: Sequence[_Data], known: Mapping[str, float]) -> list[str]:
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

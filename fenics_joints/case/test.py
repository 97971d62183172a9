"""The ``[test]`` section of a case file: what was measured, or is planned."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from fenics_joints.case.usual import usual
from fenics_joints.case.values import (
    AXES,
    CaseSection,
    Direction,
    File,
    Files,
    Length,
    Mass,
    Names,
    Number,
    Point,
    Positive,
    Share,
    Spacing,
    Stiffness,
    ascending,
    either,
    in_files,
    listed,
    quantity,
)
from fenics_joints.measurements.data import same_conditions
from fenics_joints.measurements.files import UFF_SUFFIXES
from fenics_joints.measurements.tables import column_head


class AmplitudeSection(CaseSection):
    """``[test.amplitude."MODE"]``, or ``amplitude = { "MODE" = FILE }``: a mode by amplitude.

    Attributes:
        files: Tables of level, frequency and damping; sweeps at constant response or force; or
            ring-downs. Their columns say which, see ``docs/amplitude.md``.
        levels: Levels of the functions of universal files, one for each.
        band: Frequencies that hold this mode and no other.
        sensor: The sensor that the amplitude is of, where a ring-down has several.
        units: Unit of functions or records whose file does not say it.
        noise: Relative standard deviation of frequencies: of a plain table 0.1 % by default, else
            beside their own scatter.
        damping_noise: That of damping ratios, of a plain table 10 % by default.
    """

    files: Files
    levels: Annotated[list[str], BeforeValidator(listed), Field(min_length=1)] | None = None
    band: ascending(Spacing) | None = None
    sensor: str | None = None
    units: str | None = None
    noise: Positive | None = None
    damping_noise: Positive | None = None


Modes = dict[str, Annotated[AmplitudeSection, BeforeValidator(in_files)]]


class LineOfSensors(CaseSection):
    """``[test.sees]`` with sensors along an axis.

    Attributes:
        along: The axis.
        positions: Coordinate of each sensor along it.
        at: The other coordinates by axis, one or one for each sensor.
        direction: Direction in which the sensors measure.
    """

    along: Literal["x", "y", "z"]
    positions: Annotated[list[Length], Field(min_length=1)]
    at: dict[Literal["x", "y", "z"], Annotated[list[Length], BeforeValidator(listed)]] = {}
    direction: Direction

    @model_validator(mode="after")
    def _one_for_each(self) -> LineOfSensors:
        for axis, values in self.at.items():
            if len(values) not in (1, len(self.positions)):
                raise ValueError(
                    f"at.{axis} has {len(values)} values: expected one, or {len(self.positions)}, "
                    "one for each position"
                )
        return self

    def points(self) -> list[tuple[float, ...]]:
        """Positions, m, each of shape (3,)."""
        n = len(self.positions)
        at = {axis: values * (n if len(values) == 1 else 1) for axis, values in self.at.items()}
        at[self.along] = self.positions
        return list(zip(*(at.get(axis, [0.0] * n) for axis in AXES), strict=True))

    def directions(self) -> list[tuple[float, ...]]:
        """A direction for each point."""
        return [self.direction] * len(self.positions)


class ListOfSensors(CaseSection):
    """``[test.sees]`` with sensors anywhere.

    Attributes:
        points: Place of each sensor.
        direction: One direction of all.
        directions: The direction of each.
    """

    one_of = (("direction", "each"),)
    at_points: Annotated[list[Point], Field(min_length=1, alias="points")]
    direction: Direction | None = None
    each: Annotated[list[Direction] | None, Field(alias="directions")] = None

    @model_validator(mode="after")
    def _one_for_each(self) -> ListOfSensors:
        if self.each is not None and len(self.each) != len(self.at_points):
            raise ValueError(f"expected {len(self.at_points)} directions, one for each point")
        return self

    def points(self) -> list[tuple[float, ...]]:
        """Positions, m, each of shape (3,)."""
        return self.at_points

    def directions(self) -> list[tuple[float, ...]]:
        """A direction for each point."""
        return self.each or [self.direction] * len(self.at_points)


def _sensors_kind(data: Any) -> type[CaseSection]:
    return ListOfSensors if isinstance(data, dict) and "points" in data else LineOfSensors


Sees = either(_sensors_kind, (LineOfSensors, ListOfSensors))


class ValidationTest(CaseSection):
    """``[test.validation]``: data that is never fitted.

    Attributes:
        frequencies: Table of frequencies.
        damping: Table of damping ratios.
    """

    frequencies: File
    damping: File | None = None


class FRFSection(CaseSection):
    """``[test.frfs]``: measured frequency response functions, or ``frfs`` with a list of files.

    Attributes:
        files: Files of functions and nodes; see `measurements.read_frfs`.
        kind: Kind of function, where the files do not say it.
        units: Unit of the functions, where the files do not say it.
        length_unit: Unit of the nodes' coordinates, where the files do not say it.
        points: Coordinates by node, where the files do not have them.
        directions: Directions by node, where the files do not have them.
        keys: Names of MATLAB variables that are not the usual ones.
        band: Frequencies that are used, [low, high].
        at: Condition at which they were measured, the last one by default.
        noise: Relative standard deviation, 5 % by default.
        averages: Number of averages, from which and the coherence the noise comes instead.
        calibration: Relative standard deviation of each sensor's and each force's scale.
        identify: Modes from the functions, in place of frequencies.
        time: How functions are made of time records.
    """

    class Time(CaseSection):
        """``[test.frfs.time]``: how functions are made of time records.

        Attributes:
            block: Length of a block; by default a tenth of the record, of a hammer to the next hit.
            overlap: Share by which blocks overlap.
            window: "hann" for random, "rectangular" for periodic excitation, "hammer" for hits.
            estimator: "H1", noise on responses; "H2", on the force; "Hv", on both.
            exponential: Time in which an exponential window on both falls to 1/e.
        """

        block: quantity("s", 0, above=True) | None = None
        overlap: Annotated[float, Field(ge=0, lt=1)] = 0.5
        window: Literal["hann", "rectangular", "hammer"] = "hann"
        estimator: Literal["H1", "H2", "Hv"] = "H1"
        exponential: quantity("s", 0, above=True) | None = None

    class Identify(CaseSection):
        """``[test.frfs.identify]``: modes from the functions, in place of ``frequencies``.

        Attributes:
            near: About where the frequencies are, one for each mode; by default what is stable.
            order: Highest number of modes of a model.
            max_damping: Damping ratio above which a pole is no mode.
            exponential_window: Time in which the analyser's exponential window falls to 1/e; the
                damping that the window adds is subtracted.
        """

        near: list[quantity("Hz", 0, above=True)] | None = None
        order: Annotated[int, Field(ge=1, le=1000, strict=True)] = 30
        max_damping: Positive = 0.1
        exponential_window: quantity("s", 0, above=True) | None = None

    files: Files
    kind: Literal["receptance", "mobility", "accelerance"] | None = None
    units: str | None = None
    length_unit: str | None = None
    points: dict[str, Point] = {}
    directions: dict[str, Direction] = {}
    keys: dict[str, str] = {}
    band: ascending(Spacing) | None = None
    at: Number | None = None
    noise: Positive | None = None
    averages: Annotated[int, Field(ge=2, strict=True)] | None = None
    calibration: Share = 0.02
    identify: Identify | None = None
    time: Time | None = None

    @model_validator(mode="after")
    def _one_of_noise_and_averages(self) -> FRFSection:
        if self.noise is not None and self.averages is not None:
            raise ValueError("expected either noise or averages, which gives it by the coherence")
        return self


class ShapesSection(CaseSection):
    """``[test.shapes]``, or ``shapes`` with a file or a list of them.

    Attributes:
        files: A table with a row for each sensor of [test.sees]; or universal files (UFF), which
            have sensors, frequencies and damping of their own.
        length_unit: Unit of the nodes' coordinates, where no file says it.
    """

    files: Files
    length_unit: str | None = None

    @property
    def is_universal(self) -> bool:
        """Whether the shapes stand in universal files."""
        return any(Path(file).suffix.lower() in UFF_SUFFIXES for file in self.files)

    @model_validator(mode="after")
    def _one_table(self) -> ShapesSection:
        if not self.is_universal and (len(self.files) > 1 or self.length_unit is not None):
            ends = f"expected one table, or universal files ({', '.join(UFF_SUFFIXES)})"
            raise ValueError(f"files = {self.files}: {ends}")
        return self


class ChangedTest(CaseSection):
    """``[test.changed.NAME]``: the same structure again, after a known change, for ``diagnose``.

    The bolts were not tightened anew.

    Attributes:
        frequencies: Table of one row with the columns of the test's; cells may be empty.
        mass: A mass that was put on, in equal shares.
        points: Where it was put.
        without: Names of masses and springs of the case that were taken off.
        at: The condition, the last one by default.
    """

    frequencies: File
    mass: Mass | None = None
    points: list[Point] = []
    without: Annotated[list[str], BeforeValidator(listed)] = []
    at: Number | None = None

    @model_validator(mode="after")
    def _says_what(self) -> ChangedTest:
        if (self.mass is None) != (not self.points):
            raise ValueError("expected mass and points, of a mass that was put on, or neither")
        if self.mass is None and not self.without:
            raise ValueError("expected mass and points, or without: what is otherwise than before")
        return self


class PointTest(CaseSection):
    """A measurement at one place along one direction.

    Attributes:
        point: The place.
        direction: The direction.
        at: The condition, the last one by default.
    """

    point: Point
    direction: Direction
    at: Number | None = None


class StaticTest(PointTest):
    """``[test.stiffness.NAME]``: a static stiffness of the held structure, for ``diagnose``.

    Attributes:
        stiffness: Force over displacement.
        noise: Its relative standard deviation.
    """

    stiffness: Stiffness
    noise: Positive = 0.02


class AntiresonanceTest(PointTest):
    """``[test.antiresonances.NAME]``: antiresonances of a driven point, for ``diagnose``.

    At these frequencies a point stands still while it is driven there: minima of the frequency
    response function of force and motion at one place along one direction.

    Attributes:
        frequencies: The antiresonances that were seen, not all that there are.
        noise: Their relative standard deviation.
    """

    frequencies: Annotated[list[quantity("Hz", 0, above=True)], Field(min_length=1)]
    noise: Positive = 0.005


class PlannedTest(CaseSection):
    """``[test.planned]``: a test that has not been made, for ``diagnose --plan``.

    Attributes:
        condition: Written as the head of a column, "torque [N·m]".
        conditions: Its values.
        modes: Names of the modes, or how many of the lowest that the sensors see.
        damping: Whether damping will be measured.
        shapes: Whether shapes will be measured.
    """

    condition: str | None = None
    conditions: Annotated[list[Number], BeforeValidator(listed), Field(min_length=1)] = [1.0]
    modes: Annotated[int, Field(ge=1, le=1000, strict=True)] | Names
    damping: bool = False
    shapes: bool = False

    @model_validator(mode="after")
    def _clear(self) -> PlannedTest:
        name = "condition" if self.condition is None else column_head(self.condition)[0]
        if not name or "[" in name or "]" in name:
            raise ValueError(f"condition = {self.condition!r}: expected 'NAME [UNIT]'")
        if self.condition is None and len(self.conditions) > 1:
            raise ValueError("expected condition too, such as 'torque [N·m]'")
        if (twice := same_conditions(self.conditions)) is not None:
            raise ValueError(f"conditions = {self.conditions}: {twice}")
        if not all(math.isfinite(c) for c in self.conditions):
            raise ValueError(f"conditions = {self.conditions}: expected finite numbers")
        if len(set(self.names())) != len(self.names()):
            raise ValueError(f"modes = {self.modes}: expected each name once")
        return self

    def names(self) -> tuple[str, ...]:
        """Names of the modes."""
        if isinstance(self.modes, int):
            return tuple(f"mode {i + 1}" for i in range(self.modes))
        return tuple(self.modes)

    def head(self) -> tuple[str, str]:
        """Name and unit of the condition."""
        if self.condition is None:
            return "row", ""
        return column_head(self.condition)


class Test(CaseSection):
    """``[test]``: the measured data and how good it is.

    Attributes:
        frequencies: Table with a column for each mode and a row for each condition, such as a
            torque; or, with a ``reader``, a file of any format.
        reader: Function of your own, ``module:name``, from the file's path to a
            `fenics_joints.measurements.TestData`.
        damping: Table of damping ratios with the same columns.
        shapes: Mode shapes; universal files bring frequencies, damping and sensors with them.
        condition: Name of the condition's column.
        modes: Names of the modes' columns; all by default.
        resolution: Spacing of the analyser's lines, one or one for each mode.
        noise: Relative standard deviation of the frequencies, one or one for each mode.
        damping_noise: That of damping ratios, 10 % by default.
        shape_noise: That of a shape's component, relative to the shape's root mean square.
        shapes_at: Condition at which the shapes were measured, the last one by default.
        frfs: Measured functions.
        sees: Where the sensors were and in which direction they measured.
        validation: Data that is never fitted.
        planned: A test that has not been made.
        mass: What the whole structure weighs without what is attached.
        mass_noise: Relative standard deviation of masses, with what the mesh leaves out of the
            volume.
        amplitude: Modes over their amplitude, for harmonic and diagnose.
        changed: Tests of the structure after known changes, for diagnose.
        stiffness: Static stiffnesses, for diagnose.
        antiresonances: Antiresonances of driven points, for diagnose.
    """

    __test__ = False

    frequencies: File | None = None
    reader: str | None = None
    damping: File | None = None
    shapes: Annotated[ShapesSection, BeforeValidator(in_files)] | None = None
    condition: str | None = None
    modes: Names | None = None
    resolution: usual(Annotated[list[Spacing], BeforeValidator(listed)], "resolution") = [0.0]
    noise: Annotated[list[Share], BeforeValidator(listed)] = [0.0]
    damping_noise: usual(Positive, "damping noise") | None = None
    shape_noise: Positive = 0.05
    shapes_at: Number | None = None
    frfs: Annotated[FRFSection, BeforeValidator(in_files)] | None = None
    sees: Sees | None = None
    validation: ValidationTest | None = None
    planned: PlannedTest | None = None
    mass: Mass | None = None
    mass_noise: Positive = 0.005
    amplitude: Modes = {}
    changed: dict[str, ChangedTest] = {}
    stiffness: dict[str, StaticTest] = {}
    antiresonances: dict[str, AntiresonanceTest] = {}

    @property
    def has_universal_shapes(self) -> bool:
        """Whether shapes, and the sensors with them, stand in universal files."""
        return self.shapes is not None and self.shapes.is_universal

    @property
    def has_modes(self) -> bool:
        """Whether files say the modes, so that none are identified from functions."""
        tables = self.frequencies is not None or self.has_universal_shapes
        return tables or bool(self.amplitude)

    @property
    def is_by_amplitude(self) -> bool:
        """Whether the modes are those over their amplitude, and no others."""
        return bool(self.amplitude) and self.frequencies is None and not self.has_universal_shapes

    @model_validator(mode="after")
    def _measured_or_planned(self) -> Test:
        if not self.has_modes and self.planned is None and self.frfs is None:
            raise ValueError(
                "expected frequencies, shapes in a universal file, frfs, amplitude, or a section "
                "[test.planned]"
            )
        if self.has_modes and self.frfs is not None and self.frfs.identify is not None:
            raise ValueError("frfs.identify: expected it only without frequencies and shapes")
        for key in ("damping", "shapes", "validation"):
            needs = key != "shapes" or not self.has_modes
            if self.frequencies is None and needs and getattr(self, key) is not None:
                raise ValueError(f"{key}: expected frequencies too")
        keys = ("damping", "shapes", "validation", "changed", "modes", "condition")
        beside = [getattr(self, key) for key in keys]
        if self.reader is not None and (self.frequencies is None or any(beside)):
            raise ValueError(
                "reader: expected frequencies, the file that it reads, and not damping, shapes, "
                "validation, changed, modes or condition"
            )
        if self.has_universal_shapes and self.sees is not None:
            raise ValueError(
                "sees: expected it only without shapes in a universal file, whose "
                "nodes are the sensors"
            )
        if self.is_by_amplitude and (self.condition is not None or self.modes is not None):
            key = "condition" if self.condition is not None else "modes"
            raise ValueError(
                f"{key}: expected it only with frequencies; of amplitude the level is "
                "the condition, and the names of the modes are those of its sections"
            )
        if self.changed and self.frequencies is None and not self.has_universal_shapes:
            raise ValueError("changed: expected frequencies too")
        if self.planned is not None and self.planned.shapes and self.sees is None:
            raise ValueError("planned.shapes: expected a section [test.sees] too")
        return self

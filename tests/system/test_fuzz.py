"""Odd input everywhere: it is refused in clear words, or accepted and right; nothing else.

Small here; ``-m slow`` tries fifty times as much.
"""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pint
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from measured_world import FREQUENCIES, accelerance, function, geometry, write_uff
from mpi4py import MPI
from odd import mutated, odd_text, odd_value, tried
from odd_calls import CALLS
from uff_files import mode_55, nodes_2411, units_164

from fenics_joints.case import load_case
from fenics_joints.errors import InputError
from fenics_joints.measurements import (
    read_curves,
    read_frfs,
    read_shapes,
    read_table,
    read_test_data,
)
from fenics_joints.units import to_si

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")

ROOT = Path(__file__).parents[2]
DEMOS = ROOT / "demos"
SIZES = [pytest.param(1, id="small"), pytest.param(50, id="large", marks=pytest.mark.slow)]
SOURCES = {
    "lap plates": (ROOT / "tests" / "lap_case.toml", DEMOS / "lap_plates"),
    "dumbbell": (DEMOS / "dumbbell" / "case.toml", DEMOS / "dumbbell"),
    "beams": (DEMOS / "bolted_beams" / "case.toml", DEMOS / "bolted_beams"),
    "c_beam": (DEMOS / "c_beam" / "case.toml", DEMOS / "c_beam"),
    "lap beam": (DEMOS / "lap_beam" / "nonlinear.toml", DEMOS / "lap_beam"),
}
REGISTRY = pint.UnitRegistry()


def often(examples: int, size: int):
    return settings(
        max_examples=examples * size,
        deadline=None,
        database=None,
        derandomize=size == 1,
        suppress_health_check=list(HealthCheck),
    )


@pytest.mark.parametrize("size", SIZES)
def test_units(size):
    unit = st.sampled_from(["", "m", "Pa", "Hz", "N*m", "kg/m3", "N/m"])
    symbols = "m mm k Pa GPa ** ^ / * ( ) 9 - 1e9 2 N Hz · % kg s rad ² . e µ"
    parts = st.sampled_from(symbols.split())
    quantity = st.builds(
        "{}{}{}".format,
        st.floats(allow_nan=False, width=32),
        st.sampled_from(["", " "]),
        st.lists(parts, max_size=8).map("".join),
    )

    @often(150, size)
    @given(st.one_of(quantity, odd_text, odd_value), unit)
    def check(value, unit):
        got = tried("units", lambda: to_si(value, unit))
        assert got is None or (isinstance(got, float) and math.isfinite(got))

    @often(50, size)
    @given(st.floats(-1e9, 1e9), st.sampled_from(["mm", "µm", "km", "inch", "m"]))
    def right(number, name):
        expected = REGISTRY.Quantity(number, name).to("m").magnitude
        assert to_si(f"{number!r} {name}", "m") == pytest.approx(expected, rel=1e-12, abs=1e-300)

    check()
    right()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("source", SOURCES)
def test_case_files(tmp_path, source, size):
    text, data = SOURCES[source]
    shutil.copytree(data, tmp_path, dirs_exist_ok=True)
    path = tmp_path / "case.toml"
    lines = tuple(text.read_text(encoding="utf-8").splitlines())

    @often(60, size)
    @given(mutated(lines))
    def check(changed):
        path.write_text(changed, encoding="utf-8", errors="surrogatepass")
        case = tried("case", lambda: load_case(path))
        if case is not None:  # what is accepted says the same again
            assert load_case(path).title == case.title

    check()


TABLES = {
    "frequencies": read_table,
    "test data": lambda p: read_test_data(p, condition="torque"),
    "curves": lambda p: read_curves(p, "acceleration"),
}
CURVES = "level [N],frequency [Hz],amplitude [m/s2]\n10,27,40\n10,27.8,90\n10,29,50\n"


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("table", TABLES)
def test_tables(tmp_path, table, size):
    of_test = (DEMOS / "lap_plates" / "frequencies.csv").read_text(encoding="utf-8")
    read, text = TABLES[table], CURVES if table == "curves" else of_test
    path = tmp_path / "table.csv"
    cell = st.one_of(odd_text, st.sampled_from(["", "-1", "nan", "1e400", "1;2", '"', "1,2", "x"]))

    @st.composite
    def tables(draw):
        rows = [line.split(",") for line in text.splitlines()]
        for _ in range(draw(st.integers(1, 3))):
            row = draw(st.sampled_from(rows))
            row[draw(st.integers(0, len(row) - 1))] = draw(cell)
        if draw(st.booleans()):
            del rows[draw(st.integers(0, len(rows) - 1))]
        joint = draw(st.sampled_from([",", ",", ";", "\t"]))
        end = draw(st.sampled_from(["\n", "\r\n", "\n\n"]))
        return end.join(joint.join(row) for row in rows).encode(
            draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"])), errors="replace"
        )

    @often(80, size)
    @given(st.one_of(tables(), tables(), tables(), st.binary(max_size=300)))
    def check(content):
        path.write_bytes(content)
        found = tried("tables", lambda: read(path))
        if table == "test data" and found is not None:
            values = found.frequencies_hz[np.isfinite(found.frequencies_hz)]
            assert values.size and np.all(values > 0)

    check()


def shapes_file(path: Path) -> None:
    points = {n: (100.0 * n, 0.0, 0.0) for n in (1, 2, 3)}
    shapes = [mode_55(k, 100.0 * k, {n: (0, 0, n * k) for n in points}) for k in (1, 2)]
    path.write_text(units_164() + nodes_2411(points) + "".join(shapes))


def functions_file(path: Path) -> None:
    few = {"x": FREQUENCIES[:6]}
    g = accelerance()[:6] / 9.80665
    write_uff(path, *geometry(), *[function(i, 0, **few, data=g[:, i, 0]) for i in range(2)])


def shapes_fit(found) -> None:
    assert not np.any(np.isinf(found.shapes)) and np.all(found.frequencies_hz > 0)
    assert found.notes or not np.any(np.isnan(found.shapes))  # what is missing is said


def functions_fit(found) -> None:
    assert np.all(np.isfinite(found.values)) and np.all(np.diff(found.frequencies_hz) > 0)


UFF = {
    "shapes": (shapes_file, read_shapes, shapes_fit),
    "functions": (functions_file, lambda p: read_frfs(p, units="g/N"), functions_fit),
}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", UFF)
def test_uff(tmp_path, kind, size):
    pytest.importorskip("pyuff")
    write, read, fit = UFF[kind]
    path = tmp_path / "good.uff"
    write(path)
    fit(read(path))
    good, bad = path.read_text().splitlines(), tmp_path / "bad.uff"

    @st.composite
    def files(draw):
        lines = list(good)
        for _ in range(draw(st.integers(1, 3))):
            i = draw(st.integers(0, len(lines) - 1))
            kind = draw(st.sampled_from(["gone", "twice", "number", "cut", "end"]))
            if kind == "gone" and len(lines) > 1:
                del lines[i]
            elif kind == "twice":
                lines.insert(i, lines[i])
            elif kind == "number":
                words = lines[i].split() or [""]
                words[draw(st.integers(0, len(words) - 1))] = draw(
                    st.sampled_from(["-1", "0", "nan", "1e400", "999999", "x", "2.5"])
                )
                lines[i] = " ".join(words)
            elif kind == "cut":
                lines[i] = lines[i][: draw(st.integers(0, len(lines[i])))]
            else:
                lines = lines[: i + 1]
        return "\n".join(lines)

    @often(150, size)
    @given(files())
    def check(text):
        bad.write_text(text)
        found = tried("uff", lambda: read(bad))
        if found is not None:
            fit(found)

    check()


CONSTRUCTORS = [call for room in ("structure", "joint_laws", "preload") for call in CALLS[room]()]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("call", CONSTRUCTORS, ids=lambda call: call[0].__name__)
def test_constructors(call, size):
    make, good, _ = call
    make(**good)

    @often(40, size)
    @given(st.data())
    def check(data):
        names = data.draw(st.lists(st.sampled_from(sorted(good)), min_size=1, max_size=2))
        odd = {name: data.draw(odd_value) for name in names}
        tried("constructors", lambda: make(**{**good, **odd}))

    check()


def test_a_fault_would_be_seen():
    with pytest.raises(ZeroDivisionError):
        tried("none", lambda: 1 / 0)
    assert tried("none", lambda: 3) == 3

    def refuse():
        raise InputError("x = -1: expected above 0")

    assert tried("none", refuse) is None

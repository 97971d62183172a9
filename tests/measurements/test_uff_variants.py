"""Universal files as programs and labs write them, against those that are written by the book."""

from __future__ import annotations

import re
from pathlib import Path

import measured_world as world
import numpy as np
import pytest
from uff_files import ints, reals

from fenics_joints.errors import InputError
from fenics_joints.measurements import read_frfs, read_shapes

pytest.importorskip("pyuff")

H = world.accelerance()
DATA = Path(__file__).parent / "data"
D = re.compile(rb"(\d)[Ee]([+-]\d)")


VARIANTS = {
    "D": lambda text: D.sub(rb"\1D\2", text),
    "three digits": lambda text: re.sub(rb"(?<=\d{5})E([+-])(?=\d\d)", rb"\g<1>0", text),
    "touching": lambda text: text.replace(b" -", b"-") if b"58b" not in text else text,
    "CRLF": lambda text: text.replace(b"\n", b"\r\n"),
    "80 columns": lambda text: b"\n".join(line.ljust(80) for line in text.split(b"\n")),
    "no last line": lambda text: text.rstrip(),
    "tabs": lambda text: re.sub(rb"(\d{5}E[+-]\d\d) +(?=[\d-])", rb"\1\t", text),
}


def _single(n, label="m/s^2", kind=12, rows=None):
    """A dataset 58 of single precision, its rows of six filled up with zeros."""
    values = H[: n + 2, 0, 0] if rows is None else rows
    numbers = np.column_stack([values.real, values.imag]).ravel()
    text = "".join(
        "".join(f"{x:13.5E}" for x in numbers[i : i + 6]) + "\n" for i in range(0, len(numbers), 6)
    )
    return (
        "    -1\n    58\nNONE\nNONE\n26-Nov-26 10:00:00\nNONE\nNONE\n"
        "    4         0    0         0 NONE               1   3 NONE               1   3\n"
        f"         5{n:10d}         1  6.0000E+01   5.0000E-01   0.0000E+00 \n"
        "        18    0    0    0 Frequency            Hz                  \n"
        f"{kind:10d}    0    0    0 Response             {label:20s}\n"
        "        13    0    0    0 Force                N                   \n"
        "         0    0    0    0 NONE                 NONE                \n"
        f"{text}    -1\n"
    )


@pytest.mark.parametrize("change", list(VARIANTS))
def test_ascii_variants(tmp_path, change):
    """598 values in rows of three: two more fill the last row, and are none; and what pyuff
    writes, in double precision at lines that are given or evenly spaced."""
    nodes, path = world.write_uff(tmp_path / "nodes.uff", *world.geometry()), tmp_path / "a.uff"
    path.write_bytes(VARIANTS[change](_single(598).encode()))
    assert read_frfs([nodes, path]).values[:, 0, 0] == pytest.approx(H[:598, 0, 0], rel=1e-5)
    if change in ("touching", "three digits"):  # of single precision
        return
    for spacing in (0, 1):
        world.write_uff(path, *(world.function(i, 0, abscissa_spacing=spacing) for i in range(3)))
        path.write_bytes(VARIANTS[change](path.read_bytes()))
        read = read_frfs([nodes, path])
        assert read.values[:, :, 0] == pytest.approx(H[:, :, 0], rel=1e-6)
        assert read.frequencies_hz == pytest.approx(world.FREQUENCIES, rel=1e-6)


def test_labels_in_latin_1_and_too_many_values(tmp_path):
    path = tmp_path / "a.uff"
    si = world.write_uff(tmp_path / "si.uff", world.units(1.0)).read_bytes()
    receptance = H[:, 0, 0] / -((2 * np.pi * world.FREQUENCIES) ** 2)
    path.write_bytes(si + _single(600, "µm", 8, 1e6 * receptance).encode("latin-1"))
    read = read_frfs(path, points={"1": [0, 0, 0]})
    assert read.kind == "receptance" and "µm" in read.notes[0]
    assert read.values[:, 0, 0] == pytest.approx(receptance, rel=1e-4)
    path.write_bytes(si + _single(598).replace("       598", "       594").encode())
    with pytest.raises(InputError, match="600 values, expected 594"):
        read_frfs(path, points={"1": [0, 0, 0]})


def test_binary_data_that_end_without_a_line():
    """As the standard has it; and a mark within them is data."""
    for name in ("m_58b_then_55.uff", "lab_export.unv"):
        shapes = read_shapes(DATA / name)
        assert shapes.frequencies_hz == pytest.approx([62, 118, 121.5])
    path = DATA / "m_58b_then_55.uff"
    assert len(read_frfs(path)) == 581 and len(shapes.sensors) == 15


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("after", [b"", b"\n", b"\r\n"])
def test_marks_within_binary_data(tmp_path, order, after):
    values = H[:, 0, 0] / 9.80665
    raw = np.column_stack([values.real, values.imag]).astype(f"{order}f8")
    raw.view(np.uint8).reshape(-1)[100:115] = np.frombuffer(b"\n    -1\n    -1\n", np.uint8)[:15]
    head = _single(600, "g").split("\n")[1:13]
    head[0] = f"    58b{1 + (order == '>'):6d}     2          11{raw.nbytes:12d}" + "     0" * 4
    head[7] = head[7].replace("         5", "         6", 1)
    text = "\n".join(head) + "\n"
    mark = b"    -1\n"
    nodes = world.write_uff(tmp_path / "nodes.uff", *world.geometry())
    path = tmp_path / "a.uff"
    path.write_bytes(2 * (mark + text.encode() + raw.tobytes() + after + mark))
    with pytest.raises(InputError, match="dataset 2 .*already in .*dataset 1"):
        read_frfs([nodes, path])
    path.write_bytes(mark + text.encode() + raw.tobytes() + after + mark)
    read = read_frfs([nodes, path])
    same = np.abs(read.values[:, 0, 0] - 9.80665 * values) < 1e-9 * np.abs(values)
    assert same.sum() >= 598


def _cylindrical(kind=1):
    places = dict(x=[0.1, 0.0, -0.1], y=[0.0, 0.1, 0.0], z=[0.0, 0.0, 0.0], disp_cs=[7, 7, 7])
    return [
        world.units(1.0),
        world.geometry(**places)[1],
        world.system(7, [*np.eye(3), np.zeros(3)], kind),
    ]


def test_axes_of_a_cylinder(tmp_path):
    """Outwards at nodes 1, 2 and 7 is x, y and -x of all, with points from elsewhere too."""
    nodes = world.write_uff(tmp_path / "nodes.uff", *_cylindrical())
    sets = [world.function(i, 1, rsp_dir=1, ref_node=1, ref_dir=1) for i in range(3)]
    path = world.write_uff(tmp_path / "a.uff", *sets)
    for points in (None, {"1": [0.1, 0, 0]}):
        read = read_frfs([nodes, path], points=points)
        along = np.array([[1, 0, 0], [0, 1, 0], [1, 0, 0]])
        assert read.response_directions == pytest.approx(along)
        # Along -x is turned, and the function with it.
        signs = np.array([-1, 1, -1])  # of the data of function(0) itself
        assert read.values[:, :, 0] == pytest.approx(signs * H[:, :, 1], rel=1e-5)
    spherical = world.write_uff(tmp_path / "nodes.uff", *_cylindrical(2))
    for points in (None, {str(k): [0.1, 0, 0] for k in world.NODES}):
        with pytest.raises(InputError, match="spherical"):
            read_frfs([spherical, path], points=points)


def _as_2414(text: str) -> str:
    """Datasets 55 of normal modes as 2414."""
    sets = text.split("    -1\n")
    for i, part in enumerate(sets):
        lines = part.splitlines()
        if lines and lines[0].strip() == "55":
            mode, f = lines[7].split()[3], float(lines[8].split()[0])
            damping = map(float, lines[8].split()[2:])
            head = [ints(2414)[4:], ints(1), "mode", ints(1), *lines[1:7]]
            head += [ints(0, 0, 0, 0, 0, int(mode), 0, 0), ints(0, 0)]
            head += [reals(0, f, 0, 1, *damping), reals(*[0] * 6)]
            sets[i] = "\n".join([*head, *lines[9:]]) + "\n"
    return "    -1\n".join(sets)


def test_shapes_in_axes_of_a_cylinder_and_as_2414(tmp_path):
    shapes = read_shapes(DATA / "m_cyl.uff")
    assert shapes.frequencies_hz == pytest.approx([62, 118, 121.5])
    assert shapes.sensors.directions[0] == pytest.approx([1, 0, 0])  # on the axis, and said
    assert shapes.sensors.directions[3] == pytest.approx(np.array([5, 1, 0]) / np.sqrt(26))
    assert any("nodes 1 " in note for note in shapes.notes)
    other = tmp_path / "a.unv"
    other.write_text(_as_2414((DATA / "m_cyl.uff").read_text()))
    again = read_shapes(other)
    assert again.frequencies_hz == pytest.approx(shapes.frequencies_hz)
    assert again.damping == pytest.approx(shapes.damping)
    assert again.shapes == pytest.approx(shapes.shapes, rel=1e-6)
    other.write_text(other.read_text().replace("mode\n         1", "mode\n         2"))
    with pytest.raises(InputError, match="2414.: its data are not at nodes"):
        read_shapes(other)

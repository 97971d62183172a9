"""Modes from universal files: layouts as programs of test labs write them, and broken ones.

The files are written here, by hand: fields in fixed columns, as the records are defined.
"""

from __future__ import annotations

import numpy as np
import pytest
from uff_files import block, complex_mode_55, ints, mode_55, nodes_15, nodes_2411, reals, units_164

from fenics_joints.errors import InputError
from fenics_joints.measurements import mac, made_real, read_frfs, read_shapes

pytest.importorskip("pyuff")

#: Nodes, mm, in another order than their numbers.
NODES = {7: (0, 0, 8), 12: (100, 0, 8), 3: (100, 50, 8), 40: (0, 50, 8), 41: (0, 50, 0)}
HZ, RATIOS = (182.0919, 202.0093, 406.1163), (1.818e-3, 6.43e-4, 5.593e-3)
rng = np.random.default_rng(5)
UNITS = units_164()
PLAIN = UNITS, nodes_2411(NODES)
#: By mode, node and axis; nothing is measured along y, and at node 40 not along x.
SHAPES = rng.normal(size=(3, len(NODES), 3)) * [1, 0, 1]
SHAPES[:, 3, 0] = 0


def real_mode(i, shape=SHAPES, numbers=tuple(NODES), **more):
    more = {"ratio": RATIOS[i]} | more
    return mode_55(i + 1, HZ[i], dict(zip(numbers, shape[i], strict=True)), **more)


def complex_mode(i, shape):
    shape = dict(zip(NODES, shape[i], strict=True))
    return complex_mode_55(i + 1, HZ[i], RATIOS[i], shape)


def write(path, *blocks):
    path.write_text("".join(blocks), encoding="utf-8")
    return path


def expected_sensors():
    points = np.array([NODES[n] for n in (7, 7, 12, 12, 3, 3, 40, 41, 41)]) * 1e-3
    axes = [0, 2, 0, 2, 0, 2, 2, 0, 2]
    return points, np.eye(3)[axes], SHAPES[:, [0, 0, 1, 1, 2, 2, 3, 4, 4], axes].T


def test_normal_modes_in_millimetres(tmp_path):
    """Any order of sets; what no mode moves is no sensor; a node order of its own."""
    path = write(tmp_path / "a.uff", *(real_mode(i) for i in (2, 0, 1)), *PLAIN[::-1])
    points, directions, shapes = expected_sensors()
    found = read_shapes(path)
    assert found.frequencies_hz == pytest.approx(HZ, rel=1e-5)
    assert found.damping == pytest.approx(RATIOS, rel=1e-5)
    assert found.sensors.points == pytest.approx(points, abs=1e-9)
    assert found.sensors.directions == pytest.approx(directions)
    assert found.sensors.names[:3] == ("7:x", "7:z", "12:x")
    assert np.diag(mac(found.shapes, shapes)) == pytest.approx(1)
    assert found.collinearity == pytest.approx(1) and not found.notes


def test_geometry_of_another_file_with_six_digits_and_lines(tmp_path):
    """Dataset 15 without units, lines 82, and six values at a node with rotations."""
    lines = block(82, ints(1, 6, 8), "Outline", ints(7, 12, 3, 0, 40, 41))
    files = [
        write(tmp_path / "geo.unv", nodes_15(NODES), lines),
        write(tmp_path / "modes.unv", *(real_mode(i, turns=True, ratio=0.0) for i in range(3))),
    ]
    found = read_shapes(files, length_unit="mm")
    points, _, shapes = expected_sensors()
    assert found.sensors.points == pytest.approx(points, abs=1e-9)
    assert np.diag(mac(found.shapes, shapes)) == pytest.approx(1)
    assert np.isnan(found.damping).all()
    assert found.notes == ("Rotations in the files were not used",)
    assert [line.shape for line in found.lines] == [(3, 3), (2, 3)]
    assert found.lines[1] == pytest.approx(1e-3 * np.array([NODES[40], NODES[41]]))
    with pytest.raises(InputError, match="unit of coordinates is not known.*100 x 50 x 8 mm"):
        read_shapes(files)


def test_complex_modes_turned_and_what_that_costs(tmp_path):
    """A real shape turned by an angle costs nothing; one with a part out of phase what it has."""
    out = 0.4 * rng.normal(size=SHAPES.shape) * (SHAPES != 0)
    angles, phase = np.array([0.3, 2.0, 4.0]), np.array([0, 0, 1j])
    shapes = (SHAPES + phase[:, None, None] * out) * np.exp(1j * angles)[:, None, None]
    modes = [complex_mode(i, shapes) for i in range(3)]
    path = write(tmp_path / "a.uff", *PLAIN, *modes)
    found = read_shapes(path)
    assert found.frequencies_hz == pytest.approx(HZ, rel=1e-6)
    assert found.damping == pytest.approx(RATIOS, rel=1e-5)
    _, _, expected = expected_sensors()
    assert np.diag(mac(found.shapes, expected))[:2] == pytest.approx(1, abs=1e-9)
    assert found.collinearity[:2] == pytest.approx(1, abs=1e-9)
    # By the definition of each, of the numbers in the file, at any angle.
    moves = SHAPES.any(axis=0)
    z = shapes[2][moves]
    turned = (z[:, None] * np.exp(1j * np.linspace(0, np.pi, 20001))).real
    assert found.mac_real[2] == pytest.approx(mac(turned, z[:, None]).max(), abs=1e-6)
    own = mac(found.shapes[:, [2]], z[:, None])[0, 0]
    assert found.mac_real[2] == pytest.approx(own, rel=1e-5)
    xx, yy, xy = (z.real**2).sum(), (z.imag**2).sum(), (z.real * z.imag).sum()
    collinearity = ((xx - yy) ** 2 + 4 * xy**2) / (xx + yy) ** 2
    assert found.collinearity[2] == pytest.approx(collinearity, rel=1e-5)
    assert any("3 complex shapes were made real" in note for note in found.notes)
    assert any("Too complex" in note and "at 406.12 Hz" in note for note in found.notes)
    nothing = made_real(np.array([[1.0 + 0j], [np.nan], [-2.0]]))
    assert nothing[0][[0, 2], 0] == pytest.approx([-1, 2]) and np.isnan(nothing[0][1, 0])


def test_directions_are_those_of_the_nodes_axes(tmp_path):
    """System 5 is turned by 30 degrees about z and mirrored in no way; its origin is of no use."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    rows = [reals(*r, digits=16) for r in ((c, s, 0), (-s, c, 0), (0, 0, 1), (0.1, 0.2, 0.3))]
    system = block(2420, ints(1), "Part", ints(5, 0, 8), "Turned", *rows)
    modes = [real_mode(i) for i in range(3)]
    nodes = nodes_2411(NODES, system=5)
    found = read_shapes(write(tmp_path / "a.uff", UNITS, system, nodes, *modes))
    points, _, _ = expected_sensors()
    assert found.sensors.points == pytest.approx(points, abs=1e-9)
    along = [[c, s, 0], [0, 0, 1]]
    assert found.sensors.directions[:2] == pytest.approx(np.array(along))
    mirrored = system.replace(rows[2], reals(0, 0, 2, digits=16))
    with pytest.raises(InputError, match="system 5 are no rotation"):
        read_shapes(write(tmp_path / "b.uff", UNITS, mirrored, nodes, *modes))
    with pytest.raises(InputError, match="node 7 .*system 6 is not in the file") as caught:
        read_shapes(write(tmp_path / "c.uff", UNITS, nodes_2411(NODES, system=6), *modes))
    assert str(caught.value).count("is not in the file") == 5


def test_a_sensor_missing_in_one_mode_is_an_empty_cell(tmp_path):
    few = real_mode(1, SHAPES[:, [0, 2, 3, 4]], [7, 3, 40, 41])
    path = write(tmp_path / "a.uff", *PLAIN, real_mode(0), few, real_mode(2))
    found = read_shapes(path)
    assert np.argwhere(np.isnan(found.shapes)).tolist() == [[2, 1], [3, 1]]
    assert "dataset 4 (type 55): has no value at node 12, which others have" in found.notes[0]


GOOD = (*PLAIN, *(real_mode(i) for i in range(3)))
FEW = nodes_2411({n: NODES[n] for n in (7, 3)})
#: Blocks, and all of what the one error says.
BROKEN = [
    ((), ["is empty"]),
    (("".join(GOOD)[:-300],), ["stops within a dataset", "truncated"]),
    ((*GOOD[:4], GOOD[4][:-30] + "\n    -1\n"), ["dataset 5 (type 55)", "node 41"]),
    ((UNITS, FEW, *GOOD[2:]), ["nodes 12, 40, 41 of the 5 that move", "2411"]),
    ((UNITS, *GOOD[2:]), ["nodes 7, 12, 3, 40, 41", "no node has them"]),
    (GOOD[:2], ["no mode shape", "of use are datasets 164, 2411 only", "frfs.identify"]),
    ((*GOOD[:2], real_mode(0, analysis=5)), ["analysis 5 (frequency response)"]),
    ((*GOOD[:2], real_mode(0, kind=3)), ["type 3 (strain) and no displacements"]),
    ((*GOOD, real_mode(1)), ["mode at 202.009 Hz was already in", "dataset 4"]),
    ((*GOOD[:2], real_mode(0, 0 * SHAPES)), ["is zero at all nodes"]),
    ((*GOOD[:2], mode_55(1, 0.0, {7: (1, 0, 0)})), ["no mode has a frequency"]),
    ((*GOOD[:2], GOOD[2].replace(ints(12), ints(12, 12))), ["number of the next"]),
    ((*GOOD[:2], GOOD[2].replace(ints(12), ints(7))), ["node 7 is there twice"]),
    (
        (*GOOD[:2], complex_mode(0, SHAPES + 0j).replace("-2.08", " 2.08")),
        ["grows in time", "rad/s"],
    ),
    ((units_164(1.0), PLAIN[1], UNITS, GOOD[2]), ["factor of length is 1000, expected 1"]),
]


@pytest.mark.parametrize(("blocks", "words"), BROKEN, ids=[w[0][:30] for _, w in BROKEN])
def test_broken_files_are_one_error(tmp_path, blocks, words):
    with pytest.raises(InputError) as caught:
        read_shapes(write(tmp_path / "a.uff", *blocks))
    assert "a.uff" in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_pairs_by_order_and_frequency(tmp_path):
    found = read_shapes(write(tmp_path / "a.uff", *GOOD))
    assert found.nearest(np.array([185.0, 400.0])).tolist() == [0, 2]
    assert found.nearest(np.array([200.0, 400.0])).tolist() == [1, 2]
    with pytest.raises(InputError, match="within 10 % of each of 100, 400 Hz"):
        found.nearest(np.array([100.0, 400.0]))


def function(kind, denominator):
    dofs = f"{kind:5d}{1:10d}{0:5d}{0:10d} {'NONE':10}{7:10d}{3:4d} {'NONE':10}{3:10d}{3:4d}"
    axes = [
        f"{data:10d}{0:5d}{0:5d}{0:5d} {'NONE':20} {'NONE':20}" for data in (18, 12, denominator, 0)
    ]
    head = [*["NONE"] * 5, dofs, ints(5, 3, 1) + reals(10.0, 1.0, 0.0), *axes]
    return block(58, *head, reals(1, 2, 3, 4, 5, 6))


@pytest.mark.parametrize(("kind", "denominator"), [(9, 0), (5, 12), (4, 12), (2, 0)])
def test_functions_of_responses_alone_are_refused_with_what_is_needed(tmp_path, kind, denominator):
    """Spectra, transmissibilities, and those that call themselves frequency response functions."""
    with pytest.raises(InputError, match="hammer or a shaker .*operational modal.*datasets 55"):
        read_frfs(write(tmp_path / "a.uff", *PLAIN, function(kind, denominator)))


def test_complex_rotations_over_two_lines_and_exponents_with_d(tmp_path):
    """Twelve numbers for each node, six in a line; the first three components count."""
    records = [*["NONE"] * 5, ints(1, 3, 3, 8, 5, 6), ints(2, 6, 1, 1), reals(-1.0, 1000.0)]
    for node, v in zip(NODES, SHAPES[0], strict=True):
        records += [ints(node), reals(v[0], 0, v[1], 0, v[2], 0).replace("E", "D")]
        records += [reals(9, 9, 9, 9, 9, 9)]
    found = read_shapes(write(tmp_path / "a.uff", *PLAIN, block(55, *records)))
    moves = SHAPES[0].ravel() != 0
    expected = SHAPES[0].ravel()[moves]
    assert np.abs(found.shapes[:, 0]) == pytest.approx(np.abs(expected), rel=1e-5)
    assert mac(found.shapes, expected[:, None])[0, 0] == pytest.approx(1)
    assert found.frequencies_hz[0] == pytest.approx(np.hypot(1, 1000) / (2 * np.pi))
    assert "Rotations in the files were not used" in found.notes

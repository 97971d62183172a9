"""Measured functions from files: what is read, and what is said about files that are wrong.

The functions are those of three masses, by inversion of the dynamic stiffness at each line.
"""

from __future__ import annotations

import measured_world as world
import numpy as np
import pytest
import scipy.io

from fenics_joints.errors import InputError
from fenics_joints.measurements import read_frfs
from fenics_joints.response.units import frf_unit

pyuff = pytest.importorskip("pyuff")

F, H = world.FREQUENCIES, world.accelerance()
POINTS = 1e-3 * np.array(list(world.NODES.values()))
PAIRS = [(i, j) for i in range(3) for j in range(3)]


def _uff(folder, sets, name="a.uff", nodes=None):
    """A file of datasets and one of the geometry."""
    nodes = world.geometry() if nodes is None else nodes
    return [world.write_uff(folder / name, *sets), world.write_uff(folder / "nodes.uff", *nodes)]


def _same(read, tolerance=1e-6):
    assert read.kind == "accelerance" and read.unit == "m/s2/N"
    assert np.abs(read.frequencies_hz - F).max() < 1e-6 * F.max()
    assert (np.abs(read.values - H).max(axis=0) < tolerance * np.abs(H).max(axis=0)).all()
    assert np.abs(read.response_points - POINTS).max() < 1e-12
    assert np.abs(read.reference_points - POINTS).max() < 1e-12
    directions = np.eye(3)[[2, 1, 2]]
    assert (read.response_directions == directions).all()
    assert (read.reference_directions == directions).all()


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("spacing", [0, 1])
def test_uff_of_two_files_in_any_order(tmp_path, binary, spacing):
    rng = np.random.default_rng(3)
    sets = [world.function(i, j, binary=binary, abscissa_spacing=spacing) for i, j in PAIRS]
    sets += [world.coherence(0, 1, binary=binary), world.function(0, 0, func_type=2)]
    sets = [sets[i] for i in rng.permutation(len(sets))]
    files = [
        world.write_uff(tmp_path / "b.uff", *sets[:4], world.geometry(15)[1], world.units()),
        world.write_uff(tmp_path / "a.unv", *sets[4:]),
    ]
    # Labels say g/N and dataset 164 mm and N: they disagree, the user decides.
    read = read_frfs(files, units="g/N")
    _same(read)
    assert read.response_names == read.reference_names == ("1:+z", "2:+y", "7:+z")
    assert np.isnan(read.coherence).all(axis=0).sum() == 8
    said = "coherence: 0.95 in the median, below 0.9 at 25 % of the lines, at 25 % of the worst"
    assert read.coherence_words(0.9).startswith(said)
    sd = read.relative_sd(50)[:, 0, 1]
    assert sd[[0, -1]] == pytest.approx([0.1, np.sqrt(0.05 / 95)])
    assert len(read.notes) == 1 and "auto spectrum" in read.notes[0]


def _mat(at=slice(None), **more):
    """What a MATLAB file has of the functions between some points."""
    ways = np.eye(3)[[2, 1, 2]][at]
    places = dict(response_points=POINTS[at], reference_points=POINTS[at])
    ways = dict(response_directions=ways, reference_directions=ways)
    return dict(frequency=F, frf=H[:, at, at], units="m/s2/N", **places, **ways) | more


def test_mat(tmp_path):
    path, keys = tmp_path / "a.mat", {"frequency": "f", "frf": "H"}
    content = _mat(f=F, H=1e3 * H, units="mm/s2/N", coherence=np.full(H.shape, 0.9))
    content |= {k: 1e3 * POINTS for k in content if k.endswith("points")} | {"length_unit": "mm"}
    del content["frequency"], content["frf"]
    scipy.io.savemat(path, content)
    read = read_frfs(path, keys=keys)
    _same(read)
    assert (read.coherence == 0.9).all() and len(read.driving_points()) == 3
    for change, said in [
        (
            {"H": H[:, :2], "coherence": H.real[:, :2]},
            "response_points is 3 x 3; expected 2 x 3, as H has 2 responses",
        ),
        ({"H": H.real}, "H is real; expected complex"),
        ({"H": H[:-1]}, "H is 599 x 3 x 3; expected .* n = 600"),
        ({"units": "mm/V"}, "units: the unit 'mm/V' is not known"),
        ({"kind": "mobility"}, "unit of an accelerance, expected that of kind = 'mobility'"),
        ({"coherence": 2 + 0 * H.real}, r"coherence\(:, 1, 1\): coherence 2.0 at 60 Hz"),
        ({"f": F[::-1]}, "frequencies that are finite and ascend"),
    ]:
        scipy.io.savemat(path, content | change)
        with pytest.raises(InputError, match=said):
            read_frfs(path, keys=keys)
    with pytest.raises(InputError, match="no variable 'frequency'.*there are .*f, H, coherence"):
        read_frfs(path)
    path.write_bytes(b"no MATLAB file")
    with pytest.raises(InputError, match="a.mat: cannot be read as a MATLAB file"):
        read_frfs(path)


def test_a_small_mat_file_that_would_fill_the_memory(tmp_path):
    path = tmp_path / "a.mat"
    zeros = np.zeros((1, 200_000_001), dtype=np.uint8)
    scipy.io.savemat(path, {"frequency": zeros, "other": "not read"}, do_compression=True)
    assert path.stat().st_size < 1e6
    with pytest.raises(InputError, match=r"frequency is 1 x 200000001: expected at most"):
        read_frfs(path)


def _csv(path, heads, columns):
    rows = [",".join(heads), *(",".join(f"{x:.12g}" for x in row) for row in np.array(columns).T)]
    path.write_text("# a table\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_csv(tmp_path):
    names = ["1:+z", "2:y", "7:+z"]
    nodes = _csv(
        tmp_path / "nodes.csv",
        ["node", "x [mm]", "y [mm]", "z [mm]"],
        [list(world.NODES), *(1e3 * POINTS.T)],
    )
    heads, columns = ["frequency [kHz]"], [F / 1e3]
    for i, j in PAIRS[:5]:
        heads += [f"{names[i]}/{names[j]} re [m/s²/N]", f"{names[i]}/{names[j]} im [m/s²/N]"]
        columns += [H[:, i, j].real, H[:, i, j].imag]
    first = _csv(tmp_path / "a.csv", heads, columns)
    heads, columns = ["frequency [Hz]"], [F]
    for i, j in PAIRS[5:]:
        heads += [f"{names[i]}/{names[j]} abs [g/N]", f"{names[i]}/{names[j]} phase [deg]"]
        columns += [np.abs(H[:, i, j]) / 9.80665, np.rad2deg(np.angle(H[:, i, j]))]
    second = _csv(tmp_path / "b.csv", heads, columns)
    _same(read_frfs([nodes, second, first]))
    with pytest.raises(InputError, match="b.csv: 2:y/7:.z: response node 2 has no coordinates"):
        read_frfs([second, first])
    for old, new, said in [
        ("abs [g/N]", "abs [V/N]", "column '2:y/7:.z abs': the unit 'V/N' is not known"),
        ("phase [deg]", "phase", r"2:y/7:.z phase': unit '', expected \[deg\]"),
        ("deg]\n60,", "deg]\n60,-", "abs: -.* expected magnitudes of 0 or more, not decibels"),
        ("2:y/7:+z abs", "2:w/7:+z abs", "'2:w/7:.z abs': expected a head such as '12:.z/5:-x re"),
        ("2:y/7:+z phase [deg]", "2:y/7:-z re [g/N]", "has the columns abs; expected re and im"),
    ]:
        other = tmp_path / "c.csv"
        other.write_text(second.read_text().replace(old, new, 1))
        with pytest.raises(InputError, match=said):
            read_frfs([nodes, other, first])


def test_decimal_commas_and_long_labels(tmp_path):
    rows = [["frequency [Hz]", "1000001:z/1000002:z re [g/N]", "1000001:z/1000002:z im [g/N]"]]
    rows += [[f"{x:.12g}" for x in (f, h.real, h.imag)] for f, h in zip(F, H[:, 0, 2], strict=True)]
    functions = tmp_path / "a.csv"
    nodes = tmp_path / "nodes.csv"
    nodes.write_text("node;x [mm];y [mm];z [mm]\n1000001;0;0;0\n1000002;1,5;0;0\n")
    for separator in ";\t":
        text = "\n".join(separator.join(row) for row in rows).replace(".", ",")
        functions.write_text(text + "\n")
        read = read_frfs([nodes, functions])
        assert read.values[:, 0, 0] == pytest.approx(9.80665 * H[:, 0, 2], rel=1e-9)
        assert read.reference_names == ("1000002:+z",) and read.reference_points[0, 0] == 1.5e-3
    # A comma and a point in one file: which of them is decimal is not for us to guess.
    functions.write_text(text.replace("0,", "0.", 1))
    with pytest.raises(InputError, match="a.csv: row 2,.* and [0-9]+ more: expected a number") as e:
        read_frfs([nodes, functions])
    assert len(str(e.value)) < 1000


def test_power_at_driving_points(tmp_path):
    """A kind that is wrong by one derivative; and a band of springs whose phase is a little off."""

    def read(**changes):
        scipy.io.savemat(tmp_path / "a.mat", _mat(slice(1)) | changes)
        return read_frfs(tmp_path / "a.mat")

    assert not read().notes
    assert "has both signs, for a mobility as said" in str(read(units="m/s/N"))
    low = F < 90
    assert not read(frequency=F[low], frf=H[low, 0, 0] * np.exp(0.05j)).notes


def test_what_a_file_does_not_say_can_be_said(tmp_path):
    """No units, kind, direction or nodes in the file; and nodes that move along own axes."""
    blank = dict(ordinate_axis_units_lab="NONE", orddenom_axis_units_lab="NONE")
    blank |= dict(ordinate_spec_data_type=0, orddenom_spec_data_type=0)
    sets = [world.function(i, j, **blank) for i, j in PAIRS if i and j != 1]
    for s in sets:
        s["rsp_dir"] = 0 if s["rsp_node"] == 2 else s["rsp_dir"]
    file = world.write_uff(tmp_path / "a.uff", *sets)
    points = {str(k): 1e-3 * np.array(p) for k, p in world.NODES.items()}
    said = dict(units="g/N", points=points, directions={"2": [0, -2, 0]})
    read = read_frfs(file, **said)
    signs = np.array([-1, 1])[None, :, None]  # node 2 was said to be measured along -y
    assert np.abs(read.values - signs * H[:, 1:, ::2]).max() < 1e-6 * np.abs(H).max()

    # Rows are the axes: what is along its own z is along x of all.
    system = world.system(5, [[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 0, 0]])
    nodes = world.geometry(disp_cs=[5, 0, 0])
    nodes[0] = world.units(1.0)  # so y is 10 m
    files = _uff(tmp_path, [world.function(0, 0)], "b.uff", [*nodes, system])
    read = read_frfs(files)
    assert read.response_names == ("1:+x",) and read.response_points[0, 1] == 10.0
    older = dict(type=18, cs_num=[5], cs_type=[0], ref_cs_num=[0], color=[8], method=[1])
    older |= dict(cs_name=["CS5"], ref_o=[[1, 2, 3.0]], x_point=[[1, 4, 3.0]])
    older |= dict(xz_point=[[2, 9, 3.0]])
    local = [world.units(1.0), world.geometry(15, disp_cs=[5, 0, 0], def_cs=[5, 0, 0])[1]]
    read = read_frfs(_uff(tmp_path, [world.function(0, 0)], "d.uff", [*local, older]))
    assert read.response_names == ("1:+x",)
    # Node 1 is at x = 0, y = 10, z = 5 of those axes: 5 along x, 0 along y, 10 along z of all.
    assert read.response_points[0] == pytest.approx([1 + 5, 2 + 0, 3 + 10])
    with pytest.raises(InputError, match="displacement system 5 is not in the file"):
        read_frfs(_uff(tmp_path, [world.function(0, 0)], "c.uff", nodes))


def _with_nan(text: bytes) -> bytes:
    lines = text.split(b"\n")
    lines[20] = b"%20s" % b"nan" + lines[20][20:]
    return b"\n".join(lines)


def _without_lines(text: bytes) -> bytes:
    lines = text.split(b"\n")
    return b"\n".join([*lines[:8], lines[8].replace(b"600", b"  0"), *lines[9:13], b"    -1\n"])


BROKEN_FUNCTIONS = [
    (dict(rsp_node=4), "response node 4 has no coordinates.* known are nodes 1, 2, 7"),
    (dict(ref_node=0), "reference node 0 has no coordinates"),
    (dict(rsp_dir=0), r"response node 2 has no direction \(code 0 is a scalar\)"),
    (dict(rsp_dir=5), "response direction code 5 of node 2 is a rotation"),
    (dict(ordinate_spec_data_type=13), r"response is of type 13 \(excitation force\), expected"),
    (dict(ordinate_spec_data_type=3), r"response is of type 3 \(strain\)"),
    (dict(ordinate_spec_data_type=8), "units 'g' are those of an accelerance, expected those"),
    (dict(orddenom_spec_data_type=12), r"reference is of type 12 \(acceleration\)"),
    (dict(ordinate_axis_units_lab="V"), r"labels of the units: the unit '\(V\)/\(N\)' is not"),
    (dict(ordinate_axis_units_lab="NONE"), "the units are not known; expected a dataset 164"),
    (dict(x=F + 0.2), "60.2 to 359.7 Hz in 600 lines, expected 60 to 359.5 Hz.*dataset 1"),
    (dict(abscissa_spec_data_type=17), r"abscissa is of type 17 \(time\)"),
    (dict(abscissa_axis_units_lab="rad/s"), "unit of the abscissa: .*not one of cycles"),
    (dict(data=world.function(1, 1)["data"].real), "expected 5 or 6 .complex."),
    (dict(rsp_node=1, rsp_dir=-3, ref_node=1, ref_dir=3), "already in .*a.uff: dataset 1 "),
    (dict(data=-world.function(1, 1)["data"]), "driving point 2:.y the mobility's real part is"),
    (dict(data=np.conj(world.function(1, 1)["data"])), "or the conjugate"),
    (dict(data=np.full(len(F), 0.97 + 0j)), "is real at all lines, as a spectrum or a coherence"),
    (dict(data=np.zeros(len(F), dtype=complex)), "is zero; expected"),
]
BROKEN_FILES = [
    (1, lambda b: b[: len(b) // 3], "stops within a dataset .*truncated"),
    (1, lambda b: b[:-4000] + b"    -1\n", r"dataset 2 \(type 58\): holds 350 values, expected"),
    (0, lambda b: b[:-4000] + b"\n    -1\n", "holds .* values, expected 600 as in its record 7"),
    (0, lambda b: b[:-4000].rstrip() + b" oops" + b[-4000:], "cannot be read; expected 600 AS"),
    (0, lambda b: b.replace(b"    58 ", b"    5x ", 1), "dataset 1 .* has no type"),
    (1, lambda b: b.replace(b"58b     1     2", b"58b     1     3", 1), r"format 3 \(IBM 370\)"),
    (1, lambda b: b.replace(b"       600 ", b"9999999999 ", 1), "expected 9999999999"),
    (1, lambda b: b.replace(b"        4800", b"abcdefghijkl", 1), "dataset 1"),
    (0, _with_nan, "is .*nan.*, expected a finite"),
    (0, _without_lines, "dataset 1 .* holds no line"),
    (0, lambda b: b"", "is empty"),
]


def test_broken_functions(tmp_path):
    """Each is the second dataset of a file whose first is good; the message says so."""
    for change, said in BROKEN_FUNCTIONS:
        sets = [world.function(0, 0), world.function(1, 1, **change)]
        with pytest.raises(InputError, match=said) as raised:
            read_frfs(_uff(tmp_path, sets))
        assert "a.uff: dataset 2 (type 58)" in str(raised.value)


def test_broken_files(tmp_path):
    for binary, damage, said in BROKEN_FILES:
        files = _uff(tmp_path, [world.function(i, i, binary=binary) for i in range(2)])
        files[0].write_bytes(damage(files[0].read_bytes()))
        with pytest.raises(InputError, match=said) as raised:
            read_frfs(files)
        assert "a.uff" in str(raised.value)


def test_broken_company(tmp_path):
    """Files that are right in themselves and wrong together."""
    good = _uff(tmp_path, [world.function(0, 0)])
    mixed = dict(ordinate_spec_data_type=11, ordinate_axis_units_lab="m/s")
    for sets, said in (
        (world.geometry(x=[0.0, 250.0, 501.0]), "node 7 is at .0.501.*expected .0.5,.*nodes.uff"),
        ([world.units(), world.function(1, 1)], "unit 'g' by 'N' is 9.80665 .*by dataset 164 it"),
        ([world.function(1, 1, **mixed)], "is a mobility, expected an accelerance as in .*a.u"),
        ([world.coherence(0, 1)], "coherence of response 1:.z, reference 2:.y has no"),
    ):
        with pytest.raises(InputError, match=f"b.uff.*{said}"):
            read_frfs([*good, world.write_uff(tmp_path / "b.uff", *sets)])
    many = world.write_uff(tmp_path / "d.uff", world.function(0, 1, func_type=3))
    bare = world.write_uff(tmp_path / "bare.uff", *world.geometry()[1:])
    for files, said in (
        ([many], r"1 of type 3 \(cross spectrum\); expected some of type 4"),
        ([good[0], bare], "bare.uff.*2411.: the unit of coordinates is not known"),
        ([*good, good[1]], "nodes.uff: is named twice"),
    ):
        with pytest.raises(InputError, match=said):
            read_frfs(files)
    with pytest.raises(InputError, match="units = 'm/N': are those of a receptance, expected"):
        read_frfs(good, units="m/N", kind="mobility")


def test_without_pyuff(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyuff", None)
    (tmp_path / "a.uff").write_text("    -1")
    with pytest.raises(InputError, match=r"pip install 'fenics-joints\[frf\]'"):
        read_frfs(tmp_path / "a.uff")


def test_kinds_reciprocity_and_parts(tmp_path):
    defect = {(0, 1): 1.04, (2, 1): 0.99}
    sets = [world.function(i, j) for i, j in PAIRS]
    for s, pair in zip(sets, PAIRS, strict=True):
        s["data"] = s["data"] * defect.get(pair, 1.0)
    read = read_frfs(_uff(tmp_path, sets))
    found = read.reciprocity()
    assert list(found) == [("1:+z", "2:+y"), ("1:+z", "7:+z"), ("2:+y", "7:+z")]
    assert [*found.values()] == pytest.approx([0.04 / 1.02, 0, 0.01 / 0.995], abs=1e-6)
    assert "3 pairs, defect 0.01 in the median, 0.039 at worst (1:+z and 2:+y)" in str(read)

    # A receptance of its own: by the modes, not by inversion.
    f_modes, phi = world.modes()
    w, w_modes = 2 * np.pi * F[:, None], 2 * np.pi * f_modes
    modal = 1 / (w_modes**2 - w**2 + 2j * world.ZETA * w_modes * w)
    receptance = np.einsum("ir,nr,jr->nij", phi, modal, phi)
    part = read.converted("receptance").select(["7:+z"], ["1:+z"]).band(100, 120)
    lines = (F >= 100) & (F <= 120)
    assert part.values.shape == (lines.sum(), 1, 1)
    assert part.values[:, 0, 0] == pytest.approx(receptance[lines, 2, 0], rel=1e-6)
    again = part.converted("mobility").converted("accelerance")
    assert again.values[:, 0, 0] == pytest.approx(H[lines, 2, 0], rel=1e-6)
    with pytest.raises(InputError, match="60 to 359.5 Hz"):
        read.band(400, 500)
    assert frf_unit("in/s^2/lbf")[1] == pytest.approx(0.0254 / 4.4482216152605)


def test_a_variable_that_holds_others_is_not_unpacked(tmp_path):
    """A struct says nothing of the size of what is in it."""
    path = tmp_path / "test.mat"
    inside = {"values": np.zeros((2000, 2000))}
    scipy.io.savemat(path, {"frequency": np.arange(3.0), "frf": inside}, do_compression=True)
    with pytest.raises(InputError, match="frf is a struct"):
        read_frfs(path)

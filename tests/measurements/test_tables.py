"""Tables of numbers: odd heads, cells and sizes are refused clearly, and soon."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip("dolfinx")

import resource
import subprocess
import sys

from fenics_joints.errors import InputError
from fenics_joints.files import check_size
from fenics_joints.measurements import read_frfs, read_table, read_test_data
from fenics_joints.measurements.tables import column_head


@pytest.mark.parametrize(
    ("head", "name", "unit"),
    [
        ("torque [N·m]", "torque", "N·m"),
        ("  mode 1 [ Hz ]  ", "mode 1", "Hz"),
        ("1:+z/2 re [m/s2/N]", "1:+z/2 re", "m/s2/N"),
        ("a [b] [c]", "a [b]", "c"),
        ("torque", "torque", ""),
        ("a [b", "a [b", ""),
    ],
)
def test_heads(head, name, unit):
    assert column_head(head) == (name, unit)


def test_a_head_of_blanks_takes_no_time():
    """Backtracking over 100,000 blanks would take hours."""
    start = time.perf_counter()
    column_head(" " * 100_000 + "[" + " " * 100_000)
    assert time.perf_counter() - start < 1.0


def write(folder, head: str, *rows: str, name: str = "table.csv"):
    path = folder / name
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("head", "row", "said"),
    [
        ("torque [N m], mode 1 [Hz]", "5, 400", ["'torque'", "condition = 'torque'"]),
        ("mode 1 [Hz**9**9**9]", "400", ["mode 1", "is no frequency"]),
        ("mode 1 [Hz]", "4" * 200_000, ["row 2", "field larger"]),
        ("mode 1\x1b[31m [Hz]", "400", ["U+001B"]),
        ("a [Hz], a [Hz]", "1, 2", ["'a'", "used once"]),
    ],
)
def test_mistakes(tmp_path, head, row, said):
    with pytest.raises(InputError) as error:
        read_test_data(write(tmp_path, head, row))
    for fragment in said:
        assert fragment in str(error.value)


def test_a_table_of_the_condition_alone(tmp_path):
    with pytest.raises(InputError, match="no column but that of the condition, 'torque'"):
        read_test_data(write(tmp_path, "torque [N m]", "5"), condition="torque")


def test_many_columns_take_no_time_and_are_no_test(tmp_path):
    """As many columns again took four times as long: 100,000 took minutes."""
    names = [f"mode {i}" for i in range(100_000)]
    file = write(tmp_path, ",".join(f"{n} [Hz]" for n in names), ",".join(["1.0"] * len(names)))
    start = time.perf_counter()
    table = read_table(file)
    total = sum(float(table.column(name, "Hz")[0]) for name in names)
    assert total == len(names) and time.perf_counter() - start < 10.0
    with pytest.raises(InputError, match="100000 columns of frequencies, expected at most 1000"):
        read_test_data(file)


def test_functions_that_share_no_node_are_no_matrix(tmp_path):
    """20,000 of them would be 400 million cells, which are 6 GB for each line."""
    n = 20_000
    head = ["frequency [Hz]"]
    head += [f"{i}:+z/{n + i}:+z {part} [m/N]" for i in range(n) for part in ("re", "im")]
    functions = write(tmp_path, ",".join(head), ",".join(["5.0"] + ["1.0"] * 2 * n))
    nodes = tmp_path / "nodes.csv"
    x = np.arange(2 * n)
    columns = np.column_stack([x, x, 0 * x, 0 * x])
    heads = "node,x [m],y [m],z [m]"
    np.savetxt(nodes, columns, delimiter=",", fmt="%d", header=heads, comments="")
    with pytest.raises(InputError, match="20000 references, 20000 responses"):
        read_frfs([functions, nodes])


# -- spreadsheets and large tables -----------------------------------------------------------------

HEAD = "torque [N·m]{0}a [Hz]{0}b [Hz]"
TABLES = {
    ",": "5{0}100.5{0}200.25\n6{0}{0}201",
    ";": "5{0}100,5{0}200,25\n6{0}{0}201",
    "\t": "5{0}100,5{0}200,25\n6{0}{0}201",
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("comma", list(TABLES))
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("more", [0, 3])
def test_tables_of_spreadsheets(tmp_path, encoding, comma, end, more):
    """Empty columns at the right, any of the encodings, decimal commas, lines of Windows."""
    path, text = tmp_path / "a.csv", HEAD.format(comma) + "\n" + TABLES[comma].format(comma)
    text = end.join(line + more * comma for line in text.split("\n")) + end
    path.write_bytes(text.encode(encoding))
    data = read_test_data(path, condition="torque")
    assert data.condition_unit == "N·m"
    assert data.frequencies_hz == pytest.approx(
        np.array([[100.5, 200.25], [np.nan, 201]]), nan_ok=True
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a [Hz],b [Hz]\n1_00,2\n", "column 'a [Hz]' = '1_00'"),
        ("a [Hz],b [Hz]\n1,2,3\n", "row 2 has 3 cells"),
        ("a [Hz],b [Hz],\n1,2,3\n", "row 2 has 3 cells"),
        ("a [Hz],,b [Hz]\n1,,3\n", "column name ''"),
        (",".join(f"m{i} [Hz]" for i in range(3000)) + "\n" + 3000 * "1\n", "row 2 has 1 cells"),
    ],
)
def test_what_is_no_table(tmp_path, text, said):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        read_table(path)
    assert said in str(raised.value)


READ = """
import resource, sys
from fenics_joints.measurements import read_table
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
table = read_table(sys.argv[1])
print(table.values.nbytes, 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before))
"""


@pytest.mark.skipif(not hasattr(resource, "RUSAGE_SELF"), reason="needs POSIX")
def test_memory_of_a_large_table(tmp_path):
    """That of its numbers and a little more, where cells and rows took twenty times as much."""
    path = tmp_path / "a.csv"
    row = ",".join(f"{x:.5e}" for x in np.linspace(-1, 1, 100)) + "\n"
    path.write_text(",".join(f"m{i} [Hz]" for i in range(100)) + "\n" + 15_000 * row)
    out = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True
    )
    numbers, more = map(int, out.stdout.split())
    assert numbers == 15_000 * 100 * 8 and more < 2 * numbers + 10e6


def test_too_large_a_file_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    with path.open("wb") as stream:
        stream.truncate(3_000_000_000)  # takes no space
    with pytest.raises(InputError, match="3,000 MB"):
        read_table(path)
    with pytest.raises(InputError, match="3,000 MB"):
        check_size(path)


# -- tests by level --------------------------------------------------------------------------------


def test_a_backbone_is_one_table(tmp_path):
    """Level, frequency, damping, as they come from a test; per cent by the head's unit."""
    table = tmp_path / "backbone.csv"
    table.write_text("level [m/s2],f [Hz],damping [%]\n20,80.2,0.19\n5,80.4,0.145\n")
    data = read_test_data(table, condition="level")
    assert data.by_level and data.mode_names == ("f",)
    np.testing.assert_allclose(data.damping[:, 0], [0.00145, 0.0019])
    rows = "1,10,0.01,20,\n2,9,0.02,19,0.03\n"
    table.write_text("level [N],a [Hz],a damping,b [Hz],b damping\n" + rows)
    data = read_test_data(table, condition="level")
    np.testing.assert_allclose(data.damping, [[0.01, np.nan], [0.02, 0.03]])
    assert data.mode_names == ("a", "b")
    table.write_text("level [N],a [Hz],b [Hz],damping\n1,10,20,0.01\n")
    with pytest.raises(InputError, match="'damping' is of one mode"):
        read_test_data(table, condition="level")
    table.write_text("level [N],a [Hz],damping\n1,10,1.5\n")
    with pytest.raises(InputError, match=r"below 1 \(or a unit \[%\]"):
        read_test_data(table, condition="level")


def test_heads_in_the_first_column(tmp_path):
    """The same table either way round, with empty columns at the right."""
    wide = "torque [N*m],mode 1 [Hz],mode 2 [Hz],,\n4,100.5,200,,\n8,101,,,\n"
    tall = "torque [N*m];4;8\nmode 1 [Hz];100,5;101\nmode 2 [Hz];200;\n"
    found = []
    for name, text in (("wide.csv", wide), ("tall.csv", tall)):
        (tmp_path / name).write_text(text)
        found.append(read_table(tmp_path / name))
    assert found[0].names == found[1].names == ("torque", "mode 1", "mode 2")
    np.testing.assert_array_equal(found[0].values, found[1].values)
    assert "was turned" in found[1].notes[0] and not found[0].notes

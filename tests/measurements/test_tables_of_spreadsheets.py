"""Tables as spreadsheets write them, and large ones."""

from __future__ import annotations

import resource
import subprocess
import sys

import numpy as np
import pytest

from fenics_joints.errors import InputError
from fenics_joints.files import check_size
from fenics_joints.measurements import read_table, read_test_data

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

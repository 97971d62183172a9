"""Tables of numbers: odd heads, cells and sizes are refused clearly, and soon."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from fenics_joints.errors import InputError
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

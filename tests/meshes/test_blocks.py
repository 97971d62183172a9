"""Blocks: measures against closed forms; grids of lines."""

import numpy as np
import pytest
from matching_faces import assert_pair, faces, parts
from mesh_measures import CELLS, COMM, areas, skin, volumes

from fenics_joints.meshes import box, check_mesh, graded_lines, stacked_blocks

X, Y = graded_lines([0, 0.5, 1], [0.1, 0.3, 0.1]), np.array([0, 0.2, 0.5, 0.6])
LOW, HIGH = np.array([-0.5, -0.2, 0]), np.array([0, 0.1, 0.3])


@pytest.mark.parallel
@pytest.mark.parametrize("cell", CELLS)
def test_box_measures(cell):
    tagged = box(COMM, (1.0, 0.2, 0.3), (5, 2, 3), cell)
    assert volumes(tagged) == pytest.approx({"body": 0.06})
    sides = {"x": 0.06, "y": 0.3, "z": 0.2}
    expected = {f"{axis}_{end}": sides[axis] for axis in "xyz" for end in ("min", "max")}
    assert areas(tagged) == pytest.approx(expected)
    assert skin(tagged) == pytest.approx(2 * sum(sides.values()))


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_a_small_block_on_a_big_one(cell):
    plan = [X] if cell in ("quadrilateral", "triangle") else [X, Y]
    x0, x1, y1 = X[1], X[-3], Y[2]
    span = (x0, x1) if len(plan) == 1 else ((x0, x1), (0.0, y1))
    tagged = stacked_blocks(COMM, lower=(*plan, LOW), upper=HIGH, upper_span=span, cell=cell)
    width, depth = x1 - x0, (1.0, 1.0) if len(plan) == 1 else (0.6, y1)
    big, small = depth
    assert parts(tagged) == pytest.approx({"lower": 0.5 * big, "upper": 0.3 * width * small})
    ends = 0.5 * big + 0.3 * small
    expected = {"interface_lower": width * small, "interface_upper": width * small, "bottom": big}
    expected |= {"top": width * small, "left": ends, "right": ends}
    if len(plan) == 2:
        expected |= dict.fromkeys(("front", "back"), 0.5 + 0.3 * width)
    assert faces(tagged) == pytest.approx(expected)
    assert check_mesh(tagged).bodies == 2
    assert_pair(tagged, "interface_lower", "interface_upper", ("lower", "upper"))


def test_lines_grow_from_size_to_size():
    lines = graded_lines([1.0, 3.0, 4.0], [0.05, 0.4, 0.4])
    steps = np.diff(lines)
    assert {1.0, 3.0, 4.0} <= set(lines) and steps.max() <= 0.4 + 1e-12
    first = steps[lines[1:] <= 3.0]
    np.testing.assert_allclose(first[1:] / first[:-1], first[1] / first[0])
    assert 0.04 < first[0] < 0.06 and 0.35 < first[-1] <= 0.4
    np.testing.assert_allclose(graded_lines([0, 1], [0.25, 0.25]), np.linspace(0, 1, 5))

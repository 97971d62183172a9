"""A box: measures against closed forms."""

import pytest
from mesh_measures import CELLS, COMM, areas, skin, volumes

from fenics_joints.meshes import box


@pytest.mark.parallel
@pytest.mark.parametrize("cell", CELLS)
def test_box_measures(cell):
    tagged = box(COMM, (1.0, 0.2, 0.3), (5, 2, 3), cell)
    assert volumes(tagged) == pytest.approx({"body": 0.06})
    sides = {"x": 0.06, "y": 0.3, "z": 0.2}
    expected = {f"{axis}_{end}": sides[axis] for axis in "xyz" for end in ("min", "max")}
    assert areas(tagged) == pytest.approx(expected)
    assert skin(tagged) == pytest.approx(2 * sum(sides.values()))

"""The dumbbells of Machines 2022: rings around bolts, against regular polygons."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import check_mesh, dumbbell

COMM = MPI.COMM_WORLD
SOLID = ("head_1", "neck_1", "neck_2", "head_2")
COARSE = {"element_size": 0.065}

RINGS = {"rings": [(-0.03, 0.0), (0.03, 0.0)], "r_wai": 0.024, **COARSE}


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("holes", [False, True])
def test_rings_around_bolts(cell, holes):
    """Volumes of regular polygons, both bodies joined by the rings alone."""
    tagged = dumbbell(COMM, holes=holes, cell=cell, **RINGS)
    assert check_mesh(tagged).bodies == 1
    assert set(tagged.cell_names) == {*SOLID, "ring_1", "ring_2"}
    assert tagged.points["bolts"] == pytest.approx(
        np.array([[-0.03, 0, 0.657e-3 / 2], [0.03, 0, 0.657e-3 / 2]])
    )
    n = 16  # corners on each circle
    polygon = {r: n / 2 * np.sin(2 * np.pi / n) * r**2 for r in (0.00875, 0.024)}
    hole = 2 * polygon[0.00875] if holes else 0.0
    areas = {"head": (0.24 * 0.18 - hole) * 0.09, "neck": (0.12 * 0.063 - hole) * 0.04}
    wanted = {name: areas[name[:4]] for name in SOLID}
    ring = polygon[0.024] - polygon[0.00875]
    wanted |= {name: ring * 0.657e-3 for name in ("ring_1", "ring_2")}
    dx = ufl.Measure("dx", tagged.mesh, subdomain_data=tagged.cell_tags)
    ds = ufl.Measure("dS", tagged.mesh, subdomain_data=tagged.facet_tags)
    one = fem.Constant(tagged.mesh, 1.0)
    for name, volume in wanted.items():
        found = fem.assemble_scalar(fem.form(one * dx(tagged.cell_tag(name))))
        assert COMM.allreduce(found) == pytest.approx(volume, rel=1e-9)
    for name in ("joint_lower", "joint_upper"):
        found = fem.assemble_scalar(fem.form(one * ds(tagged.facet_tag(name))))
        assert COMM.allreduce(found) == pytest.approx(2 * ring, rel=1e-9)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: dumbbell(COMM, layer=0.0), "layer is 0.0"),
        (lambda: dumbbell(COMM, neck=(0.3, 0.06, 0.04)), "neck is"),
        (lambda: dumbbell(COMM, rings=[(0, 0)]), "r_wai is None"),
        (lambda: dumbbell(COMM, rings=[(0.05, 0)], r_wai=0.02), "stays within -0.06 to"),
        (lambda: dumbbell(COMM, rings=[(-0.01, 0), (0.02, 0)], r_wai=0.02), "distance"),
    ],
)
def test_mistakes_are_named(make, said):
    with pytest.raises(MeshError, match=said):
        make()

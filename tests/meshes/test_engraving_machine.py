"""The stand-in for an engraving machine (Machines 2022): its mesh, and its joints' derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from eigen_slopes import difference
from matching_faces import faces, parts
from mpi4py import MPI

from fenics_joints._compat import geometry_dofmap
from fenics_joints.meshes import check_mesh, engraving_machine
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Parameter, Structure, part, transition

COMM = MPI.COMM_WORLD
IRON = {"E": 1.5e11, "nu": 0.23, "rho": 7250.0}
#: Eight bolts on a small frame.
SMALL = {
    "bed": (0.5, 0.8, 0.2),
    "column": 0.7,
    "arm": (0.25, 0.2),
    "wall": 0.022,
    "flange": 0.025,
    "gusset": 0.08,
    "ribs": 1,
    "bolts": (3, 3),
    "layer": 0.72e-3,
    "r_nei": 0.00675,
    "r_wai": 0.0514,
    "zone": 0.12,
    "element_size": 0.2,
}
E_RING = 6.111e9  # Machines 2022, Table 11


def machine(single=True):
    """The small frame; a modulus for each ring, or one for all."""
    tagged = engraving_machine(COMM, **SMALL)
    names = [n for n in tagged.cell_names if n.startswith("ring")]
    groups = {n: (n,) for n in names} if single else {"rings": tuple(names)}
    joints = [
        transition(n, cells, E=n, nu=0.253, h="h", meshed=0.72e-3) for n, cells in groups.items()
    ]
    parameters = [*(Parameter(n, E_RING, "Pa") for n in groups), Parameter("h", 0.72e-3, "m")]
    frame = part("frame", ("bed", "column"), **IRON)
    return Structure(tagged, [frame, *joints], parameters, degree=1)


def volumes_by_hand():
    """Bed, column and one ring, m3."""
    (width, length, height), (reach, tall) = SMALL["bed"], SMALL["arm"]
    t, f, zone = SMALL["wall"], SMALL["flange"], SMALL["zone"]
    n = SMALL["bolts"][0]
    holes = 8 * np.pi * SMALL["r_nei"] ** 2 * f
    # Strips below the plate: two walls and two ribs along; front, rear, two ribs in line with the
    # column, the one before the flange and one more across.
    along, across = 4, 6
    strips = along * t * length + across * t * width - along * across * t**2
    bed = width * length * f + strips * (height - f) - holes
    flange = n * zone + (n - 1) * t
    side = flange - 2 * zone
    hollow, above = (side - 2 * t) ** 2, SMALL["column"] - f
    column = (flange**2 - hollow) * f - holes + (side**2 - hollow) * above + hollow * t
    column += 4 * (n - 1) * zone * t * SMALL["gusset"]
    column += 2 * side * reach * t + side * t * (tall - 2 * t)
    column += 2 * t * (reach - t) * (tall - 2 * t)
    ring = np.pi * (SMALL["r_wai"] ** 2 - SMALL["r_nei"] ** 2) * SMALL["layer"]
    return bed, column, ring


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_two_castings_joined_by_rings_alone(cell):
    """Volumes by hand, tags, one body; bed and column share no vertex.

    Rings count anticlockwise from the corner of least x and y, each around its own bolt.
    """
    tagged = engraving_machine(COMM, cell=cell, n_layer=2, **SMALL)
    bed, column, ring = volumes_by_hand()
    quality = check_mesh(tagged)
    assert quality.bodies == 1
    assert cell == "tetrahedron" or quality.scaled_jacobian > 0.6
    wanted = {"bed": bed, "column": column} | {f"ring_{i}": ring for i in range(1, 9)}
    assert parts(tagged) == pytest.approx(wanted, rel=1e-9)
    inside = faces(tagged, inner=True)
    heights = faces(tagged, lambda mesh: ufl.SpatialCoordinate(mesh)[2], inner=True)
    for name, height in (("joint_lower", 0.0), ("joint_upper", SMALL["layer"])):
        assert inside[name] == pytest.approx(8 * ring / SMALL["layer"], rel=1e-9)
        assert heights[name] == pytest.approx(height * inside[name], abs=1e-12)
    t, (width, length, _) = SMALL["wall"], SMALL["bed"]
    rims = t * (4 * length + 6 * width) - 24 * t**2
    assert faces(tagged)["bottom"] == pytest.approx(rims, rel=1e-9)
    corners = tagged.mesh.geometry.x[geometry_dofmap(tagged.mesh)]
    for name, side in (("bed", -1), ("column", 1)):
        z = corners[tagged.cell_tags.find(tagged.cell_tag(name)), :, 2]
        assert np.all(side * (z - SMALL["layer"] * (side > 0)) > -1e-12)
    bolts = tagged.points["bolts"][:, :2]
    around = (0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)
    assert bolts == pytest.approx(bolts[0] + np.array(around) * (bolts[1, 0] - bolts[0, 0]))
    for i, bolt in enumerate(bolts, start=1):
        ring = corners[tagged.cell_tags.find(tagged.cell_tag(f"ring_{i}"))].reshape(-1, 3)
        assert np.all(np.linalg.norm(ring[:, :2] - bolt, axis=1) < SMALL["r_wai"] * 1.06)


@pytest.mark.parallel
def test_bolts_matter_alike_where_the_frame_is_symmetric():
    """Mirrored bolts alike, all of them together as the one parameter of all rings, six rigid
    modes; and the slope by their thickness beside central differences."""
    model, common = machine(), machine(single=False)
    modes = solve_modes(model, n_modes=11, tolerance=1e-10)
    assert modes.n_rigid == 6
    index = np.arange(6, 11)
    each = modes.gradients(index)[:, :8] * E_RING / modes.eigenvalues[6:11, None]
    x, y = model.tagged.points["bolts"][:, :2].T
    mirror = [int(np.argmin((x + a) ** 2 + (y - b) ** 2)) for a, b in zip(x, y, strict=True)]
    assert sorted(mirror) == list(range(8)) != mirror
    assert each == pytest.approx(each[:, mirror], rel=1e-5, abs=1e-9)
    assert np.all(each > 0) and np.all(each.max(axis=1) > 1.5 * each.min(axis=1))
    together = solve_modes(common, n_modes=11, tolerance=1e-10)
    assert together.eigenvalues[6:11] == pytest.approx(modes.eigenvalues[6:11], rel=1e-9)
    slopes = together.gradients(index) / together.eigenvalues[6:11, None]
    assert each.sum(axis=1) == pytest.approx(slopes[:, 0] * E_RING, rel=1e-5)
    exact = difference(common, {}, "h", index, 0.02, n_modes=11, tolerance=1e-10)
    assert slopes[:, 1] == pytest.approx(exact / together.eigenvalues[6:11], rel=2e-3)

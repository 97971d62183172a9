"""Which way a part's thickness points, and whether a model can have another one."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.spatial.transform import Rotation

from fenics_joints.case import build_mesh, build_structure, load_case
from fenics_joints.case.dimensions import Dimensions, long_normals, refuse_unfit
from fenics_joints.errors import InputError
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.modal import solve_modes

COMM = MPI.COMM_WORLD
TURN = Rotation.from_rotvec([0.3, 0.6, -0.15]).as_matrix()
MESH = """
[mesh]
file = "a.step"
size = "60 mm"
degree = 1
parts = {flat = 1, upright = 2, block = 3}
"""
PART = """
[parts.{0}]
cells = "{0}"
E = "70 GPa"
nu = 0.33
rho = "2700 kg/m3"
"""
JOINT = """
[joints.{0}]
law = "springs"
cells = "{1}"
k_n = "1 TPa/m"
k_t = "1 TPa/m"
"""


def angle(occ):
    """A plate, one that stands on its edge on it, and a block in the corner."""
    occ.addBox(0, 0, 0, 120, 80, 10)
    occ.addBox(20, 0, 10, 8, 80, 50)
    occ.addBox(60, 20, 10, 40, 40, 40)


def angled(folder, *edits):
    if COMM.rank == 0:
        write_step(folder / "a.step", angle)
        text = MESH + "".join(map(PART.format, ("flat", "upright", "block")))
        text += JOINT.format("edge", "joint_1") + JOINT.format("top", "joint_2")
        for old, new in edits:
            text = text.replace(old, new)
        (folder / "case.toml").write_text(text, encoding="utf-8")
    COMM.barrier()
    case = load_case(folder)
    tagged = build_mesh(case, COMM)
    tagged.mesh.geometry.x[:] = tagged.mesh.geometry.x @ TURN.T  # in no axis' direction
    return case, tagged


@pytest.mark.parallel
def test_a_dimension_is_offered_where_the_model_still_moves_freely(shared_tmp_path):
    """As many rigid modes as before by the eigensolver, which knows nothing of the count."""
    case, tagged = angled(shared_tmp_path)
    model = build_structure(case, COMM, width=True, tagged=tagged)
    ways = {r.name: (r.normal, r.across) for r in model.regions}
    x, y, z = TURN.T
    for name, expected in {"flat": (z, y), "upright": (x, z)}.items():
        for way, axis in zip(ways[name], expected, strict=True):
            assert abs(np.dot(way, axis)) == pytest.approx(1, abs=1e-9)
    dimensions, offered = Dimensions(case, model), {}
    for name in sorted(dimensions.names):
        reason = dimensions.reason([name])
        if "block" in name:
            assert "no plate or beam that is thin in one direction" in reason
            continue
        offered[name] = reason is None
        free = solve_modes(model, {name: 1.2}, n_modes=8).n_rigid == 6
        assert free == offered[name], (name, reason)
    assert offered == {
        "flat.thickness": True,
        "flat.width": False,
        "upright.thickness": False,
        "upright.width": True,
    }
    assert "edge" in dimensions.reason(["upright.thickness"])
    with pytest.raises(InputError, match=r"update.parameters: upright.thickness: joined \(edge\)"):
        refuse_unfit(case, model, ["flat.thickness", "upright.thickness", "flat.E"])


def test_a_given_normal_is_kept_and_a_long_one_said(tmp_path):
    way = TURN[:, 0].tolist()
    case, tagged = angled(tmp_path, ('cells = "flat"', f'cells = "flat"\nnormal = {way}'))
    model = build_structure(case, COMM, tagged=tagged)
    assert model.regions[0].normal == pytest.approx(way)
    (line,) = long_normals(case, model.tagged)
    assert "parts.flat.normal" in line and "would stretch its length" in line

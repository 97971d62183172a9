"""What holds the bodies of a preload model, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from contact_blocks import COMM, faces, pressed
from dolfinx import fem

from fenics_joints._compat import geometry_dofmap
from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import stacked_blocks
from fenics_joints.preload import (
    SLIP,
    STICK,
    Contact,
    PreloadModel,
    PreloadSolver,
    Traction,
    WasherForce,
    solve_preload,
)
from fenics_joints.structure import Support


def free_blocks(friction: float, loads, **mesh):
    x, z = np.linspace(0, 1, 3), np.linspace(0, 0.5, 3)
    tagged = stacked_blocks(COMM, **{"lower": (x, x, -z[::-1]), "upper": z} | mesh)
    bolts = [WasherForce("bolt", "bottom", "top", 1e5)]
    return pressed(tagged, loads, held=(), bolts=bolts, friction=friction)


@pytest.mark.parallel
def test_free_bodies():
    """Nothing holds a free structure: its pins carry no force, and its inertia a lone load."""
    push = [Traction("push", "top", (0.0, 0.0, -1e3))]
    solver = PreloadSolver(free_blocks(0.3, push))
    still, pushed = solver.solve({"push": 0.0}), solver.solve()
    assert solver.hold.n_whole == 6 and len(solver.hold.pins) == 6
    for result in (still, pushed):
        held = solver.model.jumps.gather(result.reactions, solver.hold.pins)
        assert np.abs(held).max() < 1e-9 * 1e5
    assert still.balance == 0 and pushed.balance > 1e-3
    # Half of the mass is below: half of the push goes through the interface.
    assert abs(pushed["c"].normal_force - (1e5 + 0.5e3)) < 1e-3
    with pytest.raises(InputError, match="nothing resists"):
        solve_preload(free_blocks(0.0, [Traction("push", "top", (1e3, 0.0, 0.0))]))


@pytest.mark.parametrize("directions", [(0,), (0, 1)])
def test_supported_interface(directions):
    """A support of one face of a contact holds, whichever face is called the lower one."""
    x, z = np.linspace(0, 0.1, 9), np.linspace(0, 0.03, 4)
    tagged = stacked_blocks(COMM, lower=(x, -z[::-1]), upper=z)
    held = [Support("bottom"), Support("interface_lower", directions)]
    loads = [
        Traction("down", "top", (0.0, -1e6), lambda x: 1 + x[:, 0] / 0.1),
        Traction("side", "top", (1.5e5, 0.0)),
    ]
    found = []
    for names in (("interface_lower", "interface_upper"), ("interface_upper", "interface_lower")):
        contacts = [Contact("c", *names, friction=0.2)]
        result = solve_preload(pressed(tagged, loads, held=held, degree=2, contacts=contacts))
        state = result["c"]
        assert abs(state.normal_force / 1e6 - 1) < 1e-8
        assert {SLIP, STICK} <= set(state.status.tolist())
        order = np.argsort(state.interface.points[:, 0])
        found.append(np.column_stack([state.force, 1e12 * state.slip])[order])
        u = result.displacement.x.array.reshape(-1, 2)
        V = result.model.V
        facets = tagged.facet_tags.find(tagged.facet_tag("interface_lower"))
        blocks = fem.locate_dofs_topological(V, 1, facets)
        assert np.abs(u[blocks][:, list(directions)]).max() < 1e-5 * np.abs(u).max()
    assert np.allclose(np.abs(found[0]), np.abs(found[1]), rtol=1e-4, atol=1.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"forces": {"nut": 1.0}}, "'nut' is neither a bolt nor a load.*bolt"),
        ({"forces": {"bolt": np.nan}}, "bolt = nan"),
        ({"method": "vi"}, "no friction, but c has"),
        ({"method": "penalty"}, "penalty"),
        ({"penalty": 1e12}, "penalty"),
    ],
)
def test_bad_input(options, message):
    """What is wrong is said: names, methods and values."""
    with pytest.raises(InputError, match=message):
        solve_preload(free_blocks(0.3, []), **options)


@pytest.mark.parallel
def test_bad_faces():
    """Faces that are not opposite, lie in a body or are one body are refused."""
    model = free_blocks(0.0, [])
    structure = model.structure
    with pytest.raises(MeshError, match="do not lie on one another"):
        PreloadModel(structure, [Contact("c", "interface_lower", "top")])
    with pytest.raises(MeshError, match="share vertices"):
        PreloadModel(structure, [Contact("c", "bottom", "left")])
    with pytest.raises(MeshError, match="no face named 'lid'"):
        PreloadModel(structure, [Contact("c", "lid", "top")])
    tagged = structure.tagged
    upper = tagged.cell_tags.find(tagged.cell_tag("upper"))
    points, nodes = tagged.mesh.geometry.x, np.unique(geometry_dofmap(tagged.mesh)[upper])
    points[nodes, 0] += 0.01 * np.sin(np.pi * points[nodes, 0])
    # Vertices that are near but not the same are averages, unless they are to be pairs.
    near, paired = (PreloadModel(structure, [faces(tolerance=t)]) for t in (None, 0.02))
    assert near.interfaces[0].coupling is not None and paired.interfaces[0].coupling is None
    assert len(paired.interfaces[0]) == 9

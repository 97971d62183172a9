"""What changes of a structure beside its properties, against meshes and matrices that have it."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from dolfinx import mesh
from eigen_slopes import difference
from mpi4py import MPI

from fenics_joints.diagnosis.zones.sites import ON, Sites, placed
from fenics_joints.errors import InputError
from fenics_joints.meshes import TaggedMesh
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.structure import Parameter, PointMass, Spring, Structure, part
from fenics_joints.structure.changes import LocalLoss, ShapeChange

SIZE, CELLS = (0.4, 0.06, 0.006), (10, 2, 1)
E, NU, RHO = 70e9, 0.33, 2700.0
CHANGED = {"loss.depth": 0.0, "loss.place": 0.0, "loss.size": 1.0, "bow": 0.0, "taper": 0.0}


def plate(moved=lambda x: x, regions=None, cells=None, **more):
    """A free plate, its vertices moved, in one part or in some by cell."""
    msh = mesh.create_box(
        MPI.COMM_SELF, [np.zeros(3), np.array(SIZE)], CELLS, mesh.CellType.hexahedron
    )
    middles = mesh.compute_midpoints(msh, 3, np.arange(np.prod(CELLS), dtype=np.int32))
    number = np.zeros(len(middles), dtype=np.int32) if cells is None else cells(middles)
    tags = mesh.meshtags(msh, 3, np.arange(len(middles), dtype=np.int32), number)
    msh.geometry.x[:] = moved(msh.geometry.x.copy())
    names = {f"c{i}": i for i in np.unique(number).tolist()}
    tagged = TaggedMesh(msh, tags, None, names, {})
    regions = regions or [part("plate", ("c0",), E="E", nu=NU, rho="rho")]
    own = [Parameter("E", E), Parameter("rho", RHO)]
    return Structure(tagged, regions, own, **more), middles


@pytest.fixture(scope="module")
def changing():
    """The plate with all kinds of changes."""
    model, middles = plate()
    stations = [np.flatnonzero(np.abs(middles[:, 0] - x) < 0.02) for x in (0.1, 0.14, 0.18)]
    scaled = {"E": "E", "nominal": E}
    own = {key: f"loss.{key}" for key in ("depth", "place", "size")} | {"first": 0, "count": 3}
    loss = LocalLoss("loss", "plate", stations, scaled | own)
    ones, L, t = np.ones(len(middles)), SIZE[0], SIZE[2]
    up, along, scaled = (0, 0, 1), (1, 0, 0), scaled | {"nominal_rho": RHO}
    line, own = (0.0, 4 / L, -4 / L**2), {"rho": RHO, "amount": "bow", "count": 2}
    moved = np.array([ones, 0 * ones])
    bow = ShapeChange("bow", "plate", up, along, line, moved, 0.01, scaled | own)
    line, own = (-1.0, 2 / L, 0.0), {"rho": "rho", "amount": "taper", "count": 6}
    moved = np.array([-t / 2 * ones, ones])
    taper = ShapeChange("taper", "plate", up, along, line, moved, 0.2, scaled | own)
    more = [Parameter(k, v, log=False) for k, v in CHANGED.items()]
    return model.with_changes([loss, bow, taper], more)


def elastic(model, given=None, n=6):
    modes = solve_modes(model, given, n_modes=n + 6)
    return modes.frequencies_hz[modes.n_rigid :][:n]


def check_slopes(model, given, names, rel, mode=8):
    """Derivatives of an eigenvalue are those of central differences."""
    modes = solve_modes(model, given, n_modes=10)
    slope = modes.gradients([mode])[0]
    for name in names:
        found = slope[list(model.parameters).index(name)]
        expected = difference(model, given, name, mode, 1e-3, n_modes=10)
        assert found == pytest.approx(expected, rel=rel), name


def bowed(x):
    x[:, 2] += 0.004 * (4 * x[:, 0] / SIZE[0] - 4 * (x[:, 0] / SIZE[0]) ** 2)
    return x


def tapered(x):
    x[:, 2] += 0.2 * (2 * x[:, 0] / SIZE[0] - 1) * (x[:, 2] - SIZE[2] / 2)
    return x


def softened(given):
    number = lambda m: np.where(np.abs(m[:, 0] - 0.14) < 0.02, 1, 0).astype(np.int32)  # noqa: E731
    regions = [part(f"p{i}", (f"c{i}",), E=e * E, nu=NU, rho=RHO) for i, e in enumerate(given)]
    return plate(cells=number, regions=regions)[0]


def weighed(point, kg, k):
    springs = [Spring(f"s{i}", k, point, tuple(row)) for i, row in enumerate(np.eye(3))]
    return plate(masses=[PointMass("m", kg, point)], springs=springs)[0]


#: That of sums of matrices against integrals, in the lowest mode of thin cells.
ROUND_OFF = 1e-7
CASES = {
    "loss": ({"loss.depth": 0.6, "loss.place": 1.0}, lambda: softened((1.0, 0.4)), ROUND_OFF),
    # Hexahedra with straight edges on a parabola, against its tangents.
    "bow": ({"bow": 0.004}, lambda: plate(bowed)[0], 2e-4),
    "taper": ({"taper": 0.2}, lambda: plate(tapered)[0], 1e-6),
}


@pytest.mark.parametrize("name", CASES)
def test_a_change_is_that_of_a_mesh_or_of_cells_that_have_it(changing, name):
    given, real, limit = CASES[name]
    expected, found, before = elastic(real()), elastic(changing, given), elastic(changing)
    assert np.max(np.abs(expected / before - 1)) > 20 * limit
    assert found == pytest.approx(expected, rel=limit)


def test_the_reduced_model_has_them_too(changing):
    """On the modes of all samples, with slopes that are those of differences."""
    samples = [{}, *(given for given, _, _ in CASES.values())]
    small = reduce(changing, samples, 14, tolerance=1e-10).arrays()
    for given in samples:
        assert elastic(small, given) == pytest.approx(elastic(changing, given), rel=1e-5)
    # Changes of the shape are not put in with others: they know nothing of each other.
    both = {"loss.depth": 0.3, "loss.place": 0.6, "loss.size": 1.2}
    for model, given in product((small, changing), (both, {"taper": 0.1}, {"bow": 0.002})):
        check_slopes(model, given, given, 2e-3)


def test_what_is_attached_acts_near_its_point_in_reduced_models_alone():
    """As a mass and springs there do; with slopes that are those of differences."""
    model, _ = plate()
    sites = Sites(
        np.array([[0.2, 0.03, 0.0], [0.36, 0.03, 0.0]]),
        np.zeros((0, 3)),
        vertices=model.mesh.geometry.x,
        idle=1e-6,
    )
    changes = [change for change in placed(sites) if change.name.startswith(ON)]
    own = {name for c in changes for name in c.properties.values() if isinstance(name, str)}
    changing = model.with_changes(changes, [Parameter(name, 0.0, log=False) for name in own])
    small = reduce(changing, [{}], 40).arrays()
    before = elastic(small)
    here = {"place": 0.0, "mass": 0.02, "x": 0.006, "y": -0.003}
    springs = {"place": 1.0, **dict.fromkeys(("stiffness_x", "stiffness_y", "stiffness_z"), 2e3)}
    for given, point in ((here, (0.206, 0.027, 0.0)), (springs, (0.36, 0.03, 0.0))):
        real = elastic(weighed(point, given.get("mass", 0.0), given.get("stiffness_z", 0.0)))
        given = {f"{ON}.{key}": value for key, value in given.items()}
        found, shift = elastic(small, given), np.abs(real - before)
        assert found == pytest.approx(real, abs=0.06 * shift.max())
    given = {f"{ON}.{key}": value for key, value in here.items()}
    check_slopes(small, given, [f"{ON}.{key}" for key in ("mass", "x", "y")], 1e-4)
    with pytest.raises(InputError, match="expected a reduced model"):
        changing.mass(given)

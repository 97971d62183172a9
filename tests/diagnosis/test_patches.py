"""Patches of cells: the partition, their sensitivities, their tests, and the picture."""

from __future__ import annotations

import importlib.util
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.where.cells import MeshCells
from fenics_joints.diagnosis.where.patches import Patches, PatchMap, patches, signatures
from fenics_joints.diagnosis.where.score_tests import Place, ScoreTest, score_tests
from fenics_joints.errors import InputError
from fenics_joints.measurements import pair_modes
from fenics_joints.meshes import lap_plates
from fenics_joints.modal import frequency_sensitivity, solve_modes
from fenics_joints.report import patch_map
from fenics_joints.structure import Parameter, PointMass, Structure, joint, part

pytestmark = pytest.mark.parallel

E, NU, RHO = 70e9, 0.3, 2700.0
LAYER = 0.5e-3
MODES = 9

#: Where the joint gives way.
GIVEN_WAY = {"kE": 5e8, "kG": 5e8}


def lap(comm, softened: float = 1.0) -> Structure:
    """Lap plates whose plate 1 has its modulus times ``softened`` where x < 60 mm.

    A mass on the other end tells the ends apart: of symmetric plates frequencies could not.
    """
    tagged = lap_plates(comm, element_size=0.02, n_thickness=1, layer=LAYER)

    def modulus(x, p):
        import ufl

        return p["E"] * ufl.conditional(ufl.lt(x[0], 0.06), softened, 1.0)

    plates = part("plates", ("plate_1", "plate_2"), E=modulus, nu=NU, rho="rho")
    layer = joint("joint", ("joint_near", "joint_away"), E="kE", G="kG")
    parameters = [
        Parameter("E", E),
        Parameter("rho", RHO),
        Parameter("kE", 90e9),
        Parameter("kG", 25e9),
    ]
    mass = PointMass("mass", 0.2, (0.31, 0.04, 0.0165))
    return Structure(tagged, [plates, layer], parameters, masses=[mass])


@pytest.fixture(scope="module")
def nominal():
    structure = lap(MPI.COMM_WORLD)
    modes = solve_modes(structure, n_modes=6 + MODES)
    return structure, modes, pair_modes(modes, MODES)


def test_patches_cover_the_structure_compactly_on_any_number_of_ranks(nominal):
    """The same volumes and middles as in serial; plates that face each other share no patch."""
    structure = nominal[0]
    cells = MeshCells(structure)
    split, alone = patches(cells, 10), patches(MeshCells(lap(MPI.COMM_SELF)), 10)
    assert split.names == alone.names
    assert split.volume == pytest.approx(alone.volume, rel=1e-12)
    assert split.middle == pytest.approx(alone.middle, abs=1e-12)
    assert split.volume.sum() == pytest.approx(structure.volumes().sum(), rel=1e-12)
    ones = cells.sums(split.number, structure.cell_volumes(), len(split))
    assert ones == pytest.approx(split.volume, rel=1e-12)
    assert [split.region.count(name) for name in ("plates", "joint")] == [10, 10]
    heights = split.middle[np.array(split.region) == "plates", 2]
    assert np.all((heights < 0.009) | (heights > 0.0085 + LAYER / 2))
    # No cell is nearer to another patch of its group than it would be to its own by much.
    assert split.volume[:10].max() < 4 * split.volume[:10].min()


@pytest.fixture(scope="module")
def soft(nominal):
    """The same with a joint that gives way."""
    modes = solve_modes(nominal[0], GIVEN_WAY, n_modes=6 + MODES)
    return modes, pair_modes(modes, MODES)


def columns_of(cells, modes, pairing, split: Patches, soft) -> np.ndarray:
    """Change of ln f by the expected change in each patch, (P, m, 2)."""
    test = SimpleNamespace(shapes=None)
    return signatures(cells, modes, pairing, test, split, None, soft).log_f.swapaxes(0, 1)


def map_of(cells, modes, pairing, evidence, residual, nuisance, n, soft) -> PatchMap:
    """The map by frequencies alone."""
    split = patches(cells, n)
    columns = columns_of(cells, modes, pairing, split, soft)
    places = [
        Place(name, region, "joint" if region == "joint" else "part", own)
        for name, region, own in zip(split.names, split.region, columns, strict=True)
    ]
    tests = score_tests(residual, places, nuisance, evidence)
    drawn = cells.gather(cells.corners, split.number) or (None, None)
    return PatchMap(tuple(tests), split.middle, split.volume, cells.bolts, 0.05, *drawn)


def test_patches_sensitivities_add_up_to_the_parameters(nominal, soft):
    """All patches of a region softened together are its parameter: the sum of adjoints is the
    derivative of ln f by ln E and ln rho; a joint's, where it gives way, is what a hundredth more
    of compliance does, solved again."""
    structure, modes, pairing = nominal
    cells = MeshCells(structure)
    split = patches(cells, 6)
    columns = columns_of(cells, modes, pairing, split, soft)
    slope = frequency_sensitivity(modes, pairing.index)
    names = list(structure.parameters)
    own = np.array(split.region) == "plates"
    total = columns[own].sum(axis=0)
    assert total[:, 0] == pytest.approx(0.15 * E * slope[:, names.index("E")], rel=1e-8)
    assert total[:, 1] == pytest.approx(0.10 * RHO * slope[:, names.index("rho")], rel=1e-8)
    more = solve_modes(structure, {k: v / 1.01 for k, v in GIVEN_WAY.items()}, n_modes=6 + MODES)
    change = np.log(more.frequencies_hz[6:] / soft[0].frequencies_hz[6:]) / np.log(1.01)
    assert columns[~own].sum(axis=0)[:, 0] == pytest.approx(change, rel=0.02, abs=1e-7)


def test_the_softened_end_is_found(nominal, soft):
    """Ten per cent off the modulus of one end of a plate: its patches explain the misfit, more
    than chance; without a gap no patch is significant. The picture says the same in words."""
    structure, modes, pairing = nominal
    true = solve_modes(lap(MPI.COMM_WORLD, 0.9), n_modes=6 + MODES)
    log_f = np.log(true.frequencies_hz[6:])[None]
    evidence = Evidence(np.array([1.0]), log_f, np.full(log_f.shape, 2e-4), 3e-4)
    residual = log_f[0] - np.log(modes.frequencies_hz[6:])
    stiffness = frequency_sensitivity(modes, pairing.index) * [E, RHO, 0, 0]
    cells = MeshCells(structure)
    found = map_of(cells, modes, pairing, evidence, residual, 0.01 * stiffness[:, :2], 10, soft)
    best = int(np.argmax(found.share))
    assert found.significant[best] and found.share[best] > 0.9
    assert found.region[best] == "plates" and found.middle[best][0] < 0.06
    assert found.tests[best].change[0] < 0 < found.signed_share[best]
    quiet = map_of(cells, modes, pairing, evidence, 0 * residual + 1e-5, None, 12, soft)
    assert not quiet.significant.any()
    assert found.to_json()["patches"][best]["zone"] == found.tests[best].zone
    if MPI.COMM_WORLD.rank == 0:
        svg = patch_map(found)
        assert svg.startswith("<svg") and f"Largest: {found.tests[best].zone}" in svg
        assert "explains more than chance" in svg
    else:
        with pytest.raises(InputError, match="rank 0"):
            patch_map(found)


class Grid:
    """What is asked of pyvista's grid."""

    def __init__(self, cells, kinds, points):
        self.n_cells, self.points, self.cell_data = len(kinds), points, {}


def test_patches_go_to_pyvista_cell_by_cell(monkeypatch):
    """To the library itself where it is installed."""
    if importlib.util.find_spec("pyvista") is None:
        monkeypatch.setitem(sys.modules, "pyvista", SimpleNamespace(UnstructuredGrid=Grid))
    corner = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
    vertices = np.stack([corner + [i, 0, 0] for i in range(3)])
    tests = [
        ScoreTest("", name, "part", 1.0, dof, 0.0, p, p, share, 0.5, 0.0, (), (), log_f)
        for name, dof, p, share, log_f in (
            ("a", 2, 0.5, 0.1, 0.01),
            ("b", 2, 1e-9, 0.8, -0.01),
            ("c", 0, 1.0, 0.0, 0.0),
        )
    ]
    found = PatchMap(
        tuple(tests),
        np.zeros((3, 3)),
        np.ones(3),
        np.zeros((0, 3)),
        vertices=vertices,
        patch=np.array([1, 0, 2]),
    )
    grid = found.to_pyvista()
    assert grid.n_cells == 3 and len(grid.points) == 16 and np.ptp(grid.points[:, 0]) == 3
    shown = {name: np.asarray(values).tolist() for name, values in grid.cell_data.items()}
    assert shown["patch"] == [1, 0, 2] and shown["share"] == [0.8, 0.1, 0.0]
    assert shown["signed_share"] == [0.8, -0.1, 0.0] and found.region == ("a", "b", "c")
    assert shown["significant"] == shown["sufficient"] == [True, False, False]
    assert shown["seen"] == [True, True, False]
    with pytest.raises(InputError, match="rank 0"):
        PatchMap((), np.zeros((0, 3)), np.ones(0), np.zeros((0, 3))).to_pyvista()

"""What a case will cost is known before anything is built."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dolfinx")

import step_files
from gmsh_files import gmsh_file
from mpi4py import MPI

from fenics_joints.case import build_preload, build_structure, check_size, estimate, load_case, size
from fenics_joints.case.size import available_bytes, estimate_refused
from fenics_joints.errors import InputError
from fenics_joints.meshes.grid import count_intervals, grid_lines
from fenics_joints.meshes.step_writer import write_step

DEMOS = Path(__file__).parents[2] / "demos"
BODY = '[parts.body]\ncells = "body"\nE = "70 GPa"\nnu = 0.3\nrho = 2700\n'


def changed(case, **mesh):
    return case.model_copy(update={"mesh": case.mesh.model_copy(update=mesh)})


def dofs(case) -> int:
    """The degrees of freedom that the case's model has when it is built."""
    if case.contacts:
        return build_preload(case, MPI.COMM_SELF).structure.n_dofs
    return build_structure(case, MPI.COMM_SELF).n_dofs


@pytest.mark.parametrize(
    ("demo", "mesh"),
    [
        ("lap_plates", {"n_thickness": 3}),
        ("lap_plates", {"degree": 1, "cell": "tetrahedron", "element_size": 4e-3}),
        ("c_beam", {"element_size": 3e-3, "radial_size": 2e-3}),
        ("lap_beam/virtual.toml", {"n_length": 30}),
        ("dumbbell", {}),
        ("engraving_machine", {"element_size": 0.1}),
    ],
)
def test_degrees_of_freedom(demo, mesh):
    """Within a third of those of the mesh when it is there."""
    case = changed(load_case(DEMOS / demo), **mesh)
    assert estimate(case).dofs == pytest.approx(dofs(case), rel=0.33)


def test_files_are_counted_by_their_heads(tmp_path):
    pytest.importorskip("gmsh")
    found = []
    for version, binary in ((4.1, 0), (4.1, 1), (2.2, 0), (2.2, 1)):
        options = {"MeshSizeMax": 0.02, "MshFileVersion": version, "Binary": binary}
        with gmsh_file(tmp_path / "a.msh", **options) as gmsh:
            gmsh.model.occ.addBox(0, 0, 0, 0.1, 0.1, 0.1)
            gmsh.model.occ.synchronize()
            gmsh.model.addPhysicalGroup(3, [1], 1, "body")
            gmsh.model.mesh.generate(3)
        (tmp_path / "case.toml").write_text('[mesh]\nfile = "a.msh"\n' + BODY)
        case = load_case(tmp_path)
        found.append(estimate(case).dofs)
    assert len(set(found)) == 1 and found[0] == pytest.approx(dofs(case), rel=0.33)


def test_step_files_by_the_size_of_elements():
    """Half the size, eight times as many; at 15 mm the count is that of the mesh to a factor."""
    case = load_case(DEMOS / "cad_bracket")
    counts = [estimate(changed(case, size=h)).dofs for h in (2e-3, 1e-3, 1e-12)]
    assert counts[1] / counts[0] == pytest.approx(8, rel=0.1) and counts[2] > 1e20


def test_intervals_are_those_of_the_grid():
    edges, rng = [0.0, 0.3, 0.3 + 1e-13, 1.0], np.random.default_rng(1)
    for step in rng.uniform(1e-3, 0.5, 20):
        assert count_intervals(edges, step) == len(grid_lines(edges, step)) - 1
    assert count_intervals(edges, 0.05, (0.3, 1.0)) == 14
    assert count_intervals(edges, 5e-324) == np.inf


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('element_size = "20 mm"\nn_thickness = 1', "n_length = 1000000000\nn_thickness = 1"),
        ("n_thickness = 1", "n_thickness = 3000"),
        ('element_size = "20 mm"', 'element_size = "1e-9 m"'),
    ],
)
def test_too_large_a_model_is_refused_at_once(tmp_path, write_case, monkeypatch, old, new):
    """10^9 elements took 5 GB and more; 4.9 million degrees of freedom were solved unwarned."""
    monkeypatch.setattr(size, "available_bytes", lambda: 16 * 2.0**30)
    start = time.perf_counter()
    case = load_case(write_case(tmp_path, (old, new)))
    with pytest.raises(InputError, match=r"about .* of memory .* 16 GiB .*--large"):
        check_size(case)
    assert time.perf_counter() - start < 5.0
    assert check_size(case, large=True).bytes > 16 * 2**30


STEP = {"max": "3000000000", "current": "1500000000", "stat": "anon 5\ninactive_file 500000000\n"}
SLURM = {"limit_in_bytes": "5000", "usage_in_bytes": "6000"}


@pytest.mark.parametrize(
    ("group", "files", "expected"),
    [
        ("", {}, 8e9),
        ("0::/job/step\n", {f"job/step/memory.{k}": v for k, v in STEP.items()}, 2e9),
        ("0::/../../other\n", {"memory.max": "4000000000", "memory.current": "1000000000"}, 3e9),
        ("3:cpu,memory:/s\n", {f"memory/s/memory.{k}": v for k, v in SLURM.items()}, 0.0),
    ],
)
def test_memory_is_the_least_of_all_limits(tmp_path, group, files, expected):
    """Containers and batch systems give less than the machine has."""
    if files:
        files = {"sys/fs/cgroup/job/memory.max": "max", "proc/self/cgroup": group} | {
            f"sys/fs/cgroup/{name}": text for name, text in files.items()
        }
    files = {"proc/meminfo": "MemTotal: 16000000 kB\nMemAvailable:    7812500 kB\n"} | files
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert available_bytes(tmp_path) == expected
    assert 0 < available_bytes() < 1e15


#: Drawings, and a size of the cells in mm.
DRAWN = {
    "plates": (lambda occ: step_files.joined(occ, [(30, 20), (70, 20)]), 10),
    "flanges": (step_files.flanges(), 12),
    "bracket": (step_files.bracket, 8),
    "spigot": (step_files.spigot, 15),
    "dumbbell": (step_files.dumbbell_halves, 20),
}


@pytest.mark.parametrize("name", DRAWN)
def test_drawings_are_estimated_by_their_surfaces(tmp_path, name):
    """Within a factor of two, also where their solids cannot be joined."""
    draw, millimetres = DRAWN[name]
    write_step(tmp_path / "a.step", draw)
    parts = BODY.replace('"body"', '["solid_1", "solid_2"]') + '[joints.j]\ncells = "joint*"\n'
    mesh = f'[mesh]\nfile = "a.step"\nsize = "{millimetres} mm"\ncircle = 8\njoint = "layer"\n'
    solids = "[mesh.parts]\nsolid_1 = 1\nsolid_2 = 2\n"
    law = 'law = "springs"\nk_n = "1e12 Pa/m"\nk_t = "1e12 Pa/m"\n'
    (tmp_path / "case.toml").write_text(mesh + solids + parts + law, encoding="utf-8")
    case = load_case(tmp_path)
    assert 0.5 < estimate_refused(case).dofs / dofs(case) < 2

"""Virtual tests of a plate of one part, with a cause that its nominal model lacks.

The data come from finer meshes that contain the cause, not from the code of the effects.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.linalg
from block_file import write_block
from case_tables import write_frequencies, write_table
from dolfinx import mesh
from mpi4py import MPI
from virtual_plates import noisy, noisy_shapes

from fenics_joints.meshes import TaggedMesh
from fenics_joints.modal import solve_modes
from fenics_joints.structure import ElasticSupport, PointMass, Sensors, Spring, Structure, part
from fenics_joints.structure.sparse import MatrixForm

SIZE = (0.4, 0.06, 0.006)
E, NU, RHO = 70e9, 0.33, 2700.0
MODES, NOISE, SHAPE_NOISE = 8, 0.0005, 0.01
#: Two lines of sensors along the plate.
PLACES = [(x, y, 0.0) for x in (0.0, 0.08, 0.16, 0.24, 0.32, 0.4) for y in (0.0, 0.06)]
ALL_WAYS = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
SENSORS = Sensors(np.array(PLACES), [0.0, 0.0, 1.0])

_CASE = """
title = "A strip"

[mesh]
file = "strip.msh"
scale = "1 mm"
degree = 2

[parts.strip]
cells = ["block"]
E = "70 GPa"
nu = 0.33
rho = "2700 kg/m3"

HELD
[test]
frequencies = "frequencies.csv"
shapes = "shapes.csv"
noise = "0.05 %"
shape_noise = "1 %"
DAMPED

[test.sees]
points = POINTS
direction = [0, 0, 1]

[diagnose]
n_modes = 18
samples = 6
patches = 0
max_effects = 1
discrepancy = "0.5 %"
shape_discrepancy = "2 %"
mesh_error = false
"""


def strip(moved=None, soft=None, thick=SIZE[2], **more) -> Structure:
    """The plate, finer than the diagnosed one, free.

    Args:
        thick: Its thickness, m.
        moved: Moves vertices, m, (n, 3).
        soft: Two x, m, between which the stiffness is reduced, and the remaining share.
        more: Further arguments of `Structure`.
    """
    cells = (20, 4, 1)
    msh = mesh.create_box(
        MPI.COMM_SELF, [np.zeros(3), np.array([*SIZE[:2], thick])], cells, mesh.CellType.hexahedron
    )
    every = np.arange(np.prod(cells), dtype=np.int32)
    x = mesh.compute_midpoints(msh, 3, every)[:, 0]
    low, high, left = soft or (0.0, 0.0, 1.0)
    number = ((x > low) & (x < high)).astype(np.int32)
    if moved is not None:
        msh.geometry.x[:] = moved(msh.geometry.x.copy())
    names = {f"c{i}": i for i in np.unique(number).tolist()}
    tagged = TaggedMesh(msh, mesh.meshtags(msh, 3, every, number), None, names, {})
    regions = [part(n, (n,), E=(E, left * E)[i], nu=NU, rho=RHO) for n, i in names.items()]
    return Structure(tagged, regions, **more)


def measured(model: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and shapes of the modes that the sensors see."""
    modes = solve_modes(model, n_modes=MODES + 10)
    shapes = modes.at(SENSORS)
    seen = modes.visibility(SENSORS) > 0.3
    seen[: modes.n_rigid] = False
    index = np.flatnonzero(seen)[:MODES]
    return modes.frequencies_hz[index], shapes[:, index]


def held_by(kg: float, k: float, point, ways=ALL_WAYS) -> tuple[np.ndarray, np.ndarray]:
    """The plate with a mass, and springs to the ground, by default in all directions."""
    springs = [Spring(f"s{i}", k, point, tuple(way)) for i, way in enumerate(ways)]
    hz, shapes = measured(strip(masses=[PointMass("m", kg, point)], springs=springs))
    # A plate on a spring bounces on it, which the test knows from bending.
    elastic = np.array([np.ptp(s) > 0 for s in shapes.T]) & (hz > 150.0)
    return hz[elastic], shapes[:, elastic]


def with_resonator(
    kg: float, hz: float, point, count: int = 60, own_share: float = 0.3, plate=None
) -> tuple[np.ndarray, np.ndarray]:
    """The plate with a mass on springs in three directions: three more degrees of freedom beside
    ``count`` modes of the plate. The test leaves out modes in which the mass has more than
    ``own_share`` of the kinetic energy."""
    modes = solve_modes(plate or strip(), n_modes=count)
    at = modes.at(Sensors(np.repeat([point], 3, axis=0), np.eye(3)))
    k = kg * (2 * np.pi * hz) ** 2
    joined = np.hstack([at, -np.eye(3)])
    K = np.diag(np.r_[(2 * np.pi * modes.frequencies_hz) ** 2, np.zeros(3)]) + k * joined.T @ joined
    M = np.diag(np.r_[np.ones(count), np.full(3, kg)])
    values, vectors = scipy.linalg.eigh(K, M)
    own = kg * np.sum(vectors[count:] ** 2, axis=0)
    shapes = modes.at(SENSORS) @ vectors[:count]
    found = np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)
    size = np.sqrt(np.mean(shapes**2, axis=0)) / np.sqrt(1 / 0.39)
    size /= np.sqrt(1 - np.minimum(own, 1 - 1e-9))
    index = np.flatnonzero((found > 150.0) & (own < own_share) & (size > 0.3))[:MODES]
    return found[index], shapes[:, index]


def on_springs(k: float, eta: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The plate on an elastic end, Pa/m in both directions, with a loss factor: also its damping
    ratios, 0.1 % of them the plate's own, from complex modes on a basis of 40 real ones."""
    msh = strip().mesh
    faces = mesh.locate_entities_boundary(msh, 2, lambda x: np.isclose(x[0], 0.0))
    tags = mesh.meshtags(msh, 2, np.sort(faces), np.ones(len(faces), dtype=np.int32))
    every = np.arange(msh.topology.index_map(3).size_local, dtype=np.int32)
    cells = mesh.meshtags(msh, 3, every, np.zeros(len(every), dtype=np.int32))
    tagged = TaggedMesh(msh, cells, tags, {"c0": 0}, {"left": 1})
    model = Structure(
        tagged,
        [part("c0", ("c0",), E=E, nu=NU, rho=RHO)],
        supports=[ElasticSupport("end", "left", k, k)],
    )
    modes = solve_modes(model, n_modes=40)
    X = np.column_stack([x.array_r for x in modes.shapes])
    lossy = X.T @ (MatrixForm(model.region_stiffness("end"), True) @ X)
    K = np.diag((2 * np.pi * modes.frequencies_hz) ** 2)
    values, vectors = np.linalg.eig(K + 1j * eta * lossy)
    order = np.argsort(values.real)
    values, vectors = values[order], vectors[:, order].real
    shapes = modes.at(SENSORS) @ vectors
    index = np.flatnonzero(modes.visibility(SENSORS) > 0.3)[:MODES]
    ratios = 0.001 + 0.5 * values.imag / values.real
    return np.sqrt(values.real[index]) / (2 * np.pi), shapes[:, index], ratios[index]


def write_strip(
    folder: Path,
    hz,
    shapes,
    *lines: str,
    seed: int = 3,
    thick=SIZE[2],
    ratios=None,
    cells=(16, 3, 1),
) -> Path:
    """Put the nominal case and these data, with noise, into a folder, and return it; with damping
    ratios it is clamped."""
    write_block(folder / "strip.msh", [1e3 * L for L in (*SIZE[:2], thick)], cells)
    rng = np.random.default_rng(seed)
    names = write_frequencies(folder, noisy(hz, NOISE, rng))
    size = np.sqrt(np.mean(shapes**2, axis=0))
    write_table(folder / "shapes.csv", names, noisy_shapes(shapes, SHAPE_NOISE, rng) / size)
    points = str([[float(c) for c in p] for p in PLACES])
    held = "" if ratios is None else '[supports.end]\nfacets = "left"\n'
    damped = "" if ratios is None else 'damping = "damping.csv"\ndamping_noise = "10 %"\n'
    if ratios is not None:
        write_table(folder / "damping.csv", names, noisy(ratios, 0.1, rng)[None])
    text = _CASE.replace("HELD", held).replace("DAMPED", damped)
    text = text.replace("POINTS", points) + "".join(f"{line}\n" for line in lines)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder

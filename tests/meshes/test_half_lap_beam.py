"""The half-lap beam: its meshes by their measures, and its limits against whole beams."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("dolfinx")

import ufl
from matching_faces import assert_pair, faces, parts, polygon
from mpi4py import MPI
from scipy.optimize import brentq

from fenics_joints.meshes import HalfLapBeam, check_mesh, half_lap_beam, half_lap_beam_section
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Structure, joint, part

COMM = MPI.COMM_WORLD
L, W, H, LAP, GAP, WASHER, HOLE = 0.6, 0.03, 0.012, 0.16, 1e-3, 0.016, 0.008
SMALL = {"length": L, "thickness": H, "lap": LAP, "gap": GAP, "washer": WASHER}
SMALL |= {"n_length": 3, "n_lap": 6}
SOLID = SMALL | {"width": W, "n_width": 2}
LAYERS = [(0.0, False), (0.0, True), (2e-4, False)]


def assert_measures(tagged, n, width, washer, hole, layer, bonded):
    """By hand: a face inside of a body has no exterior."""
    lap = LAP * width - n * hole
    tongue = lap * (H - layer) / 2 + GAP * width * (H - layer) / 2
    beam = ((L - LAP) / 2 - GAP) * width * H + tongue
    expected = {"beam_1": beam, "beam_2": beam} | ({"joint": lap * layer} if layer else {})
    assert parts(tagged) == pytest.approx(expected)
    found = faces(tagged)
    assert [found["end_1"], found["end_2"]] == pytest.approx([width * H] * 2)
    numbers = range(1, n + 1)
    sides = [f"washer_{i}_{side}" for i in numbers for side in ("lower", "upper")]
    assert [found[side] for side in sides] == pytest.approx([washer - hole] * len(sides))
    inside = ("joint_lower", "joint_upper") if layer else ("interface",)
    if layer or bonded:
        assert [found[name] for name in inside] == pytest.approx([0.0] * len(inside), abs=1e-15)
    else:
        names = "interface_lower", "interface_upper"
        assert [found[name] for name in names] == pytest.approx([lap] * 2)
        assert_pair(tagged, "interface_lower", "interface_upper", ("beam_1", "beam_2"))
    height = tagged.mesh.geometry.dim - 1
    middles = faces(tagged, lambda mesh: ufl.SpatialCoordinate(mesh)[0])
    heights = faces(tagged, lambda mesh: ufl.SpatialCoordinate(mesh)[height])
    area = washer - hole
    assert heights["washer_1_lower"] == pytest.approx(-area * H / 2)
    assert heights[f"washer_{n}_upper"] == pytest.approx(area * H / 2)
    assert middles[f"washer_{n}_upper"] / area == pytest.approx(tagged.points["bolts"][n - 1, 0])
    assert tagged.points["bolts"][:, 0] == pytest.approx(0.22 + 0.16 * np.array(numbers) / (n + 1))
    assert check_mesh(tagged).bodies == (1 if layer or bonded else 2)


@pytest.mark.parallel
@pytest.mark.parametrize(("n", "hole", "cell"), [(4, 0.0, "hexahedron"), (3, HOLE, "tetrahedron")])
@pytest.mark.parametrize(("layer", "bonded"), LAYERS)
def test_measures(layer, bonded, cell, n, hole):
    tagged = half_lap_beam(COMM, layer=layer, bonded=bonded, cell=cell, bolts=n, hole=hole, **SOLID)
    washer = polygon(WASHER) if hole else WASHER**2
    assert_measures(tagged, n, W, washer, polygon(hole), layer, bonded)
    if hole:
        wall = n * 16 * hole * np.sin(np.pi / 16) * H
        # That of a layer is on the outside too.
        assert faces(tagged)["holes"] == pytest.approx(wall)


@pytest.mark.parametrize("hole", [0.0, HOLE])
def test_cells_are_counted_before_they_are_made(hole):
    """Without holes exactly; the gaps' cells are taken for as high as the beam."""
    builder = HalfLapBeam(layer=2e-4, bolts=3, hole=hole, n_thickness=2, **SOLID)
    counted = sum(np.prod(brick) for brick in builder.bricks())
    gaps = 2 * 2 * builder.bricks()[0][1]
    assert len(builder.lists().cells) == pytest.approx(counted - gaps, rel=0.3 if hole else 1e-12)


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
@pytest.mark.parametrize(("layer", "bonded"), LAYERS[1:])
def test_measures_of_the_section(layer, bonded, cell):
    tagged = half_lap_beam_section(COMM, layer=layer, bonded=bonded, cell=cell, bolts=3, **SMALL)
    assert_measures(tagged, 3, 1.0, WASHER, 0.0, layer, bonded)


# -- bending of beams by hand ----------------------------------------------------------------------

E, RHO, THIN = 194e9, 7730.0, 3e-3
FUNCTIONS = (
    lambda n, x: [np.cos(x), -np.sin(x), -np.cos(x), np.sin(x)][n],
    lambda n, x: [np.sin(x), np.cos(x), -np.sin(x), -np.cos(x)][n],
    lambda n, x: [np.cosh(x), np.sinh(x)][n % 2],
    lambda n, x: [np.sinh(x), np.cosh(x)][n % 2],
)


def stepped_beam(share: float) -> float:
    """First bending frequency, Hz, of a free beam of Euler's, softer over the lap in its middle.

    Of its right half: w' = w''' = 0 in the middle, w'' = w''' = 0 at the end, and at the end of the
    lap deflection, slope, moment and force are the same on both sides.

    Args:
        share: Bending stiffness in the lap over that of the beam.
    """
    inertia = THIN**3 / 12
    cos, sin, cosh, sinh = FUNCTIONS
    middle = cos, cosh
    end = (lambda n, x: cos(n, x) + cosh(n, x)), (lambda n, x: sin(n, x) + sinh(n, x))

    def determinant(hertz: float) -> float:
        line = RHO * THIN * (2 * np.pi * hertz) ** 2 / E
        inside, outside = ((line / i) ** 0.25 for i in (share * inertia, inertia))
        rows = np.empty((4, 4))
        for n in range(4):
            stiff = share if n > 1 else 1.0
            rows[n, :2] = [stiff * inside**n * f(n, inside * LAP / 2) for f in middle]
            rows[n, 2:] = [-((-outside) ** n) * f(n, outside * (L - LAP) / 2) for f in end]
        return np.linalg.det(rows / np.linalg.norm(rows, axis=1)[:, None])

    whole = 3.5608 / L**2 * np.sqrt(E * inertia / (RHO * THIN))
    return brentq(determinant, 0.3 * whole, 1.05 * whole)


@pytest.mark.parallel
@pytest.mark.parametrize("bonded", [True, False])
def test_bends_as_a_whole_beam_or_one_of_half_heights(bonded):
    """A layer that does not shear leaves two beams of half the height, a quarter as stiff."""
    layer = 0.0 if bonded else 1e-5
    thin = {"length": L, "thickness": THIN, "lap": LAP, "gap": 1e-5, "washer": 0.0, "n_lap": 24}
    tagged = half_lap_beam_section(COMM, layer=layer, bonded=bonded, **thin)
    regions = [part("beams", ("beam_1", "beam_2"), E=E, nu=0.0, rho=RHO, normal=(0.0, 1.0))]
    if not bonded:
        regions.append(joint("lap", "joint", E=1e9, G=1e-2, normal=(0.0, 1.0)))
    # The beams slide along each other besides.
    modes = solve_modes(Structure(tagged, regions), n_modes=5 - bonded)
    # What is left is the foot of each step, and shear.
    share = 1.0 if bonded else 0.25
    assert modes.frequencies_hz[-1] == pytest.approx(stepped_beam(share), rel=1.5e-2)

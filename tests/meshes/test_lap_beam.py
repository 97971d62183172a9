"""The lap beam: its meshes by their measures, and its model against beams joined by springs."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("dolfinx")

import ufl
from matching_faces import assert_pair, faces, parts
from mpi4py import MPI
from scipy.linalg import eigh

from fenics_joints.meshes import check_mesh, lap_beam, lap_beam_section
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Structure, Support, joint, part

COMM = MPI.COMM_WORLD
LENGTH, WIDTH, THICKNESS, LAP, WASHER = 0.235, 0.0254, 6e-3, 0.05, 0.01
SMALL = {"n_length": 3, "n_lap": 5, "n_thickness": 1}
LAYERS = [(0.0, False), (0.0, True), (2e-4, False)]


def along(tagged, axis):
    """Integral of a coordinate over each face."""
    return faces(tagged, lambda mesh: ufl.SpatialCoordinate(mesh)[axis])


def expected(width, washer_area, layer, bonded):
    """Measures of the parts and faces by hand; a face inside a body has no exterior."""
    beam = LENGTH * width * THICKNESS
    volumes = {"beam_1": beam, "beam_2": beam} | ({"joint": LAP * width * layer} if layer else {})
    areas = dict.fromkeys(("clamp", "tip"), width * THICKNESS)
    areas |= dict.fromkeys(("washer_lower", "washer_upper"), washer_area)
    if layer:
        areas |= {"joint_lower": 0.0, "joint_upper": 0.0}
    elif bonded:
        areas |= {"interface": 0.0}
    else:
        areas |= dict.fromkeys(("interface_lower", "interface_upper"), LAP * width)
    return volumes, areas


def assert_groups(tagged, height, width, washer_area, layer, bonded):
    volumes, areas = expected(width, washer_area, layer, bonded)
    assert parts(tagged) == pytest.approx(volumes)
    assert faces(tagged) == pytest.approx(areas)
    outer, (middle, heights) = THICKNESS + layer / 2, (along(tagged, a) for a in (0, height))
    assert middle["washer_upper"] / washer_area == pytest.approx(tagged.points["bolt"][0, 0])
    assert middle["tip"] / (width * THICKNESS) == pytest.approx(0.42)
    assert tagged.points["tip"][0, [0, height]] == pytest.approx([0.42, outer])
    assert heights["washer_upper"] == pytest.approx(washer_area * outer)
    assert heights["washer_lower"] == pytest.approx(-washer_area * outer)
    assert heights["clamp"] == pytest.approx(-width * THICKNESS * (THICKNESS + layer) / 2)
    assert check_mesh(tagged).bodies == (1 if layer or bonded else 2)
    if not (layer or bonded):
        assert_pair(tagged, "interface_lower", "interface_upper", ("beam_1", "beam_2"))


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize(("layer", "bonded"), LAYERS[1:])
def test_measures(layer, bonded, cell):
    tagged = lap_beam(COMM, layer=layer, bonded=bonded, cell=cell, n_width=3, **SMALL)
    assert_groups(tagged, 2, WIDTH, WASHER**2, layer, bonded)
    side = faces(tagged, lambda mesh: ufl.SpatialCoordinate(mesh)[1] ** 2)["washer_lower"]
    assert side == pytest.approx(WASHER**4 / 12)


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
@pytest.mark.parametrize(("layer", "bonded"), LAYERS)
def test_measures_of_the_section(layer, bonded, cell):
    tagged = lap_beam_section(COMM, layer=layer, bonded=bonded, cell=cell, **SMALL)
    assert_groups(tagged, 1, 1.0, WASHER, layer, bonded)


def test_counts_are_met_and_no_washer_is_possible():
    tagged = lap_beam(MPI.COMM_SELF, n_length=4, n_lap=6, n_width=2, n_thickness=2, washer=0.0)
    assert tagged.mesh.topology.index_map(3).size_local == 2 * (4 + 6) * 2 * 2
    assert "washer_lower" not in tagged.facet_names


@pytest.mark.parallel
def test_a_root_lies_before_the_clamp():
    for builder, width in ((lap_beam, WIDTH), (lap_beam_section, 1.0)):
        tagged = builder(COMM, root=1e-4, **SMALL)
        assert parts(tagged)["root"] == pytest.approx(1e-4 * THICKNESS * width)
        place = along(tagged, 0)["clamp"]
        assert place == pytest.approx(-1e-4 * THICKNESS * width)
        assert check_mesh(tagged).bodies == 2


# -- the paper's model: beams on their neutral axes, and a layer between these ---------------------


def beams_and_shell(E_layer, G_layer, E=207e9, rho=7800.0, n=(24, 24)):
    """First three frequencies, Hz, of Iranzad and Ahmadian 2012's kind of model, by hand.

    Euler beams of width 1 with u, w, w' at each node. Where they overlap a layer fills the distance
    h of their neutral axes, with the strains (w2 - w1) / h and (u2 - u1) / h + w'.
    """
    h, start = THICKNESS, LENGTH - LAP
    free = np.linspace(0, start, n[0] + 1)
    lap = np.linspace(start, LENGTH, n[1] + 1)
    x = [np.concatenate([free, lap[1:]]), np.concatenate([lap, LENGTH + free[1:]])]
    first = [0, 3 * len(x[0])]
    K = np.zeros((3 * (len(x[0]) + len(x[1])),) * 2)
    M = np.zeros_like(K)
    for beam, lines in enumerate(x):
        for e, length in enumerate(np.diff(lines)):
            dofs = first[beam] + 3 * e + np.arange(6)
            for s, weight in zip(*gauss(), strict=True):
                u, w, slope, curvature = rows(s, length)
                stretch = np.array([-1, 0, 0, 1, 0, 0]) / length
                bending = E * h**3 / 12 * np.outer(curvature, curvature)
                k = E * h * np.outer(stretch, stretch) + bending
                K[np.ix_(dofs, dofs)] += weight * length * k
                m = rho * h * (np.outer(u, u) + np.outer(w, w))
                M[np.ix_(dofs, dofs)] += weight * length * m
    for e, length in enumerate(np.diff(lap)):
        dofs = np.append(3 * (n[0] + e) + np.arange(6), first[1] + 3 * e + np.arange(6))
        for s, weight in zip(*gauss(), strict=True):
            u, w, slope, _ = rows(s, length)
            opening = np.append(-w, w) / h
            shear = np.append(-u, u) / h + np.append(slope, slope) / 2
            k = E_layer * np.outer(opening, opening) + G_layer * np.outer(shear, shear)
            K[np.ix_(dofs, dofs)] += weight * length * h * k
    values = eigh(K[3:, 3:], M[3:, 3:], eigvals_only=True, subset_by_index=[0, 2])
    return np.sqrt(values) / (2 * np.pi)


def gauss():
    points, weights = np.polynomial.legendre.leggauss(4)
    return (points + 1) / 2, weights / 2


def rows(s, a):
    """Values of u, w, w', w'' at the place s (0 to 1) of an element of length a."""
    u = np.array([1 - s, 0, 0, s, 0, 0])
    w = [0, 1 - 3 * s**2 + 2 * s**3, a * (s - 2 * s**2 + s**3)]
    w += [0, 3 * s**2 - 2 * s**3, a * (s**3 - s**2)]
    slope = [0, 6 * (s**2 - s) / a, 1 - 4 * s + 3 * s**2, 0, 6 * (s - s**2) / a, 3 * s**2 - 2 * s]
    bend = [0, (12 * s - 6) / a**2, (6 * s - 4) / a, 0, (6 - 12 * s) / a**2, (6 * s - 2) / a]
    return u, np.array(w), np.array(slope), np.array(bend)


@pytest.mark.parallel
@pytest.mark.parametrize("moduli", [(499.82e6, 168.13e6), (50e6, 20e6), (5e9, 20e6)])
def test_a_thin_layer_stands_for_the_papers_layer_between_neutral_axes(moduli):
    """Moduli in proportion to the thickness: E / t of the mesh's layer is the paper's E / h."""
    t = 6e-5
    tagged = lap_beam_section(COMM, layer=t, n_length=12, n_lap=10)
    E, G = (value * t / THICKNESS for value in moduli)
    regions = [
        part("beams", ("beam_1", "beam_2"), E=207e9, nu=0.0, rho=7800.0, normal=(0.0, 1.0)),
        joint("lap", "joint", E=E, G=G, normal=(0.0, 1.0)),
    ]
    model = Structure(tagged, regions, supports=[Support("clamp", (0, 1))])
    found = solve_modes(model, n_modes=3).frequencies_hz
    # What is left is shear in the beams and the elements.
    np.testing.assert_allclose(found, beams_and_shell(*moduli), rtol=2e-3)

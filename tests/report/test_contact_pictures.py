"""What the pictures of a contact draw, against the numbers that they are drawn from."""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Circle
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.meshes import c_beams, stacked_blocks
from fenics_joints.preload import OPEN, SLIP, STICK, Contact, ContactState, PreloadModel
from fenics_joints.preload.patch import equal_radius, nearest_axis
from fenics_joints.report.contact_pictures import pressure_map, pressure_profile, status_map
from fenics_joints.report.style import to_svg
from fenics_joints.structure import Structure, part

CENTRES = np.array([[0.0497 / 2, 0.0, 0.0], [0.508 - 0.0497 / 2, 0.0, 0.0]])


def contact(tagged, parts, pressure, axisymmetric=False):
    """A state with a given pressure: open where there is none, slipping where it is small."""
    bodies = [part("a", parts, E=200e9, nu=0.3, rho=7800.0)]
    structure = Structure(tagged, bodies, degree=1, axisymmetric=axisymmetric)
    pair = Contact("c", "interface_lower", "interface_upper")
    interface = PreloadModel(structure, [pair]).interfaces[0]
    p = np.maximum(pressure(interface.points), 0.0)
    force = np.zeros((len(interface), structure.gdim))
    force[:, 0] = p * interface.areas
    slip = np.where(p < 0.3 * p.max(), SLIP, STICK)
    status = np.where(p > 0, slip, OPEN)
    return ContactState("c", interface, force, 0 * p, 0 * force[:, 1:], status)


def square(pressure, cell="hexahedron"):
    x, z = np.linspace(0.0, 0.06, 9), np.linspace(0.0, 0.01, 2)
    tagged = stacked_blocks(MPI.COMM_SELF, lower=(x, x, -z[::-1]), upper=z, cell=cell)
    return contact(tagged, ("lower", "upper"), pressure)


def shoelace(x):
    """Area of polygons, (n,), whichever way round."""
    after = np.roll(x, -1, axis=1)
    return 0.5 * np.abs(np.sum(x[..., 0] * after[..., 1] - x[..., 1] * after[..., 0], axis=1))


def polygons(collection):
    return np.array([path.vertices[:-1] for path in collection.get_paths()])


def drawn(figure, kind):
    return [c for a in figure.axes[:1] for c in a.collections if isinstance(c, kind)]


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_contour_of_a_linear_pressure_is_a_straight_line(cell):
    # 1 MPa on the line x + 2 y = 0.091 m, which leaves the square at y = 0.0155 and y = 0.0455.
    figure = pressure_map(square(lambda x: 1e6 + 4e7 * (x[:, 0] + 2 * x[:, 1] - 0.091), cell))
    segments = np.array(drawn(figure, LineCollection)[0].get_segments())
    assert segments[..., 0] + 2 * segments[..., 1] == pytest.approx(91.0)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    assert length == pytest.approx(np.hypot(60.0, 30.0))
    assert "1770 mm²" in figure.axes[0].get_title(loc="left")


def test_facets_have_the_colour_of_their_pressure():
    state = square(lambda x: 2e7 * (x[:, 0] - 0.03) / 0.03)
    figure = pressure_map(state)
    (facets,) = drawn(figure, PolyCollection)
    # Drawn one by one, 2,400 facets made a megabyte.
    assert to_svg(figure, "a", "a contact").count("<path") < len(state.interface.facets)
    centres = polygons(facets).mean(axis=1)
    assert shoelace(polygons(facets)) == pytest.approx(1e6 * state.facet_area)
    colours = facets.get_facecolors()
    is_open = centres[:, 0] < 30.0
    assert len(np.unique(colours[is_open], axis=0)) == 1
    # One colour for each column of the four that are closed, darker towards the right.
    columns = np.unique(np.column_stack([centres[:, 0].round(6), colours])[~is_open], axis=0)
    assert len(columns) == 4 and np.all(np.diff(columns[:, 1:4].sum(axis=1)) < 0)


def test_status_covers_each_vertex_with_its_own_area():
    state = square(lambda x: 1e7 * (x[:, 0] + x[:, 1] - 0.05))
    figure = status_map(state)
    assert to_svg(figure, "a", "a contact").count("<path") < len(state.interface.facets)
    corners = drawn(figure, PolyCollection)[0]
    area, colours = shoelace(polygons(corners)), corners.get_facecolors()
    labels = figure.legends[0]
    for text, handle in zip(labels.get_texts(), labels.legend_handles, strict=True):
        kind = {"open": OPEN, "slip": SLIP, "stick": STICK}[text.get_text().split(",")[0]]
        own = np.all(colours == handle.get_facecolor(), axis=1)
        expected = 1e6 * state.interface.areas[state.status == kind].sum()
        assert expected > 0
        assert area[own].sum() == pytest.approx(expected)
        assert f", {expected / 36:.0f} %" in text.get_text()


def cones(axes, radii, slope):
    """A pressure that is 1 MPa at these radii about the axes."""

    def pressure(x):
        r = np.linalg.norm(x[:, None, :2] - axes[None, :, :2], axis=2)
        return np.max(1e6 - slope * (r - radii), axis=1)

    return pressure


def circles_of(panel):
    return [patch for patch in panel.patches if isinstance(patch, Circle)]


def test_patches_and_radii_of_two_pads():
    tagged = c_beams(
        MPI.COMM_SELF, element_size=6e-3, radial_size=3e-3, middle_size=25e-3, n_thickness=(2, 1)
    )

    state = contact(tagged, ("beam_1", "beam_2"), cones(CENTRES, [0.015, 0.013], 2e7))
    # Given in the other order, each patch takes its own.
    figure = pressure_map(state, centres=CENTRES[::-1])
    for panel, centre, radius in zip(figure.axes, CENTRES, (15.0, 13.0), strict=False):
        (circle,) = circles_of(panel)
        assert circle.center == pytest.approx(1e3 * centre[:2])
        # Between vertices the cone is linear, and reaches the limit a little further in or out.
        assert circle.radius == pytest.approx(radius, rel=0.03)
        low, high = panel.get_xlim()
        assert low < circle.center[0] < high and high - low < 60
    left, right = pressure_profile(state, centres=CENTRES).axes
    points = np.vstack([line.get_xydata() for line in left.lines if line.get_marker() == "o"])
    own = state.interface.points[:, 0] < 0.25
    r = np.linalg.norm(state.interface.points[own] - CENTRES[0], axis=1)
    order, expected = np.lexsort(points.T), np.column_stack([1e3 * r, state.pressure[own] / 1e6])
    assert points[order] == pytest.approx(expected[np.lexsort(expected.T)], abs=1e-9)
    forces = [float(a.get_title(loc="left").split(": ")[1].split(" kN")[0]) for a in (left, right)]
    assert sum(forces) == pytest.approx(state.normal_force / 1e3, rel=5e-3)


def test_two_axes_through_one_patch_have_a_circle_each():
    """Cones of 1 MPa at 12 and 9 mm from two axes on one face, and circles of equal area."""
    axes, reach = np.array([[0.015, 0.03, 0.0], [0.047, 0.03, 0.0]]), (0.012, 0.009)
    x, z = np.linspace(0.0, 0.06, 61), np.linspace(0.0, 0.01, 2)
    tagged = stacked_blocks(MPI.COMM_SELF, lower=(x, x, -z[::-1]), upper=z)
    state = contact(tagged, ("lower", "upper"), cones(axes, reach, 1e8))
    circles = circles_of(pressure_map(state, centres=axes).axes[0])
    nearest = nearest_axis(state.interface.points, axes)
    for i, (circle, axis, radius) in enumerate(zip(circles, axes, reach, strict=True)):
        assert circle.center == pytest.approx(1e3 * axis[:2])
        assert circle.radius == pytest.approx(1e3 * radius, rel=0.03)
        own = np.where(nearest == i, state.pressure, 0.0)
        equal, least, most = equal_radius(state.interface, own, 1e6, axis)
        assert equal == pytest.approx(radius, rel=0.02) and least < radius < most
        assert circle.radius == pytest.approx(1e3 * equal)


@pytest.mark.parametrize("axisymmetric", [True, False])
def test_profile_in_the_plane(axisymmetric):
    x, z = np.linspace(0.01, 0.05, 9), np.linspace(0.0, 0.01, 2)
    tagged = stacked_blocks(MPI.COMM_SELF, lower=(x, -z[::-1]), upper=z)
    state = contact(
        tagged, ("lower", "upper"), lambda x: 1e6 + 2e8 * (0.0350001 - x[:, 0]), axisymmetric
    )
    direction = None if axisymmetric else (-2.0, 0.0)
    figure = pressure_profile(state, direction=direction)
    line = figure.axes[0].lines[0].get_xydata()
    sign = 1 if axisymmetric else -1
    assert line[::sign, 0] == pytest.approx(sign * 1e3 * x)
    assert line[::sign, 1] == pytest.approx(np.maximum(1 + 200 * (0.0350001 - x), 0.0))
    title = figure.axes[0].get_title(loc="left")
    # 1 MPa at r = 35 mm: a ring, or a strip of 25 mm.
    ring = np.pi * (35.0**2 - 10.0**2)
    assert (f"{ring:.0f} mm²" if axisymmetric else ", 25 mm") in title
    figure.savefig(io.BytesIO(), format="svg")


def test_refusals():
    x, z = np.linspace(0.0, 0.06, 3), np.linspace(0.0, 0.01, 2)
    tagged = stacked_blocks(MPI.COMM_SELF, lower=(x, -z[::-1]), upper=z)
    state = contact(tagged, ("lower", "upper"), lambda x: 1e6 * x[:, 0])
    for picture in (pressure_map, status_map):
        with pytest.raises(InputError, match="no plan"):
            picture(state)
    for key, value in {"limit": 0.0, "centres": [0.0, 0.0, 0.0], "direction": (0.0, 0.0)}.items():
        with pytest.raises(InputError, match=key):
            pressure_profile(state, **{key: value})

"""What is said of contacts in a preload state: pressures, areas, radii at the bolts."""

from __future__ import annotations

import numpy as np

from fenics_joints.formatting import quantity
from fenics_joints.preload import OPEN, SLIP, STICK, ContactState, PreloadResult
from fenics_joints.preload.patch import equal_radius, largest_radius, nearest_axis

#: Pressure, Pa, that bounds the contact radius (Machines 2022, eq. 10).
LIMIT = 1e6


def bolt_axes(result: PreloadResult) -> dict[str, np.ndarray]:
    """A point on the axis of every bolt, m, (gdim,): the middle of its two faces. Collective."""
    model = result.model
    return {
        bolt.name: 0.5 * (_middle(model.face(bolt.lower)) + _middle(model.face(bolt.upper)))
        for bolt in model.bolts
    }


def bolt_centres(result: PreloadResult) -> np.ndarray | None:
    """These points, m, (n, gdim); None without bolts. Collective."""
    axes = bolt_axes(result)
    return np.array(list(axes.values())) if axes else None


def _middle(face) -> np.ndarray:
    return 0.5 * (face.points.min(axis=0) + face.points.max(axis=0))


def contact_facts(state: ContactState, axes: dict[str, np.ndarray]) -> dict:
    """What is said of a contact.

    Args:
        state: The contact in its state.
        axes: A point on each bolt's axis, by bolt.

    Returns:
        Keys ``name``; ``force_n``; ``peak_pressure_pa``, the largest of the facets' means, and
        ``peak_nodal_pressure_pa``; ``mean_pressure_pa``, over the area that presses; ``area_m2``,
        where the pressure, linear between vertices, is above zero, ``area_above_1_mpa_m2``, with
        the same pressure, and ``whole_area_m2``; ``radius_m`` by bolt, to the farthest place with
        1 MPa or more among those nearest to the bolt; ``equal_radius_m`` by bolt, in space only:
        radius of the circle around the hole with the area above 1 MPa, and the least and largest
        radius within the mesh's resolution; ``open``, ``slip``, ``stick``: numbers of pairs;
        ``matching``, whether these are pairs of vertices.
    """
    force, area = state.normal_force, state.area
    return {
        "name": state.name,
        "force_n": force,
        "peak_pressure_pa": float(state.facet_pressure.max(initial=0.0)),
        "peak_nodal_pressure_pa": float(state.pressure.max(initial=0.0)),
        "mean_pressure_pa": state.pressure_force / area if area else 0.0,
        "area_m2": area,
        "area_above_1_mpa_m2": state.area_above(LIMIT),
        "whole_area_m2": float(state.facet_area.sum()),
        **_radii(state, axes),
        "matching": state.interface.coupling is None,
        **{
            word: int(np.sum(state.status == kind))
            for word, kind in (("open", OPEN), ("slip", SLIP), ("stick", STICK))
        },
    }


def _radii(state: ContactState, axes: dict[str, np.ndarray]) -> dict[str, dict]:
    """Contact radii at each bolt, by the pairs nearest to the bolt."""
    farthest, equal = {}, {}
    if axes:
        nearest = nearest_axis(state.interface.points, axes.values())
    for i, (name, axis) in enumerate(axes.items()):
        own = np.where(nearest == i, state.pressure, 0.0)
        farthest[name] = largest_radius(state.interface, own, LIMIT, axis)
        if len(axis) == 3:
            equal[name] = equal_radius(state.interface, own, LIMIT, axis)
    return {"radius_m": farthest, "equal_radius_m": equal}


def area_words(square_metres: float) -> str:
    """An area in mm2."""
    return f"{square_metres * 1e6:.0f} mm²"


def bolt_forces(result: PreloadResult) -> dict[str, float]:
    """The bolts' forces, N, by name."""
    return {bolt.name: result.forces[bolt.name] for bolt in result.model.bolts}


def forces_in_words(result: PreloadResult) -> str:
    """The bolts' forces by name; empty without bolts."""
    return ", ".join(f"{name} {quantity(f, 'N')}" for name, f in bolt_forces(result).items())


def contact_rows(contacts: list[dict]) -> list[dict]:
    """Facts of each contact in words."""
    rows = []
    for c in contacts:
        presses, whole = area_words(c["area_m2"]), area_words(c["whole_area_m2"])
        facts = [
            ("force between the faces", quantity(c["force_n"], "N")),
            ("peak pressure, mean over a facet", quantity(c["peak_pressure_pa"], "Pa")),
            ("peak pressure at a vertex", quantity(c["peak_nodal_pressure_pa"], "Pa")),
            ("mean pressure where it presses", quantity(c["mean_pressure_pa"], "Pa")),
            ("area that presses", f"{presses} of {whole}"),
            ("area above 1 MPa", area_words(c["area_above_1_mpa_m2"])),
        ]
        for bolt, radius in c["radius_m"].items():
            if bolt in c["equal_radius_m"]:
                equal, least, most = (1e3 * r for r in c["equal_radius_m"][bolt])
                words = f"{equal:.1f} mm ({least:.1f} to {most:.1f} by the mesh)"
                facts.append((f"radius of the area above 1 MPa at {bolt}", words))
            facts.append((f"farthest place with 1 MPa from {bolt}", quantity(radius, "m")))
        if not c["matching"]:
            facts.append(("meshes of the faces", "differ: mortar"))
        facts += [(f"{word} pairs", str(c[word])) for word in ("open", "slip", "stick")]
        rows.append({"name": c["name"], "facts": facts})
    return rows

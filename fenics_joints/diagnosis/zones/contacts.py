"""A bolted contact as a thin layer in zones of equal pressure, for the parametric reduced models.

The preload is solved on the case's own mesh of separate bodies. Its twin has the same plan, but the
bodies share vertices with a thin layer between them, as stiff as they are: the fully stuck model.
The cells of the layer are split into zones by the pressure of the facet at the same place; a zone
can then lose its stiffness. The bolts' beams are left out (what is stuck is far stiffer), their
mass is put on the faces under the washers.
"""

from __future__ import annotations

from dataclasses import replace

import dolfinx.mesh
import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from fenics_joints._compat import geometry_dofmap
from fenics_joints.case import Case, build_mesh, build_preload
from fenics_joints.case.sections import JointSection, MassSection
from fenics_joints.diagnosis.zones.zone import Zone, Zones, bonded_moduli, equal_shares
from fenics_joints.errors import InputError
from fenics_joints.meshes import TaggedMesh
from fenics_joints.preload import PreloadModel, solve_preload

#: Thickness of the layer, relative to the shortest edge of the interface: thin enough that one as
#: stiff as the bodies is as good as none. [numerical: chosen]
_THIN = 0.1
#: Pressure, relative to the largest, below which a facet is open. [numerical: chosen]
_OPEN = 1e-9
#: Zones by pressure, at most. [decision: chosen]
_ZONES = 12


def contact_zones(case: Case, comm: MPI.Intracomm, n_zones: int = _ZONES) -> Zones:
    """Solve a case's preload and make the zones. Collective.

    Args:
        case: A case with one contact that can open, whose mesh builder can make a layer.
        comm: Communicator.
        n_zones: Zones of equal area where the contact is pressed; one more where it is open.

    Returns:
        Zones by ascending pressure, each with its least and largest, the next one's least; the
        first is open, without any, if a part of the contact is. Neither contacts nor bolts are
        left in their case.

    Raises:
        InputError: If the case has another number of contacts, or another mesh.
    """
    names = [name for name, section in case.contacts.items() if not section.bonded]
    if len(names) != 1:
        raise InputError(
            f"{case.path}: contacts: {len(names)} of them can open; a diagnosis expects one"
        )
    twin = getattr(case.mesh, "with_layer", None)
    if twin is None:
        raise InputError(
            f"{case.path}: mesh: a diagnosis of a contact needs a builder that can put a layer "
            "between the bodies, such as 'c_beams'"
        )
    model = build_preload(case, comm)
    state = solve_preload(model)[names[0]]
    interface = state.interface
    middles = interface.points[interface.facets].mean(axis=1)
    thickness = _THIN * float(np.sqrt(state.facet_area.min()))
    low, high, area, zone = _zones(state.facet_pressure, state.facet_area, n_zones)
    labels = tuple(f"{names[0]}_{k + 1}" for k in range(len(low)))
    made = case.model_copy(
        update={
            "mesh": twin(thickness),
            "contacts": {},
            "bolts": {},
            "masses": case.masses | _bolt_masses(case, model),
        }
    )
    tagged = _split(build_mesh(made, comm), middles, zone, labels)
    made = made.model_copy(update={"joints": _joints(case, labels)})
    rows = zip(labels, low.tolist(), high.tolist(), area.tolist(), strict=True)
    common = {"thickness": thickness, "joint": names[0], "shown": names[0]}
    zones = tuple(Zone(label, pressure=(a, b), area=size, **common) for label, a, b, size in rows)
    return Zones(made, zones, tagged)


def _zones(pressure: np.ndarray, area: np.ndarray, n: int):
    """Least and largest pressure and area of each zone, and the zone of each facet."""
    pressed = pressure > _OPEN * pressure.max()
    zone = np.zeros(len(pressure), dtype=int)
    zone[pressed] = equal_shares(pressure[pressed], area[pressed], n) + (not pressed.all())
    least = np.array([pressure[zone == k].min() for k in range(zone.max() + 1)])
    least[0] = 0.0
    # An open zone has no pressure: it is lost at any cut-off.
    high = np.append(least[1:], pressure.max() * (1 + 1e-9))
    if not pressed.all():
        high[0], least[1] = 0.0, 0.0
    return least, high, np.bincount(zone, area), zone


def _split(tagged: TaggedMesh, middles: np.ndarray, zone: np.ndarray, labels) -> TaggedMesh:
    """The mesh with the layer's cells tagged by zone."""
    mesh, tags = tagged.mesh, tagged.cell_tags
    layer = tags.find(tagged.cell_tag("joint"))
    corners = mesh.geometry.x[geometry_dofmap(mesh)[layer]]
    values, first = tags.values.copy(), max(tagged.cell_names.values()) + 1
    if len(layer):
        _, nearest = cKDTree(middles).query(corners.mean(axis=1))
        values[np.searchsorted(tags.indices, layer)] = first + zone[nearest]
    new = dolfinx.mesh.meshtags(mesh, tags.dim, tags.indices, values)
    names = {name: tag for name, tag in tagged.cell_names.items() if name != "joint"}
    names |= {label: first + k for k, label in enumerate(labels)}
    return replace(tagged, cell_tags=new, cell_names=names)


def _joints(case: Case, labels) -> dict[str, JointSection]:
    """A joint for each zone, as stiff as the stiffest part."""
    E, G = bonded_moduli(case)
    return {name: JointSection(cells=[name], law="uncoupled", E=E, G=G) for name in labels}


def _bolt_masses(case: Case, model: PreloadModel) -> dict[str, MassSection]:
    """The mass of each bolt that is a beam, on four places of the faces under its washers."""
    found = {}
    for bolt in model.beams:
        (lower, upper), mass = model.ends(bolt), model.bolt_mass(bolt)
        axis = model.beam_axis(bolt)
        if not mass > 0:
            continue
        across = np.linalg.svd(axis[None])[2][1:]
        points = []
        for side, centre in (("lower", lower), ("upper", upper)):
            radius = np.linalg.norm(model.face(getattr(bolt, side)).points - centre, axis=1).mean()
            for way in (*across, *-across):
                points.append((centre + radius * way).tolist())
        found[f"{bolt.name}_mass"] = MassSection(points=points, mass=mass)
    return found

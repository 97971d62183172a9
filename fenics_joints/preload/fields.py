"""Files of a preload state for ParaView: fields over the bodies, and the contacts by themselves.

Over the bodies, all fields are linear between vertices and of the same names in either format:
``displacement``, m, ``traction`` of the contact on the body there, Pa, ``slip``, m, of the upper
body over the lower, ``pressure``, Pa, ``gap``, m, and ``status`` (0 open, 1 slip, 2 stick). Away
from the contacts they are zero, and ``status`` is -1: a threshold on it leaves the interfaces
(``nan`` would leave holes in cells beside them and spoil contours and statistics). Where two
contacts share a vertex, the one that presses more is shown.

The contacts are a mesh of their own facets, with the same fields at the vertices and, on the
facets, ``facet_pressure``, Pa, the mean, which times the area sums to the force, and
``facet_status``: open where all vertices are, else slip where a closed one slips.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from dolfinx import fem

from fenics_joints.preload.conditions import OPEN, SLIP, STICK
from fenics_joints.preload.contact_state import ContactState
from fenics_joints.preload.solve import PreloadResult
from fenics_joints.structure.grids import write_fields

#: Status away from the contacts.
NO_CONTACT = -1.0
#: Name in XDMF, and corners in VTK's order, of facets by their number of vertices.
_FACETS = {2: ("Polyline", (0, 1)), 3: ("Triangle", (0, 1, 2)), 4: ("Quadrilateral", (0, 1, 3, 2))}


def write(result: PreloadResult, path: str | Path) -> list[Path]:
    """Write a state: VTX for ``.bp``, XDMF with HDF5 for ``.xdmf``. Collective.

    Beside the file of the bodies there is one of the contacts, ``<name>_contacts.xdmf``, and for
    XDMF ``<name>.h5``. Files are written under another name and moved into place when they are
    whole; those of a failed attempt are removed.

    Args:
        result: The state.
        path: Name of the bodies' file; one that is there is replaced.

    Returns:
        The files, that of the bodies first.

    Raises:
        InputError: For another ending, a DOLFINx without ADIOS2, or if a file cannot be written.
    """
    path = Path(path)
    contacts = path.with_name(f"{path.stem}_contacts.xdmf")
    states = list(result.contacts.values())
    return write_fields(nodal_fields(result), path, {contacts: lambda: _contacts_xdmf(states)})


# -- bodies ----------------------------------------------------------------------------------------


def nodal_fields(result: PreloadResult) -> list[fem.Function]:
    """The fields over the bodies as functions of degree 1, vectors first. Collective."""
    mesh, gdim = result.model.V.mesh, result.model.jumps.gdim
    vectors = fem.functionspace(mesh, ("Lagrange", 1, (gdim,)))
    scalars = fem.functionspace(mesh, ("Lagrange", 1))
    displacement = fem.Function(vectors, name="displacement")
    displacement.interpolate(result.displacement)
    place = _places(result.model.V, scalars)
    fields = {
        name: fem.Function(vectors if name in ("traction", "slip") else scalars, name=name)
        for name in ("traction", "slip", "pressure", "gap", "status")
    }
    fields["status"].x.array[:] = NO_CONTACT
    for state in result.contacts.values():
        values = _contact_values(state)
        c = state.interface
        for (nodes, pair), side in ((c.opposite, -1.0), ((c.upper, np.arange(len(c))), 1.0)):
            at, rows = place(nodes)
            rows = pair[rows]
            keep = _presses_more(fields, at, values["pressure"][rows])
            at, rows = at[keep], rows[keep]
            for name, field in fields.items():
                factor = side if name == "traction" else 1.0
                view = field.x.array.reshape(-1, gdim if name in ("traction", "slip") else 1)
                view[at] = factor * values[name][rows].reshape(view[at].shape)
    return [displacement, *fields.values()]


def _presses_more(fields: dict[str, fem.Function], at: np.ndarray, pressure: np.ndarray):
    """Where no contact has written yet, or one that presses less."""
    empty = fields["status"].x.array[at] == NO_CONTACT
    return empty | (pressure > fields["pressure"].x.array[at])


def _contact_values(state: ContactState) -> dict[str, np.ndarray]:
    """Fields of one contact at its pairs; vectors in space, the traction on the upper body."""
    frames = state.interface.frames
    traction = np.einsum("nk,nki->ni", state.force, frames) / state.interface.areas[:, None]
    return {
        "traction": traction,
        "slip": np.einsum("nk,nki->ni", state.slip, frames[:, 1:]),
        "pressure": state.pressure,
        "gap": state.gap,
        "status": state.status.astype(float),
    }


def _places(V: fem.FunctionSpace, Q: fem.FunctionSpace) -> Callable:
    """A function from global blocks of V at vertices to local DOFs of Q, and which were found."""
    n = Q.dofmap.dof_layout.num_dofs
    corners = [[space.dofmap.dof_layout.entity_dofs(0, v)[0] for v in range(n)] for space in (V, Q)]
    blocks = V.dofmap.list[:, corners[0]].ravel()
    blocks = V.dofmap.index_map.local_to_global(blocks)
    blocks, first = np.unique(blocks, return_index=True)
    dofs = Q.dofmap.list[:, corners[1]].ravel()[first]

    def place(nodes: np.ndarray):
        if not len(blocks):
            return np.empty(0, int), np.empty(0, int)
        i = np.minimum(np.searchsorted(blocks, nodes), len(blocks) - 1)
        rows = np.flatnonzero(blocks[i] == nodes)
        return dofs[i[rows]], rows

    return place


# -- contacts --------------------------------------------------------------------------------------


def facet_status(state: ContactState) -> np.ndarray:
    """Status of the facets, (n,): OPEN if all its vertices are, SLIP if one slips, or STICK."""
    status = state.status[state.interface.facets]
    closed = np.where((status == SLIP).any(axis=1), SLIP, STICK)
    return np.where((status == OPEN).all(axis=1), OPEN, closed)


def _contacts_xdmf(states: list[ContactState]) -> str:
    """Text of an XDMF file with one grid for each contact, its numbers within."""
    grids = "".join(_contact_grid(state) for state in states)
    return (
        '<?xml version="1.0"?>\n<Xdmf Version="3.0">\n<Domain>\n'
        '<Grid Name="contacts" GridType="Collection" CollectionType="Spatial">\n'
        f"{grids}</Grid>\n</Domain>\n</Xdmf>\n"
    )


def _contact_grid(state: ContactState) -> str:
    c = state.interface
    kind, order = _FACETS[c.facets.shape[1]]
    fields = {name: (values, "Node") for name, values in _contact_values(state).items()}
    fields["facet_pressure"] = state.facet_pressure, "Cell"
    fields["facet_status"] = facet_status(state).astype(float), "Cell"
    attributes = "".join(
        f'<Attribute Name="{name}" AttributeType="{"Scalar" if values.ndim == 1 else "Vector"}" '
        f'Center="{centre}">\n{_numbers(values)}</Attribute>\n'
        for name, (values, centre) in fields.items()
    )
    return (
        f'<Grid Name={quoteattr(state.name)} GridType="Uniform">\n'
        f'<Topology TopologyType="{kind}" NumberOfElements="{len(c.facets)}" '
        f'NodesPerElement="{len(order)}">\n{_numbers(c.facets[:, order], "Int")}</Topology>\n'
        f'<Geometry GeometryType="XYZ">\n{_numbers(c.points)}</Geometry>\n'
        f"{attributes}</Grid>\n"
    )


def _numbers(values: np.ndarray, kind: str = "Float") -> str:
    """An array as a DataItem; vectors in space."""
    if kind == "Float" and values.ndim == 2:
        values = np.pad(values, ((0, 0), (0, 3 - values.shape[1])))
    rows = "\n".join(" ".join(map(repr, row)) for row in np.atleast_2d(values).tolist())
    shape = " ".join(map(str, values.shape))
    return (
        f'<DataItem Dimensions="{shape}" NumberType="{kind}" Precision="8" Format="XML">\n'
        f"{rows}\n</DataItem>\n"
    )

"""Measures of parts and faces by forms, and faces that match, by an independent route."""

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.preload import check_contact

COMM = MPI.COMM_WORLD


def integral(tagged, integrand):
    return COMM.allreduce(fem.assemble_scalar(fem.form(integrand)))


def parts(tagged, weight=None):
    """Integral of the weight over each part; of 1 if there is none."""
    dx = ufl.Measure("dx", tagged.mesh, subdomain_data=tagged.cell_tags)
    one = fem.Constant(tagged.mesh, 1.0) if weight is None else weight(tagged.mesh)
    return {name: integral(tagged, one * dx(tag)) for name, tag in tagged.cell_names.items()}


def faces(tagged, weight=None, inner=False):
    """Integral of the weight over each face: its exterior facets, or its interior ones."""
    ds = ufl.Measure("dS" if inner else "ds", tagged.mesh, subdomain_data=tagged.facet_tags)
    one = fem.Constant(tagged.mesh, 1.0) if weight is None else weight(tagged.mesh)
    one = one("+") if inner else one
    return {name: integral(tagged, one * ds(tag)) for name, tag in tagged.facet_names.items()}


def polygon(diameter, n=16):
    """Area of a regular polygon whose corners lie on a circle."""
    return n / 8 * diameter**2 * np.sin(2 * np.pi / n)


def corners_and_sides(tagged, name):
    """Sorted vertices of a face, without repetition, and the parts of the cells behind it."""
    mesh, fdim = tagged.mesh, tagged.mesh.topology.dim - 1
    facets = tagged.facet_tags.find(tagged.facet_tag(name))
    facets = facets[facets < mesh.topology.index_map(fdim).size_local]
    mesh.topology.create_connectivity(0, fdim + 1)
    links, to_vertex = (mesh.topology.connectivity(fdim, dim) for dim in (fdim + 1, 0))
    parts = {int(tagged.cell_tags.values[c]) for f in facets for c in links.links(f)}
    vertices = np.unique([to_vertex.links(f) for f in facets]).astype(np.int32)
    x = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, 0, vertices)] if len(facets) else []
    gathered = COMM.allgather((np.round(np.reshape(x, (-1, 3)), 12) + 0.0, parts))
    return np.unique(np.vstack([x for x, _ in gathered]), axis=0), set.union(
        *(parts for _, parts in gathered)
    )


def assert_pair(tagged, lower, upper, parts):
    below, behind = corners_and_sides(tagged, lower)
    above, before = corners_and_sides(tagged, upper)
    np.testing.assert_array_equal(below, above)
    assert behind == {tagged.cell_tag(parts[0])} and before == {tagged.cell_tag(parts[1])}
    match = check_contact(tagged, lower, upper)
    assert len(match) == len(below) and not match.gap.any()

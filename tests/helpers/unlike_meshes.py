"""Parts whose meshes do not match, with a layer between them, for tests of ties."""

from __future__ import annotations

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from fenics_joints.meshes.facets import FACETS, Skin
from fenics_joints.meshes.grow import Grown, grow
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute, extent
from fenics_joints.parallel import on_root
from fenics_joints.structure import Parameter, Structure, interface, part

COMM = MPI.COMM_WORLD
STEEL = {"E": 2e11, "nu": 0.3, "rho": 7800.0}


def two_parts(cell: str, blocks, change=None, faces=(), **grown) -> TaggedMesh:
    """Parts "low" and "high" with a layer "joint".

    Args:
        cell: DOLFINx's name of the cells.
        blocks: Lowest and highest corner and counts of cells of either part.
        change: Changes the positions of all vertices, (n, gdim), in place.
        faces: Names of outer faces with axis and place, before the change.
        grown: Arguments of `Grown`.
    """

    def build() -> MeshLists:
        kind, points, cells = getattr(mesh.CellType, cell), [], []
        for low, high, counts in blocks:
            gdim = len(counts)
            make = mesh.create_box if gdim == 3 else mesh.create_rectangle
            one = make(MPI.COMM_SELF, [low, high], counts, kind)
            cells.append(np.array(one.geometry.dofmap) + sum(map(len, points)))
            points.append(one.geometry.x[:, :gdim].copy())
        none = np.empty((0, FACETS[cell].shape[1]), np.int64)
        values = np.repeat([1, 2], [len(own) for own in cells])
        parts = {"low": 1, "high": 2}
        tags = np.empty(0, np.int32)
        x, cells = np.vstack(points), np.vstack(cells)
        lists = MeshLists(cell, x, cells, values, none, tags, parts, {})
        skin = Skin(lists)
        lists = skin.named({name: skin.at(axis, place) for name, axis, place in faces})
        if change is not None:
            change(lists.x)
        return grow(lists, Grown(joint="layer", **grown))

    return distribute(COMM, on_root(COMM, build))


def lap(low, high, cell="hexahedron", **more) -> TaggedMesh:
    """Two plates of 200 x 40 x 10 mm that overlap by 80 mm, with counts of cells each."""
    blocks = [([0, 0, 0], [0.2, 0.04, 0.01], low), ([0.12, 0, 0.01], [0.32, 0.04, 0.02], high)]
    return two_parts(cell, blocks, **more)


def springs(tagged: TaggedMesh, degree=2, k_n=1e12, k_t=1e12, normal=(0.0, 0.0, 1.0), **more):
    """Both parts of steel, and springs whose stiffnesses are the parameters k_n and k_t."""
    curved = callable(normal)
    meshed = more.pop("meshed") if curved else extent(tagged, ["joint"], normal)
    regions = [
        part("parts", ("low", "high"), **(STEEL | more.pop("solid", {}))),
        interface("joint", "joint", k_n="k_n", k_t="k_t", meshed=meshed, normal=normal),
    ]
    parameters = [Parameter("k_n", k_n, "Pa/m"), Parameter("k_t", k_t, "Pa/m")]
    return Structure(tagged, regions, parameters, degree=degree, **more)

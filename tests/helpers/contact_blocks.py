"""Blocks pressed on each other, for the tests of preload contact."""

from __future__ import annotations

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root
from fenics_joints.preload import Contact, PreloadModel
from fenics_joints.structure import Structure, Support, part

COMM = MPI.COMM_WORLD
STEEL = {"E": 200e9, "nu": 0.3, "rho": 7800.0}


def faces(**options) -> Contact:
    """The contact of stacked blocks."""
    return Contact("c", "interface_lower", "interface_upper", **options)


def both(**properties):
    return [part("both", ("lower", "upper"), **STEEL | properties)]


def pair(low, up) -> list:
    """Parts of the two blocks, with properties other than steel's."""
    return [part("low", "lower", **STEEL | low), part("up", "upper", **STEEL | up)]


def pressed(
    tagged,
    loads=(),
    *,
    parts=None,
    parameters=(),
    held=("bottom",),
    bolts=(),
    contacts=None,
    **more,
) -> PreloadModel:
    """Stacked blocks in contact "c", of steel, linear and clamped at the bottom by default.

    Args:
        tagged: Their mesh.
        loads: Loads.
        parts: Parts; steel if None.
        parameters: Parameters that they name.
        held: Supports, or faces that are clamped.
        bolts: Bolts.
        contacts: Contacts instead of "c".
        more: ``degree``, ``axisymmetric`` and ``springs`` of the structure, and options of "c".
    """
    own = {key: more.pop(key) for key in ("degree", "axisymmetric", "springs") if key in more}
    supports = [s if isinstance(s, Support) else Support(s) for s in held]
    structure = Structure(
        tagged, parts or both(), parameters, supports=supports, **{"degree": 1} | own
    )
    return PreloadModel(structure, contacts or [faces(**more)], bolts, loads)


def half_width(state, axes=1) -> float:
    """Half-width of a Hertzian patch: p^2 is linear in r^2, and a fit through its inner part
    vanishes there."""
    r2 = (state.interface.points[:, :axes] ** 2).sum(axis=1)
    inner = state.pressure > 0.3 * state.pressure.max()
    slope, top = np.polyfit(r2[inner], state.pressure[inner] ** 2, 1)
    return np.sqrt(-top / slope)


def slope_of(errors, sizes) -> float:
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def unlike_blocks(lower, upper, cell: str, warp=None) -> TaggedMesh:
    """Two unit-wide blocks on one another with meshes of their own: counts of cells each.

    Args:
        lower: Cells along each axis of the lower block, which is 1 high; from 0 down.
        upper: Those of the upper one, from 0 up.
        cell: DOLFINx's name of the cells.
        warp: Changes the positions of all vertices, (n, gdim), in place.
    """
    return distribute(COMM, on_root(COMM, lambda: _unlike(lower, upper, cell, warp)))


def _unlike(lower, upper, cell: str, warp) -> MeshLists:
    sides = []
    for tag, counts, base in ((1, lower, -1.0), (2, upper, 0.0)):
        x, cells, *faces = _block(counts, cell, base)
        tags = np.repeat([2 * tag - 1, 2 * tag], [len(face) for face in faces])
        sides.append((x, cells, np.full(len(cells), tag), np.vstack(faces), tags))
    names = {"bottom": 1, "interface_lower": 2, "interface_upper": 3, "top": 4}
    lists = two_bodies(cell, sides, names)
    if warp is not None:
        warp(lists.x)
    return lists


def two_bodies(cell: str, sides, names) -> MeshLists:
    """Lower and upper bodies of (points, cells, their values, facets, their tags) as one mesh."""
    (x0, c0, v0, f0, t0), (x1, c1, v1, f1, t1) = sides
    cells, facets = np.vstack([c0, c1 + len(x0)]), np.vstack([f0, f1 + len(x0)])
    values, tags = np.append(v0, v1), np.append(t0, t1)
    parts = {"lower": 1, "upper": 2}
    return MeshLists(cell, np.vstack([x0, x1]), cells, values, facets, tags, parts, names)


def _block(counts, cell: str, base: float):
    """Vertices, cells, and facets below and above, of a block of height 1 from ``base``."""
    gdim = len(counts)
    low, high = np.zeros(gdim), np.ones(gdim)
    low[-1], high[-1] = base, base + 1
    kind = getattr(mesh.CellType, cell)
    make = mesh.create_rectangle if gdim == 2 else mesh.create_box
    msh = make(MPI.COMM_SELF, [low, high], counts, kind)
    x, fdim = msh.geometry.x[:, :gdim], gdim - 1
    msh.topology.create_connectivity(fdim, gdim)
    sides = [
        mesh.locate_entities_boundary(msh, fdim, lambda p, h=h: np.isclose(p[gdim - 1], h))
        for h in (base, base + 1)
    ]
    facets = [mesh.entities_to_geometry(msh, fdim, side) for side in sides]
    cells = np.arange(msh.topology.index_map(gdim).size_local, dtype=np.int32)
    return x, mesh.entities_to_geometry(msh, gdim, cells), *facets

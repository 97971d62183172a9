"""Grids of pyvista, to be looked at, cut and written by that library, which is optional."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_joints.errors import InputError

#: VTK's number of a cell's kind, and its corners in VTK's order, by their number and dimension.
_KINDS = {
    (2, 1): (3, (0, 1)),
    (3, 2): (5, (0, 1, 2)),
    (4, 2): (9, (0, 1, 3, 2)),
    (4, 3): (10, (0, 1, 2, 3)),
    (8, 3): (12, (0, 1, 3, 2, 4, 5, 7, 6)),
}
#: Corners nearer than this share of the whole, which carry the same values, are one point.
_SAME = 1e-7


def pyvista():
    """The library.

    Raises:
        InputError: If it is not installed.
    """
    try:
        import pyvista
    except ImportError as error:
        raise InputError(
            "to_pyvista needs pyvista, which is not installed: pip install 'fenics-joints[view]'"
        ) from error
    return pyvista


def cell_arrays(
    corners: np.ndarray, tdim: int, values: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Cells as VTK has them, their corners shared where they are at one place and carry the same.

    Args:
        corners: Corners in DOLFINx's order, m, (n, k, 3).
        tdim: Dimension of the cells.
        values: At the corners, each (n, k) or (n, k, c), by name.

    Returns:
        Cells, one after the other with the number of their corners before them, (n (k + 1),); VTK's
        kind of each, (n,); points, (p, 3); and the values at the points.

    Raises:
        InputError: For cells of another shape.
    """
    n, k = corners.shape[:2]
    if (k, tdim) not in _KINDS:
        raise InputError(
            f"cells with {k} corners in {tdim} dimensions: expected simplices, "
            "quadrilaterals or hexahedra."
        )
    kind, order = _KINDS[k, tdim]
    flat = {"": corners.reshape(n * k, 3)}
    flat |= {name: np.asarray(v, dtype=float).reshape(n * k, -1) for name, v in values.items()}
    whole = [np.round((v - v.min(initial=0)) / (_SAME * (np.ptp(v) or 1.0))) for v in flat.values()]
    key = np.column_stack(whole).astype(np.int64)
    _, first, number = np.unique(key, axis=0, return_index=True, return_inverse=True)
    ids = number.reshape(n, k)[:, order]
    cells = np.column_stack([np.full(n, k), ids]).ravel()
    given = {name: flat[name][first].reshape(-1, *np.shape(v)[2:]) for name, v in values.items()}
    return cells, np.full(n, kind, dtype=np.uint8), flat[""][first], given


def cell_grid(
    corners: np.ndarray,
    tdim: int,
    points: Mapping[str, np.ndarray] | None = None,
    cells: Mapping[str, np.ndarray] | None = None,
):
    """Cells as a ``pyvista.UnstructuredGrid``, in metres.

    Args:
        corners: Corners in DOLFINx's order, m, (n, k, 3).
        tdim: Dimension of the cells.
        points: Values at the corners, each (n, k) or (n, k, c), by name.
        cells: Values of the cells, each (n,) or (n, c), by name.

    Raises:
        InputError: If pyvista is not installed.
    """
    pv = pyvista()
    connected, kinds, x, values = cell_arrays(corners, tdim, points or {})
    grid = pv.UnstructuredGrid(connected, kinds, x)
    for name, value in values.items():
        grid.point_data[name] = value
    for name, value in (cells or {}).items():
        grid.cell_data[name] = np.asarray(value)
    return grid


def facet_mesh(
    points: np.ndarray,
    facets: np.ndarray,
    at_points: Mapping[str, np.ndarray],
    at_facets: Mapping[str, np.ndarray],
):
    """Facets as a ``pyvista.PolyData``.

    Args:
        points: Their vertices, m, (n, gdim).
        facets: Vertices of each in DOLFINx's order, (m, k).
        at_points: Values at the vertices, each (n, ...), by name.
        at_facets: Values of the facets, each (m, ...), by name.

    Raises:
        InputError: If pyvista is not installed.
    """
    pv = pyvista()
    k = facets.shape[1]
    order = _KINDS[k, min(k - 1, 2)][1]
    x = np.zeros((len(points), 3))
    x[:, : points.shape[1]] = points
    around = np.column_stack([np.full(len(facets), k), facets[:, order]]).ravel()
    mesh = pv.PolyData(x, lines=around) if k == 2 else pv.PolyData(x, faces=around)
    for name, value in at_points.items():
        mesh.point_data[name] = value
    for name, value in at_facets.items():
        mesh.cell_data[name] = value
    return mesh

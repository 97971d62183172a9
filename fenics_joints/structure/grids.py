"""Structures and fields for other programs: grids of pyvista, files for ParaView."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import basix
import numpy as np
import ufl
from dolfinx import fem, io
from mpi4py import MPI

from fenics_joints._compat import geometry_dofmap
from fenics_joints.errors import InputError
from fenics_joints.files import check_writable, write_text
from fenics_joints.parallel import on_root

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


def corner_motion(
    motions: Sequence[fem.Function], V: fem.FunctionSpace, element
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all cells and how they move. Collective.

    Args:
        motions: Displacements.
        V: Their space, of one component along each axis of the mesh.
        element: Of a component; not every element has its corner values as degrees of freedom.

    Returns:
        On rank 0 the corners, m, shape (n_cells, n_corners, 3), and the displacements, shape
        (n_motions, n_cells, n_corners, 3), zero in a direction that the mesh does not have; empty
        on the other ranks.
    """
    msh, gdim = V.mesh, V.mesh.geometry.dim
    n_owned = msh.topology.index_map(msh.topology.dim).size_local
    corners = msh.geometry.x[geometry_dofmap(msh)[:n_owned]]
    cell = getattr(basix.CellType, msh.topology.cell_name())
    values = element.tabulate(0, basix.geometry(cell))[0]
    nodes = V.dofmap.list[:n_owned]
    moved = np.zeros((len(motions), *corners.shape))
    for i, u in enumerate(motions):
        block = u.x.array.reshape(-1, gdim)[nodes]
        moved[i, :, :, :gdim] = np.einsum("cn,eni->eci", values, block)
    gathered = msh.comm.gather((corners, moved), root=0)
    if gathered is None:
        return np.empty((0, 0, 3)), np.empty((len(motions), 0, 0, 3))
    parts, shares = zip(*gathered, strict=True)
    return np.concatenate(parts), np.concatenate(shares, axis=1)


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


def cell_volumes(mesh, weight=1.0) -> np.ndarray:
    """Integral of a weight over each cell that this rank owns, (n_owned,); by default its volume,
    m3."""
    space = fem.functionspace(mesh, ("DG", 0))
    form = weight * ufl.TestFunction(space) * ufl.dx(mesh)
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    return fem.assemble_vector(fem.form(form)).array[space.dofmap.list[:owned, 0]]


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


#: File by which a folder written by ADIOS2 is recognised.
_BP_INDEX = "md.idx"


def check_fields_path(comm: MPI.Intracomm, path: str | Path, beside: Sequence[Path] = ()) -> None:
    """Refuse what cannot be written or must not be replaced, before the work. Collective.

    Args:
        comm: Communicator.
        path: As for `write_fields`.
        beside: Other files that are written with it.

    Raises:
        InputError: For another ending, a DOLFINx without ADIOS2, or if a file cannot be written.
    """
    path = Path(path)
    if path.suffix not in ENDINGS:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(ENDINGS)}.")
    on_root(comm, lambda: _check(path, beside))


def write_fields(
    fields: Sequence[fem.Function],
    path: str | Path,
    beside: Mapping[Path, Callable[[], str]] | None = None,
) -> list[Path]:
    """Write functions on one mesh by their names. Collective.

    Files are written under another name and moved into place when they are whole; those of a failed
    attempt are removed.

    Args:
        fields: The functions; for XDMF of degree 1, for VTX all of one element.
        path: Name of the file, ``.bp`` or ``.xdmf``, which has ``<name>.h5`` beside it; one that is
            there is replaced.
        beside: Functions that give the text of other files, on rank 0.

    Returns:
        The files, ``path`` first.

    Raises:
        InputError: As `check_fields_path`; if writing fails.
    """
    path, comm = Path(path), fields[0].function_space.mesh.comm
    beside = beside or {}
    check_fields_path(comm, path, list(beside))
    maps = [f.function_space.dofmap for f in fields]
    need = 8 * sum(m.index_map.size_global * m.index_map_bs for m in maps)
    part = comm.bcast(on_root(comm, lambda: _part(path, need)))
    try:
        ENDINGS[path.suffix](fields, part / path.name)
        comm.barrier()
        names = on_root(comm, lambda: _finish(part, path, beside))
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path}: cannot be written ({error}).") from error
    finally:
        if comm.rank == 0:
            shutil.rmtree(part, ignore_errors=True)
    return comm.bcast(names)


def _check(path: Path, beside: Sequence[Path]) -> None:
    if path.suffix == ".bp":
        if not hasattr(io, "VTXWriter"):
            raise InputError(f"{path}: DOLFINx was built without ADIOS2; expected .xdmf.")
        if path.is_dir() and any(path.iterdir()) and not (path / _BP_INDEX).exists():
            raise InputError(f"{path}: is a folder, but none of ADIOS2; expected another name.")
    for file in (*_files(path), *beside):
        check_writable(path.parent / "file" if file.suffix == ".bp" else file, "fields")


def _files(path: Path) -> list[Path]:
    """The files that functions are written to."""
    return [path, path.with_suffix(".h5")] if path.suffix == ".xdmf" else [path]


def _part(path: Path, need: int) -> Path:
    """A new folder beside the file, for so many bytes."""
    try:
        # ADIOS2 ends the whole process if the disk becomes full.
        if (free := shutil.disk_usage(path.parent).free) < need:
            raise InputError(
                f"{path}: cannot be written: {free / 1e6:.3g} MB are free on the disk, expected "
                f"{need / 1e6:.3g} MB or more."
            )
        return Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error


def _finish(part: Path, path: Path, beside: Mapping[Path, Callable[[], str]]) -> list[Path]:
    """Complete the files in ``part`` and move them into place; on rank 0."""
    if path.suffix == ".xdmf":
        share_grid(part / path.name)
    for file, text in beside.items():
        write_text(part / file.name, text())
    files = [*_files(path), *beside]
    for file in reversed(files):  # the first last: it refers to the heavy one
        if file.is_dir():
            file.rename(part / "old")
        (part / file.name).replace(file)
    return files


def _write_vtx(fields: Sequence[fem.Function], path: Path) -> None:
    with io.VTXWriter(fields[0].function_space.mesh.comm, path, list(fields)) as writer:
        writer.write(0.0)


def _write_xdmf(fields: Sequence[fem.Function], path: Path) -> None:
    mesh = fields[0].function_space.mesh
    with io.XDMFFile(mesh.comm, path, "w") as writer:
        writer.write_mesh(mesh)
        for field in fields:
            writer.write_function(field)


#: Writers of files, by ending.
ENDINGS = {".bp": _write_vtx, ".xdmf": _write_xdmf}


def share_grid(path: Path) -> None:
    """Put all fields on the one grid: DOLFINx gives each a copy, which ParaView shows apart."""
    tree = ElementTree.parse(path)
    domain = tree.getroot().find("Domain")
    grid, *others = domain.findall("Grid")
    for other in others:
        grid.extend(other.iter("Attribute"))
        domain.remove(other)
    ElementTree.indent(tree)
    write_text(path, ElementTree.tostring(tree.getroot(), encoding="unicode") + "\n")

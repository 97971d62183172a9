"""Files of functions for ParaView: VTX by ADIOS2 (``.bp``), or XDMF with HDF5 (``.xdmf``)."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from dolfinx import fem, io
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.files import check_writable, write_text
from fenics_joints.parallel import on_root

#: What ADIOS2 puts into a folder that is one of its files.
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
        beside: What makes the text of other files, on rank 0.

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


#: What writes a file, by its ending.
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

"""Measured functions from files of any kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fenics_joints.errors import InputError
from fenics_joints.files import is_file, paths_of, shown_path
from fenics_joints.measurements.csv import read_csv
from fenics_joints.measurements.files import UFF_SUFFIXES, Contents, FileMetadata, merge
from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.measurements.mat import HDF5, read_mat
from fenics_joints.measurements.rattlesnake import read_rattlesnake
from fenics_joints.measurements.sdynpy import read_sdynpy
from fenics_joints.measurements.time_records import TimeSettings
from fenics_joints.measurements.uff import read_uff

#: What reads the functions and nodes of a file, by its ending: a format is one file and one line.
READERS: dict[str, Callable[[Path, FileMetadata], Contents]] = {
    **dict.fromkeys(UFF_SUFFIXES, read_uff),
    **dict.fromkeys((".mat", *HDF5), read_mat),
    ".nc4": read_rattlesnake,
    ".npz": read_sdynpy,
    **dict.fromkeys((".csv", ".toml"), read_csv),
}


def read_frfs(
    paths: str | Path | Sequence[str | Path],
    *,
    kind: str | None = None,
    units: str | None = None,
    length_unit: str | None = None,
    points: Mapping[str, Sequence[float]] | None = None,
    directions: Mapping[str, Sequence[float]] | None = None,
    keys: Mapping[str, str] | None = None,
    time: TimeSettings | None = None,
) -> MeasuredFRFs:
    """Read one matrix of functions from files in any order.

    - UFF (``.uff``, ``.unv``, ...; ASCII or binary; needs pyuff): functions and coherence of
      datasets 58, nodes of 15 and 2411, axes of 18 and 2420, units of 164;
      see `fenics_joints.measurements.uff`.
    - MATLAB (``.mat``) and HDF5 (``.h5``), functions or time records of forces and responses: see
      `fenics_joints.measurements.mat`.
    - CSV: a table of functions, of time records or of nodes, see `fenics_joints.measurements.csv`.

    Args:
        paths: The files; nodes may stand in other files than functions.
        kind: ``receptance``, ``mobility`` or ``accelerance``, where a file does not say.
        units: Unit of the functions, such as ``g/N``; it goes before what the files say.
        length_unit: Unit of the nodes' coordinates, where a file does not say.
        points: Coordinates of nodes, m, which replace the files'; local axes stay the files'.
        directions: Directions of nodes, where a file does not say (direction code 0).
        keys: Names of MATLAB variables that are not the usual ones.
        time: How functions are made of time records.

    Raises:
        InputError: For what is wrong in a file; names the file, the place in it and what was
            expected.
    """
    paths = paths_of(paths)
    if not paths:
        raise InputError("paths: expected one file or more")
    metadata = FileMetadata(kind, units, length_unit, keys or {}, time or TimeSettings())
    contents, seen = Contents(), set()
    for path in paths:
        if not is_file(path):
            raise InputError(f"{shown_path(path)}: no such file, expected measured FRFs")
        if path.resolve() in seen:
            raise InputError(f"{path}: is named twice, expected each file once")
        seen.add(path.resolve())
        contents.add(reader_of(path)(path, metadata))
    return merge(
        contents, points=points, directions=directions, sources=[str(path) for path in paths]
    )


def reader_of(path: Path) -> Callable[[Path, FileMetadata], Contents]:
    """What reads the functions of a file, by its ending; raises InputError for another one."""
    ending = path.suffix.lower()
    if ending in READERS:
        return READERS[ending]
    raise InputError(
        f"{path}: the ending {ending!r} is not known; expected one of {', '.join(READERS)}"
    )

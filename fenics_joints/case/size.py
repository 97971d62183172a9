"""How large the model of a case will be, and what it will cost, before anything is built."""

from __future__ import annotations

import math
import os
import re
import resource
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.case.case import Case
from fenics_joints.case.mesh import (
    MatricesMesh,
    MeshFile,
    OffsetBeamsMesh,
    OwnMesh,
    SolidMesh,
    StepMesh,
)
from fenics_joints.errors import InputError, MeshError
from fenics_joints.formatting import number
from fenics_joints.machine.control_groups import contents, control_groups
from fenics_joints.meshes.cad_survey import count_vertices

#: Files of a control group, versions 1 and 2: its limit, what it uses, and what of that in
#: `memory.stat` could be given back.
_FIRST = "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"
_SECOND = "memory.max", "memory.current", "inactive_file"


def available_bytes(root: str | Path = "/") -> float:
    """Memory that could be had without swapping: the least of the machine's and all limits'.

    ``MemAvailable`` of Linux, else all of the physical memory; the limits of the control groups
    that the process is in (version 1 or 2), as containers and batch systems set them, less what
    they hold and could not give back; and ``ulimit -v``.

    Args:
        root: Folder in which ``proc`` and ``sys`` are.
    """
    root = Path(root)
    found = [_meminfo(root / "proc/meminfo") or _physical(), *_groups(root)]
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    if soft != resource.RLIM_INFINITY:
        found.append(float(soft))
    return max(0.0, min(found))


def _meminfo(file: Path) -> float | None:
    for line in contents(file).splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable" and value.split():
            return 1024.0 * float(value.split()[0])
    return None


def _physical() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (OSError, ValueError):
        return float("inf")


def _groups(root: Path) -> Iterator[float]:
    """What each control group of this process, and those above it, leave."""
    for folder, second in control_groups(root, "memory"):
        names = _SECOND if second else _FIRST
        limit, used = (_number(contents(folder / name)) for name in names[:2])
        if limit is not None:
            yield limit - (used or 0.0) + _cached(folder, names[2])


def _cached(folder: Path, key: str) -> float:
    for line in contents(folder / "memory.stat").splitlines():
        name, _, value = line.partition(" ")
        if name == key:
            return _number(value) or 0.0
    return 0.0


def _number(text: str) -> float | None:
    return float(text) if text.strip().isdigit() else None


#: Seconds of a command's time that are no solution: Python, the mesh, compiled forms.
BEGIN = 5.0

#: Memory of twenty modes by a factorisation (MUMPS by METIS, peak of the process less what it had
#: before), kB for each degree of freedom: START[degree] + GROWTH * sqrt(nodes of the smallest cut
#: through the thickest block). Fitted, and met to 20 %: measured for lap plates of 46, 140 and 276
#: thousand (15.0, 16.7, 17.0 kB), boxes of 8, 38 and 79 thousand (17.8, 21.3, 22.6 kB), a box of
#: tetrahedra of 28 thousand (14.9 kB); of degree 1 plates of 48 and a box of 37 thousand (9.9, 15.6
#: kB); and the machine of benchmarks/README.md (16.0 kB at 408 thousand). The fronts of nested
#: dissection are as large as such cuts (George 1973), which is why it grows with them.
_START, _GROWTH = {1: 8.0, 2: 12.0}, 0.288
#: The same without a factorisation, benchmarks/README.md: 3.9 kB at 408 thousand, 4.6 at 1,169.
_ITERATIVE = 4.7
#: Python and its libraries, bytes for each rank; and how much more the ranks' parts take together
#: (7.1 GiB on two ranks, 6.3 on one).
_PROCESS, _SHARED = 0.25e9, 1.13
#: Bytes of factors that a core makes and solves with in a second where cuts have CUT nodes along
#: their sides: 32 s for 6.1 GiB on the machine of benchmarks/README.md.
_SPEED, _CUT = 190e6, 25.0
#: Degrees of freedom for each second, of the iterative method (156 s for 408 thousand).
_ITERATIVE_SPEED = 2600.0
#: Nodes of degree 2 for each of degree 1 in a mesh of tetrahedra: about seven edges meet at each.
_EDGES = 8.0
#: The same of assemblies of plates from CAD. Fitted to eleven: 5.8 to 6.6, or up to 11 with the
#: small cells of many rings.
_SURFACE = 6.5
#: Bytes of a .msh file for each vertex, where it does not say their number soon.
_MSH_BYTES = 200.0
#: Of a file's head that is read, and share of the box round an assembly that is solid.
_HEAD, _SOLID = 4_000_000, 0.4


@dataclass(frozen=True)
class CostEstimate:
    """What a case's model will cost; all of it rough.

    Attributes:
        dofs: Degrees of freedom, to about 20 % for builders; for files to a factor of two or so,
            and less where a STEP file's own detail makes smaller elements than are asked for.
        bytes: Memory of one modal solution on all ranks together.
        seconds: Its time, on a quiet machine.
    """

    dofs: float
    bytes: float
    seconds: float

    def __str__(self) -> str:
        rounded = float(f"{self.dofs:.2g}")
        dofs = f"{rounded:,.0f} degrees of freedom" if rounded < 1e15 else "1e15 and more"
        memory, time = gibibytes(self.bytes), duration(self.seconds)
        return f"about {dofs}, {memory} of memory and {time} a solution"


def estimate(case: Case, *, method: str = "direct", ranks: int = 1) -> CostEstimate:
    """What the model of a case will cost, from its numbers and the files' heads alone.

    Args:
        case: The case; for a diagnosis that of `Case.diagnosed`.
        method: ``"direct"`` or ``"iterative"``, see `fenics_joints.modal.solve_modes`.
        ranks: How many processes share it.

    Raises:
        InputError: If the builder's arguments are impossible.
    """
    mesh = case.mesh
    if isinstance(mesh, OffsetBeamsMesh):
        n = 6.0 * (sum(mesh.of("elements")) + sum(mesh.of("lap_elements")))
        return CostEstimate(n, ranks * _PROCESS + 40 * 8 * n**2, 1.0)
    if isinstance(mesh, OwnMesh):  # nothing says its size before it is made
        return CostEstimate(0.0, ranks * _PROCESS, BEGIN)
    if isinstance(mesh, MatricesMesh):
        return estimate_of(_rows(case, mesh), mesh.degree, method=method, ranks=ranks)
    if isinstance(mesh, SolidMesh):
        made = mesh.made()
        bricks = made.bricks()
        dofs = 3 * sum(_nodes(brick, mesh.degree, made.cell) for brick in bricks)
        cut = max(math.prod(sorted(mesh.degree * float(n) + 1 for n in b)[:2]) for b in bricks)
    else:
        vertices = _step_vertices(case, mesh) if isinstance(mesh, StepMesh) else _vertices(case)
        gdim = getattr(mesh, "gdim", 3)
        if getattr(mesh, "thickness", None) is not None:  # a sheet has two sides
            gdim, vertices = 3, 2 * vertices
        dofs = gdim * vertices * (_EDGES if mesh.degree == 2 else 1.0)
        cut = None  # assemblies are slender
    return estimate_of(dofs, mesh.degree, cut, method=method, ranks=ranks)


def estimate_refused(case: Case, *, ranks: int = 1) -> CostEstimate | None:
    """What a case with a STEP file would cost whose parts cannot be joined; None if it is no such.

    Its surfaces are meshed, so that details count; see `fenics_joints.meshes.cad_survey`.
    """
    mesh = case.mesh
    if not isinstance(mesh, StepMesh):
        return None
    given = {"size": mesh.size, "circle": mesh.circle or 16, "without": mesh.without or ()}
    try:
        vertices = count_vertices(case.folder / mesh.file, **given)
    except MeshError:
        return None
    # A thin body has its vertices on its surface, where fewer edges meet than inside.
    dofs = 3 * vertices * (_SURFACE if mesh.degree == 2 else 1.0)
    return estimate_of(dofs, mesh.degree, ranks=ranks)


def estimate_of(
    dofs: float, degree: int, cut: float | None = None, *, method: str = "direct", ranks: int = 1
) -> CostEstimate:
    """What a solid model will cost whose size is known.

    Args:
        dofs: Degrees of freedom.
        degree: Of the displacement.
        cut: Nodes of the smallest cut through its thickest block; None: as in slender assemblies.
        method: As of `estimate`.
        ranks: How many processes share it.
    """
    if method == "iterative":
        seconds = BEGIN + dofs / _ITERATIVE_SPEED / ranks
        return CostEstimate(dofs, ranks * _PROCESS + 1e3 * _ITERATIVE * dofs, seconds)
    cut = (dofs / 3) ** (2 / 3) / 4 if cut is None else cut
    share = 1.0 if ranks == 1 else _SHARED
    factors = 1e3 * share * dofs * (_START[degree] + _GROWTH * math.sqrt(cut))
    seconds = BEGIN + factors / _SPEED / ranks * max(1.0, math.sqrt(cut) / _CUT)
    return CostEstimate(dofs, ranks * _PROCESS + factors, seconds)


def check_size(
    case: Case, *, method: str = "direct", ranks: int = 1, hosts: int = 1, large: bool = False
) -> CostEstimate:
    """Refuse a case whose model needs more memory than the machine has.

    Args:
        case: The case.
        method: As of `estimate`.
        ranks: How many processes share it.
        hosts: On how many machines like this one.
        large: Whether to go on all the same.

    Raises:
        InputError: Says the estimate and what there is, and names the option ``--large``.
    """
    found, there = estimate(case, method=method, ranks=ranks), hosts * available_bytes()
    if large or found.bytes <= there:
        return found
    raise InputError(
        f"{case.path}: mesh: {found}, more than the {gibibytes(there)} that this machine has free; "
        "expected larger elements or fewer of them"
        + ("" if method == "iterative" else " (or modes --iterative, for modes alone)")
        + "; with --large it is tried all the same"
    )


def _nodes(brick: Iterable[float], degree: int, cell: str) -> float:
    """Nodes of a block of cells; hexahedra of degree 2 are serendipity's: corners and edges."""
    sides = [float(n) for n in brick]
    if degree == 1 or cell != "hexahedron":
        return math.prod(degree * n + 1 for n in sides)
    lines = [n + 1 for n in sides]
    along = [n * math.prod(lines[:i] + lines[i + 1 :]) for i, n in enumerate(sides)]
    return math.prod(lines) + sum(along)


#: Bytes of a row in a table of degrees of freedom, and of its part of a matrix written as text.
_ROW_BYTES, _MATRIX_BYTES = 9.0, 1400.0


def _rows(case: Case, mesh: MatricesMesh) -> float:
    """Degrees of freedom of matrices, from the size of their files."""
    total = 0.0
    for files in mesh.matrices.values():
        name, each = files.stiffness, _MATRIX_BYTES
        if files.dofs is not None:
            name, each = files.dofs, _ROW_BYTES
        path = case.folder / name
        try:
            total += path.stat().st_size / each
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    return total


def _vertices(case: Case) -> float:
    """Vertices of a .msh file, as its head says, or from its size."""
    path = case.folder / case.mesh.file
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    return min(_counted(head) or size / _MSH_BYTES, size / 8.0)


def _counted(head: bytes) -> float | None:
    """Number of vertices in the head of a .msh file: $Nodes, then it or (4.x) blocks and it."""
    version = re.search(rb"\$MeshFormat\s+(\d)[.\d]*\s+(\d)", head)
    start = head.find(b"$Nodes")
    if not version or start < 0:
        return None
    after = head[start + len(b"$Nodes") :].lstrip(b"\r")[1:]
    if version[1] == b"4" and version[2] == b"1":
        return float(struct.unpack("<4Q", after[:32])[1]) if len(after) >= 32 else None
    counts = re.match(rb"\s*(\d{1,15})(?:[ \t]+(\d{1,15}))?", after)
    return None if not counts else float(counts[2] or counts[1])


#: A point of a STEP file, and its unit of length; metres unless it says so.
_POINT = re.compile(rb"CARTESIAN_POINT\s*\([^,]{0,80},\s*\(([^()]{1,120})\)")
_UNIT = re.compile(rb"SI_UNIT\s*\(\s*(?:\.(\w+)\.|\$)\s*,\s*\.METRE\.")
_PREFIXES = {b"MILLI": 1e-3, b"CENTI": 1e-2, b"DECI": 1e-1, b"MICRO": 1e-6, b"KILO": 1e3}


def _step_vertices(case: Case, mesh: MeshFile) -> float:
    """Vertices of a STEP file meshed with elements of a size: those that the box round it holds."""
    path = case.folder / mesh.file
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    points = []
    for found in _POINT.finditer(text):
        try:
            points.append([float(c) for c in found[1].split(b",")])
        except ValueError:
            continue
    points = np.array([p for p in points if len(p) == 3 and np.all(np.isfinite(p))])
    if not len(points):
        return 0.0  # said where it is read
    unit = _UNIT.search(text)
    scale = _PREFIXES.get(unit[1], 1.0) if unit else 1e-3
    # The middle of the points: planes and axes may be placed anywhere.
    low, high = np.percentile(points, [1, 99], axis=0) * scale
    with np.errstate(over="ignore"):
        cells = (high - low) / mesh.size + 1
        return float(_SOLID * math.sqrt(2) * np.prod(cells))


def gibibytes(n_bytes: float) -> str:
    """An amount of memory."""
    return f"{number(n_bytes / 2**30, 2)} GiB"


def duration(seconds: float) -> str:
    """A time in the unit that suits it."""
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds > 2 * length:
            return f"{number(seconds / length, 2)} {unit}"
    return f"{number(seconds, 2)} s"

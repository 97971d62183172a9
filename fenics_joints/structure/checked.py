"""What a structure is put together from, checked before it is assembled."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes.tagged import TaggedMesh, limits
from fenics_joints.structure.components import Parameter, PointMass, Region, Spring
from fenics_joints.structure.laws import AXISYMMETRIC_SOLID, WIDE_SOLID

#: Most point masses, and most springs: each is a search for its cell and a block in K or M.
MOST_POINTS = 10_000


def check_components(
    owners: Sequence,
    masses: Sequence[PointMass],
    springs: Sequence[Spring],
    parameters: Mapping[str, Parameter],
) -> None:
    """Refuse names that are given twice, parameters that do not exist, and too many points.

    Args:
        owners: Components with ``properties``: regions, elastic supports, changes.
        masses: Point masses.
        springs: Grounding springs.
        parameters: Those that the components may name.

    Raises:
        InputError: Names the component.
    """
    for what, points in (("masses", masses), ("springs", springs)):
        if len(points) > MOST_POINTS:
            raise InputError(
                f"{what}: {len(points)} of them, expected at most {MOST_POINTS}; what is "
                "spread out is a part's density, or an elastic support."
            )
    for name, count in Counter(c.name for c in (*owners, *masses, *springs)).items():
        if count > 1:
            raise InputError(f"component {name} is given twice; expected unique names.")
    for owner, key, value in _values(owners, masses, springs):
        if isinstance(value, str) and value not in parameters:
            raise InputError(
                f"{owner}.{key} names the parameter {value!r}, which does not exist; "
                f"expected a number or one of: {', '.join(parameters) or 'none'}."
            )


def _values(owners, masses, springs) -> Iterator[tuple[str, str, float | str]]:
    for owner in owners:
        for key, value in owner.properties.items():
            yield owner.name, key, value
    for mass in masses:
        yield mass.name, "mass", mass.mass
        yield mass.name, "travel", mass.travel
    for spring in springs:
        yield spring.name, "stiffness", spring.stiffness


def axisymmetric_regions(tagged: TaggedMesh, regions: Sequence[Region]) -> tuple[Region, ...]:
    """Parts with their law in a body of revolution.

    Raises:
        InputError: If one has none there.
        MeshError: If the mesh is no half section.
    """
    low, high = limits(tagged)
    if tagged.mesh.geometry.dim != 2 or low[0] < -1e-9 * np.max(high - low):
        raise MeshError("axisymmetric: expected a mesh in the plane with r = x[0] >= 0 everywhere.")
    for region in regions:
        if region.is_joint:
            raise InputError(
                f"{region.name}: a thin layer is not available in an axisymmetric structure; "
                "expected parts only."
            )
        if region.law is WIDE_SOLID:
            raise InputError(
                f"{region.name}: a width is not available in an axisymmetric structure."
            )
        if region.properties["stretch"] != 1.0 and abs(region.normal[1]) != 1.0:
            raise InputError(
                f"{region.name}.normal = {list(region.normal)}: expected the axis, (0, 1), for "
                "the stretch of a part in an axisymmetric structure."
            )
    return tuple(replace(r, law=AXISYMMETRIC_SOLID) for r in regions)


def region_cells(tagged: TaggedMesh, regions: Sequence[Region]) -> list[tuple[Region, np.ndarray]]:
    """Local cells, ghosts included, of each region. Collective.

    Raises:
        MeshError: If a cell is in no region or in two.
    """
    imap = tagged.mesh.topology.index_map(tagged.mesh.topology.dim)
    count = np.zeros(imap.size_local + imap.num_ghosts, dtype=np.int32)
    found = []
    for region in regions:
        tags = [tagged.cell_tag(name) for name in region.cells]
        cells = np.sort(np.concatenate([tagged.cell_tags.find(t) for t in tags]))
        count[cells] += 1
        found.append((region, cells))
    bad = tagged.mesh.comm.allreduce(int(np.sum(count[: imap.size_local] != 1)))
    if bad:
        used = [name for region in regions for name in region.cells]
        names = tagged.cell_names
        wrong = [name for name in names if used.count(name) != 1]
        raise MeshError(
            f"{bad} cells are in no region or in more than one: "
            f"{', '.join(wrong) or 'untagged'}; expected every cell group "
            f"({', '.join(names)}) in exactly one part or joint."
        )
    return found

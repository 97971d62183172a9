"""Thickness and width of parts as parameters: where they point, and which a model can represent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.case.case import Case
from fenics_joints.case.sections import PartSection
from fenics_joints.errors import InputError, located
from fenics_joints.meshes import TaggedMesh
from fenics_joints.meshes.slender import BoxAround, box_around
from fenics_joints.structure.stretching import Stretching
from fenics_joints.structure.structure import Structure

#: Parameters of a part that are dimensions, relative to the mesh's.
_DIMENSIONS = ("thickness", "width")
#: Sine of the angle below which two directions are the same: round-off of a mesh file.
_ONE = 1e-3
_NO_PLATE = (
    "no plate or beam that is thin in one direction: its bodies are blocks, or thin in different "
    "ones; a normal of the part says what its thickness is, or a part for each body"
)
_UNFIT = (
    "no longer fits, and the model would resist being turned as a rigid body; it takes a mesh of "
    "the other dimension to see what that does"
)


def _is_guessed(case: Case, part: PartSection, tagged: TaggedMesh) -> bool:
    """Whether a part's directions are measured: its mesh is a file's, and it has no normal."""
    solid = case.mesh.origin == "file" and tagged.mesh.geometry.dim == 3
    return solid and "normal" not in part.model_fields_set


def _boxes(tagged: TaggedMesh, part: PartSection) -> list[BoxAround]:
    return [box_around(tagged, [name]) for name in part.cells]


def _directions(tagged: TaggedMesh, part: PartSection) -> np.ndarray | None:
    """Normal and across, shape (2, 3), of a part whose bodies are slender, and all alike."""
    boxes = _boxes(tagged, part)
    first = boxes[0].axes[:2]
    for box in boxes:
        sines = np.linalg.norm(np.cross(box.axes[:2], first), axis=1)
        # Of square plates the width is that of any of their edges.
        if not box.is_slender or sines[0] > _ONE:
            return None
    return first


def directed_parts(case: Case, tagged: TaggedMesh) -> Case:
    """The case with the directions of thickness and width of parts as the mesh has them.

    Where a part of an own mesh gives no ``normal``, it is that in which its bodies extend the
    least, if that is clearly less than the next; ``across`` is the middle one. Collective.

    Raises:
        InputError: If a given ``across`` is along the normal that is found.
    """
    parts = dict(case.parts)
    for name, part in case.parts.items():
        if not _is_guessed(case, part, tagged):
            continue
        found = _directions(tagged, part)
        if found is None:
            continue
        normal, across = (tuple(way.tolist()) for way in found)
        given = part.across
        if given is not None and np.linalg.norm(np.cross(given, normal)) < _ONE:
            raise InputError(
                f"{case.path}: parts.{name}.across = {list(given)}: is the direction in which the "
                "part is thinnest, which is its normal unless that is given too"
            )
        update = {"normal": normal, "across": across if given is None else given}
        parts[name] = part.model_copy(update=update)
    return case.model_copy(update={"parts": parts})


def measured_directions(case: Case, tagged: TaggedMesh) -> dict[str, tuple[tuple, tuple]]:
    """Normal and across of the parts that have them from the mesh. Collective."""
    directed = directed_parts(case, tagged).parts
    return {
        name: (directed[name].normal, directed[name].across)
        for name, part in case.parts.items()
        if directed[name] is not part
    }


def long_normals(case: Case, tagged: TaggedMesh) -> list[str]:
    """A sentence for each given normal along which its part is the longest. Collective."""
    found = []
    if tagged.mesh.geometry.dim != 3:
        return found
    for name, part in case.parts.items():
        if "normal" not in part.model_fields_set:
            continue
        n = np.asarray(part.normal) / np.linalg.norm(part.normal)
        with located(f"parts.{name}"):
            boxes = _boxes(tagged, part)
        if all(b.is_slender and abs(b.axes[2] @ n) > np.sqrt(0.5) for b in boxes):
            thin = ", ".join(f"{c:.3g}" for c in boxes[0].axes[0])
            found.append(
                f"parts.{name}.normal = {[float(f'{c:.3g}') for c in n]}: the part is longest that "
                f"way, and its thickness would stretch its length; it is thinnest along ({thin})"
            )
    return found


class Dimensions:
    """Which thicknesses and widths of a case's parts its model can represent. Collective.

    Args:
        case: The case.
        structure: Its model, with the widths as parameters if they are asked for.
        called: What the user calls regions that have other names in the model.

    Attributes:
        names: Of the parameters in question.
    """

    def __init__(self, case: Case, structure: Structure, called: Mapping[str, str] | None = None):
        self._called = called or {}
        self.names = {f"{part}.{key}" for part in case.parts for key in _DIMENSIONS}
        self._stretching = Stretching(structure)
        tagged = structure.tagged
        self._blocks = {
            name
            for name, part in case.parts.items()
            if _is_guessed(case, part, tagged) and _directions(tagged, part) is None
        }

    def reason(self, names: Sequence[str]) -> str | None:
        """Why parameters of thickness or width cannot change by one factor; None if they can.

        Args:
            names: Such as ``plate.thickness``.
        """
        for name in names:
            if name.rpartition(".")[0] in self._blocks:
                return _NO_PLATE
        if self._stretching.keeps(names):
            return None
        touched = [n for name in names for n in self._stretching.spanned(name)]
        where = ", ".join(dict.fromkeys(self._called.get(name, name) for name in touched))
        where = f"joined ({where}) on faces along that direction" if where else "joined in a ring"
        return f"{where}, where what is stretched {_UNFIT}"


class AsGiven:
    """Dimensions and Poisson's ratio of parts whose matrices are given: none can change.

    Args:
        case: The case.

    Attributes:
        names: Of the parameters in question.
    """

    def __init__(self, case: Case):
        self.names = {f"{part}.{key}" for part in case.parts for key in case.mesh.lacks}

    def reason(self, names: Sequence[str]) -> str | None:
        """Why these parameters cannot change."""
        return "the model has matrices of this part, which E and rho alone scale; it needs a mesh"


def unfit(dimensions: Dimensions | AsGiven | None, names: Sequence[str]) -> str | None:
    """`Dimensions.reason` of those names that are thicknesses and widths of parts."""
    wanted = [] if dimensions is None else [n for n in names if n in dimensions.names]
    return dimensions.reason(wanted) if wanted else None


def refuse_unfit(case: Case, structure, names: Sequence[str]) -> None:
    """Refuse parameters of thickness or width that a model cannot represent. Collective.

    Raises:
        InputError: Naming the first.
    """
    if not isinstance(structure, Structure):
        return
    asked = {f"{part}.{key}" for part in case.parts for key in _DIMENSIONS} & set(names)
    dimensions = Dimensions(case, structure) if asked else None
    for name in sorted(asked):
        reason = unfit(dimensions, [name])
        if reason is not None:
            raise InputError(f"{case.path}: update.parameters: {name}: {reason}")

"""What is to be said before data and model are believed: left out, doubtful, moved, assumed."""

from __future__ import annotations

import numpy as np

from fenics_joints.case.case import Case
from fenics_joints.structure import Structure

__all__ = ["test_notes"]

#: A sensor that was moved less, m, stood where the mesh ends, but for the digits of its file.
_MOVED = 1e-6


def test_notes(case: Case, model: object) -> tuple[str, ...]:
    """Sentences on the files of the test, on sensors moved onto the mesh, on joints. Collective.

    Args:
        case: The case.
        model: The case's model; of one that has no mesh no sensor is moved.
    """
    notes, sensors = [*case.test_notes(), *case.joint_notes()], case.sensors()
    structure = getattr(model, "structure", model)
    if not isinstance(structure, Structure):
        return tuple(notes)
    notes += structure.tagged.notes
    if sensors is None:
        return tuple(notes)
    moved = structure.rows(sensors.points, "sensor", sensors.names).moved
    count, far = int(np.sum(moved > _MOVED)), int(np.argmax(moved))
    if count:
        name = f" ({sensors.names[far]})" if sensors.names else ""
        were = "was" if count == 1 else "were"
        notes.append(
            f"{count} of {len(sensors)} sensors stood beside the mesh and {were} moved onto it, "
            f"the farthest{name} by {1e3 * moved[far]:.3g} mm"
        )
    return tuple(notes)


#: Not a test, whatever pytest thinks of the name.
test_notes.__test__ = False

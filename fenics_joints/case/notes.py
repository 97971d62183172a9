"""Notes on data and model: what was left out, doubted, moved or assumed."""

from __future__ import annotations

import numpy as np

from fenics_joints.case.case import Case
from fenics_joints.structure import Structure

#: Prefix of a note on the model; other notes are on the test.
OF_MODEL = "model: "

#: A sensor that was moved less, m, stood where the mesh ends, but for the digits of its file.
_MOVED = 1e-6
_NO_SENSORS = (
    "the places and directions of its sensors are not given ([test.sees], points and direction): "
    "its modes are taken as the model's lowest, in order of frequency and without their shapes"
)


def test_notes(case: Case, model: object) -> tuple[str, ...]:
    """Sentences on the files of the test, on sensors moved onto the mesh, on joints. Collective.

    Args:
        case: The case.
        model: The case's model; of one that has no mesh no sensor is moved.
    """
    own = case.test_notes(by_amplitude=False)
    notes = [*own, *(f"{OF_MODEL}{note}" for note in case.joint_notes())]
    sensors = case.sensors()
    structure = getattr(model, "structure", model)
    if not isinstance(structure, Structure):
        return tuple(notes)
    notes += [f"{OF_MODEL}{note}" for note in structure.tagged.notes]
    if sensors is None:
        blind = case.measured is not None and structure.tagged.mesh.geometry.dim == 3
        return (*notes, _NO_SENSORS) if blind else tuple(notes)
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


def labelled(note: str) -> str:
    """A note with its subject, model or test, as a terminal shows it."""
    return note if note.startswith(OF_MODEL) else f"test: {note}"


#: Not a test, whatever pytest thinks of the name.
test_notes.__test__ = False

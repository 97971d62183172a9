"""The ``diagnose`` command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import Case
from fenics_joints.case.check_structure import refuse_applied
from fenics_joints.case.notes import OF_MODEL
from fenics_joints.commands.diagnose.document import diagnosis_document
from fenics_joints.commands.outcome import Outcome
from fenics_joints.diagnosis import Diagnosis, diagnose
from fenics_joints.formatting import percent, quantity, spaced
from fenics_joints.measurements.data import TestData
from fenics_joints.progress import Progress


def run_diagnose(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    keep: Path | None = None,
    effects: Sequence[str] | None = None,
) -> Outcome[Diagnosis]:
    """Where a case's model is wrong, which effect causes it, how far the error shrinks. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        keep: Folder of the reduced model, which the next run takes.
        effects: In place of ``[diagnose] effects``.

    Raises:
        JointsError: If the case, the mesh or a solution fails.
    """
    refuse_applied(case, "diagnose")
    case = case.looking_for(effects)
    found, data = diagnose(case, comm, progress, keep=keep), case.diagnosed_test()
    assumed = assumptions(case, data)
    for note in found.model.get("notes", ()):
        of = "of the model" if note.startswith(OF_MODEL) else "of the test's data"
        assumed.append((of, note.removeprefix(OF_MODEL)))
    return Outcome(found, diagnosis_document(found, log_sd=data.log_sd(), assumed=assumed))


def assumptions(case: Case, data: TestData) -> list[tuple[str, str]]:
    """Names and values of what ``[test]``, ``[diagnose]`` and the tolerances say.

    Args:
        case: The case.
        data: Its test.
    """
    given = case.diagnose
    rows = [
        *_noise(data),
        ("model error (discrepancy), the same at all conditions", percent(given.discrepancy)),
    ]
    if data.shapes is not None:
        rows.append(
            ("model error of a component of a mode shape", percent(given.shape_discrepancy, 1))
        )
    if not data.by_level:
        scatter = percent(given.preload_scatter, 0)
        rows.append(("scatter of the preload at a given torque", scatter))
    effects = "all that the case has" if given.effects is None else ", ".join(given.effects)
    return [
        *rows,
        ("joints of the baseline model", _JOINTS[given.joints]),
        ("effects that may act together", f"up to {given.max_effects}"),
        ("effects that were considered", effects),
        *_tolerances(case),
    ]


_JOINTS = {
    "bonded": "bonded to the parts: no stiffness is assumed",
    "given": "with the stiffness that the case gives",
}


def _noise(data: TestData) -> Iterator[tuple[str, str]]:
    noise = sorted({float(x) for x in np.atleast_1d(data.noise)})
    yield "noise of a frequency", " to ".join(percent(x, 3) for x in dict.fromkeys(noise))
    lines = sorted({float(x) for x in np.atleast_1d(data.resolution_hz) if x})
    if lines:
        yield "line spacing of the analyser", ", ".join(quantity(x, "Hz") for x in lines)
    if data.damping is not None and data.damping_noise is not None:
        yield "noise of a damping ratio", percent(data.damping_noise, 1)
    if data.shapes is not None:
        yield "noise of a component of a mode shape", percent(data.shape_noise, 1)


def _tolerances(case: Case) -> Iterator[tuple[str, str]]:
    words: dict[str, list[str]] = {}
    for parameter, sd in case.tolerances().items():
        owner, _, key = parameter.rpartition(".")
        if sd:
            words.setdefault(owner, []).append(f"{key} {percent(sd, 1)}")
    for owner, each in words.items():
        yield f"{spaced(owner)} known within (one s.d.)", ", ".join(each)

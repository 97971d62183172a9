"""The model that chains were made with, in a file beside them: a second run does not prepare it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.bayes.model import Frequencies, ReducedCheck
from fenics_joints.reduction import ArrayModel, BatchPrediction, ModalPrediction
from fenics_joints.reduction.files import read_model, register, write_model
from fenics_joints.structure.points import Sensors

_FORMAT = "fenics_joints sampled model"


@dataclass(frozen=True)
class KeptLean:
    """What stands in the file.

    Attributes:
        model: The lean model.
        n_test: Of its forward; so are the next two.
        n_modes: See `ModalPrediction`.
        reference: See `ModalPrediction`.
        error: Of its frequencies against the reduced model.
        check: Against the full model.
        bound: Estimated error.
    """

    model: ArrayModel
    n_test: int
    n_modes: int
    reference: np.ndarray | None
    error: float
    check: ReducedCheck
    bound: float


register(KeptLean, ReducedCheck)


def write_lean(
    path: Path, name: str, frequencies: Frequencies, check: ReducedCheck, bound: float
) -> None:
    """Write a small model, whole or not at all; on one rank.

    Args:
        path: The file.
        name: What it depends on, see `fenics_joints.case.fingerprint`.
        frequencies: Of a `fenics_joints.reduction.prediction.BatchPrediction`.
        check: Against the full model.
        bound: Estimated error.

    Raises:
        InputError: If it cannot be written.
    """
    forward = frequencies.forward
    kept = KeptLean(
        forward.model,
        forward.n_test,
        forward.n_modes,
        forward.reference,
        frequencies.error,
        check,
        bound,
    )
    write_model(kept, path, _FORMAT, name)


def read_lean(
    path: Path, name: str, sensors: Sensors | None
) -> tuple[Frequencies, ReducedCheck, float]:
    """Read the model that `write_lean` wrote under this name.

    Args:
        path: The file.
        name: What the model depends on now.
        sensors: What the test saw.

    Raises:
        InputError: See `fenics_joints.reduction.files.read_model`.
    """
    kept = read_model(path, _FORMAT, KeptLean, name)
    forward = ModalPrediction(kept.model, sensors, kept.n_test, kept.n_modes, kept.reference)
    lean = BatchPrediction(forward, kept.model)
    return Frequencies(tuple(kept.model.parameters), lean, {}, kept.error), kept.check, kept.bound

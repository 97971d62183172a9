"""The model that chains were made with, in a file beside them: a second run does not prepare it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import h5py
import numpy as np

from fenics_joints.bayes.model import Frequencies, ReducedCheck
from fenics_joints.errors import InputError
from fenics_joints.reduction.batch import LeanForward
from fenics_joints.reduction.files import read_array_model, write_array_model
from fenics_joints.reduction.forward import Forward
from fenics_joints.structure.points import Sensors

__all__ = ["read_lean", "write_lean"]

_KEY = "sampled"


def write_lean(
    path: Path, name: str, frequencies: Frequencies, check: ReducedCheck, bound: float
) -> None:
    """Write a small model, whole or not at all; on one rank.

    Args:
        path: The file.
        name: What it depends on, see `fenics_joints.case.fingerprint`.
        frequencies: Of a `fenics_joints.reduction.batch.LeanForward`.
        check: Against the full model.
        bound: Estimated error.

    Raises:
        InputError: If it cannot be written.
    """
    forward = frequencies.forward
    said = {
        "name": name, "bound": bound, "lean_error": frequencies.error,
        "check": {**asdict(check), "errors": check.errors.tolist()},
        "n_test": forward.n_test, "n_modes": forward.n_modes,
        "reference": None if forward.reference is None else np.asarray(forward.reference).tolist(),
    }  # fmt: skip
    write_array_model(forward.model, path)
    try:
        with h5py.File(path, "a") as file:
            file.attrs[_KEY] = json.dumps(said)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from error


def read_lean(
    path: Path, name: str, sensors: Sensors | None
) -> tuple[Frequencies, ReducedCheck, float] | None:
    """What `write_lean` wrote under this name; None if there is none or it is of another one.

    Args:
        path: The file.
        name: What the model depends on now.
        sensors: What the test saw.
    """
    said = _said(path)
    if said is None or said.get("name") != name:
        return None
    try:
        model = read_array_model(path)
    except InputError:
        return None
    reference = None if said["reference"] is None else np.array(said["reference"])
    forward = Forward(model, sensors, said["n_test"], said["n_modes"], reference)
    check = ReducedCheck(**{**said["check"], "errors": np.array(said["check"]["errors"])})
    frequencies = Frequencies(
        tuple(model.parameters), LeanForward(forward, model), {}, said["lean_error"]
    )
    return frequencies, check, said["bound"]


def _said(path: Path) -> Mapping | None:
    if not path.is_file():
        return None
    try:
        with h5py.File(path, "r") as file:
            return json.loads(file.attrs[_KEY])
    except (OSError, KeyError, ValueError):
        return None

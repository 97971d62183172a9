"""Finished fits in a file, so that a diagnosis that was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.errors import InputError
from fenics_joints.files import json_digest, open_own

__all__ = ["KeptFits"]

#: Of how fits are found and in which order their parameters stand: those of an earlier way may
#: stand in a valley that the present one leaves.
_WAY = 6


class KeptFits:
    """Where each hypothesis' fit ended, one JSON line for each.

    Lines left unfinished by a stopped run, or with a wrong checksum, are skipped, and a hypothesis'
    last line counts. The file is named by a hash of the test, its errors and the nominal model, so
    that fits to other data are never used.

    Args:
        folder: Where the file stands; None to keep nothing.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        writes: Whether this rank writes.
        made: Digest of all that made the model.

    Attributes:
        reason: Why nothing is taken from the file, nor kept in it, though it is there; else empty.
    """

    def __init__(
        self, folder: Path | None, evidence: Evidence, baseline: Mapping[str, float], writes: bool,
        made: str = "",
    ):  # fmt: skip
        self._path, self._writes, self.reason = None, writes, ""
        self._known: dict[str, np.ndarray] = {}
        if folder is None:
            return
        data = np.nan_to_num(evidence.data, nan=-1.0).tobytes()
        errors = np.round(evidence.full_covariance(), 12).tobytes()
        words = json.dumps([_WAY, dict(baseline), evidence.conditions.tolist(), made])
        name = hashlib.sha256(data + errors + words.encode()).hexdigest()[:16]
        self._path = Path(folder) / f"fits-{name}.jsonl"
        if not os.path.lexists(self._path):
            return
        try:
            if self._path.is_symlink() or not self._path.is_file():
                raise InputError(f"{self._path}: is a link or a folder; expected a file")
            with open_own(self._path) as file:
                self._known = dict(_lines(file))
        except (InputError, OSError) as error:
            self.reason = str(error)

    def start(self, label: str, size: int) -> list[np.ndarray]:
        """Where a fit ended before, in a list; empty if it was not done."""
        z = self._known.get(label)
        return [z] if z is not None and len(z) == size else []

    def add(self, fits: Mapping[str, np.ndarray]) -> None:
        """Keep these: z by the hypothesis' label."""
        new = {
            label: z for label, z in fits.items() if not np.array_equal(self._known.get(label), z)
        }
        self._known |= new
        if self._path is None or not self._writes or self.reason or not new:
            return
        lines = [_line(label, list(map(float, z))) for label, z in new.items()]
        try:
            with open(self._path, "a", encoding="utf-8", opener=_opened) as file:
                # The first newline ends a line that a stopped run left unfinished.
                file.write("\n" + "\n".join(lines) + "\n")
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written ({error})") from error


def _opened(path: str, flags: int) -> int:
    """Nobody else may write to it, whatever the mask, nor put a link to another file there."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o644)


def _line(label: str, z: list[float]) -> str:
    return json.dumps({"label": label, "z": z, "checksum": json_digest([label, z])[:16]})


def _lines(file: Iterable[bytes]) -> Iterator[tuple[str, np.ndarray]]:
    for line in file:
        line = line.decode(errors="replace").rstrip("\n")
        try:
            item = json.loads(line)
            if _line(item["label"], item["z"]) != line:
                continue
            label, z = str(item["label"]), np.array(item["z"], dtype=float)
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
        if z.ndim == 1 and np.all(np.isfinite(z)):
            yield label, z

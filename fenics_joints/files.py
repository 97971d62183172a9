"""Files that are either whole or not there."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError

__all__ = ["check_writable", "json_text", "plain", "write_arrays", "write_text"]


def check_writable(path: str | Path, what: str) -> Path:
    """Raise before the work starts if a file could not be written after it.

    Args:
        path: The file to be.
        what: Name of the option, for the message.

    Raises:
        InputError: If the folder does not exist or cannot be written to, or the path is a folder.
    """
    path = Path(path)
    folder = path.parent
    if not folder.is_dir():
        raise InputError(f"{what} {path}: no folder {folder}; expected one that exists")
    if path.is_dir():
        raise InputError(f"{what} {path}: is a folder; expected the name of a file")
    if not os.access(path if _is_stream(path) else folder, os.W_OK):
        raise InputError(f"{what} {path}: {folder} cannot be written to; expected one that can")
    return path


@contextmanager
def replaced(path: str | Path) -> Iterator[Path]:
    """A temporary sibling to write to, which takes the file's place at the end, or is not there.

    Raises:
        InputError: If it cannot be written; what was there before is still there.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be written ({reason})") from error
    finally:
        part.unlink(missing_ok=True)


def write_arrays(path: str | Path, **arrays: np.ndarray) -> None:
    """Write arrays to an .npz file, whole or not at all.

    Raises:
        InputError: If it cannot be written.
    """
    with replaced(path) as part, part.open("wb") as file:
        np.savez(file, **arrays)


def write_text(path: str | Path, text: str) -> None:
    """Write a file through a temporary sibling, so that no reader ever sees a part of it.

    Raises:
        InputError: If it cannot be written; what was there before is still there.
    """
    path = Path(path)
    if not _is_stream(path):
        with replaced(path.resolve()) as part:  # a link stays a link
            with part.open("w", encoding="utf-8") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


def json_text(content: Mapping[str, object]) -> str:
    """Text of JSON; raises ValueError for nan or infinity, which JSON does not have."""
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value):
    """Nested values as JSON has them: lists, Python's numbers, None for what is no number."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def _is_stream(path: Path) -> bool:
    """A pipe or a device, such as /dev/stdout: nothing to rename."""
    return path.exists() and not path.is_file() and not path.is_dir()

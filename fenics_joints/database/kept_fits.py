"""Fits beside the database they were made from: a query then does not wait for a new one.

The file is written whole or not at all, is taken only for the very rows it was made from, and may
be deleted. A folder that cannot be written to has none.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fenics_joints.database.kriging import FORMAT, Kriging
from fenics_joints.database.store import Store
from fenics_joints.errors import InputError
from fenics_joints.files import json_digest, json_text, open_own, write_text

_FORMAT = "fenics-joints fits"
#: Of one file; those of other models, or of rows that are no more, make room.
_MOST = 8


def fitted(
    store: Store, x: np.ndarray, y: np.ndarray, inputs: Sequence[str], output: str
) -> Kriging:
    """The fit that is kept beside a database, or a new one, which is kept then.

    Args:
        store: The database; one in memory keeps nothing.
        x: Sample points, as `Kriging.fit` takes them.
        y: Values.
        inputs: Names of the columns.
        output: Name of the output.

    Raises:
        InputError: As `Kriging.fit` does.
    """
    kept_here = store.path != ":memory:"
    key, kept = _digest(x, y, inputs, output), _read(store.fits, kept_here)
    try:
        kriging = Kriging.from_json(kept[key])
        if _digest(kriging.x, kriging.y, kriging.inputs, kriging.output) == key:
            return kriging
    except (KeyError, InputError):
        pass
    kriging = Kriging.fit(x, y, inputs=inputs, output=output)
    if kept_here:
        others = [item for item in kept.items() if item[0] != key][1 - _MOST :]
        try:
            write_text(store.fits, _text({**dict(others), key: kriging.to_json()}), own=True)
        except (InputError, ValueError):
            pass  # nobody asked for the file
    return kriging


def fits_text(*fits: Kriging) -> str:
    """What is kept of some fits."""
    return _text({_digest(k.x, k.y, k.inputs, k.output): k.to_json() for k in fits})


def _text(fits: dict[str, object]) -> str:
    return json_text({"format": _FORMAT, "fits": fits})


def _read(path: Path | None, own: bool) -> dict[str, object]:
    """Kept fits by digest; none if the file is not there, is damaged, something else, or, with a
    word, others could have changed one that has to be this user's own."""
    if path is None or not path.is_file():
        return {}
    try:
        with open_own(path) if own else path.open("rb") as file:
            content = json.load(file)
    except InputError as error:
        logging.getLogger(__name__).warning("%s; fitting anew", error)
        return {}
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        return {}
    fits = content.get("fits")
    return fits if isinstance(fits, dict) else {}


def _digest(x: np.ndarray, y: np.ndarray, inputs: Sequence[str], output: str) -> str:
    """Of the rows with all their digits, and of how they are fitted."""
    content = [*FORMAT, list(inputs), output, np.asarray(x).tolist(), np.asarray(y).tolist()]
    return json_digest(content)

"""STEP files drawn with gmsh, with the names that a CAD program gives to solids."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path


def write_step(path: Path, draw: Callable, labels: Sequence[str] = ()) -> Path:
    """Write what a function draws. gmsh is initialised and finalised, so no model may be open.

    gmsh gives products numbers in the place of names; the names are put into the file's text.

    Args:
        path: The file; lengths are in millimetres.
        draw: Called with ``gmsh.model.occ``.
        labels: Names of the solids, in the order of their tags.
    """
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("drawn")
    draw(gmsh.model.occ)
    gmsh.model.occ.synchronize()
    gmsh.write(str(path))
    gmsh.finalize()
    text = path.read_text(encoding="utf-8")
    for number, label in enumerate(labels, start=1):
        (old,) = {
            name for name in re.findall(r"PRODUCT\('([^']*)'", text) if name.endswith(f".{number}")
        }
        text = text.replace(f"'{old}'", f"'{label}'")
    path.write_text(text, encoding="utf-8")
    return path

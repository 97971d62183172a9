"""An empty model of gmsh's Python module that leaves a caller's own gmsh as it was."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fenics_joints.errors import MeshError
from fenics_joints.meshes.gmsh_apart import NO_GMSH


@contextmanager
def gmsh_model(path: str | Path, options: Mapping[str, float | str] | None = None) -> Iterator:
    """A fresh current model, removed afterwards; a model and options of the caller's stay.

    Args:
        path: The file that is to be read, for messages.
        options: gmsh's options by name while the model lives; nothing is printed.

    Yields:
        ``gmsh.model``.

    Raises:
        MeshError: gmsh's Python module is not installed.
    """
    try:
        import gmsh
    except ImportError as error:
        raise MeshError(f"{path}: {NO_GMSH}") from error
    ours = not gmsh.isInitialized()
    if ours:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    before = None if ours else gmsh.model.getCurrent()
    kept = {}
    for name, value in {"General.Terminal": 0, **(options or {})}.items():
        text = isinstance(value, str)
        kept[name] = (gmsh.option.getString if text else gmsh.option.getNumber)(name)
        _set(gmsh, name, value)
    gmsh.model.add("fenics_joints")
    try:
        yield gmsh.model
    finally:
        gmsh.model.remove()
        for name, value in kept.items():
            _set(gmsh, name, value)
        if ours:
            gmsh.finalize()
        else:
            gmsh.model.setCurrent(before)


def _set(gmsh, name: str, value: float | str) -> None:
    (gmsh.option.setString if isinstance(value, str) else gmsh.option.setNumber)(name, value)

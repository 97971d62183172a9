"""gmsh in a separate process, for files from others.

Of STEP and .msh files with a few changed numbers up to a half make gmsh or OpenCASCADE crash, and
with it the whole program, on all ranks. Here a crash, an endless loop or a demand for all memory
ends only that process, and becomes a `MeshError`.

What is in a ``.msh`` file comes from that process. Shapes of a STEP file cannot be handed over: one
that could be read here, with areas and boxes of its faces, is read again in the program, which then
cuts and meshes the shapes. What goes wrong there alone ends the program.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from fenics_joints.errors import MeshError

#: Message if gmsh's Python module is missing.
NO_GMSH = (
    "reading it needs gmsh's Python module, expected python3-gmsh (Debian) "
    "or python-gmsh (conda) to be installed"
)
#: Most seconds that reading may take, and more for each byte of the file. Chosen: far above what
#: sound files take.
_SECONDS, _SECONDS_A_BYTE = 60.0, 1e-4
#: Most bytes of memory, and more for each byte of the file. Chosen likewise.
_MEMORY, _MEMORY_A_BYTE = 4 << 30, 300
_CHILDREN = {
    name: Path(__file__).with_name(f"{name}_child.py").resolve() for name in ("gmsh", "deck")
}


def run_apart(folder: Path, file: str, size: int, child: str = "gmsh") -> None:
    """Run ``gmsh_child.py``, or another child, which reads a file and writes what is in it.

    Args:
        folder: A private folder, where it runs and writes.
        file: What it reads, in the folder: ``"mesh.msh"``, or a STEP file of another name.
        size: Bytes of the file.
        child: ``"gmsh"``, or ``"deck"`` for decks of other codes.

    Raises:
        MeshError: gmsh is not installed, refuses the file, crashes on it or takes too long.
    """
    if child == "gmsh" and find_spec("gmsh") is None:
        raise MeshError(NO_GMSH)
    reader = "gmsh" if child == "gmsh" else "the reader of decks"
    # Isolated: nothing is imported from the user's working folder.
    where, most = [each for each in sys.path if each], _MEMORY + _MEMORY_A_BYTE * size
    script = _CHILDREN[child]
    command = [sys.executable, "-I", str(script), json.dumps(where), str(most), file]
    command.append(str(script.parent))
    # Without MPI's variables, or the process would take itself for a rank.
    mine = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMI", "MPI"))}
    mine["HOME"] = str(folder)
    nowhere, limit = subprocess.DEVNULL, _SECONDS + _SECONDS_A_BYTE * size
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=mine,
            timeout=limit,
            check=False,
            stdin=nowhere,
            stdout=nowhere,
            stderr=subprocess.PIPE,
        )
    except subprocess.TimeoutExpired:
        raise MeshError(f"{reader} was still reading it after {limit:.0f} s") from None
    refused = folder / "error.txt"
    if refused.exists():
        words = refused.read_text(encoding="utf-8", errors="replace")[:300]
        raise MeshError(f"{reader} cannot read it: {words or 'no reason is given'}")
    if done.returncode < 0:
        how = signal.Signals(-done.returncode).name
        raise MeshError(f"{reader} crashes on it ({how}); expected an undamaged file")
    if done.returncode:
        words = done.stderr.decode(errors="replace").strip().rpartition("\n")[2][:300]
        raise MeshError(f"{reader} cannot read it: {words}")


@contextmanager
def gmsh_model(options: Mapping[str, float | str]) -> Iterator:
    """A fresh current model, removed afterwards; a model and options of the caller's stay.

    Args:
        options: gmsh's options by name while the model lives; nothing is printed.

    Yields:
        ``gmsh.model``.

    Raises:
        MeshError: gmsh's Python module is not installed.
    """
    try:
        import gmsh
    except ImportError as error:
        raise MeshError(NO_GMSH) from error
    ours = not gmsh.isInitialized()
    if ours:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    before = None if ours else gmsh.model.getCurrent()
    kept = {}
    for name, value in {"General.Terminal": 0, **options}.items():
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

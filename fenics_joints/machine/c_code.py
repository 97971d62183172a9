"""C code compiled for this machine when first used, and kept in the user's cache folder."""

from __future__ import annotations

import errno
import hashlib
import importlib.util
import os
import platform
import sys
import tempfile
from functools import cache
from pathlib import Path

import cffi

from fenics_joints.machine import form_cache
from fenics_joints.machine.imports import without_local_settings
from fenics_joints.machine.private import cache_folder

# Without traps both sides of a conditional may be computed, and so elements side by side.
_FLAGS = ["-O3", "-fno-math-errno", "-fno-trapping-math"]
# Sums over quadrature points in any order, and products that are rounded with their sums.
_SUMS = ["-fno-signed-zeros", "-fassociative-math", "-ffp-contract=fast"]
_CPU = Path("/proc/cpuinfo")


def compiled(source: str, declarations: str, what: str):
    """The compiled module of a source, from the cache or through cffi: has ``ffi`` and ``lib``.

    Args:
        source: C.
        declarations: Of the functions to call.
        what: Begins the file's name.

    Raises:
        OSError: It could not be compiled, or written.
    """
    flags, cpu = _machine()
    text = "".join([source, declarations, *flags, cpu, sys.version, cffi.__version__])
    name = f"{what}_{hashlib.sha256(text.encode()).hexdigest()[:24]}"
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = cache_folder(Path(root) / "fenics_joints" / "c_code")
    found = list(folder.glob(f"{name}.*"))
    return _load(name, found[0] if found else _build(name, source, declarations, folder, flags))


@cache
def form_options() -> dict[str, list[str]]:
    """DOLFINx's ``jit_options`` by which an element's matrix takes a third of the time."""
    flags, cpu = _machine()
    # So that it is in the form's name in the cache, as all options are.
    machine = f"-DMACHINE_{hashlib.sha256(cpu.encode()).hexdigest()[:24]}"
    return {"cffi_extra_compile_args": [*flags, *_SUMS, machine]}


def _machine() -> tuple[list[str], str]:
    """Compiler flags for this machine, and what tells it from others that share the cache."""
    if platform.machine() != "x86_64" or not _CPU.is_file():
        return _FLAGS, platform.machine()
    lines = _CPU.read_text(encoding="utf-8", errors="replace").splitlines()
    return [*_FLAGS, "-march=native"], next((s for s in lines if s.startswith("flags")), "")


def _build(name: str, source: str, declarations: str, folder: Path, flags: list[str]) -> Path:
    form_cache.tell()
    ffi = cffi.FFI()
    ffi.cdef(declarations)
    ffi.set_source(name, source, extra_compile_args=flags)
    with tempfile.TemporaryDirectory(dir=folder) as scratch, without_local_settings():
        try:
            built = Path(ffi.compile(tmpdir=scratch))
        except cffi.VerificationError as error:
            said = f"cannot be compiled, expected a C compiler: {error}"
            raise OSError(errno.ENOEXEC, said, f"{name}.c") from error
        # Whole or not there, whoever else compiles the same code at this moment.
        return built.replace(folder / built.name)


def _load(name: str, path: Path):
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

"""Compiled forms: each in a folder of its own, which is whole or not there.

DOLFINx keeps all forms in one folder, where a source without its library means that somebody
compiles it. If that somebody was killed, every later run waits for it and fails, until the source
is removed by hand; and to remove it while somebody does compile it breaks theirs. Here a form is
compiled in a folder that nobody else knows, which takes its name when it is whole: a rename does
that on local and on network file systems. Locks only spare two processes the same work; a file
system without them costs time and nothing else.

A form is a library, and loading it runs its code. A cache that other users can write to is not
used. The ``fenics-joints`` command takes no settings of DOLFINx, FFCx and
setuptools from the working folder, which may be a stranger's, see `fenics_joints.machine.imports`.
"""

from __future__ import annotations

import fcntl
import functools
import logging
import os
import shutil
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import dolfinx.jit
import ffcx
import ffcx.naming

from fenics_joints.machine.imports import without_local_settings
from fenics_joints.machine.private import cache_folder, folder_of_process

#: Name of the folder beside DOLFINx's own files, which users' settings of DOLFINx move.
_FOLDER = "fenics_joints"
#: Age, s, at which an unfinished folder is removed: no form takes a day to compile.
_ABANDONED = 86400.0
#: What a library that is not whole raises when it is loaded, and DOLFINx when files are missing.
_DAMAGED = (ImportError, OSError, TimeoutError)

#: Folders of the forms that this process could not put into the cache.
_own: dict[str, Path] = {}
#: See `install`.
_told: list[Callable[[], None]] = []


def install(*told: Callable[[], None]) -> None:
    """Let DOLFINx take compiled forms from here, in this process; again does nothing.

    Args:
        told: Called before forms or C code are compiled that were not kept.
    """
    _told.extend(told)
    decorated = dolfinx.jit.ffcx_jit
    if getattr(decorated, "whole_folders", False):
        return
    compiled = decorated.__wrapped__

    @functools.wraps(compiled)
    def cached(ufl_object, form_compiler_options=None, jit_options=None):
        with without_local_settings():
            options = dolfinx.jit.get_options(jit_options)
            key = _key(ufl_object, form_compiler_options, options)

        def at(folder: Path):
            handlers = logging.getLogger().handlers.copy()
            try:
                with without_local_settings():
                    # A folder with its name is whole: nobody is waited for to fill it.
                    own = {**options, "cache_dir": folder, "timeout": 1}
                    return compiled(ufl_object, form_compiler_options, own)
            finally:  # FFCx leaves the log to itself when a compiler fails
                logging.getLogger().handlers = handlers

        return _found(key, cache_folder(Path(options["cache_dir"]) / _FOLDER), at)

    dolfinx.jit.ffcx_jit = dolfinx.jit.mpi_jit_decorator(cached)
    dolfinx.jit.ffcx_jit.whole_folders = True


def tell() -> None:
    """Call what was given to `install`."""
    for call in _told:
        call()


def _key(ufl_object, form_compiler_options, options: dict) -> str:
    """Tells all apart that are compiled to different libraries, as FFCx does."""
    tag = str(sorted(ffcx.get_options(form_compiler_options).items()))
    tag += str(sorted((k, v) for k, v in options.items() if k not in ("cache_dir", "timeout")))
    tag += str([sysconfig.get_config_var(name) for name in ("CFLAGS", "SOABI")])
    return ffcx.naming.compute_signature([ufl_object], tag)


def _found(key: str, cache: Path, at: Callable[[Path], tuple]) -> tuple:
    """A form from its folder, which is made where it is not there or its files are damaged."""
    folder = _own.get(key, cache / key)
    if folder.is_dir():
        try:
            return at(folder)
        except _DAMAGED:
            shutil.rmtree(folder, ignore_errors=True)
    try:
        return _made(key, cache, at)
    except Exception as error:
        # No place, no right to write, no space, or a compiler that says so in its own words.
        return _made_for_us(key, cache, at, error)


def _made(key: str, cache: Path, at: Callable[[Path], tuple]) -> tuple:
    folder = cache / key
    with _locked(cache / f"{key}.lock"):
        if folder.is_dir():  # made while we waited
            return at(folder)
        tell()
        _sweep(cache)
        scratch = Path(tempfile.mkdtemp(prefix=".", dir=cache))
        try:
            result = at(scratch)
            _settle(scratch)
            with suppress(OSError):  # another was first, where there are no locks
                scratch.rename(folder)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    return result


def _made_for_us(key: str, cache: Path, at: Callable[[Path], tuple], reason: Exception) -> tuple:
    """In a folder for this process alone, with a warning; what was wrong if that fails too."""
    folder = folder_of_process()
    try:
        result = at(folder)
    except Exception:
        raise reason from None  # the form's fault
    if not _own:
        line = str(reason).strip().splitlines()[-1:] or [type(reason).__name__]
        # Not as a Python warning: setuptools, which compiles, sends these to a log without readers.
        logging.getLogger(__name__).warning(
            "%s: compiled forms cannot be kept there (%s); every run compiles them anew. Set "
            "XDG_CACHE_HOME to a folder that can be written to",
            cache,
            line[0],
        )
    _own[key] = folder
    return result


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Alone with this name, where the file system has locks; freed if the process dies."""
    with path.open("w") as file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink()


def _settle(folder: Path) -> None:
    """Bring files to the disk before their folder's name, and leave out what is not needed."""
    for path in folder.iterdir():
        if path.suffix == ".o":
            path.unlink()
            continue
        with path.open("rb") as file:
            os.fsync(file.fileno())


def _sweep(cache: Path) -> None:
    """Remove folders of processes that were killed."""
    now = time.time()
    for path in cache.glob(".*"):
        with suppress(OSError):
            if now - path.stat().st_mtime > _ABANDONED:
                shutil.rmtree(path)

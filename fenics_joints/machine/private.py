"""Folders that nobody else can change, for files that are loaded as code; and empty folders."""

from __future__ import annotations

import atexit
import grp
import logging
import os
import pwd
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

#: Owner, in a container that knows some users only, of what belongs to all others, root of the host
#: among them; and the number in a list of all users.
_UNKNOWN, _ALL = 65534, "4294967295"


@contextmanager
def empty_folder() -> Iterator[None]:
    """Work in an empty folder, so that no settings are read from the user's working folder."""
    before = os.open(os.curdir, getattr(os, "O_PATH", os.O_RDONLY))
    try:
        with tempfile.TemporaryDirectory(prefix="fenics_joints_") as empty:
            os.chdir(empty)
            try:
                yield
            finally:
                os.fchdir(before)
    finally:
        os.close(before)


@lru_cache
def cache_folder(path: Path) -> Path:
    """`private_folder`; else, with a word, one of this user among the machine's temporary files, as
    where a group can write to all of a project's folders; else one for this process alone."""
    log = logging.getLogger(__name__)
    try:
        return private_folder(path)
    except OSError as error:
        reason = error.strerror or error
    with suppress(OSError):
        own = Path(tempfile.gettempdir()) / f"fenics_joints_{os.geteuid()}" / path.name
        folder = private_folder(own)
        log.info("%s: is not used (%s); compiled code is in %s", path, reason, folder)
        return folder
    log.warning(
        "%s: compiled code cannot be kept there (%s); every run compiles it anew. "
        "Set XDG_CACHE_HOME to a folder that you and nobody else can write to",
        path,
        reason,
    )
    return folder_of_process()


def folder_of_process() -> Path:
    """A new folder for this process alone, removed at its end."""
    folder = Path(tempfile.mkdtemp(prefix="fenics_joints_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def private_folder(path: Path) -> Path:
    """A folder into which nobody else can put a file, made with mode 0700 if it is missing.

    The folders above count too: whoever can write to one of them can replace the folder.

    Args:
        path: The folder.

    Returns:
        The folder's path without links, to be used from here on: links can be redirected.

    Raises:
        OSError: If the folder cannot be made, or others could change it.
    """
    _make(path)
    real = path.resolve()
    for folder in (real, *real.parents):
        reason = changed_by_others(folder.stat(), above=folder != real)
        if reason:
            raise PermissionError(f"{folder} {reason}")
    return real


def _make(path: Path) -> None:
    """Make the folder and missing folders above it, each for this user only."""
    if not path.is_dir():
        _make(path.parent)
        path.mkdir(mode=0o700, exist_ok=True)


def changed_by_others(status: os.stat_result, above: bool = False) -> str:
    """Why another user, except root, could have changed a file or folder; empty if none could.

    Args:
        status: Status of the file.
        above: Whether it is a folder above the one that counts: in a folder with the sticky bit,
            such as /tmp, others cannot rename this user's files.
    """
    known = (0, os.geteuid(), *([_UNKNOWN] if above and _in_container() else []))
    if status.st_uid not in known:
        return f"belongs to another user (number {status.st_uid})"
    mode = status.st_mode
    if above and mode & stat.S_ISVTX:
        return ""
    if mode & stat.S_IWOTH or (mode & stat.S_IWGRP and not _of_one(status.st_gid)):
        return f"can be written to by other users (mode {stat.S_IMODE(mode):04o})"
    return ""


@lru_cache
def _in_container() -> bool:
    """Whether this is a user namespace that knows some users only, as bubblewrap makes one."""
    try:
        return _ALL not in Path("/proc/self/uid_map").read_text(encoding="ascii")
    except OSError:
        return False


def _of_one(gid: int) -> bool:
    """Whether a group is this user's alone, as Debian and Red Hat make one for each user."""
    with suppress(KeyError):
        user, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(gid)
        return group.gr_name == user.pw_name and set(group.gr_mem) <= {user.pw_name}
    return False

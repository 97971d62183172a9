"""What the machine, and the limits on this process, leave of memory."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from pathlib import Path


def available_bytes(root: str | Path = "/") -> float:
    """Memory that could be had without swapping: the least of the machine's and all limits'.

    ``MemAvailable`` of Linux, else all of the physical memory; the limits of the control groups
    that the process is in (version 1 or 2), as containers and batch systems set them, less what
    they hold and could not give back; and ``ulimit -v``.

    Args:
        root: Folder in which ``proc`` and ``sys`` are.
    """
    root = Path(root)
    found = [_meminfo(root / "proc/meminfo") or _physical(), *_groups(root)]
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    if soft != resource.RLIM_INFINITY:
        found.append(float(soft))
    return max(0.0, min(found))


def _meminfo(file: Path) -> float | None:
    for line in _text(file).splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable" and value.split():
            return 1024.0 * float(value.split()[0])
    return None


def _physical() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (OSError, ValueError):
        return float("inf")


def _groups(root: Path) -> Iterator[float]:
    """What each control group of this process, and those above it, leave."""
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, kinds, path = (line.split(":", 2) + ["", ""])[:3]
        if kinds == "":
            base, names = root / "sys/fs/cgroup", ("memory.max", "memory.current", "inactive_file")
        elif "memory" in kinds.split(","):
            base = root / "sys/fs/cgroup/memory"
            names = "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"
        else:
            continue
        parts = [part for part in path.split("/") if part not in ("", "..")]
        # In a container the path may be one outside of it: its own group is then the base.
        for depth in range(len(parts) + 1):
            folder = base.joinpath(*parts[:depth])
            limit, used = (_number(_text(folder / name)) for name in names[:2])
            if limit is not None:
                yield limit - (used or 0.0) + _cached(folder, names[2])


def _cached(folder: Path, key: str) -> float:
    for line in _text(folder / "memory.stat").splitlines():
        name, _, value = line.partition(" ")
        if name == key:
            return _number(value) or 0.0
    return 0.0


def _number(text: str) -> float | None:
    return float(text) if text.strip().isdigit() else None


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""

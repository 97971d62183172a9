"""Control groups of Linux, versions 1 and 2, which limit what a process may use."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path


def control_groups(root: Path, controller: str) -> Iterator[tuple[Path, bool]]:
    """Folders of this process's control group and of those above it.

    Args:
        root: Folder in which ``proc`` and ``sys`` are.
        controller: ``"cpu"`` or ``"memory"``.

    Yields:
        The folder, which may not be there, and whether its files are those of version 2.
    """
    for line in contents(root / "proc/self/cgroup").splitlines():
        _, controllers, path = (line.split(":", 2) + ["", ""])[:3]
        if controllers and controller not in controllers.split(","):
            continue
        base = root / "sys/fs/cgroup" / (controller if controllers else "")
        parts = [part for part in path.split("/") if part not in ("", "..")]
        # In a container the path may be one outside of it: its own group is then the base.
        for depth in range(len(parts) + 1):
            yield base.joinpath(*parts[:depth]), not controllers


def contents(file: Path) -> str:
    """What a file says; nothing if it cannot be read."""
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""

"""Memory that was freed: kept for the next arrays, or given back to the system."""

from __future__ import annotations

import ctypes
import gc
from contextlib import suppress

#: ``M_TRIM_THRESHOLD`` and ``M_MMAP_THRESHOLD`` of glibc's ``mallopt``.
_TRIM, _MMAP = -1, -3
#: Bytes up to which arrays share the heap, and bytes of it that may lie idle at its end; chosen.
_SHARED, _IDLE = 64 << 20, 1 << 30


def hold_freed() -> None:
    """Let this process keep what it frees, for the arrays that come next, until `give_back`; for
    the command line, since a library leaves the process of others as it is.

    By default glibc gives each array of some megabytes back as soon as it is freed, and asks for
    zeroed pages for the next one: of the products of batches of small models that is more than half
    of the time, and several times as much on a machine that is short of memory.
    """
    with suppress(OSError, AttributeError):  # another C library
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP, _SHARED), library.mallopt(_TRIM, _IDLE)


def give_back() -> None:
    """Give back what this process has freed, where the C library can (glibc's ``malloc_trim``).

    Arrays of some megabytes lie between others that stay, and glibc keeps their room: after a
    finer model was solved, or a basis has grown, that is more than what is in use (of a box of
    56,000 degrees of freedom 3.1 GB for 1.4), and two diagnoses at a time run out of memory.
    """
    gc.collect()
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)

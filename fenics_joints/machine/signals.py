"""Signals while a command runs: a stop that is known as one wherever it arrives, no SIGPIPE."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

#: Those that end a command: Ctrl-C, what mpirun and batch systems send, a terminal that is closed.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Terminated(BaseException):
    """The process was asked to end by another signal than Ctrl-C's."""


class Stop:
    """Whether a command was asked to end.

    Attributes:
        number: The signal's number; None if none came.
        leaving: Set once the command cleans up, so that further signals do not disturb it.
    """

    def __init__(self):
        self.number: int | None = None
        self.leaving = False

    @property
    def exit_code(self) -> int:
        """As shells have it: 130 for Ctrl-C, 143 for SIGTERM."""
        return 128 + (signal.SIGINT if self.number is None else self.number)

    def __call__(self, number: int, frame) -> None:
        """The handler. What it raises may be lost in a callback of PETSc; the number is not."""
        if self.leaving:
            return
        self.number = number
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated


@contextmanager
def stoppable() -> Iterator[Stop]:
    """Hear signals that end a command, and let writing to a closed pipe be an error, not the end.

    PETSc would end all ranks when a reader, such as a browser's tab or ``head``, goes away, and UCX
    below MPI takes a closed terminal for the wish to see its debug messages.
    """
    options = os.environ.get("PETSC_OPTIONS", "")
    os.environ["PETSC_OPTIONS"] = f"{options} -no_signal_handler".strip()  # where it starts later
    os.environ.setdefault("UCX_DEBUG_SIGNO", "0")
    stop = Stop()
    before = {signal.SIGPIPE: signal.signal(signal.SIGPIPE, signal.SIG_IGN)}
    for number in ENDING:
        # Ignored by who started us, as nohup and shells do for what runs in the background.
        if signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, stop)
    try:
        yield stop
    finally:
        # Who was asked to end is on the way out: asked again, it must not lose its exit code.
        deaf = dict.fromkeys(ENDING, signal.SIG_IGN) if stop.leaving and stop.number else {}
        for number, handler in before.items():
            signal.signal(number, deaf.get(number, handler))

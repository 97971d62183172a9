"""Progress of a long computation on the terminal, as verbose as the user wants it."""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import TextIO

from fenics_joints.machine.ranks import LAUNCHED, joined

_loudness = "normal"
#: Open progress displays of this process, the innermost last.
_contexts: list[Progress] = []
#: Size of a file, bytes, from which its reading is shown as a step.
_LARGE = 20_000_000


def loudness() -> str:
    """How much is said: ``"quiet"`` (errors only), ``"normal"`` or ``"verbose"``."""
    return _loudness


def set_loudness(value: str) -> None:
    """Say how much is said in this process from now on; see `loudness`."""
    global _loudness
    _loudness = value


def reading(name: str, size: int, total: int | None = None) -> Progress:
    """Begin a step of the running command, if there is one, for a large file.

    Args:
        name: Name of the file.
        size: Size of the file, bytes.
        total: Number of calls of `Progress.advance` that follow, if known.
    """
    progress = _contexts[-1] if _contexts and size > _LARGE else Progress(silent=True)
    progress.step(f"reading {name}, {size / 1e6:.0f} MB", total)
    return progress


def compiling() -> None:
    """Say once in the running command, if there is one, that code is compiled for it."""
    if _contexts:
        _contexts[-1].mention("compiling forms: the first run of such a case, kept for the next")


def is_terminal(stream: TextIO) -> bool:
    """Whether a stream is a terminal that can be drawn on.

    Under a launcher of the user's it is not: Open MPI gives each rank a terminal of its own (of no
    size), and passes on what is written there, escape codes included, be it into a file.
    """
    launched = any(key in os.environ for key in LAUNCHED) and not joined()
    return os.environ.get("TERM") != "dumb" and not launched and stream.isatty()


class Progress:
    """Steps of a computation, shown on rank 0: redrawn on a terminal, otherwise as plain lines.

    Use it as a context; `step` and `advance` may be called on every rank, and outside a context
    they do nothing, so that ``Progress(silent=True)`` suits tests and notebooks.

    With ``-q`` nothing is said; with ``-v`` all are plain lines, with the seconds of every step.

    Args:
        silent: Say nothing; for the ranks other than 0.
        stream: Where to; standard error by default.

    Attributes:
        interval: Seconds between two lines of one step where there is no terminal to redraw.
    """

    interval = 10.0

    def __init__(self, *, silent: bool = False, stream: TextIO | None = None):
        self._stream = sys.stderr if stream is None else stream
        self._silent, self._open = silent or _loudness == "quiet", False
        self._verbose = _loudness == "verbose"
        if self._verbose:
            self.interval = 0.0
        self._begun = self._entered = 0.0
        self._live = self._task = self._total = None
        self._done, self._text, self._said = 0, "", 0.0
        self._stages: Sequence[str] = ()
        self._mentioned: set[str] = set()

    def __enter__(self) -> Progress:
        _contexts.append(self)
        self._open = not self._silent
        self._entered = time.monotonic()
        if self._open and not self._verbose and is_terminal(self._stream):
            self._live = _live(self._stream)
            self._live.start()
        return self

    def __exit__(self, kind, value, trace) -> None:
        _contexts.remove(self)
        if self._live is not None:
            if kind is None:
                self._finish()
            self._live.stop()
            self._live = None
        if self._open and self._verbose:
            self._tell_seconds()
            print(f"all: {time.monotonic() - self._entered:.1f} s, {_peak()}", file=self._stream)
        self._open = False

    def outline(self, stages: Sequence[str], seconds: float | None = None) -> None:
        """Say at the start what is to come, in order, and when it will roughly end.

        Args:
            stages: What `stage` is called with later; none where only the end is told.
            seconds: How long all will take; None where nobody knows.
        """
        self._stages = stages or self._stages
        if stages:
            self._tell("stages: " + "; ".join(f"{i}. {s}" for i, s in enumerate(stages, 1)))
        if seconds is not None:
            end = datetime.now() + timedelta(seconds=seconds)
            self._tell(f"expected end: {end:%H:%M}, in {_span(seconds)} (a rough estimate)")

    def stage(self, name: str) -> None:
        """Begin a stage of the outline; what has not been announced is not told."""
        if name in self._stages:
            so_far = _span(time.monotonic() - self._entered)
            place = f"stage {self._stages.index(name) + 1} of {len(self._stages)}"
            self._tell(f"{place}: {name} ({so_far} so far)")

    def mention(self, line: str) -> None:
        """Say a line, if it was not said before."""
        if line not in self._mentioned:
            self._mentioned.add(line)
            self._tell(line)

    def _tell(self, line: str) -> None:
        if not self._open:
            return
        if self._live is None:
            print(line, file=self._stream, flush=True)
        else:
            self._live.console.print(line, markup=False, highlight=False)

    def step(self, text: str, total: int | None = None) -> None:
        """Begin the next step.

        Args:
            text: What is being done, such as ``solving 18 modes``.
            total: How many calls of `advance` it takes, if known.
        """
        if not self._open:
            return
        self._tell_seconds()
        self._text, self._total, self._done, self._said = text, total, 0, time.monotonic()
        self._begun = self._said
        if self._live is not None:
            self._finish()
            self._task = self._live.add_task(text, total=total)
            return
        print(f"{text} ...", file=self._stream, flush=True)

    def advance(self, n: int = 1, note: str = "") -> None:
        """Say that ``n`` more parts of the step are done, and how it stands."""
        if not self._open:
            return
        note = f" ({note})" if note else ""
        self._done += n
        if self._live is not None:
            if self._task is not None:
                known = self._total if self._done <= (self._total or 0) else None
                words = f"{self._text}{note}"
                self._live.update(self._task, total=known, advance=n, description=words)
            return
        now = time.monotonic()
        if now - self._said > self.interval:
            # Repeated work, such as a fit from another start, is not part of the total.
            of = ""
            if self._total and 0 < self._done <= self._total:
                left = (now - self._begun) * (self._total - self._done) / self._done
                of = f" of {self._total}" + (f", about {left:.0f} s left" if left >= 1 else "")
            print(f"{self._text}: {self._done}{of}{note}", file=self._stream, flush=True)
            self._said = now

    def reach(self, done: int, note: str = "") -> None:
        """Say how many parts of the step are done in all, and how it stands."""
        self.advance(done - self._done, note)

    def _tell_seconds(self) -> None:
        """With ``-v``: how long the step took that ends now."""
        if self._verbose and self._text:
            print(f"{self._text}: {time.monotonic() - self._begun:.1f} s", file=self._stream)

    def _finish(self) -> None:
        if self._task is not None:
            self._live.update(self._task, total=1, completed=1)
            self._live.stop_task(self._task)


def _span(seconds: float) -> str:
    """A time in minutes and seconds."""
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _peak() -> str:
    """The most memory that this process has had, in words."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return f"at most {most * (1 if sys.platform == 'darwin' else 1024) / 2**30:.2f} GiB of memory"


def _live(stream: TextIO):
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as RichProgress

    return RichProgress(
        SpinnerColumn(finished_text="·"),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(file=stream),
    )

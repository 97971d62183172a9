"""Ranks on this machine that the command starts by itself: a parent that waits, and its children.

The parent runs mpirun and computes nothing. Each child reports over a socket that it is up, and the
number of ranks that MPI counts: processes of another MPI than mpirun's count one each. If it is
right the parent gives the child its own standard streams, so that rank 0 prints as without mpirun,
in colour on a terminal. Signals to the parent go to the ranks themselves: mpirun would end them
with another one. At its end a rank reports its exit code, and leaves mpirun with 0, so that
mpirun says nothing and ends nobody; what mpirun prints is shown only if a rank ended without a
report.
"""

from __future__ import annotations

import os
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fenics_joints.machine.control_groups import contents, control_groups
from fenics_joints.machine.signals import ENDING

#: Environment variable with the number of ranks to start.
VARIABLE = "FENICS_JOINTS_RANKS"
#: Ranks that are started unasked, at most: each takes memory of its own, and few of a command's
#: steps gain from more (`docs/cluster.md`).
MOST = 4
#: Where a launcher says the rank, before MPI itself is started.
LAUNCHED = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")
#: Jobs of batch systems, whose scripts say where ranks are started, and how many.
_BATCH = ("SLURM_PROCID", "SLURM_JOB_ID", "PBS_JOBID", "LSB_JOBID", "FLUX_JOB_ID")
#: Where a child finds the socket of its parent.
_SOCKET = "FENICS_JOINTS_PARENT"
#: What Open MPI 4 to 6 needs to start several ranks wherever the command may run: no core of their
#: own, since two commands would take the same ones; more ranks than cores if asked for; a waiting
#: rank lets others run.
_OPEN_MPI = {
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "PRTE_MCA_hwloc_default_binding_policy": "none",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_mpi_yield_when_idle": "1",
}

#: Files that tell a container, in which root is nobody in particular.
_CONTAINERS = ("/.dockerenv", "/run/.containerenv")
_AS_ROOT = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")

_parent: socket.socket | None = None


def may_start() -> bool:
    """Whether this process is the command itself, and neither a rank nor in a batch job.

    `fenics_joints.cli.main` may also be called in a notebook or in a test, which cannot be started
    again as a rank.
    """
    own = os.path.basename(sys.argv[0]) in ("fenics-joints", "__main__.py")
    return own and not any(name in os.environ for name in (*LAUNCHED, *_BATCH))


def cores(root: str | Path = "/") -> int:
    """Cores that this process may use: neither threads of one core, nor those of others.

    Args:
        root: Folder in which ``proc`` and ``sys`` are.

    Returns:
        The cores with a processor that the process may run on, at most as many as the quota of its
        control groups (version 1 or 2) has; 1 on systems that do not say.
    """
    if not hasattr(os, "sched_getaffinity"):
        return 1
    root = Path(root)
    topology = "sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
    names = {contents(root / topology.format(n)) or str(n) for n in os.sched_getaffinity(0)}
    return max(1, min([len(names), *_quotas(root)]))


def _quotas(root: Path) -> Iterator[int]:
    """Whole processors that the control groups of this process, and those above, allow."""
    for folder, second in control_groups(root, "cpu"):
        files = ["cpu.max"] if second else ["cpu.cfs_quota_us", "cpu.cfs_period_us"]
        quota, period = (" ".join(contents(folder / f) for f in files).split() + ["", ""])[:2]
        if quota.isdecimal() and period.isdecimal():  # "max" and -1 are none
            yield int(quota) // int(period)


# -- the parent ------------------------------------------------------------------------------------


def run_on(ranks: int) -> int | str:
    """Run this process's command line again on several ranks, and wait for its end.

    Args:
        ranks: How many, 2 or more.

    Returns:
        Its exit code; or, if they did not start, the reason, and nothing has been done.
    """
    launcher = shutil.which("mpirun") or shutil.which("mpiexec")
    if launcher is None:
        return "there is no mpirun"
    folder = tempfile.mkdtemp(prefix="fenics_joints_")
    try:
        parent = _Parent(launcher, ranks, folder)
    except OSError as error:  # as where the path is too long for a socket
        shutil.rmtree(folder)
        return error.strerror or str(error)
    return parent.wait()


class _Parent:
    """Starts ranks, and waits for them; ``folder`` is private, and gone once all are up."""

    def __init__(self, launcher: str, ranks: int, folder: str):
        self._ranks, self._folder = ranks, folder
        path = os.path.join(folder, "socket")
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(path)
        self._server.listen(ranks)
        environment = {"OMP_NUM_THREADS": "1", **_OPEN_MPI, **os.environ, _SOCKET: path}
        if os.geteuid() == 0 and any(map(os.path.exists, _CONTAINERS)):
            environment |= dict.fromkeys(_AS_ROOT, "1")
        # In a session of its own: signals of the terminal reach the ranks through us alone.
        self._process = subprocess.Popen(
            [launcher, "-n", str(ranks), sys.executable, *sys.orig_argv[1:]],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env=environment,
        )
        self._said = b""  # by mpirun
        self._up: dict[socket.socket, tuple[int, ...]] = {}  # rank, ranks, process
        self._codes: dict[int, int] = {}
        self._lost: int | None = None  # the first rank that ended without a report
        self._stopped: int | None = None  # by this signal

    def wait(self) -> int | str:
        """See `run_on`."""
        handlers = {number: self._pass_on for number in ENDING} | {signal.SIGTSTP: self._pause}
        before = {number: signal.getsignal(number) for number in handlers}
        for number, handler in handlers.items():
            # Ignored by who started us, as nohup and shells do for what runs in the background.
            if before[number] is not signal.SIG_IGN:
                signal.signal(number, handler)
        try:
            self._listen()
            return self._end(self._process.wait())
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            shutil.rmtree(self._folder, ignore_errors=True)
            for line in (self._server, *self._up):
                line.close()

    def _listen(self) -> None:
        """Until mpirun closes its output, at its end."""
        pipe = self._process.stdout
        with selectors.DefaultSelector() as selector, pipe:
            selector.register(self._server, selectors.EVENT_READ)
            selector.register(pipe, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select():
                    if key.fileobj is self._server:
                        child, _ = self._server.accept()
                        selector.register(child, selectors.EVENT_READ)
                        continue
                    words = os.read(key.fd, 65536)
                    if key.fileobj is not pipe:
                        self._hear(key.fileobj, words)
                        if not words:
                            selector.unregister(key.fileobj)
                    elif words:
                        self._said += words
                    else:
                        return

    def _hear(self, child: socket.socket, words: bytes) -> None:
        """What a child says: that it is up, its exit code, or by nothing that it is gone."""
        if child in self._up:
            rank = self._up[child][0]
            if words:
                self._codes[rank] = words[0]
            elif self._lost is None and rank not in self._codes and not any(self._codes.values()):
                self._lost = rank
        elif words:
            self._up[child] = tuple(map(int, words.split()))
            if len(self._up) == self._ranks:
                shutil.rmtree(self._folder)  # who is killed from now on leaves nothing
                self._begin()

    def _begin(self) -> None:
        if not self._started:
            for child in self._up:
                child.shutdown(socket.SHUT_RDWR)  # which ends it
            return
        for child, (rank, *_) in self._up.items():
            # What libraries print on other ranks must not get between the lines of rank 0.
            socket.send_fds(child, [b"."], [2 if rank else 1, 2])

    @property
    def _started(self) -> bool:
        """Whether all ranks are up, as MPI counts them."""
        counted = sorted(self._up.values())
        return [up[:2] for up in counted] == [(rank, self._ranks) for rank in range(self._ranks)]

    def _pass_on(self, number: int, frame) -> None:
        self._stopped = self._stopped or number
        if self._started:
            self._signal(number)
        else:
            self._process.terminate()

    def _pause(self, number: int, frame) -> None:
        self._signal(signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGSTOP)  # until we are continued
        self._signal(signal.SIGCONT)

    def _signal(self, number: int) -> None:
        for rank, _, process in self._up.values():
            if rank not in self._codes:
                with suppress(ProcessLookupError):
                    os.kill(process, number)

    def _end(self, status: int) -> int | str:
        said = " ".join(self._said.decode(errors="replace").split())
        if not self._started:
            if self._stopped:
                print("stopped; no file is left half-written", file=sys.stderr)
                return 128 + self._stopped
            if len(self._up) == self._ranks:
                return "mpirun belongs to another MPI than mpi4py"
            return f"mpirun ended with {status} ({said[:200]})"
        if self._lost is not None and not self._stopped:
            by = f" by {signal.Signals(status - 128).name}" if status > 128 else f" ({said})"
            print(
                f"error: rank {self._lost} of {self._ranks} was ended{by}; there may be too "
                "little memory",
                file=sys.stderr,
            )
            return status or 1
        if not self._codes:
            return 128 + (self._stopped or 0)
        return next(filter(None, self._codes.values()), 0)


# -- a child ---------------------------------------------------------------------------------------


def join(rank: int, size: int) -> None:
    """Take the parent's streams, if this process is a rank that `run_on` started.

    Args:
        rank: As MPI counts.
        size: How many ranks it counts.

    Raises:
        SystemExit: If the parent is gone, or begins nothing because MPI counts other ranks.
    """
    global _parent
    path = os.environ.pop(_SOCKET, None)
    if path is None:
        return
    parent = socket.socket(socket.AF_UNIX)
    try:
        parent.connect(path)
        parent.send(b"%d %d %d" % (rank, size, os.getpid()))
        _, streams, _, _ = socket.recv_fds(parent, 1, 2)
    except OSError:
        streams = []
    if len(streams) != 2:
        sys.exit(0)
    # Of the terminal we are in the background, and write to it all the same.
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    for number, stream in enumerate(streams, 1):
        os.dup2(stream, number)
        os.close(stream)
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=stream.isatty() or stream is sys.stderr)
    threading.Thread(target=_follow, args=(parent,), daemon=True).start()
    _parent = parent


def _follow(parent: socket.socket) -> None:
    parent.recv(1)  # nothing is ever sent: the parent was killed
    os.kill(os.getpid(), signal.SIGTERM)


def joined() -> bool:
    """Whether this process is a rank that the command started itself."""
    return _parent is not None


def report(code: int) -> None:
    """Tell the parent, if there is one, the exit code with which this rank ends."""
    if _parent is not None:
        with suppress(OSError):
            _parent.send(bytes([code]))


@contextmanager
def reported() -> Iterator[None]:
    """Report the exit code of what is inside, and leave mpirun with 0."""
    code = 0
    try:
        yield
    except SystemExit as end:
        if not joined():
            raise
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    report(code)
    if joined():
        sys.exit(0)

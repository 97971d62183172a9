"""The launcher ``with-fenicsx``, run by bash against stand-ins for mmdebstrap and bubblewrap.

The stand-ins do the little that the launcher can see: mmdebstrap writes a small tar, bubblewrap
runs what follows ``--``. Everything else (bash, tar, flock, signals, renames) is real.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
TOOLS = (
    "bash sh env cat cut awk sed grep ls mkdir rm mv chmod cksum mktemp df du tail sleep tar uname "
    "id dirname flock true readlink ln"
).split()
MISSING = [tool for tool in TOOLS if shutil.which(tool) is None]
pytestmark = pytest.mark.skipif(
    bool(MISSING) or not sys.platform.startswith("linux"), reason=f"needs Linux and {MISSING}"
)

MMDEBSTRAP = """#!/bin/sh
echo build >>"$RECORD"
echo "I: pretending" >&2
sleep "${STUB_SECONDS:-0}"
if [ -n "$STUB_FAILURE" ]; then echo "$STUB_FAILURE" >&2; exit 1; fi
mkdir -p "$TMPDIR/r/usr/bin" "$TMPDIR/r/etc" "$TMPDIR/r/dev"
tar -c -C "$TMPDIR/r" .
"""
BWRAP = """#!/bin/sh
while [ "$1" != -- ]; do
  if [ "$1 $2" = "--setenv HOME" ]; then export HOME="$3"; fi
  shift
done
shift
case "$1 $2 $3" in
  *python3*"-m venv") for venv; do :; done
    mkdir -p "$venv/lib/python3.13/site-packages" "$venv/bin" ;;
  *python3*"-m pip") case "$*" in *--require-hashes*) echo pip >>"$RECORD" ;; esac ;;
  *python3*) echo "ok /usr|/usr/dolfinx|0.9.0" ;;
  *) "$@"; exit $? ;;
esac
"""


class Machine:
    """A machine with an empty cache, a checkout and only the stand-ins and tools on its PATH."""

    def __init__(self, place: Path) -> None:
        self.bin, self.checkout = place / "bin", place / "checkout"
        self.cache, self.record = place / "cache" / "fenics-joints", place / "record"
        self.bin.mkdir()
        self.checkout.mkdir()
        self.record.touch()
        for tool in TOOLS:
            (self.bin / tool).symlink_to(shutil.which(tool))
        self.install("mmdebstrap", MMDEBSTRAP)
        self.install("bwrap", BWRAP)
        self.install("id", "#!/bin/sh\necho 0\n")
        for name in ("with-fenicsx", "pyproject.toml", "requirements.lock"):
            shutil.copy(REPOSITORY / name, self.checkout / name)

    def install(self, name: str, script: str) -> None:
        (self.bin / name).unlink(missing_ok=True)
        (self.bin / name).write_text(script)
        (self.bin / name).chmod(0o755)

    def start(
        self, *command: str, cwd: Path | None = None, **environment: str | None
    ) -> subprocess.Popen[str]:
        """Start the launcher with variables of its environment; None is not set."""
        variables = {
            "PATH": str(self.bin),
            "HOME": str(self.checkout.parent),
            "XDG_CACHE_HOME": str(self.cache.parent),
            "RECORD": str(self.record),
            **environment,
        }
        return subprocess.Popen(
            [self.checkout / "with-fenicsx", *command],
            cwd=cwd,
            env={name: value for name, value in variables.items() if value is not None},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def run(self, *command: str, stdin: str = "", **options) -> tuple[int, str, str]:
        process = self.start(*command, **options)
        out, err = process.communicate(stdin, timeout=60)
        return process.returncode, out, err

    def count(self, word: str) -> int:
        return self.record.read_text().split().count(word)

    def roots(self) -> list[Path]:
        return sorted((self.cache / "roots").glob("*")) + sorted((self.cache / "roots").glob(".*"))


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def give_away(folder: Path) -> None:
    """Make it another user's."""
    try:
        os.chown(folder, 12345, 12345)
    except PermissionError:
        pytest.skip("only the superuser can make a folder that is another user's")


def wait_for(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)


def test_command_gets_stdin_arguments_and_passes_its_status(machine: Machine) -> None:
    status, out, err = machine.run("sh", "-c", 'cat; echo "$1"; exit 7', "-", "a b", stdin="in\n")
    assert (status, out) == (7, "in\na b\n")
    assert "making a private Debian trixie root" in err
    # Everything is there now: silence, and nothing is made again.
    assert machine.run("sh", "-c", "exit 3") == (3, "", "")
    assert (machine.count("build"), machine.count("pip")) == (1, 1)


@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_interrupted_build_is_never_used(machine: Machine, kill: signal.Signals) -> None:
    process = machine.start("true", STUB_SECONDS="60")
    wait_for(lambda: machine.count("build") == 1)
    process.send_signal(kill)
    if kill != signal.SIGKILL:
        process.communicate(timeout=20)
        assert process.returncode == 128 + kill
        assert machine.roots() == []
    assert machine.run("true")[0] == 0
    assert machine.count("build") == 2
    assert [(root / ".ready").exists() for root in machine.roots()] == [True]
    process.communicate(timeout=20)


def test_killed_at_random_moments_it_installs_all_the_same(machine: Machine) -> None:
    """A start takes half a second here, of which half waits for the root."""
    draw = random.Random(3)
    for _ in range(8):
        process = machine.start("true", STUB_SECONDS="0.2")
        time.sleep(draw.uniform(0.0, 0.6))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=20)
    assert machine.run("sh", "-c", "exit 3")[0] == 3
    assert machine.run("sh", "-c", "exit 3") == (3, "", "")
    ready = [root for root in machine.roots() if (root / ".ready").exists()]
    assert len(ready) == 1


@pytest.mark.parametrize("home", [None, "/nowhere"])
def test_without_a_home_the_command_gets_one(machine: Machine, home: str | None) -> None:
    """Open MPI does not start without."""
    _, out, err = machine.run("sh", "-c", 'ls -d "$HOME"', HOME=home)
    assert out.strip() == str(machine.cache / "home"), err


def test_two_starts_build_once(machine: Machine) -> None:
    first = machine.start("sh", "-c", "echo one", STUB_SECONDS="1")
    wait_for(lambda: machine.count("build") == 1)
    status, out, err = machine.run("sh", "-c", "echo two", STUB_SECONDS="1")
    assert (status, out, "waiting for it" in err) == (0, "two\n", True)
    assert first.communicate(timeout=20)[0] == "one\n"
    assert (machine.count("build"), machine.count("pip")) == (1, 1)


def test_ordinary_user_without_tools_gets_the_line_to_run(machine: Machine) -> None:
    (machine.bin / "bwrap").unlink()
    machine.install("id", "#!/bin/sh\necho 1000\n")
    machine.install("apt-get", '#!/bin/sh\necho apt >>"$RECORD"\n')
    status, out, err = machine.run("true")
    assert (status, out, machine.count("apt")) == (1, "", 0)
    assert "sudo apt-get install bubblewrap mmdebstrap" in err
    assert "missing" in err and "bwrap" in err and "conda" in err


def test_root_user_installs_the_tools(machine: Machine) -> None:
    (machine.bin / "mmdebstrap").rename(machine.bin / "package")
    script = '#!/bin/sh\ncase $1 in install) mv "$BIN/package" "$BIN/mmdebstrap" ;; esac\n'
    machine.install("apt-get", script)
    status, _, err = machine.run("true", BIN=str(machine.bin))
    assert status == 0
    assert "installing bubblewrap mmdebstrap" in err


@pytest.mark.parametrize(
    ("failure", "word"),
    [
        ("E: Could not resolve 'deb.debian.org'", "network"),
        ("tar: ./usr/lib/x: Cannot write: No space left on device", "disk"),
        ("W: GPG error: m trixie InRelease: ... NO_PUBKEY 6ED0E7B8\nE: ... is not signed.", "keys"),
        ("E: InRelease  Clearsigned file isn't valid, got 'NOSPLIT'\nE: is not signed.", "send"),
        ("E: The repository 'm trixie Release' does not have a Release file.", "send"),
        ("E: Failed to fetch http://m/dists/trixie/InRelease  500  Internal Server Error", "send"),
    ],
)  # what apt wrote at mirrors that were broken on purpose
def test_failed_build_says_why_and_leaves_nothing(
    machine: Machine, failure: str, word: str
) -> None:
    status, _, err = machine.run("true", STUB_FAILURE=failure)
    assert status == 69
    reason = err.partition("with-fenicsx: Other ways")[0].splitlines()[-1]
    assert reason.startswith("with-fenicsx: ") and word in reason and failure in err
    assert machine.roots() == []


def test_a_signal_reaches_the_command_and_is_said_once_for_several_ranks(machine: Machine) -> None:
    """mpirun ends with 1 then, and shows nothing more of what its ranks say."""
    loop = 'echo up >>"$RECORD"; while :; do sleep 0.05; done'
    machine.install("mpirun", f'#!/bin/sh\ntrap "exit 1" INT; {loop}\n')
    assert machine.run("true")[0] == 0
    alone = "sh", "-c", f'trap "echo cleaned; exit 3" INT; {loop}'
    ranks = "mpirun", "-n", "2", "true"
    for command, ended in ((alone, (3, "cleaned\n", 0)), (ranks, (130, "", 1))):
        machine.record.write_text("")
        process = machine.start(*command)
        wait_for(lambda: machine.count("up") == 1)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
        assert (process.returncode, out, err.count("\n")) == ended
    assert "INT" in err


def test_new_dependency_makes_a_new_environment_and_gone_checkouts_lose_theirs(
    machine: Machine,
) -> None:
    assert machine.run("true")[0] == 0
    project = machine.checkout / "pyproject.toml"
    text = project.read_text()
    project.write_text(text.replace("[tool.ruff]", "[tool.ruff]\npreview = true"))
    assert machine.run("true")[0] == 0
    assert machine.count("pip") == 1  # settings of tools change nothing
    project.write_text(text.replace("dependencies = [", 'dependencies = [\n  "attrs",', 1))
    assert machine.run("true")[0] == 0
    assert machine.count("pip") == 2
    (machine.checkout / "requirements.lock").open("a").write("# other versions\n")
    assert machine.run("true")[0] == 0
    assert machine.count("pip") == 3
    machine.checkout = shutil.move(machine.checkout, machine.checkout.with_name("moved"))
    assert machine.run("true")[0] == 0
    assert (machine.count("build"), machine.count("pip")) == (1, 4)
    assert len(list((machine.cache / "venvs").iterdir())) == 1


def fake_fenicsx(machine: Machine, version: str, scalar: str) -> None:
    """Let the machine's ``python3`` see packages that say they are FEniCSx."""
    site = machine.checkout.parent / "site"
    info = f"fenics_dolfinx-{version}.dist-info"
    for name in ("dolfinx", "mpi4py", "petsc4py", "slepc4py", info):
        (site / name).mkdir(parents=True)
        (site / name / "__init__.py").touch()
    (site / "petsc4py" / "PETSc.py").write_text(f"import numpy\nScalarType = numpy.{scalar}\n")
    (site / "slepc4py" / "SLEPc.py").touch()
    metadata = site / f"fenics_dolfinx-{version}.dist-info" / "METADATA"
    metadata.write_text(f"Metadata-Version: 2.1\nName: fenics-dolfinx\nVersion: {version}\n")
    script = f'#!/bin/sh\nPYTHONPATH="{site}" exec "{sys.executable}" "$@"\n'
    machine.install("python3", script)


@pytest.mark.parametrize(
    ("version", "scalar", "words"),
    [
        ("0.8.0", "float64", "DOLFINx 0.8.0, supported are 0.9 to 0.11"),
        ("0.12.0.dev0", "float64", "DOLFINx 0.12.0.dev0, supported are 0.9 to 0.11"),
        ("0.10.0", "complex128", "complex scalars"),
    ],
)
def test_unfit_active_environment_falls_through(
    machine: Machine, version: str, scalar: str, words: str
) -> None:
    fake_fenicsx(machine, version, scalar)
    status, out, err = machine.run("sh", "-c", "echo inside")
    assert (status, out, machine.count("build")) == (0, "inside\n", 1)
    assert words in err


def test_fit_active_environment_is_named_and_explicit_suite_skips_it(machine: Machine) -> None:
    fake_fenicsx(machine, "0.10.0", "float64")
    assert machine.run("--where")[1].startswith(f"active: {machine.bin}/python3 (DOLFINx 0.10.0)")
    assert "private root: " in machine.run("--where", FENICSX_SUITE="sid")[1]


def test_no_python_of_the_working_folder_is_run(machine: Machine) -> None:
    """Neither where it looks for FEniCSx, nor while it makes a virtual environment (from nothing,
    so that pip fails in the end)."""
    fake_fenicsx(machine, "0.10.0", "float64")
    folder, ran = machine.checkout.parent / "strangers", machine.checkout.parent / "ran"
    for name in ("importlib", "linecache", "os", "re", "setuptools", "site", "venv", "pip"):
        (folder / name).mkdir(parents=True)
        planted = f"open({str(ran)!r}, 'a').write({name!r})\nraise SystemExit(0)\n"
        (folder / name / "__init__.py").write_text(planted)
        (folder / name / "__main__.py").write_text(planted)
    where = machine.run("--where", cwd=folder)
    assert "(DOLFINx 0.10.0)" in where[1] and not ran.exists()
    nothing = {"PIP_INDEX_URL": "file:///nowhere", "PIP_RETRIES": "0"}
    status, _, err = machine.run("true", cwd=folder, **nothing)
    assert (status, ran.exists()) == (1, False) and "installing this checkout" in err


def test_only_own_folders_are_removed_for_a_killed_build(machine: Machine) -> None:
    """The folder in /var/tmp may be gone, and its name another user's."""
    left, other = machine.cache / "roots" / ".new.x", machine.checkout.parent / "other"
    for folder in (left, other):
        folder.mkdir(parents=True)
    (left / "work").symlink_to(other)
    give_away(other)
    assert machine.run("true")[0] == 0
    assert (other.is_dir(), left.exists()) == (True, False)


def test_a_group_is_ones_own_by_its_name(machine: Machine) -> None:
    machine.cache.mkdir(parents=True)
    machine.cache.chmod(0o775)
    for user, group, safe in [
        ("ann", "ann:x:0:", True),
        ("ann", "ann:x:0:ann", True),
        ("ann", "ann:x:0:ann,bob", False),
        ("ann", "staff:x:0:", False),
        ("root", "root:x:0:", True),
        ("ann", "", False),
    ]:
        machine.install("id", f'#!/bin/sh\ncase "$*" in *n*) echo {user} ;; *) echo 0 ;; esac\n')
        machine.install("getent", f"#!/bin/sh\necho '{group}'\n")
        assert is_refused(machine) is not safe, (user, group)
        shutil.rmtree(machine.cache / "roots", ignore_errors=True)
        machine.record.write_text("")


def test_clean_removes_roots_and_environments(machine: Machine) -> None:
    assert machine.run("true")[0] == 0
    status, _, err = machine.run("--clean")
    assert (status, machine.roots()) == (0, [])
    assert "MB freed" in err
    assert os.listdir(machine.cache) == ["lock"]


def is_refused(machine: Machine, **environment: str) -> bool:
    """Whether it says which folder is not safe, before anything is made or run."""
    status, out, err = machine.run("sh", "-c", "echo ran", **environment)
    assert (status, out) in ((1, ""), (0, "ran\n")), err
    return status == 1 and machine.count("build") == 0 and "safe" in err


def test_cache_that_others_can_write_to_is_refused(machine: Machine) -> None:
    places = [machine.cache.parent, machine.cache, machine.cache / "roots", machine.cache / "venvs"]
    for at in places:
        at.mkdir()
        at.chmod(0o777)
        assert is_refused(machine), at
        at.chmod(0o755)
    assert not is_refused(machine)


def test_cache_in_a_folder_for_all_is_for_the_user_alone(machine: Machine) -> None:
    """As in /tmp: what is not there yet can be made, whatever the mask, and is nobody else's."""
    machine.cache.parent.mkdir()
    machine.cache.parent.chmod(0o1777)
    before = os.umask(0)
    try:
        status, out, err = machine.run("sh", "-c", "umask")
    finally:
        os.umask(before)
    assert (status, int(out, 8)) == (0, 0), err  # the command's mask is the user's
    assert machine.cache.stat().st_mode & 0o777 == 0o700
    inside = [path for path in machine.cache.rglob("*") if not path.is_symlink()]
    assert not [path for path in inside if path.stat().st_mode & 0o002]


def test_cache_of_another_user_or_through_his_link_is_refused(machine: Machine) -> None:
    other = machine.checkout.parent / "other"
    other.mkdir()
    (other / "link").symlink_to(machine.checkout.parent)
    link = machine.checkout.parent / "way"
    link.symlink_to("other/link")
    give_away(other)
    for place in (other, other / "link", link):
        assert is_refused(machine, XDG_CACHE_HOME=str(place))
    os.chown(other, os.getuid(), os.getgid())
    assert not is_refused(machine, XDG_CACHE_HOME=str(link))


def test_cache_of_a_relative_name_counts_for_nothing(machine: Machine) -> None:
    status, out, err = machine.run("sh", "-c", "pwd", XDG_CACHE_HOME="here")
    assert (status, not Path("here").exists()) == (0, True), err
    assert (machine.checkout.parent / ".cache" / "fenics-joints" / "roots").is_dir()


def test_working_folder_of_a_known_name_is_not_taken(machine: Machine) -> None:
    """mmdebstrap's is in /var/tmp for an ordinary user, where all can make folders."""
    machine.install("id", "#!/bin/sh\necho 987654\n")
    machine.install("newuidmap", "#!/bin/sh\n")
    machine.install("grep", "#!/bin/sh\nexit 0\n")  # there are subordinate ids
    planted = Path("/var/tmp/fenics-joints-987654")
    planted.mkdir()
    try:
        stub = MMDEBSTRAP.replace("echo build", 'echo "build $TMPDIR"')
        machine.install("mmdebstrap", stub)
        status, _, err = machine.run("true")
        assert (status, list(planted.iterdir())) == (0, []), err
        (place,) = [Path(w) for w in machine.record.read_text().split() if w.startswith("/")]
        assert place != planted and not place.exists()
    finally:
        planted.rmdir()

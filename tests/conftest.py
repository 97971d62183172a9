"""Fixtures of all tests. Imports no DOLFINx: the launcher's tests run without it."""

from __future__ import annotations

import gc
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

# For the helpers of several tests, and for the benchmarks. The repository comes last, so that an
# installed package is found before the sources beside this folder.
sys.path.insert(0, str(Path(__file__).parent / "helpers"))
sys.path.append(str(Path(__file__).parents[1]))
# Tests run side by side already.
os.environ.setdefault("FENICS_JOINTS_RANKS", "1")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """With ``-n``, give each worker a run of tests: one worker makes a module's fixtures."""
    if getattr(config.option, "numprocesses", None) and config.option.dist == "no":
        config.option.dist = "worksteal"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect slow tests unless ``-m`` names them; ``-m parallel`` does not."""
    if "slow" in (config.getoption("markexpr") or ""):
        return
    slow = [item for item in items if item.get_closest_marker("slow")]
    if slow:
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if item not in slow]


def pytest_collection_finish() -> None:
    """Exempt imported objects from garbage collection, which costs 0.13 s after every test."""
    if "dolfinx" in sys.modules:  # for tests that compile forms on meshes of their own
        from fenics_joints.machine import form_cache

        form_cache.install()
    gc.collect()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Destroy PETSc objects at the same time on all ranks: their destructors are collective."""
    gc.collect()
    if nextitem is None or nextitem.path != item.path:
        # The module's fixtures are gone; its tests imported what is left.
        gc.freeze()
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is not None and mpi.Is_initialized():
        mpi.COMM_WORLD.barrier()


@pytest.fixture(autouse=True)
def results_keep_to_their_schema(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every result that a command writes in this process has the keys of its schema."""
    if "fenics_joints.files" not in sys.modules or find_spec("jsonschema") is None:
        return
    from fenics_joints import files

    write = files.json_text

    def checked(content):
        if {"schema", "run"} <= set(content):
            import jsonschema

            from fenics_joints.commands.results import result_schema

            schema = result_schema(content["schema"].split()[1])
            assert set(content) <= set(schema["properties"])
            if content["run"]:  # on rank 0
                jsonschema.validate(json.loads(write(content)), schema)
        return write(content)

    monkeypatch.setattr(files, "json_text", checked)


@pytest.fixture
def shared_tmp_path(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty directory that all ranks know by the same path; rank 0 makes it."""
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    yield comm.bcast(tmp_path_factory.mktemp("shared") if comm.rank == 0 else None)
    comm.barrier()


@pytest.fixture(scope="session")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for ``keep``: a reduced model is made once for all tests of a structure."""
    return tmp_path_factory.mktemp("models")


@pytest.fixture
def write_case() -> Callable[..., Path]:
    """A function that puts the case of ``lap_case.toml`` and its data into a folder.

    ``write_case(folder, (old, new), ..., file="case.toml")`` replaces texts of one of the files,
    each of which must stand there once, and returns the folder. Call it on rank 0 only.
    """
    here = Path(__file__).parent

    def write(folder: Path, *edits: tuple[str, str], file: str = "case.toml") -> Path:
        for source in (here.parent / "demos" / "lap_plates").glob("*.csv"):
            shutil.copy(source, folder)
        shutil.copy(here / "lap_case.toml", folder / "case.toml")
        text = (folder / file).read_text(encoding="utf-8")
        for old, new in edits:
            if text.count(old) != 1:
                raise ValueError(f"{old!r} is {text.count(old)} times in {file}, expected once")
            text = text.replace(old, new)
        (folder / file).write_text(text, encoding="utf-8")
        return folder

    return write


@pytest.fixture(scope="session")
def any_browser():
    """A headless Chromium, or None where there is none, and on several ranks."""
    import browser as helper

    mpi = sys.modules.get("mpi4py.MPI")
    if helper.CHROMIUM is None or (mpi is not None and mpi.COMM_WORLD.size > 1):
        yield None
        return
    pytest.importorskip("choreographer", reason="drives the browser")
    found = helper.Browser()
    yield found
    found.close()


@pytest.fixture
def browser(any_browser):
    """A headless Chromium; skips where there is none, and on several ranks."""
    if any_browser is None:
        pytest.skip("no browser, or several ranks")
    return any_browser


@pytest.fixture
def keeps_rules(any_browser, tmp_path) -> Callable[[str], None]:
    """``keeps_rules(page)`` fails as `Browser.check` does, and does nothing without a browser."""

    def check(page: str) -> None:
        if any_browser is not None:
            any_browser.check(page, tmp_path)

    return check

"""The sdist has all that its tests need, the wheel has all rooms and their data."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

# It builds in one process, in a copy of the checkout, without a network.
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes itself")

REPOSITORY = Path(__file__).resolve().parents[2]
FILES = (
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "LICENSE",
    "MANIFEST.in",
    "README.md",
    "pyproject.toml",
    "with-fenicsx",
)
#: Folders of the package, and where an installation has them.
PACKAGES = {
    "fenics_joints": "fenics_joints",
    "forms": "fenics_joints/forms",
    "meshes": "fenics_joints/meshes",
}
#: Folders that git ignores; the blind check keeps some GB in its own.
CACHES = {"__pycache__", "cache", "build"}
FOLDERS = (*PACKAGES, ".ci", ".github", "benchmarks", "conda.recipe", "demos", "docs", "tests")

IMPORT_ALL = """
import importlib, json, pkgutil
import fenics_joints
names = [m.name for m in pkgutil.walk_packages(fenics_joints.__path__, "fenics_joints.")]
names.remove("fenics_joints.__main__")
for name in names:
    importlib.import_module(name)
print(json.dumps({name: importlib.import_module(name).__file__ for name in names}))
"""
COLLECT = "import sys, pytest; sys.exit(pytest.main(['--collect-only', '-q', *sys.argv[1:]]))"


def run(*command: object, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env={**os.environ, **environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, f"{command}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def files(folder: Path) -> set[str]:
    """Files below a folder, but for caches."""
    found = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return {path.as_posix() for path in found if not CACHES & set(path.parts)}


def packaged() -> set[str]:
    """Files of the package, where an installation has them."""
    own = [(place, files(REPOSITORY / folder)) for folder, place in PACKAGES.items()]
    return {f"{place}/{name}" for place, names in own for name in names}


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the unpacked sdist of this checkout is."""
    place = tmp_path_factory.mktemp("sdist")
    checkout = place / "checkout"
    checkout.mkdir()
    for name in FILES:
        shutil.copy(REPOSITORY / name, checkout / name)
    for name in FOLDERS:
        ignored = shutil.ignore_patterns(*CACHES)
        shutil.copytree(REPOSITORY / name, checkout / name, ignore=ignored)
    build = "from setuptools import build_meta; print(build_meta.build_sdist('..'))"
    name = run(sys.executable, "-c", build, cwd=checkout).splitlines()[-1]
    with tarfile.open(place / name) as archive:
        archive.extractall(place, filter="data")
    return place / name.removesuffix(".tar.gz")


@pytest.fixture(scope="module")
def wheel(sdist: Path) -> Path:
    """The wheel made of the sdist."""
    build = "from setuptools import build_meta; print(build_meta.build_wheel('..'))"
    name = run(sys.executable, "-c", build, cwd=sdist).splitlines()[-1]
    return sdist.parent / name


@pytest.fixture(scope="module")
def python(wheel: Path) -> Path:
    """Python of a fresh virtual environment with the wheel and this one's packages."""
    venv = wheel.parent / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", "--system-site-packages", venv, cwd=Path())
    python = venv / "bin" / "python3"
    install = ("--no-deps", "--no-index", "--no-compile", "--disable-pip-version-check")
    run(sys.executable, "-m", "pip", "--python", python, "install", *install, wheel, cwd=Path())
    # Paths alone: this environment's .pth files would add the checkout.
    places = [path for path in sys.path if path.endswith("-packages")]
    (packages,) = (venv / "lib").glob("python3*/site-packages")
    (packages / "packages_of_the_tests.pth").write_text("\n".join(places), encoding="utf-8")
    return python


def test_sdist_has_what_its_tests_need(sdist):
    for folder in FOLDERS:
        assert files(REPOSITORY / folder) - files(sdist / folder) == set(), folder
    assert set(FILES) <= {path.name for path in sdist.iterdir()}
    assert os.access(sdist / "with-fenicsx", os.X_OK)


def test_wheel_has_every_file_of_the_package(wheel):
    with zipfile.ZipFile(wheel) as archive:
        found = {name for name in archive.namelist() if ".dist-info/" not in name}
        (metadata,) = (n for n in archive.namelist() if n.endswith("/METADATA"))
        text = archive.read(metadata).decode()
    assert found == packaged()
    assert "License-Expression: MIT\n" in text and "License-File: LICENSE\n" in text


def test_every_module_imports_from_the_wheel(python, tmp_path):
    (tmp_path / "import_all.py").write_text(IMPORT_ALL, encoding="utf-8")
    said = run(python, tmp_path / "import_all.py", cwd=tmp_path)
    modules = json.loads(said.splitlines()[-1])
    sources = [name.removesuffix(".py") for name in packaged() if name.endswith(".py")]
    expected = {name.removesuffix("/__init__").replace("/", ".") for name in sources}
    assert modules.keys() == expected - {"fenics_joints", "fenics_joints.__main__"}
    outside = {n for n, f in modules.items() if not f.startswith(str(python.parents[1]))}
    assert not outside, "imported from somewhere else"


@pytest.mark.slow
def test_tests_of_the_sdist_collect_beside_the_installed_wheel(sdist, python, tmp_path):
    """Each test finds its helpers, data and what it imports, without the checkout."""
    (tmp_path / "collect.py").write_text(COLLECT, encoding="utf-8")
    said = run(python, tmp_path / "collect.py", "-p", "no:cacheprovider", cwd=sdist)
    assert "error" not in said.lower().splitlines()[-1]


def test_python_in_a_checkout_has_all_rooms(sdist, python):
    """In a checkout its own modules are imported, not those of an installed copy."""
    script = "import fenics_joints.forms as f, fenics_joints.meshes; print(f.__file__)"
    said = run(python, "-c", script, cwd=sdist)
    assert Path(said.strip()) == sdist / "fenics_joints" / "forms" / "__init__.py"


#: Names that are missing are errors, which they would not be of a package that is not found.
LACKING = """
from fenics_joints.forms import elasticity, no_form
from fenics_joints.meshes import dumbbell, no_mesh
"""


@pytest.mark.parametrize("where", ["checkout", "installed"])
def test_mypy_knows_the_names_and_passes_the_scripts_of_the_pages(python, tmp_path, where):
    """As a user's would, against the installed wheel; each takes from at most three modules."""
    pages = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    scripts = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert len(scripts) > 5
    for i, script in enumerate([LACKING, *scripts] if where == "installed" else [LACKING]):
        assert len(set(re.findall(r"^from (fenics_joints[.\w]*)", script, re.MULTILINE))) <= 3
        (tmp_path / f"script_{i}.py").write_text(script, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--ignore-missing-imports", "--follow-imports=silent"]
    command += ["--cache-dir", tmp_path / "cache", "--python-executable", python]
    place = {"MYPYPATH": str(REPOSITORY)} if where == "checkout" else {}
    done = subprocess.run(
        [*command, *tmp_path.glob("*.py")],
        cwd=tmp_path,
        env={**os.environ, **place},
        capture_output=True,
        text=True,
        timeout=120,
    )
    missing = re.findall(r'error: .* has no attribute "(\w+)"', done.stdout)
    assert missing == ["no_form", "no_mesh"] and done.stdout.count("error:") == 2, done.stdout

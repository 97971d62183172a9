"""Citation, changelog, recipe, lock and workflows: their versions, requirements and paths hold."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from mpi4py import MPI
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from fenics_joints import __version__
from fenics_joints.files import read_toml

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about files")

REPOSITORY = Path(__file__).resolve().parents[2]
PROJECT = read_toml(REPOSITORY / "pyproject.toml", "the project")["project"]
#: Names on conda-forge that are not those on PyPI.
ON_CONDA = {"matplotlib": "matplotlib-base"}


class Unique(yaml.SafeLoader):
    """YAML with each key once: a second one would silently win."""

    def construct_mapping(self, node, deep=False):
        keys = [self.construct_object(key, deep=deep) for key, _ in node.value]
        assert len(keys) == len(set(keys)), f"{node.start_mark}: a key stands twice"
        return super().construct_mapping(node, deep)


def read(name: str):
    return yaml.load((REPOSITORY / name).read_text(encoding="utf-8"), Unique)


def test_citation_is_of_this_version_in_the_format():
    c = read("CITATION.cff")
    assert {"cff-version", "message", "title", "authors"} <= c.keys()
    assert str(c["version"]) == PROJECT["version"] == __version__
    assert c["license"] == PROJECT["license"] and c["cff-version"] == "1.2.0"
    assert [a["name"] for a in c["authors"]] == [a["name"] for a in PROJECT["authors"]]
    for reference in c["references"]:
        assert {"type", "title", "authors"} <= reference.keys()
        assert re.fullmatch(r"10\.\d{4,}/\S+", reference.get("doi", "10.0000/none"))


def test_changelog_is_kept():
    text = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = re.findall(r"^## \[(.+?)\]", text, re.M)
    assert versions[0] == "Unreleased" and len(set(versions)) == len(versions)
    kinds = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    found = re.findall(r"^### (.+)$", text, re.M)
    assert found and set(found) <= kinds


def test_recipe_asks_for_what_the_project_asks():
    recipe = read("conda.recipe/recipe.yaml")
    assert recipe["context"]["version"] == PROJECT["version"]
    assert f">={recipe['context']['python_min']}" == PROJECT["requires-python"]
    run = dict(line.partition(" ")[::2] for line in recipe["requirements"]["run"])
    for line in PROJECT["dependencies"]:
        name, versions = re.match(r"([\w-]+)(>=[\d.]+(?:,<[\d.]+)?)", line).groups()
        assert run[ON_CONDA.get(name, name)] == versions, line
    (script,) = PROJECT["scripts"].items()
    assert recipe["build"]["python"]["entry_points"] == [" = ".join(script)]
    # Versions of DOLFINx are those of the launcher.
    launcher = (REPOSITORY / "with-fenicsx").read_text(encoding="utf-8")
    oldest, newest = re.search(r'OLDEST="(.+?)" NEWEST="0\.(\d+)"', launcher).groups()
    assert run["fenics-dolfinx"] == f">={oldest},<0.{int(newest) + 1}"
    assert (REPOSITORY / recipe["about"]["license_file"]).is_file()


def test_locked_versions_are_those_that_the_project_asks_for():
    """Each with hashes; what the lock does not have is Debian's own."""
    text = (REPOSITORY / "requirements.lock").read_text(encoding="utf-8")
    entries = re.findall(r"^([\w.-]+)==(\S+) \\\n((?:    --hash=\S+(?: \\)?\n)+)", text, re.M)
    lines = [line for line in text.splitlines() if line and line[0] not in " #"]
    assert len(entries) == len(lines) > 50  # no line without hashes
    hashes = r"(?:--hash=sha256:[0-9a-f]{64}[\s\\]*)+"
    assert all(re.fullmatch(hashes, given.strip()) for _, _, given in entries)
    locked = {canonicalize_name(name): version for name, version, _ in entries}
    asked = (*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["test"])
    for each in map(Requirement, asked):
        if (version := locked.get(canonicalize_name(each.name))) is not None:
            assert each.specifier.contains(version), each
    assert {"h5py", "pint", "pytest", "cryptography"} <= locked.keys()
    assert not {"numpy", "mpi4py", "petsc4py", "slepc4py", "scipy"} & locked.keys()


def test_hosted_tests_run_on_every_version_and_name_files_that_are_there():
    workflow = read(".github/workflows/tests.yml")
    assert {"push", "pull_request"} <= workflow[True].keys()  # YAML reads "on" as a truth value
    jobs = workflow["jobs"]
    versions = jobs["conda"]["strategy"]["matrix"]["dolfinx"]
    assert versions == ["0.9", "0.10", "0.11"]  # texts: 0.10 is not 0.1
    for job in jobs.values():
        assert job["timeout-minutes"] and job["runs-on"]
        matrix = job.get("strategy", {}).get("matrix", {})
        for used in re.findall(r"matrix\.(\w+)", str(job)):
            assert used in matrix
        for step in job["steps"]:
            assert ("run" in step) != ("uses" in step)
            assert "@v" in step.get("uses", "@v")
            for word in step.get("run", "").split():
                if word.startswith(("./", "demos", "tests")):
                    assert (REPOSITORY / word).exists(), word


def test_issue_forms_have_what_their_schema_asks_for():
    for form in (REPOSITORY / ".github/ISSUE_TEMPLATE").glob("[!c]*.yml"):
        content = read(form)
        assert {"name", "description", "body"} <= content.keys()
        ids = [part["id"] for part in content["body"]]
        assert len(set(ids)) == len(ids)
        kinds = {"textarea", "input", "checkboxes", "dropdown", "markdown"}
        for part in content["body"]:
            assert part["type"] in kinds and part["attributes"]["label"]

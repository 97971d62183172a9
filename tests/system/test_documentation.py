"""Pages say what exists: links, anchors, imports, commands and options, keys of case files."""

from __future__ import annotations

import html
import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

pytest.importorskip("dolfinx")

import tomllib
import typer
from mpi4py import MPI
from pydantic import ValidationError

from fenics_joints.case import Case
from fenics_joints.cli import app

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="reads text files")

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/*.md", "demos/**/*.md", "benchmarks/**/*.md")
    for path in REPOSITORY.glob(pattern)
)
SHELLS = ("sh", "")
LINK = re.compile(r"(?<!`)\]\((?!https?:|mailto:)([^)\s]*)\)")


def name(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def prose(text: str) -> str:
    """A page without its blocks and spans of code."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`\n]+`", "", text)


def blocks(page: Path, *languages: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"^```([\w-]*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return [body for language, body in found if language in languages]


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.M)
    titles = re.findall(r"^#+ +(.+)$", text, re.MULTILINE)
    plain = (re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", title) for title in titles)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in plain}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    for link in LINK.findall(prose(page.read_text(encoding="utf-8"))):
        place, _, anchor = link.partition("#")
        target = (page.parent / place).resolve() if place else page
        assert target.exists(), f"{name(page)} links to {link}, which does not exist"
        if anchor:
            assert target.suffix == ".md" and anchor in anchors(target), link


def test_every_page_is_reached_from_the_readme():
    """By links of Markdown pages alone, as one who reads on the web finds them."""
    reached, ahead = set(), [REPOSITORY / "README.md"]
    while ahead:
        page = ahead.pop()
        if page in reached:
            continue
        reached.add(page)
        for link in LINK.findall(prose(page.read_text(encoding="utf-8"))):
            target = (page.parent / link.partition("#")[0]).resolve()
            if target.suffix == ".md" and target.is_file():
                ahead.append(target)
    assert set(PAGES) <= reached


def test_the_readme_is_short_and_says_what_to_type_first():
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert text.count("\n") <= 150
    typed = "".join(blocks(REPOSITORY / "README.md", "sh")).splitlines()
    first = "./with-fenicsx fenics-joints diagnose demos/lap_plates --report diagnosis.html"
    assert typed[0] == first
    assert typed[1] == "./with-fenicsx pytest -n 2"
    assert typed[1] in (REPOSITORY / ".ci" / "run").read_text(encoding="utf-8")


def test_sources_are_named_by_author_year_or_title():
    """ "Seed 000" is a file name of ours; readers know papers."""
    for page in PAGES:
        assert not re.search(r"\bseeds? 00\d", page.read_text(encoding="utf-8"), re.I), name(page)


def shell_lines(page: Path) -> list[list[str]]:
    """Words of every shell line that starts this project's launcher or command."""
    lines = "\n".join(blocks(page, *SHELLS)).replace("\\\n", " ").splitlines()
    starts = ("./with-fenicsx ", "fenics-joints ", "FENICSX_SUITE=")
    return [shlex.split(line, comments=True) for line in lines if line.startswith(starts)]


@pytest.mark.parametrize("page", [p for p in PAGES if shell_lines(p)], ids=name)
def test_shell_lines_name_commands_options_and_files_that_exist(page):
    for words in shell_lines(page):
        for word in words:
            if re.match(r"(demos|tests|benchmarks|docs)/", word) and "*" not in word:
                assert (REPOSITORY / word).exists(), f"{name(page)}: no {word}"
        if "fenics-joints" in words:
            _check_command(words[words.index("fenics-joints") + 1 :])


def _check_command(words: list[str]) -> None:
    """A command of the tree, down to where there are no more, and its options."""
    command = typer.main.get_command(app)
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"no command {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    known = {option for parameter in command.params for option in parameter.opts}
    known |= set(command.context_settings.get("help_option_names", [])) | {"--help"}
    for word in words:
        if word.startswith("-") and len(word) > 1:
            assert word.partition("=")[0] in known, f"{command.name} has no {word}"


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "toml")], ids=name)
def test_case_files_in_pages_have_keys_that_exist(page):
    """And values; but a page shows parts of a case, so that some are missing."""
    expected = ("missing", "no_kind", "value_error")
    for text in blocks(page, "toml"):
        if "[build-system]" in text:  # of a package
            continue
        wrong = []
        try:
            Case.model_validate(tomllib.loads(text))
        except ValidationError as error:
            wrong = [e for e in error.errors() if e["type"] not in expected]
        assert not wrong, name(page)


def _scripts():
    for page in [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]:
        text = page.read_text(encoding="utf-8")
        for found in re.finditer(
            r"<!-- output: the script above -->\n\n```text\n(.*?)```", text, re.S
        ):
            marks = [pytest.mark.slow] if page.stem == "own-model" else []
            name = f"{page.stem}-{text[: found.start()].count('script above')}"
            yield pytest.param(text[: found.start()], found[1], id=name, marks=marks)


@pytest.mark.parametrize(("text", "shown"), list(_scripts()))
def test_scripts_print_what_their_page_shows(text, shown):
    """The same words, and numbers within two per cent, as other versions of gmsh may give."""
    outputs = maker()
    printed = outputs.script_output(text)
    assert outputs.same(printed, shown), printed


def maker():
    """The module that writes what commands print into pages."""
    spec = importlib.util.spec_from_file_location("outputs", REPOSITORY / "docs" / "outputs.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["outputs"] = module  # where its dataclass looks for names
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["json", "database"])
def test_pages_that_are_made_are_up_to_date(name, tmp_path):
    """The keys of the JSON, and what a quick command prints."""
    outputs, page = maker(), REPOSITORY / "docs" / f"{name}.md"
    old = page.read_text(encoding="utf-8")
    assert outputs.same(outputs.Maker(tmp_path, quick=True, pictures=False).page(page, old), old)


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    """Without a network and without running demos; the whole site, links between its pages too."""
    pytest.importorskip("sphinx")
    command = [sys.executable, REPOSITORY / "docs" / "build.py", tmp_path / "site", "--static"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    built = {p: p.read_text(encoding="utf-8") for p in (tmp_path / "site").rglob("*.html")}
    there = {p: set(re.findall(r'\b(?:id|name)="([^"]+)"', text)) for p, text in built.items()}
    lost = []
    for page, text in built.items():
        for link in map(html.unescape, re.findall(r'\b(?:href|src)="([^"]*)"', text)):
            place, _, anchor = unquote(link).partition("#")
            target = (page.parent / place.partition("?")[0]).resolve() if place else page
            known = there.get(target, {anchor}) | {""}
            if not re.match(r"https?:|mailto:|data:", link):
                if not target.exists() or anchor not in known:
                    lost.append((page.name, link))
    assert len(built) > 60 and not lost
    for page, text in built.items():
        if page.parent.name == "gallery":
            assert re.search(r'<img alt="[^"]{20}', text), f"{page.name} has no picture"


def made_by(name: str):
    """The module of the site of this name."""
    path = REPOSITORY / "docs" / "site_pages" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("room", "example"), made_by("api").EXAMPLES.items())
def test_an_example_of_each_room_has_its_names(room, example):
    pytest.importorskip("jupytext")
    names = importlib.import_module(f"fenics_joints.{room}").__all__
    code = made_by("api").example(*example)
    assert any(re.search(rf"\b{name}\b", code) for name in names)


def test_table_of_nonlinear_laws():
    """`docs/site_pages/laws.py` writes it from the classes of the case file."""
    laws = made_by("laws")
    found = laws.table()
    assert "`E_p` | Pa | needed" in found and found in laws.PAGE.read_text(encoding="utf-8")

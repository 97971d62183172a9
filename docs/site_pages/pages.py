"""The repository's Markdown pages, with their links turned to each other's place on the site."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path

#: Captions of the site's side bar, and their pages.
SECTIONS = {
    "Start": ("tutorial", "install", "diagnosis", "notebooks", "gallery/index"),
    "How to build a model": ("case", "own-mesh", "own-matrices", "beams", "preload", "database"),
    "How to use test data": ("own-data", "formats", "diagnosis-data", "levels", "amplitude"),
    "How to compute and update": ("functions", "slip", "updating", "posterior", "cluster"),
    "How to extend": ("forms", "own-law", "own-effect", "own-model", "own-package"),
    "Reference": (
        "glossary",
        "commands",
        "case-file",
        "json",
        "diagnosis-effects",
        "diagnosis-method",
        "theory",
        "thresholds",
        "limits",
        "security",
        "api/index",
    ),
    "Validation": ("blind", "blind-misses", "nonlinear_checks", "benchmarks", "speed", "peers"),
    "Project": ("contributing", "changelog"),
}
#: Pages that stand elsewhere in the repository.
ELSEWHERE = {
    "README.md": "index",
    "CONTRIBUTING.md": "contributing",
    "CHANGELOG.md": "changelog",
    "benchmarks/README.md": "benchmarks",
    "benchmarks/blind/README.md": "blind",
    "benchmarks/blind/checks/2026-11-28-misses.md": "blind-misses",
}
LINK = re.compile(r"(?<!`)\]\((?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]*)?\)")


def write(repository: Path, source: Path) -> None:
    """Write all pages but those that are made from code."""
    sites = places(repository)
    for original, page in sites.items():
        if page.startswith("gallery/"):
            continue  # with their scripts and pictures
        text = relinked((repository / original).read_text("utf-8"), original, sites, source)
        if page == "index":
            text += _contents(source, set(sites.values()))
        target = source / f"{page}.md"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")


def places(repository: Path) -> dict[str, str]:
    """Each Markdown page of the repository, and the page of the site that it becomes."""
    found = dict(ELSEWHERE)
    for path in sorted((repository / "docs").glob("*.md")):
        found[f"docs/{path.name}"] = path.stem
    for path in sorted((repository / "demos").glob("*/README.md")):
        found[f"demos/{path.parent.name}/README.md"] = f"gallery/{path.parent.name}"
    return found


def relinked(text: str, original: str, sites: Mapping[str, str], source: Path) -> str:
    """A page's text with links that work on the site.

    Links to pages lead to the site's; pictures and other files are copied to ``files/``, from where
    they are shown or downloaded.

    Args:
        text: Of the page.
        original: Its path in the repository.
        sites: As from `places`.
        source: The site's folder of sources.
    """
    here = sites[original]
    repository = Path(__file__).resolve().parents[2]

    def turned(match: re.Match) -> str:
        path = os.path.normpath(os.path.join(os.path.dirname(original), match[1]))
        page = sites.get(path) or sites.get(f"{path}/README.md") or _notebook(path)
        if page:
            place = f"{page}.md"
        else:
            place = f"files/{path}"
            (source / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(repository / path, source / place)
        return f"]({os.path.relpath(place, os.path.dirname(here) or '.')}{match[2] or ''})"

    blocks = re.split(r"(^```.*?^```$)", text, flags=re.DOTALL | re.MULTILINE)
    return "".join(part if part.startswith("```") else LINK.sub(turned, part) for part in blocks)


def _notebook(path: str) -> str | None:
    """The page of one of the notebooks."""
    folder, _, file = path.rpartition("/")
    return f"notebooks/{file[:-3]}" if folder == "docs/notebooks" else None


def _contents(source: Path, known: set[str]) -> str:
    """The side bar; pages that no section names stand under More."""
    sections = dict(SECTIONS)
    named = {"index", *(page for pages in SECTIONS.values() for page in pages)}
    more = tuple(sorted(p for p in known - named if not p.startswith("gallery/")))
    made = {*known, "gallery/index", "api/index", "case-file"}
    text = ""
    for caption, pages in {**sections, **({"More": more} if more else {})}.items():
        listed = "\n".join(page for page in pages if page in made)
        text += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{listed}\n```\n"
    return text

"""The demos: their pages, their scripts as stories, what they print, and their pictures."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from site_pages.pages import places, relinked

#: Of the processor, for a demo that is run while the site is built; and at most so many times as
#: long on a busy machine. Those in LONG take more, and keep their picture.
SECONDS, BUSY = 60, 5
LONG = frozenset(
    {
        "demo_bayes",
        "demo_c_beam",
        "demo_diagnosis",
        "demo_dumbbell",
        "demo_engraving_machine",
        "demo_lap_plates",
    }
)
HEAD = """# Gallery

Each demo is a structure with its own page, and one or more scripts that read as a story: run as
they are, or turned into notebooks by jupytext. Each asserts a published number.
Pictures are drawn by the scripts{when}.

"""


def write(repository: Path, source: Path, run: bool, long: bool = False) -> None:
    """Write `gallery/index.md`, and a page for each demo and for each of its scripts.

    Args:
        repository: Where `demos/` is.
        source: The site's folder of sources.
        run: Run the demos that take less than a minute; the others keep the pictures in
            `docs/gallery`.
        long: Run the others, too.
    """
    folder = source / "gallery"
    folder.mkdir()
    text = HEAD.format(when=", here while the site was built" if run else "")
    names = []
    for readme in sorted(repository.glob("demos/*/README.md")):
        name = readme.parent.name
        names.append(name)
        page = relinked(
            readme.read_text("utf-8"), f"demos/{name}/README.md", places(repository), source
        )
        scripts = sorted(readme.parent.glob("demo_*.py"))
        if (repository / "docs" / "gallery" / f"{name}.png").exists():
            shutil.copy(repository / "docs" / "gallery" / f"{name}.png", folder)
        stories = [_story(script, folder, run, long) for script in scripts]
        (folder / f"{name}.md").write_text(page + _scripts(stories), encoding="utf-8")
        text += _card(name, folder, page, stories)
    text += "\n```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n"
    (folder / "index.md").write_text(text, encoding="utf-8")


def _story(script: Path, folder: Path, run: bool, long: bool) -> tuple[str, str, bool]:
    """Write a script's page; its name, title, and whether it has a picture."""
    name = script.stem
    picture = folder / f"{name}.png"
    printed = _run(script, picture, long) if run and (long or name not in LONG) else None
    committed = script.parents[2] / "docs" / "gallery" / f"{name}.png"
    if not picture.exists() and committed.exists():
        shutil.copyfile(committed, picture)
    text = _markdown(script)
    title, _, rest = text.partition("\n")
    shown = f"\n![{title.strip('# ')}]({name}.png)\n" if picture.exists() else ""
    if printed:
        rest += f"\n## What it prints\n\n```text\n{printed.strip()}\n```\n"
    (folder / f"{name}.md").write_text(f"{title}\n{shown}{rest}", encoding="utf-8")
    return name, title.strip("# "), picture.exists()


def _run(script: Path, picture: Path, long: bool) -> str | None:
    """What a script prints, or None if it takes too long; if it fails, so does the site."""
    command = [sys.executable, str(script), str(picture)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    limits = {} if long else {"timeout": BUSY * SECONDS, "preexec_fn": _limited}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, **limits)
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        picture.unlink(missing_ok=True)
        print(f"{script.name} takes more than {SECONDS} s here: the picture is the committed one")
        return None
    if done.returncode:
        raise SystemExit(f"{script} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))


def _markdown(script: Path) -> str:
    """A script in jupytext's light format as Markdown."""
    import jupytext

    text = jupytext.writes(jupytext.read(script, fmt="py:light"), fmt="md")
    text = re.sub(r"\A---\n.*?\n---\n+", "", text, flags=re.DOTALL)
    return re.sub(r"^<!-- #(end)?region.*-->\n", "", text, flags=re.MULTILINE)


def _scripts(stories: list[tuple[str, str, bool]]) -> str:
    if not stories:
        return ""
    text = "\n## The scripts\n\n"
    for name, title, picture in stories:
        text += f"[{title}]({name}.md)\n\n"
        text += f"[![{title}]({name}.png)]({name}.md)\n\n" if picture else ""
    listed = "\n".join(name for name, _, _ in stories)
    return f"{text}```{{toctree}}\n:hidden:\n\n{listed}\n```\n"


def _card(name: str, folder: Path, page: str, stories: list[tuple[str, str, bool]]) -> str:
    """The demo's title, first paragraph and first picture."""
    title = re.match(r"# (.*)", page)[1]
    text = f"## [{title}]({name}.md)\n\n"
    pictures = [story[0] for story in stories if story[2]]
    if pictures or (folder / f"{name}.png").exists():
        text += f"[![{title}]({(pictures or [name])[0]}.png)]({name}.md)\n\n"
    return text

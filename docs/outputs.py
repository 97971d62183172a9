"""Writes numbers and pictures into pages: ``./with-fenicsx python3 docs/outputs.py [PAGE ...]``.

A block of text in a Markdown page is replaced by what a command prints if a comment stands above:

    <!-- output: fenics-joints diagnose demos/lap_plates | until Compared | columns 80 | slow -->

``output: the script above`` stands for the last block of Python before it. ``from`` and ``until``
leave out the lines before the first one that begins with these words, or from there on; ``columns``
is the width of the terminal, 100 by default. A picture is replaced likewise:

    <!-- picture: fenics-joints modes demos/barc | show .stage | width 1000 -->

by the top of the command's page, 760 pixels of it or as many as ``height`` says, or by the element
that ``show`` names; ``the script above`` writes a picture of this name itself. Pictures of pages
take a Chromium.

Commands run in the repository, each once; scripts in an empty folder. ``docs/json.md`` and
``docs/thresholds.md`` are made from the code. All pages by default. With ``--check`` nothing is
written, and the exit status is 1 if words would change or numbers by more than two per cent;
pictures are not compared. With ``--quick`` what is marked ``slow`` is left as it is.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
sys.path[:0] = [str(DOCS), str(REPOSITORY), str(REPOSITORY / "tests" / "helpers")]
PAGES = ("*.md", "docs/*.md", "demos/*/README.md")
BLOCK = re.compile(
    r"(?P<mark><!-- output: (?P<what>[^\n]+) -->\n\n?```text\n)(?P<old>.*?)(?=^```$)",
    re.DOTALL | re.M,
)
PICTURE = re.compile(r"<!-- picture: (?P<what>[^\n]+) -->\n\n?!\[[^]]*\]\((?P<file>[^)]+)\)")
NUMBER = r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?"
SCRIPT = "the script above"


def main() -> int:
    """Write the pages, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("pages", nargs="*", type=Path, help="all by default")
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    parser.add_argument("--quick", action="store_true", help="only what takes less than a minute")
    arguments = parser.parse_args()
    every = [page for pattern in PAGES for page in sorted(REPOSITORY.glob(pattern))]
    changed = False
    with tempfile.TemporaryDirectory() as folder:
        made = Maker(Path(folder), arguments.quick, pictures=not arguments.check)
        for page in (page.resolve() for page in arguments.pages or every):
            old = page.read_text(encoding="utf-8")
            new = made.page(page, old)
            if new != old and not (arguments.check and same(new, old)):
                changed = True
                name = page.relative_to(REPOSITORY)
                print(f"{name}: {'out of date' if arguments.check else 'written'}", flush=True)
                if not arguments.check:
                    page.write_text(new, encoding="utf-8")
    return int(changed and arguments.check)


def same(new: str, old: str) -> bool:
    """Whether two texts have the same words, and numbers within two per cent."""
    if re.sub(NUMBER, "#", new).split() != re.sub(NUMBER, "#", old).split():
        return False
    pairs = zip(re.findall(NUMBER, new), re.findall(NUMBER, old), strict=True)
    return all(abs(float(a) - float(b)) <= 0.02 * abs(float(b)) + 0.011 for a, b in pairs)


@dataclass
class Maker:
    """Runs commands and scripts, each once.

    Attributes:
        folder: Where they write.
        quick: Whether what is slow is left out.
        pictures: Whether pictures are made.
        printed: What was printed by command and columns, or by script.
    """

    folder: Path
    quick: bool
    pictures: bool
    printed: dict[tuple[str, str], tuple[str, Path]] = field(default_factory=dict)

    def page(self, page: Path, text: str) -> str:
        """A page with new blocks; its pictures are written beside it."""
        for name in ("results", "thresholds"):
            module = __import__(f"site_pages.{name}", fromlist=[name])
            if page == module.PAGE:
                return module.page()
        for found in PICTURE.finditer(text) if self.pictures else ():
            self._picture(page, found)
        return BLOCK.sub(self._block, text)

    def _block(self, block: re.Match) -> str:
        command, options = _read(block["what"])
        if self.quick and "slow" in options:
            return block[0]
        text, _ = self._run(command, options.get("columns", "100"), block)
        lines = text.splitlines()
        for key in ("from", "until"):
            if key in options:
                at = next((i for i, s in enumerate(lines) if s.startswith(options[key])), None)
                if at is None:
                    raise SystemExit(f"{command}: no line begins with {options[key]!r}")
                lines = lines[at:] if key == "from" else lines[:at]
        return block["mark"] + "\n".join(lines).strip("\n") + "\n"

    def _picture(self, page: Path, found: re.Match) -> None:
        command, options = _read(found["what"])
        if self.quick and "slow" in options:
            return
        _, folder = self._run(command, options.get("columns", "100"), found)
        target = page.parent / found["file"]
        if command == SCRIPT:
            shutil.copyfile(folder / target.name, target)
            return
        from browser import CHROMIUM, Browser

        if CHROMIUM is None:
            print(f"{target.relative_to(REPOSITORY)}: left as it is, there is no Chromium")
            return
        browser = Browser()
        try:
            size = int(options.get("width", 1000)), int(options.get("height", 760))
            browser.picture(folder / "page.html", target, size, options.get("show", ""))
        finally:
            browser.close()

    def _run(self, command: str, columns: str, found: re.Match) -> tuple[str, Path]:
        """What a command or the script above prints, and the folder with what it wrote."""
        key = (command, columns)
        if command == SCRIPT:
            key = (_last_script(found.string[: found.start()]), "")
        if key not in self.printed:
            folder = self.folder / str(len(self.printed))
            folder.mkdir()
            run = _script if command == SCRIPT else _command
            self.printed[key] = run(key[0], columns, folder), folder
        return self.printed[key]


def _read(what: str) -> tuple[str, dict[str, str]]:
    command, *options = (part.strip() for part in what.split("|"))
    return command, {key: value for key, _, value in (o.partition(" ") for o in options)}


def script_output(text: str) -> str:
    """What the last block of Python in a text prints."""
    with tempfile.TemporaryDirectory() as folder:
        return _script(_last_script(text), "", Path(folder))


def _last_script(text: str) -> str:
    return re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.M)[-1]


def _script(script: str, columns: str, folder: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
    run = [sys.executable, "-c", script]
    done = subprocess.run(run, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return done.stdout.strip("\n") + "\n"


def _command(command: str, columns: str, folder: Path) -> str:
    """What a command prints, without its progress and without the files that it wrote."""
    name, *arguments = shlex.split(command)
    if name != "fenics-joints":
        raise SystemExit(f"{command}: expected a command of fenics-joints")
    page = [] if arguments[0] in ("database", "new") else ["--report", str(folder / "page.html")]
    print(f"{command} ...", flush=True)
    done = subprocess.run(
        [sys.executable, "-m", "fenics_joints", *arguments, *page],
        cwd=REPOSITORY,
        env={**os.environ, "COLUMNS": columns, "NO_COLOR": "1", "FENICS_JOINTS_RANKS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        check=True,
    )
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    return "\n".join(line for line in lines if not line.startswith("wrote "))


if __name__ == "__main__":
    sys.exit(main())

"""Writes what commands print into pages: ``./with-fenicsx python3 docs/outputs.py [PAGE ...]``.

A block of text in a Markdown page is replaced by what a command prints if a comment stands above:

    <!-- output: fenics-joints diagnose demos/lap_plates | until Compared | columns 80 -->

``output: the script above`` stands for the last block of Python before it. ``until`` leaves out the
first line that begins with these words, and all after it; ``columns`` is the width of the terminal,
100 by default. Commands run in the repository, each once; scripts in an empty folder. All pages by
default. With ``--check`` nothing is written, and the exit status is 1 if a page would change.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = ("*.md", "docs/*.md", "demos/*/README.md")
BLOCK = re.compile(
    r"(?P<mark><!-- output: (?P<what>[^\n]+) -->\n\n?```text\n)(?P<old>.*?)(?=^```$)",
    re.DOTALL | re.M,
)


def main() -> int:
    """Write the pages, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("pages", nargs="*", type=Path, help="all by default")
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    arguments = parser.parse_args()
    every = [page for pattern in PAGES for page in sorted(REPOSITORY.glob(pattern))]
    changed = False
    for page in arguments.pages or every:
        old = page.read_text(encoding="utf-8")
        new = BLOCK.sub(_written, old)
        if new != old:
            changed = True
            print(f"{page}: {'out of date' if arguments.check else 'written'}")
            if not arguments.check:
                page.write_text(new, encoding="utf-8")
    return int(changed and arguments.check)


def _written(block: re.Match) -> str:
    command, *options = (part.strip() for part in block["what"].split("|"))
    if command == "the script above":
        return block["mark"] + script_output(block.string[: block.start()])
    given = dict(option.split(" ", 1) for option in options)
    lines = _printed(command, given.get("columns", "100")).splitlines()
    if "until" in given:
        last = next(i for i, line in enumerate(lines) if line.startswith(given["until"]))
        lines = lines[:last]
    return block["mark"] + "\n".join(lines).strip("\n") + "\n"


def script_output(text: str) -> str:
    """What the last block of Python in a text prints."""
    script = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.M)[-1]
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
        run = [sys.executable, "-c", script]
        done = subprocess.run(run, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return done.stdout.strip("\n") + "\n"


@cache
def _printed(command: str, columns: str) -> str:
    """What a command prints, without its progress."""
    name, *arguments = shlex.split(command)
    if name != "fenics-joints":
        raise SystemExit(f"{command}: expected a command of fenics-joints")
    done = subprocess.run(
        [sys.executable, "-m", "fenics_joints", *arguments],
        cwd=REPOSITORY,
        env={**os.environ, "COLUMNS": columns, "NO_COLOR": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return "\n".join(line.rstrip() for line in done.stdout.splitlines())


if __name__ == "__main__":
    sys.exit(main())

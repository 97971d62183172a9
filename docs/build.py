"""Builds the documentation as a web site: ``./with-fenicsx python3 docs/build.py [FOLDER]``.

Into ``build/docs`` unless told otherwise, with Sphinx, MyST and furo (``fenics-joints[docs]``),
from the Markdown pages of the repository, docstrings, the case file's schema and the demos. It
needs no network. Demos that take less than a minute are run; with ``--static`` none is.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from pathlib import Path

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
sys.path.insert(0, str(DOCS))

from site_pages import api, gallery, pages, reference  # noqa: E402


def main() -> int:
    """Assemble the sources, let Sphinx build them; a warning is a failure."""
    arguments = _arguments()
    source = arguments.folder.with_name(arguments.folder.name + "-source")
    started = time.monotonic()
    shutil.rmtree(source, ignore_errors=True)
    source.mkdir(parents=True)
    pages.write(REPOSITORY, source)
    reference.write(source)
    api.write(source)
    gallery.write(REPOSITORY, source, run=not arguments.static)
    from sphinx.cmd.build import build_main

    options = ["-b", "html", "-c", str(DOCS), "-d", str(source.with_name("doctrees")), "-E", "-q"]
    os.environ.setdefault("PYTHONHASHSEED", "0")
    status = build_main([*options, "-W", "--keep-going", str(source), str(arguments.folder)])
    size = sum(path.stat().st_size for path in arguments.folder.rglob("*") if path.is_file())
    print(f"{arguments.folder}/index.html: {size / 1e6:.1f} MB, {time.monotonic() - started:.0f} s")
    return status


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=REPOSITORY / "build" / "docs")
    parser.add_argument("--static", action="store_true", help="run no demo")
    arguments = parser.parse_args()
    arguments.folder = arguments.folder.resolve()
    return arguments


if __name__ == "__main__":
    sys.exit(main())

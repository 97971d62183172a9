"""Builds the documentation as a web site: ``./with-fenicsx python3 docs/build.py [FOLDER]``.

Into ``build/docs`` unless told otherwise, with Sphinx, MyST and furo (``fenics-joints[docs]``),
from the Markdown pages of the repository, docstrings, the case file's schema and the demos. It
needs no network; with one, types of other packages are links to their documentation. Notebooks,
and demos that take less than a minute, are run; with ``--all`` every demo, with ``--static`` none
is. With ``--links`` nothing is built: links that lead elsewhere are followed, which takes a
network.
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

from site_pages import api, gallery, notebooks, pages, reference  # noqa: E402


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
    run = not (arguments.static or arguments.links)
    notebooks.write(REPOSITORY, source, run)
    gallery.write(REPOSITORY, source, run, long=arguments.all)
    from sphinx.cmd.build import build_main

    builder = "linkcheck" if arguments.links else "html"
    options = ["-b", builder, "-c", str(DOCS), "-d", str(source.with_name("doctrees")), "-E", "-q"]
    os.environ.setdefault("PYTHONHASHSEED", "0")
    status = build_main([*options, "-W", "--keep-going", str(source), str(arguments.folder)])
    if arguments.links:
        print(f"{arguments.folder}/output.txt: {'broken links' if status else 'no link is broken'}")
        return status
    size = sum(path.stat().st_size for path in arguments.folder.rglob("*") if path.is_file())
    print(f"{arguments.folder}/index.html: {size / 1e6:.1f} MB, {time.monotonic() - started:.0f} s")
    return status


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, help="build/docs, or build/links")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--static", action="store_true", help="run no demo")
    which.add_argument("--all", action="store_true", help="run the demos that take minutes, too")
    parser.add_argument("--links", action="store_true", help="follow links that lead elsewhere")
    arguments = parser.parse_args()
    usual = REPOSITORY / "build" / ("links" if arguments.links else "docs")
    arguments.folder = (arguments.folder or usual).resolve()
    return arguments


if __name__ == "__main__":
    sys.exit(main())

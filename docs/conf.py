"""Sphinx's settings; `build.py` assembles the sources and starts it."""

from __future__ import annotations

import re
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import requests

sys.path.insert(0, str(Path(__file__).parent))

from site_pages import mathml, prose

from fenics_joints import __version__

project = "fenics_joints"
author = "The fenics_joints authors"
copyright = author
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
root_doc = "index"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
# Blocks without a language, and toml with "..." in it, stay as they are; "n" in a shape is no name.
suppress_warnings = ["misc.highlighting_failure", "ref.python"]
highlight_language = "text"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
maximum_signature_line_length = 88

#: Documentation to which names of types lead.
OTHERS = {
    "dolfinx": "https://docs.fenicsproject.org/dolfinx/main/python/",
    "ufl": "https://docs.fenicsproject.org/ufl/main/",
    "basix": "https://docs.fenicsproject.org/basix/main/python/",
    "petsc4py": "https://petsc.org/release/petsc4py/",
    "slepc4py": "https://slepc.upv.es/release/slepc4py/",
    "mpi4py": "https://mpi4py.readthedocs.io/en/stable/",
    "numpy": "https://numpy.org/doc/stable/",
    "scipy": "https://docs.scipy.org/doc/scipy/",
    "python": "https://docs.python.org/3/",
}
#: Seconds to wait for each of their inventories.
PATIENCE = 3

# Followed by `build.py --links`. Anchors of GitHub's pages are made by scripts.
linkcheck_anchors_ignore_for_url = [r"https://github\.com/"]
linkcheck_ignore = [f"{re.escape(url)}.*#" for url in OTHERS.values()]
linkcheck_timeout, linkcheck_retries, linkcheck_workers = 20, 2, 4

html_theme = "furo"
html_title = "fenics_joints"
html_copy_source = False
html_show_sourcelink = False
html_static_path = ["static"]
html_search_scorer = str(Path(__file__).parent / "static" / "search.js")
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}
html_permalinks_icon = "#"


def setup(app):
    """Formulas as MathML, which needs no network; docstrings in the words of this project."""
    mathml.setup(app)
    prose.setup(app)
    app.config.intersphinx_mapping = _inventories(Path(app.outdir).with_name("inventories"))
    app.connect("html-collect-pages", _only_read, priority=100)


def _only_read(app) -> tuple[()]:
    """Leave modules that viewcode could not parse out of its index: they have no page."""
    read = app.env._viewcode_modules
    app.env._viewcode_modules = {name: entry for name, entry in read.items() if entry}
    return ()


def _inventories(folder: Path) -> dict:
    """Inventories that are in a folder or can be fetched into it; without a network, none."""

    def fetched(name: str) -> bool:
        kept = folder / f"{name}.inv"
        try:
            if not kept.exists():
                found = requests.get(f"{OTHERS[name]}objects.inv", timeout=PATIENCE).content
                if found.startswith(b"# Sphinx inventory version 2"):
                    kept.write_bytes(found)
        except OSError:
            pass
        return kept.exists()

    folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(len(OTHERS)) as pool:
        there = zip(OTHERS.items(), pool.map(fetched, OTHERS), strict=True)
    return {name: (url, str(folder / f"{name}.inv")) for (name, url), found in there if found}

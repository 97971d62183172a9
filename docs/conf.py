"""Sphinx's settings; `build.py` assembles the sources and starts it."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from site_pages import mathml, prose

from fenics_joints import __version__

project = "fenics_joints"
author = "The fenics_joints authors"
copyright = author
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
# Blocks without a language, and toml with "..." in it, stay as they are; "n" in a shape is no name.
suppress_warnings = ["misc.highlighting_failure", "ref.python"]
highlight_language = "none"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False

# Followed by `build.py --links`. Anchors of GitHub's pages are made by scripts.
linkcheck_anchors_ignore_for_url = [r"https://github\.com/"]
linkcheck_timeout, linkcheck_retries, linkcheck_workers = 20, 2, 4

html_theme = "furo"
html_title = "fenics_joints"
html_copy_source = False
html_show_sourcelink = False
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}
html_permalinks_icon = "#"


def setup(app):
    """Formulas as MathML, which needs no network; docstrings in the words of this project."""
    mathml.setup(app)
    prose.setup(app)

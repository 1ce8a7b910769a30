"""Configuration of the documentation, which docs/build_site.py builds."""

import hashlib
import sys
from functools import partial
from pathlib import Path

import jupyter_cache.executors.utils as executors

from exunet.base.version import VERSION

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))  # of checked_names
project = "exunet"
author = "The exunet developers"
copyright = author  # noqa: A001
version = release = VERSION
exclude_patterns = ["_build", "_static/katex"]
extensions = [
    "myst_nb",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinxcontrib.katex",
    "sphinxcontrib.bibtex",
    "checked_names",
]
nitpicky = True

myst_enable_extensions = ["amsmath", "attrs_block", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_dmath_allow_digits = False  # "$5" is no equation

# Outputs are of the present code and cases: the cache of jupyter-cache knows only the cells.
sources = hashlib.sha256()
for file in sorted([*DOCS.parent.glob("exunet/**/*.py"), *DOCS.parent.glob("cases/**/*.toml")]):
    sources.update(file.read_bytes())
nb_execution_mode = "cache"
nb_execution_cache_path = str(DOCS / "_build" / "notebooks" / sources.hexdigest()[:12])
nb_execution_in_temp = True
nb_execution_show_tb = True  # with the warning that fails the build
nb_execution_timeout = 300
nb_output_stderr = "remove"  # progress; build_site.py looks for tracebacks
nb_merge_streams = True
executors.executenb = partial(executors.executenb, coalesce_streams=True)  # else commands print in pieces
copybutton_exclude = ".linenos, .gp, .go"

numfig = True  # equations are numbered through, in the order of the pages
numfig_secnum_depth = 0
bibtex_bibfiles = ["references.bib"]

html_theme = "furo"
html_title = f"exunet {VERSION}"
html_static_path = ["_static"]
html_css_files = ["site.css", "gallery.css"]
html_extra_path = ["capture_box.html", "_build/gallery/site"]
html_copy_source = html_show_sourcelink = False
html_show_sphinx = False
html_show_search_summary = False  # pages of a folder cannot be read by a script
html_theme_options = {"footer_icons": []}
katex_css_path = "katex/katex.min.css"  # of the same version as the scripts in sphinxcontrib-katex

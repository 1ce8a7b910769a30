"""Configuration of the documentation, which docs/build_site.py builds."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # of checked_names

from exunet.base.version import VERSION

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
    "checked_names",
]
nitpicky = True

myst_enable_extensions = ["amsmath", "attrs_block", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_dmath_allow_digits = False  # "$5" is no equation

nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parent / "_build" / "notebooks")
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_output_stderr = "warn"  # which fails the build
nb_merge_streams = True
copybutton_exclude = ".linenos, .gp, .go"

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

"""Sphinx configuration of the documentation."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

import sfol  # noqa: E402 (this checkout's, found by the line above)

project = "sfol"
author = "The sfol maintainers"
copyright = "2026, The sfol maintainers"
version = release = sfol.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "generated",  # the last two are files beside this one
    "known_names",
]
exclude_patterns = ["_build"]

myst_heading_anchors = 4
myst_enable_extensions = ["deflist"]

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 88
default_role = "code"  # `name` in a docstring is code, as it is in these pages
napoleon_use_ivar = True

html_theme = "furo"
html_title = "sfol"
html_static_path = ["static"]
html_css_files = ["style.css"]

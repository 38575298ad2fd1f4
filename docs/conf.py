"""Sphinx configuration of the documentation."""

import sfol

project = "sfol"
author = "The sfol maintainers"
copyright = "2026, The sfol maintainers"
version = release = sfol.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 3
html_theme = "furo"
exclude_patterns = ["_build"]
autodoc_member_order = "bysource"
autodoc_typehints = "description"
suppress_warnings = ["myst.xref_missing"]

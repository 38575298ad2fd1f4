"""Warns of classes and functions that a page names and the reference does not have."""

from __future__ import annotations

from collections.abc import Mapping

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx


def setup(app: Sphinx) -> Mapping[str, bool]:
    """Look at every page after it was read."""
    app.connect("doctree-read", _mark_names)
    return {"parallel_read_safe": True}


def _mark_names(_app: Sphinx, page: nodes.document) -> None:
    # Signatures also name types that are documented elsewhere, or nowhere; sentences do not.
    for name in page.findall(addnodes.pending_xref):
        if name["refdomain"] == "py" and not _in_description(name):
            name["refwarn"] = True


def _in_description(node: nodes.Element | None) -> bool:
    return node is not None and (isinstance(node, addnodes.desc) or _in_description(node.parent))

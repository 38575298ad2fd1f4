"""`sfol graph`: what depends on what."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from sfol.cli.app import app
from sfol.cli.inputs import Source, path_or_name
from sfol.cli.output import print_file
from sfol.knowledge_base import KnowledgeBase
from sfol.tools.graph import mermaid, svg


class Format(StrEnum):
    """How a graph is drawn."""

    mermaid = "mermaid"
    svg = "svg"


_DRAW = {Format.mermaid: mermaid, Format.svg: svg}


@app.command()
def graph(
    source: Source,
    format: Annotated[
        Format, typer.Option(help="Mermaid text, which Markdown viewers draw, or an SVG image.")
    ] = Format.mermaid,
) -> None:
    """Draw which predicates, rules, heads, weights and terms depend on which.

    Example: `sfol graph aeb --format svg > aeb.svg`
    """
    print_file(_DRAW[format](KnowledgeBase.load(path_or_name(source))))

"""`sfol show`: what a knowledge base says, all that it extends included."""

from __future__ import annotations

from typing import Annotated

import typer

from sfol.cli.app import app
from sfol.cli.inputs import Source, path_or_name
from sfol.cli.output import print_file, stdout
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.printing import to_yaml
from sfol.knowledge_base.tables_view import summary_table


@app.command()
def show(
    source: Source,
    as_yaml: Annotated[
        bool, typer.Option("--yaml", help="Print one file that extends nothing.")
    ] = False,
) -> None:
    """Show what a knowledge base says, with all that it extends applied.

    Example: `sfol show crossing --yaml > flat.yaml`
    """
    kb = KnowledgeBase.load(path_or_name(source))
    if as_yaml:
        print_file(to_yaml(kb))
    else:
        stdout(markup=True).print(summary_table(kb))

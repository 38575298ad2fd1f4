"""`sfol check`: is a knowledge base valid?"""

from __future__ import annotations

from importlib.metadata import entry_points

import typer
from pydantic import BaseModel

from sfol.cli.app import app
from sfol.cli.inputs import Sources, files
from sfol.cli.output import line, print_errors, singles, stdout
from sfol.errors import SfolError
from sfol.knowledge_base import KnowledgeBase
from sfol.tools.texts import visible


@app.command()
def check(sources: Sources) -> None:
    """Check knowledge bases: YAML, names, clauses, formulas, and what they extend.

    Every error is shown with file, line and column, and with what was probably meant.

    Example: `sfol check rules/`
    """
    console = stdout()
    sections = _sections()
    shown: set[str] = set()  # an error in a base is an error of all that extend it: once is enough
    for path in files(sources):
        try:
            kb = KnowledgeBase.load(path, sections=sections)
        except SfolError as error:
            print_errors(error, but=shown)
            shown |= {str(single) for single in singles(error)}
            continue
        line(
            console,
            f"{visible(path)}: ",
            ("valid", "green"),
            f" ({len(kb.predicates)} predicates, {len(kb.written_rules)} rules, "
            f"{len(kb.weights)} weights, {len(kb.terms)} terms, {len(kb.tests)} tests)",
        )
    if shown:
        raise typer.Exit(2)


def _sections() -> dict[str, type[BaseModel]]:
    """Return the models of the sections of `grounding` whose readers are installed."""
    return {entry.name: entry.load() for entry in entry_points(group="sfol.grounding")}

"""`sfol lint`: what is allowed, but most likely not meant."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from sfol.cli.app import app
from sfol.cli.inputs import LogFile, Sources, files
from sfol.cli.output import line, note_unknown, stdout
from sfol.errors import UsageError
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import read_log
from sfol.tools.lint import DOMINANT, Finding, lint_episodes, located
from sfol.tools.lint import lint as findings_of
from sfol.tools.replay import replay
from sfol.tools.texts import visible

# Of the logs that the bundled street writes; other environments name their own with --endings.
_ENDINGS = ("collision", "timeout", "success")
_COLOURS = {"warning": "yellow", "info": "cyan"}


@app.command()
def lint(
    sources: Sources,
    log: LogFile = None,
    endings: Annotated[
        str, typer.Option(help="How episodes of the log end, from the worst to the best.")
    ] = " < ".join(_ENDINGS),
    dominant: Annotated[
        float, typer.Option(min=0, max=1, help="Share of all reward that is too much for a term.")
    ] = DOMINANT,
) -> None:
    """Find what is allowed in knowledge bases, but most likely not meant.

    SF001 a rule that can never fire · SF002 an atom and its negation in one body · SF003 a
    predicate that nothing reads · SF004 a weight that names a head without a rule · SF005 a
    rule that holds only where another one does · SF006 averages over several groundings (info)
    · SF017 averages that jump from 0 (info) · SF018 a head that no rule concludes about the
    subject · SF019 a constant that only one rule names · SF020 a rule that no entity fits ·
    SF009 rules that were not compared for SF005, as that takes too long (info) · SF010 a weight
    that no term uses · SF011 a signal that no formula reads · SF013 a comment that ignores what
    is no code · SF021 a schedule that ends elsewhere than the file ·
    SF022 an operator over time that looks back less than a step · and on the recorded
    episodes of a log: SF007 one term is nearly all of the reward · SF008 worse endings return
    more than better ones · SF012 endings that `--endings` does not name.

    A comment `# sfol: ignore SF003` on the line of a finding, or above it, hides it.

    Example: `sfol lint rules/aeb.yaml --log runs/drives.parquet`
    """
    console = stdout()
    recorded = read_log(log) if log else None
    order = [ending.strip() for ending in endings.split("<")]
    if "" in order or len({*order}) < len(order):
        raise UsageError(
            f"'{endings}' is no order of endings",
            name=endings,
            suggestion="written like 'collision < timeout < success'",
        )
    warnings = 0
    for path in files(sources):
        kb = KnowledgeBase.load(path)
        findings = findings_of(kb)
        if recorded is not None:
            note_unknown(recorded, kb)
            episodes = replay(recorded, kb)
            findings += lint_episodes(kb, episodes, dominant=dominant, endings=order)
        shown = located(kb, findings)
        warnings += sum(finding.level == "warning" for finding in shown)
        _print(console, path, shown)
    if warnings:
        raise typer.Exit(1)


def _print(console: Console, path: str | Path, findings: Sequence[Finding]) -> None:
    for finding in findings:
        line(
            console,
            f"{visible(finding.place or path)}: ",
            (finding.code, _COLOURS[finding.level]),
            f" {visible(finding.message)} — {visible(finding.suggestion)}",
        )
    if not findings:
        line(console, f"{visible(path)}: ", ("nothing found", "green"))

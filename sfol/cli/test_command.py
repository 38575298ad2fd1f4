"""`sfol test`: do the tests that stand in a knowledge base pass?"""

from __future__ import annotations

from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sfol.cli.app import app
from sfol.cli.inputs import Sources, files
from sfol.cli.output import line, stdout
from sfol.knowledge_base import KnowledgeBase
from sfol.testing.cases import TestReport, run_tests
from sfol.tools.texts import visible


@app.command()
def test(sources: Sources) -> None:
    """Run the tests that stand in knowledge bases, and count which rules they use.

    Tests that a file inherits from what it extends do not run.

    Example: `sfol test rules/aeb.yaml`
    """
    console = stdout()
    reports = []
    for path in files(sources):
        kb = KnowledgeBase.load(path)
        report = run_tests(kb)
        reports.append(report)
        _print_report(console, path, kb, report)
    if not all(report.passed for report in reports):
        raise typer.Exit(1)


def _print_report(
    console: Console, path: str | Path, kb: KnowledgeBase, report: TestReport
) -> None:
    for result in report.results:
        mark = ("PASS", "green") if result.passed else ("FAIL", "red")
        line(console, mark, f" {visible(result.name)}")
        for difference in result.differences:
            line(console, f"     {visible(difference)}")
    failed = sum(not result.passed for result in report.results)
    share = report.covered / len(kb.rules) if kb.rules else 1.0
    table = Table("rule", "tests", title=f"rule coverage {share:.0%}", title_justify="left")
    for rule, count in report.coverage.items():
        table.add_row(visible(rule), str(count) if count else Text("0", "red"))
    if report.results:
        console.print(table)
    passed = len(report.results) - failed
    line(console, f"{visible(path)}: {passed} passed, {failed} failed\n")

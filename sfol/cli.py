"""The command `sfol`: check, test and explain knowledge bases."""

from __future__ import annotations

import json
import sys
from collections.abc import Collection, Iterator, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import typer
from pydantic import BaseModel
from rich.console import Console
from rich.table import Table

import sfol
from sfol.errors import InvalidKnowledgeBase, SfolError, UsageError, did_you_mean
from sfol.facts import Facts
from sfol.knowledge_base import Case, KnowledgeBase
from sfol.loading import load
from sfol.reward import RewardFunction
from sfol.testing import TestReport, run_tests

app = typer.Typer(
    help="""Rewards for reinforcement learning as logic that people write in YAML.

    A knowledge base is a YAML file with predicates, Horn rules, weights and reward terms.
    Name one by its path (rules/aeb.yaml), or a bundled one by its name (aeb).
    """,
    epilog="Exit codes: 0 all is well · 1 a test failed · 2 an error in the input.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_Sources = Annotated[
    list[str],
    typer.Argument(help="Files, folders, or names of bundled knowledge bases.", metavar="FILE…"),
]


def main() -> None:
    """Run the command line; errors of ours end with exit code 2 and no traceback."""
    try:
        app(prog_name="sfol")
    except SfolError as error:
        _print_errors(error)
        sys.exit(2)


def _version(wanted: bool) -> None:
    if wanted:
        print(sfol.__version__)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None: ...


@app.command()
def check(sources: _Sources) -> None:
    """Check knowledge bases: YAML, names, clauses, formulas, and what they extend.

    Every error is shown with file, line and column, and with what was probably meant.

    Example: `sfol check rules/`
    """
    console = Console(highlight=False)
    sections = _sections()
    shown: set[str] = set()  # an error in a base is an error of all that extend it: once is enough
    for path in _files(sources):
        try:
            kb = load(path, sections=sections)
        except SfolError as error:
            _print_errors(error, but=shown)
            shown |= {str(single) for single in _singles(error)}
            continue
        console.print(
            f"{_escaped(path)}: [green]valid[/] "
            f"({len(kb.predicates)} predicates, {len(kb.rules)} rules, {len(kb.weights)} weights, "
            f"{len(kb.terms)} terms, {len(kb.tests)} tests)"
        )
    if shown:
        raise typer.Exit(2)


@app.command()
def test(sources: _Sources) -> None:
    """Run the tests that stand in knowledge bases, and count which rules they use.

    Tests that a file inherits from what it extends do not run.

    Example: `sfol test rules/aeb.yaml`
    """
    console = Console(highlight=False)
    reports = []
    for path in _files(sources):
        kb = KnowledgeBase.load(path)
        report = run_tests(kb)
        reports.append(report)
        _print_report(console, path, kb, report)
    if not all(report.passed for report in reports):
        raise typer.Exit(1)


@app.command()
def explain(  # noqa: PLR0913, PLR0917  (each is an option of the command line)
    source: Annotated[str, typer.Argument(help="A file, or a bundled name.", metavar="FILE")],
    facts: Annotated[
        str, typer.Option(help="Facts as text, or @FILE to read them from a file.")
    ] = "",
    signal: Annotated[
        list[str] | None, typer.Option("--signal", "-s", help="A signal, such as v=6.0.")
    ] = None,
    case: Annotated[
        str | None, typer.Option("--test", help="Take facts and signals of this test of the file.")
    ] = None,
    depth: Annotated[int | None, typer.Option(min=0, help="Show so many levels.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the tree as JSON.")] = False,
) -> None:
    """Show why a scene gets its reward: a proof tree from the reward down to the facts.

    Example:
    `sfol explain aeb --facts "Pedestrian(p1): 0.8. OnCrosswalk(p1)." -s v=6 -s v_next=5 -s d=9`
    """
    reward = RewardFunction(KnowledgeBase.load(_path_or_name(source)))
    chosen = _case(reward.kb, case) if case is not None else None
    text = [] if chosen is None else chosen.facts
    texts = [text] if isinstance(text, str) else list(text)
    scene = Facts.parse([*texts, _text_argument(facts)], margin=reward.kb.grounding.margin)
    signals = {**(chosen.signals if chosen else {}), **_signals(signal or [])}
    explanation = reward.explain(scene, depth=depth, **signals)
    if as_json:
        print(json.dumps(explanation.to_dict(), indent=2))
    elif sys.stdout.isatty():
        Console(highlight=False).print(explanation)
    else:
        print(explanation)


# -- input --------------------------------------------------------------------------------------


def _files(sources: Sequence[str]) -> Iterator[str | Path]:
    """Yield every knowledge base that the arguments name; a folder stands for all below it."""
    for source in sources:
        folder = Path(source)
        if not folder.is_dir():
            yield _path_or_name(source)
            continue
        found = sorted(p for p in folder.rglob("*") if p.suffix in (".yaml", ".yml"))
        if not found:
            raise UsageError(f"no knowledge base below '{source}'", name=source)
        yield from found


def _path_or_name(source: str) -> str | Path:
    return Path(source) if Path(source).is_file() else source


def _case(kb: KnowledgeBase, name: str) -> Case:
    cases = {case.name: case for case in kb.tests}
    if name not in cases:
        raise UsageError(
            f"'{kb.name}' has no test '{name}'", name=name, suggestion=did_you_mean(name, cases)
        )
    return cases[name]


def _text_argument(text: str) -> str:
    if not text.startswith("@"):
        return text
    try:
        return Path(text[1:]).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"'{text[1:]}' can't be read: {error}", name=text[1:]) from None


def _signals(arguments: Sequence[str]) -> dict[str, float]:
    values = {}
    for argument in arguments:
        name, _, number = argument.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            raise UsageError(
                f"'{argument}' is not a signal", name=argument, suggestion="written like v=6.0"
            ) from None
    return values


def _sections() -> dict[str, type[BaseModel]]:
    """Return the models of the sections of `grounding` whose readers are installed."""
    return {entry.name: entry.load() for entry in entry_points(group="sfol.grounding")}


# -- output -------------------------------------------------------------------------------------


def _singles(error: SfolError) -> tuple[SfolError, ...]:
    return error.errors if isinstance(error, InvalidKnowledgeBase) else (error,)


def _print_errors(error: SfolError, *, but: Collection[str] = ()) -> None:
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    for single in _singles(error):
        if str(single) in but:
            continue
        place = f"{_escaped(single.place)}: " if single.place else ""
        hint = f" — {_escaped(single.suggestion)}" if single.suggestion else ""
        console.print(f"{place}[red]error:[/] {_escaped(single.message)}{hint}")


def _print_report(
    console: Console, path: str | Path, kb: KnowledgeBase, report: TestReport
) -> None:
    for result in report.results:
        mark = "[green]PASS[/]" if result.passed else "[red]FAIL[/]"
        console.print(f"{mark} {_escaped(result.name)}")
        for line in result.differences:
            console.print(f"     {_escaped(line)}")
    failed = sum(not result.passed for result in report.results)
    share = report.covered / len(kb.rules) if kb.rules else 1.0
    table = Table("rule", "tests", title=f"rule coverage {share:.0%}", title_justify="left")
    for rule, count in report.coverage.items():
        table.add_row(rule, str(count) if count else "[red]0[/]")
    if report.results:
        console.print(table)
    passed = len(report.results) - failed
    console.print(f"{_escaped(path)}: {passed} passed, {failed} failed\n")


def _escaped(text: object) -> str:
    return str(text).replace("[", "\\[")


if __name__ == "__main__":
    main()

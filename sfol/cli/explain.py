"""`sfol explain`: why does a scene get its reward?"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from sfol.cli.app import app
from sfol.cli.inputs import Source, path_or_name, signals, text_argument
from sfol.cli.output import note, print_file, stdout
from sfol.errors import ClauseError, Place, UsageError, did_you_mean
from sfol.facts import Facts
from sfol.knowledge_base import Case, CaseStep, KnowledgeBase
from sfol.reward import RewardFunction
from sfol.testing.cases import played, steps_of


@app.command()
def explain(  # noqa: PLR0913, PLR0917  (each is an option of the command line)
    source: Source,
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

    Of a test with several steps it shows the last one.

    Example:
    `sfol explain aeb --facts "Pedestrian(p1): 0.8. OnCrosswalk(p1)." -s v=6 -s v_next=5 -s d=9`
    """
    reward = RewardFunction(KnowledgeBase.load(path_or_name(source)))
    steps = [CaseStep()] if case is None else steps_of(reward, _case(reward.kb, case))
    last = steps.pop()
    texts = [last.facts] if isinstance(last.facts, str) else list(last.facts)
    scene = _scene([*texts, text_argument(facts)], facts, reward.kb.grounding.margin)
    if reward.kb.has_memory and not steps:
        note(f"'{reward.kb.name}' has rules over time: this is the first step of an episode")
    *_, conclusions = played(reward, [*steps, CaseStep(facts=str(scene))])
    explanation = reward.explain(conclusions, **{**last.signals, **signals(signal or [])})
    if depth is not None:
        explanation = explanation.cut(depth)
    if as_json:
        print_file(json.dumps(explanation.to_dict(), indent=2) + "\n")
    elif sys.stdout.isatty():
        stdout(markup=True).print(explanation)
    else:
        print(explanation)


def _scene(texts: Sequence[str], argument: str, margin: float) -> Facts:
    try:
        return Facts.parse(texts, margin=margin)
    except ClauseError as error:  # of the argument: a test's facts were checked with its file
        if not argument.startswith("@"):
            raise
        before = texts[-1][: error.offset]
        column = error.offset - before.rfind("\n")
        raise error.at(Place(argument[1:], before.count("\n") + 1, column)) from None


def _case(kb: KnowledgeBase, name: str) -> Case:
    cases = {case.name: case for case in kb.tests}
    if name not in cases:
        raise UsageError(
            f"'{kb.name}' has no test '{name}'", name=name, suggestion=did_you_mean(name, cases)
        )
    return cases[name]

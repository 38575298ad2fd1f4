"""A knowledge base to start from, as text: about a robot vacuum, or about an observation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from string import Template

import yaml

from sfol.clauses import MAXIMUM_LITERALS
from sfol.errors import FormulaError, UsageError
from sfol.formula import check_formula_name
from sfol.syntax import is_name, is_variable

SUBJECT = "robot"
DOMAIN = "Clean where it is dirty, and keep away from people."
UNNAMED = "_"

_PREDICATES = ("Person", "Asleep", "Near", "Dirty")


@dataclass(frozen=True)
class Number:
    """A number of an observation that is to stay near 0.

    Attributes:
        name: its name.
        index: where it stands in the observation, from 0.
        margin: how far from 0 it is all wrong, above 0.
    """

    name: str
    index: int
    margin: float

    @property
    def predicate(self) -> str:
        """The predicate that it is near 0, such as ``SmallAngle``."""
        return f"Small{_camel(self.name)}"


def parse_numbers(text: str) -> tuple[tuple[Number, ...], int]:
    """Read what the numbers of an observation are called.

    Args:
        text: names in the order of the observation, each with its margin if that is not 1, and
            ``_`` for a number that does not matter: ``position=2.4, _, angle=0.2, _``.

    Returns:
        The numbers that have a name, and how many there are with and without.

    Raises:
        UsageError: a name or a margin is none, a name stands twice, or there is none or too many.
    """
    entries = [entry.strip() for entry in text.split(",")]
    numbers = tuple(_number(entry, i) for i, entry in enumerate(entries) if entry != UNNAMED)
    names = [number.predicate for number in numbers]
    twice = next((n.name for n in numbers if names.count(n.predicate) > 1), None)
    if twice is not None:
        raise UsageError(f"the number '{twice}' is named twice", name=twice)
    most = MAXIMUM_LITERALS - 1  # the first says what the subject is
    if not 1 <= len(numbers) <= most:
        raise UsageError(
            f"{len(numbers)} numbers of the observation are named",
            suggestion=f"name 1 to {most}, with _ for those between them",
        )
    return numbers, len(entries)


def starting_text(
    name: str,
    *,
    subject: str = SUBJECT,
    domain: str = DOMAIN,
    numbers: Sequence[Number] = (),
    width: int = 0,
) -> str:
    """Return the text of a knowledge base to start from, whose tests pass.

    Args:
        name: what it is called.
        subject: the entity whose heads make the reward.
        domain: what it should do, in a sentence.
        numbers: those of the observation that facts are read off; without any, facts come from a
            program.
        width: how many numbers the observation has.

    Raises:
        UsageError: the subject is no constant, or would share its name with a predicate.
    """
    kind = _kind(subject, [number.predicate for number in numbers] or _PREDICATES)
    values = {
        "name": _entry(name=name),
        "description": _entry(description=domain),
        "subject": subject,
        "a_subject": f"{'an' if subject[0] in 'aeiou' else 'a'} {subject}",
        "kind": kind,
    }
    if numbers:
        values |= _observed(subject, kind, numbers, width)
    file = "starter_observed.yaml" if numbers else "starter.yaml"
    text = files("sfol.tools").joinpath(file).read_text(encoding="utf-8")
    return Template(text).substitute(values)


# -- its parts ----------------------------------------------------------------------------------


def _observed(subject: str, kind: str, numbers: Sequence[Number], width: int) -> dict[str, str]:
    """Return what a file about an observation says of its numbers."""
    columns = {number.name: number.index for number in numbers}
    fields = [*columns] if len(numbers) == width else columns
    return {
        "predicates": "\n".join(
            f"  {n.predicate}(X): The {_words(n.name)} of X is close to 0." for n in numbers
        ),
        "literals": ", ".join([f"{kind}(X)", *(f"{n.predicate}(X)" for n in numbers)]),
        "width": "one number" if width == 1 else f"{width} numbers",
        "fields": _flow(fields),
        "facts": "\n".join(
            f"  {n.predicate}({subject}): "
            f"near(state.{n.name}, 0, margin={n.margin!r}, value_at_margin=0)"
            for n in numbers
        ),
        "first": numbers[0].name,
        "tests": "\n".join(_tests(numbers, width)),
    }


def _tests(numbers: Sequence[Number], width: int) -> list[str]:
    """Return tests: all is well, one number is half way out, and one is out."""
    first, last, zeros = numbers[0], numbers[-1], [0.0] * width

    def case(name: str, number: Number, value: float, confidence: float) -> str:
        after = list(zeros)
        after[number.index] = value
        return (
            f"  - {_entry(name=name)}\n"
            f"    observation: {_flow(after)}\n"
            f"    next: {_flow(after)}\n"
            f"    expect: {{confidences: {{steady: {confidence}}}, reward: {confidence}}}"
        )

    return [
        case("all numbers are 0", first, 0.0, 1.0),
        case(f"{_words(first.name)} is half a margin from 0", first, first.margin / 2, 0.5),
        case(f"{_words(last.name)} is a margin from 0", last, -last.margin, 0.0),
    ]


def _number(entry: str, index: int) -> Number:
    name, equals, text = (part.strip() for part in entry.partition("="))
    margin = _margin(text) if equals else 1.0
    if margin is None:
        raise UsageError(
            f"the margin of '{name}' is '{text}'",
            name=name,
            suggestion="how far from 0 it is all wrong, such as angle=0.2",
        )
    try:
        check_formula_name(name)
    except FormulaError as error:
        raise UsageError(error.message, name=name, suggestion=error.suggestion) from None
    if not is_name(name):
        raise UsageError(
            f"'{name}' is no name of a number",
            name=name,
            suggestion="it begins with a letter; _ stands for a number that does not matter",
        )
    return Number(name, index, margin)


def _margin(text: str) -> float | None:
    try:
        margin = float(text)
    except ValueError:
        return None
    return margin if 0.0 < margin < float("inf") else None


def _kind(subject: str, predicates: Sequence[str]) -> str:
    """Return the predicate that says what the subject is."""
    if not is_name(subject) or is_variable(subject):
        raise UsageError(
            f"the subject '{subject}' is not a constant",
            name=subject,
            suggestion="one word that begins with a lower-case letter, such as lander",
        )
    kind = _camel(subject)
    if kind in predicates:
        raise UsageError(
            f"the subject '{subject}' would share its name with the predicate '{kind}'",
            name=subject,
            suggestion="call it differently",
        )
    return kind


def _camel(name: str) -> str:
    return "".join(word[:1].upper() + word[1:] for word in name.split("_"))


def _words(name: str) -> str:
    return name.replace("_", " ")


def _entry(**entry: str) -> str:
    return yaml.safe_dump(entry, allow_unicode=True, width=float("inf")).strip()


def _flow(value: object) -> str:
    return yaml.safe_dump(
        value, default_flow_style=True, sort_keys=False, width=float("inf")
    ).strip()

"""What is wrong with a file is said once, where it is wrong, with what to write instead."""

import math

import pytest

from sfol.errors import InvalidKnowledgeBase
from tests.sfol.conftest import KITCHEN

CARE = "careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X)."
HASTE = "{weight: care, formula: -k * speed, parameters: {k: 2.0}}"
TEST = "\ntests: [{name: t, expect: {%s}}]"


def errors(kitchen, changes):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        kitchen(changes)
    return caught.value.errors


@pytest.mark.parametrize(
    ("changes", "message", "suggestion"),
    [
        # An error in one line is not repeated by all that name it.
        ({CARE: "careful(X) - Person(X)."}, "the character '-'", "head(X) :- body(X)"),
        ({CARE: "careful(X) :- Person(X) Pot(P)."}, "'.' is expected", "full stop"),
        ({"Hot(X): X": "Hot(X: X"}, "')' is expected", "a comma tears text apart"),
        # A misspelt reader is reported where it stands, not where the name is right.
        ({"{careful: 1.0}": "{carefull: 1.0}"}, "unknown head 'carefull'", "'careful'"),
        ({"Pot(P), ": "Pott(P), "}, "unknown predicate 'Pott'", "'Pot'"),
        # What other languages write.
        ({"Hot(P), ": "!Hot(P), "}, "the character '!'", "not P(X)"),
        ({"Hot(P), ": "~Hot(P), "}, "the character '~'", "not P(X)"),
        ({"Hot(P), ": "Hot(P) && "}, "the character '&'", "comma"),
        ({"Hot(P), ": "Hot(P) and "}, "'and' stands", "comma"),
        ({"Hot(P), ": "Hot(P) OR "}, "'OR' stands", "write or,"),
        ({"Hot(P), ": "Hot(P); "}, "the character ';'", "write or,"),
        ({"Hot(P), ": "Hot(P) or "}, "'or' stands beside ','", "P(X), (Q(X) or R(X))"),
        ({":- Person(X)": "<- Person(X)"}, "the character '-'", "head(X) :- body(X)"),
        ({"Hot(P), ": "P = X, "}, "where '=' stands", "X != Y"),
        ({"-k * speed": "-k * speed^2"}, "speed ^ 2", "v**2"),
        ({"-k * speed": "k and speed"}, "k and speed", "(a < b) * (b < c)"),
        ({"-k * speed": "k if speed else 0"}, "k if speed else 0", "where(condition"),
        ({"-k * speed": "-lambda * speed"}, "'lambda' is a reserved word", "lambda_"),
        ({"speed: {": "lambda: {", "-k * speed": "-k"}, "'lambda' is a reserved word", "lambda_"),
        ({"speed: {": "top speed: {", "-k * speed": "-k"}, "'top speed' is not a name", "letters"),
        # Numbers.
        ({"{unit: m/s}": "{unit: m/s, default: .nan}"}, "the default of 'speed' is NaN", "leave it"),
        # Tests that could not fail.
        ({HASTE: HASTE + TEST % "bounds: {Hot: null}"}, "unknown head 'Hot'", "careful"),
        ({HASTE: HASTE + TEST % "confidences: {Hot: 0}"}, "unknown head 'Hot'", "careful"),
    ],
)  # fmt: skip
def test_one_error_with_what_to_write(kitchen, changes, message, suggestion):
    (error,) = errors(kitchen, changes)
    assert message in error.message
    assert suggestion in (error.suggestion or "")
    assert error.place is not None
    assert error.place.line is not None


def test_a_comma_that_tears_a_formula_apart_is_explained(kitchen):
    found = errors(kitchen, {HASTE: "{weight: 1.0, formula: min(speed, 1)}"})
    assert any("put the whole in quotes" in (error.suggestion or "") for error in found)


@pytest.mark.parametrize("number", ["-10", "0.5", "1e3", ".5"])
def test_a_number_is_a_formula(kitchen, number):
    kb = kitchen({HASTE: f"{{weight: care, formula: {number}}}"})
    assert kb.terms["haste"].formula({}) == float(number)
    quoted = kitchen({HASTE: f"{{weight: care, formula: '{number}'}}"})
    assert quoted.terms["haste"].formula({}) == float(number)


@pytest.mark.parametrize("wrong", ["true", "null", "[1]", "{a: 1}", ".inf", ".nan"])
def test_what_is_no_number_is_no_formula(kitchen, wrong):
    assert errors(kitchen, {HASTE: f"{{weight: care, formula: {wrong}}}"})


def test_a_default_may_be_infinite(kitchen):
    kb = kitchen({"{unit: m/s}": "{unit: m/s, default: .inf}"})
    assert kb.signals["speed"].default == math.inf


def test_the_kitchen_itself_is_valid(kitchen):
    assert "haste" in KITCHEN
    assert kitchen().terms

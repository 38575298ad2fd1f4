"""`sfol fmt`: it changes blanks in clauses, and nothing else at all."""

import os
import re
import shutil

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol.clauses import Body, Clause, parse_clause
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.formatting import format_clause, format_file
from sfol.literals import Negated, NotEqual, Positive
from sfol.syntax import Atom, parse_facts
from tests.sfol.command_line import RULES, sfol
from tests.sfol.conftest import KITCHEN

BASE = KITCHEN.replace("{SEMANTICS}", "{}")
FILES = sorted(RULES.rglob("*.yaml"))
UGLY = """\
# A comment, then a knowledge base.
version: 1
name:   kitchen     # blanks here are none of our business
subject: cook
background: [ "Person( cook )." , Pot( pan ) ]
predicates:
  Person( X ): X   is a person.
  "Near(X,Y)":   X is near  Y.    # near
  Pot(X): X is a pot.
  Hot(X): X is hot.
rules:
  # a comment of its own
  care:   careful( X ):-Person(X) ,Pot(P),  not Hot( P ),X!=P,Near(P,X) .   # after the rule
  more: {rule: "careful(X):-Hot(X) .", threshold: 0.5}   # in a flow
  most:
    rule: |   # a block
      careful( X )   :-    % why
        Person(X),Near( X,Y )   # who
        ,Hot(Y).
  folded: >-
    careful(X) :-
      Hot(X)  ,
      Pot(X).
signals: {speed: {unit: m/s}}
weights: {care: {normalizer: 1, coefficients: {careful: 1.0}}}
terms:
  haste: {weight: care, formula: -k*speed, parameters: {k: 2.0}}
entity_weights:
  - {when: 'Pot( X ),Hot(X)', weight: 1.0}
tests:
  - name: a test,with commas
    facts: Pot(p):0.8. Hot(p) .
    expect: {}
  - {name: b, facts: ["Near( p,cook ).", "Pot(p):[0.1,0.2].Hot(p)."], expect: {}}
"""
PRETTY = """\
# A comment, then a knowledge base.
version: 1
name:   kitchen     # blanks here are none of our business
subject: cook
background: [ "Person(cook)." , Pot(pan) ]
predicates:
  Person(X): X   is a person.
  "Near(X, Y)":   X is near  Y.    # near
  Pot(X): X is a pot.
  Hot(X): X is hot.
rules:
  # a comment of its own
  care:   careful(X) :- Person(X), Pot(P), not Hot(P), X != P, Near(P, X).   # after the rule
  more: {rule: "careful(X) :- Hot(X).", threshold: 0.5}   # in a flow
  most:
    rule: |   # a block
      careful(X) :-    % why
        Person(X), Near(X, Y)   # who
        , Hot(Y).
  folded: >-
    careful(X) :-
      Hot(X),
      Pot(X).
signals: {speed: {unit: m/s}}
weights: {care: {normalizer: 1, coefficients: {careful: 1.0}}}
terms:
  haste: {weight: care, formula: -k*speed, parameters: {k: 2.0}}
entity_weights:
  - {when: 'Pot(X), Hot(X)', weight: 1.0}
tests:
  - name: a test,with commas
    facts: "Pot(p): 0.8. Hot(p)."
    expect: {}
  - {name: b, facts: ["Near(p, cook).", "Pot(p): [0.1, 0.2]. Hot(p)."], expect: {}}
"""


@pytest.fixture
def ugly(tmp_path):
    path = tmp_path / "kitchen.yaml"
    path.write_text(UGLY)
    return path


def test_clauses_change_and_nothing_else(ugly):
    before = KnowledgeBase.load(ugly).hash
    done = sfol("fmt", ugly)
    assert (done.code, done.out) == (0, f"{ugly}: formatted\n")
    assert ugly.read_text() == PRETTY
    assert KnowledgeBase.load(ugly).hash == before
    assert os.listdir(ugly.parent) == ["kitchen.yaml"]


def test_twice_changes_nothing_the_second_time(ugly):
    sfol("fmt", ugly)
    stamp = ugly.stat()
    assert sfol("fmt", ugly) == (0, "", "")
    assert ugly.stat().st_ino == stamp.st_ino


def test_check_and_diff_write_nothing(ugly):
    done = sfol("fmt", "--check", ugly)
    assert (done.code, done.out) == (1, f"{ugly}: would be formatted\n")
    done = sfol("fmt", "--diff", ugly)
    assert done.code == 1
    assert '-  more: {rule: "careful(X):-Hot(X) .", threshold: 0.5}   # in a flow\n' in done.out
    assert '+  more: {rule: "careful(X) :- Hot(X).", threshold: 0.5}   # in a flow\n' in done.out
    assert ugly.read_text() == UGLY
    sfol("fmt", ugly)
    assert sfol("fmt", "--check", "--diff", ugly) == (0, "", "")


def test_a_file_with_errors_is_not_touched(ugly):
    broken = UGLY.replace("Pot(P)", "Pto(P)")
    ugly.write_text(broken)
    done = sfol("fmt", ugly)
    assert done.code == 2
    assert "did you mean 'Pot'" in done.err
    assert ugly.read_text() == broken


def test_others_are_formatted_even_so(ugly):
    other = ugly.with_name("other.yaml")
    other.write_text("version: 1\nname: [")
    done = sfol("fmt", ugly.parent)
    assert done.code == 2
    assert "not YAML" in done.err
    assert ugly.read_text() == PRETTY


@pytest.mark.parametrize("source", ["aeb", "nowhere"])
def test_names_are_no_files(source):
    done = sfol("fmt", source)
    assert done.code == 2
    assert f"'{source}' is no file" in done.err


def test_line_breaks_permissions_and_links_stay(ugly):
    ugly.write_bytes(UGLY.replace("\n", "\r\n").encode())
    ugly.chmod(0o640)
    link = ugly.with_name("link.yaml")
    link.symlink_to(ugly)
    assert sfol("fmt", link).code == 0
    assert ugly.read_bytes() == PRETTY.replace("\n", "\r\n").encode()
    assert ugly.stat().st_mode & 0o777 == 0o640
    assert link.is_symlink()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_bundled_files_are_formatted(path):
    assert format_file(path.read_text()) == path.read_text()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_bundled_file_with_other_blanks_comes_back(tmp_path, path):
    text = path.read_text()
    rule = re.compile(r"^(?! *#).*:-.*$", re.M)
    other = rule.sub(lambda line: line[0].replace("), ", ")  ,").replace(" :- ", ":-   "), text)
    assert (":-   " in other) == (" :- " in text)
    assert format_file(other) == text
    copied = shutil.copytree(path.parent, tmp_path / "rules") / path.name
    copied.write_text(other)
    assert KnowledgeBase.load(copied).hash == KnowledgeBase.load(path).hash


@pytest.mark.parametrize(
    "text",
    [
        'rules: {a: "b(X):-\\x43(X)."}',  # an escape: what stands there is not what is meant
        "rules: {a: 'b(X):-c(X). % it''s'}",
        "rules:\n  a: &a b(X):-c(X).\n",
        "rules:\n  a: >\n    b(X):-c(X)  % to the end of a folded line\n    ,d(X).\n",
        "tests:\n- facts: 'a(b).'\n- other: a(b):-c\n",
    ],
)
def test_what_is_not_plain_to_see_is_left_alone(text):
    assert format_file(text) == text


def test_what_an_alias_repeats_is_formatted_once():
    text = "rules:\n  a: &a\n    rule: b(X):-c(X).\n  d: *a\n"
    assert format_file(text) == text.replace(":-", " :- ")


# -- properties -----------------------------------------------------------------------------------

names = st.sampled_from(["a", "Near", "p1", "X", "Y_2", "not_", "ego"])
atoms = st.builds(Atom, names, st.lists(names, min_size=1, max_size=2).map(tuple))
literals = (
    st.builds(Positive, atoms) | st.builds(Negated, atoms) | st.builds(NotEqual, names, names)
)
bodies = st.builds(Body, st.lists(literals, min_size=1, max_size=6).map(tuple))
clauses = st.builds(Clause, atoms, bodies)
TOKEN = re.compile(r":-|!=|\w+|[^\w\s]")


@st.composite
def scattered(draw, texts):
    """A text with other blanks, line breaks and comments between its tokens."""
    blanks = st.sampled_from(
        ["", "", " ", "  ", "\t", "\n", "\n    ", "  \n", " % x, y\n", "  # a(b).\n "]
    )
    text = ""
    for token in TOKEN.findall(draw(texts)):
        gap = draw(blanks)
        both_words = text[-1:].isalnum() or text[-1:] == "_"
        text += (gap or " ") if both_words and (token[0].isalnum() or token[0] == "_") else gap
        text += token
    return text.strip()


@settings(max_examples=60)
@given(clauses)
def test_a_printed_rule_is_formatted(clause):
    assert format_clause(str(clause)) == str(clause)
    assert parse_clause(str(clause)) == clause


@settings(max_examples=60)
@given(scattered(clauses.map(str)))
def test_a_scattered_rule_keeps_its_meaning_and_its_comments(text):
    formatted = format_clause(text)
    assert parse_clause(formatted) == parse_clause(text)
    assert format_clause(formatted) == formatted
    for comment in re.findall(r"\s*[%#][^\n]*\n\s*", text):
        assert comment.strip() in formatted
    assert formatted.count("\n") == text.count("\n")


@settings(max_examples=60)
@given(scattered(clauses.map(str)))
def test_a_scattered_rule_in_one_line_is_printed_as_a_rule(text):
    line = re.sub(r"\s*[%#][^\n]*\n\s*|\s*\n\s*", " ", text)
    assert format_clause(line) == str(parse_clause(line))


bounds = st.floats(0, 1, allow_subnormal=False).map(lambda x: f"{x:.6f}")
facts = st.builds("{}({}, {}): [{}, {}].".format, names, names, names, bounds, bounds) | st.builds(
    "{}({}): {}.".format, names.filter(str.islower), st.sampled_from(["p1", "ego"]), bounds
)


@settings(max_examples=60)
@given(st.lists(facts, min_size=1, max_size=4))
def test_facts_keep_every_digit(texts):
    text = " ".join(texts)
    assert format_clause(text) == text
    assert format_clause(text.replace(" ", "")) == text


@settings(max_examples=60)
@given(st.integers(0, 3), scattered(clauses.map(str)))
def test_a_file_keeps_every_other_byte(style, text):
    flat = " ".join(re.sub(r"[%#][^\n]*\n", " ", text).split())
    shown = {
        0: f"\n    rule: {flat}   # comment",
        1: f'\n    rule: "{flat}"   # comment',
        2: f" {{rule: '{flat}'  }}   # comment",
        3: "\n    rule: |  # comment\n" + "".join(f"      {x}\n" for x in text.splitlines()),
    }[style]
    source = f"# head\nname:  x\nrules:\n  r:{shown}\nbackground:   []  # tail\n"
    formatted = format_file(source)
    assert format_file(formatted) == formatted
    assert "".join(formatted.split()) == "".join(source.split())
    old, new = (yaml.safe_load(s)["rules"]["r"]["rule"] for s in (source, formatted))
    assert parse_clause(new) == parse_clause(old)


def test_facts_of_the_bundled_tests_survive():
    for path in FILES:
        for case in KnowledgeBase.load(path).tests:
            for text in [case.facts] if isinstance(case.facts, str) else case.facts:
                assert list(parse_facts(format_clause(text))) == list(parse_facts(text))

"""Constants: lower-case names, integers, and quoted texts of any other form."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

import sfol
from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_clause
from sfol.errors import ClauseError, FactError, InvalidKnowledgeBase, UsageError
from sfol.knowledge_base.formatting import format_clause
from sfol.knowledge_base.printing import to_yaml
from sfol.logs import LogWriter, read_log
from sfol.syntax import Atom, constant, is_constant, is_variable
from sfol.testing.naive import naive_conclusions
from tests.differential.dense import dense_conclusions
from tests.differential.programs import program

printable = st.text(
    st.characters(exclude_categories=["C", "Z"]) | st.just(" "), min_size=1, max_size=12
).filter(lambda text: not {"'", '"'} <= set(text))


@given(printable)
def test_every_text_names_one_constant(text):
    name = constant(text)
    assert is_constant(name)
    assert not is_variable(name)
    facts = Facts()
    facts.add("P", name, confidence=0.5)
    facts.add("R", "ego", name)
    assert Facts.parse(str(facts)) == facts
    clause = parse_clause(f"h(X) :- P({name}), R(X, {name}), X != {name}.")
    assert parse_clause(str(clause)) == clause
    assert format_clause(str(clause)) == str(clause)


@pytest.mark.parametrize(
    ("text", "name"),
    [("p1", "p1"), ("7", "7"), ("-7", "-7"), ("0", "0"), ("007", '"007"'), ("-0", '"-0"'),
     ("Mary", '"Mary"'), ("Mary Ann", '"Mary Ann"'), ("_", '"_"'), ("1.5", '"1.5"'),
     ("it's", '"it\'s"'), ('so "so"', "'so \"so\"'")],
)  # fmt: skip
def test_quotes_stand_where_they_are_needed(text, name):
    assert sfol.constant(text) == name
    quote = "'" if '"' in text else '"'
    assert Facts.parse(f"P({quote}{text}{quote}).").entities() == (name,)


@pytest.mark.parametrize("text", ["", "a\nb", "\x00", "'\"", "\u202e"])
def test_what_cannot_be_seen_names_nothing(text):
    with pytest.raises(ClauseError, match="can't name a constant"):
        constant(text)
    assert not is_constant(f'"{text}"')


def test_only_a_text_names_a_constant():
    with pytest.raises(UsageError):
        constant(7)


@pytest.mark.parametrize(
    "name", ["Mary", "mary ann", "1.5", "007", '"p1"', '"7"', "'Mary'", 7, '"']
)
def test_facts_take_constants_as_they_are_written(name):
    with pytest.raises(FactError, match=r"sfol.constant\(…\)"):
        Facts().add("P", name)
    assert Facts().bound("P", name) is None


@pytest.mark.parametrize(
    ("text", "message", "suggestion", "at"),
    [
        ("P(1.5).", "'1.5' can't be a constant", "integers can", "1.5"),
        ("P(007).", "'007' can't be a constant", "'007'", "007"),
        ("P(1e3).", "'1e3' can't be a constant", "integers can", "1e3"),
        ("P(12345678901234567890).", "can't be a constant", "in quotes", "123"),
        ("P(Mary).", "has a variable, 'Mary'", '"Mary"', "P("),
        ('P("Mary).', "has no place in a clause", "close the quotes", '"'),
        ("P('').", "'' can't name a constant", "can be printed", "''"),
        ("P(p1, 'a\tb').", "can't name a constant", "can be printed", "'a"),
        ('"P"(p1).', "a predicate is expected", "", '"P"'),
    ],
)
def test_mistakes_are_answered_with_what_to_write(text, message, suggestion, at):
    with pytest.raises(ClauseError) as caught:
        Facts.parse(text)
    assert message in caught.value.message
    assert suggestion in (caught.value.suggestion or "")
    assert caught.value.offset == text.index(at)


FRIENDS = program(
    'h(X) :- R("Mary", X), P(X), X != 7.', 'e(X, 7) :- R(X, _), not S(X, "it\'s (1, 2)").'
)


def test_rules_reason_about_them_in_every_engine():
    text = """R("Mary", 'John'): 0.5. P("John"). R("Mary", 7). P(7). R("Mary", -7). P(-7): 0.3.
    S("John", 7). S("Mary", "it's (1, 2)")."""
    facts = Facts.parse(text)
    derived = RewardFunction(FRIENDS).conclude(facts).derived
    assert derived == naive_conclusions(FRIENDS, facts)
    assert {str(atom) for atom in derived} == {'h("John")', "h(-7)"}
    dense = dense_conclusions(FRIENDS, [facts], sorts=2)[0]
    assert {atom for atom in dense if atom.predicate == "e"} == set()
    more = Facts.parse(f"{text} R(9, 9).")
    assert Atom("e", ("9", "7")) in RewardFunction(FRIENDS).conclude(more).derived
    assert dense_conclusions(FRIENDS, [more], sorts=2)[0][Atom("e", ("9", "7"))] == (1.0, 1.0)


def test_the_subject_may_have_any_name(kitchen, tmp_path):
    kb = kitchen({"subject: cook": "subject: '\"Mary\"'", "Person(cook)": "'Person(\"Mary\")'"})
    facts = Facts.parse('Pot(1). Hot(1). Near(1, "Mary").')
    reward = RewardFunction(kb)
    assert reward.evaluate(facts, speed=1.0).bounds["careful"] == (1.0, 1.0)
    assert 'Near(1, "Mary") [1, 1]' in str(reward.explain(facts, speed=1.0))
    batch = reward.evaluate(reward.batch([facts, Facts()]), speed=1.0)
    assert batch.confidences["careful"].tolist() == [1.0, 0.0]
    (tmp_path / "again.yaml").write_text(to_yaml(kb))
    assert KnowledgeBase.load(tmp_path / "again.yaml").hash == kb.hash


def test_a_subject_without_quotes_is_refused(kitchen):
    with pytest.raises(InvalidKnowledgeBase, match=r"'\"Mary\"'"):
        kitchen({"subject: cook": "subject: Mary"})


def test_logs_keep_them(tmp_path):
    facts = Facts.parse('P("Mary, Ann"): 0.5. R(7, "it\'s").')
    with LogWriter(tmp_path / "log.parquet", FRIENDS) as log:
        log.step(facts, 0.0)
    assert read_log(tmp_path / "log.parquet").episodes[0].steps[0].facts == facts

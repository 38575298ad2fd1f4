"""What a file says of observations is checked when it is read, and handed on to overlays."""

import pytest

from sfol import KnowledgeBase
from sfol.errors import InvalidKnowledgeBase
from sfol.knowledge_base.formatting import format_file
from sfol.knowledge_base.printing import to_yaml
from sfol.tools.diff import compare
from sfol.tools.lint import lint
from tests.sfol.command_line import sfol
from tests.sfol.hall import HALL

PERSON = "Person(P in person): 1.0"
PEOPLE = "{key: people, fields: [x, y], present: mask}"


@pytest.fixture
def hall(tmp_path):
    """Return a function that loads the hall with changes: old text → new text."""

    def load(changes=None, more=""):
        text = HALL
        for old, new in (changes or {}).items():
            assert old in text, old
            text = text.replace(old, new)
        path = tmp_path / "hall.yaml"
        path.write_text(text + more)
        return KnowledgeBase.load(path)

    return load


@pytest.mark.parametrize(
    ("changes", "message", "suggestion"),
    [
        # Atoms.
        ({PERSON: "Persn(P in person): 1"}, "unknown predicate 'Persn'", "'Person'"),
        ({PERSON: "Person(P in person, robot): 1"}, "'Person' has 2 arguments here", "Person(X)"),
        ({PERSON: "Person(P in persn): 1"}, "unknown sort 'persn'", "'person'"),
        ({PERSON: "Person(P): 1"}, "'in' is expected", "P in pedestrian"),
        ({PERSON: '"Person(P: person)": 1'}, "'in' is expected", "P in pedestrian"),
        ({PERSON: "Person(P: person): 1"}, "not YAML", "in quotes"),
        ({PERSON: "Person(person): 1"}, "'person' is a sort", "X in person"),
        ({PERSON: "Person(person2): 1"}, "'person2' is an entity of a sort", "X in person"),
        ({PERSON: "Beside(P in person, P in person): 1"}, "'P' stands twice", "another one"),
        ({PERSON: PERSON + "\n  Person(Q in person): 1"}, "said twice", ""),
        ({PERSON: PERSON + "\n  Robot(robot): 1"}, "Robot(robot) is said twice", ""),
        ({PERSON: PERSON + "\n  careful(robot): 1"}, "'careful' is what rules conclude", "declare"),
        ({PERSON: "Person(P in person): {bounds: exact}"}, "'formula' is missing", ""),
        ({PERSON: "Person(P in person): {formula: 1, bounds: none}"}, "bounds", ""),
        ({PERSON: "Person(P in person): {formula: 1, at_least: 2}"}, "at_least", ""),
        ({PERSON: "Person(P in person): true"}, "valid string", ""),
        # Formulas.
        ({PERSON: "Person(P in person): P.z"}, "'P' has no field 'z'", "known: x, y"),
        ({PERSON: "Person(P in person): P"}, "'P' has several numbers", "P.x"),
        ({PERSON: "Person(P in person): Q.x"}, "the variable 'Q', which has no sort", "known: P"),
        ({PERSON: "Person(P in person): robt.x"}, "reads 'robt', which is no part", "'robot'"),
        ({PERSON: "Person(P in person): robot.sped"}, "'robot' has no field 'sped'", "'speed'"),
        ({PERSON: "Person(P in person): robot"}, "'robot' has several numbers", "robot.x"),
        ({PERSON: "Person(P in person): light.x"}, "'light' has no field 'x'", "write light"),
        ({PERSON: "Person(P in person): people.x"}, "'people' is a table", "P.x"),
        ({PERSON: "Person(P in person): next.light"}, "a fact can't read 'next'", "before"),
        ({PERSON: "Person(P in person): action.throttle"}, "can't read 'action'", "before"),
        ({PERSON: "Person(P in person): belw(P.x, 1)"}, "the function 'belw'", "'below'"),
        ({PERSON: "Person(P in person): any(Q.x for Q in persn)"}, "'persn' is no sort", "'person'"),
        ({PERSON: "Person(P in person): any(Q.z for Q in person)"}, "no field 'z'", "known: x, y"),
        ({PERSON: "Person(P in person): any(P.x for P in person)"}, "'P' stands twice", "another"),
        ({PERSON: "Person(P in person): any(1 for Q in next.person)"}, "can't read 'next'", "before"),
        ({PERSON: "Person(P in person): Q.x + any(Q.x for Q in person)"}, "no sort", "known: P"),
        ({"formula: -v**2 - limit": "formula: any(P.x for P in person)"}, "only facts and signals", ""),
        ({"from: robot.speed": "from: P.x"}, "the variable 'P', which has no sort", "no variables"),
        ({"from: robot.speed": "from: next.action.throttle"}, "reads 'action'", "known"),
        ({"from: robot.speed": "from: next"}, "reads '', which is no part", "known"),
        ({"from: robot.speed": "from: robot.sped"}, "'robot' has no field 'sped'", "'speed'"),
        ({"from: robot.speed": "frm: robot.speed"}, "unknown key 'frm'", "'from'"),
        # Parts of the observation.
        ({PEOPLE: "{key: people, field: [x, y]}"}, "unknown key 'field'", "'fields'"),
        ({"light: {key: light}": "next: {key: light}", "1 - light": "1"}, "called 'next'", "lower"),
        ({"light: {key: light}": "Light: {key: light}", "1 - light": "1"}, "called 'Light'", ""),
        ({"light: {key: light}": "a b: {key: light}", "1 - light": "1"}, "'a b' is not a name", ""),
        ({"{key: light}": "{key: light, present: on}"}, "'light' is no table", "rows"),
        ({"{key: light}": "{key: light, fields: []}"}, "'light' has no fields", "leave"),
        ({"{x: 0, y: 1, speed: 3}": "[x, y, speed, y]"}, "the field 'y' of 'robot' stands", ""),
        ({"{x: 0, y: 1, speed: 3}": "[x, y, speed, _z]"}, "begins with an underscore", "call it z"),
        ({"{x: 0, y: 1, speed: 3}": "[x, y, speed, in]"}, "'in' is a reserved word", "in_"),
        ({"speed: 3": "speed: -1"}, "the index of 'speed' is -1", ""),
        # Sorts.
        ({"from: people": "from: peopel"}, "unknown part of the observation 'peopel'", "'people'"),
        ({"from: people": "from: [people, people]"}, "the tables of 'person' share a field", ""),
        ({"at_most: 4": "at_most: 0"}, "greater than or equal to 1", ""),
        ({", at_most: 4": ""}, "'at_most' is missing", ""),
        ({"subject: robot": "subject: person3"}, "would call an entity 'person3'", "differently"),
        ({"at_most: 4}": "at_most: 20}\n  person1: {from: people, at_most: 4}"},
         "would call an entity 'person11'", "differently"),
        ({"at_most: 4}": "at_most: 4}\n  Sort: {from: people, at_most: 4}"}, "is no sort", ""),
        ({"at_most: 4": "at_most: 1000"}, "more than 100,000 atoms", "at_most"),
    ],
)  # fmt: skip
def test_one_error_with_what_to_write(hall, changes, message, suggestion):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        hall(changes)
    found = [error for error in caught.value.errors if message in error.message]
    assert found, caught.value
    assert suggestion in (found[0].suggestion or "")
    assert found[0].place.line


def test_places_are_those_of_the_atom_and_of_the_formula(hall):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        hall({PERSON: "Person(P in persn): 1.0", "P.x >= robot.x": "P.x >= robt.x"})
    places = [(error.place.line, error.place.column) for error in caught.value.errors]
    atom, formula = (HALL.splitlines()[line - 1] for line, _ in places)
    assert atom[places[0][1] - 1 :].startswith("Person(P in")
    assert formula[places[1][1] - 1 :].startswith("robot.x")


def test_too_many_entities(hall):
    sorts = "".join(f"\n  s{i}_: {{from: people, at_most: 1000}}" for i in range(11))
    with pytest.raises(InvalidKnowledgeBase, match="more than 10,000 entities"):
        hall({"at_most: 4}": "at_most: 4}" + sorts})


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("observation: [1], facts: Person(p).", "facts and an observation"),
        ("action: [1]", "'action' without an observation"),
        ("next: [1]", "'next' without an observation"),
        ("observation: text", "observation"),
    ],
)
def test_what_tests_observe_is_checked(hall, case, message):
    with pytest.raises(InvalidKnowledgeBase, match=message):
        hall(more=f"tests: [{{name: t, {case}, expect: {{reward: 0}}}}]\n")


def test_a_test_observes_only_what_the_file_can_read(kitchen):
    test = "parameters: {k: 2.0}}\ntests: [{name: t, observation: [1], expect: {reward: 0}}]"
    with pytest.raises(InvalidKnowledgeBase, match="nothing says how an observation is read"):
        kitchen({"parameters: {k: 2.0}}": test})


def test_a_predicate_may_be_observed_and_concluded_if_it_is_declared(hall):
    kb = hall({"rules:\n": "rules:\n  alone: Person(X) :- Robot(X).\n"})
    assert "Person" in kb.heads
    assert kb.facts[0].atom.predicate == "Person"


# -- overlays -----------------------------------------------------------------------------------


def overlay(folder, changes):
    (folder / "base.yaml").write_text(HALL)
    path = folder / "over.yaml"
    path.write_text(f"version: 1\nname: over\nextends: base\n{changes}\n")
    return KnowledgeBase.load(path)


def test_an_overlay_changes_facts_whatever_their_variables_are_called(tmp_path):
    kb = overlay(tmp_path, "facts: {'Close(Q in person, robot)': P}".replace("P}", "Q.x}"))
    close = next(fact for fact in kb.facts if fact.atom.predicate == "Close")
    assert (close.text, close.formula.text, close.at_least) == (
        "Close(Q in person, robot)",
        "Q.x",
        0,
    )
    assert len(kb.facts) == 4


def test_an_overlay_changes_parts_sorts_and_signals_key_by_key(tmp_path):
    kb = overlay(
        tmp_path,
        "observation: {people: {key: crowd}}\n"
        "entities: {person: {at_most: 7}}\n"
        "signals: {v: {from: 2 * robot.speed}}",
    )
    people = kb.observation["people"]
    assert (people.path, [*people.columns], people.present) == (("crowd",), ["x", "y"], "mask")
    assert (kb.entities["person"].tables, kb.entities["person"].at_most) == (("people",), 7)
    assert kb.observed_signals["v"].text == "2 * robot.speed"
    assert kb.signals["v"].unit == "m/s"


def test_an_overlay_removes_facts_sorts_and_parts(tmp_path):
    kb = overlay(
        tmp_path,
        "remove:\n"
        "  facts: ['Close( Q in person , robot)', Person(P in person), 'Ahead(P in person, robot)',"
        " 'Beside(A in person, B in person)']\n"
        "  entities: [person]\n"
        "  observation: [people]",
    )
    assert (kb.facts, kb.entities, [*kb.observation]) == ((), {}, ["robot", "light", "action"])
    with pytest.raises(InvalidKnowledgeBase, match="no 'Close' in facts to remove"):
        overlay(tmp_path, "remove: {facts: [Close]}")


# -- what becomes of it -------------------------------------------------------------------------


def test_it_comes_back_from_its_printed_form(hall, tmp_path):
    kb = hall()
    path = tmp_path / "again.yaml"
    path.write_text(to_yaml(kb))
    again = KnowledgeBase.load(path)
    assert again.hash == kb.hash
    assert compare(kb, again) == ()
    assert [*map(str, again.facts)] == [*map(str, kb.facts)]


@pytest.mark.parametrize(
    ("old", "new", "section"),
    [
        ("margin=4", "margin=3", "facts"),
        ("at_least: 0.3", "at_least: 0.2", "facts"),
        ("bounds: exact", "bounds: margin", "facts"),
        ("key: light", "key: lights", "observation"),
        ("at_most: 4", "at_most: 5", "entities"),
        ("from: robot.speed", "from: robot.x", "signals"),
    ],
)
def test_every_change_is_one_to_the_hash_and_to_diff(hall, old, new, section):
    before, after = hall(), hall({old: new})
    assert before.hash != after.hash
    assert {change.section for change in compare(before, after)} == {section}


def test_show_and_check_know_it(hall, tmp_path):
    hall()
    shown = sfol("show", tmp_path / "hall.yaml").out
    assert all(part in shown for part in ("body.state", "x, y, speed", "Ahead(P in person, robot)"))
    assert sfol("check", tmp_path / "hall.yaml").code == 0
    assert sfol("test", tmp_path / "hall.yaml").code == 0


def test_atoms_are_formatted():
    text = HALL.replace("Ahead(P in person, robot)", "Ahead( P  in person,robot )")
    assert format_file(text) == HALL


def test_lint_finds_what_nothing_reads_and_what_nothing_gives(hall):
    assert {finding.code for finding in lint(hall())} == {"SF006", "SF017"}
    kb = hall(
        {
            f"  {PERSON}\n": "",
            "from: 1 - light": "from: 1",
            "at_most: 4}": "at_most: 4}\n  ghost: {from: people, at_most: 1}",
        }
    )
    found = {finding.code: finding for finding in lint(kb)}
    assert found["SF016"].path == ("predicates", "Person")
    parts = {finding.path for finding in lint(kb) if finding.code == "SF015"}
    assert parts == {("observation", "light"), ("entities", "ghost")}

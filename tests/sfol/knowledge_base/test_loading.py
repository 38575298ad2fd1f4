"""Loading: what a file may say, and how each mistake is reported."""

import os
import re
from pathlib import Path

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.errors import InvalidKnowledgeBase
from sfol.knowledge_base.loading import bundled_names
from tests.sfol.conftest import KITCHEN

BASE = KITCHEN.replace("{SEMANTICS}", "{}")


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


def errors_of(*sources):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        KnowledgeBase.load(*sources)
    return caught.value.errors


def overlay(folder, text, base=BASE):
    write(folder, "kitchen", base)
    return write(folder, "overlay", f"version: 1\nname: overlay\nextends: kitchen\n{text}")


# -- the bundled files ----------------------------------------------------------------------------


def test_every_bundled_file_is_found_by_name_and_is_valid():
    assert {"aeb", "crossing"} <= set(bundled_names())
    for name in bundled_names():
        assert KnowledgeBase.load(name).rules


def test_the_papers_tables_are_there():
    kb = KnowledgeBase.load("aeb")
    table = "Vehicle Truck Pedestrian Crosswalk LeftOf RightOf CenterOf IsNear Approaching OnRoad"
    table += " OnCrosswalk Occludes IsClear NoCrosswalk EmptyLane IsAt"
    declared = {name for name, predicate in kb.predicates.items() if name not in kb.heads[1:]}
    assert declared == set(table.split())
    assert all(kb.predicates[name].description for name in declared)
    assert sum(rule.clause.head.predicate == "safe3" for rule in kb.rules.values()) == 3
    assert kb.grounding.margin == 0.05


def test_what_extends_a_base_keeps_its_rules_and_changes_its_numbers():
    aeb, crossing = KnowledgeBase.load("aeb"), KnowledgeBase.load("crossing")
    assert crossing.rules == aeb.rules
    assert crossing.hash != aeb.hash
    assert crossing.tests == ()
    assert [Path(file).name for file in crossing.files] == ["aeb.yaml", "crossing.yaml"]


def test_the_hash_is_of_the_meaning_and_not_of_the_text(tmp_path):
    plain = KnowledgeBase.load(write(tmp_path, "a", BASE))
    commented = KnowledgeBase.load(
        write(tmp_path, "b", "# hello\n" + BASE.replace("X is hot.", "Ouch."))
    )
    changed = KnowledgeBase.load(write(tmp_path, "c", BASE.replace("{k: 2.0}", "{k: 2.5}")))
    assert plain.hash == commented.hash != changed.hash


# -- overlays -------------------------------------------------------------------------------------


def test_an_overlay_adds_replaces_and_merges(tmp_path):
    path = overlay(
        tmp_path,
        "rules:\n  care: careful(X) :- Person(X), Hot(X).\n  more: careful(X) :- Lid(X).\n"
        "predicates: {'Near(A, B)': A touches B.}\n"
        "terms: {haste: {parameters: {k: 3.0}}}\n",
    )
    kb = KnowledgeBase.load(path)
    assert list(kb.rules) == ["care", "more"]
    assert str(kb.rules["care"].clause) == "careful(X) :- Person(X), Hot(X)."
    assert kb.predicates["Near"].description == "A touches B."
    assert kb.terms["haste"].parameters == {"k": 3.0}
    assert kb.terms["haste"].formula.text == "-k * speed"


def test_a_replaced_rule_keeps_nothing_of_the_old_one(tmp_path):
    base = BASE.replace(
        "care: careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X).",
        "care: {rule: 'careful(X) :- Person(X).', threshold: 0.7, description: old}",
    )
    kb = KnowledgeBase.load(
        overlay(tmp_path, "rules: {care: {rule: 'careful(X) :- Hot(X).'}}\n", base)
    )
    assert (kb.rules["care"].threshold, kb.rules["care"].description) == (0.0, "")


def test_remove_drops_rules_and_their_weights_contribute_nothing(tmp_path):
    kb = KnowledgeBase.load(overlay(tmp_path, "remove: {rules: [care]}\n"))
    assert kb.rules == {}
    assert RewardFunction(kb).evaluate(Facts(), speed=1.0).weights == {"care": 0.0}


def test_removing_what_is_not_there_is_an_error_with_place(tmp_path):
    (error,) = errors_of(overlay(tmp_path, "remove: {rules: [crae]}\n"))
    assert "no 'crae' in rules to remove" in str(error)
    assert "did you mean 'care'?" in str(error)
    assert (error.place.line, error.place.column) == (4, 18)


def test_several_knowledge_bases_apply_left_to_right_each_once(tmp_path):
    base = write(tmp_path, "kitchen", BASE)
    fast = write(tmp_path, "fast", "version: 1\nname: fast\nextends: kitchen\n"
                 "terms: {haste: {parameters: {k: 5.0}}}\n")  # fmt: skip
    slow = write(tmp_path, "slow", "version: 1\nname: slow\nextends: [kitchen]\n"
                 "terms: {haste: {parameters: {k: 1.0}}}\n")  # fmt: skip
    assert KnowledgeBase.load(fast, slow).terms["haste"].parameters["k"] == 1.0
    assert KnowledgeBase.load(slow, fast).terms["haste"].parameters["k"] == 5.0
    assert KnowledgeBase.load(base, slow, fast).name == "fast"
    assert len(KnowledgeBase.load(slow, fast).files) == 3


def test_extends_in_a_circle(tmp_path):
    write(tmp_path, "a", "version: 1\nname: a\nextends: b\n")
    (error,) = errors_of(write(tmp_path, "b", "version: 1\nname: b\nextends: a\n"))
    assert "in a circle: b → a → b" in error.message
    assert error.place.file.endswith("a.yaml")


@pytest.mark.parametrize("name", ["../kitchen", "/etc/passwd", "sub/../kitchen", "kitchen.yaml"])
def test_extends_never_climbs(tmp_path, name):
    write(tmp_path, "kitchen", BASE)
    folder = tmp_path / "sub"
    folder.mkdir()
    (error,) = errors_of(write(folder, "x", f"version: 1\nname: x\nextends: {name}\n"))
    assert "can't be extended" in error.message
    assert (error.place.line, error.place.column) == (3, 10)


def test_a_bundled_name_that_is_misspelt():
    (error,) = errors_of("crosing")
    assert "did you mean 'crossing'?" in str(error)


# -- mistakes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "line", "column", "message", "suggestion"),
    [
        ("Pot(P), Hot(P)", "Pto(P), Hot(P)", 12, 34, "unknown predicate 'Pto'", "did you mean 'Pot'?"),
        ("Near(P, X).", "Near(P).", 12, 50, "'Near' has 1 arguments here", "declared as Near(X, Y)"),
        ("careful(X) :-", "careful(Y) :-", 12, 17, "the variable 'Y' stands in no positive", "Predicate(Y)"),
        ("Hot(P), Near", "not Hot(Q), Near", 12, 50, "the variable 'Q' stands in no positive", "Predicate(Q)"),
        ("Hot(P), Near", "Hot(P); Near", 12, 48, "the character ';' has no place", ""),
        ("careful: 1.0", "crefaul: 1.0", 17, 40, "unknown head 'crefaul'", "did you mean 'careful'?"),
        ("weight: care,", "weight: cear,", 19, 19, "unknown weight 'cear'", "did you mean 'care'?"),
        ("-k * speed", "-k * sped", 19, 39, "the formula reads 'sped'", "did you mean 'speed'?"),
        ("-k * speed", "-k * speed.real", 19, 39, "the formula reads 'speed.real'", "from: speed.real"),
        ("rules:", "ruels:", 11, 1, "unknown key 'ruels'", "did you mean 'rules'?"),
        ("normalizer: 1", "normalizer: 0", 17, 10, "greater than 0", ""),
        ("normalizer: 1", "normalizer: one", 17, 22, "not 'one'", ""),
        ("{k: 2.0}", "{k: .nan}", 19, 59, "finite number", ""),
        ("version: 1", "version: 3", 1, 1, "should be 1 or 2, not 3", ""),
        ("subject: cook", "subject: Cook", 3, 10, "'Cook' is not a constant", "lower-case"),
        ("[Person(cook)]", "[Person(X)]", 4, 14, "has a variable, 'X'", ""),
        ("[Person(cook)]", "[Near(cook, pot)]", 4, 14, "is expected where the text ends", "in quotes"),
        ("  Hot(X): X is hot.", "  Hot(X): X is hot.\n  Hot(Y): Twice.", 9, 3, "declared twice", ""),
        ("name: kitchen", "name: kitchen\nname: again", 3, 1, "the key 'name' stands twice", ""),
        ("name: kitchen", "name: [", 3, 8, "this is not YAML", ""),
        ("name: kitchen", "name: !!python/name:os.system x", 2, 7, "could not determine|not allowed", ""),
        ("name: kitchen", "name: !!timestamp 2020-01-01", 2, 7, "not allowed", ""),
        ("name: kitchen", "name: !!bool maybe", 2, 7, "not a value of this kind", ""),
        ("normalizer: 1", "normalizer: 1:30", 17, 22, "not '1:30'", ""),
        ("normalizer: 1", "normalizer: yes", 17, 22, "not 'yes'", ""),
        ("{k: 2.0}", "{k: 2.0, kk: 3.0}", 19, 67, "does not use the parameter 'kk'", "did you mean 'k'?"),
        ("rules:", "rules: [a]\nsignls:", 11, 1, "valid dictionary", ""),
        ("unit: m/s", "unt: m/s", 15, 11, "unknown key 'unt' in signals.speed", "did you mean 'unit'?"),
    ],
)  # fmt: skip
def test_mistakes_have_a_place_a_name_and_a_suggestion(
    tmp_path, old, new, line, column, message, suggestion
):
    assert old in BASE
    path = write(tmp_path, "kitchen", BASE.replace(old, new, 1))
    texts = [str(error) for error in errors_of(path)]
    places = [(e.place.line, e.place.column) for e in errors_of(path)]
    chosen = [i for i, text in enumerate(texts) if re.search(message, text) or message in text]
    assert chosen, texts
    first = chosen[0]
    assert suggestion in texts[first]
    if "not YAML" not in message:
        assert places[first] == (line, column)
    assert texts[first].startswith(str(path))


def test_a_cycle_is_printed(kitchen):
    with pytest.raises(InvalidKnowledgeBase, match=r"in a circle: \w+ → \w+ → \w+"):
        kitchen({"Hot(P), Near": "b(P), Near", "  care: careful": "  b: b(X) :- a(X).\n"
                 "  a: a(X) :- b(X).\n  care: careful"})  # fmt: skip


@pytest.mark.parametrize(
    ("rules", "circle", "why", "suggestion"),
    [
        (("a(X) :- Hot(X), a(X).",), "a → a", "a bound would be taken from itself", "'a(X)'"),
        (
            ("'a(X) :- Hot(X), count(Y: a(Y)) >= 2.'",),
            "a → a",
            "'count(Y: a(Y)) >= 2' would speak of all",
            "'r0'",
        ),
        (("a(X) :- Hot(X), not a(X).",), "a → a", "'not a(X)' would deny what", "'not a(X)'"),
        (
            ("a(X) :- b(X).", "b(X) :- a(X).", "b(X) :- Hot(X), not a(X)."),
            r"(a → b → a|b → a → b)",
            "'not a(X)' would deny what follows from it",
            "leave 'not a(X)' out of the rule 'r2'",
        ),
    ],
)
def test_a_cycle_says_why_it_is_refused(kitchen, rules, circle, why, suggestion):
    lines = "".join(f"  r{number}: {rule}\n" for number, rule in enumerate(rules))
    with pytest.raises(InvalidKnowledgeBase, match="in a circle") as caught:
        kitchen({"Hot(P), Near": "a(P), Near", "  care: careful": f"{lines}  care: careful"})
    assert re.search(f"in a circle: {circle}; {re.escape(why)}", str(caught.value))
    assert suggestion in str(caught.value)


def test_a_misspelt_head_is_caught(kitchen):
    with pytest.raises(InvalidKnowledgeBase, match="did you mean 'careful'"):
        kitchen({"  care: careful(X)": "  other: carefull(X) :- Hot(X).\n  care: careful(X)"})


def test_places_in_block_and_quoted_texts(kitchen):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        kitchen({
            "care: careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X).":
            "care:\n    rule: |\n      careful(X) :-\n        Person(X),\n        Pott(X).\n"
            '  more: "careful(X) :- Hott(X)."'
        })  # fmt: skip
    places = [(e.name, e.place.line, e.place.column) for e in caught.value.errors]
    assert places == [("Pott", 16, 9), ("Hott", 17, 24)]


def test_all_errors_of_a_file_are_reported_in_one_run(kitchen):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        kitchen({"Pot(P), Hot(P)": "Pto(P), Hto(P)", "-k * speed": "-k * sped"})
    assert [error.name for error in caught.value.errors] == ["Pto", "Hto", "sped"]


def test_tests_of_a_file_are_checked_too(kitchen):
    case = "tests:\n- {name: t, facts: Pott(p)., signals: {sped: 1}, expect: {weights: {cere: 1}}}"
    with pytest.raises(InvalidKnowledgeBase) as caught:
        kitchen({"{k: 2.0}}": "{k: 2.0}}\n" + case})
    assert [error.name for error in caught.value.errors] == ["Pott", "sped", "cere"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "- a list",
        "just text",
        "a: &a [*a]",
        "version: 1\nname: x\nbackground: " + "[" * 5000,
        "version: 1\nname: x\nbackground: " + "[" * 60 + "]" * 60,
        "a: &a [x, x, x, x, x, x, x, x, x]\n"
        + "\n".join(
            f"a{i}: &a{i} [{', '.join([f'*a{i - 1}' if i else '*a'] * 9)}]" for i in range(9)
        ),
        "? [a, b]\n: c",
        "\tversion: 1",
        "version: 1\nname: \x01",
        "rules: &r {}\n<<: *r",
    ],
)
def test_broken_recursive_and_exploding_files_are_refused(tmp_path, text):
    for error in errors_of(write(tmp_path, "x", text)):
        assert error.place is not None
        assert error.place.file.endswith("x.yaml")


def test_files_that_cannot_be_read(tmp_path):
    assert "can't be read" in errors_of(tmp_path / "nowhere.yaml")[0].message
    assert "can't be read" in errors_of(tmp_path)[0].message
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    assert "not UTF-8" in errors_of(binary)[0].message
    huge = tmp_path / "huge.yaml"
    huge.write_text("#" * 1_000_001)
    assert "bytes" in errors_of(huge)[0].message


def test_loading_runs_nothing(tmp_path):
    marker = tmp_path / "ran"
    write(
        tmp_path,
        "x",
        BASE.replace("name: kitchen", f"name: !!python/object/apply:os.system ['touch {marker}']"),
    )
    errors_of(tmp_path / "x.yaml")
    assert not os.path.exists(marker)

"""Lint: each code on a knowledge base that deserves it, and silence on one that does not."""

import math
import re

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.knowledge_base.loading import bundled_names
from sfol.logs import Log, LoggedEpisode, LoggedStep, LogWriter
from sfol.tools import lint as lint_module
from sfol.tools.lint import lint, lint_episodes, located
from sfol.tools.replay import replay
from sfol.tools.subsumption import PAIR_STEPS
from tests.sfol.command_line import RULES, sfol
from tests.sfol.conftest import KITCHEN
from tests.sfol.work import calls

RULE = "careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X)."
ENDINGS = ("collision", "timeout", "success")
QUIET = {"  Lid(X): X has a lid on.\n": ""}


def codes(kb):
    return [finding.code for finding in lint(kb)]


def only(kb, code):
    (finding,) = [finding for finding in lint(kb) if finding.code == code]
    return finding


def test_nothing_is_odd_about_the_kitchen_but_its_average(kitchen):
    assert codes(kitchen(QUIET)) == ["SF006", "SF017"]
    assert codes(kitchen(QUIET, "groundings: best")) == ["SF017"]
    assert codes(kitchen(QUIET, "conjunction: minimum")) == []
    assert codes(kitchen(QUIET, "conjunction: product")) == []


@pytest.mark.parametrize(
    ("rule", "reason"),
    [
        ("careful(X) :- Person(X), X != X.", "'X != X' is never true"),
        ("careful(X) :- a(X).\n  a: a(X) :- b(X).\n  b: b(X) :- Pot(X), X != X.", "concludes 'a'"),
        ("{rule: 'careful(X) :- Pot(X), not Pot(X).', threshold: 0.6}", "exclude each other"),
        ("{rule: 'careful(X) :- Pot(X), not Pot(X).', negation_threshold: 1}", "exclude each other"),
    ],
)  # fmt: skip
def test_sf001_rules_that_never_fire(kitchen, rule, reason):
    found = [f for f in lint(kitchen({RULE: rule})) if f.code == "SF001"]
    assert any(reason in finding.message for finding in found)
    assert ("rules", "care") in [finding.path for finding in found]
    assert "SF002" not in codes(kitchen({RULE: rule}))


def test_sf001_a_declared_head_may_be_observed(kitchen):
    kb = kitchen({RULE: f"{RULE}\n  hot: Hot(X) :- Lid(X), X != X."})
    assert [f.path for f in lint(kb) if f.code == "SF001"] == [("rules", "hot")]


def test_sf001_is_right_about_what_fires(kitchen):
    """At the default thresholds P and not P both hold of an atom that is hardly true."""
    kb = kitchen({RULE: "careful(X) :- Pot(X), not Pot(X)."})
    assert "upper bound is at most 0.5" in only(kb, "SF002").message
    facts = Facts.parse("Pot(cook): [0.1, 0.4].")
    assert RewardFunction(kb).evaluate(facts, speed=1.0).bounds["careful"] is not None


def test_sf003_predicates_that_nothing_reads(kitchen):
    assert only(kitchen(), "SF003").path == ("predicates", "Lid")
    read = {"rules:": "entity_weights: [{when: Lid(X), weight: 1}]\nrules:"}
    assert "SF003" not in codes(kitchen(read))


def test_sf004_weights_without_a_rule(tmp_path):
    (tmp_path / "kitchen.yaml").write_text(KITCHEN.replace("{SEMANTICS}", "{}"))
    path = tmp_path / "bare.yaml"
    path.write_text("version: 1\nname: bare\nextends: kitchen\nremove:\n  rules: [care]\n")
    kb = KnowledgeBase.load(path)
    (finding,) = [f for f in located(kb, lint(kb)) if f.code == "SF004"]
    assert "'careful', which no rule concludes" in finding.message
    assert (finding.place.file, finding.place.line) == (str(path), 5)


def test_sf010_weights_that_no_term_uses(kitchen):
    kb = kitchen({"weights:": "weights:\n  spare: {normalizer: 1, coefficients: {careful: 1.0}}"})
    assert only(kb, "SF010").path == ("weights", "spare")
    assert "SF010" not in codes(kitchen())


def test_sf011_signals_that_no_formula_reads(kitchen):
    kb = kitchen({"signals:": "signals:\n  heat: {unit: K, default: 0.0}"})
    assert only(kb, "SF011").path == ("signals", "heat")
    assert "SF011" not in codes(kitchen())


def test_sf014_tests_that_expect_nothing(kitchen):
    haste = "haste: {weight: care, formula: -k * speed, parameters: {k: 2.0}}"
    tests = "tests: [{name: a, signals: {speed: 1}, expect: {reward: 0}}, {name: b, expect: {}}]"
    kb = kitchen({haste: f"{haste}\n{tests}"})
    finding = only(kb, "SF014")
    assert finding.path == ("tests", 1)
    assert "'b'" in finding.message


def test_sf017_averages_that_jump(kitchen):
    reward = RewardFunction(kb := kitchen(semantics="groundings: best"))
    sure = "Person(cook). Pot(p). Near(p, cook)."
    hot = [reward(Facts.parse(f"{sure} {more}"), speed=1.0) for more in ("", "Hot(p): 1e-9.")]
    finding = only(kb, "SF017")
    assert "'care' goes from 0 to 0.75 as soon" in finding.message
    assert hot == pytest.approx([0.0, 0.75 * reward(Facts.parse(f"{sure} Hot(p)."), speed=1.0)])
    for quiet in (
        "careful(X) :- Person(X).",
        "careful(X) :- Person(X) >= 0.1, Hot(X) >= 0.2.",
        "{rule: 'careful(X) :- Person(X), Hot(X).', threshold: 0.5}",
    ):
        assert "SF017" not in codes(kitchen({RULE: quiet}))
    assert "SF017" not in codes(kitchen(semantics="conjunction: product"))


def test_thresholds_that_meet_on_paper_do_not_exclude_each_other(kitchen):
    rule = (
        "{rule: 'careful(X) :- Person(X), not Person(X).', threshold: %s, negation_threshold: 0.8}"
    )
    for threshold, code in ((0.2, "SF002"), (0.21, "SF001")):  # 1 − 0.8 is a little less than 0.2
        kb = kitchen({RULE: rule % threshold})
        assert code in codes(kb)


@pytest.mark.parametrize("name", bundled_names())
def test_nothing_is_odd_about_the_bundled_knowledge_bases(name):
    kb = KnowledgeBase.load(name)
    assert [f for f in located(kb, lint(kb)) if f.level == "warning"] == []


@pytest.mark.parametrize(
    ("other", "subsumed"),
    [
        ("careful(Y) :- Near(Q, Y), Pot(Q), Person(Y).", "care"),
        ("careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X), Lid(P).", "other"),
        (RULE, "other"),
        ("careful(X) :- Person(X), Pot(Q), Hot(P), Near(P, X).", "care"),
        ("careful(X) :- Person(X), Pot(P), Hot(P), Near(X, P).", None),
        ("careful(X) :- Person(X), Pot(P), not Hot(P), Near(P, X).", None),
        ("careful(X) :- Person(X), Near(P, X), P != X.", None),
        ("{rule: 'careful(X) :- Person(X), Near(P, X).', threshold: 0.5}", None),
    ],
)
def test_sf005_subsumed_rules(kitchen, other, subsumed):
    kb = kitchen({RULE: f"{RULE}\n  other: {other}"})
    found = [finding.path[1] for finding in lint(kb) if finding.code == "SF005"]
    assert found == ([subsumed] if subsumed else [])


def test_sf005_says_what_the_rule_still_does(kitchen):
    more = {RULE: f"{RULE}\n  other: {RULE}"}
    assert "only raise the average" in only(kitchen(more), "SF005").message
    assert "changes nothing" in only(kitchen(more, "conjunction: minimum"), "SF005").message


BIG = """\
version: 1
name: big
predicates: {{P(X): a{predicates}}}
rules: {{{rules}}}
signals: {{v: {{unit: m/s}}}}
weights: {{w: {{normalizer: 1, coefficients: {{h0: 1}}}}}}
terms: {{t: {{weight: w, formula: v}}}}
"""


def big(count, rule):
    """Return a text with so many rules; {i} in a rule is its number, Q{i} a predicate of its own."""
    rules = ", ".join(f"r{i}: '{rule.format(i=i)}'" for i in range(count))
    predicates = "".join(f", Q{i}(X): q" for i in range(count)) + "".join(
        f", h{i}(X): h" for i in range(count + 1)
    )
    return BIG.format(predicates=predicates, rules=rules)


@pytest.mark.parametrize(
    "rule",
    [
        "h0(X) :- P(X), Q{i}(X).",
        "h{i}(X) :- P(X).",
        "h0(X) :- P(X).",
        "h0(X) :- Q{i}(X), X != X.",
        "h0(X) :- Q{i}(X), not Q{i}(X).",
    ],
)
def test_twice_the_rules_are_about_twice_the_work(tmp_path, rule):
    once, twice = (linting(tmp_path, big(count, rule)) for count in (100, 200))
    assert twice < 2.5 * once


def test_a_chain_of_rules_that_never_fire_is_followed_once(tmp_path):
    """Each reads the head of the one after it, the last reads nothing: in one pass or in many."""

    def chain(count):
        text = big(count, "g{i}(X) :- P(X), g{i}_(X).").replace("'g", "'h").replace(" g", " h")
        for i in range(count - 1):
            text = text.replace(f"h{i}_(X)", f"h{i + 1}(X)")
        heads = "".join(f", h{i}(X): h" for i in range(count + 1))
        return text.replace(heads, "").replace(f"h{count - 1}_(X)", "X != X")

    once, twice = (linting(tmp_path, chain(count)) for count in (100, 200))
    kb = KnowledgeBase.load(tmp_path / "big.yaml")
    assert len([finding for finding in lint(kb) if finding.code == "SF001"]) == 200
    assert twice < 2.5 * once


def linting(folder, text):
    """Return how many functions are called to lint a text."""
    path = folder / "big.yaml"
    path.write_text(text)
    kb = KnowledgeBase.load(path)
    return calls(lambda: lint(kb))


def hard(variables):
    """Two rules whose comparison is the colouring of a complete graph with one colour too few."""
    names = [f"A{i}" for i in range(variables)]
    edges = [f"Near({a}, {b})" for a in names for b in names if a != b]
    colours = [name for name in names if name != "A0"]
    fewer = [f"Near({a}{x}, {b}{y})" for a in colours for b in colours if a != b for x in "xy" for y in "xy"]  # fmt: skip
    return f"careful(X) :- Person(X), {', '.join(edges)}.", f"careful(X) :- Person(X), {', '.join(fewer)}."  # fmt: skip


def test_sf009_says_which_rules_were_not_compared(kitchen):
    first, second = hard(5)
    kb = kitchen({RULE: f"{first}\n  other: {second}"})
    finding = only(kb, "SF009")
    assert (finding.level, finding.path) == ("info", ("rules",))
    assert "not compared, as that takes too long: 'care' with 'other'" in finding.message
    assert calls(lambda: lint(kb)) < 30 * PAIR_STEPS


def test_rules_of_eight_or_twelve_free_literals_are_compared(kitchen):
    for count in (8, 12):
        free = [f"Near(A{i}, B{i})" for i in range(count)]
        ends = ["Near(A, A)"], ["Hot(A)", "Pot(A)"]
        first, second = (f"careful(X) :- Person(X), {', '.join([*free, *end])}." for end in ends)
        assert set(codes(kitchen({RULE: f"{first}\n  other: {second}"}))) == {
            "SF003",
            "SF006",
            "SF017",
        }


# -- recorded episodes ----------------------------------------------------------------------------


def log_of(*episodes):
    """A log from (ending, haste at every step)."""
    scene = Facts.parse("Pot(p). Hot(p). Near(p, cook).")
    return Log("kitchen", "", "", tuple(
        LoggedEpisode(i, ending, tuple(LoggedStep(t, scene, {"speed": s}) for t, s in enumerate(speeds)))
        for i, (ending, speeds) in enumerate(episodes)
    ))  # fmt: skip


def test_sf007_a_term_that_dominates(kitchen):
    kb = kitchen({"k: 2.0}}": "k: 2.0}}\n  rest: {weight: 1, formula: 0.01 * speed}"})
    episodes = replay(log_of(("success", [1.0, 2.0])), kb)
    (finding,) = lint_episodes(kb, episodes, endings=ENDINGS)
    assert (finding.code, finding.path) == ("SF007", ("terms", "haste"))
    assert "99.5% of all reward" in finding.message
    assert lint_episodes(kb, episodes, endings=ENDINGS, dominant=0.999) == ()


def test_sf007_one_term_alone_is_no_finding(kitchen):
    kb = kitchen()
    assert lint_episodes(kb, replay(log_of(("success", [1.0])), kb), endings=ENDINGS) == ()


def test_sf008_returns_in_the_wrong_order(kitchen):
    kb = kitchen()
    drives = (("collision", [9.0]), ("timeout", [0.0]), ("success", [1.0]), ("other", [5.0]))
    (finding,) = lint_episodes(kb, replay(log_of(*drives), kb), endings=ENDINGS)
    assert finding.code == "SF008"
    assert "'timeout' return 0 on average" in finding.message
    assert "'success' only -2" in finding.message
    assert lint_episodes(kb, replay(log_of(*drives), kb), endings=("collision", "success")) == ()


@pytest.mark.parametrize(
    ("endings", "left_out"),
    [
        (("crash", "goal"), None),
        (("crash", "stuck", "goal"), None),
        (("crash",), None),
        (("collision", "timeout", "success"), "'crash', 'goal'"),
        (("crash", "gaol"), "'goal'"),
    ],
)
def test_sf012_endings_without_a_place(kitchen, endings, left_out):
    kb = kitchen()
    drives = (("crash", [9.0]), ("goal", [1.0]), (None, [1.0]))
    found = lint_episodes(kb, replay(log_of(*drives), kb), endings=endings)
    messages = [finding.message for finding in found if finding.code == "SF012"]
    assert len(messages) == (0 if left_out is None else 1)
    for message in messages:
        assert message.startswith(
            f"episodes end with {left_out}, which has no place in '{endings[0]} <"
        )


# -- places, comments, the command ----------------------------------------------------------------


@pytest.fixture
def odd(tmp_path):
    path = tmp_path / "kitchen.yaml"
    path.write_text(KITCHEN.replace("{SEMANTICS}", "{conjunction: minimum}"))
    return path


def test_findings_have_a_place(odd):
    done = sfol("lint", odd)
    assert done.code == 1
    assert done.out == (
        f"{odd}:9:3: SF003 nothing reads the predicate 'Lid' — remove it, or use it in a rule\n"
    )


@pytest.mark.parametrize(
    ("comment", "hides"),
    [
        ("  # sfol: ignore SF003", True),
        ("  # sfol: ignore SF001, SF003", True),
        ("  # sfol: ignore", True),
        ("  #sfol:ignore SF003: others may read it", True),
        ("  # sfol: ignore sf003", True),
        ("  # SFOL: Ignore Sf003, sf001", True),
        ("  # sfol: ignore: others may read it", True),
        ("  # sfol: ignore SF003 # and more", True),
        ("  # sfol: ignore SF003 here", True),
        ("  # sfol: ignore SF004", False),
        ("  # sfol: ignore sf004", False),
        ("  # sfol: ignore SF0003", False),
        ("  # sfol: ignore this", False),
        ("  # sfol: ignored by all", False),
    ],
)
def test_a_comment_hides_a_finding(odd, comment, hides):
    line = "  Lid(X): X has a lid on.\n"
    text = odd.read_text()
    for changed in (line.replace("\n", comment + "\n"), comment + "\n" + line):
        odd.write_text(text.replace(line, changed))
        assert ("SF003" not in sfol("lint", odd).out.replace("sfol: ignore SF003", "")) == hides
    odd.write_text(text.replace(line, line + comment + "\n"))
    assert sfol("lint", odd).code == 1


@pytest.mark.parametrize("word", ["this", "SF0003", "SF099", "SF003."])
def test_sf013_comments_that_ignore_what_is_no_code(odd, word):
    odd.write_text(odd.read_text() + f"\n  # sfol: ignore SF001 {word}: for a reason\n")
    lines = odd.read_text().count("\n")
    done = sfol("lint", odd)
    assert done.code == 1
    assert (
        f"{odd}:{lines}:3: SF013 the comment ignores '{word.upper()}', which is no code" in done.out
    )


def test_the_table_has_every_code():
    table = re.findall(r"^\| (SF\d+) \| (warning|info) \|", lint_module.__doc__, re.M)
    assert [code for code, _ in table] == sorted(lint_module._CODES)


def test_infos_are_no_failure_and_what_is_inherited_is_not_told_again():
    done = sfol("lint", RULES / "aeb.yaml", RULES / "crossing.yaml")
    lines = [line for line in done.out.splitlines() if "SF006" in line]
    assert len(lines) == 1
    assert "aeb.yaml" in lines[0]
    levels = {
        finding.level for finding in lint(KnowledgeBase.load("aeb")) if finding.code == "SF006"
    }
    assert levels == {"info"}


def test_a_log_on_the_command_line(tmp_path):
    path = tmp_path / "drives.parquet"
    scene = Facts.parse("Pedestrian(p). OnRoad(p). CenterOf(p, ego). Wheel(w).")
    with LogWriter(path, KnowledgeBase.load("aeb")) as log:
        for ending, distance in (("collision", math.inf), ("success", 0.0)):
            log.step(scene, 0.0, v=5.0, v_next=5.0, d=distance)
            log.end_episode(ending)
    done = sfol("lint", "aeb", "--log", path)
    assert done.code == 1
    assert "SF007 the term 'safety' is 100.0% of all reward" in done.out
    assert "SF008 episodes that end with 'collision' return 0 on average" in done.out
    assert "note: 'aeb' does not know Wheel; left out" in done.err
    assert sfol("lint", "aeb", "--log", tmp_path / "none").code == 2
    mild = sfol("lint", "aeb", "--log", path, "--dominant", 1, "--endings", "success<collision")
    assert "SF007" not in mild.out
    assert "SF008" not in mild.out
    unknown = sfol("lint", "aeb", "--log", path, "--endings", "crash < goal")
    assert unknown.code == 1
    assert "SF012 episodes end with 'collision', 'success'" in unknown.out
    for order in ("", "a <", "a < b < a"):
        assert "is no order of endings" in sfol("lint", "aeb", "--endings", order).err

"""Episodes: steps in order, a memory that is a value, and what knows of neither and says so."""

import copy
import math
import pickle
from dataclasses import replace
from itertools import pairwise

import pytest

import sfol
from sfol.errors import FactError, InvalidKnowledgeBase, SfolError, SignalError, UsageError
from sfol.knowledge_base.formatting import format_file
from sfol.knowledge_base.printing import to_yaml
from sfol.logs import LogWriter, read_log
from sfol.temporal import Memory
from sfol.testing.cases import run_tests
from sfol.tools.diff import compare, compare_log
from sfol.tools.graph import dependency_graph
from sfol.tools.lint import lint, located
from sfol.tools.replay import replay
from tests.sfol.command_line import sfol as command
from tests.sfol.harbour import harbour, harbour_text

NEAR = sfol.Facts.parse("Near(pilot): [0.6, 0.8].")
NOTHING = sfol.Facts()
ONCE = "once[1](Near(X))"
EVERYTHING = (
    "once[3](Near(X)), held[2](Near(X)), not previously(Behind(X, _)), "
    "not since(Near(X), Warned(X)), latched(Near(X), on=0.5, off=0.2), not rose(Near(X)), "
    "not fell(once[2](Behind(X, _)))"
)
SMOOTH = ("coefficients: {said: 1}", "coefficients: {said: 1}, smoothing: {rise: 0, fall: 1}")


def smooth(body="Near(X)"):
    return harbour_text(body).replace(*SMOOTH)


@pytest.fixture
def load(tmp_path):
    def loaded(text, name="harbour"):
        path = tmp_path / f"{name}.yaml"
        path.write_text(text)
        return sfol.KnowledgeBase.load(path)

    return loaded


# -- steps --------------------------------------------------------------------------------------


def test_a_step_is_rewarded_with_those_before_it_in_mind():
    episode = sfol.RewardFunction(harbour(ONCE)).episode()
    assert [episode.step(facts).reward for facts in (NEAR, NOTHING, NOTHING)] == [0.7] * 3
    assert episode.step(NOTHING).reward == 0.0
    episode.step(NEAR)
    episode.reset()
    assert episode.step(NOTHING).reward == 0.0


def test_episodes_of_one_reward_know_nothing_of_each_other():
    reward = sfol.RewardFunction(harbour(ONCE))
    one, other = reward.episode(), reward.episode()
    one.step(NEAR)
    assert (one.step(NOTHING).reward, other.step(NOTHING).reward) == (0.7, 0.0)


def test_without_memory_an_episode_is_its_steps():
    reward = sfol.RewardFunction("aeb")
    facts = sfol.Facts.parse("Pedestrian(p1): 0.8. OnRoad(p1). CenterOf(p1, ego).")
    episode = reward.episode()
    for speed in (6.0, 3.0):
        expected = reward.evaluate(facts, v=speed, v_next=2.0, d=4.0)
        found = episode.step(facts, v=speed, v_next=2.0, d=4.0)
        assert (found.reward, found.weights, found.bounds) == (
            expected.reward, expected.weights, expected.bounds,
        )  # fmt: skip


def test_an_error_leaves_the_episode_where_it_was(load):
    text = harbour_text(ONCE).replace("formula: 1", "formula: speed")
    text = text.replace("weights:", "signals:\n  speed: {unit: m/s}\nweights:")
    episode = sfol.RewardFunction(load(text)).episode()
    episode.step(NEAR, speed=1.0)
    before = episode.memory
    with pytest.raises(SignalError, match="'speed' is missing"):
        episode.step(NEAR)
    with pytest.raises(FactError):
        episode.step(sfol.Facts.parse("Far(pilot)."), speed=1.0)
    with pytest.raises(UsageError, match="a scene"):
        episode.step("Near(pilot).", speed=1.0)
    assert episode.memory == before


def test_conclusions_come_before_their_signals():
    reward = sfol.RewardFunction(harbour(ONCE))
    episode = reward.episode()
    episode.conclude(NEAR)
    conclusions = episode.conclude(NOTHING)
    assert reward.evaluate(conclusions).reward == 0.7
    assert reward.weights(conclusions) == {"said": 0.7}


def test_a_transition_reads_what_it_needs(load):
    text = harbour_text(ONCE).replace(
        "weights:",
        "observation:\n  place: {fields: [x]}\nfacts:\n  Near(pilot): {formula: place.x, bounds: exact}\n"
        "signals:\n  push: {unit: m, from: next.place.x - place.x}\nweights:",
    )  # fmt: skip
    reward = sfol.RewardFunction(load(text.replace("formula: 1}", "formula: 1 + push}")))
    episode = reward.episode()
    places = ([0.5], [0.25], [0.125])
    rewards = [episode.transition(a, None, b).reward for a, b in pairwise(places)]
    assert rewards == [0.5 * 0.75, 0.5 * 0.875]
    with pytest.raises(UsageError, match="operator over time 'once'"):
        reward.transition(*([0.5], None, [0.25]))


def test_smoothed_weights_follow(load):
    reward = sfol.RewardFunction(load(smooth()))
    episode = reward.episode()
    weights = [episode.step(facts).weights["said"] for facts in (NOTHING, NEAR, NOTHING, NOTHING)]
    # At once up; down by exp(-0.5 s / 1 s) each step.
    expected = [0.0, 0.7, 0.7 * math.exp(-0.5), 0.7 * math.exp(-1.0)]
    assert weights == pytest.approx(expected)
    reward.coefficients["said"]["said"] = 2.0
    assert episode.step(NEAR).weights["said"] == pytest.approx(1.4)


# -- memory -------------------------------------------------------------------------------------


def entries(memory):
    """Return how many numbers and names a memory holds."""
    if isinstance(memory, Memory):
        return entries(memory.atoms) + entries(memory.weights)
    if isinstance(memory, dict):
        return sum(1 + entries(value) for value in memory.values())
    return sum(map(entries, memory)) if isinstance(memory, tuple) else 1


def test_memory_is_bounded_by_the_longest_window():
    episode = sfol.RewardFunction(harbour(EVERYTHING)).episode()
    sizes = {}
    for step in range(10_001):
        facts = sfol.Facts.parse(f"Near(pilot). Behind(pilot, b{step}).")
        facts.add("Near", f"b{step % 7}", bound=((step % 5) / 4, 1.0))
        episode.conclude(facts)
        if step in (200, 10_000):  # the same of the 35 steps after which all but names repeats
            sizes[step] = entries(episode.memory)
    assert sizes[200] == sizes[10_000] > 20


def test_memory_is_a_value_that_can_be_kept_copied_and_pickled():
    reward = sfol.RewardFunction(harbour(EVERYTHING))
    episode = reward.episode()
    for _ in range(6):
        episode.step(NEAR)
    kept = episode.memory
    copies = (copy.deepcopy(kept), pickle.loads(pickle.dumps(kept)))
    assert copies == (kept, kept)
    after = [episode.step(facts) for facts in (NOTHING, NEAR)]
    for memory in (kept, *copies):
        episode.memory = memory
        again = [episode.step(facts) for facts in (NOTHING, NEAR)]
        assert [o.derived for o in again] == [o.derived for o in after]
    twin = pickle.loads(pickle.dumps(reward)).episode()
    twin.memory = kept
    assert [twin.step(facts).derived for facts in (NOTHING, NEAR)] == [o.derived for o in after]


def test_outcomes_of_an_episode_can_be_pickled():
    episode = sfol.RewardFunction(harbour(ONCE)).episode()
    episode.step(NEAR)
    outcome = episode.step(NOTHING)
    again = pickle.loads(pickle.dumps(outcome))
    assert (again.reward, again.derived, again.fired) == (
        outcome.reward, outcome.derived, outcome.fired,
    )  # fmt: skip
    assert again.conclusions.memory == episode.memory


# -- what takes single steps --------------------------------------------------------------------


@pytest.mark.parametrize(
    "ask",
    [
        lambda reward: reward(NEAR),
        lambda reward: reward.evaluate(NEAR),
        lambda reward: reward.conclude(NEAR),
        lambda reward: reward.weights(NEAR),
        lambda reward: reward.explain(NEAR),
        lambda reward: reward.entity_weights(NEAR, ["pilot"]),
        lambda reward: reward.batch([NEAR]),
    ],
)
def test_a_single_step_is_refused_with_what_to_do(ask, load):
    for kb, named in ((harbour(ONCE), "operator over time 'once'"), (load(smooth()), "'said'")):
        with pytest.raises(UsageError) as caught:
            ask(sfol.RewardFunction(kb))
        assert named in caught.value.message
        assert "episode = reward.episode()" in caught.value.suggestion


def test_many_observations_are_refused(load):
    numpy = pytest.importorskip("numpy")
    text = harbour_text(ONCE).replace(
        "weights:",
        "observation:\n  place: {fields: [x]}\nfacts:\n  Near(pilot): place.x\nweights:",
    )
    reward = sfol.RewardFunction(load(text))
    many = (reward.transitions, reward.weights_of_many, reward.fired_of_many, reward.on_tensors)
    for ask in many:
        with pytest.raises(UsageError, match="what a step is worth depends on those before it"):
            ask(numpy.ones((3, 1)))


# -- files --------------------------------------------------------------------------------------


@pytest.mark.parametrize("operator", ["once[1]", "held[0.5]"])
def test_a_duration_needs_the_length_of_a_step(load, operator):
    text = harbour_text(f"Near(X), {operator}(Near(X))").replace("time: {step: 0.5, unit: s}\n", "")
    with pytest.raises(InvalidKnowledgeBase) as caught:
        load(text)
    (error,) = caught.value.errors
    assert "has a duration, but nothing says how long a step is" in error.message
    assert error.suggestion == "say how long one is: time: {step: 0.1, unit: s}"
    line = text.splitlines()[error.place.line - 1]
    assert line[error.place.column - 1 :].startswith(operator)


def test_a_smoothed_weight_needs_the_length_of_a_step(load):
    with pytest.raises(InvalidKnowledgeBase, match="'said' is smoothed, but nothing says"):
        load(smooth().replace("time: {step: 0.5, unit: s}\n", ""))


def test_operators_without_a_duration_need_none():
    assert harbour("previously(Near(X))").has_memory


@pytest.mark.parametrize("change", [("step: 0.5", "step: 0"), ("step: 0.5", "step: -1"),
                                    ("fall: 1}", "fall: -1}")])  # fmt: skip
def test_lengths_are_not_negative(load, change):
    with pytest.raises(InvalidKnowledgeBase, match="greater than"):
        load(smooth().replace(*change))


def test_sf022_a_window_shorter_than_a_step(load):
    kb = load(harbour_text("held[0.4](Near(X)), once[0.5](Near(X))"))
    (found,) = [finding for finding in located(kb, lint(kb)) if finding.code == "SF022"]
    assert "'held' looks back 0.4, less than a step of 0.5" in found.message
    assert found.suggestion.endswith("held[0.5]")
    assert found.place.line == kb_line("said: >")


def kb_line(start):
    lines = harbour_text("").splitlines()
    return next(n for n, line in enumerate(lines, 1) if line.strip().startswith(start))


def test_misspelt_names_below_operators_are_found(load):
    with pytest.raises(InvalidKnowledgeBase, match="did you mean 'Near'"):
        load(harbour_text("once[1](previously(Neer(X)))"))
    with pytest.raises(InvalidKnowledgeBase, match="'Behind' has 1 arguments here"):
        load(harbour_text("once[1](Behind(X))"))


@pytest.mark.parametrize("text", [harbour_text(EVERYTHING), smooth(ONCE)])
def test_what_is_printed_means_the_same(load, text):
    kb = load(text)
    again = load(to_yaml(kb), "again")
    assert (again.hash, compare(kb, again)) == (kb.hash, ())
    formatted = load(format_file(text), "formatted")
    assert (formatted.hash, compare(kb, formatted)) == (kb.hash, ())


def test_the_length_of_a_step_counts_where_something_remembers(load):
    slow = ("step: 0.5", "step: 1")
    remembers, not_so = harbour_text(ONCE), harbour_text("Near(X)")
    assert load(remembers).hash != load(remembers.replace(*slow)).hash
    assert load(not_so).hash == load(not_so.replace(*slow)).hash
    assert load(smooth()).hash != load(not_so).hash


def test_diff_tells_of_durations_steps_and_smoothing(load):
    before = load(smooth(ONCE))
    text = (
        smooth("once[2](Near(X))").replace("step: 0.5", "step: 0.25").replace("fall: 1", "fall: 2")
    )
    changes = {change.section: change for change in compare(before, load(text, "after"))}
    assert set(changes) == {"rules", "time", "weights"}
    assert changes["time"].before == {"step": "0.5"}
    assert changes["weights"].after == {"smoothing.fall": "2.0"}


def test_show_and_graph_know_of_it(load, tmp_path):
    load(smooth(ONCE))
    shown = command("show", tmp_path / "harbour.yaml").out
    assert "once[1](Near(X))" in shown
    assert "│ said   │ 0    │ 1    │" in shown
    graph = dependency_graph(harbour("Near(X), not since(Warned(X), Near(X))"))
    sources = {a.name for a, b in graph.edges if b.name == "said" and b.kind == "rule"}
    assert sources == {"Near", "Warned"}


# -- explanations -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (ONCE, "once[1](Near(pilot)) [0.6, 0.8]  last true 1 s ago"),
        ("previously(previously(Near(X)))", "[0.6, 0.8]  0.5 s ago"),
        ("latched(once[1](Near(X)), on=0.5, off=0.5)", "on for 1 s"),
        ("held[1](once[2](Near(X)))", "known for 1 s"),
        ("once[1](Near(X)), Warned(X)", "Warned(pilot) [1, 1]  asserted"),
    ],
)
def test_explanations_say_when(body, said):
    reward = sfol.RewardFunction(harbour(body))
    episode = reward.episode()
    warned = sfol.Facts.parse("Warned(pilot).")
    *_, last = [episode.conclude(facts) for facts in (NEAR, NOTHING, warned)]
    assert said in str(reward.explain(last))


def test_explanations_say_what_lacks_and_what_follows(load):
    reward = sfol.RewardFunction(load(smooth(ONCE)))
    text = str(reward.explain(reward.episode().conclude(NOTHING)))
    assert "lacks once[1](Near(pilot))" in text
    assert "weight said 0, smoothed, follows 1/1 of the sum below" in text


def test_steps_without_a_length_are_counted():
    kb = replace(harbour("latched(Near(X), on=0.5, off=0.5)"), time=None)
    reward = sfol.RewardFunction(kb)
    episode = reward.episode()
    episode.conclude(NEAR)
    assert "on for 1 steps" in str(reward.explain(episode.conclude(NEAR)))


# -- tests of a file ----------------------------------------------------------------------------

TESTS = """\
tests:
  - name: near a moment ago
    steps:
      - {facts: "Near(pilot): [0.6, 0.8].", expect: {bounds: {said: [0.6, 0.8]}}}
      - {times: 2, expect: {bounds: {said: [0.6, 0.8]}}}
      - {}
    expect: {bounds: {said: null}, reward: 0}
"""


def test_a_test_plays_steps(load, tmp_path):
    kb = load(harbour_text(ONCE) + TESTS)
    report = run_tests(kb)
    assert report.passed
    assert report.coverage == {"said": 1}
    done = command("explain", tmp_path / "harbour.yaml", "--test", "near a moment ago")
    assert "lacks once[1](Near(pilot))" in done.out
    assert (done.code, done.err) == (0, "")
    assert load(to_yaml(kb), "again").tests == kb.tests


def test_a_test_that_fails_says_at_which_step(load):
    text = TESTS.replace("times: 2, expect: {bounds: {said: [0.6, 0.8]", "times: 3, expect: {bounds: {said: [0.5, 0.8]")  # fmt: skip
    (result,) = run_tests(load(harbour_text(ONCE) + text)).results
    assert result.differences == (
        "step 4: bound of said: expected [0.5, 0.8], found nothing concluded",
    )


def test_signals_of_a_test_count_in_each_step(load):
    text = harbour_text(ONCE).replace("formula: 1", "formula: speed")
    text = text.replace("weights:", "signals:\n  speed: {unit: m/s}\nweights:")
    tests = """\
tests:
  - name: speeds
    signals: {speed: 2}
    steps:
      - {facts: Near(pilot)., expect: {reward: 2}}
      - {signals: {speed: 3}, expect: {reward: 3}}
      - {}
    expect: {reward: 2}
"""
    assert run_tests(load(text + tests)).passed


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("    steps:", "    facts: Near(pilot).\n    steps:", "the test has steps and facts"),
        ("Near(pilot):", "Neer(pilot):", "did you mean 'Near'"),
        ("{bounds: {said: [0.6, 0.8]}}}\n      - {times", "{bounds: {sad: [0.6, 0.8]}}}\n      - {times", "'said'"),
        ("times: 2", "times: 0", "greater than or equal to 1"),
        ("times: 2", "signals: {speed: 2}", "speed"),
    ],
)  # fmt: skip
def test_errors_in_steps_are_found(load, old, new, message):
    assert old in TESTS
    with pytest.raises(InvalidKnowledgeBase, match=message) as caught:
        load(harbour_text(ONCE) + TESTS.replace(old, new, 1))
    assert all(error.place for error in caught.value.errors)


def test_a_single_scene_is_explained_as_the_first_step(load, tmp_path):
    load(harbour_text(ONCE))
    done = command("explain", tmp_path / "harbour.yaml", "--facts", "Near(pilot): 0.5.")
    assert "once[1](Near(pilot)) [0.5, 0.5]  true now" in done.out
    assert "this is the first step of an episode" in done.err


# -- logs ---------------------------------------------------------------------------------------


@pytest.fixture
def log(tmp_path):
    pytest.importorskip("pyarrow")
    path = tmp_path / "drives.parquet"
    with LogWriter(path, harbour("Near(X)")) as writer:
        for _ in range(2):
            for step, facts in enumerate((NEAR, NOTHING, NOTHING, NOTHING)):
                writer.step(facts, step / 2)
            writer.end_episode("success")
    return path


def test_recorded_episodes_are_episodes(log):
    expected = [0.7, 0.7, 0.7, 0.0]
    for episode in replay(read_log(log), harbour(ONCE)):
        assert [outcome.reward for outcome in episode.outcomes] == expected


def test_diff_explains_the_worst_step_with_its_past(log, load, tmp_path):
    before, after = load(harbour_text("Near(X)")), load(harbour_text(ONCE), "after")
    difference = compare_log(read_log(log), before, after)
    assert [(m.episode, m.step) for m in difference.moved] == [(0, 1), (0, 2), (1, 1), (1, 2)]
    done = command("diff", tmp_path / "harbour.yaml", tmp_path / "after.yaml", "--log", log)
    assert "once[1](Near(pilot)) [0.6, 0.8]  last true 0.5 s ago" in done.out


def test_steps_of_another_length_are_refused(log, load):
    kb = load(harbour_text(ONCE).replace("step: 0.5", "step: 0.1"))
    with pytest.raises(SfolError) as caught:
        replay(read_log(log), kb)
    assert "episode 0, step 0 took 0.5 s, and a step of 'harbour' takes 0.1 s" in str(caught.value)
    replay(read_log(log), load(harbour_text("Near(X)").replace("step: 0.5", "step: 0.1")))


def test_measurements_of_batches_are_refused(load, tmp_path):
    load(harbour_text(ONCE) + TESTS)
    done = command("bench", tmp_path / "harbour.yaml", "--quick")
    assert done.code == 2
    assert "'harbour' has rules over time" in done.err

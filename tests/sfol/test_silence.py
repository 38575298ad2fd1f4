"""No silent zero: what can never be concluded is said, by lint and once by a warning."""

import copy
import pickle
import warnings

import numpy as np
import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.cli import run
from sfol.errors import SilentZeroWarning
from sfol.knowledge_base.loading import bundled_names
from sfol.tools.lint import lint, located
from tests.sfol.command_line import sfol

DOOR = """\
version: 1
name: door
subject: robot
background: [Robot(robot)]
predicates:
  Robot(X): X is a robot.
  Door(X): X is a door.
  Key(X): X is a key.
  Near(X, Y): X is near Y.
rules:
  out: out(X) :- Robot(X), Near(D, X), Door(D).
semantics: {conjunction: minimum}
weights: {out: {normalizer: 1, coefficients: {out: 1.0}}}
terms: {out: {weight: out, formula: 1}}
"""
OBSERVED = """\
observation:
  doors: {key: doors, fields: [x]}
  keys: {key: keys, fields: [x]}
  place: {key: place}
entities:
  door: {from: doors, at_most: 3}
  key: {from: keys, at_most: 3}
facts:
  Door(D in door): 1.0
  Key(K in key): 1.0
  Near(K in door, robot): near(K.x - place, 0, margin=1, value_at_margin=0)
"""
OUT = "out(X) :- Robot(X), Near(D, X), Door(D)."
SCENE = "Near(door1, robot). Door(door1)."


@pytest.fixture
def door(tmp_path):
    def load(changes=None, more=""):
        text = DOOR + more
        for old, new in (changes or {}).items():
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "door.yaml").write_text(text)
        return KnowledgeBase.load(tmp_path / "door.yaml")

    return load


def found(kb):
    return [(f.code, f.path, f.message) for f in lint(kb) if f.code in {"SF018", "SF019", "SF020"}]


def only(kb):
    ((code, path, message),) = found(kb)
    assert [f.level for f in lint(kb) if f.code == code] == ["warning"]
    return code, path, message


def said(function):
    """Return what a function warns of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        function()
    return [str(w.message) for w in caught if w.category is SilentZeroWarning]


# -- what is found ------------------------------------------------------------------------------


@pytest.mark.parametrize("more", ["", OBSERVED])
def test_nothing_is_said_of_rules_that_can_conclude_something(door, more):
    assert found(door(more=more)) == []


@pytest.mark.parametrize("name", bundled_names())
def test_nothing_is_said_of_the_bundled_knowledge_bases(name):
    assert found(KnowledgeBase.load(name)) == []


def test_sf018_a_head_about_another_constant(door):
    kb = door({OUT: "out(door1) :- Near(door1, X), Robot(X).", "[Robot": "[Door(door1), Robot"})
    code, path, message = only(kb)
    assert (code, path) == ("SF018", ("rules", "out"))
    assert "no rule concludes 'out' about the subject 'robot', but about 'door1'" in message


def test_sf018_a_head_about_another_sort(door):
    changes = {OUT: "out(D) :- Robot(X), Near(D, X)."}
    assert only(door(changes, OBSERVED))[2].endswith("'robot', but about 'door'")
    assert found(door(changes)) == []  # a program may say so of the robot


def test_sf018_another_rule_of_the_head_may_be_about_the_subject(door):
    changes = {OUT: f"{OUT}\n  other: out(D) :- Robot(X), Near(D, X)."}
    assert found(door(changes, OBSERVED)) == []


def test_sf018_goes_through_other_rules(door):
    changes = {OUT: "close(D) :- Near(D, X), Robot(X).\n  out: out(Y) :- close(Y)."}
    code, path, _ = only(door({**changes, "  out: close": "  close: close"}, OBSERVED))
    assert (code, path) == ("SF018", ("rules", "out"))


@pytest.mark.parametrize("more", ["", OBSERVED])
def test_sf018_a_subject_that_nothing_names(door, more):
    code, path, message = found(door({"subject: robot\n": ""}, more))[0]
    assert (code, path) == ("SF018", ("subject",))
    assert message == "nothing names the subject 'ego'; the background is about 'robot'"


def test_sf018_a_head_about_nobody_needs_no_subject(door):
    nobody = {"subject: robot\n": "", OUT: "out :- Robot(X), Near(D, X), Door(D)."}
    assert found(door(nobody)) == []


def test_sf019_a_variable_in_small_letters(door):
    code, path, message = only(door({OUT: "out(X) :- Robot(X), Near(d, X), Door(d)."}))
    assert (code, path) == ("SF019", ("rules", "out"))
    assert "names 'd', which no fact, test or other rule does" in message
    (finding,) = [f for f in lint(door({OUT: "out(X) :- Near(d, X)."})) if f.code == code]
    assert "for any entity write D" in finding.suggestion


@pytest.mark.parametrize("constant", ["7", '"Mary"'])
def test_sf019_what_is_no_name_was_not_meant_as_a_variable(door, constant):
    assert found(door({OUT: f"out(X) :- Robot(X), Near({constant}, X)."})) == []


@pytest.mark.parametrize(
    "more",
    [
        "tests: [{name: a, facts: 'Door(exit).', expect: {reward: 0}}]",
        "tests: [{name: a, facts: ['Door(exit).'], expect: {reward: 0}}]",
        "entity_weights: [{when: 'Near(exit, X)', weight: 1}]",
        OBSERVED.replace("Door(D in door)", "Near(exit, robot): 1.0\n  Door(D in door)"),
    ],
)
def test_sf019_a_constant_that_something_else_names(door, more):
    assert found(door({OUT: "out(X) :- Robot(X), Near(exit, X)."}, more)) == []


def test_sf019_a_constant_of_the_background_or_of_two_rules_or_of_a_sort(door):
    rule = "out(X) :- Robot(X), Near(exit, X)."
    assert found(door({OUT: rule, "[Robot(robot)]": "[Robot(robot), Door(exit)]"})) == []
    assert found(door({OUT: f"{rule}\n  also: out(X) :- Door(X), Near(exit, X)."})) == []
    assert found(door({OUT: rule.replace("exit", "door1")}, OBSERVED)) == []


def test_sf020_a_rule_that_no_entity_fits(door):
    kb = door({OUT: "out(X) :- Robot(X), Near(K, X), Key(K)."}, OBSERVED)
    code, path, message = only(kb)
    assert (code, path) == ("SF020", ("rules", "out"))
    assert message.endswith("'out': K is 'door' in Near(K, X), but 'key' in Key(K)")
    assert RewardFunction(kb).observe({"doors": [[0.0]], "keys": [[0.0]], "place": 0.0})


def test_sf020_a_constant_where_another_one_is_known(door):
    kb = door({OUT: "out(X) :- Robot(X), Near(X, D), Door(D)."}, OBSERVED)
    assert "X is 'robot' in Robot(X), but 'door' in Near(X, D)" in only(kb)[2]
    kb = door({OUT: "out(X) :- Robot(X), Near(door1, robot), Near(robot, door1)."}, OBSERVED)
    assert "robot is not 'door' in Near(robot, door1)" in only(kb)[2]


def test_sf020_is_silent_where_a_program_makes_the_facts(door):
    assert found(door({OUT: "out(X) :- Robot(X), Near(X, X), Key(X)."})) == []


def test_a_comment_hides_them(door):
    kb = door({"  out: out(X) :- Robot(X), Near(D, X), Door(D).": "  # sfol: ignore SF019\n"
               "  out: out(X) :- Robot(X), Near(d, X)."})  # fmt: skip
    assert "SF019" not in {f.code for f in located(kb, lint(kb))}
    assert "SF019" not in sfol("lint", kb.files[0]).out


# -- the warning --------------------------------------------------------------------------------

LONELY = {OUT: "out(X) :- Robot(X), Near(d, X), Door(d)."}


def test_the_first_evaluation_warns_once(door):
    reward = RewardFunction(door(LONELY))
    (text,) = said(lambda: reward(Facts.parse(SCENE)))
    assert text.startswith("'door': the rule 'out' names 'd'")
    assert "for any entity write D" in text
    assert said(lambda: reward(Facts.parse(SCENE))) == []
    assert said(lambda: reward.explain(Facts.parse(SCENE))) == []


@pytest.mark.parametrize(
    "use",
    [
        lambda reward: reward.conclude(Facts.parse(SCENE)),
        lambda reward: reward.weights(Facts.parse(SCENE)),
        lambda reward: reward.batch([Facts.parse(SCENE)]),
        lambda reward: copy.deepcopy(reward)(Facts.parse(SCENE)),
        lambda reward: pickle.loads(pickle.dumps(reward))(Facts.parse(SCENE)),
    ],
)
def test_every_way_to_evaluate_warns(door, use):
    assert len(said(lambda: use(RewardFunction(door(LONELY))))) == 1


def test_many_observations_warn(door):
    reward = RewardFunction(door({OUT: "out(X) :- Robot(X), Near(K, X), Key(K)."}, OBSERVED))
    scenes = {"doors": np.zeros((2, 3, 1)), "keys": np.zeros((2, 3, 1)), "place": np.zeros(2)}
    (text,) = said(lambda: reward.transition(scenes))
    assert "no entity fits the rule 'out'" in text
    assert said(lambda: reward.transition(scenes)) == []


def test_facts_that_name_the_constant_or_the_subject_are_enough(door):
    reward = RewardFunction(door(LONELY))
    assert said(lambda: reward(Facts.parse("Near(d, robot). Door(d)."))) == []
    reward = RewardFunction(door({"subject: robot\n": ""}))
    assert said(lambda: reward(Facts.parse("Robot(ego)."))) == []


def test_a_warning_names_the_line_of_the_program(door):
    reward = RewardFunction(door(LONELY))
    with pytest.warns(SilentZeroWarning) as caught:
        reward(Facts.parse(SCENE))
    assert [warning.filename for warning in caught] == [__file__]


ONE_LINE = "warning: 'door': no rule concludes 'out' about the subject 'robot', but about 'door1' ("


def test_a_command_says_it_in_one_line(door, tmp_path):
    door({OUT: "out(door1) :- Near(door1, X), Robot(X)."})
    done = sfol("explain", tmp_path / "door.yaml", "--facts", "Door(door1).")
    assert done.code == 0
    assert done.out.startswith("reward 0")
    assert done.err.startswith(ONE_LINE)
    assert done.err.count("\n") == 1


def test_a_command_says_it_once(door, capsys):
    kb = door({OUT: "out(door1) :- Near(door1, X), Robot(X)."})

    def command():
        for _ in range(2):
            RewardFunction(kb)(Facts.parse("Door(door1)."))

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        run(command)
    assert capsys.readouterr().err.count("warning: ") == 1


def test_other_warnings_of_a_command_stay_as_they_are(capsys):
    before = warnings.showwarning
    with pytest.warns(UserWarning, match="something else"):
        run(lambda: warnings.warn("something else", UserWarning, stacklevel=1))
    assert capsys.readouterr().err == ""
    assert warnings.showwarning is before


def test_nothing_is_said_of_what_is_well(door):
    assert said(lambda: RewardFunction(door())(Facts.parse(SCENE))) == []
    scene = Facts.parse("Pedestrian(p1). OnRoad(p1).")
    assert said(lambda: RewardFunction("aeb")(scene, v=1.0, v_next=1.0, d=1.0)) == []


# -- a whole episode ----------------------------------------------------------------------------

gymnasium = pytest.importorskip("gymnasium")

from sfol.wrappers import RuleReward, VectorRuleReward  # noqa: E402 (it needs gymnasium)


class Hallway(gymnasium.Env):
    """A robot takes three steps; how near the door is, an episode says beforehand."""

    observation_space = gymnasium.spaces.Dict(
        {
            "doors": gymnasium.spaces.Box(-9.0, 9.0, (1, 1), np.float64),
            "keys": gymnasium.spaces.Box(-9.0, 9.0, (1, 1), np.float64),
            "place": gymnasium.spaces.Box(-9.0, 9.0, (), np.float64),
        }
    )
    action_space = gymnasium.spaces.Discrete(1)

    def __init__(self, *distances):
        self.distances = list(distances)

    def observation(self):
        zeros = np.zeros((1, 1))
        return {"doors": zeros + self.distance, "keys": zeros, "place": np.float64(0.0)}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.distance, self.left = self.distances.pop(0), 3
        return self.observation(), {}

    def step(self, action):
        self.left -= 1
        return self.observation(), 0.0, self.left == 0, False, {}


MODES = [{}, {"mode": "add"}, {"mode": "potential", "discount": 0.9},
         {"mode": "potential", "potential": "out", "discount": 0.9}]  # fmt: skip


def drive(env, episodes):
    for _ in range(episodes):
        env.reset(seed=0)
        while not env.step(0)[2]:
            pass


@pytest.mark.parametrize("options", MODES)
def test_an_episode_that_touches_no_rule_is_told_of_at_its_end_and_once(door, options):
    env = RuleReward(Hallway(9.0, 9.0), RewardFunction(door(more=OBSERVED)), **options)
    assert said(env.reset) == []
    assert said(lambda: [env.step(0) for _ in range(2)]) == []
    (text,) = said(lambda: env.step(0))
    assert "no rule has concluded anything about 'robot' in a whole episode" in text
    assert said(lambda: drive(env, 1)) == []


@pytest.mark.parametrize("options", MODES)
def test_nothing_is_told_once_a_rule_was_touched(door, options):
    env = RuleReward(Hallway(0.5, 9.0), RewardFunction(door(more=OBSERVED)), **options)
    assert said(lambda: drive(env, 2)) == []


def test_it_names_the_predicates_of_which_nothing_was_known(door):
    env = RuleReward(Hallway(0.0), RewardFunction(door()), facts=lambda *_: Facts.parse("Door(d)."))
    (text,) = said(lambda: drive(env, 1))
    assert "its last facts say nothing of Near;" in text


def test_rules_that_do_not_exist_are_not_missed(door):
    kb = door({"rules:\n  out: out(X) :- Robot(X), Near(D, X), Door(D).\n": "",
               "weights: {out: {normalizer: 1, coefficients: {out: 1.0}}}\n": "",
               "weight: out": "weight: 1"}, OBSERVED)  # fmt: skip
    assert said(lambda: drive(RuleReward(Hallway(9.0), RewardFunction(kb)), 1)) == []


@pytest.mark.parametrize("options", MODES)
@pytest.mark.parametrize(("distances", "times"), [((9.0, 9.0), 1), ((9.0, 0.5), 0)])
def test_many_environments_are_watched_together(door, options, distances, times):
    envs = gymnasium.vector.SyncVectorEnv(
        [lambda d=d: Hallway(d, 9.0, 9.0, 9.0) for d in distances]
    )
    envs = VectorRuleReward(envs, RewardFunction(door(more=OBSERVED)), **options)
    envs.reset(seed=0)
    assert len(said(lambda: [envs.step(np.zeros(2, int)) for _ in range(9)])) == times

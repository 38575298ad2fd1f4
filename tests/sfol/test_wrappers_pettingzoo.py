"""Parallel environments of PettingZoo, in which each agent is rewarded by rules."""

import numpy as np
import pytest

import sfol
from sfol.errors import UsageError

pytest.importorskip("gymnasium")
pettingzoo = pytest.importorskip("pettingzoo")

from gymnasium.spaces import Box, Discrete  # noqa: E402 (it needs gymnasium)
from pettingzoo.test import parallel_api_test  # noqa: E402 (it needs pettingzoo)

from sfol.wrappers import EPISODE  # noqa: E402 (it needs gymnasium)
from sfol.wrappers.pettingzoo import ParallelRuleReward  # noqa: E402 (it needs pettingzoo)

TEAM = """\
version: 1
name: team
description: Walk on, and keep away from others.
subject: walker
background: [Walker(walker)]
predicates:
  Walker(X): X walks.
  Crowded(X): Somebody is close to X.
rules:
  crowded: crowded(X) :- Walker(X), Crowded(X).
semantics: {conjunction: minimum}
grounding: {margin: 0}
observation:
  place: {fields: [own, nearest]}
facts:
  Crowded(walker): near(place.nearest, place.own, margin=5, value_at_margin=0)
signals:
  gain: {unit: m, from: next.place.own - place.own}
weights:
  crowd: {normalizer: 1, coefficients: {crowded: 1.0}}
terms:
  walk: {weight: 1, formula: gain}
  crowd: {weight: crowd, formula: -2}
"""
CLOSE = """\
version: 1
name: close
subject: walker_0
background: [Walker(walker_0), Walker(walker_1), Walker(walker_2)]
predicates:
  Walker(X): X walks.
  Close(X, Y): X is close behind Y.
rules:
  pushed: pushed(X) :- Walker(X), Walker(Y), Close(Y, X).
semantics: {conjunction: minimum}
grounding: {margin: 0}
signals:
  gain: {unit: m}
weights:
  pushed: {normalizer: 1, coefficients: {pushed: 1.0}}
terms:
  walk: {weight: 1, formula: gain}
  pushed: {weight: pushed, formula: -3}
"""


class Path(pettingzoo.ParallelEnv):
    """Walkers on a line; the first leaves after three steps, and the last joins after two."""

    metadata = {"name": "path_v0", "render_modes": []}  # noqa: RUF012 (as PettingZoo has it)
    possible_agents = ("walker_0", "walker_1", "walker_2")

    def __init__(self):
        self.spaces = {agent: Box(-100, 100, (2,), np.float64) for agent in self.possible_agents}
        self.actions = {agent: Discrete(3, seed=1) for agent in self.possible_agents}

    def observation_space(self, agent):
        return self.spaces[agent]

    def action_space(self, agent):
        return self.actions[agent]

    def reset(self, seed=None, options=None):
        self.time = 0
        self.agents = [*self.possible_agents[:2]]
        self.places = {agent: 2.0 * i for i, agent in enumerate(self.possible_agents)}
        return self.observed(self.agents), {agent: {} for agent in self.agents}

    def step(self, actions):
        self.time += 1
        for agent, action in actions.items():
            self.places[agent] += action
        joined = ["walker_2"] if self.time == 2 else []
        there = [*self.agents, *joined]
        terminated = {agent: agent == "walker_0" and self.time == 3 for agent in there}
        truncated = dict.fromkeys(there, self.time == 6)
        observations = self.observed(there)
        self.agents = [a for a in there if not terminated[a] and not truncated[a]]
        infos = {agent: {"time": self.time} for agent in there}
        return observations, dict.fromkeys(there, 0.25), terminated, truncated, infos

    def observed(self, agents):
        return {a: np.array([self.places[a], self.nearest(a)]) for a in agents}

    def nearest(self, agent):
        own = self.places[agent]
        return min((p for a, p in self.places.items() if a != agent), key=lambda p: abs(p - own))


@pytest.fixture
def team(tmp_path):
    (tmp_path / "team.yaml").write_text(TEAM)
    return sfol.RewardFunction(tmp_path / "team.yaml")


@pytest.fixture
def close(tmp_path):
    (tmp_path / "close.yaml").write_text(CLOSE)
    return sfol.RewardFunction(tmp_path / "close.yaml")


def close_facts(observations, infos, env):
    """Say of all walkers at once who is close behind whom."""
    facts = sfol.Facts(margin=0.0)
    places = env.unwrapped.places
    for back, x in places.items():
        for front, y in places.items():
            if 0 < y - x <= 2:
                facts.add("Close", back, front, confidence=1 - (y - x) / 4)
    return facts


def gain_of(agent, transition):
    assert transition.info.get("agent", agent) == agent
    return {"gain": float(transition.next_observation[0] - transition.observation[0])}


def drive(env, seed):
    """Yield, step by step, what each agent saw before and after, and what it was given."""
    chance = np.random.default_rng(seed)
    observations, _ = env.reset(seed=seed)
    while env.agents:
        actions = {agent: int(chance.integers(3)) for agent in env.agents}
        before = {**observations}
        observations, rewards, _, _, infos = env.step(actions)
        yield before, actions, observations, rewards, infos


@pytest.mark.filterwarnings("error")
def test_it_passes_pettingzoos_own_test(team, close):
    parallel_api_test(ParallelRuleReward(Path(), team), num_cycles=20)
    shared = ParallelRuleReward(Path(), close, facts=close_facts, signals=gain_of)
    parallel_api_test(shared, num_cycles=20)


def test_each_agent_is_rewarded_by_what_it_observes(team):
    env = ParallelRuleReward(Path(), team)
    sums = dict.fromkeys(Path.possible_agents, 0.0)
    lengths = {"walker_0": 3, "walker_1": 6, "walker_2": 4}
    for before, _, after, rewards, infos in drive(env, 3):
        for agent, value in rewards.items():
            assert infos[agent]["original_reward"] == 0.25
            if agent not in before:
                assert value == 0.0
                continue
            crowded = max(1 - abs(before[agent][1] - before[agent][0]) / 5, 0.0)
            terms = {"walk": after[agent][0] - before[agent][0], "crowd": -2 * crowded}
            assert value == pytest.approx(sum(terms.values()), abs=1e-12)
            for name, term in terms.items():
                assert infos[agent][f"reward_{name}"] == pytest.approx(term, abs=1e-12)
            sums[agent] += value
            if EPISODE in infos[agent]:
                assert infos[agent][EPISODE]["return"] == pytest.approx(sums[agent], abs=1e-12)
                assert infos[agent][EPISODE]["length"] == lengths[agent]
    assert all(sums.values())


def test_each_agent_is_the_subject_of_facts_about_all(close):
    env = ParallelRuleReward(Path(), close, facts=close_facts, signals=gain_of)
    pushed = set()
    inner = env.unwrapped
    env.reset()
    places = dict(inner.places)
    for actions in ({"walker_0": 0, "walker_1": 1}, {"walker_0": 2, "walker_1": 0}):
        _, rewards, _, _, infos = env.step(actions)
        for agent, action in actions.items():
            behind = [places[agent] - p for p in places.values() if 0 < places[agent] - p <= 2]
            confidence = max((1 - gap / 4 for gap in behind), default=0.0)
            assert rewards[agent] == pytest.approx(action - 3 * confidence, abs=1e-12)
            assert infos[agent]["confidence_pushed"] == confidence
            pushed.add((agent, confidence > 0))
        places = dict(inner.places)
    assert pushed == {("walker_0", False), ("walker_1", True), ("walker_1", False)}


def test_added_and_shaped(team):
    added = drive(ParallelRuleReward(Path(), team, mode="add"), 5)
    plain = drive(ParallelRuleReward(Path(), team), 5)
    for (before, _, _, more, _), (_, _, _, less, _) in zip(added, plain, strict=True):
        for agent in more:
            expected = less[agent] + 0.25 if agent in before else 0.25
            assert more[agent] == pytest.approx(expected, abs=1e-12)
    shaped = ParallelRuleReward(Path(), team, mode="potential", potential="crowd", discount=0.9)
    for before, _, after, rewards, infos in drive(shaped, 5):
        for agent in before.keys() & rewards.keys():
            phi = [max(1 - abs(o[agent][1] - o[agent][0]) / 5, 0.0) for o in (before, after)]
            alive = not (agent == "walker_0" and infos[agent]["time"] == 3)
            expected = 0.25 + 0.9 * alive * phi[1] - phi[0]
            assert rewards[agent] == pytest.approx(expected, abs=1e-12)


def test_wrong_arguments_are_refused(team, close):
    with pytest.raises(UsageError, match="the environment"):
        ParallelRuleReward(team, team)
    with pytest.raises(UsageError, match="the reward"):
        ParallelRuleReward(Path(), Path())
    with pytest.raises(UsageError, match="does not say how facts are read"):
        ParallelRuleReward(Path(), close)
    named = Path()
    named.possible_agents = ["Walker 1"]
    with pytest.raises(UsageError, match="'Walker 1' is not a constant"):
        ParallelRuleReward(named, close, facts=close_facts, signals=gain_of)


def test_rules_over_time_remember_the_steps_of_each_agent(tmp_path):
    text = TEAM.replace("Crowded(X).\n", "previously(Crowded(X)).\n", 1)
    assert text != TEAM
    path = tmp_path / "team.yaml"
    path.write_text(text)
    env = ParallelRuleReward(Path(), sfol.RewardFunction(path))
    for seed in range(3):
        crowds = {}
        for before, *_, infos in drive(env, seed):
            for agent in before.keys() & infos.keys():
                own, nearest = before[agent]
                now = infos[agent].get("confidence_crowded")
                if now is not None:
                    assert now == pytest.approx(crowds.get(agent, 0.0))
                    crowds[agent] = max(1 - abs(nearest - own) / 5, 0.0)
        assert max(crowds.values()) > 0.0

"""Environments of stable-baselines3 are rewarded as each of them would be."""

import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import sfol

pytest.importorskip("stable_baselines3")
import gymnasium
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.logger import KVWriter, Logger
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecCheckNan,
    VecEnvWrapper,
    VecMonitor,
    VecNormalize,
)

from sfol.sb3 import RuleRewardCallback, VecRuleReward
from sfol.wrappers import EPISODE, FIRED, RuleReward
from tests.sfol import boat

COUNT, STEPS = 4, 60
OF_STEPS = ("way:", "push:", "lost:", "late:", "own:", "ending:")


class Boat(boat.Boat):
    """Seen as stable-baselines3 sees environments: one level deep, and ended in one way."""

    observation_space = gymnasium.spaces.Dict(
        place=gymnasium.spaces.Box(-99, 99, (2,), np.float64), age=gymnasium.spaces.Discrete(100)
    )

    def observed(self):
        return {"place": self.place, "age": self.age}

    def step(self, action):
        observation, reward, lost, late, info = super().step(action)
        return observation, reward, lost, late and not lost, info


@pytest.fixture
def drift(tmp_path):
    def load(facts_at="state", *changes):
        return boat.load(tmp_path, facts_at, ("key: [boat, 0]", "key: place"), *changes)

    return load


def compared(make, reward, given, alone_given=None):
    """Step environments that are rewarded together and alone; return how many episodes ended."""
    together = VecRuleReward(DummyVecEnv([make] * COUNT), reward, **given)
    envs = [RuleReward(make(), reward, **(alone_given or given)) for _ in range(COUNT)]
    alone = DummyVecEnv([lambda env=env: env for env in envs])
    together.report_fired()
    alone.env_method("report_fired")
    for many in (together, alone):
        many.seed(3)
        many.reset()
    chance, episodes = np.random.default_rng(0), 0
    for _ in range(STEPS):
        actions = chance.integers(0, 2, COUNT)
        found, expected = (many.step(actions) for many in (together, alone))
        assert found[1] == pytest.approx(expected[1], rel=1e-6, abs=1e-6)  # DummyVecEnv has float32
        assert found[2].tolist() == expected[2].tolist()
        for own, others in zip(found[3], expected[3], strict=True):
            assert own.keys() == others.keys()
            for key in others.keys() - {"terminal_observation"}:
                assert flat(own[key]) == pytest.approx(flat(others[key]), rel=1e-6, abs=1e-6)
        episodes += found[2].sum()
    return episodes


def flat(value):
    """Return the numbers of one item by name, however they are nested."""
    if isinstance(value, dict):
        return {f"{k}.{n}": v for k, inner in value.items() for n, v in flat(inner).items()}
    return {"": value}


MODES = [{}, {"mode": "add"}, {"mode": "potential", "potential": "far", "discount": 0.9}]


@pytest.mark.parametrize("given", MODES, ids=str)
@pytest.mark.parametrize("facts_at", ["state", "next"])
def test_each_is_rewarded_by_what_really_happened(drift, facts_at, given):
    assert compared(Boat, drift(facts_at), given) > 20


def test_the_reward_of_a_state_as_a_potential(drift):
    lines = [line for line in boat.DRIFT.splitlines(True) if line.strip().startswith(OF_STEPS)]
    reward = drift("state", ("1 + push", "1"), *((line, "") for line in lines))
    assert compared(Boat, reward, {"mode": "potential", "discount": 0.9}) > 20


def facts_of(observation, info):
    """Make facts by a function that also reads what the environment said."""
    facts = sfol.Facts()
    far = min(float(np.hypot(*observation["place"])) / 4, 1.0)
    facts.add("Far", "boat", confidence=far * (0.5 if "begun" in info else 1.0))
    return facts


def signals_of(transition):
    """Make a signal of everything that a transition has."""
    way = transition.next_observation["place"] - transition.observation["place"]
    return {
        "way": float(way[0]) + 0.1 * transition.native + transition.terminated,
        "push": float(transition.action) + 2 * transition.truncated + transition.info["tide"],
    }


class Tide(Boat):
    """A boat whose environment says something of every step."""

    def step(self, action):
        *given, _ = super().step(action)
        return *given, {"tide": 0.1 * self.age}


@pytest.mark.parametrize("facts_at", ["state", "next"])
@pytest.mark.parametrize("given", MODES, ids=str)
def test_functions_make_facts_and_signals(drift, facts_at, given):
    functions = {"facts": facts_of, **({} if "potential" in given else {"signals": signals_of})}
    alone = {**functions, "facts": lambda observation, info, env: facts_of(observation, info)}
    reward = drift(facts_at, ("own: {", "other: {description: x, "), ("+ own", "+ other"))
    assert compared(Tide, reward, {**functions, **given}, {**alone, **given}) > 20


@pytest.mark.parametrize("facts_at", ["state", "next"])
def test_rules_over_time_remember_the_steps_of_each(drift, facts_at):
    reward = drift(facts_at, *boat.OVER_TIME)
    assert compared(Boat, reward, {}) > 20
    assert compared(Boat, reward, {"mode": "add"}) > 20


def test_cartpole_in_processes_of_its_own():
    make = partial(gymnasium.make, "CartPole-v1")
    reward = sfol.RewardFunction("cartpole")
    together = VecRuleReward(SubprocVecEnv([make] * 2, start_method="fork"), reward)
    alone = SubprocVecEnv(
        [lambda: RuleReward(gymnasium.make("CartPole-v1"), reward)] * 2, start_method="fork"
    )
    for many in (together, alone):
        many.seed(0)
        many.reset()
    for step in range(30):
        found, expected = (many.step(np.full(2, int(step % 3 > 0))) for many in (together, alone))
        assert found[1] == pytest.approx(expected[1])
    for many in (together, alone):
        many.close()


def test_a_wrapped_environment_passes_the_checker():
    check_env(RuleReward(gymnasium.make("CartPole-v1"), sfol.RewardFunction("cartpole")))


class Mute(VecEnvWrapper):
    """Environments that do not hand on the last observations."""

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        *given, infos = self.venv.step_wait()
        return *given, [{k: v for k, v in i.items() if k != "terminal_observation"} for i in infos]


def test_last_observations_that_are_not_given_are_asked_for(drift):
    envs = VecRuleReward(Mute(DummyVecEnv([Boat])), drift())
    envs.reset()
    with pytest.raises(sfol.errors.UsageError, match="give no terminal_observation"):
        any(envs.step(np.array([0])) is None for _ in range(20))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"venv": Boat()}, "the environments is of type Boat"),
        ({"reward": "drift"}, "the reward is of type str"),
        ({"facts": 3}, "facts is of type int"),
        ({"mode": "both"}, "there is no mode 'both'"),
        ({"mode": "potential", "discount": 0.9}, "the signal 'way' reads 'next'"),
        (
            {"mode": "potential", "discount": 0.9, "potential": "far", "signals": signals_of},
            "a potential has no signals of a transition",
        ),
    ],
)
def test_what_does_not_fit_is_refused_when_it_is_made(drift, given, message):
    given = {"venv": DummyVecEnv([Boat]), "reward": drift(), **given}
    with pytest.raises(sfol.errors.UsageError, match=message):
        VecRuleReward(given.pop("venv"), given.pop("reward"), **given)


def test_hindsight_is_refused_rather_than_paid_by_the_environments(drift):
    envs = VecRuleReward(DummyVecEnv([Boat]), drift())
    with pytest.raises(sfol.errors.UsageError, match="know nothing of the rules"):
        envs.env_method("compute_reward", [0.0], [1.0], {}, indices=[0])
    assert envs.env_method("get_wrapper_attr", "spec") == [None]


def test_facts_must_be_read_or_made(drift):
    with pytest.raises(sfol.errors.UsageError, match="'aeb' does not say how facts are read"):
        VecRuleReward(DummyVecEnv([Boat]), sfol.RewardFunction("aeb"))


# -- trainings ----------------------------------------------------------------------------------


class Kept(KVWriter):
    """What was logged, dump by dump."""

    def __init__(self):
        self.dumps = []

    def write(self, key_values, key_excluded, step=0):
        self.dumps.append({**key_values, "step": step})

    def close(self):
        pass


def trained(envs, algorithm=PPO, steps=256, **given):
    given = {"n_steps": 64, "batch_size": 64, "n_epochs": 1} if algorithm is PPO else given
    kept = Kept()
    model = algorithm("MultiInputPolicy", envs, **given)
    model.set_logger(Logger(None, [kept]))
    model.learn(steps, callback=RuleRewardCallback(), log_interval=1)
    return model, kept.dumps


class Seen(VecEnvWrapper):
    """Keeps what environments give."""

    def __init__(self, venv):
        super().__init__(venv)
        self.infos = []

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        *given, infos = self.venv.step_wait()
        self.infos.append(infos)
        return *given, infos


def wrapped(kind, reward, **given):
    def make():
        return Monitor(RuleReward(Boat(), reward, **given))

    if kind == "VecRuleReward":
        return VecRuleReward(DummyVecEnv([Boat] * 2), reward, **given)
    if kind == "SubprocVecEnv":
        return SubprocVecEnv([make] * 2, start_method="fork")
    return DummyVecEnv([make] * 2)


KINDS = ["VecRuleReward", "DummyVecEnv", "SubprocVecEnv"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_training_logs_what_the_rules_gave(drift, kind):
    envs = Seen(wrapped(kind, drift()))
    model, dumps = trained(envs)
    envs.close()
    assert model.num_timesteps == 256
    assert [dump["step"] for dump in dumps] == [128, 256]
    for number, dump in enumerate(dumps):
        infos = [i for many in envs.infos[64 * number : 64 * (number + 1)] for i in many]
        sums = [info[EPISODE] for info in infos if EPISODE in info]
        assert len(sums) > 5
        for name in ("return", "original_return", "length"):
            assert dump[f"Episode/{name}"] == mean(s[name] for s in sums)
        for term in ("far", "way", "ending", "age"):
            assert dump[f"Episode_Reward/{term}"] == mean(s["terms"][term] for s in sums)
        assert dump["Confidence/far"] == mean(info["confidence_far"] for info in infos)
        for rule in ("far", "out"):
            assert dump[f"Rule_Coverage/{rule}"] == mean(info[FIRED][rule] for info in infos)
        assert 0.0 < dump["Rule_Coverage/out"] < dump["Rule_Coverage/far"] < 1.0


def mean(values):
    return pytest.approx(np.mean([*values]))


def test_a_training_by_a_potential_is_logged(drift):
    envs = wrapped("VecRuleReward", drift(), mode="potential", potential="far", discount=0.99)
    _, dumps = trained(envs, steps=128)
    assert {"Episode_Reward/far", "Rule_Coverage/out"} <= dumps[0].keys()
    assert "Confidence/far" not in dumps[0]


def test_an_algorithm_that_learns_off_policy_is_logged(drift):
    _, dumps = trained(wrapped("VecRuleReward", drift()), DQN, 200, learning_starts=50)
    first = {dump["step"]: dump for dump in reversed(dumps)}  # two episodes may end in one step
    assert len(first) > 5
    for dump in first.values():
        assert {"Episode_Reward/far", "Confidence/far", "Rule_Coverage/out"} <= dump.keys()


def test_wrappers_of_stable_baselines_may_stand_around_it(drift):
    envs = VecMonitor(VecRuleReward(DummyVecEnv([Boat] * 2), drift()))
    envs = VecNormalize(VecCheckNan(envs, raise_exception=True), norm_obs=False)
    model, (dump,) = trained(envs, steps=128)
    assert dump["Episode/return"] == mean(episode["r"] for episode in model.ep_info_buffer)


def test_only_rewarding_reports_which_rules_fired_while_it_is_logged(drift):
    envs = wrapped("DummyVecEnv", drift())
    trained(envs, steps=128)
    envs.reset()
    assert FIRED not in envs.step(np.zeros(2, dtype=np.int64))[3][0]


def test_environments_without_rules_are_refused(drift):
    with pytest.raises(sfol.errors.UsageError, match="not rewarded by rules"):
        trained(DummyVecEnv([Boat]))


# -- schedules ----------------------------------------------------------------------------------

SCHEDULES = """
schedules:
  weights.far.far: {from: 0, to: 2, over: 512}
  terms.price.price: {from: 1, to: 5, over: 60, by: episodes}
"""
SCHEDULED = (
    ("terms:\n", "terms:\n  price: {weight: 1, formula: -price, parameters: {price: 5}}\n"),
    ("  age: {weight: 1, formula: age}\n", "  age: {weight: 1, formula: age}\n" + SCHEDULES),
)


def continued(model, envs, steps, **given):
    """Train a model further, and return what was logged."""
    kept = Kept()
    model.set_env(envs)
    model.set_logger(Logger(None, [kept]))
    callback = RuleRewardCallback(**given)
    model.learn(steps, callback=callback, log_interval=1, reset_num_timesteps=False)
    return kept.dumps


def scheduled(dumps):
    return [(d["Schedule/weights.far.far"], d["Schedule/terms.price.price"]) for d in dumps]


@pytest.mark.parametrize("kind", KINDS)
def test_schedules_go_on_in_every_environment(drift, kind):
    envs = Seen(wrapped(kind, drift("state", *SCHEDULED)))
    _, dumps = trained(envs, steps=512)
    envs.close()
    assert len(dumps) == 4
    ended = 0
    for number, dump in enumerate(dumps):
        infos = [i for many in envs.infos[64 * number : 64 * (number + 1)] for i in many]
        share, price = 128 * number / 512, 1 + 4 * min(ended / 60, 1)
        assert scheduled([dump]) == [(pytest.approx(2 * share), pytest.approx(price))]
        for info in infos:
            assert info["weight_far"] == pytest.approx(2 * share * info["confidence_far"])
            assert info["reward_price"] == pytest.approx(-price)
        ended += sum(EPISODE in info for info in infos)
    assert ended > 60


@pytest.mark.parametrize("kind", ["VecRuleReward", "SubprocVecEnv"])
def test_a_training_that_is_resumed_goes_on_at_the_right_step(drift, tmp_path, kind):
    envs = [wrapped(kind, drift("state", *SCHEDULED)) for _ in range(2)]
    model, first = trained(envs[0], steps=256)
    model.save(tmp_path / "model.zip")
    again = PPO.load(tmp_path / "model.zip")
    second = continued(again, envs[1], 256)
    third = continued(again, envs[1], 128)
    for many in envs:
        many.close()
    found = scheduled([*first, *second, *third])
    assert [share for share, _ in found] == [0.0, 0.5, 1.0, 1.5, 2.0]
    prices = [price for _, price in found]
    assert prices[0] == 1.0 < prices[1] < prices[2] < 5.0 == prices[4]


def test_a_training_that_begins_anew_has_its_schedules_from_the_beginning(drift):
    model, _ = trained(wrapped("VecRuleReward", drift("state", *SCHEDULED)), steps=256)
    kept = Kept()
    model.set_logger(Logger(None, [kept]))
    model.learn(128, callback=RuleRewardCallback(), log_interval=1)
    assert scheduled(kept.dumps) == [(0.0, 1.0)]


def test_episodes_that_nobody_counted_are_asked_for(drift):
    reward = drift("state", *SCHEDULED)
    envs = wrapped("VecRuleReward", reward)
    model = PPO("MultiInputPolicy", envs, n_steps=64, batch_size=64, n_epochs=1)
    model.learn(128)
    with pytest.raises(sfol.errors.UsageError, match="nobody counted"):
        continued(model, envs, 128)
    dumps = continued(model, envs, 128, episodes=10)
    assert scheduled(dumps) == [(0.5, pytest.approx(1 + 4 * 10 / 60))]


# -- what is missing ----------------------------------------------------------------------------


def test_what_is_missing_is_named():
    code = (
        "import sys; sys.modules['stable_baselines3'] = None\n"
        "from sfol.errors import MissingExtraError\n"
        "try: import sfol.sb3\n"
        "except MissingExtraError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "sfol[sb3]" in done.stdout


def test_long_names_do_not_stop_a_training(drift, capsys):
    names = [f"out_where_nobody_should_ever_be_{n}_{n}" for n in "ab"]
    lines = "\n".join(f"  {name}: far(X) :- Boat(X), Far(X)." for name in names)
    envs = wrapped("VecRuleReward", drift("state", ("rules:\n", f"rules:\n{lines}\n")))
    model = PPO("MultiInputPolicy", envs, n_steps=64, batch_size=64, n_epochs=1, verbose=1)
    model.learn(128, callback=RuleRewardCallback())
    shown = capsys.readouterr().out
    assert "far" in shown
    assert "out_where" not in shown

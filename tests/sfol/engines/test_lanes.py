"""What is repeated from a tape is what an evaluation gives."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sfol
from sfol import arrays, recorded_steps
from sfol.engines import lanes
from sfol.engines.lanes import Recorded
from sfol.engines.tape import NotRecordableError, Tape
from sfol.errors import FactError, FormulaError, SignalError
from sfol.observations.plans import ObservedStep
from tests.sfol.test_many_observations import NEAR, drawn, load, part

SEEDS = st.integers(0, 2**32 - 1)
SEMANTICS = [
    "",
    "semantics: {conjunction: minimum}\n",
    "semantics: {conjunction: product, disjunction: probabilistic_sum}\n",
    "semantics: {conjunction: lukasiewicz, confidence: lower}\n",
    "semantics: {groundings: best, confidence: upper}\n",
    "semantics: {groundings: sum}\n",
    "semantics: {conjunction: product, groundings: probabilistic_sum}\n",
]


def ready(reward, step):
    """Return a reward function that was asked so often that it repeats, one step and many."""
    for _ in range(2):
        reward.repeated_many(step)
        reward.transitions(*step)
        reward.repeated([part_of(whole, 0) for whole in step])
        reward.repeated_many(step, fired=True)
        reward.repeated([part_of(whole, 0) for whole in step], fired=True)
    return reward


def part_of(whole, scene):
    return None if whole is None else part(whole, scene)


def alone(observations):
    """Return a step of which there is nothing but the observations before."""
    return [observations, *[None] * 5]


def without_nan(whole):
    return {**whole, "people": np.nan_to_num(whole["people"])} if isinstance(whole, dict) else whole


def step_of(seed, **given):
    return [*map(without_nan, drawn(seed, **given)), None, None, None]


def named(reward, numbers):
    """Return what is repeated by the names that an outcome has."""
    rest = iter(numbers)
    groups = {"terms": reward.kb.terms, "weights": reward.kb.weights}
    groups["confidences"] = reward.subject_heads
    value = next(rest)
    found = {group: {name: next(rest) for name in names} for group, names in groups.items()}
    assert next(rest, None) is None
    return value, found


def assert_repeated(reward, step):
    """Compare what is repeated, many at once and each alone, with evaluations."""
    assert reward._repeated_outcomes.own_arrays(step, reward._state()) is not None
    found, expected = reward.transitions(*step), reward._evaluated_scenes(ObservedStep(*step))
    value, groups = named(reward, reward.repeated_many(step))
    assert value.tolist() == found.reward.tolist()
    compare_all(found.reward, expected.reward)
    for group, items in groups.items():
        ours, others = getattr(found, group), getattr(expected, group)
        assert [*ours] == [*others] == [*items]
        for name in others:
            compare_all(ours[name], others[name])
            assert np.broadcast_to(items[name], len(value)).tolist() == ours[name].tolist()
    for head, bounds in expected.bounds.items():
        ours, known = found.bounds[head], bounds.known
        assert ours.known.tolist() == known.tolist()
        for end in ("lower", "upper"):
            compare_all(getattr(ours, end)[known], getattr(bounds, end)[known])
    rules = len(reward.kb.rules)
    masks = reward.repeated_many(step, fired=True)[-rules:]
    for scene in range(len(value)):
        wholes = [part_of(whole, scene) for whole in step]
        fired = reward.conclude(reward.observe(wholes[0])).fired
        expected_fired = [rule in fired for rule in reward.kb.rules]
        assert [bool(np.broadcast_to(m, len(value))[scene]) for m in masks] == expected_fired
        assert reward.repeated(wholes, fired=True)[-rules:] == expected_fired
        alone, groups = named(reward, reward.repeated(wholes))
        outcome = reward.transition(*wholes)
        assert alone == pytest.approx(outcome.reward, abs=1e-12)
        for group, items in groups.items():
            assert items == pytest.approx(getattr(outcome, group), abs=1e-12)


def compare_all(found, expected):
    assert found.shape == expected.shape
    assert found.dtype == expected.dtype
    assert found == pytest.approx(expected, abs=1e-12)


@pytest.fixture(scope="module")
def rewards(tmp_path_factory):
    folders = [tmp_path_factory.mktemp("hall") for _ in SEMANTICS]
    return [
        ready(load(folder, {}, semantics), step_of(0))
        for folder, semantics in zip(folders, SEMANTICS, strict=True)
    ]


@settings(max_examples=8)
@given(SEEDS, st.sampled_from(range(len(SEMANTICS))), st.sampled_from([1, 2, 7]))
def test_every_operator_over_entities(rewards, seed, which, size):
    assert_repeated(rewards[which], step_of(seed, size=size))


COUNTS = {
    "crowded(X) :- Robot(X), Person(P), Person(Q), Beside(P, Q), P != Q.": (
        '"crowded(X) :- Robot(X), count(P: Person(P), Beside(P, Q), P != Q) >= 2."'
    ),
    "Robot(X), Person(P), Close(P, X), Ahead(P, X)": (
        "Robot(X), exists(P:Person(P), Close(P, X), not Ahead(P, X))"
    ),
}


FORALLS = {
    "crowded(X) :- Robot(X), Person(P), Person(Q), Beside(P, Q), P != Q.": (
        '"crowded(X) :- Robot(X), forall(P: Person(P), Close(P, X))(Person(Q), Beside(P, Q), '
        'not Ahead(Q, X))."'
    ),
    "Robot(X), Person(P), Close(P, X), Ahead(P, X)": (
        "Robot(X), forall(P:Person(P) >= 0.5)(not Close(P, X))"
    ),
}


def test_foralls(tmp_path):
    reward = ready(load(tmp_path, FORALLS), step_of(0))
    for seed in range(10):
        assert_repeated(reward, step_of(seed, size=7))


MEAN = {
    f"from: 'min(5, {NEAR})'": (
        "from: 'where(sum(1 for P in person) > 0, mean(P.x for P in person), 3)'"
    )
}


def test_a_mean_over_entities(tmp_path):
    reward = ready(load(tmp_path, MEAN), step_of(0))
    for seed in range(10):
        assert_repeated(reward, step_of(seed, size=7))


def test_counts(tmp_path):
    reward = ready(load(tmp_path, COUNTS), step_of(0))
    for seed in range(10):
        assert_repeated(reward, step_of(seed, size=7))


@settings(max_examples=20)
@given(SEEDS, st.sampled_from([0.1, 1.0, 5.0]))
def test_cartpole(seed, spread):
    observations = np.random.default_rng(seed).normal(0, spread, (20, 4)).astype(np.float32)
    reward = ready(sfol.RewardFunction("cartpole"), alone(observations))
    assert_repeated(reward, alone(observations[::-1]))


def test_another_number_counts_at_once():
    observations = np.random.default_rng(0).normal(0, 1, (9, 4))
    step = alone(observations)
    reward = ready(sfol.RewardFunction("cartpole"), step)
    for gain in (3.0, 0.5):
        reward.parameters["balance"]["gain"] = gain
        assert reward.repeated_many(step) is None
        assert_repeated(ready(reward, step), step)
        assert reward.transition(observations).terms["balance"] == pytest.approx(
            gain * reward.transition(observations).weights["balance"]
        )


@pytest.fixture(params=[4096, 4], ids="blocks of {}".format)
def blocks(request, monkeypatch):
    monkeypatch.setattr(recorded_steps, "BLOCK", request.param)


@pytest.mark.parametrize("size", [1, 4, 5, 12])
def test_many_steps_are_repeated_in_blocks(blocks, size):
    step = alone(np.random.default_rng(0).normal(0, 1, (size, 4)))
    assert_repeated(ready(sfol.RewardFunction("cartpole"), step), step)


@pytest.mark.parametrize("scene", [0, 4, 8])
def test_a_block_that_does_not_hold_is_evaluated_with_all_others(blocks, scene):
    good = np.random.default_rng(0).normal(0, 0.1, (9, 4))
    reward = ready(sfol.RewardFunction("cartpole"), alone(good))
    bad = good.copy()
    bad[scene, :2] = (9.0, 1e200)
    assert reward.repeated_many(alone(bad)) is None
    with pytest.raises(FormulaError, match=f"scene {scene}"):
        reward.transition(bad)


def test_a_long_tape_repeats_few_steps(rewards, monkeypatch):
    assert rewards[0].repeated_many(step_of(1, size=7)) is not None
    size = rewards[0]._repeated_many[False]._recording.program.size
    monkeypatch.setattr(recorded_steps, "MOST_NUMBERS", 5 * size)
    assert rewards[0].repeated_many(step_of(1, size=5)) is not None
    assert rewards[0].repeated_many(step_of(1, size=7)) is None
    monkeypatch.setattr(recorded_steps, "BLOCK", 5)
    assert rewards[0].repeated_many(step_of(1, size=7)) is not None


def test_outcomes_are_their_own(blocks):
    step = alone(np.random.default_rng(0).normal(0, 1, (9, 4)))
    reward = ready(sfol.RewardFunction("cartpole"), step)
    first, second = reward.transitions(*step), reward.transitions(*step)
    for values in (*first.terms.values(), *first.weights.values(), first.reward):
        values[:] = 7.0
    assert first.confidences["balanced"].max() <= 1.0
    compare_all(second.reward, reward._evaluated_scenes(ObservedStep(*step)).reward)


def test_what_is_wrong_with_a_later_step_is_said():
    good = np.random.default_rng(0).normal(0, 0.1, (9, 4))
    reward = ready(sfol.RewardFunction("cartpole"), alone(good))
    bad = good.copy()
    bad[4, 2] = np.nan
    with pytest.raises(FactError, match=r"cart\.angle"):
        reward.transition(bad)
    with pytest.raises(FactError, match=r"\(9, 3\)"):
        reward.transition(good[:, :3])
    bad[4, 2] = 0.0
    bad[4, :2] = (9.0, 1e200)
    with pytest.raises(FormulaError, match="scene 4"):
        reward.transition(bad)
    bad[4, :3] = (0.0, np.nan, 0.0)
    with pytest.raises((FactError, SignalError), match=r"cart\.speed"):
        reward.transition(bad)
    bad[4] = (0.0, 0.0, 0.0, np.nan)  # which nothing reads
    assert np.isfinite(reward.transition(bad).reward).all()


@pytest.mark.parametrize("people", [0, 2, 3])
def test_tables_of_other_sizes_are_evaluated(rewards, people):
    step = step_of(1, people=people)
    assert rewards[0].repeated_many(step) is None
    outcome = rewards[0].transition(*step)
    single = [rewards[0].transition(*(part_of(w, i) for w in step)) for i in range(7)]
    assert outcome.reward == pytest.approx([one.reward for one in single])


def test_who_is_absent_may_be_nan(rewards):
    step = [*drawn(5), None, None, None]
    assert rewards[0].repeated_many(step) is None
    assert np.isfinite(rewards[0].transition(*drawn(5)).reward).all()


def test_tensors_are_not_taken_for_constants():
    torch = pytest.importorskip("torch")
    observations = np.random.default_rng(0).normal(0, 0.1, (5, 4))
    reward = sfol.RewardFunction("cartpole")
    coefficient = torch.tensor(2.0, requires_grad=True)
    reward.coefficients["balance"]["balanced"] = coefficient
    for _ in range(4):
        reward.transition(observations).reward.sum().backward()
    assert coefficient.grad > 0.0
    plain = ready(sfol.RewardFunction("cartpole"), alone(observations))
    assert isinstance(plain.transition(torch.as_tensor(observations)).reward, torch.Tensor)


def test_signals_that_are_given_are_not_read_from_a_tape():
    observations = np.random.default_rng(0).normal(2, 0.1, (5, 4))
    reward = ready(sfol.RewardFunction("cartpole"), alone(observations))
    given = reward.transition(observations, speed=np.full(5, 10.0))
    assert given.terms["track"] != pytest.approx(reward.transition(observations).terms["track"])


# -- tapes --------------------------------------------------------------------------------------


def recorded(tape, *numbers):
    return lanes.given(tape, 0, np.array(numbers, dtype=np.float64))


def test_a_question_about_values_is_asked_again():
    tape = Tape()
    x = recorded(tape, 1.0, -2.0)
    y = x[0] + 1.0 if x[1] < 0.0 else x[0]
    program = tape.program([y.ids.item()])
    assert program.of_numbers({0: [5.0, -1.0]}) == [6.0]
    assert program.of_numbers({0: [5.0, 1.0]}) is None
    many = np.array([[1.0, 2.0], [-1.0, -1.0]])
    assert program.of_arrays({0: many})[0].tolist() == [2.0, 3.0]
    many[1, 1] = 1.0
    assert program.of_arrays({0: many}) is None
    assert program.of_numbers({0: [float("nan"), -1.0]}) is None


FINITE = st.floats(-1e300, 1e300) | st.sampled_from([0.0, -0.0, 1.0, np.inf, -np.inf])


@given(FINITE, FINITE, st.sampled_from([0.05, 0.0, 1.0, 2.0, -3.0]))
def test_what_is_left_out_changes_nothing(a, b, constant):
    def computed(x, y, minimum, maximum, where):
        low = maximum(abs(x) / 2.0, 0.0)
        soft = maximum(1.0 - low * constant, 0.0)
        lower, upper = soft - constant * soft, minimum(soft + constant * soft, 1.0)
        holds = (upper > 0.0) & (y >= constant)
        best = where(holds, minimum(1.0, where(upper > 0.0, lower, 0.0)), 0.0)
        both = (0.0 + (0.0 + best)) + 1.0 * (x <= y)
        return [both, minimum(both, 1.0), (best >= 0.0) | (y < x), maximum(x - 0.0, y * 1.0)]

    tape = Tape()
    pair = recorded(tape, 0.3, 0.7)
    results = computed(pair[0], pair[1], arrays.minimum, arrays.maximum, arrays.where)
    program = tape.program([lane.ids.item() for lane in results])
    with np.errstate(all="ignore"):
        expected = computed(np.float64(a), np.float64(b), np.minimum, np.maximum, np.where)
    found = program.of_numbers({0: [a, b]})
    np.testing.assert_array_equal(np.array(found, float), np.array(expected, float))
    many = program.of_arrays({0: np.array([[a, a], [b, b]])})
    for value, single in zip(many, expected, strict=True):
        np.testing.assert_array_equal(np.broadcast_to(value, 2), np.full(2, single))


REALS = FINITE | st.sampled_from([5e-324, -5e-324, 1.7e308, -1.7e308])


@given(REALS, REALS, st.sampled_from([0.0, 1.0, -0.5]))
def test_what_is_left_out_changes_not_even_the_sign_of_a_zero(a, b, constant):
    def computed(x, y, minimum, where):
        low = minimum(abs(x), 1.0)
        holds = y > constant
        truth = 1.0 * holds
        sums = [x + 0.0, 0.0 + x, x - 0.0, x + -0.0, x - -0.0, 0.0 + (0.0 + x), low + 0.0]
        zeros = [0.0 * x, x * 0.0, 0.0 * low, low - 0.0 * low, -0.0 * low, 0.0 * -low]
        halves = [(x + x) / 2.0, (low + low) / 2.0, (x + y) / 2.0, (truth + truth) / 2.0]
        chosen = [
            where(x > 0.0, x, 0.0),
            where(low > 0.0, low, 0.0),
            where((low > 0.0) & holds, minimum(low, truth), 0.0),
            where((truth > 0.0) & (low > 0.0), low * truth, 0.0),
            where((x > 0.0) & holds, x - truth, 0.0),
            where((low > 0.0) & holds, low, -0.0),
        ]
        return [*sums, *zeros, *halves, *chosen]

    tape = Tape()
    pair = recorded(tape, 0.3, 0.7)
    results = computed(pair[0], pair[1], arrays.minimum, arrays.where)
    program = tape.program([lane.ids.item() for lane in results])
    with np.errstate(all="ignore"):
        expected = np.array(computed(np.float64(a), np.float64(b), np.minimum, np.where))
    many = program.of_arrays({0: np.array([[a, a], [b, b]])})
    for found in (program.of_numbers({0: [a, b]}), [np.broadcast_to(v, 2)[1] for v in many]):
        np.testing.assert_array_equal(np.array(found, float), expected)
        np.testing.assert_array_equal(
            np.signbit(np.array(found, float))[~np.isnan(expected)],
            np.signbit(expected)[~np.isnan(expected)],
        )


def test_an_exact_bound_costs_what_a_number_does():
    tape = Tape()
    x = recorded(tape, 0.3)
    low = arrays.minimum(abs(x), 1.0)
    lower, upper = low - 0.0 * low, arrays.minimum(low + 0.0 * low, 1.0)
    middle = 0.0 + arrays.where(upper > 0.0, (lower + upper) / 2.0, 0.0)
    assert middle.ids.tolist() == low.ids.tolist()


def test_what_no_tape_holds_is_refused():
    array = recorded(Tape(), 1.0, 2.0)
    for use in (float, iter, np.asarray, lambda a: a.tolist(), np.linalg.norm):
        with pytest.raises((NotRecordableError, TypeError)):
            use(array)
    assert isinstance(np.ones(2) + array, Recorded)


@pytest.mark.parametrize("gradients", [False, True])
def test_observations_as_tensors_are_evaluated(gradients):
    torch = pytest.importorskip("torch")
    reward = sfol.RewardFunction("cartpole")
    observations = torch.full((5, 4), 0.05, dtype=torch.float64, requires_grad=gradients)
    values = [reward.transition(observations).reward for _ in range(4)]
    assert all(isinstance(value, torch.Tensor) for value in values)
    if gradients:
        values[-1].sum().backward()
        assert observations.grad.abs().sum() > 0.0
    assert reward._repeated_outcomes._asked == 0


def test_a_long_sum_under_a_condition_is_recorded_in_little_time():
    tape = Tape()
    x = recorded(tape, *np.linspace(-1.0, 1.0, 300))
    total = 0.0
    for index in range(300):
        holds = x[index] > 0.0
        total = arrays.where(holds, arrays.where(holds, x[index], 5.0) + total, total)
    program = tape.program([total.ids.item()])
    numbers = np.linspace(1.0, -1.0, 300)
    assert program.of_numbers({0: numbers.tolist()}) == [pytest.approx(numbers[:150].sum())]


def test_a_number_that_is_set_to_itself_changes_nothing():
    step = alone(np.zeros((3, 4)))
    reward = ready(sfol.RewardFunction("cartpole"), step)
    reward.parameters["balance"]["gain"] = float("1.0")
    assert reward.repeated_many(step) is not None

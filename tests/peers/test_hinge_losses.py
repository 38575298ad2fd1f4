"""Losses of probabilistic soft logic as terms: hinges, squared or not, summed over substitutions.

The loss of a ground rule is its weight times its distance to satisfaction, max(0, Σ body − (n − 1)
− head), or the square of that (Bach et al. 2017, Hinge-loss Markov random fields, section 3).
"""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol import Facts, RewardFunction

REWARD = RewardFunction(Path(__file__).with_name("hinges.yaml"))
PEOPLE = ("ann", "bob", "cleo")
PAIRS = tuple(product(PEOPLE, PEOPLE))
RELATIONS = ("Near", "Trusts", "Helps")


def distance(body, head):
    return max(0.0, sum(body) - (len(body) - 1) - head)


def loss(values, x, y):
    """Return the loss of one substitution, by hand."""
    near, trusts, helps = (values[relation, x, y] for relation in RELATIONS)
    symmetric = near - values["Near", y, x]
    return (
        2 * distance([near, trusts], helps) ** 2
        + 0.5 * (distance([helps], values["Helps", y, x]) if x != y else 0)
        + distance([trusts], near) ** 2
        + 0.01 * distance([helps], 0) ** 2
        + 10 * abs(symmetric)
    )


def scene(values, x, y):
    facts = Facts()
    facts.add("First", x)
    facts.add("Second", y)
    for (relation, *pair), value in values.items():
        facts.add(relation, *pair, confidence=value)
    return facts


def test_a_loss_by_hand():
    values = dict.fromkeys(product(RELATIONS, PEOPLE, PEOPLE), 0.0)
    values["Near", "ann", "bob"] = values["Near", "bob", "ann"] = 0.9
    values["Trusts", "ann", "bob"] = 0.8
    values["Helps", "ann", "bob"] = 0.3
    outcome = REWARD.evaluate(scene(values, "ann", "bob"))
    assert outcome.terms == pytest.approx(
        # max(0, 0.9 + 0.8 − 1 − 0.3) = 0.4; max(0, 0.3 − 0) = 0.3; max(0, 0.8 − 0.9) = 0
        {"helpful": -2 * 0.16, "returned": -0.15, "wary": 0, "idle": -0.0009, "symmetric": 0}
    )


shares = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0.0, 1.0))


@given(st.fixed_dictionaries(dict.fromkeys(product(RELATIONS, PEOPLE, PEOPLE), shares)))
def test_the_rewards_of_all_substitutions_are_the_loss(values):
    batch = REWARD.batch([scene(values, x, y) for x, y in PAIRS])
    rewards = REWARD.evaluate(batch).reward
    np.testing.assert_allclose(rewards, [-loss(values, x, y) for x, y in PAIRS], atol=1e-9)

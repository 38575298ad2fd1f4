"""Rewards are the same to the last bit wherever they are computed.

The digest below was made with Python 3.11; the tests of other versions compare with it. Python's
own `sum` would not do: from 3.12 on it compensates its rounding.
"""

import hashlib
import random
from dataclasses import replace

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.knowledge_base.format import Semantics

DIGESTS = {
    "average": "f57b5d169fc0ec1b",
    "product": "57f1c89154c5982b",
    "lukasiewicz": "dec1ad786cebc951",
}


def scene(chance):
    facts = Facts()
    for number in range(chance.randint(0, 6)):
        name = f"p{number}"
        facts.add("Pedestrian", name, confidence=chance.random())
        facts.add(chance.choice(["OnRoad", "OnCrosswalk"]), name)
        facts.add(chance.choice(["CenterOf", "LeftOf", "RightOf"]), name, "ego")
    return facts


@pytest.mark.parametrize("conjunction", DIGESTS)
def test_rewards_are_the_same_in_every_version(conjunction):
    kb = replace(KnowledgeBase.load("aeb"), semantics=Semantics(conjunction=conjunction))
    reward = RewardFunction(kb)
    for weight in reward.coefficients:
        for number, head in enumerate(reward.coefficients[weight]):
            reward.coefficients[weight][head] = 0.1 + number / 3
    chance = random.Random(5)
    digest = hashlib.sha256()
    for _ in range(300):
        signals = {name: 30 * chance.random() for name in ("v", "v_next", "d")}
        digest.update(reward(scene(chance), **signals).hex().encode())
    assert digest.hexdigest()[:16] == DIGESTS[conjunction]

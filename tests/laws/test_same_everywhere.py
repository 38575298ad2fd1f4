"""Rewards are the same to the last bit wherever they are computed.

The digest below was made with Python 3.11; the tests of other versions compare with it. Python's
own `sum` would not do: from 3.12 on it compensates its rounding.
"""

import hashlib
import random

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction

DIGESTS = {
    "average": "749fc969483adf84",
    "product": "e65ec8784bd66960",
    "lukasiewicz": "847efe9aba0a0200",
}
HEADS = range(8)


def knowledge_base(path, conjunction):
    path.write_text(
        "\n".join(
            [
                "version: 1",
                "name: sums",
                "predicates: {P(X): p}",
                "rules:",
                *(f'  r{i}: "h{i}(X) :- P(X), {", ".join(f"P(c{j})" for j in range(i))}."'
                  for i in HEADS if i),
                "signals: {v: {unit: m/s}}",
                f"semantics: {{conjunction: {conjunction}}}",
                "weights: {w: {normalizer: 3, coefficients: {"
                + ", ".join(f"h{i}: {0.1 + i / 3}" for i in HEADS if i) + "}}}",
                "terms:",
                *(f"  t{i}: {{weight: w, formula: -v * {0.1 * i + 0.7}}}" for i in HEADS),
            ]
        )
    )  # fmt: skip
    return KnowledgeBase.load(path)


def scene(chance):
    facts = Facts(margin=0.05)
    for name in ("ego", *(f"c{i}" for i in HEADS)):
        facts.add("P", name, confidence=0.8 + 0.2 * chance.random())
    return facts


@pytest.mark.parametrize("conjunction", DIGESTS)
def test_rewards_are_the_same_in_every_version(tmp_path, conjunction):
    reward = RewardFunction(knowledge_base(tmp_path / "sums.yaml", conjunction))
    chance = random.Random(5)
    digest = hashlib.sha256()
    for _ in range(200):
        digest.update(reward(scene(chance), v=30 * chance.random()).hex().encode())
    assert digest.hexdigest()[:16] == DIGESTS[conjunction]

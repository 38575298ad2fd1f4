"""One knowledge base, asked for the rewards of several subjects."""

import copy
import pickle

import numpy as np
import pytest

import sfol
from sfol.errors import UsageError

CROWD = """\
version: 1
name: crowd
subject: guide
background: [Person(guide)]
predicates:
  Person(X): X is a person.
  Close(X, Y): X is close to Y.
rules:
  pushed: pushed(X) :- Person(X), Person(Y), Close(X, Y), X != Y.
semantics: {conjunction: minimum}
grounding: {margin: 0}
observation:
  people: {fields: [x]}
entities:
  person: {from: people, at_most: 4}
facts:
  Person(P in person): 1.0
  Close(P in person, Q in person): below(abs(P.x - Q.x), 0, margin=4, value_at_margin=0)
signals:
  price: {unit: "1", default: 1.0}
weights:
  pushed: {normalizer: 1, coefficients: {pushed: 1.0}}
terms:
  pushed: {weight: pushed, formula: -k * price, parameters: {k: 2.0}}
"""


@pytest.fixture
def crowd(tmp_path):
    (tmp_path / "crowd.yaml").write_text(CROWD)
    return sfol.RewardFunction(tmp_path / "crowd.yaml")


def test_each_subject_has_its_own_reward(crowd):
    places = np.array([[0.0], [1.0], [4.0]])
    facts = crowd.observe(places)
    assert crowd(facts) == 0.0
    for subject, confidence in (("person1", 0.75), ("person2", 0.75), ("person3", 0.25)):
        other = crowd.for_subject(subject)
        assert other(facts) == other.transition(places).reward == -2.0 * confidence
        assert f"pushed({subject})" in str(other.explain(facts))


def test_many_scenes_of_another_subject(crowd):
    scenes = np.random.default_rng(0).normal(0.0, 2.0, (50, 4, 1))
    other = crowd.for_subject("person2")
    rewards = other.transition(scenes).reward
    distances = np.delete(abs(scenes[:, :, 0] - scenes[:, 1:2, 0]), 1, axis=1).min(axis=1)
    assert rewards == pytest.approx(-2.0 * np.clip(1 - distances / 4, 0, 1), abs=1e-12)
    assert np.ptp(rewards) > 0.5


def test_numbers_are_shared_by_all_subjects(crowd):
    facts = sfol.Facts.parse("Person(person1). Close(person1, guide).")
    other = crowd.for_subject("person1")
    assert other(facts) == -2.0
    crowd.parameters["pushed"]["k"] = 8.0
    other.coefficients["pushed"]["pushed"] = 0.5
    assert other(facts) == -4.0
    assert crowd.coefficients["pushed"]["pushed"] == 0.5


def test_conclusions_are_of_one_subject(crowd):
    facts = sfol.Facts.parse("Person(person1). Close(person1, guide).")
    other = crowd.for_subject("person1")
    for conclusions in (crowd.conclude(facts), pickle.loads(pickle.dumps(crowd.conclude(facts)))):
        assert crowd.evaluate(conclusions).reward == 0.0
        with pytest.raises(UsageError, match="those of 'guide'"):
            other.evaluate(conclusions)
    assert other.evaluate(copy.copy(other.conclude(facts))).reward == -2.0


@pytest.mark.parametrize("subject", ["Person", "", "two words", 3, None])
def test_a_subject_is_a_constant(crowd, subject):
    with pytest.raises(UsageError, match="the subject"):
        crowd.for_subject(subject)

"""First-order formulas with ∃, ∀, ∨, ¬ and →: rules say what the formulas say, on random worlds."""

from itertools import product
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from sfol import Atom, Facts, RewardFunction

REWARD = RewardFunction(Path(__file__).with_name("warehouse.yaml"))
ROBOTS = ("r1", "r2", "r3")
UNARY = ("AtDoor", "InDoor", "Laden", "Slow", "Waits")
ATOMS = [
    *(Atom(predicate, (x,)) for predicate, x in product(UNARY, ROBOTS)),
    *(Atom(predicate, pair) for predicate in ("Near", "Older") for pair in product(ROBOTS, ROBOTS)),
]


def by_the_formulas(world, x):
    """Return what holds of x, by going through all robots."""

    def holds(predicate, *arguments):
        return Atom(predicate, arguments) in world

    must_wait = any(
        (holds("AtDoor", x) and (holds("InDoor", y) or (holds("AtDoor", y) and holds("Older", y, x))))
        or (holds("Near", y, x) and holds("Near", z, x) and y != z and holds("Laden", y) and not holds("Laden", x))
        for y, z in product(ROBOTS, ROBOTS)
    )  # fmt: skip
    calm = all(
        not holds("Near", y, x) or (holds("Slow", y) and not holds("Laden", y)) for y in ROBOTS
    )
    first = not any(holds("Older", y, x) for y in ROBOTS)
    broken = must_wait and not calm and not holds("Waits", x) and not first
    return {
        "must_wait": must_wait,
        "rush": not calm,
        "calm": calm,
        "first": first,
        "broken": broken,
    }


@given(st.sets(st.sampled_from(ATOMS)))
def test_rules_say_what_the_formulas_say(world):
    facts = Facts()
    for robot in ROBOTS:
        facts.add("Robot", robot)
    for atom in world:
        facts.add(atom.predicate, *atom.arguments)
    for robot in ROBOTS:
        outcome = REWARD.for_subject(robot).evaluate(facts)
        expected = by_the_formulas(world, robot)
        assert {head: outcome.derived.get(Atom(head, (robot,))) for head in expected} == {
            head: (1, 1) if holds else None for head, holds in expected.items()
        }
        uneasy = expected["must_wait"] and not expected["calm"]
        assert outcome.reward == -5 * expected["broken"] - uneasy


def test_an_example_by_hand():
    facts = Facts.parse(
        "Robot(r1). Robot(r2). AtDoor(r1). AtDoor(r2). Older(r2, r1). Near(r2, r1). Laden(r2). Slow(r2)."
    )
    # r2 is older, at the same door, near and laden: r1 must wait, has no rest, and drives on.
    outcome = REWARD.evaluate(facts)
    assert outcome.terms == {"broken": -5, "crowd": -1}
    assert outcome.confidences["first"] == 0
    facts.add("Waits", "r1")
    assert REWARD(facts) == -1

"""Programs whose heads depend on themselves, and dense scenes for them, drawn fast and by number.

Hypothesis draws recursion, too, within all else that rules can say; here bodies are short and facts
are many, so that conclusions take several rounds.
"""

import itertools
import random

from sfol import Facts
from tests.differential.programs import program

ARITIES = {"P": 1, "Q": 1, "V": 1, "R": 2, "S": 2, "T": 2, "h": 1, "g": 1, "e": 2}
ENTITIES = ("ego", "a", "b", "c", "d")
CIRCLES = (("h",), ("e",), ("h", "g"), ("g", "e"), ("h", "g", "e"))


def atom(chance, name, names):
    return f"{name}({', '.join(chance.choices(names, k=ARITIES[name]))})"


def body(chance, circle, *, among):
    names = ("X", "Y", "Z")
    literals = [atom(chance, chance.choice("RRSP" if among else "PRS"), names)]
    literals += [atom(chance, chance.choice(circle), names) for _ in range(among)]
    bound = sorted({name for name in names if any(name in text for text in literals)})
    if chance.random() < 0.1:
        literals.append(f"not {atom(chance, chance.choice(('Q', 'T')), bound)}")
    if chance.random() < 0.2 and len(bound) > 1:
        literals.append(f"{bound[0]} != {bound[1]}")
    if chance.random() < 0.1:
        either = (atom(chance, chance.choice(names), bound) for names in ("PRS", circle))
        literals.append(f"({' or '.join(either)})")
    return ", ".join(literals), bound


def rule(chance, head, circle, *, among):
    text, bound = body(chance, circle, among=among)
    entry = {"rule": f"{atom(chance, head, bound)} :- {text}.", "groundings": "best"}
    if chance.random() < 0.3:
        entry["certainty"] = chance.choice([0.5, 0.9, [0.25, 0.75], [0.0, 0.5]])
    if chance.random() < 0.2:
        entry["threshold"] = chance.choice([0.25, 0.5])
    return entry


def scene(chance, density):
    facts = Facts()
    ring = chance.sample(ENTITIES, k=len(ENTITIES))
    for pair in zip(ring, [*ring[1:], ring[0]], strict=True):  # so that there is far to go
        facts.add("R", *pair, bound=(chance.random() / 2 + 0.5, 1.0))
    for name, arity in ARITIES.items():
        for constants in itertools.product(ENTITIES, repeat=arity):
            loop = len(set(constants)) < arity
            if name != "R" and chance.random() < (density / 4 if loop else density):
                ends = [chance.choice([0.0, 0.25, 0.5, chance.random(), 1.0]) for _ in range(2)]
                facts.add(name, *constants, bound=tuple(sorted(ends)))
    return facts


def recursive_scene(number, *, plain=False):
    """Return a knowledge base and facts, the same ones for the same number.

    Args:
        number: of the scene.
        plain: whether nothing is denied or counted, and no rule has a threshold.
    """
    chance = random.Random(number)
    circle = chance.choice(CIRCLES)
    rules = [rule(chance, head, circle, among=chance.choice([1, 1, 2])) for head in circle]
    rules += [rule(chance, chance.choice(circle), circle, among=among) for among in (0, 1)]
    # Heads above it may deny and count what depends on itself.
    first, last = circle[0], circle[-1]
    rules.append(f"V(X) :- P(X), not {first}({'X' if ARITIES[first] == 1 else 'X, _'}).")
    counted = f"{last}({'N' if ARITIES[last] == 1 else 'X, N'})"
    rules.append(f"V(X) :- Q(X), count(N: {counted}) >= 2.")
    if plain:
        rules = [r | {"threshold": 0.0} for r in rules[:-2] if " not " not in r["rule"]]
    chance.shuffle(rules)
    kb = program(*rules, conjunction="minimum")
    return kb, scene(chance, chance.choice([0.1, 0.3, 0.5]))

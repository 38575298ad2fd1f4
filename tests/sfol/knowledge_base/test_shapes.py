"""Every node of a file replaced by something of another shape: located errors, never a traceback."""

import copy
import json

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.errors import InvalidKnowledgeBase, SfolError
from sfol.knowledge_base.loading import bundled_folder, bundled_names
from sfol.strict_yaml import parse

BASE = """\
version: 1
name: base
description: A kitchen.
subject: cook
background: [Person(cook)]
predicates: {Person(X): a person, Pot(X): a pot, Hot(X): hot, "Near(X, Y)": near}
rules:
  care: {rule: "careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X).", description: a, threshold: 0.1}
  calm: calm(X) :- Person(X), not careful(X).
semantics: {conjunction: average, groundings: pooled, disjunction: maximum, confidence: midpoint}
signals: {v: {unit: m/s, description: speed, default: 1.0}}
weights: {care: {normalizer: 1, coefficients: {careful: 1.0, calm: 0.5}, description: w}}
terms: {haste: {weight: care, formula: -k * v, parameters: {k: 2.0}, description: t}}
entity_weights: [{when: "Pot(X), Hot(X)", weight: 1.0, at_least: 0.5}]
grounding: {margin: 0.05, other: {a: 1}}
tests:
  - {name: t, facts: ["Pot(p). Hot(p)."], signals: {v: 1}, expect: {bounds: {careful: null}, reward: 0}}
"""
OVERLAY = """\
version: 1
name: overlay
extends: [base]
remove: {rules: [calm], predicates: [], signals: [], weights: [], terms: []}
predicates: {Pot(Y): a pot}
rules: {care: careful(X) :- Person(X).}
signals: {v: {default: 2.0}}
weights: {care: {coefficients: {careful: 2.0}}}
terms: {haste: {parameters: {k: 3.0}}}
"""
DEEP = [[[[[[[[[[[[1]]]]]]]]]]]]
SHAPES = [
    None,
    True,
    3,
    -1.5e300,
    "",
    "x",
    "Hot(X)",
    [],
    [None],
    {},
    {"x": None},
    [{"a": []}],
    DEEP,
]


def paths(data, above=()):
    yield above
    children = data.items() if isinstance(data, dict) else enumerate(data)
    for key, child in children if isinstance(data, dict | list) else ():
        yield from (
            paths(child, (*above, key)) if isinstance(child, dict | list) else [(*above, key)]
        )


def replaced(data, path, value):
    data = copy.deepcopy(data)
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return data


def mutants(text):
    data = parse(text, "text").data
    return [
        (path, shape, json.dumps(replaced(data, path, shape)))
        for path in paths(data)
        if path
        for shape in SHAPES
    ]


def outcome_of(path):
    """Return the errors of a file; where it has none, it must be good for a reward, too."""
    try:
        kb = KnowledgeBase.load(path)
    except InvalidKnowledgeBase as invalid:
        return invalid.errors
    try:
        RewardFunction(kb)(Facts(), **dict.fromkeys(kb.signals, 1.0))
    except SfolError as error:
        return (error,)
    return ()


@pytest.mark.parametrize("mutated", ["base", "overlay"])
def test_no_shape_is_a_traceback(tmp_path, mutated):
    texts = {"base": BASE, "overlay": OVERLAY}
    for name, text in texts.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    assert not outcome_of(tmp_path / "overlay.yaml")
    refused = 0
    for path, shape, text in mutants(texts[mutated]):
        (tmp_path / f"{mutated}.yaml").write_text(text)
        errors = outcome_of(tmp_path / "overlay.yaml")
        refused += bool(errors)
        assert all(error.place or error.name for error in errors), (path, shape, errors)
    assert refused > 250  # so that the shapes are not harmless


@pytest.mark.long
@pytest.mark.parametrize("name", bundled_names())
def test_no_shape_of_a_bundled_file_is_a_traceback(tmp_path, name):
    path = tmp_path / "mutant.yaml"
    for _, _, text in mutants((bundled_folder() / f"{name}.yaml").read_text()):
        path.write_text(text)
        outcome_of(path)

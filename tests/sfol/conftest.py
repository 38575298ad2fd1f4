"""A small knowledge base to vary, far from driving."""

from pathlib import Path

import pytest

from sfol import KnowledgeBase

KITCHEN = """\
version: 1
name: kitchen
subject: cook
background: [Person(cook)]
predicates:
  Person(X): X is a person.
  Pot(X): X is a pot.
  Hot(X): X is hot.
  Lid(X): X has a lid on.
  Near(X, Y): X is near Y.
rules:
  care: careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X).
semantics: {SEMANTICS}
signals:
  speed: {unit: m/s}
weights:
  care: {normalizer: 1, coefficients: {careful: 1.0}}
terms:
  haste: {weight: care, formula: -k * speed, parameters: {k: 2.0}}
"""


@pytest.fixture
def kitchen(tmp_path):
    """Return a function that loads the kitchen with changes: old text → new text."""

    def load(changes: dict[str, str] | None = None, semantics: str = "") -> KnowledgeBase:
        text = KITCHEN.replace("SEMANTICS", semantics)
        for old, new in (changes or {}).items():
            assert old in text
            text = text.replace(old, new)
        path: Path = tmp_path / "kitchen.yaml"
        path.write_text(text)
        return KnowledgeBase.load(path)

    return load

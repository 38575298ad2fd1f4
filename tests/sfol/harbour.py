"""A small knowledge base whose rules speak of steps that have passed; half a second each."""

import yaml

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.syntax import Atom

HARBOUR = """\
version: 1
name: harbour
subject: pilot
time: {step: 0.5, unit: s}
predicates:
  Near(X): X is near.
  Warned(X): X was warned.
  Behind(X, Y): X is behind Y.
rules:
  said: >
    said(X) :- BODY.
MOREweights:
  said: {normalizer: 1, coefficients: {said: 1}}
terms:
  said: {weight: said, formula: 1}
"""


def harbour_text(body, *, more=""):
    """Return the file: with a body for its rule, and further rules or sections after it."""
    return HARBOUR.replace("BODY", body).replace("MORE", more)


def harbour(body, *, more=""):
    """Return the knowledge base."""
    content = yaml.safe_load(harbour_text(body, more=more))
    return KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))


def course(body, scenes, *, more=""):
    """Return the bound of said(pilot) at each step, None where nothing is concluded."""
    episode = RewardFunction(harbour(body, more=more)).episode()
    found = [episode.conclude(Facts.parse(scene)).derived for scene in scenes]
    bounds = [derived.get(Atom("said", ("pilot",))) for derived in found]
    return [None if bound is None else tuple(bound) for bound in bounds]

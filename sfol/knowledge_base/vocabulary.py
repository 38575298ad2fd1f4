"""Which predicates a knowledge base declares, and which only its rules bring in."""

from __future__ import annotations

from sfol.knowledge_base.model import KnowledgeBase
from sfol.knowledge_base.parts import Predicate


def declared(kb: KnowledgeBase) -> dict[str, Predicate]:
    """Return the predicates that were declared, by name.

    A knowledge base also holds a predicate for every head that was not; such a predicate is
    written like the head of its first rule and described like that rule.
    """
    implied: dict[str, Predicate] = {}
    for rule in kb.rules.values():
        head = rule.clause.head
        implied.setdefault(
            head.predicate, Predicate(head.predicate, head.arguments, rule.description)
        )
    return {
        name: predicate
        for name, predicate in kb.predicates.items()
        if implied.get(name) != predicate or name not in read(kb)
    }


def read(kb: KnowledgeBase) -> set[str]:
    """Return the predicates that something reads: a body, a condition or a weight."""
    bodies = [rule.clause.body for rule in kb.rules.values()]
    bodies += [condition.when for condition in kb.entity_weights]
    heads = {head for weight in kb.weights.values() for head in weight.coefficients}
    return heads.union(*(body.predicates for body in bodies))

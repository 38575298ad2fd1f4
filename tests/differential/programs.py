"""Small programs written in a test, and scenes that were drawn once and for all."""

from functools import cache

from hypothesis import HealthCheck, Phase, given, settings

from sfol import Facts
from sfol.knowledge_base import KnowledgeBase, KnowledgeBaseFile
from sfol.testing.strategies import scenes

PREDICATES = ("P(X)", "Q(X)", "V(X)", "R(X, Y)", "S(X, Y)", "T(X, Y)")


def program(*rules, background=(), **semantics):
    """Return a knowledge base of rules; each is a text, or a dictionary with settings."""
    content = {
        "version": 1,
        "name": "program",
        "background": list(background),
        "predicates": dict.fromkeys([*PREDICATES, "h(X)", "g(X)", "e(X, Y)"], ""),
        "rules": {f"rule{number}": rule for number, rule in enumerate(rules)},
        "semantics": semantics,
        "terms": {"nothing": {"weight": 1, "formula": "0"}},
    }
    return KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))


@cache
def drawn_scenes(count):
    """Return the same scenes on every run."""
    found = []

    @settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(scenes(arities=(1, 2), plain=True, recursive=False))
    def draw(scene):
        found.append(scene)

    draw()
    return tuple(found)


SMALL = tuple(
    (program(*rules, **semantics), Facts.parse(facts, margin=0.05))
    for rules, semantics, facts in [
        (["h(X) :- V(X), P(Y), R(Y, X)."], {}, "V(ego). P(a): 0.2. P(b): 0.8. R(a, ego). R(b, ego)."),
        (["h(X) :- V(X), P(Y), R(Y, X)."], {}, "V(c). V(d). P(a): 0.2. P(b): 0.8. R(a, c). R(b, d)."),
        (["h(X) :- R(Y, X), S(X, Y)."], {}, "R(a, ego). S(ego, b). S(ego, c). R(c, ego): 0.5."),
        (["h(X) :- P(X), R(Y, Z), S(Z, Y)."], {}, "P(ego). R(a, b): 0.4. S(b, a): 0.6. R(c, b). S(b, d)."),
        (["h(X) :- R(Y, X), R(Z, X), Y != Z."], {}, "R(a, ego): 0.4. R(b, ego): 0.6."),
        (["h(X) :- R(Y, X), R(Z, X), Y != Z."], {}, "R(a, ego)."),
        ([{"rule": "h(X) :- P(X), Q(X).", "threshold": 0.5}], {}, "P(ego): [0.5, 0.7]. Q(ego)."),
        ([{"rule": "h(X) :- P(X), not Q(X).", "negation_threshold": 0.25}], {}, "P(ego): [0.2, 0.8]. Q(ego): [0.5, 0.75]."),
        ([{"rule": "h(X) :- P(X), not Q(X).", "negation_threshold": 0.0}], {}, "P(ego): 0.5. Q(ego)."),
        (["h(X) :- P(X), not Q(X)."], {}, "P(ego): [0.2, 0.75]. Q(ego): [0.1, 0.2]."),
        (["h(X) :- P(X), not Q(X)."], {}, "P(ego). Q(ego)."),
        (["h(X) :- P(X).", "h(X) :- Q(X)."], {}, "P(ego): [0.2, 0.9]. Q(ego): [0.4, 0.5]."),
        (["h(X) :- P(X)."], {}, "P(ego): [0.1, 0.2]. h(ego): [0.7, 0.8]."),
        (["V(X) :- P(X).", "h(X) :- V(X), Q(X)."], {}, "P(ego): 0.5. V(ego): [0.2, 0.9]. Q(ego)."),
        (["h(X) :- P(X), R(X, Y)."], {"groundings": "best"}, "P(ego). R(ego, a): [0.1, 0.9]. R(ego, b): [0.4, 0.5]."),
        (["h(X) :- P(Y), R(Y, X)."], {"conjunction": "product"}, "P(a): 0.9. R(a, ego): 0.2. P(b): 0.3. R(b, ego): 0.9."),
        (["h(X) :- P(X), Q(Y)."], {}, "P(ego): [0, 0]. Q(a)."),
        (["h(X) :- P(X)."], {}, "P(ego): [0, 1]."),
        (["e(X, Y) :- R(X, Z), S(Z, Y), P(Z)."], {}, "R(ego, a). S(a, b): 0.5. P(a): 0.4. R(ego, c). S(c, b). P(c)."),
        (["e(X, Y) :- R(Y, X), P(Y)."], {}, "R(a, ego): 0.5. P(a): 0.4. R(ego, c). P(ego)."),
        (["h(X) :- P(X).", {"rule": "h(X) :- R(X, Y), h(Y).", "certainty": [0.5, 1.0]}], {"conjunction": "minimum"},
         "P(c): [0.6, 0.8]. R(ego, a). R(a, b): 0.9. R(b, c): 0.7. R(c, ego). R(b, a)."),
        (["e(X, Y) :- R(X, Y).", "e(X, Z) :- e(X, Y), g(Y), e(Y, Z).", "g(X) :- e(X, Y), P(Y)."], {"conjunction": "minimum"},
         "R(ego, a): 0.9. R(a, b): 0.7. R(b, c). P(b): 0.8. P(c): 0.6."),
    ]
)  # fmt: skip

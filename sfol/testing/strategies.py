"""Hypothesis strategies: knowledge bases, facts that fit them, and overlays that change them.

Example:
    >>> from hypothesis import given
    >>> from sfol.testing import strategies
    >>> @given(strategies.scenes())
    ... def test_mine(scene):
    ...     kb, facts = scene
    ...     assert facts.margin == kb.grounding.margin
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from sfol.clauses import Body, Clause, parse_rule
from sfol.comparisons import SIGNS, Comparison, compared
from sfol.connectives import AND, IMPLIES, OR, Joined, Tree
from sfol.errors import missing_extra
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase, KnowledgeBaseFile
from sfol.literals import Count, ForAll, Literal, Negated, NotEqual, Positive, Quantified
from sfol.operators import BEST, CONFIDENCES, CONJUNCTIONS, DISJUNCTIONS, GATHERINGS, POOLED
from sfol.syntax import ANONYMOUS, Atom, Compared, is_anonymous, variables
from sfol.temporal import (
    MAXIMUM_DEPTH,
    Fell,
    Held,
    Latched,
    Once,
    Previously,
    Rose,
    Since,
    TemporalOperator,
    applied,
)

try:
    from hypothesis import strategies as st
except ImportError as error:
    raise missing_extra("hypothesis", "the strategies need it", extra="testing") from error

# Predicates with their arity. A rule reads only those that stand before its head, or in a circle
# with it; those behind the first four can be asserted, derived or both.
_PREDICATES = {"Calm": 1, "Near": 2, "Raining": 0, "Between": 3, "Loud": 1, "Sees": 2, "Warm": 1,
               "knows": 2, "alarm": 0, "gives": 3, "care": 1, "Linked": 4, "worry": 1}  # fmt: skip
_BASE = 4
_ATTRIBUTES = {"Weight": 1, "Gap": 2}  # with their number of arguments
_LIMITS = (0.0, 1.0, 2.5)
_OPTIONS: Sequence[tuple[tuple[str, float | str], ...]] = (
    (),
    (("margin", 2.0),),
    (("margin", 2.0), ("value_at_margin", 0.5), ("shape", "gaussian")),
    (("margin", 1.5), ("shape", "long_tail")),
    (("margin", 1.5), ("shape", "cosine")),
    (("margin", 0.5), ("value_at_margin", 0.25), ("shape", "hard")),
)
_VALUES = (-1.0, *_LIMITS, 2.0, 4.0)
_some_value = st.floats(-4, 8)
UNREAD = "Unread"  # a predicate that no rule of these knowledge bases reads

ENTITIES = ("ego", "7", '"Ada B."', "bob")
_STRANGER = "zoe"  # rules may name it; facts do not

_VARIABLES = ("X", "Y", "Z")
_COUNTED = ("P", "Q")
_WITHIN = "W"  # stands in the body of a forall alone
_PARAMETERS = (*_VARIABLES, "W")

_Literals = st.SearchStrategy[list[Literal]]


def _mostly(usual: Any, *others: Any) -> st.SearchStrategy[Any]:
    """Return the usual value seven times out of eight."""
    return st.sampled_from([usual] * 7 * len(others) + list(others))


def _bound(pair: tuple[float, float]) -> Bound:
    return Bound(min(pair), max(pair))


# Eighths are exact in binary, so thresholds are often met at their very value.
_eighths = st.integers(0, 8).map(lambda n: n / 8)
_pairs = st.one_of(st.tuples(_eighths, _eighths), st.tuples(st.floats(0, 1), st.floats(0, 1)))


def bounds() -> st.SearchStrategy[Bound]:
    """Bounds: certain, impossible, unknown but named, sharp ones and any others."""
    named = st.sampled_from([Bound(1.0, 1.0), Bound(0.0, 0.0), Bound(0.0, 1.0)])
    return st.one_of(named, _pairs.map(_bound))


def _terms(names: Sequence[str], count: int) -> st.SearchStrategy[tuple[str, ...]]:
    constants = st.sampled_from([*ENTITIES[:3], _STRANGER])
    term = _mostly(st.sampled_from(names), constants).flatmap(lambda chosen: chosen)
    # An atom that names one variable twice is legal and rare.
    apart = st.lists(term, min_size=count, max_size=count, unique=True)
    return _mostly(apart, st.lists(term, min_size=count, max_size=count)).flatmap(
        lambda chosen: chosen.map(tuple)
    )


def _atoms(predicates: Sequence[str], names: Sequence[str] = _VARIABLES) -> st.SearchStrategy[Atom]:
    return st.sampled_from(predicates).flatmap(
        lambda name: _terms(names, _PREDICATES[name]).map(lambda terms: Atom(name, terms))
    )


def _comparisons() -> st.SearchStrategy[Comparison]:
    """Comparisons of a value: every sign and every soft comparison, with and without a margin."""
    limit, options = st.sampled_from(_LIMITS), st.sampled_from(_OPTIONS)
    one = st.tuples(limit)
    crisp = st.builds(Comparison, st.sampled_from(SIGNS), one)
    soft = st.builds(Comparison, st.sampled_from(["below", "above", "near"]), one, options)
    between = st.builds(Comparison, st.just("between"), st.just((0.0, 1.0)), options)
    return st.one_of(crisp, soft, between)


@st.composite
def _compared(draw: st.DrawFn, names: Sequence[str], most: int) -> Atom:
    """Draw what is said of a value, of an attribute with so many arguments at most."""
    attributes = [name for name, arity in _ATTRIBUTES.items() if arity <= most]
    attribute = draw(st.sampled_from(attributes))
    terms = draw(_terms(names, _ATTRIBUTES[attribute]))
    return compared(draw(_comparisons()), Atom(attribute, terms))


@st.composite
def _patterns(draw: st.DrawFn, predicates: Sequence[str], names: Sequence[str]) -> Atom:
    """Draw an atom in which ``_`` may stand, though not often; or what is said of a value."""
    atom = draw(_atoms(predicates, names))
    most = max(_PREDICATES[name] for name in predicates)
    if most and draw(_mostly(False, True)):
        atom = draw(_compared(names, most))
    blank = draw(_mostly((), (0,), (1,), (0, 1), (2,), (0, 2)))
    return Atom(
        atom.predicate,
        tuple(ANONYMOUS if at in blank else term for at, term in enumerate(atom.arguments)),
    )


def _positive(
    readable: Sequence[str], bound: Sequence[str], least: int = 1, most: int = 4
) -> _Literals:
    minimum = _mostly(0.0, 0.125, 0.5, 1.0)
    return st.lists(
        st.builds(Positive, _patterns(readable, bound), minimum), min_size=least, max_size=most
    )


def _negated(readable: Sequence[str], bound: Sequence[str]) -> _Literals:
    return st.lists(_patterns(readable, bound).map(Negated), max_size=2)


def _not_equal(readable: Sequence[str], bound: Sequence[str]) -> _Literals:
    if len(bound) < 2:
        return st.just([])
    different = st.permutations(bound).map(lambda names: [NotEqual(*names[:2])])
    return _mostly(st.just([]), different).flatmap(lambda chosen: chosen)


def _counts(readable: Sequence[str], bound: Sequence[str]) -> _Literals:
    count = _mostly(st.just([]), st.lists(_count(readable, bound), min_size=1, max_size=2))
    return count.flatmap(lambda chosen: chosen)


@st.composite
def _count(draw: st.DrawFn, readable: Sequence[str], bound: Sequence[str]) -> Count:
    """Draw a count of one variable or two, which stand in no other literal."""
    counted, literals = draw(_restricted(readable, bound))
    return Count(counted, counted=literals, minimum=draw(st.integers(1, 3)))


def _foralls(readable: Sequence[str], bound: Sequence[str]) -> _Literals:
    forall = _mostly(st.just([]), _forall(readable, bound).map(lambda drawn: [drawn]))
    return forall.flatmap(lambda chosen: chosen)


@st.composite
def _forall(draw: st.DrawFn, readable: Sequence[str], bound: Sequence[str]) -> ForAll:
    """Draw a forall of one variable or two, whose body may have one of its own."""
    quantified, guard = draw(_restricted(readable, bound))
    names = [*quantified, *bound]
    body: list[Literal] = draw(_positive(readable, [*names, _WITHIN]) | st.just([]))
    inside = variables(*names, *(term for literal in body for term in literal.terms))
    body += draw(_negated(readable, inside))
    body += draw(_not_equal(readable, inside))
    return ForAll(quantified, guard=guard, body=tuple(body or draw(_positive(readable, names))))


@st.composite
def _restricted(
    draw: st.DrawFn, readable: Sequence[str], bound: Sequence[str]
) -> tuple[tuple[str, ...], tuple[Literal, ...]]:
    """Draw one variable or two, and literals that bind them."""
    names = [*_COUNTED, *bound]
    literals: list[Literal] = draw(_positive(readable, names))
    inside = variables(*(term for literal in literals for term in literal.terms))
    counted = [name for name in inside if name in _COUNTED]
    if not counted:
        predicate = draw(st.sampled_from([n for n in readable if _PREDICATES[n] > 0]))
        others = draw(_terms(names, _PREDICATES[predicate] - 1))
        literals.append(Positive(Atom(predicate, (_COUNTED[0], *others))))
        inside = variables(_COUNTED[0], *inside, *others)
        counted = [_COUNTED[0]]
    literals += draw(_negated(readable, inside))
    literals += draw(_not_equal(readable, inside))
    several = draw(st.integers(1, len(counted)))
    return tuple(counted[:several]), tuple(literals)


# Kind of literal → how a body's literals of this kind are drawn, from the predicates that it may
# read and the variables that it may name. Those that bind come first and choose freely.
LITERALS: Mapping[type[Literal], Callable[[Sequence[str], Sequence[str]], _Literals]] = {
    Positive: _positive,
    Negated: _negated,
    NotEqual: _not_equal,
    Count: _counts,
    ForAll: _foralls,
}


@st.composite
def _clauses(
    draw: st.DrawFn,
    head: str,
    names: Sequence[str] = tuple(_PREDICATES),
    *,
    plain: bool = False,
    circle: Sequence[str] = (),
) -> str:
    """Draw the text of a rule for a head: safe, reading only what stands before the head.

    A head of a circle reads what stands before all of the circle, and in positive literals what is
    of the circle. Its bodies are short, so that they hold often, one after the other.
    """
    readable = names[: names.index(circle[0] if head in circle else head)]
    literals = [
        literal
        for kind, drawn in LITERALS.items()
        if kind.binds
        for literal in draw(drawn(readable, _VARIABLES))
    ]
    if head in circle:
        literals = literals[:1] + draw(_positive(circle, _VARIABLES, least=0, most=2))
    bound = variables(*(term for literal in literals for term in literal.terms)) or (ENTITIES[0],)
    arguments = draw(_terms(bound, _PREDICATES[head]))
    short = head in circle and draw(_mostly(True, False))
    for kind, drawn in LITERALS.items():
        if not kind.binds and not short and not (plain and issubclass(kind, Quantified)):
            literals += draw(drawn(readable, bound))
    body = Body(tuple(draw(st.permutations(literals))))
    choice = draw(_choices(readable, bound))
    if choice is None:
        return f"{Clause(Atom(head, arguments), body)}"
    return f"{Atom(head, arguments)} :- {Joined(AND, (*body.literals, choice))}."


@st.composite
def _choices(draw: st.DrawFn, readable: Sequence[str], bound: Sequence[str]) -> Joined | None:
    """Draw what may hold in several ways, though not often."""
    connective = draw(_mostly(None, OR, IMPLIES))
    if connective is None:
        return None

    def side(*, negatable: bool) -> Tree:
        positive = st.builds(
            Positive, _patterns(readable, bound), st.just(0.0) if negatable else _mostly(0.0, 0.5)
        )
        literals = st.one_of(positive, positive, _patterns(readable, bound).map(Negated))
        pair = st.tuples(st.sampled_from([AND, OR]), st.tuples(literals, literals))
        sides: st.SearchStrategy[Tree] = _mostly(literals, pair.map(lambda p: Joined(*p))).flatmap(
            lambda chosen: chosen
        )
        return draw(sides)

    return Joined(connective, (side(negatable=connective == IMPLIES), side(negatable=False)))


@st.composite
def _rules(
    draw: st.DrawFn, names: Sequence[str], *, plain: bool, recursive: bool
) -> dict[str, dict[str, Any]]:
    heads_of = [name for name in names if name in [*_PREDICATES][_BASE:]]
    most = 2 if recursive else 6
    heads = draw(st.lists(st.sampled_from(heads_of), min_size=1, max_size=most))
    circle: Sequence[str] = ()
    if recursive:
        first, length = draw(st.integers(0, len(heads_of) - 1)), draw(st.integers(1, 3))
        circle = heads_of[first : first + length]
        heads += draw(st.lists(st.sampled_from(circle), min_size=2, max_size=4))
    more = () if plain else tuple(GATHERINGS)
    return {
        f"rule{number}": {
            "rule": draw(_clauses(head, names, plain=plain, circle=circle)),
            "threshold": draw(_mostly(0.0, 0.125, 0.5, 1.0)),
            "negation_threshold": draw(_mostly(0.5, 0.0, 0.25, 1.0)),
            "certainty": draw(_mostly(1.0, 0.5, 0.7, (0.0, 0.5), (0.75, 1.0))),
            "groundings": BEST.name if head in circle else draw(_mostly(None, BEST.name, *more)),
        }
        for number, head in enumerate(heads)
    }


def semantics(*, plain: bool = False, recursive: bool = False) -> st.SearchStrategy[dict[str, Any]]:
    """All valid combinations of operators, as the key `semantics` has them.

    Args:
        plain: only those that PyReason has, too.
        recursive: only those with which a head may depend on itself.
    """
    usual = [None, None, BEST.name, BEST.name]
    gathered = usual if plain else [*usual, *GATHERINGS]
    valid = [(name, groundings) for name in CONJUNCTIONS for groundings in gathered]
    valid += [(name, POOLED) for name, c in CONJUNCTIONS.items() if c.pooled]
    if recursive:
        valid = [pair for pair in valid if pair[0] == "minimum"]
    return st.builds(
        lambda pair, disjunction, confidence: {
            "conjunction": pair[0],
            "groundings": pair[1],
            "disjunction": disjunction,
            "confidence": confidence,
        },
        st.sampled_from(valid),
        st.sampled_from(["maximum"] if recursive else [*DISJUNCTIONS]),
        st.sampled_from([*CONFIDENCES]),
    )


def _heads(rules: dict[str, dict[str, Any]]) -> list[str]:
    written = (parse_rule(entry["rule"], _ATTRIBUTES) for entry in rules.values())
    return sorted({rule.head.predicate for rule in written})


def _hinges(heads: Sequence[str]) -> st.SearchStrategy[dict[str, Any]]:
    """Draw terms whose formulas read heads: one, or none."""
    if not heads:
        return st.just({})
    pairs = st.tuples(st.sampled_from(heads), st.sampled_from(heads))
    formulas = pairs.map(lambda pair: f"-max(0, {pair[0]} - {pair[1]} / 2)**2")
    hinges = formulas.map(lambda formula: {"hinge": {"weight": 2.0, "formula": formula}})
    return st.just({}) | hinges


@st.composite
def knowledge_base_files(
    draw: st.DrawFn,
    arities: Sequence[int] = (0, 1, 2, 3, 4),
    *,
    plain: bool = False,
    recursive: bool = False,
) -> KnowledgeBaseFile:
    """Contents of knowledge base files, all valid.

    They have negation, guards, constants of every form, predicates of every number of arguments,
    literals that name a variable twice, `or` and `implies`, several rules per head, certainties,
    derived predicates over several strata that may be asserted as well, thresholds met at their
    very value, and every operator.

    Args:
        draw: given by hypothesis.
        arities: the numbers of arguments that predicates may have.
        plain: whether they have only what PyReason can say: neither sums nor counts nor foralls.
        recursive: whether heads may depend on themselves.
    """
    names = tuple(name for name, arity in _PREDICATES.items() if arity in arities)
    rules = draw(_rules(names, plain=plain, recursive=recursive))
    weighed = [head for head in _heads(rules) if _PREDICATES[head] <= 1]
    coefficient = st.integers(-16, 16).map(lambda n: n / 8)
    weights = {
        "concern": {
            "normalizer": draw(st.sampled_from([1.0, 2.0, 3.0])),
            "coefficients": {head: draw(coefficient) for head in weighed},
        }
    }
    content = {
        "version": 1,
        "name": "drawn",
        "subject": ENTITIES[0],
        "background": draw(st.sampled_from([[], ["Calm(ego)"], ["Calm(ego)", "Near(ego, 7)"]])),
        "predicates": {
            str(Atom(name, _PARAMETERS[: _PREDICATES.get(name, 1)])): ""
            for name in (*names, UNREAD)
        },
        "attributes": {
            str(Atom(name, _PARAMETERS[:arity])): "" for name, arity in _ATTRIBUTES.items()
        },
        "rules": rules,
        "semantics": draw(semantics(plain=plain, recursive=recursive)),
        "signals": {"v": {"unit": "m/s"}, "d": {"unit": "m", "default": float("inf")}},
        "weights": weights,
        "terms": {
            "care": {
                "weight": "concern",
                "formula": "-k * v / (d + 1)",
                "parameters": {"k": draw(coefficient)},
            },
            "haste": {"weight": 0.5, "formula": "v"},
            **draw(_hinges(weighed)),
        },
    }
    return KnowledgeBaseFile.model_validate(content)


def knowledge_bases(
    arities: Sequence[int] = (0, 1, 2, 3, 4), *, plain: bool = False, recursive: bool = False
) -> st.SearchStrategy[KnowledgeBase]:
    """Checked knowledge bases of the files that `knowledge_base_files` draws."""
    return knowledge_base_files(arities, plain=plain, recursive=recursive).map(KnowledgeBase.of)


_STEP = 0.25
_durations = st.integers(1, 12).map(lambda n: n / 8)  # of two of three windows, not whole steps
_operators: st.SearchStrategy[TemporalOperator] = st.one_of(
    st.sampled_from([Previously(), Rose(), Fell()]),
    st.builds(Once, _durations),
    st.builds(Held, _durations),
    st.builds(Latched, st.sampled_from([0.5, 0.75]), st.sampled_from([0.125, 0.5])),
)


@st.composite
def _over_time(
    draw: st.DrawFn, atom: Atom, readable: Sequence[str], depth: int = MAXIMUM_DEPTH
) -> Atom:
    """Draw what up to `depth` operators say of an atom; `readable` may stand beside it."""
    if readable and ANONYMOUS not in atom.arguments and draw(_mostly(False, True)):
        kept = draw(_atoms(readable, variables(*atom.arguments) or (ENTITIES[0],)))
        return applied(Since(), (kept, atom))
    deeper = depth > 1 and draw(_mostly(False, True))
    operand = draw(_over_time(atom, readable, depth - 1)) if deeper else atom
    return applied(draw(_operators), (operand,))


@st.composite
def timed_knowledge_bases(
    draw: st.DrawFn, arities: Sequence[int] = (0, 1, 2, 3, 4)
) -> KnowledgeBase:
    """Checked knowledge bases whose rules speak of the past, with every operator over time.

    Args:
        draw: given by hypothesis.
        arities: the numbers of arguments that predicates may have.
    """
    content = draw(knowledge_base_files(arities)).model_dump(by_alias=True)
    names = [name for name, arity in _PREDICATES.items() if arity in arities]
    for entry in content["rules"].values():
        written = parse_rule(entry["rule"], _ATTRIBUTES)
        if len(written.clauses) > 1:
            continue
        clause = written.clauses[0]
        literals = [draw(_perhaps_over_time(lit, names)) for lit in clause.body.literals]
        entry["rule"] = str(Clause(clause.head, Body(tuple(literals))))
    return KnowledgeBase.of(
        KnowledgeBaseFile.model_validate({**content, "time": {"step": _STEP, "unit": "s"}})
    )


@st.composite
def _perhaps_over_time(draw: st.DrawFn, literal: Literal, names: Sequence[str]) -> Literal:
    if not isinstance(literal, Positive | Negated) or not draw(st.booleans()):
        return literal
    terms = [ANONYMOUS if is_anonymous(term) else term for term in literal.atom.arguments]
    atom = Atom(literal.atom.predicate, tuple(terms))
    compares = isinstance(atom.predicate, Compared)
    before = () if compares else names[: names.index(atom.predicate)]
    return replace(literal, atom=draw(_over_time(atom, before)))


@st.composite
def episodes(
    draw: st.DrawFn, arities: Sequence[int] = (0, 1, 2, 3, 4), max_steps: int = 8
) -> tuple[KnowledgeBase, list[Facts]]:
    """Knowledge bases whose rules speak of the past, each with the facts of some steps."""
    kb = draw(timed_knowledge_bases(arities))
    facts = facts_for(kb, ENTITIES[:2], max_size=12)
    several = draw(st.lists(facts, min_size=1, max_size=3))
    # Scenes that come again let what they say last, or return.
    order = draw(st.lists(st.sampled_from(several), min_size=1, max_size=max_steps))
    return kb, order


@st.composite
def facts_for(
    draw: st.DrawFn,
    kb: KnowledgeBase,
    entities: Sequence[str] = ENTITIES,
    max_size: int = 40,
) -> Facts:
    """Facts that fit a knowledge base.

    Args:
        draw: given by hypothesis.
        kb: the knowledge base; any of its predicates may be asserted, derived ones as well.
        entities: the constants to speak of.
        max_size: the greatest number of atoms that rules read.
    """
    present = entities[: draw(st.sampled_from([1, 2, 2, 3, 3, 3, len(entities)]))]
    atoms = [
        Atom(name, constants)
        for name, predicate in kb.predicates.items()
        for constants in itertools.product(present, repeat=predicate.arity)
        if (name, constants) not in kb.background
    ]
    read = {name for rule in kb.rules.values() for name in rule.clause.body.predicates}
    # Bodies hold only where much of what they read is known: each such atom may well be.
    likely = draw(st.permutations([atom for atom in atoms if atom.predicate in read]))[:max_size]
    maybe = draw(st.lists(st.none() | bounds(), min_size=len(likely), max_size=len(likely)))
    others = draw(st.dictionaries(st.sampled_from(atoms), bounds(), max_size=3))
    facts = Facts(margin=kb.grounding.margin)
    for atom, bound in {**dict(zip(likely, maybe, strict=True)), **others}.items():
        if bound is not None:
            facts.add(atom.predicate, *atom.arguments, bound=bound)
    for name, attribute in kb.attributes.items():
        for constants in itertools.product(present, repeat=attribute.arity):
            value = draw(st.none() | st.sampled_from(_VALUES) | _some_value)
            if value is not None:
                facts.add(name, *constants, value=value)
    return facts


def scenes(
    arities: Sequence[int] = (0, 1, 2, 3, 4), *, plain: bool = False, recursive: bool | None = None
) -> st.SearchStrategy[tuple[KnowledgeBase, Facts]]:
    """Knowledge bases, each with facts that fit it.

    PyReason takes those that are plain, with arities of 1 and 2 alone.

    Args:
        arities: the numbers of arguments that predicates may have.
        plain: whether they have only what PyReason can say.
        recursive: whether heads may depend on themselves; by default in every fourth of them.
    """
    chosen = (
        st.sampled_from([False, False, False, True]) if recursive is None else st.just(recursive)
    )
    bases = chosen.flatmap(lambda r: knowledge_bases(arities, plain=plain, recursive=r))
    return bases.flatmap(lambda kb: st.tuples(st.just(kb), facts_for(kb)))


@st.composite
def overlays(draw: st.DrawFn, base: KnowledgeBaseFile) -> dict[str, Any]:
    """Overlays of a drawn file, as data to be written to a file beside it.

    They drop rules, replace others, add one, and change operators and coefficients.

    Args:
        draw: given by hypothesis.
        base: the file to extend, of `knowledge_base_files`.
    """
    names = list(base.rules)
    removed = draw(st.lists(st.sampled_from(names), unique=True, max_size=len(names) - 1))
    kept = [name for name in names if name not in removed]
    changed = draw(st.lists(st.sampled_from([*kept, "added"]), unique=True, max_size=2))
    # A replaced rule keeps its head, so that weights go on meaning something.
    rules = {name: parse_rule(entry.rule, _ATTRIBUTES) for name, entry in base.rules.items()}
    heads = {name: rule.head.predicate for name, rule in rules.items()}
    return {
        "version": 1,
        "name": "overlay",
        "extends": base.name,
        "remove": {"rules": removed},
        "rules": {name: draw(_clauses(heads.get(name, "care"))) for name in changed},
        "semantics": draw(st.just({}) | semantics()),
    }

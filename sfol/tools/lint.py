"""Finds what is allowed in a knowledge base, but most likely not meant.

Every kind of finding has a code that stays. A comment ``# sfol: ignore SF003`` on the line of a
finding, or alone on the line above, hides it; without a code it hides all. After a colon it may say
why. What is odd in a file that another one extends is found where that file is linted, and not
again.

| code | level | finds |
| --- | --- | --- |
| SF001 | warning | a rule that can never fire |
| SF002 | warning | a body that asks for an atom and for its negation |
| SF003 | warning | a predicate that nothing reads |
| SF004 | warning | a weight that names a head without a rule |
| SF005 | warning | a rule that holds only where another one of the same head does |
| SF006 | info | averages over several groundings, which more facts can lower |
| SF007 | warning | recorded episodes: one term is nearly all of the reward |
| SF008 | warning | recorded episodes: returns are not in the order of their endings |
| SF009 | info | rules that were not compared for SF005, as that takes too long |
| SF010 | warning | a weight that no term uses |
| SF011 | warning | a signal that no formula reads |
| SF012 | warning | recorded episodes: endings that have no place in the order |
| SF013 | warning | a comment that ignores something that is no code |
| SF014 | warning | a test that expects nothing |
| SF015 | warning | a part of the observation, or a sort, that nothing reads |
| SF016 | warning | a predicate that rules read, and neither a fact of the file nor a rule gives |
| SF017 | info | averages over literals, which jump from 0 as soon as all are true at all |
| SF018 | warning | a head that no rule concludes about the subject |
| SF019 | warning | a constant that nothing but one rule names, perhaps meant as a variable |
| SF020 | warning | a rule that no entity fits: its arguments are of different sorts |
| SF021 | warning | a schedule that ends at another number than the file's own |
| SF022 | warning | an operator over time whose duration is shorter than a step |
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Literal as Choice

from sfol.clauses import Body
from sfol.errors import Place
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.knowledge_base.positions import Keys, entries
from sfol.knowledge_base.recursion import components
from sfol.knowledge_base.silence import silences
from sfol.literals import Negated, Positive
from sfol.operators import CONJUNCTIONS, DISJUNCTIONS, POOLED, least
from sfol.reading import text_of
from sfol.syntax import variables
from sfol.temporal import steps_of
from sfol.tools.replay import ReplayedEpisode
from sfol.tools.subsumption import compared

DOMINANT = 0.9

_CODES = frozenset(f"SF{number:03}" for number in range(1, 23))
_CODE_OF = {"subject": "SF018", "constant": "SF019", "sort": "SF020"}
_OF_EPISODES = ("SF007", "SF008", "SF012")
_IGNORE = re.compile(r"#\s*sfol:\s*ignore\b(?P<words>[^:#]*)", re.IGNORECASE)


@dataclass(frozen=True)
class Finding:
    """Something that is most likely not meant.

    Attributes:
        code: such as ``SF001``; it stays the same for ever.
        level: ``warning``, or ``info`` for what one should merely know.
        message: what was found, in one sentence.
        path: the keys of the part of the knowledge base that it is about.
        suggestion: what to do.
        place: where that part stands, if the knowledge base was read from files.
    """

    code: str
    level: Choice["warning", "info"]
    message: str
    path: Keys
    suggestion: str
    place: Place | None = None


def lint(kb: KnowledgeBase) -> tuple[Finding, ...]:
    """Return everything that is odd about a knowledge base itself."""
    checks: Sequence[Callable[[KnowledgeBase], Iterator[Finding]]] = (
        _never_fires,
        _contradicts,
        _unused,
        _without_rule,
        _without_use,
        _expects_nothing,
        _unread,
        _ungiven,
        _ends_elsewhere,
        _looks_nowhere_back,
        _subsumed,
        _not_monotone,
        _jumps,
        _silent,
    )
    return tuple(finding for check in checks for finding in check(kb))


def lint_episodes(
    kb: KnowledgeBase,
    episodes: Sequence[ReplayedEpisode],
    *,
    endings: Sequence[str],
    dominant: float = DOMINANT,
) -> tuple[Finding, ...]:
    """Return what is odd about the rewards of recorded episodes.

    Args:
        kb: the knowledge base that they were replayed under.
        episodes: as `sfol.tools.replay.replay` returns them.
        endings: how episodes end, from the worst to the best. Source: the sanity checks of
            Knox et al., "Reward (Mis)design for Autonomous Driving", arXiv 2104.13906.
        dominant: the share of all reward from which one term is too much.
    """
    return (
        *_dominates(kb, episodes, dominant),
        *_misordered(episodes, endings),
        *_without_place(episodes, endings),
    )


# -- rules --------------------------------------------------------------------------------------


def _never_fires(kb: KnowledgeBase) -> Iterator[Finding]:
    """SF001; a head that nobody declares and whose rules never fire is never known itself."""
    rules_of: dict[str, list[Rule]] = {}
    for rule in kb.rules.values():
        rules_of.setdefault(rule.clause.head.predicate, []).append(rule)
    declared = kb.declared.keys()
    reasons: dict[str, str] = {}
    barren: set[str] = set()
    for component in components(kb.rules.values()):
        # Heads that depend on themselves fire only where some rule does without them.
        waiting = {n for n in component.predicates if n in rules_of and n not in declared}
        while True:
            found = {
                rule.name: why
                for head in component.predicates
                for rule in rules_of.get(head, ())
                if (why := _why_never(rule, barren | waiting))
            }
            firing = {n for n in waiting if any(rule.name not in found for rule in rules_of[n])}
            waiting -= firing
            if not firing or not component.recursive:
                break
        reasons |= found
        barren |= waiting
    for name, rule in kb.rules.items():
        if name in reasons:
            yield Finding(
                "SF001",
                "warning",
                f"the rule {rule.called} can never fire: {reasons[name]}",
                ("rules", rule.entry),
                "correct or remove it",
            )


def _why_never(rule: Rule, barren: Set[str]) -> str | None:
    body = rule.clause.body
    for literal in body.literals:
        if literal.never_holds():
            return f"'{literal}' is never true"
    for literal in _contradictions(body):
        if _excludes(rule, literal):
            return f"{literal} and not {literal.atom} exclude each other at its thresholds"
    needed = (*body.literals, *(lit for whole in body.quantified for lit in whole.needed))
    read = [a.predicate for lit in needed if lit.binds for a in lit.atoms]
    if missing := next((name for name in read if name in barren), None):
        return f"no rule that can fire concludes '{missing}'"
    return None


def _contradicts(kb: KnowledgeBase) -> Iterator[Finding]:
    for rule in kb.rules.values():
        for literal in _contradictions(rule.clause.body):
            if not _excludes(rule, literal):
                most = 1.0 - rule.negation_threshold
                yield Finding(
                    "SF002",
                    "warning",
                    f"the rule {rule.called} asks for {literal} and for not {literal.atom}: "
                    f"it holds only while the upper bound is at most {most:g}",
                    ("rules", rule.entry),
                    "remove one of the two literals",
                )


def _contradictions(body: Body) -> list[Positive]:
    negated = {lit.atom for lit in body.atom_literals if isinstance(lit, Negated)}
    positive = (lit for lit in body.atom_literals if isinstance(lit, Positive))
    return [literal for literal in positive if literal.atom in negated]


def _excludes(rule: Rule, literal: Positive) -> bool:
    """Tell whether no bound meets both thresholds: l ≥ threshold, 1 − u ≥ negation threshold."""
    most = 1.0 - least(rule.negation_threshold)
    return rule.negation_threshold >= 1.0 or least(literal.threshold(rule)) > most


def _unused(kb: KnowledgeBase) -> Iterator[Finding]:
    used = kb.read | kb.weighed
    compared = {comparison.attribute for comparison in kb.comparisons}
    unused = [("predicate", name) for name in kb.declared if name not in used]
    unused += [("attribute", name) for name in kb.attributes if name not in compared]
    for what, name in unused:
        yield Finding(
            "SF003",
            "warning",
            f"nothing reads the {what} '{name}'",
            (f"{what}s", name),
            "remove it, or use it in a rule",
        )


def _without_rule(kb: KnowledgeBase) -> Iterator[Finding]:
    heads = {*kb.heads}
    for name, weight in kb.weights.items():
        for head in weight.coefficients:
            if head not in heads:
                yield Finding(
                    "SF004",
                    "warning",
                    f"the weight '{name}' names '{head}', which no rule concludes: it adds 0",
                    ("weights", name, "coefficients", head),
                    "fine in an ablation; otherwise remove the coefficient or add a rule",
                )
    for name, term in kb.terms.items():
        for head in term.heads:
            if head not in heads:
                yield Finding(
                    "SF004",
                    "warning",
                    f"the formula of '{name}' reads '{head}', which no rule concludes: it is 0",
                    ("terms", name, "formula"),
                    "fine in an ablation; otherwise leave the head out or add a rule",
                )


def _without_use(kb: KnowledgeBase) -> Iterator[Finding]:
    """SF010 and SF011."""
    weights = {term.weight for term in kb.terms.values()}
    signals = {name for term in kb.terms.values() for name in term.formula.names}
    for code, section, names, used, user in (
        ("SF010", "weights", kb.weights, weights, "no term uses the weight"),
        ("SF011", "signals", kb.signals, signals, "no formula reads the signal"),
    ):
        for name in names:
            if name not in used:
                yield Finding(
                    code, "warning", f"{user} '{name}'", (section, name), "remove it, or use it"
                )


def _expects_nothing(kb: KnowledgeBase) -> Iterator[Finding]:
    for index, case in enumerate(kb.tests):
        expected = (case.expect, *(step.expect for step in case.steps))
        if not any(expect.model_fields_set for expect in expected):
            yield Finding(
                "SF014",
                "warning",
                f"the test '{case.name}' expects nothing, so that it can hardly fail",
                ("tests", index),
                "name a bound, a confidence, a weight, a term or the reward that must come out",
            )


def _unread(kb: KnowledgeBase) -> Iterator[Finding]:
    formulas = [*(fact.formula for fact in kb.facts), *kb.observed_signals.values()]
    sorts = {sort for fact in kb.facts for sort in fact.sorts.values()}
    sorts |= {part for f in formulas for r in f.ranges for part in r.sort.split(".")}
    parts = {part for f in formulas for name in f.names for part in name.split(".")[:2]}
    parts |= {table for sort in kb.entities.values() for table in sort.tables}
    for section, names, used, what in (
        ("observation", kb.observation, parts, "no fact, signal or sort reads the part"),
        ("entities", kb.entities, sorts, "no fact or signal is about the entities of"),
    ):
        for name in names:
            if name not in used:
                yield Finding(
                    "SF015", "warning", f"{what} '{name}'", (section, name), "remove it, or use it"
                )


def _ungiven(kb: KnowledgeBase) -> Iterator[Finding]:
    given = {fact.atom.predicate for fact in kb.facts}
    given |= {atom.predicate for atom in kb.background} | {*kb.heads}
    compared = {comparison.attribute for comparison in kb.comparisons}
    in_bodies = kb.read
    read = [("predicate", name) for name in kb.declared if name in in_bodies]
    read += [("attribute", name) for name in kb.attributes if name in compared]
    for what, name in read if kb.facts else ():
        if name not in given:
            yield Finding(
                "SF016",
                "warning",
                f"rules read the {what} '{name}', of which nothing is known: no fact gives it",
                (f"{what}s", name),
                "add it to facts",
            )


def _ends_elsewhere(kb: KnowledgeBase) -> Iterator[Finding]:
    for target, scheduled in kb.schedules.items():
        own = kb.number(scheduled)
        if own != scheduled.end:
            yield Finding(
                "SF021",
                "warning",
                f"the schedule of '{target}' ends at {scheduled.end:g}, but wherever nobody is "
                f"trained, in tests and explanations, it is {own:g}",
                ("schedules", target),
                f"let it end at {own:g}, or change the number",
            )


def _looks_nowhere_back(kb: KnowledgeBase) -> Iterator[Finding]:
    bodies: list[tuple[Keys, Body]] = [
        (("rules", rule.entry), rule.clause.body) for rule in kb.rules.values()
    ]
    bodies += [(("entity_weights",), condition.when) for condition in kb.entity_weights]
    length = kb.time.step if kb.time else 0.0
    for path, body in bodies:
        for operator in (predicate.operator for predicate in body.timed):
            if operator.duration is not None and not steps_of(operator.duration, length):
                yield Finding(
                    "SF022",
                    "warning",
                    f"'{operator.name}' looks back {operator.duration:g}, less than a step of "
                    f"{length:g}: it says what is so now",
                    path,
                    f"leave it out, or look further back: {operator.name}[{length:g}]",
                )


def _subsumed(kb: KnowledgeBase) -> Iterator[Finding]:
    """SF005, and SF009 for what was not looked at."""
    comparison = compared(kb.rules.values())
    for general, special in comparison.covered:
        yield _subsumption(kb, general, special)
    pairs = [f"'{a.name}' with '{b.name}'" for a, b in comparison.undecided]
    pairs += [f"'{rule.name}' with those after it" for rule in comparison.rest]
    if pairs:
        yield Finding(
            "SF009",
            "info",
            f"rules were not compared, as that takes too long: {_listed(pairs)}",
            ("rules",),
            "shorter bodies, and fewer rules of one head, are compared faster",
        )


def _listed(texts: Sequence[str], most: int = 3) -> str:
    more = [f"and {len(texts) - most} more"] if len(texts) > most else []
    return ", ".join([*texts[:most], *more])


def _subsumption(kb: KnowledgeBase, general: Rule, special: Rule) -> Finding:
    effect = (
        "it can only raise the average"
        if CONJUNCTIONS[kb.semantics.conjunction].can_grow
        else "it changes nothing"
        if DISJUNCTIONS[kb.semantics.disjunction].is_idempotent
        else "it counts twice"
    )
    return Finding(
        "SF005",
        "warning",
        f"the rule {special.called} holds only where {general.called} does: {effect}",
        ("rules", special.entry),
        "remove one of the two rules",
    )


def _not_monotone(kb: KnowledgeBase) -> Iterator[Finding]:
    several = dict.fromkeys(
        rule.entry
        for rule in kb.rules.values()
        if kb.gathers(rule) == POOLED
        and set(variables(*rule.clause.body.terms)) - set(rule.clause.head.arguments)
    )
    if several:
        yield Finding(
            "SF006",
            "info",
            f"{', '.join(several)}: the average over several groundings is not monotone; "
            "a further, less certain entity can lower a confidence",
            ("semantics",),
            "groundings: best is monotone; the paper's rules mean pooled",
        )


def _jumps(kb: KnowledgeBase) -> Iterator[Finding]:
    """SF017; a body begins to hold with what all its literals but one are worth."""
    conjunction = CONJUNCTIONS[kb.semantics.conjunction]
    jumps = {}
    for rule in kb.rules.values():
        quantified = rule.clause.body.quantified
        literals = (*rule.clause.body.atom_literals, *quantified)
        least_bounds = [lit.threshold(rule) for lit in literals if isinstance(lit, Positive)]
        least_bounds += [rule.threshold for literal in quantified if literal.monotone]
        if len(literals) > 1 and 0.0 in least_bounds:
            jumps[rule.name] = conjunction.combine([*(1.0 for _ in literals[1:]), 0.0])
    if conjunction.can_grow and jumps:
        highest = max(jumps, key=lambda name: jumps[name])
        yield Finding(
            "SF017",
            "info",
            f"{_listed([*jumps])}: averages jump: '{highest}' goes from 0 to "
            f"{jumps[highest]:.2g} as soon as the last of its literals is true at all",
            ("semantics",),
            "conjunction: minimum has no such step; the paper's rules mean average",
        )


def _silent(kb: KnowledgeBase) -> Iterator[Finding]:
    for silence in silences(kb):
        code = _CODE_OF[silence.cause]
        yield Finding(code, "warning", silence.message, silence.path, silence.suggestion)


# -- recorded episodes --------------------------------------------------------------------------


def _dominates(
    kb: KnowledgeBase, episodes: Sequence[ReplayedEpisode], dominant: float
) -> Iterator[Finding]:
    outcomes = [outcome for episode in episodes for outcome in episode.outcomes]
    sizes = {name: sum(abs(outcome.terms[name]) for outcome in outcomes) for name in kb.terms}
    total = sum(sizes.values())
    for name, size in sizes.items():
        if len(sizes) > 1 and total and size / total > dominant:
            yield Finding(
                "SF007",
                "warning",
                f"the term '{name}' is {size / total:.1%} of all reward in {len(episodes)} "
                "recorded episodes: the others hardly count",
                ("terms", name),
                "compare the parameters of the terms",
            )


def _misordered(episodes: Sequence[ReplayedEpisode], endings: Sequence[str]) -> Iterator[Finding]:
    returns = {
        ending: values
        for ending in endings
        if (values := [e.value for e in episodes if e.episode.ending == ending])
    }
    for worse, better in pairwise(returns):
        low, high = fmean(returns[worse]), fmean(returns[better])
        if low >= high:
            yield Finding(
                "SF008",
                "warning",
                f"episodes that end with '{worse}' return {low:.4g} on average "
                f"({len(returns[worse])} episodes), those with '{better}' only {high:.4g} "
                f"({len(returns[better])} episodes)",
                ("terms",),
                f"an agent would learn to prefer '{worse}'",
            )


def _without_place(
    episodes: Sequence[ReplayedEpisode], endings: Sequence[str]
) -> Iterator[Finding]:
    """SF012; who names endings that occur, all of them, has left the others out on purpose."""
    found = {e.episode.ending for e in episodes if e.episode.ending is not None}
    if found <= {*endings} or {*endings} <= found:
        return
    left_out = _listed([f"'{ending}'" for ending in sorted(found - {*endings})])
    yield Finding(
        "SF012",
        "warning",
        f"episodes end with {left_out}, which has no place in '{' < '.join(endings)}': "
        "their returns were not compared",
        ("terms",),
        "name the endings, from the worst to the best, with --endings",
    )


# -- places -------------------------------------------------------------------------------------


def located(kb: KnowledgeBase, findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings with their places, without those that a comment hides.

    Nor are those returned that stand in an inherited file, unless they are about episodes. What is
    odd about the comments themselves is added.

    Args:
        kb: what they were found in; its files are read again.
        findings: from `lint` and `lint_episodes`.
    """
    texts = {file: text_of(Path(file)) for file in kb.files}
    places = _places(texts)
    hidden = {(file, n): codes for file, text in texts.items() for n, codes in _ignores(text)}
    placed = [replace(finding, place=_place(finding, places)) for finding in findings]
    own = [
        f for f in placed if f.code in _OF_EPISODES or not f.place or f.place.file in kb.files[-1:]
    ]
    own += [finding for file in kb.files[-1:] for finding in _strange_comments(file, texts[file])]
    shown = [finding for finding in own if not _is_hidden(finding, hidden)]
    return tuple(sorted(shown, key=lambda f: (f.place or Place(""), f.code)))


def _places(texts: Mapping[str, str]) -> dict[Keys, Place]:
    """Return where each path of keys stands; later files change what earlier ones said."""
    places: dict[Keys, Place] = {}
    for file, text in texts.items():
        # What a file removes is its own affair.
        places = {path: place for path, place in places.items() if path[0] != "remove"}
        for entry in entries(text):
            mark = entry.key.start_mark
            path = _normal(entry.path)
            places[path] = Place(file, mark.line + 1, mark.column + 1)
    return places


def _normal(path: Keys) -> Keys:
    if path[0] not in ("predicates", "attributes") or len(path) < 2:
        return path
    return (path[0], str(path[1]).partition("(")[0].strip())


def _place(finding: Finding, places: Mapping[Keys, Place]) -> Place | None:
    # A head is without a rule because this file removed it, most likely.
    paths: list[Keys] = [("remove", "rules")] if finding.code == "SF004" else []
    whole = finding.path
    paths += [whole[:length] for length in range(len(whole), 0, -1)]
    return next((places[path] for path in paths if path in places), None)


def _ignores(text: str) -> Iterator[tuple[int, frozenset[str]]]:
    """Yield the number of each line on which codes are ignored; no code means all."""
    for number, comment in _comments(text):
        words = _words(comment)
        if words and not words & _CODES:
            continue
        yield number, words & _CODES
        if comment.string.lstrip().startswith("#"):
            yield number + 1, words & _CODES


def _strange_comments(file: str, text: str) -> Iterator[Finding]:
    for number, comment in _comments(text):
        strange = sorted(_words(comment) - _CODES)
        if strange:
            yield Finding(
                "SF013",
                "warning",
                f"the comment ignores '{strange[0]}', which is no code",
                (),
                "a reason stands after a colon: # sfol: ignore SF003: others read it",
                Place(file, number, comment.start() + 1),
            )


def _comments(text: str) -> Iterator[tuple[int, re.Match[str]]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if comment := _IGNORE.search(line):
            yield number, comment


def _words(comment: re.Match[str]) -> frozenset[str]:
    return frozenset(comment["words"].upper().replace(",", " ").split())


def _is_hidden(finding: Finding, hidden: Mapping[tuple[str, int], frozenset[str]]) -> bool:
    if finding.place is None or finding.place.line is None:
        return False
    codes = hidden.get((finding.place.file, finding.place.line))
    return codes is not None and (not codes or finding.code in codes)

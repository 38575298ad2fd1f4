"""From the models of a file to a checked knowledge base: every name must mean something.

All errors are collected, so that one run shows everything that is wrong.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Set
from typing import Literal

from sfol.clauses import Body, parse_conditions, parse_rule
from sfol.errors import InvalidKnowledgeBase, closest, did_you_mean
from sfol.facts import TRUE, Bound, Facts
from sfol.formula import Formula, can_be_read, check_formula_name
from sfol.knowledge_base.format import (
    Case,
    CaseStep,
    EntityWeight,
    KnowledgeBaseFile,
    RuleEntry,
    Term,
)
from sfol.knowledge_base.observing import STEP, ObservationChecker
from sfol.knowledge_base.parts import (
    Attribute,
    EntityCondition,
    ObservedFact,
    Parts,
    Predicate,
    RewardTerm,
    Rule,
)
from sfol.knowledge_base.recursion import check_recursion
from sfol.knowledge_base.reporting import Path, PlaceOf, Reporter
from sfol.knowledge_base.schedules import checked_schedules
from sfol.operators import CONJUNCTIONS, POOLED
from sfol.syntax import (
    Atom,
    Compared,
    is_constant,
    parse_ground_atom,
    parse_signature,
    variables,
)


def check(
    file: KnowledgeBaseFile,
    *,
    place_of: PlaceOf = lambda path, offset: None,
    files: tuple[str, ...] = (),
    removed_heads: Iterable[str] = (),
) -> Parts:
    """Return the parts of the knowledge base that a file describes.

    Args:
        file: the merged content of all files of a chain.
        place_of: where a path of keys stands, for error messages.
        files: the files that it was made from.
        removed_heads: heads that lost all their rules to an overlay; weights may name them.

    Raises:
        InvalidKnowledgeBase: with every error found.
    """
    return _Checker(file, place_of, frozenset(removed_heads)).parts(files)


class _Checker:
    """Collects errors while it parses a file part by part."""

    def __init__(
        self, file: KnowledgeBaseFile, place_of: PlaceOf, removed_heads: frozenset[str]
    ) -> None:
        self._file = file
        self._reporter = Reporter(place_of)
        self._removed_heads = removed_heads
        self._heads: set[str] = set()  # of the rules that could be read
        self._attributes: dict[str, Attribute] = {}

    def parts(self, files: tuple[str, ...]) -> Parts:
        file = self._file
        self._check_subject()
        declared = self._predicates()
        self._attributes = self._declared_attributes(declared)
        rules = self._rules()
        predicates = self._with_heads(declared, rules)
        conditions = self._entity_conditions()
        background = self._background(predicates)
        self._heads = {rule.clause.head.predicate for rule in rules.values()}
        for rule in rules.values():
            self._check_rule(rule, predicates)
        entries = Counter(index for index, _ in conditions)
        for index, condition in conditions:
            path = ("entity_weights", index, "when")
            self._check_body(path, condition.when, predicates, ("X",), part=entries[index] > 1)
            for literal in condition.when.quantified:
                self._reporter.report(
                    path,
                    f"a condition can't have a count or a forall: '{literal}'",
                    str(literal),
                    "let a rule conclude it, and name the head of that rule here",
                )
        terms = self._terms(rules)
        self._check_heads_are_used(declared, rules, [c for _, c in conditions], terms.values())
        check_recursion(rules, file.semantics, self._reporter)
        self._check_semantics()
        self._check_signals()
        self._check_time(rules, conditions)
        observation = ObservationChecker(file, self._reporter)
        observation.check({file.subject}.union(*(atom.arguments for atom in background)))
        self._check_weights(rules)
        schedules = checked_schedules(file, self._reporter)
        facts = observation.facts(background, self._heads - declared.keys())
        for fact in facts:
            self._check_observed_fact(fact, predicates)
        observed_signals = observation.signals()
        for index, case in enumerate(file.tests):
            self._check_case(index, case, predicates)
        if self._reporter.errors:
            raise InvalidKnowledgeBase(self._reporter.errors)
        return Parts(
            name=file.name,
            description=file.description,
            subject=file.subject,
            background=background,
            predicates=predicates,
            attributes=self._attributes,
            rules=rules,
            semantics=file.semantics,
            signals=file.signals,
            weights=file.weights,
            terms=terms,
            schedules=schedules,
            entity_weights=tuple(condition for _, condition in conditions),
            grounding=file.grounding,
            observation=file.observation,
            entities=file.entities,
            facts=facts,
            facts_at=file.facts_at,
            time=file.time,
            observed_signals=observed_signals,
            tests=tuple(file.tests),
            files=files,
            version=file.version,
        )

    # -- parsing ------------------------------------------------------------------------------

    def _check_subject(self) -> None:
        subject = self._file.subject
        if not is_constant(subject):
            self._reporter.report(
                ("subject",), f"the subject '{subject}' is not a constant", subject,
                "a constant begins with a lower-case letter, or stands in quotes: '\"Mary\"'",
            )  # fmt: skip

    def _predicates(self) -> dict[str, Predicate]:
        found: dict[str, Predicate] = {}
        for name, parameters, path, description in self._signatures("predicates"):
            if name in found:
                self._reporter.report(path, f"the predicate '{name}' is declared twice", name)
            found[name] = Predicate(name, parameters, description)
        return found

    def _declared_attributes(self, predicates: Mapping[str, Predicate]) -> dict[str, Attribute]:
        found: dict[str, Attribute] = {}
        for name, parameters, path, description in self._signatures("attributes"):
            if name in found:
                self._reporter.report(path, f"the attribute '{name}' is declared twice", name)
            elif name in predicates:
                self._reporter.report(
                    path,
                    f"'{name}' is a predicate and an attribute",
                    name,
                    "rename one of them: an atom is more or less true, an attribute has a value",
                )
            found[name] = Attribute(name, parameters, description)
        return found

    def _signatures(
        self, section: Literal["predicates", "attributes"]
    ) -> Iterator[tuple[str, tuple[str, ...], Path, str]]:
        """Yield the names that a section declares, with parameters, place and description."""
        for key, description in getattr(self._file, section).items():
            path = (section, key)
            signature = self._reporter.parsed(path, parse_signature, key)
            if signature is None:
                self._reporter.unread.update(_first_name(key))
            else:
                yield (*signature, path, description)

    def _rules(self) -> dict[str, Rule]:
        found: dict[str, Rule] = {}
        for name, entry in self._file.rules.items():
            for rule in self._rules_of(name, entry):
                if rule.name != name and rule.name in self._file.rules:
                    self._reporter.report(
                        ("rules", rule.name),
                        f"'{rule.name}' is what a part of the rule '{name}' is called",
                        rule.name,
                        "rename one of the two rules",
                    )
                found[rule.name] = rule
        return found

    def _rules_of(self, name: str, entry: RuleEntry) -> Iterator[Rule]:
        """Yield an entry's rule, or one for each way in which its body can hold."""
        path = ("rules", name, "rule")
        written = self._reporter.parsed(path, parse_rule, entry.rule, self._attributes)
        certainty = self._certainty(name, entry)
        if written is None:
            self._reporter.unread.update(_first_name(entry.rule))
            return
        several = len(written.clauses) > 1
        for number, clause in enumerate(written.clauses, start=1):
            yield Rule(
                f"{name}.{number}" if several else name,
                clause,
                entry.description,
                entry.threshold,
                entry.negation_threshold,
                certainty,
                entry.groundings,
                written if several else None,
            )

    def _certainty(self, name: str, entry: RuleEntry) -> Bound:
        path, given = ("rules", name, "certainty"), entry.certainty
        pair = given if isinstance(given, tuple) else (given, given)
        certainty = self._reporter.parsed(
            path, lambda: Bound.checked(*pair, of=f"the certainty of '{name}'")
        )
        if certainty is not None and certainty.upper == 0.0:
            self._reporter.report(
                path,
                f"the certainty of '{name}' is 0: the rule concludes nothing",
                "certainty",
                "leave the rule out, or remove it in an overlay",
            )
        return certainty or TRUE

    def _entity_conditions(self) -> list[tuple[int, EntityCondition]]:
        """Return the conditions of entity weights, each with the index of its entry."""
        return [
            (index, EntityCondition(body, entry.weight, entry.at_least))
            for index, entry in enumerate(self._file.entity_weights)
            for body in self._bodies_of(index, entry)
        ]

    def _bodies_of(self, index: int, entry: EntityWeight) -> tuple[Body, ...]:
        path = ("entity_weights", index, "when")
        return self._reporter.parsed(path, parse_conditions, entry.when, self._attributes) or ()

    def _background(self, predicates: Mapping[str, Predicate]) -> tuple[Atom, ...]:
        atoms = []
        for index, text in enumerate(self._file.background):
            path = ("background", index)
            atom = self._reporter.parsed(path, parse_ground_atom, text)
            if atom is not None:
                self._check_atom(path, atom, predicates, offset=0)
                atoms.append(atom)
        return tuple(atoms)

    def _terms(self, rules: Mapping[str, Rule]) -> dict[str, RewardTerm]:
        heads = self._subject_heads(rules)
        return {
            name: term
            for name, entry in self._file.terms.items()
            if (term := self._term(name, entry, heads)) is not None
        }

    def _term(self, name: str, entry: Term, heads: Set[str]) -> RewardTerm | None:
        weights, signals = self._file.weights, self._file.signals
        if isinstance(entry.weight, str) and entry.weight not in weights:
            self._reporter.unknown(("terms", name, "weight"), "weight", entry.weight, weights)
        for parameter in entry.parameters:
            self._reporter.parsed(
                ("terms", name, "parameters", parameter), check_formula_name, parameter
            )
            if parameter in signals:
                self._reporter.report(
                    ("terms", name, "parameters", parameter),
                    f"'{parameter}' is a signal and a parameter of '{name}'",
                    parameter,
                    "rename the parameter",
                )
        path = ("terms", name, "formula")
        formula = self._reporter.parsed(path, Formula.parse, entry.formula)
        if formula is None:
            return None
        known = {*signals, *entry.parameters, *heads}
        self._reporter.parsed(path, formula.check_names, known | self._reporter.unread)
        both = formula.names & heads & {*signals, *entry.parameters}
        if self._file.version == 1:  # whose formulas had signals and parameters before heads
            heads, both = heads - both, frozenset()
        read = tuple(sorted(formula.names & heads))
        for head in both:
            other = "signal" if head in signals else "parameter"
            self._reporter.report(
                path,
                f"'{head}' is a {other} and a head: the formula of '{name}' could mean either",
                head,
                f"rename the {other} or the head",
                offset=formula.offset_of(head),
            )
        for parameter in entry.parameters:
            if parameter not in formula.names and can_be_read(parameter):
                self._reporter.report(
                    ("terms", name, "parameters", parameter),
                    f"the formula of '{name}' does not use the parameter '{parameter}'",
                    parameter,
                    did_you_mean(parameter, formula.names.difference(signals)),
                )
        return RewardTerm(name, entry.weight, formula, entry.parameters, entry.description, read)

    # -- rules --------------------------------------------------------------------------------

    def _with_heads(
        self, declared: Mapping[str, Predicate], rules: Mapping[str, Rule]
    ) -> dict[str, Predicate]:
        # Written with their first rule's arguments; a second rule with another arity is caught
        # when its atoms are checked.
        heads = {
            rule.clause.head.predicate: Predicate(
                rule.clause.head.predicate,
                rule.clause.head.arguments,
                rule.description,
                declared=False,
            )
            for rule in reversed(list(rules.values()))
        }
        return {**declared, **{n: heads[n] for n in reversed(list(heads)) if n not in declared}}

    def _check_rule(self, rule: Rule, predicates: Mapping[str, Predicate]) -> None:
        path = ("rules", rule.entry, "rule")
        head, body = rule.clause.head, rule.clause.body
        self._check_atom(path, head, predicates, offset=0)
        part = rule.part_of is not None
        self._check_body(path, body, predicates, variables(*head.arguments), part=part)

    def _check_body(
        self,
        path: Path,
        body: Body,
        predicates: Mapping[str, Predicate],
        must_bind: tuple[str, ...],
        *,
        part: bool,
    ) -> None:
        offsets = dict(reversed(body.offsets))
        whole = f"'{body}', one way in which the body can hold," if part else "the body"
        if not body.atom_literals and not body.quantified:
            self._reporter.report(path, f"{whole} has guards and no literal", str(body))
        for atom in (atom for literal in body.literals for atom in literal.atoms):
            self._check_atom(path, atom, predicates, offsets.get(atom.predicate, 0))
        for comparison in body.comparisons:
            assert isinstance(comparison.predicate, Compared)
            compared = comparison.predicate.of(comparison.arguments)
            self._check_value(path, compared, predicates, offsets.get(compared.predicate, 0))
        for fault in (fault for literal in body.literals for fault in literal.faults()):
            name, message, suggestion = fault
            self._reporter.report(path, message, name, suggestion, offset=offsets.get(name, 0))
        bound = body.bound_variables
        for variable in variables(*must_bind, *body.terms):
            if variable not in bound:
                self._reporter.report(
                    path,
                    f"the variable '{variable}' stands in no positive literal of "
                    f"{whole.removesuffix(',')}",
                    variable,
                    f"add a literal such as Predicate({variable}), or rename the variable",
                    offset=offsets.get(variable, 0),
                )

    def _check_atom(
        self,
        path: Path,
        atom: Atom,
        predicates: Mapping[str, Predicate],
        offset: int,
    ) -> None:
        name = atom.predicate
        if name in self._attributes:
            self._reporter.report(
                path,
                f"'{name}' is an attribute: it has a value, and is neither true nor false",
                name,
                f"a body compares it, as {atom} < 10; a fact says it, as {atom} = 10",
                offset=offset,
            )
        elif name not in predicates:
            choices = {**predicates, **self._attributes}
            self._reporter.unknown(path, "predicate", name, choices, offset)
        else:
            self._check_arity(path, atom, predicates[name], offset)

    def _check_value(
        self, path: Path, atom: Atom, predicates: Mapping[str, Predicate], offset: int
    ) -> None:
        """Check an attribute with its arguments."""
        name = atom.predicate
        if name in self._attributes:
            self._check_arity(path, atom, self._attributes[name], offset)
        elif name in predicates:
            self._reporter.report(
                path,
                f"'{name}' is a predicate, and has no value",
                name,
                f"a bound is asked of an atom as {atom} >= 0.5, and denied as not {atom}; "
                "numbers are declared under attributes",
                offset=offset,
            )
        else:
            self._reporter.unknown(path, "attribute", name, self._attributes, offset)

    def _check_arity(self, path: Path, atom: Atom, declared: Attribute, offset: int) -> None:
        if declared.arity != len(atom.arguments):
            self._reporter.report(
                path,
                f"'{atom.predicate}' has {len(atom.arguments)} arguments here",
                atom.predicate,
                f"it is declared as {declared.signature}",
                offset=offset,
            )

    def _check_observed_fact(self, fact: ObservedFact, predicates: Mapping[str, Predicate]) -> None:
        path = ("facts", fact.text)
        if fact.atom.predicate not in self._attributes:
            self._check_atom(path, fact.atom, predicates, offset=0)
            return
        self._check_value(path, fact.atom, predicates, offset=0)
        for setting in self._file.facts[fact.text].model_fields_set & {"bounds", "at_least"}:
            self._reporter.report(
                (*path, setting),
                f"'{fact.atom.predicate}' is an attribute, whose value has no '{setting}'",
                setting,
                "leave it out: a value is known, and no confidence",
            )

    def _check_heads_are_used(
        self,
        declared: Mapping[str, Predicate],
        rules: Mapping[str, Rule],
        conditions: Iterable[EntityCondition],
        terms: Iterable[RewardTerm],
    ) -> None:
        """A head that nobody declared and nobody reads is most likely misspelt."""
        bodies = [rule.clause.body for rule in rules.values()]
        bodies += [condition.when for condition in conditions]
        used = {name for body in bodies for name in body.predicates}
        used |= {head for weight in self._file.weights.values() for head in weight.coefficients}
        used |= {head for term in terms for head in term.heads}
        unknown = used - {*declared, *(rule.clause.head.predicate for rule in rules.values())}
        for rule in rules.values():
            head = rule.clause.head.predicate
            # Where the misspelt name is that of the reader, it is reported there.
            misread = any(closest(other, [head]) for other in unknown)
            known = head in declared or head in self._attributes
            if not known and head not in used and not misread:
                self._reporter.unknown(
                    ("rules", rule.entry, "rule"), "predicate", head, {*declared, *used}
                )

    # -- the rest -----------------------------------------------------------------------------

    def _check_semantics(self) -> None:
        semantics = self._file.semantics
        if CONJUNCTIONS[semantics.conjunction].pooled is not None:
            return
        pooling = " and ".join(f"'{name}'" for name, c in CONJUNCTIONS.items() if c.pooled)
        rules = (("rules", name, "groundings") for name in self._file.rules)
        for path, groundings in (
            (("semantics", "groundings"), semantics.groundings),
            *zip(rules, (entry.groundings for entry in self._file.rules.values()), strict=True),
        ):
            if groundings == POOLED:
                self._reporter.report(
                    path,
                    f"'pooled' is defined for {pooling}, not for '{semantics.conjunction}'",
                    POOLED,
                    "write groundings: best",
                )

    def _check_signals(self) -> None:
        for name, signal in self._file.signals.items():
            self._reporter.parsed(("signals", name), check_formula_name, name)
            if signal.default is not None and math.isnan(signal.default):
                self._reporter.report(
                    ("signals", name, "default"),
                    f"the default of '{name}' is NaN",
                    name,
                    "leave it out, so that the caller must give the signal",
                )

    def _check_time(
        self, rules: Mapping[str, Rule], conditions: Iterable[tuple[int, EntityCondition]]
    ) -> None:
        """Durations mean nothing without the length of a step."""
        if self._file.time is not None:
            return
        bodies: list[tuple[Path, Body]] = [
            (("rules", rule.entry, "rule"), rule.clause.body) for rule in rules.values()
        ]
        bodies += [(("entity_weights", index, "when"), c.when) for index, c in conditions]
        advice = "say how long one is: time: {step: 0.1, unit: s}"
        for path, body in bodies:
            offsets = dict(reversed(body.offsets))
            for predicate in body.timed:
                name = predicate.operator.name
                if predicate.operator.duration is not None:
                    self._reporter.report(
                        path,
                        f"'{name}' has a duration, but nothing says how long a step is",
                        name,
                        advice,
                        offset=offsets.get(name, 0),
                    )
        for name, weight in self._file.weights.items():
            if weight.smoothing is not None:
                self._reporter.report(
                    ("weights", name, "smoothing"),
                    f"the weight '{name}' is smoothed, but nothing says how long a step is",
                    name,
                    advice,
                )

    def _check_weights(self, rules: Mapping[str, Rule]) -> None:
        known = self._subject_heads(rules)
        arities = {r.clause.head.predicate: len(r.clause.head.arguments) for r in rules.values()}
        for name, weight in self._file.weights.items():
            for head in weight.coefficients:
                path = ("weights", name, "coefficients", head)
                if head in arities and head not in known:
                    self._reporter.report(
                        path,
                        f"the head '{head}' has {arities[head]} arguments",
                        head,
                        "a weight is made of heads with one, the subject, or none",
                    )
                elif head not in known:
                    self._reporter.unknown(path, "head", head, known)

    def _subject_heads(self, rules: Mapping[str, Rule]) -> frozenset[str]:
        """Return the heads of one argument or none; what an overlay removed may have been one."""
        heads = (rule.clause.head for rule in rules.values())
        return self._removed_heads.union(h.predicate for h in heads if len(h.arguments) <= 1)

    def _check_observed(self, path: Path, case: Case) -> None:
        """Check what a test observes; whether it has the parts that are read, its run shows."""
        if case.observation is None:
            for key in case.model_fields_set & {"action", "next", *STEP}:
                self._reporter.report(
                    (*path, key),
                    f"the test has '{key}' without an observation",
                    key,
                    "give the observation before the action, too",
                )
        elif not self._file.observation:
            self._reporter.report(
                (*path, "observation"),
                "nothing says how an observation is read",
                "observation",
                "add the sections observation and facts",
            )
        elif "facts" in case.model_fields_set:
            self._reporter.report(
                (*path, "facts"),
                "the test has facts and an observation",
                "facts",
                "give one of them: facts are read from the observation",
            )

    def _check_case(self, index: int, case: Case, predicates: Mapping[str, Predicate]) -> None:
        path: Path = ("tests", index)
        self._check_observed(path, case)
        self._check_scene(path, case, predicates)
        for key in case.model_fields_set & {"facts", "observation"} if case.steps else ():
            self._reporter.report(
                (*path, key),
                f"the test has steps and {key}",
                key,
                "give one of them: each step has facts of its own",
            )
        for number, step in enumerate(case.steps):
            self._check_scene((*path, "steps", number), step, predicates)

    def _check_scene(
        self, path: Path, case: Case | CaseStep, predicates: Mapping[str, Predicate]
    ) -> None:
        texts = [case.facts] if isinstance(case.facts, str) else case.facts
        for number, text in enumerate(texts):
            where = (*path, "facts", *([] if isinstance(case.facts, str) else [number]))
            facts = self._reporter.parsed(where, Facts.parse, text) or Facts()
            for atom in facts:
                has_value = facts.value(atom.predicate, *atom.arguments) is not None
                check = self._check_value if has_value else self._check_atom
                check(where, atom, predicates, max(text.find(atom.predicate), 0))
        expect = case.expect
        heads = {n for n, p in predicates.items() if p.arity <= 1 and n in self._heads}
        known = (
            ("signal", case.signals, self._file.signals, ("signals",)),
            ("head", expect.bounds, heads | self._removed_heads, ("expect", "bounds")),
            ("head", expect.confidences, heads | self._removed_heads, ("expect", "confidences")),
            ("weight", expect.weights, self._file.weights, ("expect", "weights")),
            ("term", expect.terms, self._file.terms, ("expect", "terms")),
        )
        for what, names, choices, key in known:
            for name in names:
                if name not in choices:
                    self._reporter.unknown((*path, *key, name), what, name, choices)
        for head, pair in expect.bounds.items():
            if pair is not None:
                self._reporter.parsed((*path, "expect", "bounds", head), Bound.checked, *pair)


def _first_name(text: str) -> list[str]:
    """Return the predicate with which a text that is no clause begins, if there is one."""
    return re.findall(r"\A\s*([A-Za-z]\w*)\s*(?:\(|:-)", text)

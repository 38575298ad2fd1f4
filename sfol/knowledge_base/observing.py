"""Checks what a file says of reading facts and signals off an observation.

Every field that a formula names must be one of the observation's parts, every variable must have a
sort, and no atom may be said twice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from itertools import chain

from sfol.errors import FormulaError, did_you_mean
from sfol.formula import Formula, Range, check_formula_name
from sfol.knowledge_base.format import FactEntry, KnowledgeBaseFile, Sort, Source
from sfol.knowledge_base.parts import ObservedFact, fields_of
from sfol.knowledge_base.reporting import Path, Reporter
from sfol.syntax import Atom, is_name, is_variable, parse_sorted_signature

ACTION, NEXT = "action", "next"
# What signals may read of a step beside observations and the action: one number each.
STEP = ("native", "terminated", "truncated")
MAXIMUM_ENTITIES = 10_000
MAXIMUM_ATOMS = 100_000

_Fields = Mapping[str, object]
_Fault = tuple[str, str, str | None]  # what is wrong, the word that is, a suggestion
_NOT_IN_FACTS = "a fact can't read '{}'"
_ONE_STATE = "it is of the state before the action or, with facts_at: next, of the one after it"


class ObservationChecker:
    """Checks the sections `observation`, `entities` and `facts`, and the signals read from them.

    Args:
        file: the merged content of all files of a chain.
        reporter: takes the errors.
    """

    def __init__(self, file: KnowledgeBaseFile, reporter: Reporter) -> None:
        self._file = file
        self._reporter = reporter
        self._sources = with_step(file.observation)
        self._tables = set(chain.from_iterable(sort.tables for sort in file.entities.values()))
        self._names: dict[str, str] = {}  # name of an entity → its sort
        self._fields: dict[str, _Fields] = {}  # sort → fields of its entities

    def check(self, constants: Set[str]) -> None:
        """Check the parts of the observation, and which entities there are.

        Args:
            constants: names that are taken: the subject, and whatever the background is about.
        """
        for name, source in self._file.observation.items():
            self._check_source(name, source)
        for name, sort in self._file.entities.items():
            self._check_sort(name, sort, constants)

    def facts(self, background: Sequence[Atom], concluded: Set[str]) -> tuple[ObservedFact, ...]:
        """Return the facts that are read off an observation.

        Args:
            background: atoms that hold anyway.
            concluded: predicates that only rules know of.
        """
        said: dict[tuple[str, ...], str] = {
            (a.predicate, *a.arguments): "the background" for a in background
        }
        found = []
        for text, entry in self._file.facts.items():
            fact = self._fact(text, entry)
            if fact is None:
                continue
            found.append(fact)
            self._check_fact(fact, concluded)
            if fact.slots in said:
                self._report(
                    ("facts", text),
                    f"{fact.atom} is said twice, here and in {said[fact.slots]}",
                    fact.atom.predicate,
                )
            said.setdefault(fact.slots, f"'{text}'")
        self._check_size(found)
        return tuple(found)

    def signals(self) -> dict[str, Formula]:
        """Return the formulas of the signals that are read off an observation, by name."""
        found = {}
        for name, signal in self._file.signals.items():
            path = ("signals", name, "from")
            if signal.observed is None:
                continue
            formula = self._reporter.parsed(path, Formula.parse, signal.observed)
            if formula is not None:
                self._check_names(path, formula, {}, in_signal=True)
                found[name] = formula
        return found

    # -- the observation ----------------------------------------------------------------------

    def _check_source(self, name: str, source: Source) -> None:
        path = ("observation", name)
        if name in (NEXT, *STEP) or name[:1].isupper():
            self._report(
                path,
                f"a part of the observation can't be called '{name}'",
                name,
                "names begin with a lower-case letter; 'next' is the observation after the action, "
                f"and {', '.join(STEP)} are of the step",
            )
        else:
            self._reporter.parsed(path, check_formula_name, name)
        if source.fields is not None and not source.fields:
            self._report(
                (*path, "fields"),
                f"'{name}' has no fields",
                name,
                "leave the key out for a single number",
            )
        if isinstance(source.fields, list) and len(source.columns) != len(source.fields):
            twice = next(f for f in source.fields if source.fields.count(f) > 1)
            self._report((*path, "fields"), f"the field '{twice}' of '{name}' stands twice", twice)
        for field, column in source.columns.items():
            self._reporter.parsed((*path, "fields"), _check_field, field)
            if column < 0:
                self._report((*path, "fields", field), f"the index of '{field}' is {column}", field)
        if source.present is not None and name not in self._tables:
            self._report(
                (*path, "present"),
                f"'{name}' is no table",
                name,
                "present says which rows of a table are there",
            )

    def _check_sort(self, name: str, sort: Sort, constants: Set[str]) -> None:
        path = ("entities", name)
        if not is_name(name) or is_variable(name):
            self._report(
                path,
                f"'{name}' is no sort",
                name,
                "it begins with a lower-case letter, and names its entities: pedestrian1",
            )
        tables = self._file.observation.keys() - {ACTION}
        for table in sort.tables:
            if table not in tables:
                self._reporter.unknown((*path, "from"), "part of the observation", table, tables)
        if tables.issuperset(sort.tables):
            self._fields[name] = fields_of(self._file.observation, sort)
            count = sum(len(self._file.observation[t].columns) or 1 for t in sort.tables)
            if count > len(self._fields[name]):
                self._report(
                    (*path, "from"),
                    f"the tables of '{name}' share a field",
                    name,
                    "call it differently in one of them",
                )
        if len(self._names) + sort.at_most > MAXIMUM_ENTITIES:
            self._report(
                (*path, "at_most"), f"there are more than {MAXIMUM_ENTITIES:,} entities", name
            )
            return
        names = entity_names(name, sort)
        taken = next((n for n in names if n in constants or n in self._names), None)
        if taken is not None:
            owner = f"an entity of '{self._names[taken]}'" if taken in self._names else "a constant"
            self._report(
                path,
                f"the sort '{name}' would call an entity '{taken}', which is the name of {owner}",
                taken,
                "call the sort differently",
            )
        self._names.update(dict.fromkeys(names, name))

    # -- facts --------------------------------------------------------------------------------

    def _fact(self, text: str, entry: FactEntry) -> ObservedFact | None:
        signature = self._reporter.parsed(("facts", text), parse_sorted_signature, text)
        path = ("facts", text, "formula")
        formula = self._reporter.parsed(path, Formula.parse, entry.formula)
        if signature is None or formula is None:
            return None
        atom, sorts = signature
        for sort in sorts.values():
            if sort not in self._file.entities:
                self._reporter.unknown(("facts", text), "sort", sort, self._file.entities)
        self._check_names(path, formula, sorts)
        return ObservedFact(
            text, atom, sorts, formula, exact=entry.bounds == "exact", at_least=entry.at_least
        )

    def _check_fact(self, fact: ObservedFact, concluded: Set[str]) -> None:
        path = ("facts", fact.text)
        for argument in fact.atom.arguments:
            if argument in self._file.entities:
                self._report(
                    path,
                    f"'{argument}' is a sort",
                    argument,
                    f"a variable ranges over it: X in {argument}",
                )
            elif argument in self._names:
                self._report(
                    path,
                    f"'{argument}' is an entity of a sort",
                    argument,
                    f"a variable ranges over them: X in {self._names[argument]}",
                )
        predicate = fact.atom.predicate
        if predicate in concluded:
            self._report(
                path,
                f"'{predicate}' is what rules conclude",
                predicate,
                "give what is observed a predicate of its own; or declare this one, "
                "if both may say it",
            )

    def _check_size(self, facts: Sequence[ObservedFact]) -> None:
        total = 0
        for fact in facts:
            sorts = [self._file.entities.get(sort) for sort in fact.sorts.values()]
            atoms = math.prod(sort.at_most for sort in sorts if sort is not None)
            inner = [self._file.entities.get(r.sort) for r in fact.formula.ranges]
            total += atoms * (1 + sum(sort.at_most for sort in inner if sort is not None))
            if total > MAXIMUM_ATOMS:
                self._report(
                    ("facts", fact.text),
                    f"there are more than {MAXIMUM_ATOMS:,} atoms to read",
                    fact.atom.predicate,
                    "smaller sorts, with at_most, have fewer pairs",
                )
                return

    # -- names in formulas --------------------------------------------------------------------

    def _check_names(
        self, path: Path, formula: Formula, sorts: Mapping[str, str], *, in_signal: bool = False
    ) -> None:
        for entities in formula.ranges:
            fault = self._range_fault(entities, sorts, in_signal=in_signal)
            if fault is not None:
                self._report(path, *fault, formula.offset_of(entities.sort))
        named = [(name, sorts) for name in sorted(formula.names)]
        for entities in formula.ranges:
            own = {entities.variable: entities.sort.removeprefix(f"{NEXT}.")}
            named += [(name, own) for name in sorted(entities.names)]
        for name, known in named:
            fault = self._fault(name, known, in_signal=in_signal)
            if fault is not None:
                self._report(path, *fault, formula.offset_of(name))

    def _range_fault(
        self, entities: Range, sorts: Mapping[str, str], *, in_signal: bool
    ) -> _Fault | None:
        """Return what is wrong with the entities that a quantifier goes through."""
        *first, sort = entities.sort.split(".")
        if first == [NEXT] and not in_signal:
            return _NOT_IN_FACTS.format(NEXT), NEXT, _ONE_STATE
        if first not in ([], [NEXT]) or sort not in self._file.entities:
            hint = did_you_mean(sort, self._file.entities)
            return f"'{entities.sort}' is no sort", entities.sort, hint
        if entities.variable in sorts:
            message = f"the variable '{entities.variable}' stands twice"
            return message, entities.variable, "take another one for the quantifier"
        return None

    def _fault(self, name: str, sorts: Mapping[str, str], *, in_signal: bool) -> _Fault | None:
        """Return what is wrong with a name of a formula."""
        first, *rest = name.split(".")
        known: Set[str] = self._sources.keys()
        if first in (NEXT, ACTION, *STEP) and not in_signal:
            return _NOT_IN_FACTS.format(first), first, _ONE_STATE
        if first == NEXT:
            known = known - {ACTION, *STEP}
            first, *rest = rest or [""]
        if is_variable(first or "x"):
            if first not in sorts:
                hint = did_you_mean(first, sorts) or "signals have no variables"
                return f"the formula reads the variable '{first}', which has no sort", first, hint
            return self._field_fault(first, rest, self._fields.get(sorts[first]))
        if first not in known:
            message = f"the formula reads '{first}', which is no part of the observation"
            return message, first, did_you_mean(first, known)
        if first in self._tables:
            return f"'{first}' is a table", first, "a variable of a sort reads its rows, as in P.x"
        columns = self._sources[first].columns
        return self._field_fault(first, rest, columns or {"": 0})

    @staticmethod
    def _field_fault(owner: str, rest: Sequence[str], fields: _Fields | None) -> _Fault | None:
        field = ".".join(rest)
        if fields is None or field in fields:  # where the sort itself is wrong, that was said
            return None
        if not field:
            shown = f"write {owner}.{next(iter(fields))}"
            return f"'{owner}' has several numbers", owner, shown
        hint = did_you_mean(field, fields) if any(fields) else f"it is one number: write {owner}"
        return f"'{owner}' has no field '{field}'", field, hint

    def _report(
        self, path: Path, message: str, name: str, suggestion: str | None = None, offset: int = 0
    ) -> None:
        self._reporter.report(path, message, name, suggestion, offset)


def with_step(observation: Mapping[str, Source]) -> dict[str, Source]:
    """Return the parts of an observation by name, and those of a step beside it."""
    return {**observation, **dict.fromkeys(STEP, Source())}


def entity_names(name: str, sort: Sort) -> tuple[str, ...]:
    """Return what the entities of a sort are called, as ``pedestrian1``, row by row."""
    return tuple(f"{name}{row}" for row in range(1, sort.at_most + 1))


def _check_field(field: str) -> None:
    check_formula_name(field)
    if field.startswith("_"):
        raise FormulaError(
            f"the field '{field}' begins with an underscore",
            name=field,
            suggestion=f"call it {field.strip('_') or 'x'}",
        )

"""Evaluation over arrays: every predicate an array, for all scenes and all entities at once.

Entities belong to *domains*: the sorts of a knowledge base, and one for each constant. The atoms of
a predicate for entities of some domains are a *block*: arrays (n, B) or (n, m, B), with B scenes
along the last axis. What scenes have in common has one scene, and broadcasts. A rule is typed: for
each choice of domains for its variables that the blocks allow, its literals are arrays with an axis
for each variable. Which substitutions satisfy it is found by eliminating variables, without a loop
over scenes or entities.

It gives what the compiled engine gives scene by scene.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any

import numpy as np

from sfol.arrays import Array, Backend
from sfol.engines.batched import Bounds
from sfol.engines.elimination import Names, eliminated, elimination_order
from sfol.engines.program import Program
from sfol.errors import WorkLimitError
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.knowledge_base.recursion import Component
from sfol.literals import AtomLiteral, Literal
from sfol.operators import BEST, DISJUNCTIONS, Gathering
from sfol.syntax import ANONYMOUS, is_variable, variables

Axes = tuple[str, ...]  # the domain of each argument
Key = tuple[str, Axes]  # a predicate, and the domains of its arguments
Blocks = Mapping[Key, Bounds]
Sizes = Mapping[str, int]  # domain → how many entities it has
_NONE: Names = frozenset()
_Argument = str | int  # a variable, or a place in the argument's domain


@dataclass(frozen=True)
class Domains:
    """Where entities stand.

    Attributes:
        sizes: domain → how many entities it has, at most.
        places: constant → its domain, and its place there.
    """

    sizes: Mapping[str, int]
    places: Mapping[str, tuple[str, int]]

    @classmethod
    def of(cls, kb: KnowledgeBase, sorts: Mapping[str, Sequence[str]]) -> Domains:
        """Return the domains of a knowledge base: sorts, and one for each other constant.

        Args:
            kb: the knowledge base.
            sorts: the names of each one's entities.
        """
        terms = [kb.subject, *(a for atom in kb.background for a in atom.arguments)]
        terms += [a for fact in kb.facts for a in fact.atom.arguments]
        terms += [
            a for r in kb.rules.values() for a in (*r.clause.head.arguments, *r.clause.body.terms)
        ]
        places = {name: (sort, i) for sort, names in sorts.items() for i, name in enumerate(names)}
        alone = dict.fromkeys(t for t in terms if not is_variable(t) and t not in places)
        # A domain of one can't be called like a sort.
        places |= {constant: (f"={constant}", 0) for constant in alone}
        sizes = {sort: len(names) for sort, names in sorts.items()}
        return cls({**sizes, **{f"={constant}": 1 for constant in alone}}, places)

    def of_slots(self, slots: Iterable[str]) -> Axes:
        """Return the domains of sorts, and of constants among them."""
        return tuple(self.places[slot][0] if slot in self.places else slot for slot in slots)

    def axes(self, constants: Iterable[str]) -> Axes:
        """Return the domains of some constants."""
        return tuple(self.places[constant][0] for constant in constants)


@dataclass(frozen=True)
class _Operand:
    """A literal of a typed rule, and where its atoms' bounds are found.

    Attributes:
        literal: itself.
        key: the block that it reads; there may be none, and then nothing is known.
        arguments: of its atom, but for ``_``, which the key has in place of a domain.
        names: its variables.
    """

    literal: AtomLiteral
    key: Key
    arguments: tuple[_Argument, ...]
    names: Names


@dataclass(frozen=True)
class _Typed:
    """A rule with a domain for each of its variables.

    Attributes:
        rule: the rule.
        order: its variables, those of the head first; each has an axis, in this order.
        types: variable → domain.
        head: the arguments of the head.
        axes: the domains of these.
        operands: its literals that stand for atoms.
        guards: its other literals, with their variables.
        kept: for each operand, the variables that its bounds depend on: its own and the head's.
        orders: sets of variables, larger ones first → in which order all others are eliminated.
    """

    rule: Rule
    order: tuple[str, ...]
    types: Mapping[str, str]
    head: tuple[_Argument, ...]
    axes: Axes
    operands: tuple[_Operand, ...]
    guards: tuple[tuple[Literal, Names], ...]
    kept: tuple[Names, ...]
    orders: Mapping[Names, tuple[str, ...]]

    @property
    def head_names(self) -> Names:
        """The variables of the head."""
        return frozenset(argument for argument in self.head if isinstance(argument, str))

    def typed(self, names: Names) -> frozenset[tuple[str, str]]:
        """Return variables with their domains."""
        return frozenset((name, self.types[name]) for name in names)


_Heads = Mapping[str, Sequence[Sequence[_Typed]]]  # head → its rules, each with all its domains


class DenseProgram:
    """A program for blocks of some predicates and domains.

    Args:
        program: what an engine runs.
        domains: where entities stand.
        keys: the blocks that will be given.

    Raises:
        WorkLimitError: a rule would need too large an array for each scene.
    """

    def __init__(self, program: Program, domains: Domains, keys: Iterable[Key]) -> None:
        self.program = program
        self.domains = domains
        self._offsets = dict(zip(domains.sizes, _running(domains.sizes.values()), strict=True))
        known: dict[str, dict[Axes, None]] = {}
        for predicate, axes in keys:
            known.setdefault(predicate, {})[axes] = None
        self._strata = [
            (self._typed_heads(stratum, known), stratum.recursive) for stratum in program.strata
        ]
        self._known = known

    def conclude(self, blocks: Blocks, backend: Backend, sizes: Sizes) -> dict[Key, Bounds]:
        """Return the blocks, with everything that follows from them.

        Args:
            blocks: of the keys that the program was made for, and of no others; what is unknown
                has any bound, but no NaN.
            backend: the library of arrays.
            sizes: domain → how many entities it has here.
        """
        evaluation = _Evaluation(self, blocks, backend, sizes, self._offsets)
        for heads, recursive in self._strata:
            evaluation.stratum(heads)
            if recursive:
                evaluation.repeat(heads)
        return evaluation.blocks

    def fired(self, blocks: Blocks, backend: Backend, sizes: Sizes, size: int) -> dict[str, Array]:
        """Tell which rules conclude something, for whichever entity: rule → bool (B,).

        Args:
            blocks: that `conclude` returned.
            backend: the library of arrays.
            sizes: domain → how many entities it has here.
            size: B, the number of scenes.

        Raises:
            WorkLimitError: a rule would need too large an array for each scene.
        """
        evaluation = _Evaluation(self, blocks, backend, sizes, self._offsets)
        return {
            name: backend.broadcast(evaluation.holds(typed), (size,))
            for name, typed in self._for_whichever.items()
        }

    @cached_property  # few ask which rules fired
    def _for_whichever(self) -> dict[str, list[_Typed]]:
        rules = (
            rule
            for head, rules in self.program.rules.items()
            if head not in self.program.auxiliary
            for rule, _ in rules
        )
        return {rule.name: list(self._typed((rule, {}), self._known, _NONE)) for rule in rules}

    def of_subject(self, blocks: Blocks, backend: Backend, size: int) -> dict[str, Bounds]:
        """Return the bounds of the subject's heads: head → (B,).

        Args:
            blocks: that `conclude` returned.
            backend: the library of arrays.
            size: B, the number of scenes.
        """
        nobody = Bounds(*(backend.full(1, 0.0),) * 2, backend.full(1, False))
        found = {}
        for head, atom in self.program.subject_heads.items():
            block = blocks.get((head, self.domains.axes(atom.arguments)))
            places = [self.domains.places[constant][1] for constant in atom.arguments if block]
            bounds = block or nobody
            found[head] = Bounds(
                *(
                    backend.broadcast(reduce(_first_taken, places, values), (size,))
                    for values in (bounds.lower, bounds.upper, bounds.known)
                )
            )
        return found

    def _typed_heads(self, stratum: Component, known: dict[str, dict[Axes, None]]) -> _Heads:
        """Return the rules of heads with domains, and add the heads' own domains to those known."""
        while True:
            heads = {
                head: [list(self._typed(rule, known)) for rule in self.program.needed_rules(head)]
                for head in stratum.predicates
            }
            before = sum(map(len, known.values()))
            for head, rules in heads.items():
                known.setdefault(head, {}).update((t.axes, None) for rule in rules for t in rule)
            if not stratum.recursive or sum(map(len, known.values())) == before:
                return heads

    def _typed(
        self,
        given: tuple[Rule, Mapping[str, str]],
        known: Mapping[str, Mapping[Axes, None]],
        keep: Names | None = None,
    ) -> Iterator[_Typed]:
        """Yield a rule with domains; `keep` says which variables are left, if not all it needs."""
        rule, values = given
        head = rule.clause.head.substituted(values)
        literals = [literal.substituted(values) for literal in rule.clause.body.literals]
        atoms = [literal for literal in literals if isinstance(literal, AtomLiteral)]
        order = variables(*head.arguments, *(t for literal in literals for t in literal.terms))
        places = self.domains.places

        def argument(term: str) -> _Argument:
            return term if is_variable(term) else places[term][1]

        for types in self._types([lit for lit in atoms if lit.binds], known, {}):

            def domain(term: str, types: Mapping[str, str] = types) -> str:
                if term == ANONYMOUS:
                    return term
                return types[term] if is_variable(term) else places[term][0]

            operands = tuple(
                _Operand(
                    literal,
                    (literal.atom.predicate, tuple(map(domain, literal.atom.arguments))),
                    tuple(map(argument, literal.terms)),
                    frozenset(variables(*literal.terms)),
                )
                for literal in atoms
            )
            guards = [lit for lit in literals if not isinstance(lit, AtomLiteral)]
            named = tuple((guard, frozenset(variables(*guard.terms))) for guard in guards)
            kept = tuple(o.names.union(variables(*head.arguments)) for o in operands)
            factors = [*(o.names for o in operands), *(names for _, names in named)]
            needed = {*kept, frozenset(variables(*head.arguments))}
            targets = needed if keep is None else {keep}
            if keep is None and self.program.gathers[rule.name] not in (None, BEST):
                factors = [frozenset(order)]  # each substitution is needed by itself
            yield _Typed(
                rule,
                order,
                types,
                tuple(map(argument, head.arguments)),
                tuple(map(domain, head.arguments)),
                operands,
                named,
                kept,
                {
                    names: self._order(rule, factors, names, types)
                    for names in sorted(targets, key=lambda names: (-len(names), sorted(names)))
                },
            )

    def _types(
        self,
        literals: Sequence[AtomLiteral],
        known: Mapping[str, Mapping[Axes, None]],
        types: Mapping[str, str],
    ) -> Iterator[Mapping[str, str]]:
        """Yield the domains that variables can have, so that every literal has a block."""
        if not literals:
            yield types
            return
        atom = literals[0].atom
        for axes in known.get(atom.predicate, ()):
            extended = dict(types)
            fits = (
                extended.setdefault(term, domain) == domain
                if is_variable(term)
                else self.domains.places[term][0] == domain
                for term, domain in zip(atom.arguments, axes, strict=True)
            )
            if all(fits):
                yield from self._types(literals[1:], known, extended)

    def _order(
        self, rule: Rule, factors: Sequence[Names], keep: Names, types: Mapping[str, str]
    ) -> tuple[str, ...]:
        sizes = {name: self.domains.sizes[domain] for name, domain in types.items()}
        order, largest = elimination_order(factors, keep, sizes)
        if largest > self.program.work_limit:
            raise WorkLimitError(
                f"the rule '{rule.name}' needs an array of {largest:,} numbers for each scene",
                name=rule.name,
                suggestion="fewer variables that depend on each other, or smaller sorts, need less",
            )
        return order


def _running(counts: Iterable[int]) -> Iterator[int]:
    total = 0
    for count in counts:
        yield total
        total += count


class _Evaluation:
    """One evaluation; blocks are added stratum by stratum.

    It is what its literals see as `sfol.literals.literal.BatchBounds`, with blocks for rows.
    """

    def __init__(
        self,
        program: DenseProgram,
        blocks: Blocks,
        backend: Backend,
        sizes: Sizes,
        offsets: Mapping[str, int],
    ) -> None:
        semantics = program.program.knowledge_base.semantics
        self._disjunction = DISJUNCTIONS[semantics.disjunction]
        self._gathers = program.program.gathers
        self._conjunctions = program.program.conjunctions
        self._places = program.domains.places
        self._sizes = sizes
        self._offsets = offsets
        self._atoms_of: dict[int, Bounds] = {}  # of an operand, which lives as long as the program
        self._given = blocks
        self.blocks = dict(blocks)
        self.backend = backend

    def lower(self, rows: Bounds) -> Array:
        """Return the lower bounds of a block."""
        return rows.lower

    def upper(self, rows: Bounds) -> Array:
        """Return the upper bounds of a block."""
        return rows.upper

    def known(self, rows: Bounds) -> Array:
        """Tell which atoms of a block are known."""
        return rows.known

    def possible(self, rows: Bounds) -> Array:
        """Tell which atoms of a block are known and have an upper bound above 0."""
        return rows.known & (rows.upper > 0.0)

    def stratum(self, heads: _Heads) -> None:
        """Conclude heads, once."""
        for head, rules in heads.items():
            self._conclude(head, rules)
        self._atoms_of.clear()  # they are other ones once heads are concluded again

    def repeat(self, heads: _Heads) -> None:
        """Conclude heads that depend on each other again, until nothing changes."""
        before: Blocks = {}
        while not self._rests(heads, before):
            before = dict(self.blocks)
            self.stratum(heads)

    def _rests(self, heads: _Heads, before: Blocks) -> bool:
        return all(
            key in before and block.equals(before[key], self.backend)
            for key, block in self.blocks.items()
            if key[0] in heads
        )

    def _conclude(self, head: str, rules: Sequence[Sequence[_Typed]]) -> None:
        disjuncts: dict[Axes, list[Bounds]] = {}
        for typed in rules:
            for axes in dict.fromkeys(rule.axes for rule in typed):
                same = [rule for rule in typed if rule.axes == axes]
                bounds = self._concluded(same).times(same[0].rule.certainty)
                disjuncts.setdefault(axes, []).append(self._as_block(bounds, same[0]))
        for axes, found in disjuncts.items():
            asserted = self._given.get((head, axes))
            every = found if asserted is None else [asserted, *found]
            self.blocks[head, axes] = self._either(every)

    def holds(self, typed: Sequence[_Typed]) -> Array:
        """Tell whether some substitution satisfies a rule's body, in each scene."""
        found = self.backend.full(1, False)
        for rule in typed:
            order = rule.orders[_NONE]
            mask = eliminated(self._factors(rule), order, operator.and_, self._any(rule))
            found = found | mask[(*(0 for _ in rule.order), slice(None))]
        return found

    # -- a rule -------------------------------------------------------------------------------

    def _concluded(self, typed: Sequence[_Typed]) -> Bounds:
        """Return what one rule concludes, with all domains that its variables can have."""
        gathering = self._gathers[typed[0].rule.name]
        if gathering is None:
            return self._pooled(typed)
        return self._best(typed) if gathering is BEST else self._gathered(typed, gathering)

    def _pooled(self, typed: Sequence[_Typed]) -> Bounds:
        """Combine each literal's distinct atoms, all together."""
        backend, pool = self.backend, self._conjunctions[typed[0].rule.name].pooled
        assert pool is not None  # a checked knowledge base pools only where that is defined
        supports: dict[frozenset[tuple[str, str]], tuple[Array, Names, _Typed]] = {}
        for rule in typed:
            for names, mask in self._supports(rule).items():
                key = rule.typed(names)
                # The same atoms may support a head with other variables of other domains.
                others = [supports[key][0]] if key in supports else []
                supports[key] = reduce(operator.or_, others, mask), names, rule
        lower = upper = count = backend.full(1, 0.0)
        for mask, names, rule in supports.values():
            operands = [
                o for o, kept in zip(rule.operands, rule.kept, strict=True) if kept == names
            ]
            if not operands:
                continue
            lowers, uppers = self._sums(rule, operands)
            axes = tuple(axis for axis, n in enumerate(rule.order) if n in names - rule.head_names)
            chosen = backend.real(mask)  # a product is faster than a choice
            lower = lower + backend.sum_along(chosen * lowers, axes)
            upper = upper + backend.sum_along(chosen * uppers, axes)
            count = count + len(operands) * backend.sum_along(chosen, axes)
        atoms = backend.maximum(count, 1.0)
        return Bounds(pool(lower, atoms), pool(upper, atoms), count > 0.0)

    def _supports(self, rule: _Typed) -> dict[Names, Array]:
        """Return where variables have values with which the whole body holds."""
        found: dict[Names, Array] = {}
        factors = self._factors(rule)
        for names, order in rule.orders.items():
            wider = next((other for other in found if other > names), None)
            found[names] = (
                eliminated(factors, order, operator.and_, self._any(rule))
                if wider is None
                else reduce(
                    lambda mask, name: self._any(rule)(name, mask),
                    sorted(wider - names),
                    found[wider],
                )
            )
        return found

    def _best(self, typed: Sequence[_Typed]) -> Bounds:
        """Combine per substitution, then take the greatest of lowers and of uppers."""
        backend, conjunction = self.backend, self._conjunctions[typed[0].rule.name]
        best = self._greater([self._best_of(rule) for rule in typed])
        count = len(typed[0].operands)
        return Bounds(
            backend.where(best.known, conjunction.finish(best.lower, count), 0.0),
            backend.where(best.known, conjunction.finish(best.upper, count), 0.0),
            best.known,
        )

    def _best_of(self, rule: _Typed) -> Bounds:
        """Return what the best substitutions come to, as yet unfinished."""
        backend, conjunction = self.backend, self._conjunctions[rule.rule.name]
        names = rule.head_names
        order = rule.orders[names]
        masks = self._factors(rule)
        known = eliminated(masks, order, operator.and_, self._any(rule))
        lowers: list[tuple[Names, Array]] = []
        uppers: list[tuple[Names, Array]] = []
        for operand, (_, holds) in zip(rule.operands, masks, strict=False):
            lower, upper = self._bounds(rule, operand)
            for ends, values in ((lowers, lower), (uppers, upper)):
                ends.append((operand.names, backend.where(holds, values, conjunction.absent)))
        for guard, holds in masks[len(rule.operands) :]:
            values = backend.where(holds, conjunction.neutral, backend.full(1, conjunction.absent))
            lowers.append((guard, values))
            uppers.append((guard, values))

        def largest(name: str, values: Array) -> Array:
            return backend.largest_along(values, rule.order.index(name))

        lower, upper = (
            eliminated(ends, order, conjunction.pair, largest) for ends in (lowers, uppers)
        )
        return Bounds(lower, upper, known)

    def _gathered(self, typed: Sequence[_Typed], gathering: Gathering) -> Bounds:
        """Combine per substitution, then let a gathering make one of all of a head."""
        backend, names = self.backend, typed[0].head_names
        columns = [self._column(rule, gathering.absent) for rule in typed]
        heads = [self._sizes[typed[0].types[name]] for name in typed[0].order if name in names]
        scenes = max(column.known.shape[-1] for column in columns)

        def joined(values: Iterable[Array]) -> Array:
            parts = [backend.broadcast(v, (*heads, v.shape[-2], scenes)) for v in values]
            return backend.joined_along(parts, len(heads))

        def spread(values: Array) -> Array:
            rest = len(typed[0].order) - len(heads)
            return values.reshape(*heads, *(1,) * rest, values.shape[-1])

        holds = joined(column.known for column in columns)
        counted = backend.sum_along(backend.real(holds), (len(heads),))
        known = spread(counted >= gathering.needed)
        lower, upper = (
            backend.where(known, spread(gathering.along(backend, joined(ends), len(heads))), 0.0)
            for ends in ((c.lower for c in columns), (c.upper for c in columns))
        )
        return Bounds(lower, upper, known)

    def _column(self, rule: _Typed, absent: float) -> Bounds:
        """Return what each substitution comes to: the axes of the head, one for all others."""
        backend, conjunction = self.backend, self._conjunctions[rule.rule.name]
        holds = reduce(operator.and_, (mask for _, mask in self._factors(rule)))
        ends = zip(*(self._bounds(rule, operand) for operand in rule.operands), strict=True)
        sizes = [self._sizes[rule.types[name]] for name in rule.order]
        inner = math.prod(
            s for s, n in zip(sizes, rule.order, strict=True) if n not in rule.head_names
        )

        def column(values: Array) -> Array:
            scenes = values.shape[-1]
            heads = [s for s, n in zip(sizes, rule.order, strict=True) if n in rule.head_names]
            return backend.broadcast(values, (*sizes, scenes)).reshape(*heads, inner, scenes)

        lower, upper = (
            column(backend.where(holds, conjunction.elementwise(values), absent)) for values in ends
        )
        return Bounds(lower, upper, column(holds))

    def _any(self, rule: _Typed) -> Any:
        return lambda name, mask: self.backend.any_along(mask, rule.order.index(name))

    # -- literals -----------------------------------------------------------------------------

    def _factors(self, rule: _Typed) -> list[tuple[Names, Array]]:
        """Return where each literal holds: those for atoms first, then guards."""
        factors = []
        for operand in rule.operands:
            holds = operand.literal.batch_holds(self, self._atoms(rule, operand), rule.rule)
            factors.append((operand.names, holds))
        for guard, names in rule.guards:
            factors.append((names, guard.holds_among(lambda term: self._numbers(rule, term))))
        return factors

    def _bounds(self, rule: _Typed, operand: _Operand) -> tuple[Array, Array]:
        return operand.literal.batch_bounds(self, self._atoms(rule, operand))

    def _sums(self, rule: _Typed, operands: Sequence[_Operand]) -> tuple[Array, Array]:
        lowers, uppers = zip(*(self._bounds(rule, operand) for operand in operands), strict=True)
        return reduce(operator.add, lowers), reduce(operator.add, uppers)

    def _atoms(self, rule: _Typed, operand: _Operand) -> Bounds:
        """Return the bounds of the atoms that a literal stands for."""
        if id(operand) not in self._atoms_of:
            known = self._greatest if ANONYMOUS in operand.key[1] else self.blocks.get
            found = known(operand.key) or self._unknown(len(operand.arguments))
            self._atoms_of[id(operand)] = Bounds(
                *(
                    self._placed(rule, operand.arguments, values)
                    for values in (found.lower, found.upper, found.known)
                )
            )
        return self._atoms_of[id(operand)]

    def _greatest(self, key: Key) -> Bounds | None:
        """Return the greatest bounds over all entities, of any domain, where a key has ``_``."""
        backend, (predicate, pattern) = self.backend, key
        over = tuple(axis for axis, domain in enumerate(pattern) if domain == ANONYMOUS)
        found: list[Bounds] = []
        for (name, axes), block in self.blocks.items():
            if name != predicate or any(
                domain not in (ANONYMOUS, axis) for domain, axis in zip(pattern, axes, strict=True)
            ):
                continue
            known = block.known
            lower, upper = (backend.where(known, end, 0.0) for end in (block.lower, block.upper))
            for axis in reversed(over):
                first = (*(slice(None),) * axis, 0)
                lower = backend.largest_along(lower, axis)[first]
                upper = backend.largest_along(upper, axis)[first]
                known = backend.any_along(known, axis)[first]
            found.append(Bounds(lower, upper, known))
        return self._greater(found) if found else None

    def _greater(self, found: Sequence[Bounds]) -> Bounds:
        return Bounds(
            reduce(self.backend.maximum, [bounds.lower for bounds in found]),
            reduce(self.backend.maximum, [bounds.upper for bounds in found]),
            reduce(operator.or_, [bounds.known for bounds in found]),
        )

    def _unknown(self, arity: int) -> Bounds:
        shape = (1,) * (arity + 1)
        zeros = self.backend.full(1, 0.0).reshape(shape)
        return Bounds(zeros, zeros, self.backend.full(1, False).reshape(shape))

    def _numbers(self, rule: _Typed, term: str) -> Array:
        """Return the numbers of the entities that a term of a guard may be."""
        if not is_variable(term):
            domain, place = self._places[term]
            return self.backend.array(
                np.full((1,) * (len(rule.order) + 1), self._offsets[domain] + place)
            )
        domain = rule.types[term]
        numbers = np.arange(self._sizes[domain]) + self._offsets[domain]
        return self._placed(rule, (term,), self.backend.array(numbers)[:, None])

    @staticmethod
    def _placed(rule: _Typed, arguments: tuple[_Argument, ...], values: Array) -> Array:
        """Return values of a block with an axis for each variable of the rule."""
        for axis, argument in reversed([*enumerate(arguments)]):
            if isinstance(argument, int):
                values = _taken(values, axis, argument)
        names = [argument for argument in arguments if isinstance(argument, str)]
        if len(names) > 1:
            values = _in_order(values, names, rule.order)
        return values[(*(slice(None) if n in names else None for n in rule.order), slice(None))]

    # -- heads --------------------------------------------------------------------------------

    def _as_block(self, bounds: Bounds, rule: _Typed) -> Bounds:
        """Return what was concluded as a block, with an axis for each argument of the head."""
        seen: dict[_Argument, int] = {}
        expand: list[slice | None] = []
        masks: list[Array] = []
        for axis, (argument, domain) in enumerate(zip(rule.head, rule.axes, strict=True)):
            size = self._sizes[domain]
            new = isinstance(argument, str) and argument not in seen
            expand.append(slice(None) if new else None)
            shape = [1] * (len(rule.head) + 1)
            shape[axis] = size
            if isinstance(argument, int) and size > 1:
                masks.append((np.arange(size) == argument).reshape(shape))
            elif not new and not isinstance(argument, int):
                shape[seen[argument]] = size
                masks.append(np.eye(size, dtype=np.bool_).reshape(shape))
            seen.setdefault(argument, axis)
        at = tuple(slice(None) if name in rule.head_names else 0 for name in rule.order)
        lower, upper, known = (
            values[(*at, slice(None))][(*expand, slice(None))]
            for values in (bounds.lower, bounds.upper, bounds.known)
        )
        for mask in masks:
            known = known & self.backend.array(mask)
        if masks:
            lower, upper = (self.backend.where(known, end, 0.0) for end in (lower, upper))
        return Bounds(lower, upper, known)

    def _either(self, disjuncts: Sequence[Bounds]) -> Bounds:
        """Combine what concludes the same atoms; what is unknown is 0, which changes nothing."""
        if len(disjuncts) == 1:
            return disjuncts[0]
        combine, where = self._disjunction.elementwise, self.backend.where
        return Bounds(
            combine([where(d.known, d.lower, 0.0) for d in disjuncts]),
            combine([where(d.known, d.upper, 0.0) for d in disjuncts]),
            reduce(operator.or_, (d.known for d in disjuncts)),
        )


def _in_order(values: Array, names: Sequence[str], order: Sequence[str]) -> Array:
    """Return values with one axis for each name, in an order; the scenes stay last."""
    axes = [order.index(name) for name in names]
    if all(map(operator.lt, axes, axes[1:])):  # as nearly always
        return values
    for name in dict.fromkeys(names):
        while names.count(name) > 1:
            values, names = _on_diagonal(values, names, name)
    wanted = sorted(names, key=order.index)
    left = list(names)
    for axis, name in enumerate(wanted):
        at = left.index(name)
        values = values.swapaxes(axis, at)
        left[axis], left[at] = left[at], left[axis]
    return values


def _first_taken(values: Array, place: int) -> Array:
    """Return one place along the first axis."""
    return _taken(values, 0, place)


def _on_diagonal(values: Array, names: Sequence[str], name: str) -> tuple[Array, list[str]]:
    """Return values where the first two axes of a name have the same place, as one axis."""
    first, second = [axis for axis, other in enumerate(names) if other == name][:2]
    rest = [other for axis, other in enumerate(names) if axis not in (first, second)]
    # The diagonal is put behind the scenes, which stay last.
    return values.diagonal(0, first, second).swapaxes(-1, -2), [*rest, name]


def _taken(values: Array, axis: int, place: int) -> Array:
    """Return one place along an axis; nothing is known of a place that there is not."""
    before = (slice(None),) * axis
    if place < values.shape[axis]:
        return values[(*before, place)]
    nobody = values[(*before, slice(0, 0))]
    return nobody.any(axis) if str(values.dtype).endswith("bool") else nobody.sum(axis)

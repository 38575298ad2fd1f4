"""Bodies with at most one variable left to bind: one loop finds all of their atoms.

Most rules are such, once the subject is known. What a search does step by step, keeping what it
has found in between, is done here in one go.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple, Self

from sfol.clauses import Body
from sfol.engines.matching import Binder, binders
from sfol.engines.tables import Tables
from sfol.facts import Bound
from sfol.literals import Criterion, Reading
from sfol.literals.search import ExhaustedError


class _Beside(NamedTuple):
    """A binary literal of the free variable and a known term.

    Attributes:
        predicate: of its atom.
        reading: its bound from that of a known atom, if it holds.
        place: of the free variable in it, 0 or 1.
        slot: of the known term.
    """

    predicate: str
    reading: Reading
    place: int
    slot: int


class Flat(NamedTuple):
    """A body whose literals bind and name at most one variable that is not given.

    Attributes:
        known: predicate, slots of the arguments and reading of each literal that is wholly known.
        free: predicate and reading of each unary literal of the free variable; at least one if
            there is such a variable.
        beside: the binary ones.
    """

    known: tuple[tuple[str, tuple[int, ...], Reading], ...]
    free: tuple[tuple[str, Reading], ...]
    beside: tuple[_Beside, ...]

    @classmethod
    def of(
        cls, body: Body, criterion: Criterion, slots: Mapping[str, int], given: frozenset[str]
    ) -> Self | None:
        """Return a body as a flat one; None if it is none.

        Args:
            body: what must hold.
            criterion: when literals hold.
            slots: where in `Search.values` each term stands.
            given: the terms that have a value beforehand, constants included.
        """
        literals = binders(body, criterion)
        left = {term for literal in body.literals for term in literal.terms} - given
        open_ = [(b, [term in left for term in b.atom.arguments]) for b in literals]
        known = [b for b, free in open_ if not any(free)]
        free = [b for b, free in open_ if free == [True]]
        beside = [b for b, free in open_ if free in ([True, False], [False, True])]
        placed = len(known) + len(free) + len(beside)
        if placed < len(body.literals) or len(left) > 1 or bool(left) != bool(free):
            return None
        return cls(
            tuple((b.atom.predicate, _slots(b, slots), b.reading) for b in known),
            tuple((b.atom.predicate, b.reading) for b in free),
            tuple(_beside(b, slots, given) for b in beside),
        )

    def bounds(self, tables: Tables, values: Sequence[str], limit: int) -> list[Bound]:
        """Return the bounds of all atoms that stand for a literal in some substitution.

        Args:
            tables: the scene.
            values: what stands in each slot.
            limit: how many known atoms may be looked at.

        Returns:
            Nothing where no substitution satisfies the body.

        Raises:
            ExhaustedError: there are more.
        """
        found: list[Bound] = []
        for predicate, places, reading in self.known:
            known = tables.rows(predicate).get(tuple([values[slot] for slot in places]))
            if known is None or (bound := reading(known)) is None:
                return []
            found.append(bound)
        if not self.free:
            return found
        of_all = len(found)
        found += self._of_each(tables, values, limit)
        return found if len(found) > of_all else []

    def _of_each(self, tables: Tables, values: Sequence[str], limit: int) -> list[Bound]:
        """Return the bounds of the literals of the free variable, for each of its values."""
        relations = [(tables.rows(predicate), reading) for predicate, reading in self.free]
        shortest: Collection[tuple[str, ...]] = min([rows for rows, _ in relations], key=len)
        if len(shortest) > limit:
            raise ExhaustedError
        pairs = [(tables.rows(p), r, place, values[slot]) for p, r, place, slot in self.beside]
        found: list[Bound] = []
        for key in shortest:
            here = []
            for rows, reading in relations:
                known = rows.get(key)
                if known is None or (bound := reading(known)) is None:
                    break
                here.append(bound)
            else:
                for rows, reading, place, other in pairs:
                    known = rows.get((other, *key) if place else (*key, other))
                    if known is None or (bound := reading(known)) is None:
                        break
                    here.append(bound)
                else:
                    found += here
        return found


def _slots(binder: Binder, slots: Mapping[str, int]) -> tuple[int, ...]:
    return tuple(slots[term] for term in binder.atom.arguments)


def _beside(binder: Binder, slots: Mapping[str, int], given: frozenset[str]) -> _Beside:
    first, second = binder.atom.arguments
    place, known = (1, first) if first in given else (0, second)
    return _Beside(binder.atom.predicate, binder.reading, place, slots[known])

"""Facts: what is known of a scene, as ground atoms with bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Set
from functools import lru_cache
from typing import Literal, NamedTuple

from sfol.arrays import as_float
from sfol.errors import FactError, did_you_mean, expect, listed
from sfol.syntax import MAXIMUM_ARITY, Atom, is_constant, is_name, parse_facts

DEFAULT_MARGIN = 0.0

Merge = Literal["replace", "maximum"]


class Bound(NamedTuple):
    """How true an atom is at least and at most: [τ⁻, τ⁺] with 0 ≤ τ⁻ ≤ τ⁺ ≤ 1.

    Source: the paper's equation for uncertainty bounds.
    """

    lower: float
    upper: float

    @property
    def midpoint(self) -> float:
        """The confidence τ̂ = (τ⁻ + τ⁺) / 2."""
        return (self.lower + self.upper) / 2

    @classmethod
    def checked(cls, lower: float, upper: float, of: str = "a bound") -> Bound:
        """Return the bound, or say why it is none.

        Args:
            lower: τ⁻.
            upper: τ⁺.
            of: what the bound belongs to, for the message.

        Raises:
            FactError: unless these are numbers with 0 ≤ lower ≤ upper ≤ 1; NaN never is.
        """
        lower, upper = _number(lower, of), _number(upper, of)
        if 0.0 <= lower <= upper <= 1.0:
            return cls(lower, upper)
        raise FactError(
            f"{of} has the bound [{lower}, {upper}]",
            name=of,
            suggestion="a bound is [lower, upper] with 0 ≤ lower ≤ upper ≤ 1",
        )

    @classmethod
    def around(cls, confidence: float, margin: float, of: str = "a bound") -> Bound:
        """Return [τ̂ − m τ̂, τ̂ + m τ̂], cut to [0, 1].

        Source: the paper, below its equation for an entity's confidence, with m = 0.05.

        Raises:
            FactError: unless confidence and margin are numbers in [0, 1].
        """
        confidence = _share(confidence, f"{of}: the confidence")
        spread = _share(margin, f"{of}: the margin") * confidence
        return cls(max(confidence - spread, 0.0), min(confidence + spread, 1.0))

    def __str__(self) -> str:
        return f"[{self.lower:.4g}, {self.upper:.4g}]"


def _number(value: object, of: str) -> float:
    """Return a number of any type, such as numpy's, as Python's own."""
    number = as_float(value)
    if number is not None:
        return number
    raise FactError(
        f"{of} has {value!r:.80} for a number", name=of, suggestion="give a single number"
    )


def _share(value: object, what: str) -> float:
    number = as_float(value)
    if number is None or not 0.0 <= number <= 1.0:
        raise FactError(
            f"{what} is {value!r:.80}", name=what, suggestion="it is a number between 0 and 1"
        )
    return number


TRUE = Bound(1.0, 1.0)

# How two different bounds of one atom become one, if the caller asks for it by name.
_MERGES: dict[Merge, Callable[[Bound, Bound], Bound]] = {
    "replace": lambda _, new: new,
    "maximum": lambda old, new: Bound(max(old.lower, new.lower), max(old.upper, new.upper)),
}

Relation = Mapping[tuple[str, ...], Bound]
Values = Mapping[str, Mapping[tuple[str, ...], float]]  # attribute → constants → value


class Facts:
    """A set of ground atoms, each with its bound, and of values. What is not in it is unknown.

    Args:
        margin: m, the share of a confidence by which its bound reaches down and up.

    Example:
        >>> facts = Facts.parse("Vehicle(ego). Pedestrian(p1): [0.76, 0.84].")
        >>> facts.add("OnRoad", "p1")
        >>> facts.bound("Pedestrian", "p1").midpoint
        0.8
        >>> facts.add("Distance", "p1", "ego", value=7.5)
        >>> facts.value("Distance", "p1", "ego")
        7.5
    """

    __slots__ = ("_relations", "_values", "margin")

    def __init__(self, *, margin: float = DEFAULT_MARGIN) -> None:
        self.margin = _share(margin, "the margin")
        self._relations: dict[str, dict[tuple[str, ...], Bound]] = {}
        self._values: dict[str, dict[tuple[str, ...], float]] = {}

    @classmethod
    def parse(cls, text: str | Iterable[str], *, margin: float = DEFAULT_MARGIN) -> Facts:
        """Read facts from their text, or from several texts.

        Args:
            text: such as ``Vehicle(ego). Pedestrian(p1): [0.76, 0.84]. OnRoad(p1): 0.9.``; a
                number alone is a confidence. ``Distance(p1, ego) = 7.5.`` is a value.
            margin: see `Facts`.

        Raises:
            ClauseError: the text is not a list of facts.
            FactError: a bound is none, or an atom stands twice with different bounds or values.
        """
        facts = cls(margin=margin)
        texts = [text] if isinstance(text, str) else text
        for part in listed(texts, "facts", "give a text, or a list of texts"):
            for atom, bound, confidence, value in parse_facts(part):
                facts.add(*_flat(atom), bound=bound, confidence=confidence, value=value)
        return facts

    def add(
        self,
        predicate: str,
        *constants: str,
        confidence: float | None = None,
        bound: tuple[float, float] | None = None,
        value: float | None = None,
        merge: Merge | None = None,
    ) -> None:
        """Assert an atom; without bound and confidence it is [1, 1]. Or say a value.

        Args:
            predicate: its name, or that of the attribute which has the value.
            constants: the names of entities, four at most.
            confidence: τ̂ in [0, 1]; the margin makes it a bound.
            bound: (lower, upper), instead of a confidence.
            value: a finite number in the unit of the attribute, instead of them.
            merge: what to do if the atom is known with another bound or value; None is an error.

        Raises:
            FactError: a name, a bound, a value or the number of constants is wrong, or the atom
                is already known with another bound or value.
        """
        if value is not None:
            if bound is not None or confidence is not None:
                raise FactError(
                    f"{predicate} has a value and a bound",
                    name=predicate,
                    suggestion="give one of them: an attribute has values, a predicate bounds",
                )
            self._add_value(predicate, constants, value, merge)
            return
        if bound is None and confidence is None:
            new = TRUE
        else:
            new = self._new_bound(predicate, constants, confidence, bound)
        try:
            relation = self._relations.get(predicate)
            old = None if relation is None else relation.get(constants)
        except TypeError:  # what can't be a key is no name either, and is refused as such
            relation = old = None
        if relation is None:
            _check_new(predicate, constants)
            self._relations[predicate] = {constants: new}
            return
        if old is None:
            _check_atom(predicate, constants, relation)
        elif old != new:
            new = _MERGES[self._merge(Atom(predicate, constants), old, new, merge)](old, new)
        relation[constants] = new

    def bound(self, predicate: str, *constants: str) -> Bound | None:
        """Return the bound of an atom, or None if it is unknown."""
        try:
            return self._relations.get(predicate, {}).get(constants)
        except TypeError:  # what can't be a key is no name either
            return None

    def value(self, attribute: str, *constants: str) -> float | None:
        """Return the value of an attribute, or None if it is unknown."""
        try:
            return self._values.get(attribute, {}).get(constants)
        except TypeError:  # what can't be a key is no name either
            return None

    def values(self) -> Values:
        """Return every value: attribute → constants → value; do not change it."""
        return self._values

    def relation(self, predicate: str) -> Relation:
        """Return the constants and bounds of every atom of a predicate; do not change it."""
        expect(predicate, str, "a predicate", "give its name")
        return self._relations.get(predicate, {})

    def relations(self) -> Mapping[str, Relation]:
        """Return what `relation` returns of every predicate of which something is known."""
        return self._relations

    def predicates(self) -> Set[str]:
        """Return the predicates of which something is known."""
        return self._relations.keys()

    def entities(self) -> tuple[str, ...]:
        """Return every constant once, in the order in which they were first named."""
        return tuple(dict.fromkeys(name for atom in self for name in atom.arguments))

    def about(self, entity: str) -> Facts:
        """Return the facts that name an entity."""
        expect(entity, str, "an entity", "give its name")
        chosen = Facts(margin=self.margin)
        for atom, bound in self.items():
            if entity in atom.arguments:
                chosen.add(*_flat(atom), bound=bound)
        for attribute, known in self._values.items():
            own = {names: value for names, value in known.items() if entity in names}
            if own:
                chosen._values[attribute] = own
        return chosen

    def items(self) -> Iterator[tuple[Atom, Bound]]:
        """Yield every atom with its bound; values are apart, in `values`."""
        for predicate, relation in self._relations.items():
            for constants, bound in relation.items():
                yield Atom(predicate, constants), bound

    def copy(self) -> Facts:
        """Return an independent copy."""
        twin = Facts(margin=self.margin)
        twin._relations = {name: dict(relation) for name, relation in self._relations.items()}
        twin._values = {name: dict(values) for name, values in self._values.items()}
        return twin

    def restricted(self, predicates: Container[str], attributes: Container[str]) -> Facts:
        """Return what is known of some predicates and attributes; it is not copied."""
        twin = Facts(margin=self.margin)
        twin._relations = {n: rows for n, rows in self._relations.items() if n in predicates}
        twin._values = {name: rows for name, rows in self._values.items() if name in attributes}
        return twin

    def extended(self, relations: Mapping[str, dict[tuple[str, ...], Bound]]) -> Facts:
        """Return these facts and further ones, whose names and bounds are taken unchecked.

        Args:
            relations: predicate → constants → bound, in place of what is known of a predicate;
                they are not copied.
        """
        twin = Facts(margin=self.margin)
        more = {name: relation for name, relation in relations.items() if relation}
        twin._relations = {**self._relations, **more}
        twin._values = self._values
        return twin

    def __iter__(self) -> Iterator[Atom]:
        for known in (self._relations, self._values):
            for name, rows in known.items():
                yield from (Atom(name, constants) for constants in rows)

    def __len__(self) -> int:
        bounds = sum(map(len, self._relations.values()))
        return bounds + sum(map(len, self._values.values()))

    def __contains__(self, atom: object) -> bool:
        if not isinstance(atom, tuple) or not atom:
            return False
        predicate, *constants = _flat(atom) if isinstance(atom, Atom) else atom
        known = self.bound(predicate, *constants)
        return known is not None or self.value(predicate, *constants) is not None

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Facts)
            and dict(self.items()) == dict(other.items())
            and self._values == other._values
        )

    __hash__ = None  # type: ignore[assignment]  # facts change in place

    def __str__(self) -> str:
        bounds = [_fact_text(atom, bound) for atom, bound in self.items()]
        return "\n".join([*bounds, *self._value_texts()])

    def __repr__(self) -> str:
        return f"<Facts: {len(self)} about {len(self.entities())} entities>"

    def _value_texts(self) -> Iterator[str]:
        for attribute, known in self._values.items():
            for constants, value in known.items():
                yield f"{Atom(attribute, constants)} = {value!r}."

    def _add_value(
        self, attribute: str, constants: tuple[str, ...], given: object, merge: Merge | None
    ) -> None:
        value = as_float(given)
        if value is None or not math.isfinite(value):
            raise FactError(
                f"{attribute} has {given!r:.80} for a value",
                name=attribute,
                suggestion="give a finite number, or leave out what is not known",
            )
        known = self._values.get(attribute, {}) if isinstance(attribute, str) else {}
        if known:
            _check_atom(attribute, constants, known)
        else:
            _check_new(attribute, constants)
        old = known.get(constants, value)
        if old != value:
            how = self._merge(Atom(attribute, constants), old, value, merge)
            value = max(old, value) if how == "maximum" else value
        self._values.setdefault(attribute, {})[constants] = value

    def _new_bound(
        self,
        predicate: str,
        constants: tuple[str, ...],
        confidence: float | None,
        bound: tuple[float, float] | None,
    ) -> Bound:
        if type(bound) is Bound and confidence is None:
            lower, upper = bound  # of Python's own type in nearly all calls: spare the text below
            if type(lower) is type(upper) is float and 0.0 <= lower <= upper <= 1.0:
                return bound
        atom = f"{predicate}({', '.join(map(str, constants))})" if constants else predicate
        if bound is None:
            assert confidence is not None
            return Bound.around(confidence, self.margin, atom)
        if confidence is not None:
            raise FactError(
                f"{atom} has a bound and a confidence", name=atom, suggestion="give one of them"
            )
        if not isinstance(bound, tuple | list) or len(bound) != 2:
            raise FactError(
                f"{atom} has {bound!r:.80} for a bound",
                name=atom,
                suggestion="a bound is (lower, upper)",
            )
        return Bound.checked(*bound, of=atom)

    @staticmethod
    def _merge(atom: Atom, old: object, new: object, merge: Merge | None) -> Merge:
        if merge is None:
            raise FactError(
                f"{atom} is asserted twice, with {old} and {new}",
                name=str(atom),
                suggestion="name a merge: merge='replace' or merge='maximum'",
            )
        if merge not in _MERGES:
            raise FactError(
                f"'{merge}' is no merge", name=merge, suggestion=did_you_mean(merge, _MERGES)
            )
        return merge


def _flat(atom: Atom | tuple[str, ...]) -> tuple[str, ...]:
    return (atom.predicate, *atom.arguments) if isinstance(atom, Atom) else atom


def _fact_text(atom: Atom, bound: Bound) -> str:
    if bound == TRUE:
        return f"{atom}."
    # repr keeps every digit, so that parsing gives the same bound again
    return f"{atom}: [{bound.lower!r}, {bound.upper!r}]."


def _check_new(predicate: str, constants: tuple[str, ...]) -> None:
    """Check the first atom of a predicate."""
    if not isinstance(predicate, str) or not is_name(predicate):
        raise FactError(f"'{predicate}' is not a predicate", name=predicate)
    if len(constants) > MAXIMUM_ARITY:
        raise FactError(
            f"'{predicate}' has {len(constants)} constants",
            name=predicate,
            suggestion=f"an atom has {MAXIMUM_ARITY} at most",
        )
    _check_atom(predicate, constants, {})


def _check_atom(
    predicate: str, constants: tuple[str, ...], relation: Mapping[tuple[str, ...], object]
) -> None:
    for constant in constants:
        if not (isinstance(constant, str) and _names_an_entity(constant)):
            raise FactError(
                f"'{constant}' in {predicate} is not a constant",
                name=str(constant),
                suggestion="a constant is a text: a name that begins with a lower-case letter, an "
                "integer, or what sfol.constant(…) makes of any text",
            )
    elsewhere = len(next(iter(relation))) if relation else len(constants)
    if elsewhere != len(constants):
        raise FactError(
            f"'{predicate}' has {len(constants)} constants here and {elsewhere} elsewhere",
            name=predicate,
        )


@lru_cache(maxsize=65_536)  # the same few names come at every step
def _names_an_entity(name: str) -> bool:
    return is_constant(name)

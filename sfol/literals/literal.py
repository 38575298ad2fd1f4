"""What every kind of body literal answers; readers of rules and engines ask nothing else."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import ClassVar, NamedTuple, Protocol, Self

from sfol.arrays import Array, Backend
from sfol.errors import KnowledgeBaseError
from sfol.facts import Bound
from sfol.literals.search import Constants, Rows, Scene, Step
from sfol.syntax import Atom, Derived, Reader


class Thresholds(Protocol):
    """What a rule asks of its literals."""

    @property
    def threshold(self) -> float:
        """The least lower bound of a positive literal."""
        ...

    @property
    def negation_threshold(self) -> float:
        """The least lower bound, 1 − u, of a negated literal."""
        ...


class BatchBounds(Protocol):
    """The bounds of a batch's atoms; `rows` are the numbers of some of them, K.

    Attributes:
        backend: the operations on the arrays that it gives.
    """

    backend: Backend

    def lower(self, rows: Array) -> Array:
        """Return the lower bounds, float (K,); they mean nothing where an atom is unknown."""
        ...

    def upper(self, rows: Array) -> Array:
        """Return the upper bounds, float (K,)."""
        ...

    def known(self, rows: Array) -> Array:
        """Tell which atoms are known, bool (K,)."""
        ...

    def possible(self, rows: Array) -> Array:
        """Tell which atoms are known and have an upper bound above 0, bool (K,)."""
        ...


class QueryClause(NamedTuple):
    """One clause in the body of a PyReason rule.

    Attributes:
        predicate: as PyReason knows it.
        terms: variables and constants, one or two: PyReason has no more.
        threshold: the least lower bound.
        counts: whether its bounds take part in the conjunction.
        symmetric: whether its terms may change places.
    """

    predicate: str
    terms: Constants
    threshold: float
    counts: bool = True
    symmetric: bool = False

    def __str__(self) -> str:
        return f"{self.predicate}({','.join(self.terms)}):[{self.threshold!r},1]"


def queried(predicate: str) -> str:
    """Return what PyReason calls a predicate: it could not read what an operation says of atoms."""
    return f"said.{predicate.encode().hex()}" if isinstance(predicate, Derived) else predicate


# The bound of a literal, given that of its known atom; None if the literal does not hold.
Reading = Callable[[Bound], Bound | None]
# How literals are read: each rule, and each condition of an entity's weight, has its own way.
Criterion = Callable[["AtomLiteral"], Reading]


class Literal(ABC):
    """One element of a body: a statement about terms that holds under a substitution, or not.

    Subclasses are frozen dataclasses. A literal that stands for no atom is a guard: it is true or
    false, and takes no part in the conjunction; or a count, which engines put an atom in place of.

    Attributes:
        binds: whether it is matched by looking through the known atoms of its predicate, so that
            its variables get their values from it; otherwise it is tested once they have some.
        monotone: whether further facts, and greater bounds, can make it hold but never fail.
    """

    binds: ClassVar[bool] = False
    monotone: ClassVar[bool] = True

    # -- text -----------------------------------------------------------------------------------

    @classmethod
    @abstractmethod
    def parse(cls, reader: Reader) -> Self | None:
        """Read a literal of this kind, or nothing if the next tokens begin another kind.

        Raises:
            ClauseError: it begins like this kind, and goes on in another way.
        """

    @abstractmethod
    def __str__(self) -> str:
        """Return the text from which the same literal is read."""

    # -- terms ----------------------------------------------------------------------------------

    @property
    @abstractmethod
    def terms(self) -> tuple[str, ...]:
        """The variables and constants that it names, in the order of its text."""

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """The atoms that it reads; they must fit the declared predicates."""
        return ()

    @abstractmethod
    def substituted(self, values: Mapping[str, str]) -> Self:
        """Return the literal with the terms that have a value replaced by it."""

    def named_apart(self, names: Iterator[str]) -> Self:
        """Return the literal with each anonymous variable that it binds called by another name."""
        return self

    def faults(self) -> Iterator[tuple[str, str, str]]:
        """Yield what is wrong with it inside: a name, the message and what to do."""
        return iter(())

    @abstractmethod
    def matched(self, target: Literal, values: Mapping[str, str]) -> Mapping[str, str] | None:
        """Return the substitution, extended so that it turns this literal into the target.

        Args:
            target: a literal of any kind; its variables are taken as they stand.
            values: what variables of this literal stand for already.

        Returns:
            None if no substitution does.
        """

    @classmethod
    def opposite_of(cls, literal: Literal) -> Literal | None:
        """Return what says that a literal is not so, if this kind can tell; else None."""
        return None

    def never_holds(self) -> bool:
        """Tell whether it is false under every substitution and in every scene."""
        return False

    # -- search ---------------------------------------------------------------------------------

    def step(self, number: int, slots: Mapping[str, int], criterion: Criterion, then: Step) -> Step:
        """Return the step of a plan that tests it; all its terms have values by then.

        It is called once for a plan, and the step often, so what can be looked up stands outside
        of the step. Literals that bind are matched by the plan itself and need none.

        Args:
            number: its own in the body, by which the search keeps the key and bound of its atom.
            slots: where in `Search.values` each term stands.
            criterion: when literals hold.
            then: the next step, to be called if it holds.

        Raises:
            NotImplementedError: it binds, so that no plan asks for its step; a new kind of literal
                that does not bind has to say how it is tested.
        """
        raise NotImplementedError(f"'{self}' is not tested")

    # -- arrays ---------------------------------------------------------------------------------

    def holds_among(self, numbers: Callable[[str], Array]) -> Array:
        """Tell where a guard holds, for all values of its terms at once.

        Args:
            numbers: term → the numbers of the entities that it may be, which differ between
                entities, along an axis of its own.

        Raises:
            NotImplementedError: it stands for an atom, or a new kind of guard does not say.
        """
        raise NotImplementedError(f"'{self}' is no guard")

    # -- explanation ----------------------------------------------------------------------------

    @abstractmethod
    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        """Return why it does not hold, to be read after "lacks"; it must be ground."""

    # -- PyReason -------------------------------------------------------------------------------

    def query(self, thresholds: Thresholds) -> QueryClause:
        """Return it as PyReason says it.

        Raises:
            KnowledgeBaseError: PyReason can't say it.
        """
        raise KnowledgeBaseError(
            f"PyReason can't express the literal '{self}'",
            name=str(self),
            suggestion="use engine='compiled'",
        )

    def query_rows(self, scene: Scene, domain: Sequence[str]) -> Rows:
        """Return the atoms of its query's predicate in a scene: arguments → bound.

        Args:
            scene: the known atoms.
            domain: every constant.
        """
        return {}


class AtomLiteral(Literal):
    """A literal that stands for an atom, and has a bound that takes part in the conjunction.

    Attributes:
        atom: the atom.
    """

    atom: Atom

    @property
    def terms(self) -> tuple[str, ...]:
        """The variables and constants that it names, in the order of its text."""
        return self.atom.arguments

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """The atoms that it reads; they must fit the declared predicates."""
        return self.atom.plain

    def known(self, scene: Scene) -> Bound | None:
        """Return what is known of its atom in a scene; it must be ground."""
        return scene.bound(self.atom)

    @abstractmethod
    def bound(self, known: Bound | None) -> Bound | None:
        """Return its bound from that of its ground atom; None stands for unknown."""

    @abstractmethod
    def holds(self, thresholds: Thresholds) -> Reading:
        """Return its reading in a rule; where it holds, it has the bound that `bound` returns."""

    @abstractmethod
    def reaches(self, confidence: float) -> Reading:
        """Return its reading where it holds if its confidence is at least so much."""

    @abstractmethod
    def batch_bounds(self, atoms: BatchBounds, rows: Array) -> tuple[Array, Array]:
        """Return its lower and upper bounds, as `bound` does, at some atoms of a batch.

        Args:
            atoms: the bounds of the batch.
            rows: (K,), the numbers of the atoms that it stands for.
        """

    @abstractmethod
    def batch_holds(self, atoms: BatchBounds, rows: Array, thresholds: Thresholds) -> Array:
        """Tell where it holds, as a search does, at some atoms of a batch: bool (K,)."""

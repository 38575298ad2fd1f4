"""The kinds of body literal, a module for each.

A kind is a class that says how its literals are read and printed, matched or tested in a search,
evaluated in a batch, explained, and put to PyReason. `Literal` says what is asked of it; what an
engine does with a body never depends on the kind. A count or a forall is put into rules of its own
before an engine sees it (`sfol.engines.quantified`).

To add one, write its module here and its line in `KINDS`, and in `sfol.syntax.OPERATORS` if it
has an operator of its own. Two readings are kept apart on purpose: how the tests draw it at random
(`sfol.testing.strategies`), and what it means by the letter (`sfol.testing.naive`). Tests fail as
long as either is missing.

May import sfol's ground and nothing above it.
"""

from sfol.literals.count import Count, Counted
from sfol.literals.forall import ForAll, NoCounterexample, Ranging
from sfol.literals.literal import AtomLiteral, Criterion, Literal, QueryClause, Reading
from sfol.literals.negated import Negated
from sfol.literals.not_equal import NotEqual
from sfol.literals.positive import Positive
from sfol.literals.quantified import Quantified
from sfol.literals.search import Search, Step

# In the order in which a reader tries them: an atom is what remains.
KINDS: tuple[type[Literal], ...] = (Count, ForAll, Negated, NotEqual, Positive)

__all__ = [
    "KINDS",
    "AtomLiteral",
    "Count",
    "Counted",
    "Criterion",
    "ForAll",
    "Literal",
    "Negated",
    "NoCounterexample",
    "NotEqual",
    "Positive",
    "Quantified",
    "QueryClause",
    "Ranging",
    "Reading",
    "Search",
    "Step",
]

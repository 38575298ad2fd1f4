"""Batches: many scenes, encoded once and evaluated many times.

Which atoms could support which conclusion does not depend on bounds, so it is found once, when a
batch is encoded, and kept as arrays of row numbers. Evaluation is arithmetic on bounds alone: it
runs on numpy arrays and torch tensors, and gradients go through it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.arrays import Array, Indices
from sfol.engines.program import Program
from sfol.engines.tables import Tables
from sfol.errors import FactError
from sfol.facts import TRUE, Bound, Facts
from sfol.knowledge_base import Rule
from sfol.knowledge_base.recursion import Component
from sfol.literals import AtomLiteral, Reading, Search
from sfol.literals.search import Constants, matching
from sfol.syntax import Atom


def _any_bound(literal: AtomLiteral) -> Reading:
    """Let a literal hold at every bound: at which ones it does is decided at evaluation."""
    return lambda known: known


@dataclass(frozen=True, eq=False)
class Pairs:
    """The distinct pairs of a head atom and an atom that stands for one literal of its rule.

    Attributes:
        of: for every substitution, its pair.
        heads: for every pair, its head atom, as a number within the stratum.
        rows: for every pair, its literal's atom, as a row of the batch.
    """

    of: Indices
    heads: Indices
    rows: Indices


@dataclass(frozen=True, eq=False)
class Groundings:
    """Every substitution that could satisfy a rule's body.

    Attributes:
        rule: the rule.
        heads: for every substitution, its head atom, as a number within the stratum.
        rows: for every literal, and every substitution, the atom's row in the batch.
        pairs: for every literal, its distinct pairs.
    """

    rule: Rule
    heads: Indices
    rows: tuple[Indices, ...]
    pairs: tuple[Pairs, ...]

    @property
    def literals(self) -> tuple[AtomLiteral, ...]:
        """The literals of the rule's body, in the order of `rows` and `pairs`."""
        return self.rule.clause.body.atom_literals


@dataclass(frozen=True, eq=False)
class Patterns:
    """The patterns that negated literals read, such as Near(p1, _): each is its greatest atom.

    Attributes:
        rows: the row of each pattern in the batch.
        of: for every atom that some pattern stands for, that pattern's place in `rows`.
        atoms: the row of each such atom.
    """

    rows: Indices
    of: Indices
    atoms: Indices


@dataclass(frozen=True, eq=False)
class Stratum:
    """The atoms of one head predicate that could be concluded.

    Attributes:
        head: the predicate.
        rows: the row of each atom in the batch.
        scenes: for every atom, the scene in which it is the subject's, or -1.
        rules: how its rules could conclude them.
        patterns: what of their literals has to be found beforehand; None if nothing has.
    """

    head: str
    rows: Indices
    scenes: Indices
    rules: tuple[Groundings, ...]
    patterns: Patterns | None


@dataclass(frozen=True, eq=False)
class Batch:
    """Many scenes under one knowledge base; made by `RewardFunction.batch`.

    Attributes:
        size: number of scenes, B.
        atoms: every atom that is known, could be concluded, or is read by a negated literal, with
            its scene; N of them.
        lower: float64 (N,), τ⁻ of each. May be replaced by a tensor, see `with_bounds`.
        upper: float64 (N,), τ⁺ of each.
        known: bool (N,), whether an atom is asserted or in the background.
        strata: how conclusions could be drawn, in their order.
        program: the program for which the batch was encoded.
    """

    size: int
    atoms: tuple[tuple[int, Atom], ...]
    lower: Array
    upper: Array
    known: npt.NDArray[np.bool_]
    strata: tuple[Stratum, ...]
    program: Program

    def with_bounds(self, lower: Array, upper: Array) -> Batch:
        """Return the same scenes with other bounds, such as tensors that require gradients.

        Args:
            lower: (N,), as `lower`.
            upper: (N,), as `upper`.

        Raises:
            FactError: these are no arrays of real numbers (N,), or an atom has no bound there:
                0 ≤ lower ≤ upper ≤ 1 wherever an atom is known.
        """
        count = len(self.atoms)
        for ends in (lower, upper):
            shape = tuple(getattr(ends, "shape", ()))
            if not arrays.is_array(ends) or shape != (count,) or not arrays.is_real(ends):
                raise FactError(
                    f"the bounds of a batch are {type(ends).__name__} of shape {shape}",
                    suggestion=f"give an array or tensor of real numbers, of shape ({count},)",
                )
        fit = ((lower >= 0.0) & (lower <= upper) & (upper <= 1.0)).tolist()
        for row in np.flatnonzero(self.known & ~np.array(fit, dtype=np.bool_)):
            scene, atom = self.atoms[row]
            Bound.checked(lower[row], upper[row], of=f"{atom} in scene {scene}")
        return replace(self, lower=lower, upper=upper)

    def __len__(self) -> int:
        return self.size

    def __repr__(self) -> str:
        return f"<Batch: {self.size} scenes, {len(self.atoms)} atoms>"


def encode(program: Program, scenes: Sequence[Facts]) -> Batch:
    """Return a batch of scenes.

    Args:
        program: of the knowledge base under which they are evaluated.
        scenes: the facts of each; they are copied.

    Raises:
        FactError: a fact does not fit the knowledge base.
    """
    encoder = _Encoder(program)
    for facts in scenes:
        encoder.add(facts)
    return encoder.batch()


class _Encoder:
    """Collects rows scene by scene."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._size = 0
        self._atoms: list[tuple[int, Atom]] = []
        self._bounds: list[tuple[float, float]] = []
        self._known: list[bool] = []
        self._heads = [_HeadRows(program, head) for head in program.heads]

    def add(self, facts: Facts) -> None:
        tables = self._program.tables(facts)
        rows: dict[tuple[str, Constants], int] = {}
        for atom, bound in tables.items():
            rows[atom] = self._new_row(atom, bound, known=True)
        for head in self._heads:
            if head.name in self._program.recursive:
                self._put_possible(self._program.recursive[head.name], tables, rows)
            concluded = head.substitutions(tables)
            subject = self._program.subject_heads.get(head.name)
            # The subject's asserted heads count without any rule.
            asserted = [subject] if subject is not None and subject in rows else []
            for atom in dict.fromkeys([*asserted, *(atom for atom, _, _ in concluded)]):
                if atom not in rows:
                    rows[atom] = self._new_row(atom, (0.0, 0.0), known=False)
                    tables.put(atom, TRUE)
                head.number(atom, rows[atom], self._size if atom == subject else -1)
            for read in (read for _, _, atoms in concluded for read in atoms):
                if read not in rows:  # unknown, or a pattern, in a negated literal
                    rows[read] = self._new_row(Atom(*read), (0.0, 0.0), known=False)
                if Atom(*read).is_pattern:
                    head.read_pattern(Atom(*read), tables, rows)
            head.extend(concluded, rows)
        self._size += 1

    def batch(self) -> Batch:
        bounds = np.array(self._bounds, dtype=np.float64).reshape(-1, 2)
        return Batch(
            size=self._size,
            atoms=tuple(self._atoms),
            lower=bounds[:, 0].copy(),
            upper=bounds[:, 1].copy(),
            known=np.array(self._known, dtype=np.bool_),
            strata=tuple(head.stratum(len(self._atoms)) for head in self._heads),
            program=self._program,
        )

    def _put_possible(
        self, stratum: Component, tables: Tables, rows: dict[tuple[str, Constants], int]
    ) -> None:
        """Give every atom a row that heads which depend on each other could conclude."""
        heads = [head for head in self._heads if head.name in stratum.predicates]
        while new := {
            atom: TRUE
            for head in heads
            for atom, _, _ in head.substitutions(tables)
            if atom not in rows
        }:
            rows.update((atom, self._new_row(atom, (0.0, 0.0), known=False)) for atom in new)
            tables.revise(new)

    def _new_row(self, atom: Atom, bound: tuple[float, float], *, known: bool) -> int:
        self._atoms.append((self._size, atom))
        self._bounds.append(bound)
        self._known.append(known)
        return len(self._atoms) - 1


# A head atom, the number of its rule, and the ground atoms of the body's literals.
_Substitution = tuple[Atom, int, list[tuple[str, Constants]]]


class _HeadRows:
    """Collects how the atoms of one head could be concluded."""

    def __init__(self, program: Program, head: str) -> None:
        self.name = head
        self._numbers: dict[Atom, int] = {}
        self._rows: list[int] = []
        self._scenes: list[int] = []
        self._rules = list(program.plans(head, _any_bound))
        self._found: list[list[tuple[int, ...]]] = [[] for _ in self._rules]
        self._patterns: dict[int, list[int]] = {}

    def substitutions(self, tables: Tables) -> list[_Substitution]:
        """Return every substitution that could conclude an atom of the head in a scene."""
        found: list[_Substitution] = []
        for number, (rule, plan, given) in enumerate(self._rules):
            head_of = plan.reader(rule.clause.head)
            predicates = [literal.atom.predicate for literal in rule.clause.body.atom_literals]

            def visit(
                search: Search,
                number: int = number,
                head_of: Callable[[Search], Constants] = head_of,
                predicates: Sequence[str] = predicates,
            ) -> None:
                atoms = list(zip(predicates, search.keys, strict=True))
                found.append((Atom(self.name, head_of(search)), number, atoms))

            plan.search(tables, visit, given)
        return found

    def number(self, atom: Atom, row: int, scene: int) -> None:
        """Give a head atom of the current scene its number within the stratum."""
        self._numbers[atom] = len(self._rows)
        self._rows.append(row)
        self._scenes.append(scene)

    def read_pattern(
        self, pattern: Atom, tables: Tables, rows: Mapping[tuple[str, Constants], int]
    ) -> None:
        """Keep which atoms of the current scene a pattern stands for."""
        if rows[pattern] not in self._patterns:
            found = matching(tables, pattern)
            self._patterns[rows[pattern]] = [rows[pattern.predicate, key] for key, _ in found]

    def extend(
        self, concluded: Sequence[_Substitution], rows: Mapping[tuple[str, Constants], int]
    ) -> None:
        """Keep the substitutions of the current scene."""
        for head, number, atoms in concluded:
            self._found[number].append((self._numbers[head], *(rows[atom] for atom in atoms)))
        self._numbers.clear()

    def stratum(self, atoms: int) -> Stratum:
        """Return what was collected as arrays.

        Args:
            atoms: N, the number of rows of the batch.
        """
        return Stratum(
            head=self.name,
            rows=np.array(self._rows, dtype=np.intp),
            scenes=np.array(self._scenes, dtype=np.intp),
            rules=tuple(
                _groundings(rule, found, atoms)
                for (rule, _, _), found in zip(self._rules, self._found, strict=True)
            ),
            patterns=_patterns(self._patterns) if self._patterns else None,
        )


def _patterns(found: Mapping[int, Sequence[int]]) -> Patterns:
    return Patterns(
        np.array([*found], dtype=np.intp),
        np.array([i for i, atoms in enumerate(found.values()) for _ in atoms], dtype=np.intp),
        np.array([atom for atoms in found.values() for atom in atoms], dtype=np.intp),
    )


def _groundings(rule: Rule, found: Sequence[tuple[int, ...]], atoms: int) -> Groundings:
    literals = len(rule.clause.body.atom_literals)
    table = np.array(found, dtype=np.intp).reshape(-1, literals + 1)
    heads, rows = table[:, 0].copy(), tuple(table[:, 1:].T.copy())
    return Groundings(rule, heads, rows, tuple(_pairs(heads, row, atoms) for row in rows))


def _pairs(heads: Indices, rows: Indices, atoms: int) -> Pairs:
    distinct, of = np.unique(heads * atoms + rows, return_inverse=True)
    return Pairs(of, *np.divmod(distinct, max(atoms, 1)))

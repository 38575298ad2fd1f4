"""Constants as PyReason can read them: it splits its texts at commas, brackets and blanks.

An integer or a quoted text becomes a name with a dot, which no constant of a knowledge base has;
any other constant stays as it is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from sfol.clauses import Body, Clause
from sfol.engines.pyreason_program import TraceRow
from sfol.engines.tables import Tables
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.syntax import Atom, constant, is_name, is_variable

_INTEGER: Final = "integer."
_NEGATIVE: Final = "minus."
_TEXT: Final = "text."


def coded(term: str) -> str:
    """Return the name of a constant for PyReason; a variable stays as it is."""
    if is_variable(term) or is_name(term):
        return term
    if term[0] in "\"'":
        return f"{_TEXT}{term[1:-1].encode().hex()}"
    return f"{_NEGATIVE}{term[1:]}" if term[0] == "-" else f"{_INTEGER}{term}"


def decoded(name: str) -> str:
    """Return the constant that a name for PyReason stands for."""
    if name.startswith(_TEXT):
        return constant(bytes.fromhex(name.removeprefix(_TEXT)).decode())
    if name.startswith(_NEGATIVE):
        return f"-{name.removeprefix(_NEGATIVE)}"
    return name.removeprefix(_INTEGER)


def coded_atom(atom: Atom) -> Atom:
    """Return an atom with its constants as PyReason can read them."""
    return Atom(atom.predicate, tuple(map(coded, atom.arguments)))


def decoded_atom(atom: Atom) -> Atom:
    """Return the atom that one of PyReason's stands for."""
    return Atom(atom.predicate, tuple(map(decoded, atom.arguments)))


def coded_knowledge_base(kb: KnowledgeBase) -> KnowledgeBase:
    """Return a knowledge base that names constants in its rules as PyReason can read them."""
    rules = {name: _coded_rule(rule) for name, rule in kb.rules.items()}
    return replace(kb, subject=coded(kb.subject), rules=rules)


def _coded_rule(rule: Rule) -> Rule:
    head, body = rule.clause.head, rule.clause.body
    codes = {term: coded(term) for term in (*head.arguments, *body.terms)}
    literals = tuple(literal.substituted(codes) for literal in body.literals)
    return replace(rule, clause=Clause(head.substituted(codes), Body(literals)))


def coded_tables(tables: Tables) -> Tables:
    """Return the known atoms of a scene with their constants as PyReason can read them."""
    renamed = type(tables)({})
    for atom, bound in tables.items():
        renamed.put(coded_atom(atom), bound)
    return renamed


def decoded_row(row: TraceRow) -> TraceRow:
    """Return a row of PyReason's trace with the constants that its names stand for."""
    clauses = tuple((text, tuple(map(decoded_atom, atoms))) for text, atoms in row.clauses)
    return row._replace(head=decoded_atom(row.head), clauses=clauses)

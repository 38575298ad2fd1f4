"""PyReason itself: imported with care, set up in full and run, one program at a time.

PyReason keeps its program in global variables and its settings over `reset`, so every run makes
everything anew under one lock, and sets every setting.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from sfol.engines.pyreason_program import Query, Script, TraceRow, joined
from sfol.errors import UsageError, missing_extra
from sfol.facts import Bound
from sfol.literals import QueryClause
from sfol.operators import CONJUNCTIONS, DISJUNCTIONS
from sfol.syntax import Atom

_lock = threading.RLock()

# All that PyReason has, but for names of files that are not written.
_SETTINGS: dict[str, bool | str] = {
    "verbose": False,
    "output_to_file": False,
    "graph_attribute_parsing": False,
    "abort_on_inconsistency": False,
    "memory_profile": False,
    "reverse_digraph": False,
    "atom_trace": False,
    "save_graph_attributes_to_trace": False,
    "persistent": False,
    "inconsistency_check": True,
    "static_graph_facts": False,
    "store_interpretation_changes": True,
    "parallel_computing": False,
    "update_mode": "intersection",
    "allow_ground_rules": True,
    "fp_version": False,
}


@contextlib.contextmanager
def _kept_environment(name: str) -> Iterator[None]:
    before = os.environ.get(name)
    try:
        yield
    finally:
        os.environ.pop(name, None)
        if before is not None:
            os.environ[name] = before


def _import_pyreason() -> ModuleType:
    # It sets this variable for the whole process, and prints.
    with _kept_environment("NUMBA_CACHE_DIR"), contextlib.redirect_stdout(io.StringIO()):
        try:
            module = importlib.import_module("pyreason")
            _cache_containers()
        except ImportError as error:
            raise missing_extra(
                "pyreason", "the engine 'pyreason' needs it", extra="pyreason"
            ) from error
        except (OSError, RuntimeError) as error:
            raise UsageError(
                f"PyReason can't write into its own folder: {error}",
                name="pyreason",
                suggestion="install it where you may write, such as a virtual environment",
            ) from error
        return module


def _cache_containers() -> None:
    """Let numba keep on disk what it compiles of its typed lists and dictionaries.

    It does not by itself. PyReason uses some sixty of their methods, each with its own types; to
    compile them takes ten seconds in every process, to find them in the cache a tenth of that.
    """
    dispatcher = importlib.import_module("numba.core.dispatcher").Dispatcher
    for name in ("numba.typed.typedlist", "numba.typed.typeddict"):
        for function in vars(importlib.import_module(name)).values():
            if isinstance(function, dispatcher):
                function.enable_caching()


_pyreason = _import_pyreason()
_numba = importlib.import_module("numba")
_networkx = importlib.import_module("networkx")
_objmode = _numba.objmode


# -- annotation functions -------------------------------------------------------------------------
#
# PyReason calls the function that a head names with the bounds that satisfied each clause. Only
# the way there is compiled; the operators are those of every engine.


def _pooled(lowers: Any, uppers: Any) -> tuple[float, ...]:
    bounds = [Bound(*pair) for pair in zip(lowers.tolist(), uppers.tolist(), strict=True)]
    return tuple(CONJUNCTIONS["average"](bounds))


def _best(  # noqa: PLR0913, PLR0917  (all that PyReason gives, but for the labels)
    operator: str, annotations: Any, weights: Any, nodes: Any, edges: Any, variables: Any
) -> tuple[float, ...]:
    """Join the atoms of all clauses again, and take the best substitution."""
    columns = [tuple(names) for names in variables]
    rows = [
        [(node,) for node in nodes[i]] if len(names) == 1 else [tuple(edge) for edge in edges[i]]
        for i, names in enumerate(columns)
    ]
    bounds = [
        {row: Bound(b.lower, b.upper) for row, b in zip(found, clause, strict=True)}
        for found, clause in zip(rows, annotations, strict=True)
    ]
    counting = [i for i, weight in enumerate(weights) if weight]
    each = [
        CONJUNCTIONS[operator](
            [bounds[i][tuple(values[name] for name in columns[i])] for i in counting]
        )
        for values in joined(list(zip(columns, rows, strict=True)))
    ]
    return tuple(DISJUNCTIONS["maximum"](each))


def average(annotations: Any, weights: Any) -> Any:  # pragma: no cover (runs compiled)
    """Average the bounds of all clauses together; a clause of weight 0 takes no part."""
    count = 0
    for i in range(len(annotations)):
        if weights[i] > 0:
            count += len(annotations[i])
    lowers, uppers = np.empty(count), np.empty(count)
    at = 0
    for i in range(len(annotations)):
        if weights[i] > 0:
            for bound in annotations[i]:
                lowers[at], uppers[at] = bound.lower, bound.upper
                at += 1
    with _objmode(pair="UniTuple(float64, 2)"):
        pair = _pooled(lowers, uppers)
    return pair


def _best_by(operator: str) -> Callable[..., Any]:
    """Return the function that combines per substitution; the best counts."""

    def best(  # noqa: PLR0913, PLR0917  # pragma: no cover (PyReason's signature; runs compiled)
        annotations: Any, weights: Any, nodes: Any, edges: Any, labels: Any, variables: Any
    ) -> Any:
        with _objmode(pair="UniTuple(float64, 2)"):
            pair = _best(operator, annotations, weights, nodes, edges, variables)
        return pair

    best.__name__ = f"best_{operator}"
    return best


def _with_identity(function: Callable[..., Any]) -> Any:
    """Compile a function, with an identity that is the same in every process.

    The functions are part of the signature of PyReason's compiled reasoner. A dispatcher's
    identity is random unless it is set before its first use, and then that signature is new in
    every process: nothing is found in the cache on disk, compiling takes most of a minute, and
    10 MB are added to the cache. `_set_uuid` is private to numba; without it all is as slow as that
    and nothing else.
    """
    dispatcher = _numba.njit(cache=True)(function)
    set_identity = getattr(dispatcher, "_set_uuid", None)
    if set_identity is not None:
        set_identity(f"sfol-{function.__name__}")
    return dispatcher


# Always these, in this order: any other choice is another signature. What pools stands here by its
# name, since the cache on disk finds it by that. They must not all take the
# same number of arguments, or numba takes them for one type after the first call.
_FUNCTIONS = tuple(map(_with_identity, [average, *map(_best_by, CONJUNCTIONS)]))


# -- running --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Answer:
    """What PyReason concluded.

    Attributes:
        bounds: the heads of the queries that hold.
        trace: how, if asked for.
    """

    bounds: dict[Atom, Bound]
    trace: tuple[TraceRow, ...] = ()


def run(script: Script, *, trace: bool = False) -> Answer:
    """Run a program.

    Args:
        script: the program; without rules there is nothing to conclude.
        trace: whether to keep PyReason's own trace.
    """
    if not script.queries:
        return Answer({})
    with _lock:
        interpretation = _interpretation(script, trace=trace)
        rows = tuple(_trace(script, interpretation)) if trace else ()
        return Answer(dict(_bounds(script, interpretation)), rows)


def graph_of(script: Script) -> Any:
    """Return the networkx graph of a program: constants, and the pairs that facts or heads name."""
    graph = _networkx.DiGraph()
    graph.add_nodes_from(script.nodes)
    heads = [query.head for query in script.queries]
    graph.add_edges_from(a.arguments for a in [*script.facts, *heads] if len(a.arguments) == 2)
    return graph


def rules_of(script: Script) -> list[Any]:
    """Return the rules of a program as PyReason's objects."""
    return [
        _pyreason.Rule(str(query), query.name, weights=[float(c.counts) for c in query.body])
        for query in script.queries
    ]


def facts_of(script: Script) -> list[Any]:
    """Return the facts of a program as PyReason's objects."""
    return [
        _pyreason.Fact(f"{atom}:[{lower!r},{upper!r}]", str(atom))
        for atom, (lower, upper) in script.facts.items()
    ]


def annotation_functions() -> tuple[Any, ...]:
    """Return the functions that heads of rules name; register them all, in this order."""
    return _FUNCTIONS


def _interpretation(script: Script, *, trace: bool) -> Any:
    _pyreason.reset()
    for name, value in {**_SETTINGS, "atom_trace": trace}.items():
        setattr(_pyreason.settings, name, value)
    _pyreason.load_graph(graph_of(script))
    for function in _FUNCTIONS:
        _pyreason.add_annotation_function(function)
    for rule in rules_of(script):
        _pyreason.add_rule(rule)
    for fact in facts_of(script):
        _pyreason.add_fact(fact)
    with warnings.catch_warnings():
        # numba calls a tuple of functions experimental
        warnings.simplefilter("ignore", _numba.core.errors.NumbaExperimentalFeatureWarning)
        return _pyreason.reason(timesteps=0)


def _bounds(script: Script, interpretation: Any) -> Iterator[tuple[Atom, Bound]]:
    heads = {query.head.predicate for query in script.queries}
    nodes = _atoms(interpretation.predicate_map_node, interpretation.interpretations_node)
    edges = _atoms(interpretation.predicate_map_edge, interpretation.interpretations_edge)
    for predicate, node, lower, upper in nodes:
        if predicate in heads:
            yield Atom(predicate, (node,)), Bound(lower, upper)
    for predicate, edge, lower, upper in edges:
        if predicate in heads:
            yield Atom(predicate, tuple(edge)), Bound(lower, upper)


def _listed(components: Any, worlds: Any) -> Any:  # pragma: no cover (runs compiled)
    """List every atom: its predicate, node or edge, lower and upper bound."""
    atoms = []
    for label in components:
        for component in components[label]:
            bound = worlds[component].world[label]
            atoms.append((label.get_value(), component, bound.lower, bound.upper))
    return atoms


# Compiled and cached: to read PyReason's tables from outside, each process would compile anew
# every method of theirs that it uses.
_atoms = _numba.njit(cache=True)(_listed)


def _trace(script: Script, interpretation: Any) -> Iterator[TraceRow]:
    queries = {query.name: query for query in script.queries}
    traces = (
        (interpretation.rule_trace_node, interpretation.rule_trace_node_atoms),
        (interpretation.rule_trace_edge, interpretation.rule_trace_edge_atoms),
    )
    for changes, atoms in traces:
        for change, (nodes, edges, _, name) in zip(changes, atoms, strict=True):
            if name in queries:
                _, _, component, _, bound, *_ = change
                arguments = (component,) if isinstance(component, str) else tuple(component)
                yield _row(queries[name], arguments, bound, nodes, edges)


def _row(query: Query, arguments: tuple[str, ...], bound: Any, nodes: Any, edges: Any) -> TraceRow:
    clauses = tuple(
        (str(clause), tuple(Atom(clause.predicate, row) for row in _rows(clause, *found)))
        for clause, *found in zip(query.body, nodes, edges, strict=True)
    )
    return TraceRow(
        query.rule, Atom(query.predicate, arguments), Bound(bound.lower, bound.upper), clauses
    )


def _rows(clause: QueryClause, nodes: Any, edges: Any) -> list[tuple[str, ...]]:
    return [(node,) for node in nodes] if len(clause.terms) == 1 else [tuple(e) for e in edges]

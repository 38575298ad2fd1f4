"""The dependency graph of a knowledge base: predicates → rules → heads → weights → terms.

As a networkx graph for programs, and drawn as Mermaid or SVG for people.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.sax import saxutils

from sfol.clauses import Body
from sfol.facts import TRUE
from sfol.knowledge_base import KnowledgeBase
from sfol.literals import AtomLiteral, Literal, Negated, Quantified
from sfol.syntax import Compared
from sfol.tools.texts import visible

if TYPE_CHECKING:
    import networkx as nx

    Graph = nx.DiGraph["GraphNode"]


class GraphNode(NamedTuple):
    """A part of a knowledge base.

    Attributes:
        kind: ``predicate``, ``attribute``, ``rule``, ``head``, ``weight`` or ``term``.
        name: unique among its kind.
    """

    kind: str
    name: str


_PLAIN = " _-.,:+/()"  # stands for itself in a text of Mermaid's
# kind → Mermaid's brackets, and the fill colour of both drawings
_SHAPES: Mapping[str, tuple[str, str, str]] = {
    "predicate": ("[", "]", "#eef2f7"),
    "attribute": ("[(", ")]", "#e6f4f4"),
    "rule": ("([", "])", "#fff4d6"),
    "head": ("[", "]", "#dff3e4"),
    "weight": ("{{", "}}", "#f3e3f7"),
    "term": ("[/", "/]", "#dcecfb"),
}


def dependency_graph(kb: KnowledgeBase) -> Graph:
    """Return what depends on what, from what is observed to what is rewarded.

    Args:
        kb: the knowledge base.

    Returns:
        A directed graph of `GraphNode`. A predicate that rules conclude is a ``head``. Edges from a
        predicate or attribute to a rule have ``negated``, those from a rule to its head
        ``certainty``, a `Bound`, and those from a head to a weight ``coefficient``.
    """
    import networkx as nx  # noqa: PLC0415  (slow to import, and needed for drawing only)

    graph: Graph = nx.DiGraph()
    heads = {name: GraphNode("head", name) for name in kb.heads}
    graph.add_nodes_from(heads.get(name, GraphNode("predicate", name)) for name in kb.predicates)
    attributes = {name: GraphNode("attribute", name) for name in kb.attributes}
    graph.add_nodes_from(attributes.values())
    sources = {**heads, **attributes}
    for rule in kb.rules.values():
        node = GraphNode("rule", rule.name)
        for name, negated in _read(rule.clause.body):
            source = sources.get(name, GraphNode("predicate", name))
            graph.add_edge(source, node, negated=negated)
        graph.add_edge(node, heads[rule.clause.head.predicate], certainty=rule.certainty)
    for name, weight in kb.weights.items():
        graph.add_node(GraphNode("weight", name))
        for head, coefficient in weight.coefficients.items():
            graph.add_edge(
                GraphNode("head", head), GraphNode("weight", name), coefficient=coefficient
            )
    for term in kb.terms.values():
        graph.add_node(GraphNode("term", term.name))
        if isinstance(term.weight, str):
            graph.add_edge(GraphNode("weight", term.weight), GraphNode("term", term.name))
        for head in term.heads:
            graph.add_edge(GraphNode("head", head), GraphNode("term", term.name))
    return graph


def _read(body: Body) -> Iterator[tuple[str, bool]]:
    """Yield the predicates and attributes that a body reads, and whether it speaks against them."""
    for literal in body.literals:
        against = literal.against if isinstance(literal, Quantified) else ()
        for inner in literal.literals if isinstance(literal, Quantified) else (literal,):
            negated = isinstance(inner, Negated) != (inner in against)
            yield from ((name, negated) for name in _names(inner))


def _names(literal: Literal) -> Iterator[str]:
    yield from (atom.predicate for atom in literal.atoms)
    if isinstance(literal, AtomLiteral):
        compared = (atom.predicate for atom in literal.atom.comparisons)
        yield from (name.attribute for name in compared if isinstance(name, Compared))


def mermaid(kb: KnowledgeBase) -> str:
    """Return the graph as a Mermaid flowchart, which Markdown viewers draw."""
    graph = dependency_graph(kb)
    ids = {node: f"n{index}" for index, node in enumerate(graph)}
    lines = ["flowchart LR"]
    for kind, (left, right, fill) in _SHAPES.items():
        found = [node for node in graph if node.kind == kind]
        lines += [f'    {ids[node]}{left}"{_quoted(node.name)}"{right}' for node in found]
        if found:
            lines += [f"    classDef {kind} fill:{fill},stroke:#888,color:#222"]
            lines += [f"    class {','.join(ids[node] for node in found)} {kind}"]
    for source, target, data in graph.edges(data=True):
        label = "not" if data.get("negated") else _label(data)
        arrow = ("-.->" if data.get("negated") else "-->") + (f"|{label}|" if label else "")
        lines.append(f"    {ids[source]} {arrow} {ids[target]}")
    return "\n".join(lines) + "\n"


def _label(data: Mapping[str, Any]) -> str:
    """Return what is multiplied along an edge; nothing where that changes nothing."""
    if data.get("coefficient", 1.0) != 1.0:
        return f"{data['coefficient']:g}"
    lower, upper = data.get("certainty", TRUE)
    if lower == upper == 1.0:
        return ""
    return f"certainty {lower:g}" + (f" to {upper:g}" if lower != upper else "")


def _quoted(name: str) -> str:
    """Return a name as Mermaid's text: it reads quotes, #, markup and Markdown, as ``#code;``."""
    return "".join(
        c if c.isalnum() or c in _PLAIN else f"#{ord(c)};" for c in " ".join(visible(name).split())
    )


# -- SVG ----------------------------------------------------------------------------------------

_ROW, _HEIGHT, _GAP, _MARGIN, _CHARACTER = 34, 24, 90, 16, 7.2
_SWEEPS = 8


class _Bend(NamedTuple):
    """A point that an edge over several layers passes through; it takes a row like a node."""

    source: GraphNode
    target: GraphNode
    layer: int


_Place = GraphNode | _Bend
_Layers = Sequence[Sequence[_Place]]
_Path = Sequence[_Place]


@dataclass(frozen=True)
class _Layout:
    """Where everything stands: left and right edge, and the middle of the height."""

    lefts: Mapping[_Place, float]
    rights: Mapping[_Place, float]
    middles: Mapping[_Place, float]
    width: float
    height: float


def svg(kb: KnowledgeBase) -> str:
    """Return the graph as an SVG drawing: layers from left to right, few crossings."""
    graph = dependency_graph(kb)
    layers, paths = _layered(graph)
    layout = _laid_out(_ordered(layers, list(paths.values())))
    size = f"{layout.width:.0f} {layout.height:.0f}"
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" '
            f'width="{layout.width:.0f}" height="{layout.height:.0f}" '
            'font-family="sans-serif" font-size="12">',
            f"<title>{_xml(kb.name)}: predicates, rules, heads, weights, terms</title>",
            *(
                _line(paths[source, target], layout, negated=data.get("negated", False))
                for source, target, data in graph.edges(data=True)
            ),
            *(
                _note(paths[source, target], layout, _label(data))
                for source, target, data in graph.edges(data=True)
                if _label(data)
            ),
            *(_box(node, layout) for node in graph),
            "</svg>\n",
        ]
    )


def _layered(graph: Graph) -> tuple[_Layers, dict[tuple[GraphNode, GraphNode], _Path]]:
    """Put each node right of all that it depends on, and bend long edges in every layer."""
    layer_of = _layer_of(graph)
    layers: list[list[_Place]] = [[] for _ in range(max(layer_of.values(), default=-1) + 1)]
    for node, layer in layer_of.items():
        layers[layer].append(node)
    paths: dict[tuple[GraphNode, GraphNode], _Path] = {}
    for source, target in graph.edges:
        between = range(layer_of[source] + 1, layer_of[target])
        bends = [_Bend(source, target, layer) for layer in between]
        for bend in bends:
            layers[bend.layer].append(bend)
        paths[source, target] = [source, *bends, target]
    return layers, paths


def _layer_of(graph: Graph) -> dict[GraphNode, int]:
    """Number the layers; what is observed stands next to its first use, terms stand last."""
    import networkx as nx  # noqa: PLC0415

    circles = [nodes for nodes in nx.strongly_connected_components(graph) if len(nodes) > 1]
    inside = {node: nodes for nodes in circles for node in nodes}
    forwards: Graph = graph.copy()  # without what leads from heads back to their own rules
    forwards.remove_edges_from(
        (s, t) for s, t in graph.edges if s.kind == "head" and t in inside.get(s, ())
    )
    generations = list(nx.topological_generations(forwards))
    deepest = {node: i for i, nodes in enumerate(generations) for node in nodes}
    last = len(generations) - 1

    def layer(node: GraphNode) -> int:
        if node.kind == "term":
            return last
        users = [deepest[user] for user in graph.successors(node)]
        return min(users) - 1 if users and not graph.in_degree(node) else deepest[node]

    return {node: layer(node) for node in graph}


def _ordered(layers: _Layers, paths: Sequence[_Path]) -> _Layers:
    """Order each layer by the mean row of its neighbours, to and fro: few edges cross then."""
    pairs = [pair for path in paths for pair in pairwise(path)]
    before: dict[_Place, list[_Place]] = {}
    after: dict[_Place, list[_Place]] = {}
    for left, right in pairs:
        before.setdefault(right, []).append(left)
        after.setdefault(left, []).append(right)
    ordered = [list(layer) for layer in layers]
    rows = {place: _share(i, layer) for layer in layers for i, place in enumerate(layer)}
    for sweep in range(_SWEEPS):
        forwards = sweep % 2 == 0
        neighbours = before if forwards else after
        for layer in ordered if forwards else reversed(ordered):
            means = {
                place: fmean(rows[other] for other in neighbours.get(place, [place]))
                for place in layer
            }
            layer.sort(key=means.__getitem__)
            rows |= {place: _share(i, layer) for i, place in enumerate(layer)}
    return ordered


def _share(row: int, layer: Sequence[_Place]) -> float:
    """Return how far down a row is, so that layers of different length can be compared."""
    return (row + 0.5) / len(layer)


def _laid_out(layers: _Layers) -> _Layout:
    widths = [max(map(_width, layer)) for layer in layers]
    lefts = [_MARGIN + sum(widths[:i]) + _GAP * i for i in range(len(layers))]
    rows = max(map(len, layers), default=0)
    places = [(i, row, place) for i, layer in enumerate(layers) for row, place in enumerate(layer)]
    return _Layout(
        lefts={place: lefts[i] for i, _, place in places},
        rights={
            place: lefts[i] + (_width(place) if isinstance(place, GraphNode) else widths[i])
            for i, _, place in places
        },
        middles={
            place: _MARGIN + _ROW * (row + (rows - len(layers[i])) / 2) + _HEIGHT / 2
            for i, row, place in places
        },
        width=2 * _MARGIN + sum(widths) + _GAP * max(len(layers) - 1, 0),
        height=2 * _MARGIN + _ROW * rows,
    )


def _width(place: _Place) -> float:
    return len(visible(place.name)) * _CHARACTER + 20 if isinstance(place, GraphNode) else 0.0


def _box(node: GraphNode, layout: _Layout) -> str:
    left, right, middle = layout.lefts[node], layout.rights[node], layout.middles[node]
    radius = _HEIGHT / 2 if node.kind == "rule" else 4
    return (
        f'<g><title>{node.kind} {_xml(node.name)}</title><rect x="{left:.1f}" '
        f'y="{middle - _HEIGHT / 2:.1f}" width="{right - left:.1f}" height="{_HEIGHT}" '
        f'rx="{radius}" fill="{_SHAPES[node.kind][2]}" stroke="#888"/>'
        f'<text x="{(left + right) / 2:.1f}" y="{middle + 4:.1f}" text-anchor="middle" '
        f'fill="#222">{_xml(node.name)}</text></g>'
    )


def _xml(name: str) -> str:
    return saxutils.escape(visible(name))


def _line(path: _Path, layout: _Layout, *, negated: bool) -> str:
    dashes = ' stroke-dasharray="4 3"' if negated else ""
    return f'<path d="{"".join(_curves(path, layout))}" fill="none" stroke="#999"{dashes}/>'


def _note(path: _Path, layout: _Layout, text: str) -> str:
    """Write on an edge, in the middle of its first curve."""
    source, target = path[:2]
    x = (layout.rights[source] + layout.lefts[target]) / 2
    y = (layout.middles[source] + layout.middles[target]) / 2
    return (
        f'<text x="{x:.1f}" y="{y + 3:.1f}" text-anchor="middle" font-size="10" fill="#555" '
        f'stroke="#fff" stroke-width="3" paint-order="stroke">{text}</text>'
    )


def _curves(path: _Path, layout: _Layout) -> Iterator[str]:
    x, y = layout.rights[path[0]], layout.middles[path[0]]
    yield f"M{x:.1f},{y:.1f}"
    for place in path[1:]:
        left, to = layout.lefts[place], layout.middles[place]
        turn = (x + left) / 2
        yield f"C{turn:.1f},{y:.1f} {turn:.1f},{to:.1f} {left:.1f},{to:.1f}"
        x, y = layout.rights[place], to
        if isinstance(place, _Bend):
            yield f"H{x:.1f}"

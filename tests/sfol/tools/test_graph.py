"""The dependency graph, and its drawings."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import networkx as nx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol import KnowledgeBase
from sfol.knowledge_base.loading import bundled_names
from sfol.tools.graph import GraphNode, dependency_graph, mermaid, svg
from tests.sfol.command_line import sfol

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def aeb():
    return KnowledgeBase.load("aeb")


def test_it_leads_from_what_is_seen_to_what_is_rewarded(aeb):
    graph = dependency_graph(aeb)
    path = [GraphNode("predicate", "Truck"), GraphNode("rule", "truck_is_vehicle"), GraphNode("head", "Vehicle"),
            GraphNode("rule", "safe2"), GraphNode("head", "safe2"), GraphNode("weight", "safety"),
            GraphNode("term", "safety")]  # fmt: skip
    assert nx.is_path(graph, path)
    assert nx.is_directed_acyclic_graph(graph)
    assert not list(graph.successors(GraphNode("predicate", "IsNear")))
    assert GraphNode("term", "comfort") in graph
    assert graph.edges[GraphNode("head", "safe1"), GraphNode("weight", "safety")] == {
        "coefficient": 1.0
    }


def test_every_node_and_edge_is_in_both_drawings(aeb):
    graph = dependency_graph(aeb)
    text = mermaid(aeb)
    assert text.startswith("flowchart LR\n")
    assert len(re.findall(r"-->|-\.->", text)) == graph.number_of_edges()
    assert len(re.findall(r"^    n\d+[\[({]", text, re.M)) == len(graph)
    drawing = ET.fromstring(svg(aeb))
    assert len(drawing.findall(f"{SVG}path")) == graph.number_of_edges()
    boxes = {g.findtext(f"{SVG}title") for g in drawing.findall(f"{SVG}g")}
    assert boxes == {f"{node.kind} {node.name}" for node in graph}


def test_boxes_do_not_overlap_and_edges_run_to_the_right(aeb):
    drawing = ET.fromstring(svg(aeb))
    rects = [
        tuple(float(rect.get(key)) for key in ("x", "y", "width", "height"))
        for rect in drawing.iter(f"{SVG}rect")
    ]
    for i, (x, y, w, h) in enumerate(rects):
        for X, Y, W, H in rects[i + 1 :]:
            assert x + w <= X or x >= X + W or y + h <= Y or y >= Y + H
    for path in drawing.iter(f"{SVG}path"):
        xs = [float(x) for x in re.findall(r"(?:[MCH ])([\d.]+)", path.get("d"))]
        assert xs == sorted(xs)


def test_negation_and_coefficients_are_drawn(kitchen):
    kb = kitchen({"Hot(P), Near": "not Hot(P), Near", "careful: 1.0": "careful: 0.5"})
    assert "-.->|not|" in mermaid(kb)
    assert "-->|0.5|" in mermaid(kb)
    assert "stroke-dasharray" in svg(kb)
    assert "0.5" in ET.fromstring(svg(kb)).itertext()


@pytest.mark.parametrize(
    ("certainty", "text"),
    [("0.8", "certainty 0.8"), ("[0.25, 1]", "certainty 0.25 to 1"), ("1.0", "")],
)
def test_certainties_are_drawn_where_a_rule_meets_its_head(kitchen, certainty, text):
    rule = "care: careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X)."
    entry = rule.replace("care: ", "care:\n    rule: ") + f"\n    certainty: {certainty}"
    kb = kitchen({rule: entry})
    edge = GraphNode("rule", "care"), GraphNode("head", "careful")
    assert dependency_graph(kb).edges[edge] == {"certainty": kb.rules["care"].certainty}
    lines = [line for line in mermaid(kb).splitlines() if "certainty" in line]
    assert [re.sub(r"n\d+", "n", line) for line in lines] == [f"    n -->|{text}| n"] * bool(text)
    drawn = [part for part in ET.fromstring(svg(kb)).itertext() if "certainty" in part]
    assert drawn == [text] * bool(text)


def test_names_cannot_break_the_drawings(kitchen):
    kb = kitchen({"  care: careful": "  '<b>\"&': careful"})
    assert '(["#60;b#62;#34;#38;"])' in mermaid(kb)
    assert '<b>"&' in ET.fromstring(svg(kb)).itertext()


texts = st.text(min_size=1) | st.text('"`#;<>&[](){}|%\n\r\t\0\x1b\u2028\ufffe x-', min_size=1)


@given(texts)
def test_a_name_of_any_characters_is_the_text_of_a_node_and_no_more(name):
    """A knowledge base of objects may have any name, which a file would not let pass."""
    kb = KnowledgeBase.load("cartpole")
    rule = next(iter(kb.rules.values()))
    named = [
        replace(kb, name=text, rules={**kb.rules, rule.name: replace(rule, name=text)})
        for text in ("n", name)
    ]
    plain, strange = (mermaid(each).splitlines() for each in named)
    assert len(plain) == len(strange)
    (changed,) = [line for line, other in zip(strange, plain, strict=True) if line != other] or [""]
    assert re.fullmatch(r'(    n\d+\(\["[\w _.,:+/()#;-]*"\]\))?', changed)
    drawn = [[element.tag for element in ET.fromstring(svg(each)).iter()] for each in named]
    assert drawn[0] == drawn[1]


@pytest.mark.parametrize("name", bundled_names())
def test_every_bundled_knowledge_base_can_be_drawn(name):
    kb = KnowledgeBase.load(name)
    names = {node.name for node in dependency_graph(kb)}
    assert names >= {*kb.predicates, *kb.rules, *kb.weights, *kb.terms}
    assert names <= set(ET.fromstring(svg(kb)).itertext())
    assert names == set(re.findall(r'^    n\d+\W+"(.*?)"', mermaid(kb), re.M))


def test_the_command(aeb):
    assert sfol("graph", "aeb").out == mermaid(aeb)
    assert sfol("graph", "aeb", "--format", "svg").out == svg(aeb)
    assert sfol("graph", "aeb", "--format", "png").code == 2
    assert "did you mean 'aeb'" in sfol("graph", "aebb").err

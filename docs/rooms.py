"""The drawing of the rooms: which there are and which imports which, read off the code."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path

import networkx as nx

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("sfol", "vsr", "env")
# A knowledge base as a PyReason program is the one import that goes up, and only when it is called.
UPWARDS = {("sfol.knowledge_base.model", "sfol.engines.pyreason")}

WIDTH, HEIGHT = 144, 34  # of a box
GAP, RISE = 14, 62  # between two boxes of a row; from one row to the next
MARGIN, TITLE = 16, 34

TIP = (
    '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8"'
    ' orient="auto"><path d="M0,0 L8,4 L0,8 z"/></marker></defs>'
)


def drawing() -> str:
    """Return an SVG in the page's own colours, a column for each package, imports downwards."""
    graph = import_graph()
    columns = {package: _rows(graph, package) for package in PACKAGES}
    height = TITLE + max(len(rows) for rows in columns.values()) * RISE
    parts: list[str] = []
    places: dict[str, tuple[float, float]] = {}
    left = 1
    for package, rows in columns.items():
        width = max(len(row) for row in rows) * (WIDTH + GAP) - GAP + 2 * MARGIN
        parts.append(_frame(package, left, width, height))
        for level, row in enumerate(rows):
            x = left + (width - len(row) * (WIDTH + GAP) + GAP) / 2
            y = height - (level + 1) * RISE + (RISE - HEIGHT) / 2
            places |= {room: (x + i * (WIDTH + GAP), y) for i, room in enumerate(row)}
        left += width + MARGIN
    parts += [_arrow(places[upper], places[lower]) for upper, lower in _shown(graph)]
    parts += [_box(room, *place) for room, place in places.items()]
    opening = (
        f'<svg class="rooms" viewBox="0 0 {left - MARGIN + 1} {height + 2}" role="img"'
        ' aria-label="The rooms of sfol, vsr and env, and which imports which">'
    )
    return "\n".join([opening, TIP, *parts, "</svg>"])


# -- what imports what --------------------------------------------------------------------------


def import_graph() -> nx.DiGraph[str]:
    """Return the rooms, with an edge from each to every room that a module of it imports.

    Modules at the top of a package are one room if they stand on the same folders of it.
    """
    paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    modules = {_name(path): path for path in paths if path.stem != "__main__"}
    imports: nx.DiGraph[str] = nx.DiGraph()
    imports.add_nodes_from(modules)
    imports.add_edges_from(
        (name, found) for name, path in modules.items() for found in _imported(path, modules)
    )
    imports.remove_edges_from(UPWARDS)
    room_of = _rooms(imports)
    graph: nx.DiGraph[str] = nx.DiGraph()
    graph.add_nodes_from(dict.fromkeys(room_of.values()))
    edges = {(room_of[name], room_of[found]) for name, found in imports.edges}
    graph.add_edges_from(sorted((upper, lower) for upper, lower in edges if upper != lower))
    return graph


def _name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _imported(path: Path, modules: Mapping[str, Path]) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield from {inner if inner in modules else str(node.module)} & modules.keys()
        elif isinstance(node, ast.Import):
            yield from {alias.name for alias in node.names} & modules.keys()


def _rooms(imports: nx.DiGraph[str]) -> dict[str, str]:
    """Return the room of each module: its folder, or those at the top that stand where it does."""
    rooms = {name: folder for name in imports if (folder := _folder(name))}
    below: dict[tuple[str, frozenset[str]], list[str]] = {}
    for name in imports.nodes - rooms.keys():
        found = (_folder(lower) for lower in nx.descendants(imports, name))
        own = frozenset(f for f in found if f and _package(f) == _package(name))
        below.setdefault((_package(name), own), []).append(name)
    for (package, folders), names in below.items():
        several = f"{package}.*" if folders else "ground"
        few = ", ".join(sorted(name.rpartition(".")[2] for name in names))
        label = several if len(names) > 2 else few
        rooms |= dict.fromkeys(names, f"{package}: {label}")
    return rooms


def _folder(name: str) -> str | None:
    package, *rest = name.split(".")
    inside = rest and (ROOT / package / rest[0]).is_dir()
    return f"{package}.{rest[0]}" if inside else None


# -- where it stands ----------------------------------------------------------------------------


def _rows(graph: nx.DiGraph[str], package: str) -> list[list[str]]:
    """Return a package's rooms from below: each one row above the highest that it imports."""
    rooms = [room for room in graph if _package(room) == package]
    return [sorted(row) for row in nx.topological_generations(graph.subgraph(rooms).reverse())]


def _shown(graph: nx.DiGraph[str]) -> Iterator[tuple[str, str]]:
    """Yield the imports within each package that do not follow from others."""
    for package in PACKAGES:
        rooms = [room for room in graph if _package(room) == package]
        yield from nx.transitive_reduction(graph.subgraph(rooms)).edges


def _package(room: str) -> str:
    return room.partition(".")[0].partition(":")[0]


# -- how it looks -------------------------------------------------------------------------------


def _frame(package: str, x: float, width: float, height: float) -> str:
    return (
        f'<rect class="frame" x="{x}" y="1" width="{width}" height="{height}" rx="8"/>'
        f'<text class="package" x="{x + width / 2}" y="24">{package}</text>'
    )


def _box(room: str, x: float, y: float) -> str:
    page = _package(room) if ":" in room else room
    label = room.partition(": ")[2] or room.partition(".")[2]
    return (
        f'<a href="../reference/api/{page}.html"><title>{escape(_purpose(page))}</title>'
        f'<rect class="room" x="{x}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="5"/>'
        f'<text x="{x + WIDTH / 2}" y="{y + HEIGHT / 2 + 5}">{label}</text></a>'
    )


def _purpose(page: str) -> str:
    source = (ROOT / page.replace(".", "/") / "__init__.py").read_text("utf-8")
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]


def _arrow(upper: tuple[float, float], lower: tuple[float, float]) -> str:
    (x1, y1), (x2, y2) = upper, lower
    far = ' class="far"' if y2 - y1 > RISE else ""  # it passes behind other boxes
    return (
        f'<line{far} x1="{x1 + WIDTH / 2}" y1="{y1 + HEIGHT}" x2="{x2 + WIDTH / 2}" y2="{y2 - 1}"/>'
    )

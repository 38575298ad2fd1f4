"""What may import what, room by room, and how light the core is."""

import ast
import importlib
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("sfol", "vsr", "env")
HEAVY = ("torch", "stable_baselines3", "pyreason", "scipy", "gymnasium", "pybullet", "numba")

# Each room may import the rooms of its package that stand before it, and those beside it in braces
# not at all. A module at the top of a package is a room of its own, unless it is one of the ground.
GROUND = {
    "sfol": {
        "errors",
        "arrays",
        "arithmetic",
        "reading",
        "writing",
        "locking",
        "strict_yaml",
        "syntax",
        "facts",
        "soft_comparisons",
        "quantifiers",
        "formula",
        "comparisons",
        "operators",
        "temporal",
        "literals",
        "connectives",
        "clauses",
    },
    "vsr": {
        "arrays",
        "classes",
        "segmentation",
        "entities",
        "grounding",
        "facts",
        "tracking",
        "json_files",
        "tensor_files",
        "threads",
    },
    "env": set(),
}
ORDER = {
    "sfol": [
        {"ground"},
        {"knowledge_base"},
        {"observations"},
        {"engines"},
        {"outcome", "logs"},
        {"episode", "explain", "recorded_steps"},
        {"tensor_reward"},
        {"reward"},
        {"", "wrappers"},
        {"sb3"},
        {"testing"},
        {"tools"},
        {"cli"},
    ],
    "vsr": [{"ground", ""}, {"hypervectors", "networks"}, {"pictures", "training", "bench"}],
    "env": [
        {"world"},
        {"", "perception"},
        {"street"},
        {"driving"},
        {"evaluation"},
        {"learning"},
        {"study", "demo"},
        {"tools"},
        {"cli"},
        {"__main__"},
    ],
}
# An import that goes up, and late: a knowledge base as a PyReason program.
ALLOWED = {("sfol.knowledge_base.model", "sfol.engines.pyreason")}


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {
    name_of(path): path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))
}


def imported(name, *, late):
    """Yield the project's modules that a module imports; `late` adds those inside functions."""

    def visit(nodes):
        for node in nodes:
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert not node.level, f"{name} imports relatively"
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    yield inner if inner in MODULES else node.module
            elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
                yield from visit(node.orelse)
            elif late or not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield from visit(ast.iter_child_nodes(node))

    body = ast.parse(MODULES[name].read_text()).body
    return {found for found in visit(body) if found in MODULES and found != name}


def room_of(name):
    package, _, rest = name.partition(".")
    room = rest.partition(".")[0]
    return "ground" if room in GROUND[package] else room


def test_import_sfol_imports_nothing_heavy():
    code = f"import sfol, sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", ["sfol.cli", "env"])
@pytest.mark.parametrize("arguments", [["--help"], ["bench", "--help"]])
def test_help_imports_nothing_heavy(command, arguments):
    never = ("torch", "stable_baselines3", "pybullet", "numba", "scipy", "matplotlib", "pyreason")
    code = (
        f"import runpy, sys; sys.argv = ['x', *{arguments!r}]\n"
        f"try: runpy.run_module({command!r}, run_name='__main__')\n"
        f"finally: print([m for m in {never!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Usage:" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("package", "never"),
    [("sfol", {"vsr", "env", "pybullet"}), ("vsr", {"env", "pybullet"})],
)
def test_packages_are_imported_in_one_direction(package, never):
    for name, path in MODULES.items():
        if name.partition(".")[0] == package:
            tree = ast.walk(ast.parse(path.read_text()))
            names = {
                alias.name for node in tree if isinstance(node, ast.Import) for alias in node.names
            }
            tree = ast.walk(ast.parse(path.read_text()))
            names |= {node.module for node in tree if isinstance(node, ast.ImportFrom)}
            assert not never & {found.partition(".")[0] for found in names}, name


@pytest.mark.parametrize("package", PACKAGES)
def test_every_room_has_its_place_in_the_order(package):
    rooms = {room_of(name) for name in MODULES if name.partition(".")[0] == package}
    assert rooms == set().union(*ORDER[package]) | ({"ground"} & rooms)


@pytest.mark.parametrize("name", MODULES)
def test_rooms_are_imported_in_one_direction(name):
    package = name.partition(".")[0]
    level = {room: i for i, rooms in enumerate(ORDER[package]) for room in rooms}
    own = room_of(name)
    for found in imported(name, late=True):
        if found.partition(".")[0] != package or (name, found) in ALLOWED:
            continue
        room = room_of(found)
        assert room == own or level[room] < level[own], f"{name} imports {found}"


def test_no_modules_import_each_other_in_a_circle():
    graph = {name: imported(name, late=True) for name in MODULES}
    for name, found in ALLOWED:
        graph[name].remove(found)
    TopologicalSorter(graph).prepare()


def test_every_room_says_what_it_is_for():
    for name, path in MODULES.items():
        if path.name == "__init__.py":
            assert ast.get_docstring(ast.parse(path.read_text())), name


@pytest.mark.parametrize(
    "name", ["sfol", "sfol.cli", "sfol.knowledge_base", "sfol.literals", "sfol.wrappers"]
)
def test_all_that_a_package_offers_is_there(name):
    package = importlib.import_module(name)
    assert [offered for offered in package.__all__ if not hasattr(package, offered)] == []

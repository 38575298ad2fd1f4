"""What the pages take from the code itself, so that they cannot differ from it.

A page holds a line such as ``{{ keys sfol.knowledge_base.KnowledgeBaseFile }}``; while Sphinx reads
the page, `fill` replaces it with Markdown. Nothing that is made here is kept in the repository.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from keys import keys, one_line, table
from rooms import drawing
from typer.cli import get_docs_for_click

import sfol.arithmetic
import sfol.clauses
import sfol.comparisons
import sfol.connectives
import sfol.errors
import sfol.formula
import sfol.knowledge_base.observing
import sfol.literals.search
import sfol.logs
import sfol.operators
import sfol.reading
import sfol.soft_comparisons
import sfol.strict_yaml
import sfol.syntax
import sfol.tools.lint
import sfol.tools.subsumption
import vsr.hypervectors.codebook
import vsr.tensor_files

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
LINE = re.compile(r"^\{\{ (?P<kind>\w+)(?: (?P<name>[\w.:]+))? \}\}$", re.MULTILINE)


def setup(app: Sphinx) -> Mapping[str, bool]:
    """Let Sphinx fill in every page while it reads it."""
    app.connect("source-read", _fill_page)
    return {"parallel_read_safe": True}


def _fill_page(app: Sphinx, _page: str, source: list[str]) -> None:
    filled = fill(source[0]).replace("../../results/README.md", "../results.md")
    if filled != source[0]:
        source[0] = filled
        app.env.note_reread()  # the code may have changed where the page has not


def fill(text: str) -> str:
    """Replace the lines of a page that name something generated."""
    return LINE.sub(lambda found: KINDS[found["kind"]](*filter(None, [found["name"]])), text)


# -- modules ------------------------------------------------------------------------------------


def modules_of(room: str) -> list[str]:
    """Return the modules that stand in a room itself, not in the rooms within it."""
    folder = ROOT / room.replace(".", "/")
    return [
        f"{room}.{path.stem}" for path in sorted(folder.glob("*.py")) if path.stem != "__init__"
    ]


def rooms_of(package: str) -> list[str]:
    """Return a package and every package within it that has modules."""
    folders = sorted(path.parent for path in (ROOT / package).rglob("__init__.py"))
    return [".".join(folder.relative_to(ROOT).parts) for folder in folders]


def room(name: str) -> str:
    """Return the reference of a room: what it is for, then each of its modules."""
    parts = [_automodule(name)]
    for module in modules_of(name):
        parts.append(f"## `{module.rpartition('.')[2]}`\n\n{_automodule(module, 'members')}")
    return "\n\n".join(parts)


def _automodule(name: str, *options: str) -> str:
    lines = [f".. automodule:: {name}", *(f"   :{option}:" for option in options)]
    return "\n".join(["```{eval-rst}", *lines, "```"])


# -- command lines ------------------------------------------------------------------------------


def command(name: str) -> str:
    """Return the help of a command and of all its subcommands; `name` is `module:command`."""
    module, _, program = name.partition(":")
    importlib.import_module(module)
    app = importlib.import_module(f"{module}.app").app
    group: Any = typer.main.get_command(app)
    context = typer.Context(group, info_name=program)
    text = get_docs_for_click(obj=group, ctx=context, name=program)
    for line, sentence in _sentences(group):  # the lists of subcommands have shortened ones
        text = re.sub(rf"^\* `{line}`: .*$", f"* `{line}`: {sentence}", text, flags=re.MULTILINE)
    return text.partition("\n")[2]  # the page has a title of its own


def _sentences(group: Any) -> Iterator[tuple[str, str]]:
    for name, subcommand in group.commands.items():
        yield name, inspect.cleandoc(subcommand.help).partition("\n")[0]
        if hasattr(subcommand, "commands"):
            yield from _sentences(subcommand)


# -- the language -------------------------------------------------------------------------------


def grammar() -> str:
    """Return the grammar of clauses and facts, which stands in the docstrings of their readers."""
    texts = [
        inspect.getdoc(module) or "" for module in (sfol.clauses, sfol.comparisons, sfol.syntax)
    ]
    lines = [line[4:] for text in texts for line in text.splitlines() if line.startswith("    ")]
    return "\n".join(["```text", *lines, "```"])


def operators() -> str:
    """Return a table of the operators that a knowledge base can choose."""
    rows = [
        (key, f"`{operator.name}`", operator.formula, operator.source)
        for key, named in (
            ("conjunction", sfol.operators.CONJUNCTIONS),
            ("disjunction", sfol.operators.DISJUNCTIONS),
            ("groundings", sfol.operators.GATHERINGS),
        )
        for operator in named.values()
    ]
    return table(("key of `semantics`", "value", "formula", "source"), rows)


def functions() -> str:
    """Return a table of the functions that formulas may call."""
    rows = [
        (f"`{name}`", " to ".join(map(str, sorted({function.least, function.most}))))
        for name, function in sfol.arithmetic.FUNCTIONS.items()
    ]
    return table(("function", "arguments"), rows)


def soft_comparisons() -> str:
    """Return a table of the comparisons that may have a margin."""
    rows = [
        (f"`{name}`", comparison.meaning)
        for name, comparison in sfol.soft_comparisons.SOFT_COMPARISONS.items()
    ]
    return table(("comparison", "is 1 where"), rows)


def shapes() -> str:
    """Return a table of the ways in which soft comparisons fall."""
    rows = [
        (f"`{name}`", shape.formula, "yes" if shape.takes_zero else "no")
        for name, shape in sfol.soft_comparisons.SHAPES.items()
    ]
    return table(("shape", "value at r margins from holding", "v may be 0"), rows)


def lint_codes() -> str:
    """Return the table of lint codes, which stands in the docstring of the linter."""
    lines = (inspect.getdoc(sfol.tools.lint) or "").splitlines()
    return "\n".join(line for line in lines if line.startswith("|"))


def limits() -> str:
    """Return the table of what is too large."""
    rows = [
        ("bytes of a YAML file", f"{sfol.reading.MAXIMUM_BYTES:,}", ""),
        ("values in it, and levels of nesting",
         f"{sfol.strict_yaml.MAXIMUM_VALUES:,} and {sfol.strict_yaml.MAXIMUM_DEPTH}", ""),
        ("digits of a number", f"{sfol.strict_yaml.MAXIMUM_DIGITS}", ""),
        ("errors that are shown of a file", f"{sfol.errors.MAXIMUM_ERRORS}", ""),
        ("characters of a clause or of facts", f"{sfol.syntax.MAXIMUM_TEXT:,}", ""),
        ("literals of a body, and ways in which it can hold",
         f"{sfol.clauses.MAXIMUM_LITERALS} and {sfol.connectives.MAXIMUM_WAYS}", ""),
        ("characters and levels of a formula",
         f"{sfol.formula.MAXIMUM_LENGTH:,} and {sfol.formula.MAXIMUM_DEPTH}", ""),
        ("known atoms that the search of a rule looks at",
         f"{sfol.literals.search.WORK_LIMIT:,}", "`RewardFunction(…, work_limit=…)`"),
        ("entities of all sorts, and atoms that are read off an observation",
         f"{sfol.knowledge_base.observing.MAXIMUM_ENTITIES:,} and "
         f"{sfol.knowledge_base.observing.MAXIMUM_ATOMS:,}", ""),
        ("steps of a log", f"{sfol.logs.MAXIMUM_ROWS:,}", "`read_log(…, maximum_rows=…)`"),
        ("comparisons of two rules, and of all, by `sfol lint`",
         f"{sfol.tools.subsumption.PAIR_STEPS:,} and {sfol.tools.subsumption.ALL_STEPS:,}", ""),
        ("bytes of a card", f"{vsr.tensor_files.MOST_OF_CARD:,}", ""),
        ("dimensions of a codebook", f"{vsr.hypervectors.codebook.MOST_DIMENSION:,}", ""),
    ]  # fmt: skip
    return table(("what", "limit", "setting"), rows)


def errors() -> str:
    """Return a table of all errors, each with the one that it is a kind of."""
    rows = [
        (f"{{class}}`~sfol.errors.{name}`", f"`{kind.__bases__[0].__name__}`", _first_line(kind))
        for name, kind in vars(sfol.errors).items()
        if inspect.isclass(kind) and issubclass(kind, Exception)
    ]
    return table(("error", "a kind of", "raised when"), rows)


def _first_line(thing: object) -> str:
    return (inspect.getdoc(thing) or "").partition("\n")[0]


# -- the rooms ----------------------------------------------------------------------------------


def rooms() -> str:
    """Return the drawing of the rooms, in the colours of the page."""
    return f"```{{raw}} html\n{drawing()}\n```"


def room_table(package: str) -> str:
    """Return a table of a package's rooms: what each is for."""
    rows = [
        (f"[`{name}`](../reference/api/{name}.md)", one_line(_summary(name)))
        for name in rooms_of(package)
    ]
    return table(("room", "what it is for"), rows)


def _summary(name: str) -> str:
    path = ROOT / name.replace(".", "/") / "__init__.py"
    return (ast.get_docstring(ast.parse(path.read_text("utf-8"))) or "").partition("\n")[0]


KINDS: Mapping[str, Callable[..., str]] = {
    function.__name__: function
    for function in (
        room, command, keys, grammar, operators, functions, soft_comparisons, shapes, lint_codes,
        limits, errors,
        rooms, room_table,
    )
}  # fmt: skip

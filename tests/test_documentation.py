"""What the documentation shows is true: its code runs, its files load, its commands exist."""

import ast
import doctest
import importlib
import importlib.util
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
import yaml

pytest.importorskip("pybullet", reason="the pages drive the street: they need the extra aeb")

import sfol
from env.cli.app import app as aeb
from env.driving.drivers import DRIVERS
from env.driving.setup import Setup, setup_names
from env.evaluation.metrics import METRICS
from sfol.cli.app import app as sfol_app
from sfol.errors import SfolError
from sfol.knowledge_base.loading import bundled_names

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(
    [
        *(page for page in DOCS.rglob("*.md") if "_build" not in page.parts),
        *ROOT.glob("*.md"),
        ROOT / "results" / "README.md",
    ]
)
EXAMPLES = sorted((ROOT / "examples").glob("[!_]*.py"))
# What an example, and the page about it, need beside the project; without it they are left out.
NEEDED = {
    "doorkey": "minigrid",
    "fetch": "gymnasium_robotics",
    "highway": "highway_env",
    "lunarlander": "Box2D",
    "mjx": "mujoco.mjx",
    "rllib_crossing": "ray.rllib",
    "spread": "mpe2",
}
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts): path
    for package in ("sfol", "vsr", "env")
    for path in sorted((ROOT / package).rglob("*.py"))
    if path.name != "__init__.py"
}
COMMANDS = {"sfol": typer.main.get_command(sfol_app), "aeb": typer.main.get_command(aeb)}


def name_of(page):
    return page.relative_to(ROOT).as_posix()


def blocks(page, *languages):
    fence = rf"^```(?:{'|'.join(languages)})\n(.*?)^```$"
    return re.findall(fence, page.read_text("utf-8"), re.DOTALL | re.MULTILINE)


def pages_with(*languages):
    return [pytest.param(page, id=name_of(page)) for page in PAGES if blocks(page, *languages)]


def skip_without_what_it_needs(path):
    if path.stem in NEEDED:
        pytest.importorskip(NEEDED[path.stem], reason=f"{path.name} needs it")


def run(*arguments, folder=ROOT):
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
    )


ANSWERS = re.findall(
    r"^\| `(.* :- .*)` \| (.*) \|$", (DOCS / "how-to" / "write-rules.md").read_text(), re.MULTILINE
)


@pytest.mark.parametrize(("rule", "answer"), ANSWERS)
def test_a_mistake_is_answered_as_the_page_says(tmp_path, rule, answer):
    content = {
        "version": 1,
        "name": "mistake",
        "predicates": dict.fromkeys(["P(X)", "Q(X)", "R(X, Y)", "h(X)"], ""),
        "attributes": {"S(X)": ""},
        "rules": {"rule": rule},
    }
    (tmp_path / "mistake.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(SfolError) as caught:
        sfol.KnowledgeBase.load(tmp_path / "mistake.yaml")
    assert answer in str(caught.value)


def test_the_page_shows_some_mistakes():
    assert len(ANSWERS) > 5


# -- code ---------------------------------------------------------------------------------------


def write_files(page, folder):
    """Write the files that a page shows: a block whose first line is a comment with a file name."""
    for text in blocks(page, "yaml", "python"):
        first = text.partition("\n")[0]
        if named := re.fullmatch(r"# ([\w/-]+\.(?:yaml|py))", first):
            (folder / named[1]).write_text(text, encoding="utf-8")


def begin_files(page, folder):
    """Write the files that a page begins with `sfol init`."""
    for words in command_lines(page):
        if words[:2] == ["sfol", "init"]:
            done = run("-m", "sfol.cli", *words[1:], "--force", folder=folder)
            assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", pages_with("python"))
def test_python_on_a_page_runs_from_top_to_bottom(page, tmp_path):
    begin_files(page, tmp_path)
    skip_without_what_it_needs(page)
    write_files(page, tmp_path)
    done = run("-c", "\n".join(blocks(page, "python")), folder=tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_first_commands_of_the_readme_do_what_it_shows(tmp_path):
    readme = ROOT / "README.md"
    write_files(readme, tmp_path)
    install, *shown = blocks(readme, "sh")
    assert install.startswith("python -m pip install")
    first, *_ = blocks(readme, "text")
    lines = [line for block in shown[:2] for line in block.replace("\\\n", "").splitlines()]
    printed = ""
    for program, *arguments in map(shlex.split, lines):
        command = ["-m", "sfol.cli"] if program == "sfol" else []
        done = run(*command, *arguments, folder=tmp_path)
        assert done.returncode == 0, done.stderr
        printed += done.stdout
    assert len(lines) == 4
    assert "3 passed, 0 failed" in printed
    assert "'original_return': " in printed
    assert printed.endswith(first)


def test_the_readme_shows_what_its_code_prints():
    (code,) = (code for code in blocks(ROOT / "README.md", "python") if "print(reward.expl" in code)
    printed = run("-c", code).stdout
    assert printed.startswith("-0.0695")
    (shown,) = (text for text in blocks(ROOT / "README.md", "text") if "reward -0.0695" in text)
    for line in shown.splitlines():
        assert "…" in line or line in printed


def test_sessions_on_pages_print_what_they_show():
    for page in PAGES:
        session = doctest.DocTestParser().get_doctest(
            "\n".join(blocks(page, "pycon")), {}, name_of(page), str(page), 0
        )
        assert doctest.DocTestRunner().run(session).failed == 0, page


@pytest.mark.parametrize(
    "name",
    [
        name
        for name, path in {**MODULES, "sfol": ROOT / "sfol" / "__init__.py"}.items()
        if not name.startswith("env") and ">>> " in path.read_text("utf-8")
    ],
)
def test_examples_in_docstrings_print_what_they_show(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(importlib.import_module(name))
    assert result.attempted
    assert result.failed == 0


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_examples_run(example):
    skip_without_what_it_needs(example)
    done = run(example)
    assert done.returncode == 0, done.stderr
    assert done.stdout


# -- files --------------------------------------------------------------------------------------


def load(content, folder):
    """Load a knowledge base, or a part of one: as it stands, or on top of a bundled one."""
    path = folder / "shown.yaml"
    whole = {"version": 1, "name": "shown"} | content
    faults = []
    for base in (None, *bundled_names()):
        overlay = whole if base is None or "extends" in content else whole | {"extends": base}
        path.write_text(yaml.safe_dump(overlay, sort_keys=False), encoding="utf-8")
        try:
            return sfol.KnowledgeBase.load(path)
        except SfolError as error:
            faults.append(f"on {base}: {error}")
    raise AssertionError("\n".join(faults))


@pytest.mark.parametrize("page", pages_with("yaml"))
def test_yaml_on_a_page_is_a_knowledge_base_or_a_setup(page, tmp_path):
    write_files(page, tmp_path)  # so that one can extend another
    for text in blocks(page, "yaml"):
        content = yaml.safe_load(text)
        if "stages" in content or "learning" in content:
            Setup.model_validate({"version": 1, "name": "shown", "stages": [ANY_STAGE]} | content)
        else:
            load(content, tmp_path)


ANY_STAGE = {"steps": 1, "traffic": ["low"]}


# -- command lines ------------------------------------------------------------------------------


def command_lines(page):
    """Yield the words of every command line that a page shows, in blocks and in sentences."""
    text = page.read_text("utf-8")
    shown = [
        line.removeprefix("$ ")
        for block in blocks(page, "sh", "bash", "console")
        for line in block.replace("\\\n", " ").splitlines()
    ]
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    shown += [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose)]
    for line in shown:
        if re.match(r"(\S*/)?(sfol|aeb|python)\s", line):
            for part in re.split(r"&&|\||;|>", line) if "--facts" not in line else [line]:
                yield shlex.split(part.replace("'", "’"), comments=True)


def fault(words):
    """Return what is wrong with a command line, if anything is."""
    program, *arguments = words
    program = Path(program).name
    if program == "python":
        module = arguments[1] if arguments[:1] == ["-m"] else None
        ours = module and module.split(".")[0] in {"sfol", "vsr", "env"}
        return f"no module {module}" if ours and not importlib.util.find_spec(module) else None
    if program not in COMMANDS:
        return None
    command = COMMANDS[program]
    while hasattr(command, "commands"):
        if not arguments or arguments[0].startswith("-"):
            return None
        if arguments[0] not in command.commands:
            return f"no command {arguments[0]} of {program}"
        command, arguments = command.commands[arguments[0]], arguments[1:]
    known = {"--help", "-h"}
    for parameter in command.params:
        known.update(parameter.opts, parameter.secondary_opts)
    given = {word.partition("=")[0] for word in arguments if re.match(r"--?[a-z]", word)}
    return f"no option {given - known}" if given - known else None


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_on_a_page_exist_with_their_options(page):
    faults = {" ".join(words): fault(words) for words in command_lines(page) if words}
    assert not {line: what for line, what in faults.items() if what}


# -- links --------------------------------------------------------------------------------------


def anchors(page):
    """Return the anchors of a page's headings, as code hosts and these docs make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings
    }


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    # In code, once[1.5](P) is no link; [`code`](link) is one still.
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text("utf-8"), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in link or link.startswith("mailto:"):
            continue
        target, _, anchor = link.partition("#")
        path = (page.parent / target) if target else page
        assert path.exists(), link
        filled_in = path.suffix == ".md" and "{{ " in path.read_text("utf-8")
        if anchor and not filled_in:
            assert anchor in anchors(path), link


# -- the reference ------------------------------------------------------------------------------


@pytest.fixture
def generated(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    return importlib.import_module("generated")


def public_names(path):
    return [
        node.name
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_")
    ]


def test_the_reference_has_every_module_with_a_public_class_or_function(generated):
    pages = "\n".join(generated.fill(p.read_text()) for p in (DOCS / "reference/api").glob("*.md"))
    shown = re.findall(r"^\.\. automodule:: (\S+)\n   :members:$", pages, re.MULTILINE)
    assert sorted(shown) == sorted(set(shown))
    assert {name for name, path in MODULES.items() if public_names(path)} <= set(shown)


def subcommands(command, path):
    if not hasattr(command, "commands"):
        yield path, command
        return
    for name, inner in command.commands.items():
        yield from subcommands(inner, f"{path} {name}")


@pytest.mark.parametrize("program", COMMANDS)
def test_the_reference_has_every_command_and_option(generated, program):
    page = generated.fill((DOCS / "reference/commands" / f"{program}.md").read_text("utf-8"))
    for path, command in subcommands(COMMANDS[program], program):
        section = page.partition(f"# `{path}`\n")[2].partition("\n## ")[0]
        options = [o for p in command.params for o in p.opts if o.startswith("--")]
        assert section, path
        assert [option for option in options if option not in section] == [], path


@pytest.mark.parametrize("page", ["knowledge_base.md", "setup.md"])
def test_the_reference_says_what_every_key_means(generated, page):
    table = generated.fill((DOCS / "reference" / page).read_text("utf-8"))
    rows = re.findall(r"^\| `(\w+)` \|.*\| (.*) \|$", table, re.MULTILINE)
    assert len(rows) > 20
    assert [key for key, meaning in rows if not meaning.strip()] == []


def test_the_reference_has_every_driver_metric_and_bundled_setup():
    metrics = (DOCS / "reference/metrics.md").read_text("utf-8")
    setups = (DOCS / "reference/setup.md").read_text("utf-8")
    assert [n for n in (*DRIVERS, *(m.name for m in METRICS)) if f"`{n}`" not in metrics] == []
    assert [name for name in setup_names() if f"`{name}`" not in setups] == []


def test_the_tests_that_the_page_on_trust_names_exist():
    page = (ROOT / "docs" / "explanation" / "trust.md").read_text()
    named = re.findall(r"`(tests/[\w/.]+)`", page)
    assert len(named) > 30
    assert [path for path in named if not (ROOT / path).exists()] == []

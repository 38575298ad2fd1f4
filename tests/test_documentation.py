"""The code in the documentation runs, and the examples do."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import sfol

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


def run(*arguments):
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_in_the_documentation_runs(page):
    for code in blocks(page, "python"):
        done = run("-c", code)
        assert done.returncode == 0, done.stderr


def test_the_readme_shows_what_its_code_prints():
    (code,) = blocks(ROOT / "README.md", "python")
    printed = run("-c", code).stdout
    assert printed.startswith("-0.0695")
    (shown,) = (text for text in blocks(ROOT / "README.md", "text") if "reward" in text)
    for line in shown.splitlines():
        assert "…" in line or line in printed


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_yaml_in_the_documentation_is_yaml_of_the_format(page):
    keys = set(sfol.knowledge_base.KnowledgeBaseFile.model_fields)
    for text in blocks(page, "yaml"):
        assert set(yaml.safe_load(text)) <= keys


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        assert "://" in target or (page.parent / target).exists(), target


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_examples_run(example):
    done = run(example)
    assert done.returncode == 0, done.stderr
    assert done.stdout

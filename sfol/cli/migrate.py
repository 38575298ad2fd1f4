"""`sfol migrate`: files of an older version of the format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfol import strict_yaml
from sfol.cli.app import app
from sfol.cli.inputs import Sources, paths
from sfol.cli.output import line, print_errors, stdout
from sfol.errors import SfolError
from sfol.knowledge_base.loading import load
from sfol.knowledge_base.migrating import clashing_names, migrated
from sfol.reading import text_of
from sfol.tools.texts import visible
from sfol.writing import replacing


@app.command()
def migrate(
    sources: Sources,
    check: Annotated[
        bool, typer.Option("--check", help="Write nothing; exit with 1 if a file would change.")
    ] = False,
) -> None:
    """Rewrite knowledge bases of an older version of the format.

    A file keeps its meaning, its comments and its order; what had to change is said. A file that
    would be no valid knowledge base then is not touched. Name files that extend each other
    together. Files of the newest version stay as they are.

    Example: `sfol migrate rules/`
    """
    console = stdout()
    texts, broken = _texts(list(paths(sources, "migrate")))
    clashing = frozenset[str]().union(*map(clashing_names, texts.values()))
    found = {path: migrated(text, clashing) for path, text in texts.items()}
    changed = {path: migration for path, migration in found.items() if migration.changes}
    for path, migration in changed.items():
        try:
            load(path, texts={other.resolve(): one.text for other, one in changed.items()})
        except SfolError as error:
            print_errors(error)
            broken += 1
            continue
        if not check:
            with replacing(path, follow_link=True) as part:
                part.write_bytes(migration.text.encode())
        done = "would be migrated" if check else "migrated"
        line(console, f"{visible(path)}: {done}: {'; '.join(migration.changes)}")
    if broken:
        raise typer.Exit(2)
    if changed and check:
        raise typer.Exit(1)


def _texts(files: list[Path]) -> tuple[dict[Path, str], int]:
    """Return the texts of files that are YAML, and the number of those that are not."""
    texts: dict[Path, str] = {}
    for path in files:
        try:
            text = text_of(path)
            strict_yaml.parse(text, str(path))
        except SfolError as error:
            print_errors(error)
            continue
        texts[path] = text
    return texts, len(files) - len(texts)

"""`sfol schema`: the format of a knowledge base, for editors."""

from __future__ import annotations

from sfol.cli.app import app
from sfol.cli.output import print_file
from sfol.knowledge_base.schema import schema_text


@app.command()
def schema() -> None:
    """Print the JSON Schema of a knowledge base file.

    An editor with a YAML language server completes and checks a file whose first line names it:
    `# yaml-language-server: $schema=knowledge_base.schema.json`

    Example: `sfol schema > knowledge_base.schema.json`
    """
    print_file(schema_text())

"""Knowledge bases as they were committed: the only place that talks to git."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from pathlib import Path

from sfol.errors import SfolError, UsageError
from sfol.knowledge_base import KnowledgeBase

# What `extends` can name. A name from a commit is joined to a folder only if it is one of these.
_BASE = re.compile(r"[a-z0-9_]+\.yaml")
# A repository that lacks objects names programs that fetch them; none of them is run.
_FETCHES_NOTHING = {"GIT_NO_LAZY_FETCH": "1", "GIT_ALLOW_PROTOCOL": "none"}


def committed(path: Path) -> KnowledgeBase:
    """Return a file's knowledge base as it was in the last commit.

    Files in its folder that it extends are taken from that commit too; bundled knowledge bases
    are taken as they are now.

    Args:
        path: a file in a git repository.

    Raises:
        UsageError: git is not installed, the file is in no repository, or not in the last commit.
        SfolError: the committed file has errors.
    """
    file = path.resolve()
    objects = _objects(file.parent)
    if file.name not in objects:
        raise UsageError(
            f"'{path}' is not in the last commit",
            name=str(path),
            suggestion="name two knowledge bases to compare",
        )
    with tempfile.TemporaryDirectory() as copy:
        for name, digest in objects.items():
            if name == file.name or _BASE.fullmatch(name):
                Path(copy, name).write_bytes(_git(file.parent, "cat-file", "blob", digest))
        try:
            return KnowledgeBase.load(Path(copy, file.name))
        except SfolError as error:
            raise SfolError(
                f"the committed version of '{path}' is not valid: {error.message}",
                name=error.name,
                suggestion=error.suggestion,
            ) from None


def _objects(folder: Path) -> dict[str, str]:
    """Return name → object of every regular file that the last commit has in a folder."""
    lines = os.fsdecode(_git(folder, "ls-tree", "-z", "HEAD", "./")).split("\0")
    entries = (line.partition("\t") for line in lines if line.startswith("100"))
    return {name: about.split()[2] for about, _, name in entries}


def _git(folder: Path, *arguments: str) -> bytes:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            check=False,
            env={**os.environ, **_FETCHES_NOTHING},
        )
    except OSError:
        raise UsageError(
            "git is not installed", name="git", suggestion="name two knowledge bases to compare"
        ) from None
    if done.returncode:
        reason = done.stderr.decode(errors="replace").strip().splitlines()
        raise UsageError(
            f"there is no commit to compare with: {reason[0] if reason else 'git failed'}",
            name=str(folder),
            suggestion="name two knowledge bases to compare",
        )
    return done.stdout

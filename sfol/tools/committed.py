"""Knowledge bases as they were committed: the only place that talks to git."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from sfol.errors import SfolError, UsageError
from sfol.knowledge_base import KnowledgeBase


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
    folder = path.resolve().parent
    names = _git(folder, "ls-tree", "-z", "--name-only", "HEAD", "./").decode().split("\0")
    if path.name not in names:
        raise UsageError(
            f"'{path}' is not in the last commit",
            name=str(path),
            suggestion="name two knowledge bases to compare",
        )
    with tempfile.TemporaryDirectory() as copy:
        for name in names:
            if name.endswith((".yaml", ".yml")):
                (Path(copy) / name).write_bytes(_git(folder, "show", f"HEAD:./{name}"))
        try:
            return KnowledgeBase.load(Path(copy) / path.name)
        except SfolError as error:
            raise SfolError(
                f"the committed version of '{path}' is not valid: {error.message}",
                name=error.name,
                suggestion=error.suggestion,
            ) from None


def _git(folder: Path, *arguments: str) -> bytes:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, check=False
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

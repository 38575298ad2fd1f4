"""What is wrong with a knowledge base, collected so that one run shows all of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

from sfol.errors import (
    MAXIMUM_ERRORS,
    ClauseError,
    InvalidKnowledgeBase,
    KnowledgeBaseError,
    Place,
    SfolError,
    did_you_mean,
)

Path = tuple[str | int, ...]
# Where a part of the knowledge base stands: a path of keys, and an offset in the text there.
PlaceOf = Callable[[Path, int], Place | None]
_Parsed = TypeVar("_Parsed")


class Reporter:
    """Collects errors, each with its place.

    Args:
        place_of: where a path of keys stands.

    Attributes:
        errors: what was found so far.
        unread: names that something unreadable would have declared: not unknown, but not known
            either.
    """

    def __init__(self, place_of: PlaceOf) -> None:
        self._place_of = place_of
        self.errors: list[SfolError] = []
        self.unread: set[str] = set()
        self._reported: set[tuple[Path, int, str]] = set()

    def parsed(
        self, path: Path, function: Callable[..., _Parsed], *arguments: object
    ) -> _Parsed | None:
        """Call a function; an error of ours is noted with its place, and gives None."""
        try:
            return function(*arguments)
        except SfolError as error:
            offset = error.offset if isinstance(error, ClauseError) else 0
            place = self._place_of(path, offset)
            self._add(error.at(place) if place else error)
            return None

    def report(
        self,
        path: Path,
        message: str,
        name: str,
        suggestion: str | None = None,
        offset: int = 0,
    ) -> None:
        """Note an error.

        Args:
            path: the keys of the part that is wrong.
            message: what is wrong, in one sentence.
            name: the word that is wrong.
            suggestion: what to write instead.
            offset: of that word in the text of the part.
        """
        if (path, offset, message) in self._reported:  # in another part of the same rule
            return
        self._reported.add((path, offset, message))
        place = self._place_of(path, offset)
        self._add(KnowledgeBaseError(message, name=name, suggestion=suggestion, place=place))

    def unknown(
        self, path: Path, what: str, name: str, known: Iterable[str], offset: int = 0
    ) -> None:
        """Note a name that means nothing, with the most similar one that does."""
        if name not in self.unread:
            hint = did_you_mean(name, known)
            self.report(path, f"unknown {what} '{name}'", name, hint, offset)

    def _add(self, error: SfolError) -> None:
        self.errors.append(error)
        if len(self.errors) == MAXIMUM_ERRORS:  # the rest of a large file would take long
            raise InvalidKnowledgeBase(self.errors)

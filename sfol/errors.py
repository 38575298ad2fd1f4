"""Every error that sfol raises on purpose: what is wrong, where, and what to do about it."""

from __future__ import annotations

import bisect
import difflib
import inspect
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

_Item = TypeVar("_Item")


@dataclass(frozen=True, order=True)
class Place:
    """A position in a file that a user wrote.

    Attributes:
        file: the file's name, as the user gave it.
        line: line number from 1, or None where only the file is known.
        column: column number from 1, or None where only the line is known.
    """

    file: str
    line: int | None = None
    column: int | None = None

    def __str__(self) -> str:
        numbers = [str(n) for n in (self.line, self.column) if n is not None]
        return ":".join([self.file, *numbers])


class SfolError(Exception):
    """Base of all errors of this project.

    Args:
        message: what is wrong, in one sentence without the place.
        name: the word that is wrong (a predicate, a key, a file), for programs that want it.
        suggestion: what to write instead, or what to do.
        place: where in a file it stands.
    """

    def __init__(
        self,
        message: str,
        *,
        name: str | None = None,
        suggestion: str | None = None,
        place: Place | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.name = name
        self.suggestion = suggestion
        self.place = place

    def __str__(self) -> str:
        where = f"{self.place}: " if self.place else ""
        hint = f" ({self.suggestion})" if self.suggestion else ""
        return f"{where}{self.message}{hint}"

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions pickle by their positional arguments; ours are mostly keywords.
        return _rebuild, (type(self), self.message, self.name, self.suggestion, self.place)

    def at(self, place: Place) -> SfolError:
        """Return the same error with its place filled in."""
        return type(self)(
            self.message, name=self.name, suggestion=self.suggestion, place=self.place or place
        )


class ClauseError(SfolError):
    """The text of a rule, a condition or a fact is not a clause.

    Args:
        offset: index of the offending character in the text.
    """

    def __init__(
        self,
        message: str,
        *,
        name: str | None = None,
        suggestion: str | None = None,
        place: Place | None = None,
        offset: int = 0,
    ) -> None:
        super().__init__(message, name=name, suggestion=suggestion, place=place)
        self.offset = offset


class FormulaError(ClauseError):
    """The formula of a term is not in the grammar, or gave no number."""


class FactError(SfolError):
    """A fact is malformed, contradicts another or does not fit the knowledge base."""


class SignalError(SfolError):
    """A signal is missing, unknown or not a number."""


class WorkLimitError(SfolError):
    """A body has so many substitutions in a scene that the search for them was given up."""


class KnowledgeBaseError(SfolError):
    """Something in a knowledge base is wrong."""


class UsageError(SfolError):
    """An argument has a value that the function does not take."""


class FileError(UsageError):
    """A file can't be read, or is not in the form that it should have."""


class SilentZeroWarning(UserWarning):
    """Rules can conclude nothing, or have not in a whole episode, so that rewards are 0."""


class MissingExtraError(SfolError):
    """An optional part of the distribution is not installed."""


def warn_of_silence(message: str) -> None:
    """Give a SilentZeroWarning at the line of the program that has called this package.

    Args:
        message: what keeps rewards at 0, and what to do about it.
    """
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").startswith("sfol."):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, SilentZeroWarning, stacklevel=level)


def expect(value: object, kind: type | tuple[type, ...], what: str, suggestion: str) -> None:
    """Make sure that an argument is of the kind that a function takes.

    Args:
        value: the argument.
        kind: what it must be an instance of.
        what: the argument's name, for the message.
        suggestion: what to give instead.

    Raises:
        UsageError: it is of another kind.
    """
    if not isinstance(value, kind):
        raise UsageError(
            f"{what} is of type {type(value).__name__}", name=what, suggestion=suggestion
        )


def listed(values: Iterable[_Item], what: str, suggestion: str) -> list[_Item]:
    """Return an argument's items as a list.

    Raises:
        UsageError: it has none to go through; `what` and `suggestion` as for `expect`.
    """
    try:
        return list(values)
    except TypeError:  # arrays without dimensions say that they could be gone through
        raise UsageError(
            f"{what}: {type(values).__name__} is no list", name=what, suggestion=suggestion
        ) from None


# Extras of packages that no wheel has.
_OF_A_CHECKOUT = frozenset({"aeb", "openvino", "vsr"})


def missing_extra(
    package: str, needed: str, *, extra: str | None = None, python: str | None = None
) -> MissingExtraError:
    """Return the error that says how to install what is missing.

    Args:
        package: what is missing.
        needed: who needs it, such as ``the wrappers need it``.
        extra: the extra that brings it; None for what no extra has.
        python: the version of Python that the extra needs, if not every one will do.
    """
    if extra in _OF_A_CHECKOUT:
        requirement, where = f"--editable '.[{extra}]'", " in the checkout"
    else:
        requirement, where = f"'sfol[{extra}]'" if extra else package, ""
    version = f" on Python {python}" if python else ""
    return MissingExtraError(
        f"{package} is not installed: {needed}",
        name=package,
        suggestion=f"python -m pip install {requirement}{where}{version}",
    )


# More errors than this help nobody; a file of nothing but errors would take long to describe.
MAXIMUM_ERRORS = 100


class InvalidKnowledgeBase(SfolError):  # noqa: N818 (it holds errors, it is not one more of them)
    """A knowledge base that cannot be used, with everything that is wrong with it.

    Args:
        errors: the single errors, at least one; they are put in the order of their places, and
            those after the first hundred are dropped.
    """

    def __init__(self, errors: Sequence[SfolError]) -> None:
        self.errors = tuple(sorted(errors, key=_by_place))[:MAXIMUM_ERRORS]
        first = self.errors[0]
        super().__init__(
            first.message, name=first.name, suggestion=first.suggestion, place=first.place
        )

    def __str__(self) -> str:
        return "\n".join(str(error) for error in self.errors)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.errors,)


def _by_place(error: SfolError) -> tuple[str, int, int]:
    place = error.place or Place("")
    return place.file, place.line or 0, place.column or 0


def _rebuild(
    kind: type[SfolError],
    message: str,
    name: str | None,
    suggestion: str | None,
    place: Place | None,
) -> SfolError:
    return kind(message, name=name, suggestion=suggestion, place=place)


_MOST_COMPARED = 500


def torn_apart(text: str) -> str | None:
    """Return what to do about a text that YAML has cut at a comma, if it looks like that."""
    if text.count("(") == text.count(")") or len(text) > 80:
        return None
    return (
        "within [ ] and { } of YAML a comma tears text apart: put the whole in quotes, as in "
        '"CenterOf(p1, ego)" or "min(v, 1)"'
    )


def did_you_mean(name: str, known: Iterable[str]) -> str | None:
    """Return ``did you mean 'X'?`` for the known name most like this one, or the choices.

    Args:
        name: what was written.
        known: what could have been meant.

    Returns:
        A suggestion for `SfolError`, or None where nothing is known at all.
    """
    candidates = sorted(set(known))
    close = closest(name, candidates)
    if close is not None:
        return f"did you mean '{close}'?"
    if not candidates:
        return None
    shown = ", ".join(candidates[:8])
    return f"known: {shown}" + (", …" if len(candidates) > 8 else "")


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is most like this one, or None if none is like it."""
    candidates = sorted(set(known))
    # Of very many names those that stand near it in the alphabet: comparing with all takes long.
    here = bisect.bisect(candidates, name)
    near = candidates[max(here - _MOST_COMPARED // 2, 0) :][:_MOST_COMPARED]
    by_lower = {candidate.lower(): candidate for candidate in near}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[close[0]] if close else None

"""Connections to pybullet, each a world of its own."""

from __future__ import annotations

import weakref
from contextlib import suppress
from typing import NoReturn, SupportsIndex

from sfol.errors import UsageError, missing_extra

try:
    import pybullet
except ImportError as error:
    raise missing_extra(
        "pybullet", "the bundled street needs it", extra="aeb", python="3.11"
    ) from error


class NotCopied:
    """What can't be copied or pickled, since both would move the same bodies."""

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Refuse.

        Raises:
            UsageError: always.
        """
        raise UsageError(
            "a street can't be copied or pickled: its bodies live in one client of this process",
            suggestion="build another one with the same arguments; equal seeds make them equal",
        )


class Client(NotCopied):
    """A connection, closed at the latest when nobody uses it any more.

    Raises:
        UsageError: pybullet does not start.
    """

    def __init__(self) -> None:
        self._number = _connect()
        # Clients that nobody closes would keep their memory.
        self.close = weakref.finalize(self, _disconnect, self._number)

    @property
    def number(self) -> int:
        """The client's number, by which pybullet knows it.

        Raises:
            UsageError: it is closed.
        """
        self.check_open()
        return self._number

    def check_open(self) -> None:
        """Refuse to go on with a client that is closed.

        Raises:
            UsageError: it is closed.
        """
        if not self.close.alive:
            raise UsageError("the street is closed", suggestion="build another one")


def _connect() -> int:
    """Return a new physics client, which renders too."""
    try:
        client = int(pybullet.connect(pybullet.DIRECT))
    except pybullet.error as error:
        raise _no_client(str(error)) from error
    if client < 0:
        raise _no_client("it gave no reason")
    return client


def _disconnect(client: int) -> None:
    """Free a physics client; what is gone already, as at the end of a program, stays so."""
    with suppress(pybullet.error):
        pybullet.disconnect(physicsClientId=client)


def _no_client(reason: str) -> UsageError:
    return UsageError(
        f"pybullet does not start: {reason}",
        name="pybullet",
        suggestion="close streets that are no longer driven; a process may have some 1000 of them",
    )

"""Who has logged in at the broker through this server: only they get what is not for everybody, such as the reports of runs.

No second rights system: a browser gets a ticket with its WebSocket. It counts from the moment when the broker accepts a login on
it, and until the last connection of that browser which was logged in has ended. Pure; randomness is an argument.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

#: Begin of the cookie's name; the port follows, because browsers do not tell the ports of a host apart.
NAME = "console_ticket"


class Tickets:
    """The tickets of this run.

    Parameters
    ----------
    new : callable
        Returns a text that cannot be guessed.
    port : int
        Of this server.
    """

    def __init__(self, new: Callable[[], str], port: int):
        self._new = new
        self._name = f"{NAME}_{port}"
        self._logins: Counter[str] = Counter()

    def give(self, header: str | None) -> str:
        """Return the ticket for a connection whose request has this `Cookie` header.

        A browser that is logged in keeps the one it has: a second tab must not take the first one's away.
        """
        return self._shown(header) or self._new()

    def login(self, ticket: str) -> None:
        """Note that the broker has accepted a login on a connection with this ticket."""
        self._logins[ticket] += 1

    def logout(self, ticket: str) -> None:
        """Note that a connection which was logged in has ended."""
        self._logins[ticket] -= 1
        if self._logins[ticket] <= 0:
            del self._logins[ticket]

    def is_known(self, header: str | None) -> bool:
        """Return whether a request with this `Cookie` header comes from somebody who is logged in."""
        return bool(self._shown(header))

    def _shown(self, header: str | None) -> str:
        # by hand: the library's parser drops all cookies of a host where another program's is no proper one
        for part in (header or "").split(";"):
            name, _, value = part.strip().partition("=")
            if name == self._name and value in self._logins:
                return value
        return ""

    def cookie(self, ticket: str, secure: bool) -> str:
        """Return the `Set-Cookie` header of a ticket.

        It is for all paths: a browser must show the one it has with its next WebSocket, too, or a second tab's takes its place.
        """
        return f"{self._name}={ticket}; Path=/; HttpOnly; SameSite=Strict" + ("; Secure" if secure else "")

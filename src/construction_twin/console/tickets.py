"""Who has logged in at the broker through this server: only they get what is not for everybody, such as the robot's model.

No second rights system: a browser gets a ticket with its WebSocket. It counts from the moment when the broker accepts a login on
it, and until the last connection of that account has ended, in whichever tab or browser: two tabs that connect at once get a ticket
each, and the browser keeps the later one only, which must not end with its own tab. Pure; randomness is an argument.
"""

from __future__ import annotations

from collections.abc import Callable

#: Tickets of an account whose own connections have ended: the oldest of more than so many count no longer.
MOST_ENDED = 64
#: Begin of the cookie's name; the port follows, because browsers do not tell the ports of a host apart.
NAME = "console_ticket"


class Tickets:
    """The tickets of this run.

    Args:
        new: Returns a text that cannot be guessed.
        port: Of this server.
    """

    def __init__(self, new: Callable[[], str], port: int):
        self._new = new
        self._name = f"{NAME}_{port}"
        #: By account, and by ticket in the order of their last logins: how many connections it has.
        self._logins: dict[str, dict[str, int]] = {}

    def give(self, header: str | None) -> str:
        """Return the ticket for a connection whose request has this `Cookie` header.

        A browser that is logged in keeps the one it has: a second tab must not take the first one's away.
        """
        return self._shown(header) or self._new()

    def login(self, ticket: str, account: str) -> None:
        """Note that the broker has accepted a login to an account on a connection with this ticket."""
        tickets = self._logins.setdefault(account, {})
        tickets[ticket] = tickets.pop(ticket, 0) + 1

    def logout(self, ticket: str, account: str) -> None:
        """Note that a connection which was logged in has ended."""
        tickets = self._logins[account]
        tickets[ticket] -= 1
        ended = [each for each, connections in tickets.items() if not connections]
        if len(ended) == len(tickets):
            del self._logins[account]
        elif len(ended) > MOST_ENDED:
            del tickets[ended[0]]

    def is_known(self, header: str | None) -> bool:
        """Return whether a request with this `Cookie` header comes from somebody who is logged in."""
        return bool(self._shown(header))

    def _shown(self, header: str | None) -> str:
        # by hand: the library's parser drops all cookies of a host where another program's is no proper one
        for part in (header or "").split(";"):
            name, _, value = part.strip().partition("=")
            if name == self._name and any(value in tickets for tickets in self._logins.values()):
                return value
        return ""

    def cookie(self, ticket: str, secure: bool) -> str:
        """Return the `Set-Cookie` header of a ticket.

        It is for all paths: a browser must show the one it has with its next WebSocket, too, or a second tab's takes its place.
        """
        return f"{self._name}={ticket}; Path=/; HttpOnly; SameSite=Strict" + ("; Secure" if secure else "")

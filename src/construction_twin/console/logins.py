"""What a server knows of logins: who is in, which passwords were wrong; and their lines in the log.

Two allowances of lines, so that none hides the other: logins, and wrong passwords.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from construction_twin.console.connection_limits import OpenConnections
from construction_twin.console.tickets import Tickets
from construction_twin.core.rate_limit import TokenBucket

log = logging.getLogger("console")


class Lines:
    """Lines that others can cause: not more of them than a disk can hold; the next one says how many were left out.

    Args:
        rate, burst: So many per second in the long run, and at once.
        clock: Returns a time from any origin [ns].
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], int]):
        self._clock = clock
        self._bucket = TokenBucket(rate, burst)
        self._left_out = 0

    def write(self, level: int, sentence: str) -> None:
        """Write a line, or count it."""
        if self._bucket.take(self._clock()):
            more = f" ({self._left_out} lines before it were left out)" if self._left_out else ""
            log.log(level, "%s%s", sentence, more)
            self._left_out = 0
        else:
            self._left_out += 1


class Logins:
    """The logins of a server.

    Args:
        clock: Returns a time from any origin [ns].
    """

    def __init__(self, connections: OpenConnections, tickets: Tickets, clock: Callable[[], int]):
        self.connections = connections
        self.tickets = tickets
        self.lines = Lines(1, 20, clock)
        self.wrong_lines = Lines(1, 20, clock)


class ConnectionLogin:
    """The login of one connection, as the pipe tells of it.

    Args:
        number: Of the connection, by which its place is known.
        peer: Its address.
        ticket: Of its browser.

    Attributes:
        is_wrong: Its password was refused, which has been told.
    """

    def __init__(self, logins: Logins, number: int, peer: str, ticket: str):
        self._logins = logins
        self._number, self._peer, self._ticket = number, peer, ticket
        self._account: str | None = None
        self.is_wrong = False

    def accepted(self, account: str) -> str:
        """Note that the broker has accepted it; return why it may not stay all the same, or an empty text."""
        logins = self._logins
        if why := logins.connections.login(self._number, account):
            logins.lines.write(logging.WARNING, f"{self._peer} refused as {shown(account)}: {why}")
            return why
        self._account = account
        logins.tickets.login(self._ticket, account)
        logins.lines.write(logging.INFO, f"{self._peer} logged in as {shown(account)}")
        return ""

    def wrong(self, account: str) -> None:
        """Note that the broker says that user name or password is wrong."""
        self.is_wrong = True
        self._logins.wrong_lines.write(logging.WARNING, f"{self._peer}: wrong password for {shown(account)}")

    def end(self) -> None:
        """Note that the connection has ended."""
        if self._account is not None:
            self._logins.tickets.logout(self._ticket, self._account)


def shown(account: str) -> str:
    """Return an account for the log: a browser chooses the text."""
    return repr(account[:64]) if account else "nobody (no account)"

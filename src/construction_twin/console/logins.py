"""What a server knows of logins: who waits, who is in, which passwords were wrong; and their lines in the log.

Three allowances of lines, so that none hides another: what anybody on the network can cause, what takes a right password, and wrong
passwords.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from construction_twin.console.connection_limits import OpenConnections
from construction_twin.console.login_pace import LoginPace
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

    def __init__(self, connections: OpenConnections, tickets: Tickets, pace: LoginPace, clock: Callable[[], int]):
        self.connections = connections
        self.tickets = tickets
        self.pace = pace
        self.clock = clock
        self.lines = Lines(1, 20, clock)
        # the pace bounds those of each address already: this is for wrong passwords from very many
        self.wrong_lines = Lines(2, 200, clock)


class ConnectionLogin:
    """The login of one connection, as the pipe asks and tells of it.

    Args:
        number: Of the connection, by which its place is known.
        peer: Its address.
        ticket: Of its browser.

    Attributes:
        accounts: Those that the broker has accepted on it.
        is_wrong: The broker has refused its password, which has been told.
    """

    def __init__(self, logins: Logins, number: int, peer: str, ticket: str):
        self._logins = logins
        self._number, self._peer, self._ticket = number, peer, ticket
        self.accounts: list[str] = []
        self.is_wrong = False

    def wait_s(self, account: str) -> float:
        """Return how long a CONNECT with user name or password waits before it is passed on [s]."""
        wait_s = self._logins.pace.wait_s(self._peer, account, self._logins.clock())
        if wait_s:
            self._logins.connections.wait(self._number, account)
        return wait_s

    def waited(self) -> None:
        """Note that it is passed on now, or that its browser has gone."""
        self._logins.connections.waited(self._number)

    def accepted(self, account: str) -> str:
        """Note that the broker has accepted it; return why it may not stay all the same, or an empty text."""
        logins = self._logins
        before = logins.pace.right(self._peer, account)
        after = f"; wrong passwords from there before: {before}" if before else ""
        if why := logins.connections.login(self._number, account):
            logins.lines.write(logging.WARNING, f"{self._peer} refused as {shown(account)}: {why}{after}")
            return why
        self.accounts.append(account)
        logins.tickets.login(self._ticket, account)
        logins.lines.write(logging.INFO, f"{self._peer} logged in as {shown(account)}{after}")
        return ""

    def wrong(self, account: str) -> None:
        """Note that the broker says that user name or password is wrong."""
        self.is_wrong = True
        self._count(account, "wrong password for")

    def left(self, account: str) -> None:
        """Note that a browser has left after its login was passed on, and before the broker's answer."""
        self._count(account, "left before the broker's answer, which counts as a wrong password for")

    def _count(self, account: str, what: str) -> None:
        more = self._logins.pace.wrong(self._peer, account, self._logins.clock())
        if more is not None:
            self._logins.wrong_lines.write(logging.WARNING, f"{self._peer}: {what} {shown(account)}{more}")

    def end(self) -> None:
        """Note that the connection has ended."""
        for account in self.accounts:
            self._logins.tickets.logout(self._ticket, account)


def shown(account: str) -> str:
    """Return an account for the log: a browser chooses the text."""
    return repr(account[:64]) if account else "nobody (no account)"

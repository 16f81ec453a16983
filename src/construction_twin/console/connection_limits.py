"""Limits of open connections: unauthenticated ones never displace authenticated ones.

Many people may share an address: behind a router, or behind a proxy. Pure: connections are numbers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class ConnectionLimits:
    """How many connections there may be.

    Attributes:
        anonymous, anonymous_per_address: Of those that have not logged in: they begin TLS, ask for something, get a file, or are
            about to log in.
        logins, logins_per_address, logins_per_account: Of WebSockets on which the broker has accepted a login. A broker without
            accounts has no limit per account.
    """

    anonymous: int = 256
    anonymous_per_address: int = 64
    logins: int = 64
    logins_per_address: int = 16
    logins_per_account: int = 16


class OpenConnections:
    """The open connections of a server.

    A new one is always accepted: above a limit the oldest unauthenticated connection of the address with the most of them is
    closed. So one address, however many connections it makes, takes nothing from another one with fewer.
    """

    def __init__(self, limits: ConnectionLimits):
        self._limits = limits
        self._anonymous: dict[int, str] = {}
        #: Address and account.
        self._logins: dict[int, tuple[str, str]] = {}

    def enter(self, connection: int, address: str) -> int | None:
        """Note a new connection; return the one that is to be closed for it, and is counted no more, or None."""
        self._anonymous[connection] = address
        counts = Counter(self._anonymous.values())
        if counts[address] > self._limits.anonymous_per_address:
            return self._take_oldest([address])
        if len(self._anonymous) > self._limits.anonymous:
            most = max(counts.values())
            return self._take_oldest([each for each, count in counts.items() if count == most])
        return None

    def _take_oldest(self, addresses: Iterable[str]) -> int:
        # a dict keeps the order in which they came
        oldest = next(each for each, address in self._anonymous.items() if address in addresses)
        self.leave(oldest)
        return oldest

    def login(self, connection: int, account: str) -> str:
        """Count a connection as authenticated; return the limit that forbids it, or an empty text."""
        address = self._anonymous.get(connection)
        if address is None:
            return "the connection has ended"
        limits, logins = self._limits, self._logins.values()
        if len(logins) >= limits.logins:
            return "too many connections are logged in"
        if sum(at == address for at, _ in logins) >= limits.logins_per_address:
            return "too many connections from this address are logged in"
        if account and sum(of == account for _, of in logins) >= limits.logins_per_account:
            return "too many connections are logged in to this account"
        del self._anonymous[connection]
        self._logins[connection] = address, account
        return ""

    def leave(self, connection: int) -> None:
        """Note that a connection has ended; one that had to go has been forgotten before."""
        self._anonymous.pop(connection, None)
        self._logins.pop(connection, None)

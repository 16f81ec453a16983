"""How long a login waits after wrong passwords: by the address it comes from, and longer by account and address together.

It is a wait, never a refusal, and has an upper bound. It holds for the address from which the wrong passwords came: a stranger
elsewhere slows nobody down, however often he guesses at somebody's account. Whether a password is wrong is the broker's answer.

What is remembered is bounded, and so are the lines of the log. Where there is no room the least goes: the address, or the account
of an address, whose wrong passwords would be forgotten first in any case. So whoever wants his own ones forgotten needs as many
again from every other address, or for every other account, that is remembered. Pure: `now` is an argument [ns].
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

from construction_twin.core.line_limiter import LineLimiter
from construction_twin.core.rate_limit import TokenBucket
from construction_twin.core.units import NANOSECONDS

#: Longest account that is told from others [characters]: those that begin alike have one pace.
_LONGEST_ACCOUNT = 64
_LINE = "wrong password"


@dataclass(frozen=True)
class PaceLimits:
    """How long a login waits, and how much is remembered.

    Attributes:
        account_first_s, account_most_s: Wait after the first wrong password of an account at an address, and longest wait [s]. Each
            wrong password doubles it.
        address_first_s, address_most_s: The same for an address, whatever the account [s].
        forget_s: After so long one wrong password is forgotten [s].
        most: So many count at most, so that everything is forgotten after `most` times `forget_s`.
        addresses, accounts: So many addresses are remembered, and so many accounts of each.
        line_s: Each account at an address has at most one line of the log in this time [s]. All accounts of an address beyond those
            that are remembered share one.
    """

    account_first_s: float = 0.5
    account_most_s: float = 5.0
    address_first_s: float = 0.1
    address_most_s: float = 2.0
    forget_s: float = 60.0
    most: int = 8
    addresses: int = 1024
    accounts: int = 16
    line_s: float = 60.0


class _Wrong:
    """Wrong passwords, which are forgotten one after the other."""

    def __init__(self, limits: PaceLimits, lines: LineLimiter):
        self._forget = limits.forget_s * NANOSECONDS
        self._bucket = TokenBucket(1 / limits.forget_s, limits.most)
        self.lines = lines
        self.count = 0

    def note(self, now: int) -> None:
        """Count another one."""
        self.count += 1
        self._bucket.take(now)

    def rest(self, now: int) -> float:
        """Return how long until all are forgotten [ns]."""
        return self._bucket.rest(now)

    def wait_s(self, first: float, most: float, now: int) -> float:
        """Return how long a login waits [s]: `first` after one, doubled by each that is not forgotten, at most `most`."""
        left = self.rest(now) / self._forget
        return min(most, first * 2 ** (left - 1)) if left else 0.0


class _Address(_Wrong):
    """Of an address: all of its wrong passwords, and those of each account. `lines` is for accounts that had no room."""

    def __init__(self, limits: PaceLimits, lines: LineLimiter):
        super().__init__(limits, lines)
        self.accounts: dict[str, _Wrong] = {}


_Kind = TypeVar("_Kind", bound=_Wrong)


def _least(known: Mapping[str, _Kind], now: int) -> str:
    # of several the oldest: a dict keeps their order
    return min(known, key=lambda name: known[name].rest(now))


class LoginPace:
    """The wrong passwords of a server's clients.

    Attributes:
        count: How many there were, of all.
    """

    def __init__(self, limits: PaceLimits):
        self._limits = limits
        self._addresses: dict[str, _Address] = {}
        self.count = 0

    def wait_s(self, address: str, account: str, now: int) -> float:
        """Return how long a login that comes at `now` waits [s]."""
        limits, known = self._limits, self._addresses.get(network(address))
        if known is None:
            return 0.0
        own = known.accounts.get(account[:_LONGEST_ACCOUNT])
        return max(
            known.wait_s(limits.address_first_s, limits.address_most_s, now),
            own.wait_s(limits.account_first_s, limits.account_most_s, now) if own is not None else 0.0,
        )

    def wrong(self, address: str, account: str, now: int) -> str | None:
        """Count a wrong password.

        Returns:
            What to append to its line of the log, "" or how many like it were left out before; None when there is to be no line.
        """
        self.count += 1
        limits, where = self._limits, network(address)
        known = self._addresses.get(where)
        if known is None:
            if len(self._addresses) >= limits.addresses:
                del self._addresses[_least(self._addresses, now)]
            known = self._addresses[where] = _Address(limits, self._lines())
        known.note(now)
        name = account[:_LONGEST_ACCOUNT]
        own = known.accounts.get(name)
        if own is None:
            lines = self._lines()
            if len(known.accounts) >= limits.accounts:
                least = _least(known.accounts, now)
                # one name after the other would make a line each
                lines = known.lines if known.accounts[least].rest(now) else lines
                del known.accounts[least]
            own = known.accounts[name] = _Wrong(limits, lines)
        own.note(now)
        return own.lines.note(_LINE, now)

    def right(self, address: str, account: str) -> int:
        """Forget the wrong passwords of an account at an address, which has just logged in there; return how many there were.

        Those of the address stay: else whoever has an account of his own would begin anew with each login to it.
        """
        known = self._addresses.get(network(address))
        own = known.accounts.pop(account[:_LONGEST_ACCOUNT], None) if known is not None else None
        return own.count if own is not None else 0

    def _lines(self) -> LineLimiter:
        return LineLimiter(round(self._limits.line_s * NANOSECONDS))


def network(address: str) -> str:
    """Return for whom an address stands: of IPv6 its first 64 bits, because whoever has one of such a network has all of them."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv4Address):
        return address
    if found.ipv4_mapped is not None:
        return str(found.ipv4_mapped)
    return str(ipaddress.ip_network((int(found) >> 64 << 64, 64)))

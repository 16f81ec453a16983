"""What a server knows of logins: who waits, who is in, which passwords were wrong; and their lines in the log.

Three allowances of lines, so that none hides another: what anybody on the network can cause, what takes a right password, and wrong
passwords.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING

from construction_twin.console.connection_limits import OpenConnections
from construction_twin.console.login_pace import LoginPace
from construction_twin.console.packets import Packet, password, user_name, with_password
from construction_twin.console.paired import DEVICE_MARK, PIN_MARK, DeviceCookie, PairingError, is_marked
from construction_twin.console.tickets import Tickets
from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.rate_limit import TokenBucket
from construction_twin.core.sentences import Sentence

if TYPE_CHECKING:
    from construction_twin.console.pairings import Pairings

log = logging.getLogger("console")
#: So often it is looked whether the devices that are connected are still paired [s].
WATCH_S = 1.0


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
        pin_pace: Of wrong PINs, by device in the place of the address: a tablet slows down no other one behind its router.
        clock: Returns a time from any origin [ns].
        pairings: None: no device is paired here.
    """

    def __init__(
        self,
        connections: OpenConnections,
        tickets: Tickets,
        pace: LoginPace,
        pin_pace: LoginPace,
        clock: Callable[[], int],
        pairings: Pairings | None = None,
    ):
        self.connections = connections
        self.tickets = tickets
        self.pace = pace
        self.pin_pace = pin_pace
        self.clock = clock
        self.pairings = pairings
        #: By device: what tells each of its connections that it is not paired any more.
        self.devices: dict[str, set[asyncio.Event]] = {}
        self.lines = Lines(1, 20, clock)
        # the pace bounds those of each address already: this is for wrong passwords from very many
        self.wrong_lines = Lines(2, 200, clock)

    async def watch(self) -> None:
        """Look again and again whether the devices that are connected are still paired; never ends."""
        while True:
            await asyncio.sleep(WATCH_S)
            if self.pairings is None:
                continue
            for device in tuple(self.devices):
                try:
                    paired = await asyncio.to_thread(self.pairings.is_paired, device)
                except OSError as error:
                    # the stop of whoever is connected is not taken away for a disk that does not answer
                    self.lines.write(logging.ERROR, f"cannot look whether a device is still paired: {error}")
                    continue
                for each in () if paired else self.devices.get(device, ()):
                    each.set()


class ConnectionLogin:
    """The login of one connection, as the pipe asks and tells of it.

    Args:
        number: Of the connection, by which its place is known.
        peer: Its address.
        ticket: Of its browser.
        cookie: That it is a paired device, as it says.

    Attributes:
        accounts: Those that the broker has accepted on it.
        is_wrong: Its password or PIN was refused, which has been told.
    """

    def __init__(self, logins: Logins, number: int, peer: str, ticket: str, cookie: DeviceCookie | None = None):
        self._logins = logins
        self._number, self._peer, self._ticket = number, peer, ticket
        self._cookie = cookie
        self._revoked = asyncio.Event()
        self._is_filled = False
        self.accounts: list[str] = []
        self.is_wrong = False

    def wait_s(self, connect: Packet) -> float:
        """Return how long a CONNECT with user name or password waits before it is passed on [s]."""
        logins, account = self._logins, user_name(connect)
        if not self._is_asked(connect):
            wait_s = logins.pace.wait_s(self._peer, account, logins.clock())
        elif password(connect) == DEVICE_MARK:
            # nothing is guessed, and whoever wants to stop does not wait
            wait_s = 0.0
        else:
            # of a browser that only says that it is this device: its wrong PINs do not count, and its login goes no further
            device = self._cookie.device if self._cookie is not None else self._peer
            wait_s = logins.pin_pace.wait_s(device, account, logins.clock())
        if wait_s:
            logins.connections.wait(self._number, account)
        return wait_s

    def _is_asked(self, connect: Packet) -> bool:
        """Return whether a CONNECT asks for a password to be put in."""
        return self._logins.pairings is not None and is_marked(password(connect))

    async def filled(self, connect: Packet) -> Packet:
        """Return a CONNECT as it is passed on: that of a paired device with its password, any other unchanged.

        Raises:
            PairingError: When it is not passed on.
        """
        if not self._is_asked(connect):
            return connect
        pairings, account, mark = self._logins.pairings, user_name(connect), password(connect)
        assert pairings is not None and mark is not None
        try:
            if mark.startswith(PIN_MARK):
                pin = mark.removeprefix(PIN_MARK).decode(errors="replace")
                # in a thread: it is meant to take long
                found = await asyncio.to_thread(pairings.password, self._cookie, account, pin)
            elif mark == DEVICE_MARK:
                found = await asyncio.to_thread(pairings.password_without_pin, self._cookie, account)
            else:
                raise PairingError("device", Sentence("view.pair.device"))
        except PairingError as error:
            self._refused(account, error)
            raise
        except (ConstructionTwinError, OSError) as error:
            refused = PairingError("console", Sentence("view.pair.trouble", problem=str(error)))
            self._refused(account, refused)
            raise refused from error
        assert self._cookie is not None
        self._is_filled = True
        self._logins.devices.setdefault(self._cookie.device, set()).add(self._revoked)
        return with_password(connect, found.encode())

    def _refused(self, account: str, error: PairingError) -> None:
        """Note that a device's login is not passed on."""
        self.is_wrong = True
        more: str | None = ""
        if error.why == "wrong" and self._cookie is not None:
            more = self._logins.pin_pace.wrong(self._cookie.device, account, self._logins.clock())
        if more is not None:
            self._logins.wrong_lines.write(logging.WARNING, f"{self._peer}: {error} (as {shown(account)}){more}")

    async def revoked(self) -> None:
        """Return when the device whose password was put in is not paired any more."""
        await self._revoked.wait()

    def waited(self) -> None:
        """Note that it is passed on now, or that its browser has gone."""
        self._logins.connections.waited(self._number)

    def accepted(self, account: str) -> str:
        """Note that the broker has accepted it; return why it may not stay all the same, or an empty text."""
        logins = self._logins
        before = logins.pace.right(self._peer, account)
        if self._is_filled and self._cookie is not None:
            logins.pin_pace.right(self._cookie.device, account)
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
        if self._is_filled:
            # nobody has guessed: the account has another password now
            said = (
                f"{self._peer}: the broker refuses what is kept for a paired device of {shown(account)}; pair it again"
            )
            self._logins.wrong_lines.write(logging.WARNING, said)
            return
        self._count(account, "wrong password for")

    def left(self, account: str) -> None:
        """Note that a browser has left after its login was passed on, and before the broker's answer."""
        # the PIN of a device was right by then
        if not self._is_filled:
            self._count(account, "left before the broker's answer, which counts as a wrong password for")

    def _count(self, account: str, what: str) -> None:
        more = self._logins.pace.wrong(self._peer, account, self._logins.clock())
        if more is not None:
            self._logins.wrong_lines.write(logging.WARNING, f"{self._peer}: {what} {shown(account)}{more}")

    def end(self) -> None:
        """Note that the connection has ended."""
        for account in self.accounts:
            self._logins.tickets.logout(self._ticket, account)
        if self._is_filled and self._cookie is not None:
            connections = self._logins.devices[self._cookie.device]
            connections.discard(self._revoked)
            if not connections:
                del self._logins.devices[self._cookie.device]


def shown(account: str) -> str:
    """Return an account for the log: a browser chooses the text."""
    return repr(account[:64]) if account else "nobody (no account)"

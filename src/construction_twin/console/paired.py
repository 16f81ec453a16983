"""What a paired device and its console say to each other: the cookie, what stands in place of a password, what is refused. Pure.

A browser gets the cookie when it is paired, and shows it with every request. Its page then logs in with a password that begins with
a zero byte, which no password that `make_site` makes has, and none that a person can type: it asks the console to put in what it
keeps for this device (`pairings.py`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence

#: What a password begins with in whose place the console puts the person's own; the PIN follows.
PIN_MARK = b"\0pin:"
#: The password in whose place it puts that of the account for devices without a PIN.
DEVICE_MARK = b"\0device"
#: Begin of the cookie's name, with the port behind it, and for how long a browser keeps it [s]: the most that Chromium takes.
NAME, COOKIE_S = "console_device", 400 * 24 * 3600
_VALUE = re.compile(r"([0-9a-f]{32})\.([A-Za-z0-9_-]{43})")


class PairingError(ConstructionTwinError):
    """A device, an invitation or a PIN is refused.

    Args:
        why: ``code`` (no such invitation: used, withdrawn or too old), ``pin`` (none that may be chosen), ``device`` (the browser
            is not paired, or not any more), ``wrong`` (a wrong PIN), ``erased`` (too many of them: pair again), ``console`` (what
            is kept cannot be read).
        number: Of the device, where it is known.
        left: Of a wrong PIN: how many more may be tried.
    """

    def __init__(self, why: str, sentence: Sentence, number: int = 0, left: int = 0):
        self.why, self.number, self.left = why, number, left
        super().__init__(sentence)


def no_invitation() -> PairingError:
    """Return what is said of a token that there is no invitation for."""
    return PairingError("code", Sentence("view.pair.code"))


def is_marked(password: bytes | None) -> bool:
    """Return whether a password is one in whose place the console puts another."""
    return password is not None and password.startswith(b"\0")


@dataclass(frozen=True)
class DeviceCookie:
    """Who a browser is.

    Attributes:
        device: By which its entry is found; no secret.
        secret: Without which the entry cannot be opened.
    """

    device: str
    secret: str

    def __repr__(self) -> str:
        """Return it without the secret: a line of the log is no place for it."""
        return f"DeviceCookie({self.device[:8]})"

    @classmethod
    def shown(cls, header: str | None, port: int, secure: bool) -> DeviceCookie | None:
        """Return what a `Cookie` header holds; None where there is none, or it is no proper one.

        Args:
            port, secure: Of this server, as of `header`.
        """
        for part in (header or "").split(";"):
            name, _, value = part.strip().partition("=")
            if name == _name(port, secure) and (found := _VALUE.fullmatch(value)):
                return cls(found[1], found[2])
        return None

    def header(self, port: int, secure: bool) -> str:
        """Return the `Set-Cookie` header.

        Args:
            port: Of this server: browsers do not tell the ports of a host apart.
            secure: It speaks TLS. Then no page without TLS, and none of another name, can plant such a cookie.
        """
        return (
            f"{_name(port, secure)}={self.device}.{self.secret}; Path=/; Max-Age={COOKIE_S}; HttpOnly; SameSite=Strict"
            + ("; Secure" if secure else "")
        )


def _name(port: int, secure: bool) -> str:
    return f"{'__Host-' if secure else ''}{NAME}_{port}"

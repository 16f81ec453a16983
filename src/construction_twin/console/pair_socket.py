"""The pairing of one browser, over a WebSocket of its own: one message each way, as JSON, and its end.

    {"token": "...", "pin": "482139"}
    {"ok": true, "account": "ada", "device_account": "ada-device", "number": 3}     or {"ok": false, "why": "code"}

A WebSocket, because the server takes no request with a body. The cookie comes with its 101, so before the token: `proposed` says
whether there is anything to hope for, by the token's hash.
"""

from __future__ import annotations

import asyncio
import json

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from construction_twin.console.paired import DeviceCookie, PairingError, no_invitation
from construction_twin.console.pairings import Pairings
from construction_twin.core.errors import ConstructionTwinError

#: Longest message [characters].
LONGEST = 512
#: Longest wait for the message [s].
WAIT_S = 5.0


def proposed(subprotocols: str) -> str:
    """Return the token's hash, which a browser names behind the subprotocol; "" where it names none."""
    words = [word.strip() for word in subprotocols.split(",")]
    return next((word for word in words if len(word) == 64), "")


async def pair(
    browser: ServerConnection,
    pairings: Pairings,
    cookie: DeviceCookie | None,
    former: DeviceCookie | None,
    address: str,
) -> str:
    """Answer one browser; return in one sentence what became of it.

    Args:
        cookie: Given with the 101; None where there was no such invitation.
        former: What the browser has shown.
    """
    try:
        message = await asyncio.wait_for(browser.recv(), WAIT_S)
    except (TimeoutError, ConnectionClosed):
        return "asked for no pairing"
    asked = _read(message)
    if asked is None:
        answer, said = {"ok": False, "why": "format"}, "asked for a pairing in another form"
    else:
        try:
            if cookie is None:
                raise no_invitation()
            device = await asyncio.to_thread(pairings.pair, *asked, cookie, address, former)
        except PairingError as error:
            answer, said = {"ok": False, "why": error.why}, f"was not paired: {error}"
        except (ConstructionTwinError, OSError) as error:
            answer, said = {"ok": False, "why": "console"}, f"was not paired: {error}"
        else:
            answer = {"ok": True, "number": device.number}
            answer |= {"account": device.account, "device_account": device.device_account}
            said = f"paired as device {device.number} of {device.account!r}"
    try:
        await browser.send(json.dumps(answer))
    except ConnectionClosed:
        said += ", and has left before the answer"
    return said


def _read(message: str | bytes) -> tuple[str, str] | None:
    """Return token and PIN; None when the message is none."""
    if isinstance(message, bytes) or len(message) > LONGEST:
        return None
    try:
        fields = json.loads(message)
    except (ValueError, RecursionError):
        return None
    if not isinstance(fields, dict) or set(fields) != {"token", "pin"}:
        return None
    token, pin = fields["token"], fields["pin"]
    # a lone surrogate is a text in JSON, and none that could be hashed
    if not (isinstance(token, str) and isinstance(pin, str) and token.isascii() and pin.isascii()):
        return None
    return token, pin

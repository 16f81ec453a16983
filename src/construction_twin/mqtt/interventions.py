"""`stop` by MQTT as the gateway reads it: what a person may press at any time. Pure; standard library only.

The account is the topic's last level, which a site's broker has checked; the message holds an id of its own. The bridge's side
reads it by its model (`link.requests.Pressed`).
"""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.errors import PayloadError
from construction_twin.mqtt import requests
from construction_twin.mqtt.messages import demand_live, is_short_text, parse_object, shown_keys

STOP = requests.STOP.name


@dataclass(frozen=True)
class Intervention:
    """What a person asks for: `account` is the topic's, `id` the person's own."""

    verb: str
    account: str
    id: str


def parse_intervention(verb: str, account: str, payload: bytes, retained: bool) -> Intervention:
    """Return what is asked for in a message on ``<verb>/<account>``.

    Args:
        payload: JSON object with `id`, a text of 1 to 64 characters in one line; a moment may stand in it, and is not read.
        retained: The message's retain flag.

    Raises:
        PayloadError: ``retained``, or the verb.
    """
    demand_live(retained, verb)
    document = parse_object(payload, verb, requests.STOP.limit)
    id_ = document.get("id", "")
    if not set(document) <= {"id", "moment"} or not is_short_text(id_) or not id_.strip():
        raise PayloadError(
            verb, f"{verb} with keys {shown_keys(document)}; expected id, a text of 1 to 64 characters, alone"
        )
    return Intervention(verb, account, id_)

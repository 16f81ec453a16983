"""`stop`, `pause`, `resume`, `reset`, `arm` by MQTT: what a person may press whose account has the right to. Pure; standard library
only.

The account is the topic's last level, which a site's broker has checked; the message holds an id of its own, and all but a stop and
a pause the moment that its screen had shown (`core.freshness`): they start motion, or lift what stops it, and are void when that is
too old. What is not exactly so is refused (PayloadError).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import parse_moment
from construction_twin.core.sentences import Sentence
from construction_twin.mqtt import requests
from construction_twin.mqtt.messages import demand_live, is_short_text, parse_object, shown_keys
from construction_twin.mqtt.requests import PRESSED

#: What can be asked for.
STOP, PAUSE, RESUME, RESET, ARM = (
    kind.name for kind in (requests.STOP, requests.PAUSE, requests.RESUME, requests.RESET, requests.ARM)
)
_STARTING = {kind.name for kind in PRESSED if kind.starts}
#: Longest message that is read [bytes].
MAX_BYTES = 256


@dataclass(frozen=True)
class Intervention:
    """What a person asks for: `verb` is the name of one of `PRESSED`; `account` is the topic's, `id` the person's own.

    `moment` is the newest that the screen had received, "" where none was told. One that comes again with another is the same.
    """

    verb: str
    account: str
    id: str
    moment: str = field(default="", compare=False)


def parse_intervention(verb: str, account: str, payload: bytes, retained: bool) -> Intervention:
    """Return what is asked for in a message on ``<verb>/<account>``.

    Args:
        verb, account: Of the topic.
        payload: JSON object with `id`, a text of 1 to 64 characters in one line; of a `resume` also `moment`, as the newest view
            has it, as of a `reset` and an `arm`. In a stop or a pause a moment may stand, and is not read.
        retained: The message's retain flag.

    Raises:
        PayloadError: ``retained``, ``moment``, or the verb.
    """
    demand_live(retained, verb)
    document = parse_object(payload, verb, MAX_BYTES)
    id_ = document.get("id", "")
    if not set(document) <= {"id", "moment"} or not is_short_text(id_) or not id_.strip():
        key = "link.payload.resume" if verb in _STARTING else "link.payload.intervention"
        raise PayloadError(verb, Sentence(key, verb=verb, found=shown_keys(document)))
    if verb not in _STARTING:
        return Intervention(verb, account, id_)
    return Intervention(verb, account, id_, str(parse_moment(document.get("moment"))))

"""`speed` on MQTT: the speed limit that a person sets for all people. Pure; standard library only.

Lowering it acts whenever it comes. Raising it repeats the newest moment that the screen had received (`core.freshness`): whether it
does either, and how old the moment is, is decided where the limit is held (`link.speed_limits`). So a moment that makes no sense
refuses nothing here: a lower limit must not be lost by it. Anything else that is not exactly so is refused (PayloadError).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.link.speed_limits import LEAST
from construction_twin.mqtt.json_fields import MAX_TEXT, keys, number, own_id

#: Longest message [bytes].
MAX_BYTES = 256


@dataclass(frozen=True)
class SpeedRequest:
    """A person's speed limit.

    Attributes:
        limit: Fraction of the planned speed, `LEAST` to 1.
        moment: The newest that the screen had received; "" where none was told, or none that can be one.
    """

    id: str
    limit: float
    moment: str


def parse_speed(document: Mapping[str, Any]) -> SpeedRequest:
    """Return the limit in a document of `read_document`; PayloadError (``format`` or ``values``)."""
    keys(document, "speed", ("id", "limit"), ("id", "limit", "moment"))
    id_, limit, moment = own_id(document["id"], "id"), number(document["limit"], "limit"), document.get("moment")
    if not LEAST <= limit <= 1.0:
        raise PayloadError("values", Sentence("link.payload.speed_limit", found=limit, least=LEAST))
    return SpeedRequest(id_, limit, moment if isinstance(moment, str) and len(moment) <= MAX_TEXT else "")

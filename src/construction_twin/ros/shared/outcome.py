"""What became of a request, by service or by MQTT: one record for every handler."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from construction_twin.ros.messages.records import sentence_of, with_sentences


@dataclass(frozen=True)
class Outcome:
    """What became of a request, by the names of the services' answers; `counted` as, "": as done or not."""

    success: bool
    message: str
    expired: bool = False
    fields: Mapping[str, object] = field(default_factory=dict)
    counted: str = ""

    @classmethod
    def of(cls, answer: Any) -> Outcome:
        """Return what became of a request by a service's answer; what it has no field for stays as it is without."""
        known = {name: getattr(answer, name) for name in answer.__slots__ if name != "said"}
        message = sentence_of(answer, known.pop("message"))
        return cls(known.pop("success"), message, known.pop("expired", False), known)

    def response(self, kind: Any) -> Any:
        """Return the response of a kind of service; what it has no field for is left out."""
        response = kind._response_class(success=self.success, message=self.message)
        for name, value in {"expired": self.expired, **self.fields}.items():
            if hasattr(response, name):
                setattr(response, name, value)
        return with_sentences(response, self.message)

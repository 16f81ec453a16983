"""What the gateway's status says beside its counters, as texts for `link` and `/diagnostics`. Standard library only."""

from __future__ import annotations

import math
import re

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence

#: Objects of the status whose values are shown, each under its own name and theirs.
_GROUPS = ("controller", "cycle", "playout", "speed_limit", "stop", "intruder")
_SINGLE = ("mode", "fault_number", "last_refusal", "later_refusal", "last_ipoc_jump_ms")
_LONGEST = 300
#: Members that are lists, one value per axis, and how many at most.
_LISTS = ("stop.distance_deg", "stop.moved_deg")
_MOST_AXES = 12

#: What counts in the gateway's reason while it refuses datagrams, where a parser stopped, and by how much a clock is off: these
#: change with every second of a sender that goes on.
_COUNTS = re.compile(r"(datagrams refused:|\bline|\bcolumn|\bclock is) \d+(?:\.\d+)?")


def without_counts(reason: str) -> str:
    """Return a reason without the numbers that go on while nothing else changes: to ask whether it is news, not to be read."""
    return _COUNTS.sub(r"\1", reason)


def status_values(status: dict) -> dict[str, str]:
    """Return what stands beside the counters: controller, cycle, playout, speed limit, stop and its number, mode, intruder,
    refusals, last jump of IPOC.

    Args:
        status: As `parse_status` returned it; what is absent is left out.

    Returns:
        E.g. ``{"playout_delay_ms": "20", "intruder_session": "", "last_refusal": "..."}``; "" for what is not known.

    Raises:
        PayloadError: ``status``, when a value is no number, short text or null.
    """
    values = {name: _text(name, status[name]) for name in _SINGLE if name in status}
    for group in _GROUPS:
        members = status.get(group, {})
        if not isinstance(members, dict) or len(members) > 32 or any(len(name) > 64 for name in members):
            raise PayloadError("status", Sentence("link.status.not_as_agreed", name=group))
        values |= {f"{group}_{name}": _text(f"{group}.{name}", value) for name, value in members.items()}
    return values


def controller_sentence(status: dict) -> str:
    """Return why the arm may not move, as the controller told the gateway (`status_values` has checked it); "" for no reason."""
    controller = status.get("controller", {})
    return _text("controller.sentence", controller.get("sentence", ""))


def clock_sentence(status: dict) -> str:
    """Return by how much the controller's clock is off, as the gateway has measured it; "" when it is not known to be."""
    return _text("cycle.sentence", status.get("cycle", {}).get("sentence", ""))


def _text(name: str, value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, list) and name in _LISTS and len(value) <= _MOST_AXES:
        if not all(isinstance(member, (int, float)) for member in value):
            raise PayloadError("status", Sentence("link.status.no_numbers", name=name))
        return " ".join([_text(name, member) for member in value])
    if isinstance(value, str):
        return value[:_LONGEST]
    # a whole number in JSON may have more digits than a float holds: only one of a counter's size is compared as one
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 63:
        return f"{value:.9g}"
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.9g}"
    raise PayloadError("status", Sentence("link.status.no_value", name=name, found=repr(str(value)[:80])))

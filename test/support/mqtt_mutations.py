"""Malformed and hostile MQTT messages: joint strings, property sets and control messages as a faulty or hostile sender makes them.

None of them is a complete valid command of the armed session: the broker's access rules decide who may send one. Anything else may
occur. The same random generator makes the same messages.
"""

from __future__ import annotations

import json
import random
from dataclasses import dataclass, field

#: In place of a property's value, or a name.
TEXTS = (
    "", "0", "-1", "+1", "1.0", "1e3", " 1", "1 ", "9" * 19, "9" * 40, "18446744073709551616", "4294967295999999999", "nan",
    "null", "\u0663", "\U0001d7d9", "1_000", "0x10", "\u200b", "a" * 65, "a" * 5000, "a/b", "#", "$SYS", "{}", "session",
    "s eq", "\u00e9" * 40,
)  # fmt: skip
#: In place of a value of a control message.
VALUES = (
    None, True, False, 0, -1, 1.5, 1e308, 10**30, "", "x" * 65, "x" * 1500, "\u0000", "\ud7ff", [], {}, [[]],
    {"a": {"b": 1}}, ["arm"],
)  # fmt: skip
#: Put into a payload.
PARTS = (
    b"\x00", b"\xff", b"\xef\xbb\xbf", b"\xc3\x28", b"+", b"-", b",", b".", b" ", b"\n", b"nan", b"inf", b"1e5", b"{", b"}",
    b"[" * 60, b'"', b"\\u0000", b"\\ud800", b"NaN", b"-Infinity", b"9" * 400, b"9" * 5000, b"//", b"\xd9\xa3", b"[" * 1500,
)  # fmt: skip
VERBS = ("arm", "stop", "reset", "end", "speed_limit", "fly", "ARM", "")
#: Longest payload: beyond it only the broker's limits are tested.
LONGEST = 60_000


@dataclass
class Message:
    """One publish."""

    topic: str
    payload: bytes
    pairs: list[tuple[str, str]] = field(default_factory=list)
    retain: bool = False


@dataclass
class Target:
    """What a hostile sender knows of the cell.

    Attributes:
        session: Owner of the stream.
        ended: A session that had its turn.
        arming: Value of an `arm`: configuration and run; anybody can read both in the status.
        far, held: Joint strings: degrees away from the arm on every joint, and where it stands.
    """

    session: str
    ended: str
    arming: dict
    far: bytes
    held: bytes


def message(rng: random.Random, target: Target) -> Message:
    """Return the next message."""
    kind = rng.random()
    if kind < 0.65:
        made = _command(rng, target)
    elif kind < 0.75:
        made = Message("stop", _no_stop(rng, target))
    else:
        made = Message("control", _control(rng, target))
    made.retain = rng.random() < 0.02
    made.payload = made.payload[:LONGEST]
    return made


def _command(rng: random.Random, target: Target) -> Message:
    seq, stamp = rng.choice((1, 2, 3, 70, 10**6, rng.randrange(10**19))), rng.randrange(10**19)
    session = rng.choice((target.session, target.ended, "another", ""))
    payload = target.far if session == target.session else rng.choice((target.far, target.held))
    pairs = [("session", session), ("seq", str(seq)), ("stamp", str(stamp))]
    if rng.random() < 0.6:
        payload = mutate(rng, payload)
    if rng.random() < 0.45:
        pairs = _spoilt_pairs(rng, pairs)
    return Message("command", payload, pairs)


def _spoilt_pairs(rng: random.Random, pairs: list[tuple[str, str]]) -> list[tuple[str, str]]:
    pairs = list(pairs)
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(pairs) + 1)
        name, value = pairs[place] if place < len(pairs) else ("extra", "1")
        kind = rng.randrange(6)
        if kind == 0:
            del pairs[place : place + 1]
        elif kind == 1:
            pairs.insert(place, (name, value))
        elif kind == 2:
            pairs[place : place + 1] = [(name, rng.choice(TEXTS))]
        elif kind == 3:
            pairs[place : place + 1] = [(rng.choice((*TEXTS, name.upper(), name + " ")), value)]
        elif kind == 4:
            pairs.insert(place, (rng.choice(TEXTS), rng.choice(TEXTS)))
        else:
            pairs += [(f"p{k}", value) for k in range(rng.choice((1, 5, 200)))]
    return pairs


def _control(rng: random.Random, target: Target) -> bytes:
    session = rng.choice((target.session, target.ended, "another", ""))
    # the right value only from who is armed already, or had its turn: arming anew is the access rules' business
    value = target.arming if session in (target.session, target.ended) else rng.choice((None, "0" * 64, 1.0, []))
    verb = rng.choice(VERBS)
    document = {"id": str(rng.randrange(10**6)), "session": session, "verb": verb, "value": value}
    if rng.random() < 0.5:
        for _ in range(rng.randint(1, 2)):
            name = rng.choice(list(document) or ["id"])
            kind = rng.randrange(4)
            if kind == 0:
                document.pop(name, None)
            elif kind == 1:
                document[rng.choice(("extra", "verb ", "ID", "\u00e9", "x" * 300))] = rng.choice(VALUES)
            else:
                document[name] = rng.choice(VALUES)
    payload = json.dumps(document).encode()
    if rng.random() < 0.3:
        # a key twice
        payload = payload[:-1] + b', "verb": "stop"}'
    if rng.random() < 0.05:
        payload = payload.decode().encode(rng.choice(("utf-16", "utf-32", "utf-8-sig")))
    return mutate(rng, payload) if rng.random() < 0.5 else payload


def _no_stop(rng: random.Random, target: Target) -> bytes:
    """Return what is not a stop: a stop is never refused, whoever's topic it is on, so it would be no hostile message."""
    while True:
        document = {"id": rng.choice((str(rng.randrange(10**6)), *VALUES))}
        for _ in range(rng.randint(0, 2)):
            document[rng.choice(("session", "verb", "account", "ID", "x" * 300))] = rng.choice(
                (target.session, "arm", *VALUES)
            )
        payload = json.dumps(document).encode()
        if rng.random() < 0.6:
            payload = mutate(rng, payload)
        if not _only_an_id(payload):
            return payload


def _only_an_id(payload: bytes) -> bool:
    try:
        document = json.loads(payload)
    except (ValueError, RecursionError):
        return False
    return isinstance(document, dict) and set(document) == {"id"} and isinstance(document["id"], str)


def mutate(rng: random.Random, data: bytes) -> bytes:
    """Change a payload's bytes: flipped, cut, moved, repeated, replaced, put in."""
    data = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        place, kind = rng.randrange(len(data) + 1), rng.randrange(7)
        end = min(len(data), place + rng.randint(1, 12))
        if kind == 0 and place < len(data):
            data[place] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[place:end]
        elif kind == 2:
            data[place:place] = rng.choice(PARTS)
        elif kind == 3:
            data[place:end] = rng.choice(PARTS)
        elif kind == 4:
            data[place:place] = data[place:end] * rng.choice((1, 7, 900))
        elif kind == 5:
            del data[place:]
        else:
            data[place:end] = rng.randbytes(end - place)
    return bytes(data)

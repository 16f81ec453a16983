"""Structured mutations of real telegrams: what a faulty or hostile sender could make of them."""

from __future__ import annotations

import random
import re

TOKEN = re.compile(rb"<[^>]*>|[^<>]+")
PARTS = [
    b"<!DOCTYPE a>",
    b"<!--x-->",
    b"<?x?>",
    b"&lt;",
    b"&#65;",
    b"&a;",
    b"<![CDATA[1]]>",
    b"\0",
    b"\xc3\xa9",
    b"<a>",
    b"</Rob>",
]
VALUES = [
    b"nan",
    b"inf",
    b"-inf",
    b"1e5",
    b"",
    b" ",
    b"1,5",
    b"0x1",
    b"9" * 400,
    b"-",
    b"1.",
    b".5",
    b"1_0",
    b"\xd9\xa1",
    b"+1.5",
]


def mutate(data: bytes, seed: int) -> bytes:
    """Change a telegram as a faulty or hostile sender would: its elements, its attributes, its values, its bytes."""
    rng = random.Random(seed)
    tokens = TOKEN.findall(data)
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(tokens))
        kind = rng.randrange(9)
        if kind == 0:
            del tokens[place]
        elif kind == 1:
            tokens.insert(place, tokens[place])
        elif kind == 2:
            tokens.insert(place, rng.choice(PARTS))
        elif kind == 3:
            tokens[place] = re.sub(
                rb'"[^"]*"', b'"' + rng.choice(VALUES) + b'"', tokens[place], count=rng.randint(0, 2)
            )
        elif kind == 4:
            tokens[place] = rng.choice(VALUES)
        elif kind == 5:
            other = rng.randrange(len(tokens))
            tokens[place], tokens[other] = tokens[other], tokens[place]
        elif kind == 7:
            tokens[place] = re.sub(rb' \w+="[^"]*"', b"", tokens[place], count=1)
        elif kind == 6:
            tokens[place] = tokens[place][: rng.randrange(len(tokens[place]) + 1)]
        else:
            tokens[place] = tokens[place] * rng.choice((2, 50, 3000))
        if not tokens:
            return b""
    return b"".join(tokens)

"""A decoder that knows a telegram's shape says of every other telegram what one that knows nothing says."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.controller.telegram import AxisUnit, Telegram
from construction_twin.core.errors import TelegramError
from construction_twin.rsi import gateway_codec as codec
from construction_twin.rsi.controller_codec import RobotEncoder
from construction_twin.rsi.gateway_codec import RobotDecoder

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
TRACK = (*AXES, "E1")
TRACK_UNITS = (*[AxisUnit()] * 6, AxisUnit(linear=True))
TRACK_BLOCKS = ("RIst", "RSol", "AIPos", "ASPos", "EIPos", "ESPos", "Delay")


def telegram(axes=AXES, seed: int = 0, ipoc: int = 4208163634, units=(), delay: int = 0) -> bytes:
    rng = random.Random(seed)
    six = [rng.uniform(-3.0, 3.0) for _ in range(6)]
    values = [rng.uniform(-3.0, 3.0) for _ in axes]
    blocks = TRACK_BLOCKS if "E1" in axes else ("RIst", "RSol", "AIPos", "ASPos", "Delay")
    return RobotEncoder(axes, 6, blocks, units).encode(ipoc, values, values[::-1], six, six[::-1], delay)


def outcome(decoder: RobotDecoder, data: bytes) -> Telegram | str:
    try:
        return decoder.parse(data)
    except TelegramError as error:
        return f"{error.reason}: {error}"


def knowing(*data: bytes, axes=AXES, units=()) -> RobotDecoder:
    decoder = RobotDecoder(axes, units)
    for one in data:
        decoder.parse(one)
    return decoder


@pytest.fixture
def parsed(monkeypatch):
    """Telegrams that were given to the XML parser."""
    given, read = [], codec.read_document
    monkeypatch.setattr(codec, "read_document", lambda data, tag: given.append(data) or read(data, tag))
    return given


@pytest.mark.parametrize(("axes", "units"), [(AXES, ()), (TRACK, TRACK_UNITS), (("E1",), (AxisUnit(linear=True),))])
def test_a_session_needs_the_parser_once(parsed, axes, units):
    decoder = RobotDecoder(axes, units)
    on_wire = (axes, units) if len(axes) > 1 else (TRACK, TRACK_UNITS)
    stream = [telegram(on_wire[0], seed, 4 * seed, on_wire[1]) for seed in range(50)]
    read = [decoder.parse(data) for data in stream]
    assert parsed == stream[:1]
    for data, known in zip(stream, read):
        assert RobotDecoder(axes, units).parse(data) == known


@given(st.data())
def test_bytes_that_are_changed_anywhere_are_read_or_refused_alike(data):
    original = telegram(seed=1)
    at = data.draw(st.integers(0, len(original) - 1))
    end = data.draw(st.integers(at, min(len(original), at + 20)))
    alphabet = b"0123456789.+-\"'<>/= \n\t&;AEx\x00\x01\x7f\x80"
    insert = bytes(data.draw(st.lists(st.sampled_from(alphabet), max_size=8)))
    changed = original[:at] + insert + original[end:]
    assert outcome(knowing(telegram()), changed) == outcome(RobotDecoder(AXES), changed)


POSITIONS = "".join(f' A{i}="{i}.5"' for i in range(1, 7))
BLOCKS = f"<AIPos{POSITIONS}/><ASPos{POSITIONS}/>"
#: Legal telegrams in which words of the protocol stand where they do not count.
STRANGE = {
    "in an element": f'<Rob Type="KUKA">{BLOCKS}<Tech><Delay D="7"/></Tech><IPOC>4</IPOC></Rob>',
    "blocks in an element": f'<Rob Type="KUKA"><Tech>{BLOCKS}</Tech><Delay D="0"/><IPOC>4</IPOC></Rob>',
    "as text": f'<Rob Type="KUKA">{BLOCKS}<Tech> D="7"</Tech><Delay D="0"/><IPOC>4</IPOC></Rob>',
    "as text of Delay": f'<Rob Type="KUKA">{BLOCKS}<Delay D="0"> D="7"</Delay><IPOC>4</IPOC></Rob>',
    "after IPOC": f'<Rob Type="KUKA">{BLOCKS}<IPOC>4</IPOC><Delay D="0"/></Rob>',
    "IPOC in an element": f'<Rob Type="KUKA">{BLOCKS}<Delay D="0"/><IPOC>4</IPOC><Tech C="1"><IPOC>8</IPOC></Tech></Rob>',
    "apostrophes": f"<Rob Type='KUKA'>{BLOCKS}<Delay D=\"0\"/><IPOC>4</IPOC></Rob>",
    "a block in apostrophes": f"<Rob><AIPos A1='1.5'{POSITIONS[9:]}/><ASPos{POSITIONS}/><Tech><AIPos A1=\"1.5\"/></Tech>"
    '<Delay D="0"/><IPOC>4</IPOC></Rob>',
    "IPOC only": "<Rob><IPOC>4</IPOC></Rob>",
    "without delay": f'<Rob Type="KUKA">{BLOCKS}<IPOC>4</IPOC></Rob>',
    "line ends": f'<Rob Type="KUKA">\n{BLOCKS}\n<Delay D="0"/>\n<IPOC>4</IPOC></Rob>\n',
}


@pytest.mark.parametrize("text", STRANGE.values(), ids=STRANGE)
def test_words_that_do_not_count_are_never_read(text):
    """The next telegram of such a shape, and one in which every number is another."""
    decoder = knowing(text.encode())
    for other in (
        text,
        text.replace("7", "9"),
        text.replace("4<", "8<"),
        text.replace(".5", ".25").replace('"0"', '"3"'),
    ):
        assert outcome(decoder, other.encode()) == outcome(RobotDecoder(AXES), other.encode())


@pytest.mark.parametrize("change", ["<Tech>%d</Tech>", '<Tech T%d="0"/>', "<Tech t='%d'/>"])
def test_where_no_shape_fits_it_is_seldom_looked_for(monkeypatch, change):
    looked = []
    places_of = codec.places_of
    monkeypatch.setattr(codec, "places_of", lambda *content: looked.append(content) or places_of(*content))
    decoder, plain = RobotDecoder(AXES), telegram()
    for number in range(2 * codec.RELEARN_AFTER):
        decoder.parse(plain.replace(b"<IPOC>", (change % number).encode() + b"<IPOC>"))
    assert len(looked) == 2
    # and a shape that fits is found again
    for _ in range(codec.RELEARN_AFTER + 2):
        assert decoder.parse(plain) == RobotDecoder(AXES).parse(plain)
    assert len(looked) > 2


@given(
    st.lists(st.sampled_from([*STRANGE.values(), telegram().decode(), telegram(seed=9, delay=3).decode()]), max_size=12)
)
def test_shapes_may_change_at_any_time(texts):
    decoder = RobotDecoder(AXES)
    for text in texts:
        assert outcome(decoder, text.encode()) == outcome(RobotDecoder(AXES), text.encode())

"""The optional channels Mode, ProgStatus and OvPro: read where the Ethernet XML has them, from mock to gateway status."""

from __future__ import annotations

import dataclasses
from collections import deque

import pytest
from gateway_cell import CONFIG, RUN, START
from hypothesis import given
from hypothesis import strategies as st
from mock_cell import Cell as MockCell

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.controller_socket import TelegramInbox
from construction_twin.gateway.gateway import Gateway
from construction_twin.gateway.states import State
from construction_twin.mock.faults import Fault, FaultBoard
from construction_twin.rsi.controller_codec import RobotEncoder
from construction_twin.rsi.gateway_codec import RobotDecoder
from construction_twin.rsi.layout import RsiLayout
from construction_twin.rsi.status_channels import RsiStatus, StatusReader

POSE = (0.0,) * 6
BLOCKS = ("AIPos", "ASPos", "Delay")
PLAIN = ("Mode", "ProgStatus", "OvPro")
DOTTED = ("Mode.R", "ProgStatus.R", "OvPro.R")
T1 = "the controller is in T1: the arm moves only while enabling switch and start key are held, and slowly"
STOPPED = "the controller's program is stopped (STOP): press start on the pendant"
FITTING = [(PLAIN, (*BLOCKS, *PLAIN)), (DOTTED, (*DOTTED, *BLOCKS)), (PLAIN, ("AIPos", *PLAIN, "ASPos", "Delay"))]


def telegram(send, status, ipoc=1000):
    return RobotEncoder(CONFIG.axes, 6, send).encode(ipoc, START, START, POSE, POSE, 0, status)


@pytest.mark.parametrize(("channels", "send"), FITTING)
@given(
    mode=st.sampled_from([1, 2, 3, 4]),
    program=st.sampled_from([1, 2, 3, 4, 5]),
    override=st.one_of(st.integers(0, 100), st.just(12.5)),
)
def test_what_a_controller_says_is_read_in_any_order_plain_and_dotted(channels, send, mode, program, override):
    status = RsiStatus(mode, program, override)
    assert StatusReader(channels).read(telegram(send, status)) == (status, 0)


@pytest.mark.parametrize(
    ("text", "unreadable"),
    [
        (b"<Mode></Mode><OvPro>50</OvPro>", 1),
        (b"<OvPro>50</OvPro>", 1),
        (b"<Mode>T1</Mode><OvPro>50</OvPro>", 1),
        (b"<Mode>1.5</Mode><OvPro>50</OvPro>", 1),
        (b"<Mode>-1</Mode><OvPro>50</OvPro>", 1),
        (b"<Mode>nan</Mode><OvPro>50</OvPro>", 1),
        (b"<Mode>99999999999</Mode><OvPro>50</OvPro>", 1),
        (b'<Mode R="1"/><OvPro>50</OvPro>', 1),
        (b"<Mode>1</Mode><OvPro>101</OvPro>", 1),
        (b"<Mode>1</Mode><OvPro>-1</OvPro>", 1),
        (b"<Mode>1.0000</Mode><OvPro> 50.00 </OvPro>", 0),
    ],
)
def test_what_is_no_number_of_the_kind_is_not_known_and_counted(text, unreadable):
    status, count = StatusReader(("Mode", "OvPro")).read(b'<Rob Type="KUKA">' + text + b"<IPOC>4</IPOC></Rob>")
    assert count == unreadable
    assert status == RsiStatus(
        1 if b"Mode>1<" in text or b"1.0000" in text else None, None, 50.0 if b"50" in text else None
    )


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (RsiStatus(), []),
        (RsiStatus(3, 3, 100.0), []),
        (RsiStatus(4, 3, 100.0), []),
        (RsiStatus(mode=2), ["in T2"]),
        (RsiStatus(1, 4, 100.0), [T1, STOPPED]),
        (RsiStatus(program=5), ["(END)"]),
        (RsiStatus(program=2), ["(RESET)"]),
        (RsiStatus(program=1), ["(FREE)"]),
        (RsiStatus(override=12.5), ["override is 12.5 %"]),
        (RsiStatus(override=0.0), ["override is 0 %"]),
    ],
)
def test_what_speaks_against_a_motion_is_a_sentence(status, said):
    assert len(status.sentence.split("; ") if status.sentence else []) == len(said)
    assert all(words in status.sentence for words in said)


def test_unknown_numbers_are_shown_as_numbers():
    assert RsiStatus(7, 9, 50.0).status_fields() == {
        "mode": "number 7", "program": "number 9", "override_percent": 50.0,
        "sentence": "the override is 50 %: the controller's own motions are slower by that, corrections are not",
    }  # fmt: skip
    assert RsiStatus().status_fields() == {}


# -- the gateway -------------------------------------------------------------------------------------------------------


class Chain:
    """A gateway with its inbox; telegrams come from a list."""

    def __init__(self, send):
        layout = dataclasses.replace(RsiLayout.plain(CONFIG.axes), send=send)
        self.gateway = Gateway(dataclasses.replace(CONFIG, layout=layout), RUN)
        self._waiting: deque[bytes] = deque()
        self._now = NANOSECONDS
        self._inbox = TelegramInbox(self.gateway, self._receive)

    def _receive(self):
        if not self._waiting:
            raise BlockingIOError
        return self._waiting.popleft(), self._now, ("192.168.1.20", 49152)

    def hear(self, data):
        """Take a telegram; return the corrections of the answer."""
        self._now += 4_000_000
        self._waiting.append(data)
        arrival = self._inbox.newest(self._now)
        return self.gateway.on_telegram(arrival.telegram, arrival.source, self._now)

    def silence(self):
        self._now += NANOSECONDS
        self.gateway.poll(self._now)


def test_the_status_says_what_the_controller_says():
    chain = Chain((*BLOCKS, *DOTTED))
    chain.hear(telegram((*BLOCKS, *DOTTED), RsiStatus(1, 4, 100)))
    assert chain.gateway.status()["controller"] == {
        "mode": "T1", "program": "STOP", "override_percent": 100.0, "sentence": f"{T1}; {STOPPED}",
    }  # fmt: skip
    chain.hear(telegram((*BLOCKS, *DOTTED), RsiStatus(3, 3, 100), 1004))
    assert chain.gateway.status()["controller"]["sentence"] == ""


def test_a_channel_that_cannot_be_read_ends_no_answers_and_is_counted():
    chain = Chain((*BLOCKS, *DOTTED))
    for k in range(3):
        assert chain.hear(telegram(BLOCKS, RsiStatus(), 1000 + 4 * k)) == (0.0, 0.0)
    assert chain.gateway.counters["status_channels_unreadable"] == 9
    assert chain.gateway.counters["telegrams"] == 3 and chain.gateway.status()["controller"] == {}


def test_when_telegrams_cease_the_reason_holds_the_last_words():
    chain = Chain((*BLOCKS, *PLAIN))
    chain.hear(telegram((*BLOCKS, *PLAIN), RsiStatus(3, 4, 100)))
    chain.silence()
    assert chain.gateway.state is State.NO_CONTROLLER
    assert chain.gateway.reason == f"no telegram for {CONFIG.timeout:g} s; the last one said: {STOPPED}"
    # a controller that is gone is in no mode
    assert chain.gateway.status()["controller"] == {}


# -- the mock ----------------------------------------------------------------------------------------------------------


def mock(channels=PLAIN):
    plain = RsiLayout.plain(("A1", "A2", "A3", "A4", "A5", "A6"))
    cell = MockCell(layout=dataclasses.replace(plain, send=(*plain.send, *channels)))
    return cell, FaultBoard(cell.mock, 0)


def said(cell, channels=PLAIN):
    data = cell.mock.begin_cycle()
    cell.mock.receive(cell.encoder.encode((0.0,) * 6, RobotDecoder(cell.config.axes).parse(data).controller_ms))
    return StatusReader(channels).read(data)[0]


@pytest.mark.parametrize("channels", [PLAIN, DOTTED])
def test_the_mock_says_aut_active_and_full_override_unless_it_is_told_otherwise(channels):
    cell, faults = mock(channels)
    assert said(cell, channels) == RsiStatus(3, 3, 100.0)
    for fault, expected in (
        (Fault("program", values=(4.0,)), RsiStatus(3, 4, 100.0)),
        (Fault("mode", values=(2.0,)), RsiStatus(2, 4, 100.0)),
        (Fault("override", values=(0.0,)), RsiStatus(2, 4, 0.0)),
    ):
        faults.inject(fault)
        assert said(cell, channels) == expected
    for name in ("program", "mode", "override"):
        faults.end(Fault(name))
    assert said(cell, channels) == RsiStatus(3, 3, 100.0)
    assert cell.mock.running and cell.mock.counters["missed"] == 0


@pytest.mark.parametrize(
    "fault",
    [Fault("mode", values=(5.0,)), Fault("mode", values=(0.0,)), Fault("mode", values=(1.5,)), Fault("mode"),
     Fault("program", values=(6.0,)), Fault("override", values=(-1.0,)), Fault("override", values=(101.0,)),
     Fault("override", "A1", (50.0,))],
)  # fmt: skip
def test_what_no_channel_can_say_is_refused(fault):
    _, faults = mock()
    with pytest.raises(ConfigurationError):
        faults.inject(fault)
    assert not faults.active

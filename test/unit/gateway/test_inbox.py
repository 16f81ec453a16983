"""Which of the datagrams that wait is answered: the newest telegram, whatever else the network brings, in whatever order."""

from __future__ import annotations

import itertools
from collections import deque

import pytest
from gateway_cell import CONFIG, RUN, START

from construction_twin.gateway.arm_control import LONGEST_REFUSAL
from construction_twin.gateway.controller_socket import DRAIN_LIMIT, TelegramInbox
from construction_twin.gateway.gateway import Gateway
from construction_twin.gateway.states import State
from construction_twin.rsi.controller_codec import RobotEncoder

HERE, THERE = ("192.168.1.20", 49152), ("192.168.1.20", 49153)
ENCODER = RobotEncoder(CONFIG.axes, 6)


def telegram(ipoc: int) -> bytes:
    return ENCODER.encode(ipoc, START, START, (0.0,) * 6, (0.0,) * 6, 0)


class Line:
    """Datagrams that wait: IPOC, bytes or an error, from HERE or with its source."""

    def __init__(self, controller=None):
        self.gateway = Gateway(CONFIG, RUN)
        self.waiting: deque = deque()
        self.inbox = TelegramInbox(self.gateway, self._receive, controller)
        self.arrivals = itertools.count(1)

    def _receive(self):
        if not self.waiting:
            raise BlockingIOError
        thing, source = self.waiting.popleft()
        if isinstance(thing, OSError):
            raise thing
        return telegram(thing) if isinstance(thing, int) else thing, next(self.arrivals), source

    def newest(self, *things):
        """Put these in and read; return the IPOC of what is answered, its source and which datagram it was."""
        self.waiting.extend(thing if isinstance(thing, tuple) else (thing, HERE) for thing in things)
        found = self.inbox.newest(10**9)
        return found and (found.telegram.controller_ms, found.source, found.arrived)

    def counted(self) -> dict:
        return dict(self.gateway.counters)


def test_the_newest_is_answered_and_the_others_are_counted():
    line = Line()
    assert line.newest(1000, 1004, 1008) == (1008, HERE, 3)
    assert line.counted() == {"telegrams_skipped": 2}


@pytest.mark.parametrize("order", [(1004, 1000), (1004, 1004), (1000, 1004, 1000), (1004, 604)])
def test_a_copy_or_a_late_one_costs_the_newest_no_answer(order):
    line = Line()
    assert line.newest(*order)[0] == 1004
    assert line.counted()["telegrams_repeated"] == 1


def test_a_jump_back_beyond_the_timeout_is_another_session():
    line = Line()
    assert line.newest(1004, 600) == (600, HERE, 2)
    assert line.counted() == {"telegrams_skipped": 1}


def test_what_is_no_telegram_takes_nobody_s_place():
    line = Line("192.168.1.20")
    assert line.newest(1000, b"garbage", (1004, ("10.0.0.1", 1)), b"")[0] == 1000
    counted = line.counted()
    assert counted.pop("telegram_refused_address") == 1
    assert sum(counted.values()) == 2 and all(name.startswith("telegram_refused_") for name in counted)


@pytest.mark.parametrize(
    "thing, reason",
    [
        (
            (1004, ("10.0.0.1", 1)),
            "telegram address: datagrams from 10.0.0.1 are not read, because --controller is 192.168.1.20",
        ),
        (b"", "telegram size: telegram of 0 B"),
        (b"\xff" * 60, "telegram encoding: "),
        (b"<Rob", "telegram xml: telegram is not well-formed"),
        (b"<Sen><IPOC>4</IPOC></Sen>", "telegram root: the telegram's root is 'Sen'"),
        (b"<" + b"R" * 900 + b"/>", "telegram root: "),
    ],
)
def test_every_refused_datagram_has_a_counter_and_a_reason_in_the_status(thing, reason):
    line = Line("192.168.1.20")
    assert line.newest(thing) is None
    said = line.gateway.status()["last_refusal"]
    assert said.startswith(reason) and len(said) <= LONGEST_REFUSAL
    assert line.counted() == {f"telegram_refused_{said.split(':')[0].split()[1]}": 1}


def test_while_a_controller_is_alive_nobody_else_is_read():
    line = Line()
    line.waiting.append((1000, HERE))
    found = line.inbox.newest(10**9)
    read, source = found.telegram, found.source
    line.gateway.on_telegram(read, source, 10**9)
    assert line.newest((1004, THERE)) is None
    assert line.counted()["telegram_refused_source"] == 1
    said = line.gateway.status()["last_refusal"]
    assert said == "telegram source: a datagram from 192.168.1.20:49153 while another sender's session is alive"


def told(line, now) -> bool:
    """Let the gateway look at what has come, at `now` [s]; return whether that was news."""
    line.gateway.poll(round(now * 1e9))
    return line.gateway.pop_change()


STRANGER = "datagrams from 10.0.0.1 are not read, because --controller is 192.168.1.20"


def test_while_nothing_can_be_read_the_reason_names_the_last_refusal_and_how_many():
    line = Line("192.168.1.20")
    assert told(line, 1.0) and line.gateway.reason == "no telegram yet"
    line.newest(b"<Rob><IPOC>4</IPOC>")
    assert told(line, 1.1)
    one = "no telegram yet; datagrams refused: 1, the last one for xml: telegram is not well-formed"
    assert (line.gateway.state, line.gateway.reason) == (
        State.NO_CONTROLLER,
        f"{one}: no element found: line 1, column 19",
    )
    line.newest(*[b"<Rob><IPOC>4</IPOC>"] * 41)
    # the same again is no news, and counted once a second: a flood is neither a line nor a status each
    assert not told(line, 1.2) and line.gateway.reason.startswith(one)
    assert not told(line, 2.2)
    assert line.gateway.reason.startswith(
        "no telegram yet; datagrams refused: 42, the last one for xml: telegram is not"
    )
    line.newest((1000, ("10.0.0.1", 1)))
    assert told(line, 3.3)
    assert line.gateway.reason == f"no telegram yet; datagrams refused: 43, the last one for address: {STRANGER}"


def test_a_telegram_that_can_be_read_ends_the_count():
    line = Line("192.168.1.20")
    line.newest(b"garbage", (1000, ("10.0.0.1", 1)))
    assert told(line, 1.0)
    line.waiting.append((1000, HERE))
    found = line.inbox.newest(10**9)
    line.gateway.on_telegram(found.telegram, found.source, 2 * 10**9)
    line.gateway.pop_change()
    line.newest((1004, ("10.0.0.1", 1)))
    assert not told(line, 2.1) and line.gateway.state is State.READY
    assert "refused" not in line.gateway.reason
    # the controller falls silent: what came meanwhile is told with that
    assert told(line, 10.0)
    assert (
        line.gateway.reason
        == f"no telegram for {CONFIG.timeout:g} s; datagrams refused: 1, the last one for address: {STRANGER}"
    )


def test_an_error_of_the_socket_is_counted_and_ends_the_turn():
    line = Line()
    assert line.newest(1000, OSError(111, "refused"), 1004)[0] == 1000
    assert line.counted() == {"udp_receive_111": 1}
    assert line.newest()[0] == 1004


def test_a_flood_does_not_keep_the_loop():
    line = Line()
    assert line.newest(*range(1000, 1000 + 4 * 2 * DRAIN_LIMIT, 4))[2] == DRAIN_LIMIT
    assert len(line.waiting) == DRAIN_LIMIT

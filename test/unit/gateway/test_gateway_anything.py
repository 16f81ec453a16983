"""The gateway as a pure object: streams without stamps, and anything at all."""

from __future__ import annotations

import math

import pytest
from gateway_cell import (
    DELAY_CYCLES,
    PAYLOADS,
    START,
    Cell,
    gap,
    jump_ahead,
    jump_back,
    other_source,
    slow,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS, format_allowance
from construction_twin.gateway.gateway import State
from construction_twin.mqtt.messages import Intervention

# -- MQTT 3.1.1: the string alone ------------------------------------------------------------------------------------


def test_without_properties_the_stream_is_played_on_its_arrival_grid():
    cell = Cell(properties=False)
    cell.cycle(3)
    cell.arm()
    poses = [cell.codec.quantise(slow(k)) for k in range(1000)]
    for k, q in enumerate(poses):
        # jitter of arrival: -1, 0 or 1 ms
        cell.now += (k % 3 - 1) * 1_000_000
        cell.send(q)
        cell.now -= (k % 3 - 1) * 1_000_000
        cell.cycle()
    moved = cell.replies[-1][0] + START[0]
    assert moved == pytest.approx(poses[1000 - DELAY_CYCLES][0], abs=1e-3)
    assert (cell.state, cell.count("settling")) == (State.FOLLOWING, 0)
    assert cell.gateway.state_message(cell.now)[1].command_stamp == 0


@pytest.mark.parametrize("period", [3_900_000, 4_100_000])
def test_without_properties_a_sender_of_another_clock_holds_an_idle_arm(period):
    cell = Cell(properties=False)
    cell.cycle(3)
    cell.arm()
    answered = cell.now
    for due in range(answered + period, answered + 60 * NANOSECONDS, period):
        while answered + CYCLE_NS < due:
            cell.now = answered
            cell.cycle()
            answered = cell.now
        cell.now = due
        cell.send(START)
    assert (cell.state, cell.measured) == (State.FOLLOWING, START)


# -- anything at all -------------------------------------------------------------------------------------------------


class Guard:
    """Holds every reply against the limits: origin + correction."""

    def __init__(self, cell):
        self.cell = cell
        self.sessions = -1

    def check(self):
        cell, config = self.cell, self.cell.config
        reply = cell.replies[-1]
        if cell.count("rsi_sessions") != self.sessions or reply is None:
            self.sessions = cell.count("rsi_sessions")
            self.q, self.step = cell.setpoint, (0.0, 0.0)
            if reply is None:
                return
        if cell.step_ms > cell.config.cycle:
            # under HOLDON the arm stands in every cycle without a telegram: the next step is one from standstill
            self.step = (0.0, 0.0)
        q = tuple(start + value for start, value in zip(cell.setpoint, reply))
        step = tuple(new - old for new, old in zip(q, self.q))
        rounding = math.radians(10.0**-config.decimals)
        for k in range(2):
            assert config.lower[k] - 1.1e-9 <= q[k] <= config.upper[k] + 1.1e-9
            assert abs(step[k]) <= config.velocity[k] * config.period + rounding + 1e-12
            allowance = format_allowance(config.decimals, cycle=config.period)
            budget = (config.acceleration[k] + allowance) * config.period**2
            assert abs(step[k] - self.step[k]) <= budget * (1 + 1e-8) + 1e-14
        if cell.state in (State.READY, State.ARMED, State.HOLDING):
            assert step == (0.0, 0.0)
        self.q, self.step = q, step


class Pilot:
    """A sender that knows the last command it sent, and what may go wrong with it."""

    def __init__(self, cell):
        self.cell, self.q, self.speed, self.session = cell, START[0], 0.0, "s1"
        self.guard = Guard(cell)

    def cycle(self, **changes):
        """Let the time of a command pass: a cycle of the controller, or a third of one."""
        replies = len(self.cell.replies)
        if changes:
            self.cell.cycle(**changes)
        else:
            self.cell.pass_command()
        if len(self.cell.replies) > replies:
            self.guard.check()

    def send(self, cycles=1, acceleration=0.0, **changes):
        config = self.cell.config
        self.speed = min(max(self.speed + acceleration * config.acceleration[0] * CYCLE, -2.0), 2.0)
        self.q = min(max(self.q + self.speed * CYCLE * cycles, -9.0), 9.0)
        self.cell.send((self.q, START[1]), session=self.session, **changes)

    def do(self, kind, value, cycles):
        getattr(self, f"_{kind}")(value, cycles)

    def _drive(self, value, cycles):
        for _ in range(cycles):
            self.send(acceleration=value)
            self.cycle()

    def _to_the_end(self, value, cycles):
        for _ in range(2 * cycles):
            room = 0.5 - abs(self.q)
            self.speed = math.copysign(min(abs(self.speed) + 2.34 * CYCLE, math.sqrt(max(0.0, 2 * 2.34 * room))), value)
            self.send()
            self.cycle()

    def _rest(self, value, cycles):
        self.speed = 0.0
        self._drive(0.0, cycles)

    def _jump(self, value, cycles):
        self.q += value
        self.send()
        self.cycle()

    def _lose(self, value, cycles):
        cycles = min(cycles, 12)
        for _ in range(cycles):
            self.cycle()
        self.cell.seq += cycles
        self.cell.stamp += cycles * CYCLE_NS
        self.send(cycles)

    def _silence(self, value, cycles):
        for _ in range(2 * cycles):
            self.cycle()

    def _burst(self, value, cycles):
        for _ in range(min(cycles, 20)):
            self.send()
        for _ in range(cycles):
            self.cycle()

    def _jitter(self, value, cycles):
        """Commands that arrive in bunches, while the controller goes on."""
        waiting = 0
        for k in range(3 * cycles):
            waiting += 1
            if (k * 7 + cycles) % 5 == 0 or waiting > cycles:
                for _ in range(waiting):
                    self.send(acceleration=value)
                waiting = 0
            self.cycle()

    def _stalls(self, value, cycles):
        """As the network does it: nothing, and then everything at once, up to beyond the silence."""
        for _ in range(3):
            for _ in range(cycles):
                self.cycle()
            for _ in range(cycles):
                self.send(acceleration=value / 2)

    def _drift(self, value, cycles):
        """A sender faster or slower than time."""
        for k in range(5 * cycles):
            if value > 0 or k % 12:
                self.send(acceleration=value)
            if value > 0 and k % 12 == 0:
                self.send(acceleration=value)
            self.cycle()

    def _reorder(self, value, cycles):
        seq, stamp = self.cell.seq, self.cell.stamp
        for number in ((2, 1), (1, 1), (3, 1, 2), (1, 3, 3))[cycles % 4]:
            self.cell.seq, self.cell.stamp = seq + number - 1, stamp + (number - 1) * CYCLE_NS
            self.send(acceleration=value)
        self.cell.seq, self.cell.stamp = seq + 3, stamp + 3 * CYCLE_NS
        for _ in range(3):
            self.cycle()

    def _replay(self, value, cycles):
        """Numbers that were, with today's stamps."""
        for k in range(cycles):
            self.cell.send((self.q + value, START[1]), session=self.session, seq=max(1, self.cell.seq - k))
            self.cell.seq -= 1
        self.cycle()

    def _take_over(self, value, cycles):
        for verb in ("arm", "reset", "arm"):
            self.cell.control(verb, f"x{cycles}", self.cell.arming)
            for _ in range(cycles):
                self.cell.send((self.q + value, START[1]), session=f"x{cycles}")
                self.cycle()

    def _garbage(self, value, cycles):
        self.send(payload=PAYLOADS[cycles % len(PAYLOADS)])
        self.cycle()

    def _wrong(self, value, cycles):
        changes = (
            {"seq": max(0, self.cell.seq - cycles)},
            {"stamp": self.cell.stamp - cycles * CYCLE_NS * 4},
            {"stamp": 2**63},
        )
        self.send(**changes[cycles % 3])
        self.cycle()

    def _other_session(self, value, cycles):
        self.cell.send((value, value), session="s9")
        self.cycle()

    def _skip(self, value, cycles):
        self.send()
        self.cycle(step_ms=self.cell.config.cycle * (1 + cycles % 5))

    def _control(self, value, cycles):
        self.cell.control(("stop", "reset", "arm", "nonsense")[cycles % 4], value=str(value))
        self.cycle()

    def _person(self, value, cycles):
        """Somebody presses stop, as often as they like."""
        for number in range(cycles):
            self.cell.gateway.on_stop(Intervention(f"ada{cycles % 3}", str(number)), self.cell.now)
        self.cycle()

    def _recover(self, value, cycles):
        self.cell.control("stop")
        for _ in range(400):
            self.cycle()
        self.cell.control("reset")
        self.session = f"s{self.cell.seq + 2}"
        self.cell.arm(self.session)
        self.q, self.speed = self.cell.measured[0], 0.0

    def _new_session(self, value, cycles):
        if cycles % 3:
            self.cell.setpoint = self.cell.measured
        (gap, other_source, jump_ahead, jump_back)[cycles % 4](self.cell)
        self.cycle()


_KINDS = [
    "drive", "drive", "to_the_end", "to_the_end", "rest", "jump", "lose", "silence", "burst", "garbage", "wrong", "other_session",
    "skip", "control", "recover", "recover", "new_session", "jitter", "jitter", "stalls", "stalls", "drift", "reorder", "replay",
    "take_over", "person",
]  # fmt: skip
_EVENT = st.tuples(
    st.sampled_from(_KINDS),
    st.one_of(st.sampled_from((-1.0, 1.0)), st.floats(-1.2, 1.2)),
    st.integers(1, 60),
)


@settings(max_examples=120, deadline=None)
@given(
    st.lists(_EVENT, min_size=1, max_size=14),
    st.sampled_from((2, 3, 6)),
    st.booleans(),
    st.sampled_from((0.02, 0.0213, 0.1)),
    st.sampled_from((4, 12)),
)
# one telegram is lost at speed: the arm stands for a cycle
@example([("drive", -1.0, 16), ("skip", -1.0, 1)], 2, False, 0.02, 4)
def test_corrections_stay_inside_the_limits_whatever_arrives(events, decimals, properties, delay, cycle):
    cell = Cell(
        decimals=decimals,
        properties=properties,
        playout_delay=delay,
        silence=0.06,
        cycle=cycle,
    )
    pilot = Pilot(cell)
    for _ in range(cycle // 4):
        pilot.cycle()
    cell.arm()
    for event in events:
        pilot.do(*event)
    # and whatever it was, silence ends it
    for _ in range(600 * (cycle // 4)):
        pilot.cycle()
    assert cell.state not in (State.FOLLOWING, State.BRAKING)
    if cell.replies[-1] is not None:
        assert cell.held() == cell.measured

"""The commands of one session: age on two clocks that drift apart, order, and stamps for those that have none."""

from __future__ import annotations

import dataclasses
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.command_intake import ARRIVAL_SMOOTHING, FARTHEST, REMEMBERED, CommandStream
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties

CONFIG = GatewayConfig("arm", ("A1",), (-1.0,), (1.0,), (1.0,), (1.0,))
CODEC = JointStringCodec(1)
PAYLOAD = CODEC.encode((0.0,))
SENDER_EPOCH = 1_790_000_000 * NANOSECONDS


def make_stream(config=CONFIG) -> CommandStream:
    stream = CommandStream(config, CODEC)
    stream.begin("s1")
    return stream


def test_a_command_that_was_held_up_is_stale_even_after_hours_of_drift():
    stream = make_stream()
    seconds = 3 * 3600
    for second in range(seconds):
        stamp = SENDER_EPOCH + round(second * NANOSECONDS * (1 - 50e-6))
        stream.read(PAYLOAD, CommandProperties("s1", second + 1, stamp), second * NANOSECONDS)
    stamp = SENDER_EPOCH + round((seconds - CONFIG.max_age - 0.01) * NANOSECONDS * (1 - 50e-6))
    with pytest.raises(PayloadError, match="s older than the freshest"):
        stream.read(PAYLOAD, CommandProperties("s1", seconds + 1, stamp), seconds * NANOSECONDS)


def test_a_number_far_ahead_is_refused_once_the_stream_runs_and_leaves_no_trace():
    # one message could otherwise lift the count of lost commands beyond what a status may hold, and end the stream for its owner
    stream = make_stream()
    assert take(stream, 70_000) == 69_999
    stream.last_stamp = SENDER_EPOCH
    assert take(stream, 70_001 + FARTHEST) == "sequence"
    assert take(stream, 70_000 + FARTHEST) == FARTHEST - 1
    assert take(stream, 70_001 + FARTHEST) == 0


# -- order -----------------------------------------------------------------------------------------------------------


def take(stream, seq):
    """Return what becomes of a command: commands lost before it, or the reason of its refusal."""
    try:
        return stream.read(PAYLOAD, CommandProperties("s1", seq, SENDER_EPOCH + seq), seq)[2]
    except PayloadError as error:
        return error.reason


@given(st.lists(st.integers(1, 400), min_size=1, max_size=200))
def test_every_number_is_taken_at_most_once_and_in_order(numbers):
    stream, taken = make_stream(), []
    for seq in numbers:
        result = take(stream, seq)
        newest = max(taken, default=0)
        if seq > newest:
            assert result == seq - newest - 1
            taken.append(seq)
        elif newest - seq >= REMEMBERED:
            assert result == "sequence"
        else:
            assert result == ("duplicate" if seq in taken else "reordered")


# -- the arrival grid ------------------------------------------------------------------------------------------------

BARE = dataclasses.replace(CONFIG, properties=False)


def arrive(stream, now, q=0.0):
    stamp = stream.read(CODEC.encode((q,)), None, now)[0]
    stream.last_stamp = stamp
    return stamp


def test_commands_without_stamps_lie_on_a_grid_that_jitter_hardly_moves():
    stream, chance = make_stream(BARE), random.Random(3)
    stamps = [arrive(stream, NANOSECONDS + k * CYCLE_NS + chance.randrange(20_000_000), 0.001 * k) for k in range(500)]
    steps = [b - a for a, b in zip(stamps, stamps[1:])]
    assert max(abs(step - CYCLE_NS) for step in steps) <= 20_000_000 // ARRIVAL_SMOOTHING + 1


def test_a_sender_that_was_given_up_begins_a_grid_of_its_own():
    stream = make_stream(BARE)
    arrive(stream, NANOSECONDS)
    wait = round((BARE.playout_delay_max + BARE.silence) * NANOSECONDS) + CYCLE_NS
    assert arrive(stream, NANOSECONDS + wait) == pytest.approx(NANOSECONDS + CYCLE_NS, abs=wait // ARRIVAL_SMOOTHING)
    again = 2 * NANOSECONDS + wait
    assert arrive(stream, again) == again

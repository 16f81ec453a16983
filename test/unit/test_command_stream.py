"""The commands of one session: age on two clocks that drift apart."""

from __future__ import annotations

import pytest

from construction_twin.errors import PayloadError
from construction_twin.mqtt.codec import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties
from construction_twin.rsi.command_stream import CommandStream
from construction_twin.rsi.config import GatewayConfig
from construction_twin.units import NANOSECONDS

CONFIG = GatewayConfig("arm", ("A1",), (-1.0,), (1.0,), (1.0,), (1.0,))
CODEC = JointStringCodec(1)
PAYLOAD = CODEC.encode((0.0,))
SENDER_EPOCH = 1_790_000_000 * NANOSECONDS


def make_stream() -> CommandStream:
    stream = CommandStream(CONFIG, CODEC)
    stream.begin("s1")
    return stream


@pytest.mark.parametrize("drift", [-50e-6, 50e-6])
def test_a_sender_whose_clock_drifts_is_fresh_for_a_day(drift):
    stream = make_stream()
    for second in range(86_400):
        stamp = SENDER_EPOCH + round(second * NANOSECONDS * (1 + drift))
        assert stream.read(PAYLOAD, CommandProperties("s1", second + 1, stamp), second * NANOSECONDS)[0] == stamp


def test_a_command_that_was_held_up_is_stale_even_after_hours_of_drift():
    stream = make_stream()
    seconds = 3 * 3600
    for second in range(seconds):
        stamp = SENDER_EPOCH + round(second * NANOSECONDS * (1 - 50e-6))
        stream.read(PAYLOAD, CommandProperties("s1", second + 1, stamp), second * NANOSECONDS)
    stamp = SENDER_EPOCH + round((seconds - CONFIG.max_age - 0.01) * NANOSECONDS * (1 - 50e-6))
    with pytest.raises(PayloadError, match="older than the freshest"):
        stream.read(PAYLOAD, CommandProperties("s1", seconds + 1, stamp), seconds * NANOSECONDS)

"""The seeded, short run of `make fuzz`; and a check that its verdict does find faults."""

from __future__ import annotations

import importlib.util
import random
import socket
import sys
import threading
from pathlib import Path

import pytest

from construction_twin.core.errors import PayloadError
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder

ROOT = Path(__file__).resolve().parents[3]
ARMING = {"hash": "0" * 64, "run": "run1"}


@pytest.fixture(scope="module")
def fuzz():
    """scripts/fuzz.py; it finds the modules of test/fuzz itself."""
    path = list(sys.path)
    spec = importlib.util.spec_from_file_location("fuzz", ROOT / "scripts" / "fuzz.py")
    module = sys.modules["fuzz"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["fuzz"]
    sys.path[:] = path


@pytest.fixture(scope="module")
def gateway_module(fuzz):
    return sys.modules["fuzz_gateway"]


@pytest.fixture(scope="module")
def mutations(fuzz):
    return sys.modules["mqtt_mutations"]


def test_codecs_and_running_gateway_stand_up_to_a_short_run(fuzz, capsys):
    assert fuzz.main(["--count", "2000", "--seed", "3"]) == 0, capsys.readouterr().out
    said = capsys.readouterr().out
    assert "nothing crashed, nothing moved, everything was counted, memory stayed flat" in said
    # all four, and in each the refusals that its mutations are made for
    for campaign in ("MQTT codecs", "RSI codecs", "MQTT, running gateway", "RSI, running gateway"):
        assert f"{campaign:22}      2000 sent" in said
    expected = (
        "properties control format length review status refused_session refused_control refused_properties refused_verb"
    )
    expected += " stop pause resume joints values"
    expected += " refused_retained refused_not_armed telegram_refused_xml telegram_refused_ipoc telegram_refused_source telegrams"
    assert [name for name in expected.split() if f"    {name} " not in said] == []


def test_the_same_seed_makes_the_same_messages_and_another_one_others(mutations):
    target = mutations.Target("owner", "ended", ARMING, b"+001.000", b"+000.000")

    def made(seed):
        rng = random.Random(seed)
        return [mutations.message(rng, target) for _ in range(200)]

    assert made(1) == made(1) != made(2)


def test_no_hostile_message_is_a_whole_command_of_the_armed_session_at_the_held_pose(mutations):
    rng, target = random.Random(5), mutations.Target("owner", "ended", ARMING, b"+030.000", b"+000.000")
    for _ in range(20_000):
        sent = mutations.message(rng, target)
        assert sent.payload != b"+000.000" or dict(sent.pairs).get("session") != "owner"


# -- the judge -------------------------------------------------------------------------------------------------------


def test_another_exception_than_a_refusal_is_a_crash(fuzz):
    tally = sys.modules["fuzz_codecs"].Tally()

    def refuse():
        raise PayloadError("format", "no")

    def crash():
        raise ValueError("int too long")

    assert tally.run(refuse, PayloadError) is None
    with pytest.raises(ValueError):
        tally.run(crash, PayloadError)
    assert tally == {"format": 1}


def test_a_refusal_that_quotes_all_of_a_hostile_message_is_found(fuzz):
    def refuse():
        raise PayloadError("format", "x" * 5000)

    with pytest.raises(AssertionError):
        sys.modules["fuzz_codecs"].Tally().run(refuse, PayloadError)


class FalseGateway(threading.Thread):
    """Answers every packet, with a correction of A2 after the first `still` ones."""

    def __init__(self, axes, still: int):
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self._axes, self._still = axes, still

    def run(self):
        decoder, encoder = RobotDecoder(self._axes), SensorEncoder("ImFree", self._axes)
        for number in range(self._still + 1):
            data, source = self.socket.recvfrom(65535)
            correction = [0.0] * 6
            correction[1] = 1e-6 * (number >= self._still)
            self.socket.sendto(encoder.encode(correction, decoder.parse(data).controller_ms), source)
        self.socket.close()


def test_the_smallest_motion_is_found(gateway_module):
    gateway = FalseGateway(gateway_module.AXES, 3)
    gateway.start()
    arm = gateway_module.Arm(gateway.socket.getsockname())
    try:
        assert all(arm.cycle(5.0) for _ in range(3))
        arm.demand_at_home()
        with pytest.raises(gateway_module.Refused, match="answered with a motion"):
            arm.cycle(5.0)
    finally:
        arm.close()
        gateway.join(5.0)


class ForgetfulMqtt:
    """A gateway that leaves every `leave_out`-th message uncounted, as `flood_mqtt` sees it."""

    def __init__(self, mutations, leave_out: int):
        self.target = mutations.Target("owner", "ended", ARMING, b"+001.000", b"+000.000")
        self.sent = self.granted = self.counted = self.seen = 0
        self._leave_out = leave_out

    def publish(self, made):
        self.sent += 1
        self.seen += 1
        self.counted += self.seen % self._leave_out != 0

    def marker(self):
        return {"refused_format": self.counted}

    def own(self):
        pass

    begin_stream = clean = own


def test_a_single_message_that_is_not_counted_is_found(gateway_module, mutations):
    whole = gateway_module.flood_mqtt(ForgetfulMqtt(mutations, 10**9), 700, 1)
    assert whole == {"refused_format": 700}
    with pytest.raises(gateway_module.Refused, match="500 messages were sent, 499 were counted"):
        gateway_module.flood_mqtt(ForgetfulMqtt(mutations, 400), 700, 1)


def test_memory_that_grows_is_found(fuzz, monkeypatch):
    class Growing:
        alive = True
        sizes = iter((30_000_000, 30_000_000 + fuzz.GROWTH + 1))

        def resident(self):
            return next(self.sizes)

    class Still:
        def demand_at_home(self):
            pass

    with pytest.raises(sys.modules["fuzz_gateway"].Refused, match="grew by 4.2 MB"):
        fuzz.flooded("x", Growing(), Still(), lambda *_: {}, 10, 1)

"""The codecs alone: whatever comes in, they return a value that stands for exactly that, or refuse with a typed error."""

from __future__ import annotations

import json
import math
import random
from collections import Counter
from collections.abc import Callable

from mqtt_mutations import Message, Target, message, mutate
from read_requests import read_message
from rsi_mutations import mutate as mutate_telegram

from construction_twin.core.errors import PayloadError, TelegramError
from construction_twin.link.gateway_status import parse_status, status_values
from construction_twin.link.remote_trajectory import parse_trajectory
from construction_twin.link.requests import (
    GoalRequest,
    IkRequest,
    Joints,
    NamelessVerdict,
    Verdict,
    read_document,
    read_goal,
)
from construction_twin.mqtt import requests
from construction_twin.mqtt.interventions import PAUSE, RESUME, STOP, parse_intervention
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import (
    account_of,
    parse_control,
    read_command_properties,
    read_state_properties,
)
from construction_twin.rsi.controller_codec import SensorDecoder
from construction_twin.rsi.gateway_codec import RobotDecoder

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
STATUS = {
    "state": "armed", "run": "1f", "decimals": 3, "counters": {"telegrams": 7}, "mode": "normal", "last_refusal": "arm: no",
    "playout": {"delay_ms": 20.0, "drift_ppm": None}, "intruder": {"session": "x", "count": 1},
    "reply_us": {"bins": [50, 100], "counts": [1, 2, 3], "max": 80},
}  # fmt: skip
#: What a view said; repeated by whatever starts something.
MOMENT = "c0ffee00-81234"
REVIEW = {
    "plan_id": "p1",
    "plan_hash": "0" * 64,
    "verdict": "approved",
    "reviewer": "Ada",
    "reason": "",
    "moment": MOMENT,
}
JOINTS = Joints(tuple(f"joint_a{k}" for k in range(1, 7)), (False,) * 6)
_POSE = {"position": [1.2, 0.1, 1.4], "orientation": [0.0, 0.7071067811865476, 0.0, 0.7071067811865476]}
#: What a console asks for, each kind once.
WISHES = [
    {"id": "1", "kind": "joints", "joints": dict.fromkeys(JOINTS.names, 0.1), "speed_scale": 0.3},
    {"id": "2", "kind": "pose", "configuration": "", **_POSE},
    {"id": "3", "kind": "line", "speed": 0.2, **_POSE},
    {"id": "4", "kind": "way_back"},
    {"id": "5", "kind": "work_task", "task": "2IlnvQujnOqPQIJIUQ_fsr"},
]
IK = {"id": "6", "seed": dict.fromkeys(JOINTS.names, 0.1), **_POSE}
MOTION = {
    "id": "7", "units": {"angle": "rad", "length": "m", "time": "s"}, "joint_names": list(JOINTS.names),
    "points": [{"positions": [0.0] * 6, "time_from_start": 0.0}, {"positions": [0.1] * 6, "time_from_start": 2.0}],
}  # fmt: skip
#: Largest datagram of UDP.
LARGEST = 65_507
SENSOR = (
    b'<Sen Type="CTWIN"><Stop>0</Stop><AK A1="0.1" A2="0.0" A3="0.0" A4="0.0" A5="0.0" A6="-0.2"/><IPOC>42</IPOC></Sen>'
)


class Tally(Counter):
    """How many inputs ended how; "accepted" and the reasons of refusals."""

    def run(self, parse: Callable[[], object], errors: type[Exception]) -> object:
        """Count what `parse` makes of an input; return its value, None when it refused. Any other exception is a crash."""
        try:
            value = parse()
        except errors as error:
            # a counter's name and a status carry it: neither may grow with what was sent
            assert error.reason.isidentifier() and len(error.reason) < 32
            assert len(str(error)) < 2000, len(str(error))
            self[error.reason] += 1
            return None
        self["accepted"] += 1
        return value


def mqtt_codecs(count: int, seed: int, progress: Callable[[int], None] = lambda done: None) -> Tally:
    """Feed `count` payloads and property sets to everything that reads MQTT."""
    rng, codec, tally = random.Random(seed), JointStringCodec(6), Tally()
    target = Target("owner", "ended", "0" * 64, codec.encode((0.5,) * 6), codec.encode((0.0,) * 6))
    others = [
        (json.dumps(STATUS).encode(), lambda data: status_values(parse_status(data))),
        (
            json.dumps(REVIEW).encode(),
            lambda data: read_message(NamelessVerdict, requests.NAMELESS_REVIEW, data, False),
        ),
        (json.dumps(REVIEW).encode(), lambda data: read_message(Verdict, requests.REVIEW, data, False)),
        (b'{"id": "17"}', lambda data: parse_intervention(STOP, "kr120-stopper-bob", data, False)),
        (b'{"id": "18"}', lambda data: parse_intervention(PAUSE, "kr120-stopper-bob", data, False)),
        (
            json.dumps({"id": "19", "moment": MOMENT}).encode(),
            lambda data: parse_intervention(RESUME, "kr120-stopper-bob", data, False),
        ),
        (json.dumps(IK).encode(), lambda data: _finite(read_message(IkRequest, requests.IK, data, False))),
        (
            json.dumps(MOTION).encode(),
            lambda data: parse_trajectory(read_document(data, False, "trajectory", 1 << 20), JOINTS),
        ),
        (b"twin/kr120/stop/kr120-stopper-bob", lambda data: account_of(data.decode(errors="replace"))),
    ]
    others += [(json.dumps(wish | {"moment": MOMENT}).encode(), _wish) for wish in WISHES]
    for sample, parse in others:
        # a sample that is refused as it is would fuzz nothing but the refusal
        parse(sample)
    for done in range(count):
        if rng.random() < 0.2:
            sample, parse = rng.choice(others)
            tally.run(lambda: parse(mutate(rng, sample)), PayloadError)
        else:
            _read_message(message(rng, target), codec, tally)
        progress(done + 1)
    return tally


def _wish(data: bytes) -> object:
    return _finite(read_goal(read_document(data, False, "plan_request", requests.PLAN_REQUEST.limit), JOINTS))


def _finite(asked: GoalRequest | IkRequest) -> object:
    """What is taken for a wish has only numbers in it that a planner can compute with."""
    values = [*asked.position, *asked.orientation]
    values += (
        [*asked.joints, asked.speed, asked.speed_scale, asked.acceleration_scale]
        if isinstance(asked, GoalRequest)
        else asked.seed.values()
    )
    assert all(map(math.isfinite, values)), asked
    return asked


def _read_message(sent: Message, codec: JointStringCodec, tally: Tally) -> None:
    if sent.topic == "control":
        control = tally.run(lambda: parse_control(sent.payload), PayloadError)
        assert control is None or json.loads(sent.payload)["verb"] == control.verb
        return
    q = tally.run(lambda: _command(sent, codec), PayloadError)
    # what was accepted stands for exactly what was sent; -000.000 is 0
    assert q is None or codec.encode(q) == sent.payload.replace(b"-000.000", b"+000.000")


def _command(sent: Message, codec: JointStringCodec) -> tuple[float, ...]:
    if sent.pairs and sent.pairs[0][0] == "seq":
        read_state_properties(sent.pairs)
    else:
        read_command_properties(sent.pairs)
    return codec.decode(sent.payload)


def rsi_codecs(telegram: bytes, count: int, seed: int, progress: Callable[[int], None] = lambda done: None) -> Tally:
    """Feed `count` changed telegrams and replies to the gateway's and the mock's decoder."""
    robot, sensor, tally = (
        RobotDecoder(AXES),
        SensorDecoder("CTWIN", AXES, ("Stop", *(f"AK.{a}" for a in AXES))),
        Tally(),
    )
    for done in range(count):
        if done % 4:
            read = tally.run(lambda: robot.parse(mutate_telegram(telegram, seed + done)[:LARGEST]), TelegramError)
            values = () if read is None else (*(read.measured or ()), *(read.setpoint or ()), read.controller_ms)
        else:
            read = tally.run(lambda: sensor.parse(mutate_telegram(SENSOR, seed + done)[:LARGEST]), TelegramError)
            values = () if read is None else (*read.target, read.controller_ms)
        assert all(map(math.isfinite, values))
        progress(done + 1)
    return tally

"""A program that plans elsewhere, with an account of its own at a site's broker. For the integration tests.

As compas_eve does it: QoS 0.
"""

from __future__ import annotations

import json
import uuid
from pathlib import Path

from twin_client import wait

from construction_twin.mqtt.client import Broker, load_account, make_client, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import TRAJECTORY

UNITS = {"angle": "deg", "length": "mm", "time": "s"}


class RemotePlanner:
    """Sends motions, and keeps the answers and what it sees.

    Args:
        account: Its account file, in the folder that is named after the account.
        port: Of the site's broker on this machine.
        topics: Of the robot.
    """

    def __init__(self, account: Path, port: int, topics: Topics):
        self.topic = topics.of(TRAJECTORY, account.parent.name)
        self._topics = topics
        self.answers: list[dict] = []
        self.views: list[dict] = []
        broker = Broker("localhost", port, account=load_account(account))
        self.client = make_client(broker, unique_id(topics.robot, "elsewhere"), "unused")
        self.client.on_connect = lambda client, *_: client.subscribe([(topics.ack_of(TRAJECTORY), 1), (topics.view, 0)])
        self.client.on_message = self._on_message
        self.client.connect_async(broker.host, broker.port, broker.keepalive)
        self.client.loop_start()

    def _on_message(self, client, data, message) -> None:
        kept = self.views if message.topic == self._topics.view else self.answers
        kept.append(json.loads(message.payload) | {"retained": message.retain})

    def send(self, document: dict, retain: bool = False) -> dict:
        """Send a motion; return the answer to it."""
        count = len(self.answers)
        # with QoS 0 a broken connection may lose it, or its answer
        self.client.publish(self.topic, json.dumps(document), qos=1, retain=retain)
        wait(lambda: len(self.answers) > count, "an answer on trajectory/ack")
        return self.answers[count]

    def motion(self, *goals_deg: tuple[float, ...], **changes) -> dict:
        """Return a motion from where the twin is seen to be through goals."""
        view = self.views[-1]
        start = [value * 180.0 / 3.141592653589793 for value in view["twin"]["positions"]]
        points = [{"positions": list(goal)} for goal in (start, *goals_deg)]
        document = {"id": uuid.uuid4().hex, "units": UNITS, "joint_names": view["joints"]["names"], "points": points}
        return document | changes

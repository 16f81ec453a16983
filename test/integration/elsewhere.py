"""Clients at a broker of this machine: a tablet with the account of a reviewer, and a program that plans elsewhere."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable
from pathlib import Path

from paho.mqtt.client import MQTTMessage
from twin_client import wait

from construction_twin.core.freshness import present
from construction_twin.mqtt.client import Broker, load_account, make_client, subscriptions, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import REVIEW, TRAJECTORY

UNITS = {"angle": "deg", "length": "mm", "time": "s"}


def document(message: MQTTMessage):
    """Return what a message says in JSON; None where it is empty."""
    return json.loads(message.payload or b"null")


class Elsewhere:
    """Hears topics until `close`.

    Attributes:
        heard: What `read` makes of the messages of each topic, the newest last.
    """

    def __init__(self, broker: Broker, *topics: str, read: Callable[[MQTTMessage], object] = document):
        self.heard: dict[str, list] = {topic: [] for topic in topics}
        self.client = make_client(broker, unique_id("kr120", "elsewhere"), "unused")
        self.client.on_connect = lambda client, *_: client.subscribe(
            subscriptions(client, [(topic, 1) for topic in topics])
        )
        self.client.on_message = lambda c, u, message: self.heard[message.topic].append(read(message))
        self.client.connect_async(broker.host, broker.port, broker.keepalive)
        self.client.loop_start()

    def newest(self, topic: str):
        """Return what was heard last of a topic; None before the first message."""
        return self.heard[topic][-1] if self.heard[topic] else None

    def publish(self, topic: str, payload: str, retain: bool = False) -> int:
        """Publish with QoS 1: with 0 a broken connection may lose it; return the message's number."""
        return self.client.publish(topic, payload, qos=1, retain=retain).mid

    def ask(self, topic: str, payload: str, answered: str, retain: bool = False) -> dict:
        """Publish, and return the next that is heard of the topic of answers."""
        answers = self.heard[answered]
        count = len(answers)
        self.publish(topic, payload, retain)
        wait(lambda: len(answers) > count, f"an answer on {answered}")
        return answers[count]

    def close(self) -> None:
        """End the connection."""
        self.client.disconnect()
        self.client.loop_stop()


class Tablet(Elsewhere):
    """A person's tablet.

    Args:
        account: Its account file.
        port: Of the site's broker.
        topics: Of the robot.
    """

    def __init__(self, account: Path, port: int, topics: Topics):
        self._topics, known = topics, load_account(account)
        self.account = known.user
        self._refused: dict[int, bool] = {}
        super().__init__(
            Broker("localhost", port, account=known), topics.plan, topics.view, topics.ack_of(REVIEW), topics.stop_ack
        )
        self.client.on_publish = lambda c, u, mid, reason, p: self._refused.update({mid: reason.is_failure})

    @property
    def plan(self) -> dict | None:
        """The plan under review, None when there is none."""
        return self.newest(self._topics.plan)

    def may_publish(self, topic: str, payload: str) -> bool:
        """Publish on any topic; return whether the broker's rules allow it."""
        number = self.publish(topic, payload)
        wait(lambda: number in self._refused, f"the broker's answer on {topic}")
        return not self._refused.pop(number)

    def stop(self) -> dict:
        """Publish on `stop/<account>`; return the answer of the gateway."""
        id_ = uuid.uuid4().hex
        self.publish(self._topics.stop_by(self.account), json.dumps({"id": id_}))

        def answers() -> list[dict]:
            told = list(self.heard[self._topics.stop_ack])
            return [answer for answer in told if (answer["id"], answer["by"]) == (id_, "gateway")]

        wait(answers, "the gateway's answer to the stop")
        return answers()[0]

    def approve(self, plan: dict) -> dict:
        """Approve a plan; return the answer."""
        view = self.newest(self._topics.view)
        moment = view["moment"] if view else str(present())
        verdict = {"plan_id": plan["id"], "plan_hash": plan["hash"], "verdict": "approved", "moment": moment}
        return self.ask(
            self._topics.of(REVIEW, self.account), json.dumps(verdict), answered=self._topics.ack_of(REVIEW)
        )


class RemotePlanner(Elsewhere):
    """Sends motions as compas_eve does, by MQTT 3.1.1.

    Args:
        account: Its account file, in the folder that is named after the account.
        port: Of the site's broker.
        topics: Of the robot.
    """

    def __init__(self, account: Path, port: int, topics: Topics):
        self._sent, self._answered = topics.of(TRAJECTORY, account.parent.name), topics.ack_of(TRAJECTORY)
        super().__init__(
            Broker("localhost", port, "3.1.1", account=load_account(account)),
            self._answered,
            topics.view,
            read=lambda message: document(message) | {"retained": message.retain},
        )
        self.views = self.heard[topics.view]

    def send(self, *goals_deg: tuple[float, ...], **fields) -> dict:
        """Send a motion from where the twin is seen to be through goals; return the answer to it."""
        view = self.views[-1]
        start = [value * 180.0 / 3.141592653589793 for value in view["twin"]["positions"]]
        points = [{"positions": list(goal)} for goal in (start, *goals_deg)]
        motion = {"id": uuid.uuid4().hex, "units": UNITS, "joint_names": view["joints"]["names"], "points": points}
        return self.ask(self._sent, json.dumps(motion | fields), answered=self._answered)

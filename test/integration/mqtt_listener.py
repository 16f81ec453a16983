"""Somebody at a robot's broker, for the integration tests."""

from __future__ import annotations

import json

from paho.mqtt.client import MQTTMessage
from twin_client import wait

from construction_twin.mqtt.client import Broker, make_client, subscriptions, unique_id


class MqttListener:
    """A client with an account, or without.

    Attributes:
        heard: The messages of each topic, the newest last.
    """

    def __init__(self, broker: Broker, *topics: str):
        self.heard: dict[str, list[MQTTMessage]] = {topic: [] for topic in topics}
        self._answers: dict[int, bool] = {}
        self.client = make_client(broker, unique_id("kr120", "test"), "unused")
        self.client.on_connect = lambda client, *_: client.subscribe(subscriptions((topic, 1) for topic in topics))
        self.client.on_message = lambda _c, _u, message: self.heard[message.topic].append(message)
        self.client.on_publish = lambda _c, _u, mid, reason, _p: self._answers.update({mid: not reason.is_failure})
        self.client.connect_async(broker.host, broker.port, broker.keepalive)
        self.client.loop_start()

    def documents(self, topic: str) -> list[dict]:
        """Return the JSON of each message of a topic; an empty message is an empty document."""
        return [json.loads(message.payload or b"{}") for message in list(self.heard[topic])]

    def newest(self, topic: str) -> dict:
        """Return the JSON of the newest message of a topic; empty before the first one."""
        return json.loads(self.heard[topic][-1].payload or b"{}") if self.heard[topic] else {}

    def publish(self, topic: str, payload: bytes | str) -> bool:
        """Publish; return whether the broker's rules allow it."""
        mid = self.client.publish(topic, payload, qos=1).mid
        wait(lambda: mid in self._answers, f"the broker's answer on {topic}")
        return self._answers[mid]

    def ask(self, topic: str, document: dict, ack: str) -> dict:
        """Publish a request; return the next message on the topic of answers."""
        count = len(self.heard[ack])
        self.publish(topic, json.dumps(document))
        wait(lambda: len(self.heard[ack]) > count, f"an answer on {ack}")
        return self.documents(ack)[count]

    def close(self) -> None:
        """End the connection."""
        self.client.disconnect()
        self.client.loop_stop()

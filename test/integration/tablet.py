"""A tablet with an account of its own at a site's broker. For the integration tests."""

from __future__ import annotations

import json
from pathlib import Path

from twin_client import wait

from construction_twin.mqtt.account import load_account
from construction_twin.mqtt.client import Broker, make_client, subscriptions, unique_id
from construction_twin.mqtt.messages import Topics


class Tablet:
    """What a tablet sees, by topic; the newest message last.

    Parameters
    ----------
    account : Path
        Its account file.
    port : int
        Of the site's broker on this machine.
    topics : Topics
        Of the robot.
    """

    def __init__(self, account: Path, port: int, topics: Topics):
        self._topics = topics
        self.heard: dict[str, list[tuple[bytes, bool]]] = {topics.plan: [], topics.review_ack: []}
        broker = Broker("localhost", port, account=load_account(account))
        self.client = make_client(broker, unique_id(topics.robot, "tablet"), "unused")
        self.client.on_connect = lambda client, *_: client.subscribe(
            subscriptions(client, [(t, 1) for t in self.heard])
        )
        self.client.on_message = lambda c, u, message: self.heard[message.topic].append(
            (message.payload, message.retain)
        )
        self.client.connect_async(broker.host, broker.port, broker.keepalive)
        self.client.loop_start()

    @property
    def plan(self) -> dict | None:
        """The plan under review, None when there is none."""
        heard = self.heard[self._topics.plan]
        return json.loads(heard[-1][0]) if heard and heard[-1][0] else None

    def answer(self, payload: bytes, retain: bool = False) -> dict:
        """Publish on `review`; return the answer."""
        answers = self.heard[self._topics.review_ack]
        count = len(answers)
        self.client.publish(self._topics.review, payload, qos=1, retain=retain)
        wait(lambda: len(answers) > count, "an answer on review/ack")
        return json.loads(answers[count][0])

    def verdict(self, plan: dict, verdict: str, **changes) -> dict:
        """Give a verdict on a plan; return the answer."""
        document = {"plan_id": plan["id"], "plan_hash": plan["hash"], "verdict": verdict, "reviewer": "Anna"}
        return self.answer(json.dumps(document | changes).encode())

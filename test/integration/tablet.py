"""A tablet with the account of a reviewer at a site's broker. For the integration tests."""

from __future__ import annotations

import json
import uuid
from pathlib import Path

from twin_client import wait

from construction_twin.core.freshness import present_moment
from construction_twin.mqtt.client import Broker, load_account, make_client, subscriptions, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import REVIEW


class Tablet:
    """What a tablet sees, by topic; the newest message last.

    Args:
        account: Its account file.
        port: Of the site's broker on this machine.
        topics: Of the robot.
    """

    def __init__(self, account: Path, port: int, topics: Topics):
        self._topics = topics
        known = load_account(account)
        self.account = known.user
        self._refused: dict[int, bool] = {}
        self.heard: dict[str, list[tuple[bytes, bool]]] = {
            topic: [] for topic in (topics.plan, topics.view, topics.ack_of(REVIEW), topics.stop_ack)
        }
        broker = Broker("localhost", port, account=known)
        self.client = make_client(broker, unique_id(topics.robot, "tablet"), "unused")
        self.client.on_connect = lambda client, *_: client.subscribe(subscriptions([(t, 1) for t in self.heard]))
        self.client.on_message = lambda c, u, message: self.heard[message.topic].append(
            (message.payload, message.retain)
        )
        self.client.on_publish = lambda c, u, mid, reason, p: self._refused.update({mid: reason.is_failure})
        self.client.connect_async(broker.host, broker.port, broker.keepalive)
        self.client.loop_start()

    @property
    def plan(self) -> dict | None:
        """The plan under review, None when there is none."""
        heard = self.heard[self._topics.plan]
        return json.loads(heard[-1][0]) if heard and heard[-1][0] else None

    @property
    def moment(self) -> str:
        """What whoever starts something repeats: of the newest view; the present one where no console_node tells any."""
        heard = self.heard[self._topics.view]
        return json.loads(heard[-1][0])["moment"] if heard else str(present_moment())

    def answer(self, payload: bytes, retain: bool = False) -> dict:
        """Publish on `review/<account>`; return the answer."""
        answers = self.heard[self._topics.ack_of(REVIEW)]
        count = len(answers)
        self.client.publish(self._topics.of(REVIEW, self.account), payload, qos=1, retain=retain)
        wait(lambda: len(answers) > count, "an answer on review/ack")
        return json.loads(answers[count][0])

    def may_publish(self, topic: str, payload: bytes) -> bool:
        """Publish on any topic; return whether the broker's rules allow it."""
        info = self.client.publish(topic, payload, qos=1)
        wait(lambda: info.mid in self._refused, f"the broker's answer on {topic}")
        return not self._refused.pop(info.mid)

    def stop(self) -> dict:
        """Publish on `stop/<account>`; return the answer of the gateway."""
        id_ = uuid.uuid4().hex
        self.client.publish(self._topics.stop_by(self.account), json.dumps({"id": id_}), qos=1)

        def answers() -> list[dict]:
            found = [json.loads(payload) for payload, _ in list(self.heard[self._topics.stop_ack])]
            return [answer for answer in found if (answer["id"], answer["by"]) == (id_, "gateway")]

        wait(answers, "the gateway's answer to the stop")
        return answers()[0]

    def verdict(self, plan: dict, verdict: str, **changes) -> dict:
        """Give a verdict on a plan; return the answer."""
        document = {"plan_id": plan["id"], "plan_hash": plan["hash"], "verdict": verdict}
        if verdict == "approved":
            document["moment"] = self.moment
        return self.answer(json.dumps(document | changes).encode())

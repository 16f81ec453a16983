#!/usr/bin/env python3
"""On real topics: a stop after a call of `reset` stands, a `reset` that failed arms nothing later, two gateways are named."""

import itertools
import json
import os
import signal
import sys
import threading
import time

import rospy
import rostest
from construction_twin.msg import Link
from mqtt_listener import MqttListener
from twin_client import RobotTest, case, node_pid, wait

from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics

TOPICS = Topics("twin", "kr120")
#: Between the call of `reset` and the stop [s]: while it is under way, and long after everything is accepted. Every 10 ms of
#: it is tested on a simulated clock: unit/link/test_reset_and_stop.py, TestEveryMoment.
MOMENTS = (0.06, 1.0)
#: How long a stop is watched [s].
WATCHED = 2.5
#: How often a stop may be earlier at the bridge than the call that was made before it. The call goes to the bridge by way of the
#: master, the stop by way of broker and gateway: on a busy machine either may be first.
TRIES = 20


class StopAndResetTest(RobotTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.ids = map(str, itertools.count(1))
        broker = Broker(port=rospy.get_param("mqtt_bridge/port"))
        cls.phone = MqttListener(broker, TOPICS.stop_ack, TOPICS.status, TOPICS.control)
        cls.addClassCleanup(cls.phone.close)
        wait(lambda: cls.phone.heard[TOPICS.status], "the phone to hear the gateway")

    @property
    def status(self) -> dict:
        """The gateway's newest status, of a gateway that runs."""
        found = (json.loads(message.payload) for message in reversed(self.phone.heard[TOPICS.status]))
        return next(status for status in found if status.get("run") and status["state"] != "offline")

    @property
    def cleared(self) -> list[int]:
        """The stops that `reset` has named on the wire."""
        controls = self.phone.documents(TOPICS.control)
        return [control["value"]["fault_number"] for control in controls if control["verb"] == "reset"]

    def setUp(self):
        self.client.start_over()

    def stop(self) -> None:
        """Stop by `stop/anna`, and wait until the gateway has answered."""
        id_ = next(self.ids)
        self.phone.publish(TOPICS.stop_by("anna"), json.dumps({"id": id_}))
        answer = {"id": id_, "by": "gateway", "ok": True}.items()
        wait(lambda: any(answer <= a.items() for a in self.phone.documents(TOPICS.stop_ack)), "the answer")

    def wait_until_stopped(self) -> None:
        """Wait until the bridge says so, in a report that is sent after this call."""
        client, seen = self.client, rospy.Time.now()

        def stopped() -> bool:
            link = client.link
            return link.header.stamp > seen and link.state == Link.NEEDS_RESET and link.gateway_state == "holding"

        client.wait(stopped, "the arm stopped")

    def assert_stays_stopped(self, seconds: float = WATCHED) -> None:
        """Watch gateway and link: neither is armed."""
        client, since = self.client, len(self.client.links)
        # this client's connection may be a moment behind the bridge's, whose answer says that it is stopped
        wait(lambda: self.status["state"] not in ("armed", "following", "ready"), "the status of the stop", 1.0)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.assertNotIn(self.status["state"], ("armed", "following", "ready"), self.status["reason"])
            time.sleep(0.005)
        told = client.links[since:]
        self.assertNotIn(Link.ARMED, [link.state for link in told], [link.reason for link in told])
        self.assertEqual(client.link.state, Link.NEEDS_RESET, client.describe())
        self.assertTrue(self.status["fault"])

    def reset(self) -> None:
        answer = self.client.call("reset")
        self.assertTrue(answer.success, answer.message)
        self.client.wait_until_ready()

    def stop_after_a_call(self, moment: float) -> bool:
        """Call `reset`, stop `moment` after it [s], and watch; return whether the call was at the bridge before the stop was.

        When it was not, the call was made of a person who is shown this stop: it clears it, and the link is armed. What tells is
        the number that `reset` names on the wire.
        """
        self.stop()
        self.wait_until_stopped()
        answers, sent, before = [], len(self.cleared), self.status["fault_number"]
        call = threading.Thread(target=lambda: answers.append(self.client.call("reset")))
        call.start()
        time.sleep(moment)
        self.stop()
        wait(lambda: self.status["fault_number"] > before, "the status that numbers the stop")
        number = self.status["fault_number"]
        wait(lambda: len(self.cleared) > sent or answers, "`reset` on the wire, or an answer without it")
        if number in self.cleared[sent:]:
            call.join(10.0)
            self.assertTrue(answers[0].success, answers[0].message)
            return False
        self.wait_until_stopped()
        self.assert_stays_stopped()
        call.join(10.0)
        said = answers[0].message
        self.assertTrue(said.startswith(("not armed: NEEDS_RESET, gateway was stopped", "armed, session ")), said)
        self.assertNotIn(number, self.cleared[sent:])
        self.reset()
        return True

    def test_a_stop_after_the_call_stands_and_needs_a_reset_of_its_own(self):
        for moment in MOMENTS:
            with case(f"stop {1000 * moment:g} ms after the call"):
                self.assertTrue(any(self.stop_after_a_call(moment) for _ in range(TRIES)), "never after it")

    def test_a_reset_that_failed_arms_nothing_later(self):
        client = self.client
        self.stop()
        self.wait_until_stopped()
        executor = node_pid("executor")
        # without setpoints the twin is nowhere near the arm, as far as the bridge can know
        os.kill(executor, signal.SIGSTOP)
        try:
            answer = client.call("reset")
        finally:
            os.kill(executor, signal.SIGCONT)
        self.assertFalse(answer.success)
        self.assertIn("not armed within 5 s", answer.message)
        self.assert_stays_stopped(5.0)
        self.assertIn("not armed within 5 s", client.link.reason)
        bridge = node_pid("mqtt_bridge")
        os.kill(bridge, signal.SIGKILL)
        wait(lambda: node_pid("mqtt_bridge") not in (0, bridge), "the bridge to be started again")
        self.wait_until_stopped()
        self.assert_stays_stopped(3.0)
        self.reset()


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "stop_and_reset", StopAndResetTest, sys.argv)

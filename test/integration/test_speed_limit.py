#!/usr/bin/env python3
"""What limits the speed slows the arm down on its path, and nothing that falls silent or vanishes speeds it up: a separation
distance by a program, and a person by MQTT.
"""

import os
import signal
import sys
import unittest

import numpy as np
import rospy
import rostest
from construction_twin.msg import Execution, Plan
from mqtt_listener import MqttListener
from sensor_msgs.msg import Range
from std_msgs.msg import Header
from twin_client import HOME, LEFT, Stream, TwinClient, node_pid, wait

from construction_twin.core.units import CYCLE
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.ros.messages.convert import plan_from_msg

#: Rounding to 3 decimals of a degree, of target and answer [rad].
ROUNDING = np.deg2rad(1e-3)
BROKER_PORT = 18862
TOPICS = Topics("twin", "kr120")
ACK = "twin/kr120/speed/ack"


class Tablet(MqttListener):
    """A person's page on a broker without accounts."""

    def __init__(self):
        super().__init__(Broker(port=BROKER_PORT), TOPICS.view, ACK)
        wait(lambda: self.view, "a view")

    @property
    def view(self) -> dict:
        """The newest view."""
        return self.newest(TOPICS.view)

    def limit(self, fraction: float, **more) -> dict:
        """Ask for a limit; return the answer."""
        kind = "raise" if "moment" in more else "lower"
        return self.ask(f"twin/kr120/{kind}_speed/dora", {"id": "limit", "limit": fraction, **more}, ACK)

    def raise_to(self, fraction: float) -> None:
        """Ask with the newest moment until that shows the last lower limit: on a busy machine it comes late."""
        wait(lambda: self.limit(fraction, moment=self.view["moment"])["ok"], f"a limit of {fraction}")


class Sensor:
    """Publishes a distance at 20 Hz until it is silenced."""

    def __init__(self):
        self._distance: float | None = None
        self._publisher = rospy.Publisher("separation_distance", Range, queue_size=1)
        wait(self._publisher.get_num_connections, "separation to listen")
        self._timer = rospy.Timer(rospy.Duration(0.05), self._publish)
        table = rospy.get_param("separation/table")
        self._distances, self._fractions = zip(*table)

    def publish_limit(self, fraction: float) -> None:
        """Report the distance at which this fraction of the planned speed is allowed."""
        self._distance = float(np.interp(fraction, self._fractions, self._distances))

    def silence(self) -> None:
        """Report nothing from now on."""
        self._distance = None

    def _publish(self, _event) -> None:
        if self._distance is not None:
            header = Header(stamp=rospy.Time.now())
            self._publisher.publish(Range(header=header, min_range=0.1, max_range=30.0, range=self._distance))


class SpeedLimitTest(unittest.TestCase):
    """One motion that is slowed down and sped up."""

    def setUp(self):
        rospy.init_node("test_speed_limit")
        self.client = TwinClient()
        self.reports: list[Execution] = []
        rospy.Subscriber("execution", Execution, self.reports.append)
        self.sensor = Sensor()

    def wait_for_rate(self, rate: float) -> None:
        """Wait until the executor plays at this fraction of the planned speed."""

        def there() -> bool:
            report = self.client.execution
            return abs(report.speed_limit - rate) < 0.005 and abs(report.rate - rate) < 0.005

        self.client.wait(there, f"the rate {rate}")
        self.assertEqual(self.client.execution.state, Execution.PLAYING)

    def arm_speed(self, arm: Stream) -> np.ndarray:
        """Return the arm's mean speed per joint over 0.2 s, after the setpoints that were under way have arrived [rad/s]."""
        arm.wait_for_more(100)
        begin = arm.positions(-1)[0]
        first = len(arm.messages) - 1
        arm.wait_for_more(50)
        end, last = arm.positions(-1)[0], len(arm.messages) - 1
        return np.abs(end - begin) / ((last - first) * CYCLE)

    def test_slows_down_on_the_path_speeds_up_again_and_ends_at_the_goal(self):
        self.client.wait(lambda: self.client.execution is not None, "the executor")
        self.client.wait(lambda: self.client.execution.speed_limit == 0.0, "the fraction of a sensor that says nothing")
        self.sensor.publish_limit(1.0)
        self.client.wait_until_ready()
        self.client.wait(lambda: self.client.execution.speed_limit == 1.0, "the sensor's limit")
        missed = self.client.mock_counter("missed")
        self.client.go_to(HOME)
        with Stream("mock_rsi/joint_states") as arm, Stream("twin/joint_states") as twin:
            answer = self.client.start(LEFT, duration=16.0)
            plan = self.client.plans[-1]
            top = np.abs([point.velocities for point in plan.trajectory.points]).max(axis=0)
            wait(lambda: arm.moved(4.0), "the arm to move")
            self.sensor.publish_limit(0.2)
            self.wait_for_rate(0.2)
            self.assertTrue((self.arm_speed(arm) <= 0.2 * top + ROUNDING / CYCLE / 10).all())
            self.stands_still_and_goes_on(arm, twin)
            self.slows_down_when_the_source_is_silent(arm, top)
            self.goes_as_fast_as_a_person_lets_it(arm, top)
            self.client.wait_for_outcome(answer.plan_id, "finished", 60.0)
            self.client.assert_at(LEFT, twin, arm)
            self.assert_on_the_path(plan, arm)
            self.assert_on_the_path(plan, twin)
            self.client.assert_within_limits(arm, missed)
        self.assertEqual({report.state for report in self.reports if report.plan_id == answer.plan_id} - {1}, {2})
        self.client.wait_until_ready()
        self.a_restart_of_the_monitor_raises_nothing()
        self.client.wait_until_ready()

    def stands_still_and_goes_on(self, arm: Stream, twin: Stream) -> None:
        """A silent sensor counts as a person right beside the arm."""
        self.sensor.silence()
        self.wait_for_rate(0.0)
        for stream in (arm, twin):
            self.client.wait(stream.at_rest, "the rest on the path")
        self.assertIn("stands still", self.client.execution.reason)
        self.assertIn("no separation distance", self.client.execution.reason)
        self.sensor.publish_limit(0.5)
        self.wait_for_rate(0.5)
        self.assertIn("at 50% of the planned speed", self.client.execution.reason)
        self.assertNotIn("stands still", self.client.execution.reason)

    def slows_down_when_the_source_is_silent(self, arm: Stream, top: np.ndarray) -> None:
        """The node stands still as if it had crashed: nothing is published on `speed_limit` any more."""
        pid = node_pid("separation")
        self.assertGreater(pid, 0)
        os.kill(pid, signal.SIGSTOP)
        try:
            self.wait_for_rate(0.1)
            self.assertTrue((self.arm_speed(arm) <= 0.1 * top + ROUNDING / CYCLE / 10).all())
            self.client.wait(
                lambda: "silent" in self.client.diagnostics("executor").get("speed limit because", ""), "the diagnosis"
            )
        finally:
            os.kill(pid, signal.SIGCONT)
        self.sensor.publish_limit(1.0)
        self.wait_for_rate(1.0)

    def goes_as_fast_as_a_person_lets_it(self, arm: Stream, top: np.ndarray) -> None:
        """The sensor allows everything."""
        tablet = Tablet()
        self.assertIsNotNone(tablet.view["speed"], "the sensor's limit")
        answer = tablet.limit(0.3)
        self.assertTrue(answer["ok"], answer)
        self.wait_for_rate(0.3)
        self.assertTrue((self.arm_speed(arm) <= 0.3 * top + ROUNDING / CYCLE / 10).all())
        self.assertIn("dora has limited the speed to 30%", self.client.execution.reason)
        tablet.raise_to(0.6)
        self.wait_for_rate(0.6)
        self.sensor.publish_limit(0.4)
        self.wait_for_rate(0.4)
        self.sensor.publish_limit(1.0)
        tablet.raise_to(1.0)
        self.wait_for_rate(1.0)
        tablet.close()

    def a_restart_of_the_monitor_raises_nothing(self) -> None:
        """The tablet vanishes, too: only a person with a fresh look raises it."""
        tablet = Tablet()
        self.assertTrue(tablet.limit(0.3)["ok"])
        self.client.wait(lambda: self.client.execution.speed_limit == 0.3, "the person's limit")
        tablet.close()
        seen = len(self.reports)
        pid = node_pid("pca_monitor")
        os.kill(pid, signal.SIGKILL)
        self.client.wait(lambda: self.client.execution.speed_limit == 0.1, "the fraction for silence")
        self.client.wait(lambda: node_pid("pca_monitor") not in (0, pid), "pca_monitor to come back", 60.0)
        self.client.wait(lambda: self.client.execution.speed_limit == 0.3, "the person's limit again")
        self.assertLessEqual(max(report.speed_limit for report in self.reports[seen:]), 0.3)
        tablet = Tablet()
        self.client.wait(lambda: (tablet.view["speed"] or {}).get("person") == "dora", "who set it")
        self.assertFalse(tablet.limit(1.0)["ok"])
        tablet.raise_to(1.0)
        self.client.wait(lambda: self.client.execution.speed_limit == 1.0, "no limit")
        tablet.close()

    def assert_on_the_path(self, plan: Plan, stream: Stream) -> None:
        """No pose is further from the plan's path than rounding, however fast it was passed."""
        motion = plan_from_msg(plan).trajectory
        path = motion.sample_many(np.linspace(0.0, motion.duration, 8001))[0]
        # between two points of the path, and of the rounding
        allowed = np.abs(np.diff(path, axis=0)).max() / 2 + ROUNDING
        for q in stream.positions()[::20]:
            self.assertLessEqual(np.abs(path - q).max(axis=1).min(), allowed)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "speed_limit", SpeedLimitTest, sys.argv)

"""What the tests of interruptions have in common: a fault in mid-motion, the arm's stop, `reset`, and a motion that works again."""

import os
import signal
from collections.abc import Callable

import numpy as np
import rospy
from construction_twin.msg import Link, Sync
from twin_client import FINAL_ERROR, HOME, LEFT, RobotTest, Stream, node_pid, wait

from construction_twin.core.units import radians


class Interruption(RobotTest):
    """One interruption per test, each in the middle of a motion from home."""

    def setUp(self):
        self.begin()
        # on a busy machine the planner is the last to be there
        rospy.wait_for_service("plan_to_joints", 60.0)
        self.client.go_to(HOME)
        self.links_before, self.syncs_before = len(self.client.links), len(self.client.syncs)

    def assert_said(self, words: str):
        """Since this test's begin the link asked for a reset, or the gate held, with a sentence that has these words."""
        links = [link for link in self.client.links[self.links_before :] if link.state == Link.NEEDS_RESET]
        syncs = [sync for sync in self.client.syncs[self.syncs_before :] if sync.state != Sync.IN_SYNC]
        reasons = [state.reason for state in links + syncs]
        self.assertTrue(any(words in reason for reason in reasons), reasons)

    def stops(self) -> int:
        """Return how often the gateway was ordered to stop, from a report that is sent after this call."""
        seen = rospy.Time.now() + rospy.Duration(1.0)
        self.client.wait(lambda: self.client.link.header.stamp > seen, "a report of the link")
        return int(self.client.gateway_counters().get("stops_stop", 0))

    def interrupt_and_recover(self, interrupt: Callable[[], None]):
        """Interrupt the path of commands in mid-motion: the arm stops, holds, and after `reset` executes a new plan."""
        client = self.client
        missed = client.mock_counter("missed")
        with Stream("mock_rsi/joint_states") as arm, Stream("twin/joint_states") as twin:
            # over before a killed node is back: an executor that did not notice would report it as finished
            plan = client.start(LEFT, duration=1.5)
            wait(lambda: arm.moved(5.0), "the arm to move")
            interrupt()
            wait(arm.at_rest, "the arm to rest")
            stopped = arm.positions(-1)[0]
            self.assertGreater(np.abs(stopped - radians(LEFT)).max(), np.deg2rad(3.0), "the arm went on to the goal")
            self.wait_for_the_link()
            self.assertNotEqual((client.execution.plan_id, client.execution.outcome), (plan.plan_id, "finished"))
            self.assert_holds(arm, stopped)
            self.reset()
            self.assert_holds(arm, stopped)
            client.wait(twin.at_rest, "the twin to rest where the arm is")
            np.testing.assert_allclose(twin.positions(-1), arm.positions(-1), atol=FINAL_ERROR)
            client.assert_within_limits(arm, missed)
            self.assert_works(arm, twin, missed)

    def halt_and_recover(self):
        """Interrupt by `halt`; it is the gateway that brakes for it, not a silence that follows."""
        stops = self.stops()
        self.interrupt_and_recover(lambda: self.assertTrue(self.client.call("halt").success))
        self.assert_said("stopped at the gateway on request")
        self.assertEqual(self.stops(), stops + 1)

    def kill(self, node: str):
        """Kill a node and wait until roslaunch has started it again."""
        pid = node_pid(node)
        self.assertGreater(pid, 0)
        os.kill(pid, signal.SIGKILL)
        wait(lambda: node_pid(node) not in (0, pid), f"{node} to be started again", 60.0)

    def wait_for_the_link(self):
        """Wait until the bridge has seen the arm at rest, and says that it goes on by itself or needs a reset."""
        with Stream("physical/joint_states") as physical:
            physical.wait_for_more(100)
        seen = rospy.Time.now()
        self.client.wait(
            lambda: self.client.link.header.stamp > seen and self.client.link.state in (Link.ARMED, Link.NEEDS_RESET),
            "the link to be armed again, or to need a reset",
        )

    def reset(self):
        """Call `reset`; the state is then as after bringup, in a new session."""
        before = self.client.link.session
        answer = self.client.call("reset")
        self.assertTrue(answer.success, answer.message)
        self.client.wait(lambda: self.client.link.session != before, "a new session")
        self.client.wait_until_ready()

    def assert_works(self, arm: Stream, twin: Stream, missed: int):
        """A new plan is executed up to its goal; one that a busy machine's late feedback made the gate hold may be repeated."""
        for _ in range(3):
            plan = self.client.start(LEFT)
            ended = ((plan.plan_id, "finished"), (plan.plan_id, "held"))
            self.client.wait(
                lambda: (self.client.execution.plan_id, self.client.execution.outcome) in ended, "the motion to end"
            )
            if self.client.execution.outcome == "finished":
                break
            self.wait_for_the_link()
            self.reset()
        self.client.wait_for_outcome(plan.plan_id, "finished", 1.0)
        self.client.assert_at(LEFT, twin, arm)
        self.client.assert_within_limits(arm, missed)

    def assert_holds(self, arm: Stream, stopped: np.ndarray):
        """Nothing has driven the arm to the twin: at most the start tolerance was blended in."""
        tolerance = rospy.get_param("gateway/start_tolerance")
        self.assertLessEqual(np.abs(arm.positions(-1)[0] - stopped).max(), tolerance)

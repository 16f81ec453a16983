#!/usr/bin/env python3
"""An operator does the whole job: with the marker's drags and menu as rviz sends them, and with the command `twin`."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import rospkg
import rospy
import rostest
from construction_twin.msg import Review
from twin_client import HOME, LEFT, RobotTest, Stream, wait
from visualization_msgs.msg import InteractiveMarkerFeedback, InteractiveMarkerInit, MarkerArray

from construction_twin.core.units import radians
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.ros.messages.convert import pose_to_msg

FRAME = "kr120/twin/base_link"
TWIN = Path(rospkg.RosPack().get_path("construction_twin")) / "nodes" / "twin"


class Rviz:
    """Sends what rviz sends of the marker, and sees what it shows."""

    def __init__(self):
        self._init = rospy.wait_for_message("tool_marker/update_full", InteractiveMarkerInit, 20.0)
        self._verdicts: list[MarkerArray] = []
        rospy.Subscriber("tool_marker/update_full", InteractiveMarkerInit, self._on_init)
        rospy.Subscriber("tool_marker/verdict", MarkerArray, self._verdicts.append)
        self._publisher = rospy.Publisher("tool_marker/feedback", InteractiveMarkerFeedback, queue_size=10)
        wait(lambda: self._publisher.get_num_connections(), "the marker to listen")
        wait(lambda: self._init.markers and self._init.markers[0].menu_entries, "the marker with its menu")

    def _on_init(self, message):
        self._init = message

    @property
    def text(self) -> str:
        return " ".join(self._verdicts[-1].markers[1].text.split()) if self._verdicts else ""

    @property
    def colour(self) -> str:
        r, g = self._verdicts[-1].markers[0].color.r, self._verdicts[-1].markers[0].color.g
        return "green" if g > r else "red" if g < 0.2 else "orange"

    def drag(self, pose: Pose, steps: int = 20) -> None:
        """Drag the marker to a pose: many positions in between, then the mouse button is released."""
        start = self._init.markers[0].pose.position
        for fraction in np.linspace(0.0, 1.0, steps):
            message = pose_to_msg(pose)
            for axis in "xyz":
                setattr(
                    message.position,
                    axis,
                    (1 - fraction) * getattr(start, axis) + fraction * getattr(message.position, axis),
                )
            self._send(InteractiveMarkerFeedback.POSE_UPDATE, message)
        self._send(InteractiveMarkerFeedback.MOUSE_UP, message)

    def choose(self, title: str) -> None:
        """Choose an entry of the menu."""
        entry = next(entry for entry in self._init.markers[0].menu_entries if entry.title == title)
        self._send(InteractiveMarkerFeedback.MENU_SELECT, self._init.markers[0].pose, entry.id)

    def decide(self, title: str) -> None:
        """Approve or reject; click again while the marker says that the plan was not shown long enough."""

        def decided() -> bool:
            return f"{title}: " in self.text and "has only just come" not in self.text

        wait(lambda: decided() or self.choose(title), f"the marker to take {title}", 60.0, period=0.5)

    def go_back(self) -> None:
        """Let the marker follow the tool; click again where a click is ignored.

        The server of the markers takes no feedback from another client for 1 s after a marker appeared or was moved by somebody.
        """

        def follows() -> bool:
            return "the marker follows the tool" in self.text and self.colour == "green"

        wait(lambda: follows() or self.choose("Back to the tool"), "the marker to follow the tool", 60.0, period=1.0)

    def wait_for(self, colour: str, text: str) -> None:
        """Wait until the marker shows a colour and a text."""
        try:
            wait(lambda: self._verdicts and text in self.text and self.colour == colour, f"{colour} and {text!r}", 60.0)
        except AssertionError as error:
            raise AssertionError(f"{error}; it shows {self.colour} and {self.text!r}") from None

    def _send(self, event: int, pose, entry: int = 0) -> None:
        message = InteractiveMarkerFeedback(
            client_id=f"{rospy.get_name()}/test rviz",
            marker_name="tool",
            event_type=event,
            pose=pose,
            menu_entry_id=entry,
        )
        message.header.frame_id = FRAME
        self._publisher.publish(message)


class ByHandTest(RobotTest):
    """Every test begins at rest at home."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.chain = Chain(cls.client.robot)
        cls.client.wait_until_ready()
        cls.rviz = Rviz()

    def setUp(self):
        self.begin()
        self.client.go_to(HOME)
        self.rviz.go_back()

    def twin(self, *words: str) -> subprocess.CompletedProcess:
        """Run the command line as a script would: without a terminal; and without `rosrun`, which searches for it each time."""
        command = [sys.executable, str(TWIN), "--robot", "kr120", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=120.0)

    def done(self, *words: str) -> str:
        run = self.twin(*words)
        self.assertEqual((run.returncode, run.stderr), (0, ""), run.stdout)
        return run.stdout

    # -- the marker

    def test_marker_from_drag_to_finished_motion(self):
        missed = self.client.mock_counter("missed")
        goal = self.chain.forward(radians(LEFT))
        with Stream("mock_rsi/joint_states") as arm, Stream("twin/joint_states") as twin:
            self.rviz.drag(goal)
            self.rviz.wait_for("green", "can be reached")
            plans = len(self.client.plans)
            self.rviz.choose("Plan")
            self.client.wait(lambda: len(self.client.plans) > plans, "a plan")
            plan = self.client.plans[-1]
            self.rviz.wait_for("green", f"plan {plan.id[:8]} waits for approval")
            self.rviz.choose("Preview")
            self.rviz.wait_for("green", "the ghost plays")
            arm.assert_still()
            self.rviz.decide("Approve")
            self.client.wait_for_outcome(plan.id, "finished", 30.0)
            wait(arm.at_rest, "the arm to rest")
            for stream in (arm, twin):
                reached = self.chain.forward(stream.positions(-1)[0])
                np.testing.assert_allclose(reached.position, goal.position, atol=1e-4)
                np.testing.assert_allclose(reached.rotation, goal.rotation, atol=1e-4)
            self.client.assert_within_limits(arm, missed)
        self.assertEqual(rospy.wait_for_message("review", Review, 5.0).reviewer, "tester")

    # -- the command line

    def test_command_line_from_plan_to_finished_motion(self):
        with Stream("mock_rsi/joint_states") as arm, Stream("twin/joint_states") as twin:
            self.assertIn("waiting for review", self.done("plan", "--speed", 50, "--joints", *LEFT))
            plan = self.client.plans[-1]
            shown = self.done("show")
            for part in (plan.id, plan.hash, "clearance", "largest fractions", "joint_a1 30.000 deg"):
                self.assertIn(part, shown)
            self.assertEqual(self.twin("approve").returncode, 5, "nobody was asked, nobody said yes")
            arm.assert_still()
            self.assertIn("plan 0000 is not under review", self.twin("approve", "0000", "--yes").stderr)
            said = self.done("approve", plan.id[:8], "--yes", "--wait", "--reviewer", "Ada")
            self.assertIn("finished", said)
            self.client.assert_at(LEFT, twin, arm)
        self.client.wait_until_ready()
        self.assertIn("ready", self.done("status", "--ready"))
        self.assertEqual(self.twin("approve", "--yes").returncode, 1)
        self.assertEqual(self.twin("show").returncode, 1)
        self.assertIn("waiting for review", self.done("home"))
        self.assertIn("finished", self.done("approve", "--yes", "--wait"))


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "by_hand", ByHandTest, sys.argv)

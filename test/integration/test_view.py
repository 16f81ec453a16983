#!/usr/bin/env python3
"""rviz draws the twin in orange and the arm coloured by sync state over it; without a display the node `view` ends well."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

import rospy  # noqa: E402
import rostest  # noqa: E402
from construction_twin.msg import Sync  # noqa: E402
from screenshot import VirtualDisplay, bare_view, extent, fraction  # noqa: E402
from twin_client import HOME, LEFT, RobotTest, Stream, TwinClient, wait  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

from construction_twin.monitor.states import SyncState  # noqa: E402
from construction_twin.views.sync_picture import COLOURS, visual_shapes  # noqa: E402

JOINT = "joint_a3"
SIZE = (700, 500)
#: Longest wait until the arm is drawn [s]: without a graphics card, on a busy machine.
DRAWN = 120.0
#: Least fraction of the picture that is the arm's orange: 0.0154 at home, 0.0102 seen through the ghost of the physical arm.
LEAST = 0.005
#: And of the picture's height between the highest and the lowest of it: the whole arm (0.254, through the ghost 0.244), not a link
#: that lies at the origin.
TALL = 0.2


class ViewTest(RobotTest):
    """One system, looked at."""

    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_view")
        cls.client = TwinClient()

    def view(self, config: Path, environment: dict) -> subprocess.Popen:
        return subprocess.Popen(
            ["rosrun", "construction_twin", "view", "--config", str(config), "--robot", "kr120", "__name:=test_viewer"],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    def test_markers_show_the_arm_in_the_colour_of_the_state(self):
        self.begin()
        with Stream("sync_markers", MarkerArray) as pictures:
            wait(lambda: self.is_shown(pictures.messages[-1], SyncState.IN_SYNC), "the arm in the colour of IN_SYNC")
            shown = pictures.messages[-1].markers
            arm = [marker for marker in shown if marker.ns == "physical"]
            self.assertEqual(len(arm), len(visual_shapes(self.client.robot.urdf)))
            self.assertTrue(all(marker.header.frame_id.startswith("kr120/physical/link_") for marker in arm))
            self.assertEqual([marker.action for marker in shown if marker.ns == "why"], [Marker.DELETE])
            self.close_the_gate()
            wait(lambda: not self.is_shown(pictures.messages[-1], SyncState.IN_SYNC), "another colour")
            (text,) = [marker for marker in pictures.messages[-1].markers if marker.ns == "why"]
            self.assertEqual(text.action, Marker.ADD)
            self.assertIn(text.text.split("\n")[0], {state.name.replace("_", " ") for state in SyncState} - {"IN SYNC"})
            self.client.stall(JOINT, False)
            wait(lambda: self.is_shown(pictures.messages[-1], SyncState.IN_SYNC), "the colour of IN_SYNC again", 40.0)

    def close_the_gate(self):
        """Let a joint stall in the middle of a motion."""
        self.client.go_to(HOME)
        with Stream("mock_rsi/joint_states") as arm:
            self.client.start(LEFT, duration=3.0)
            wait(lambda: arm.moved(5.0), "the arm to move")
            self.client.stall(JOINT, True)
        self.client.wait(lambda: self.client.sync.state != Sync.IN_SYNC, "the gate to close")

    @staticmethod
    def is_shown(picture: MarkerArray, state: SyncState) -> bool:
        colours = {(m.color.r, m.color.g, m.color.b) for m in picture.markers if m.ns == "physical"}
        return len(colours) == 1 and all(abs(a - b) < 1e-6 for a, b in zip(colours.pop(), COLOURS[state][:3]))

    def test_rviz_draws_the_arm(self):
        self.begin()
        with tempfile.TemporaryDirectory() as folder, VirtualDisplay(SIZE) as display:
            config = Path(folder) / "twin.rviz"
            config.write_text(bare_view((ROOT / "rviz/twin.rviz").read_text(), SIZE))
            picture = Path(folder) / "shot.png"
            self.assertLess(fraction(display.capture(picture), "orange"), LEAST / 10)
            rviz = self.view(config, display.environment)
            try:
                self.wait_until_drawn(rviz, display, picture)
            finally:
                rviz.terminate()
                rviz.communicate(timeout=60)

    def wait_until_drawn(self, rviz: subprocess.Popen, display: VirtualDisplay, picture: Path):
        def drawn() -> bool:
            if rviz.poll() is not None:
                self.skipTest(f"rviz cannot be started here, it ended with {rviz.returncode}")
            pixels = display.capture(picture)
            return fraction(pixels, "orange") > LEAST and extent(pixels, "orange")[1] > TALL

        wait(drawn, f"{LEAST:.1%} of orange in rviz's picture, over {TALL:.0%} of its height", DRAWN)

    def test_without_a_display_it_says_so_and_ends(self):
        environment = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
        run = self.view(ROOT / "rviz/twin.rviz", environment)
        output, _ = run.communicate(timeout=120)
        self.assertEqual(run.returncode, 0, output)
        self.assertIn("there is no display (DISPLAY is not set)", output)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "view", ViewTest, sys.argv)

#!/usr/bin/env python3
"""The gateway is killed in mid-motion: HOLDON and `Timeout` stop the arm, roslaunch starts the gateway, `reset` brings it all back.

No PC can prevent the step that HOLDON makes; it is printed. What the killed gateway had sent was inside the limits.
"""

import os
import shutil
import signal
import sys

import numpy as np
import rospy
import rostest
from construction_twin.msg import Link
from interruption import Interruption
from twin_client import Stream, wait

from construction_twin.core.units import CYCLE
from construction_twin.gateway.trace import read_trace


class FaultGatewayTest(Interruption):
    """One kill in the middle of a motion."""

    def test_killed_gateway(self):
        with Stream("mock_rsi/joint_states") as arm:
            timeouts = self.client.mock_counter("missed")
            self.interrupt_and_recover(self.kill_gateway)
            self.assertGreaterEqual(self.client.mock_counter("missed") - timeouts, 100, "the controller's Timeout")
            steps = np.diff(arm.positions(), axis=0)
            print(
                f"killed gateway: HOLDON changed the arm's velocity by {self.worst(steps):.1f} deg/s in one cycle",
                flush=True,
            )
        said = {link.state for link in self.client.links}
        self.assertTrue({Link.GATEWAY_OFFLINE, Link.NO_CONTROLLER} & said, [link.text for link in self.client.links])

    def kill_gateway(self):
        """Kill it, keep its trace, and wait until another one answers the controller."""
        path = rospy.get_param("~gateway_trace")
        pid = gateway_pid(path)
        os.kill(pid, signal.SIGKILL)
        # roslaunch waits a second before it starts the next one, which begins the file anew
        kept = shutil.copy(path, path + ".killed")
        self.client.assert_trace_within_limits(kept)
        begun = len(read_trace(kept))
        self.assertGreater(begun, 100)
        wait(lambda: gateway_pid(path) not in (0, pid), "roslaunch to start the gateway again")
        wait(lambda: os.path.getsize(path) and read_trace(path), "the new gateway to answer the controller", 30.0)

    @staticmethod
    def worst(steps: np.ndarray) -> float:
        """Return the largest change of velocity between two cycles [deg/s]."""
        return float(np.rad2deg(np.abs(np.diff(steps, axis=0)).max() / CYCLE))


def gateway_pid(trace: str) -> int:
    """Return the process that records this trace; the gateway is no ROS node that could be asked. 0 for none."""
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/cmdline", "rb") as file:
                words = file.read().decode(errors="replace").split("\0")
        except OSError:
            continue  # it has ended meanwhile
        if "construction_twin.gateway" in words and trace in words:
            return int(name)
    return 0


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "fault_gateway", FaultGatewayTest, sys.argv)

#!/usr/bin/env python3
"""The path of commands is interrupted in mid-motion: the arm brakes within its limits and holds; `reset` brings the system back."""

import sys

import rostest
from interruption import Interruption


class KillTest(Interruption):
    """One interruption per test, each in the middle of a motion from home."""

    def test_killed_monitor(self):
        self.interrupt_and_recover(lambda: self.kill("pca_monitor"))
        self.assert_said("silence: no command for")

    def test_killed_bridge(self):
        self.interrupt_and_recover(lambda: self.kill("mqtt_bridge"))
        self.assert_said("silence: no command for")

    def test_killed_executor(self):
        self.interrupt_and_recover(lambda: self.kill("executor"))
        # nothing is forwarded any more, and the gate repeats nothing
        self.assert_said("silence: no command for")

    def test_stop_at_the_gateway(self):
        self.halt_and_recover()


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "kill", KillTest, sys.argv)

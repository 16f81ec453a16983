"""Benchmark of the way for other planners: the action FollowJointTrajectory in a whole system with the mock arm.

    python benchmarks/planners.py --output results/bench/planners.json

- `goal_to_review_ms`: from sending a goal until its client hears that the plan waits for a person, by the number of its points; the
  planner has checked every 4 ms of the motion by then. Median.
- `cancel_to_rest_ms`: from a cancel in the middle of a motion of the first joint, at its fastest,
  until the measured arm is at rest. Median.
- `md5_equal`: whether the messages that this system serves have the md5 sums of the official ones.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import actionlib
import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus
from bringup import START, bringup
from construction_twin.msg import Execution, Sync
from link_world import environment, wait_for
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

from construction_twin.extensions.planners.nodes.joint_goals import OFFICIAL_MD5, control_messages
from construction_twin.ros.shared.params import robot_from_parameters

#: Numbers of points of a goal, and how often each is sent.
POINTS, REPEATS = (10, 1000), 9
#: The motion of these goals [rad], in this time [s].
WAY, DURATION = (0.4, 0.1, -0.2, 0.4, -0.2, 0.4), 4.0
#: The motion that is cancelled, of the first joint [rad] [s], after this part of its time, and how often.
CANCELLED, CANCELLED_TIME, PART, CANCELS = 1.0, 1.8, 0.5, 7
#: A measured pose that is this close to where the arm ends is at rest [rad].
REST = 1e-4
#: Longest wait for one step of the benchmark [s].
PATIENCE = 30.0
ROBOT, CLIENT = "kr120", "bench_planners"


class Bench:
    """A client of the action, and what it measures.

    Args:
        name: Of its node; plans of the one that bringup trusts need no person.
    """

    def __init__(self, name: str):
        rospy.init_node(name, disable_signals=True)
        self._messages = control_messages()
        self._sync: Sync | None = None
        self._execution: Execution | None = None
        self._twin: tuple[float, ...] = ()
        self._arm: list[tuple[float, tuple[float, ...]]] = []
        rospy.Subscriber("sync", Sync, lambda message: setattr(self, "_sync", message))
        rospy.Subscriber("execution", Execution, lambda message: setattr(self, "_execution", message))
        rospy.Subscriber("twin/joint_states", JointState, lambda message: setattr(self, "_twin", message.position))
        rospy.Subscriber("physical/joint_states", JointState, self._on_arm, tcp_nodelay=True)
        self._client = actionlib.SimpleActionClient(
            "follow_joint_trajectory", self._messages.FollowJointTrajectoryAction
        )
        wait_for(self._is_ready, START, "twin and arm in sync, the executor idle, and the action")
        self._names = robot_from_parameters().joint_names

    def _is_ready(self) -> bool:
        idle = self._execution is not None and self._execution.state == Execution.IDLE
        in_sync = self._sync is not None and self._sync.state == Sync.IN_SYNC
        return idle and in_sync and bool(self._twin) and self._client.wait_for_server(rospy.Duration(0.01))

    def _on_arm(self, message: JointState) -> None:
        self._arm.append((time.monotonic(), message.position))

    def _goal(self, way: np.ndarray, duration: float, points: int):
        """Return a goal of minimum jerk from the twin's pose, with velocities and accelerations, as MoveIt's have them."""
        s = np.linspace(0.0, 1.0, points)[:, None]
        start = np.array(self._twin)
        rows = (
            start + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
            way * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
            way * (60 * s - 180 * s**2 + 120 * s**3) / duration**2,
        )
        goal = self._messages.FollowJointTrajectoryGoal()
        goal.trajectory.joint_names = list(self._names)
        goal.trajectory.points = [
            JointTrajectoryPoint(q.tolist(), v.tolist(), a.tolist(), [], rospy.Duration(float(at) * duration))
            for q, v, a, at in zip(*rows, s[:, 0])
        ]
        return goal

    def _send(self, goal) -> float:
        """Send a goal; return when its client heard that it is active [s, monotonic]. SystemExit where it was rejected."""
        heard: list[float] = []
        self._client.send_goal(goal, active_cb=lambda: heard.append(time.monotonic()))

        def active() -> bool:
            if self._client.get_state() in (GoalStatus.REJECTED, GoalStatus.ABORTED):
                sys.exit(f"the goal was refused: {self._client.get_goal_status_text()}")
            return bool(heard)

        wait_for(active, PATIENCE, "the plan under review")
        return heard[0]

    def goal_to_review(self, points: int) -> float:
        """Return the time from a goal to its plan under review [ms]; the plan is withdrawn then."""
        goal = self._goal(np.array(WAY), DURATION, points)
        began = time.monotonic()
        taken = (self._send(goal) - began) * 1e3
        self._client.cancel_goal()
        self._client.wait_for_result(rospy.Duration(PATIENCE))
        return taken

    def cancel_to_rest(self, way: float) -> float:
        """Return the time from a cancel in the middle of a motion until the measured arm is at rest [ms]."""
        wait_for(self._is_ready, PATIENCE, "a pose from which to move")
        direction = np.array([way, *[0.0] * (len(self._names) - 1)])
        self._send(self._goal(direction, CANCELLED_TIME, 50))
        wait_for(lambda: self._execution.state == Execution.PLAYING, PATIENCE, "the motion")
        rospy.sleep(PART * CANCELLED_TIME)
        self._arm.clear()
        began = time.monotonic()
        self._client.cancel_goal()
        self._client.wait_for_result(rospy.Duration(PATIENCE))
        if self._client.get_state() != GoalStatus.PREEMPTED:
            sys.exit(f"the motion was not cancelled: {self._client.get_goal_status_text()}")
        wait_for(self._arm_rests, PATIENCE, "the arm at rest")
        end = self._arm[-1][1]
        moving = [at for at, q in self._arm if max(abs(a - b) for a, b in zip(q, end)) > REST]
        return (moving[-1] - began) * 1e3

    def _arm_rests(self) -> bool:
        last = [q for _, q in self._arm[-75:]]
        return len(last) == 75 and all(q == last[0] for q in last)


def review_figures() -> dict:
    """Measure the times to review; return their medians."""
    bench = Bench(CLIENT)
    return {
        str(count): round(statistics.median(bench.goal_to_review(count) for _ in range(REPEATS)), 1) for count in POINTS
    }


def cancel_figure() -> float:
    """Measure the times to rest, there and back; return their median."""
    bench = Bench(f"{CLIENT}_cancels")
    return round(statistics.median(bench.cancel_to_rest(CANCELLED * (-1) ** number) for number in range(CANCELS)), 1)


PARTS: dict[str, Callable[[], object]] = {"goal_to_review_ms": review_figures, "cancel_to_rest_ms": cancel_figure}


def measured(part: str):
    """Return a part's figures, from a process of its own: one is trusted by the system, the other is not."""
    command = [sys.executable, __file__, "--part", part]
    run = subprocess.run(command, env=os.environ | {"ROS_NAMESPACE": ROBOT}, stdout=subprocess.PIPE, text=True)
    if run.returncode:
        sys.exit(f"{part} could not be measured (exit code {run.returncode}); see above")
    return json.loads(run.stdout.splitlines()[-1])


def main() -> None:
    """Measure, print, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, help="JSON file to write")
    parser.add_argument("--part", choices=PARTS, help="only this, of a system that runs already")
    options = parser.parse_args()
    if options.part:
        print(json.dumps(PARTS[options.part]()))
        return
    messages = control_messages()
    figures: dict[str, object] = {"environment": environment()}
    trusted = f"auto_approve_sources:=/{ROBOT}/{CLIENT}_cancels"
    with bringup(trusted):
        for part in PARTS:
            figures[part] = measured(part)
            print(f"{part}: {figures[part]}", flush=True)
    figures["md5_equal"] = all(getattr(messages, name)._md5sum == md5 for name, md5 in OFFICIAL_MD5.items())
    print(f"md5_equal: {figures['md5_equal']}", flush=True)
    if options.output:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()

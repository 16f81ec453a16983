#!/usr/bin/env python3
"""The steps of reaching_task.m with the same messages, for a PC without MATLAB; the tests run it as another PC's planner.

Standard message types only: sensor_msgs/JointState, control_msgs/FollowJointTrajectory, or trajectory_msgs/JointTrajectory and
rosgraph_msgs/Log. SI, but for the goal on the command line. What MATLAB's manipulatorRRT does is left out: the path is the straight
line in joint space.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
import xmlrpc.client
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import actionlib
import numpy as np
import PyKDL
import rosgraph
import rospy
from actionlib_msgs.msg import GoalStatus
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.units import from_wire
from construction_twin.kinematics.chain import to_kdl
from construction_twin.robot.urdf import Joint, chain_joints, parse_urdf

#: How long the twin's PC may take to answer, and how close to the goal is there [s], [rad] or [m].
ANSWER, AT_GOAL = 20.0, 1e-4
TO_DO = "is bringup running, and can its PC reach this one?"


class Failure(Exception):
    """A step failed; the text is the sentence for the user."""


class Recorder:
    """Keeps every JointState of a topic, in the order of `joints`; see Recorder.m."""

    def __init__(self, topic: str, joints: Sequence[str]):
        self._joints = joints
        self._rows: list[tuple[float, list[float]]] = []
        self._news = threading.Condition()
        self._subscriber = rospy.Subscriber(topic, JointState, self._take, queue_size=500, tcp_nodelay=True)

    def wait(self, condition: Callable[[], object], until: float) -> bool:
        """Wait for a condition, asked at every message and twice a second, until a time of the monotonic clock [s]."""
        with self._news:
            while not condition():
                left = until - time.monotonic()
                if left <= 0.0 or rospy.is_shutdown():
                    return False
                self._news.wait(min(0.5, left))
        return True

    def newest(self) -> np.ndarray:
        """Return the newest position, shape (n,); Failure when none comes."""
        if not self.wait(lambda: self._rows, time.monotonic() + ANSWER):
            raise Failure(f"no message on {self._subscriber.resolved_name} within {ANSWER:g} s; {TO_DO}")
        return np.array(self._rows[-1][1])

    def stop(self) -> None:
        """Listen no more."""
        self._subscriber.unregister()

    def table(self) -> np.ndarray:
        """Return stamps [s] and positions, shape (m, 1 + n)."""
        return np.array([(stamp, *position) for stamp, position in self._rows])

    def _take(self, message: JointState) -> None:
        position = [message.position[message.name.index(joint)] for joint in self._joints]
        with self._news:
            self._rows.append((message.header.stamp.to_sec(), position))
            self._news.notify_all()


class Answers:
    """Keeps what the planner says on /rosout after a time; see send_by_topic.m.

    /rosout is latched: the last thing said before, of whatever request, comes too.
    """

    def __init__(self, namespace: str):
        self._planner = f"{namespace}/planner"
        self._said: list[tuple[float, str]] = []
        self._subscriber = rospy.Subscriber("/rosout", Log, self._take, queue_size=500)

    def await_connection(self, until: float) -> None:
        """Wait until the planner's log comes here; Failure at a time of the monotonic clock [s].

        The number of connections tells nothing: a master keeps the names of nodes whose power has failed.
        """
        master = rosgraph.Master(rospy.get_name())
        own = xmlrpc.client.ServerProxy(rospy.get_node_uri())
        while time.monotonic() < until:
            nodes = dict(master.getSystemState()[0]).get(self._subscriber.resolved_name, [])
            if self._planner in nodes:
                address = master.lookupNode(self._planner)
                connections: Any = own.getBusInfo(rospy.get_name())
                if any(row[1] == address and row[4] == self._subscriber.resolved_name for row in connections[2]):
                    return
            time.sleep(0.05)
        raise Failure(f"{self._planner} was not heard on /rosout; {TO_DO}")

    def newest(self, since: float) -> str:
        """Return the newest answer with a stamp after `since` [s, clock of the twin's PC]; empty before the first."""
        return self._said[-1][1] if self._said and self._said[-1][0] > since else ""

    def _take(self, message: Log) -> None:
        if message.name == self._planner and message.msg.startswith(("no plan", "plan ")):
            self._said.append((message.header.stamp.to_sec(), message.msg))


def rest_to_rest(corners: np.ndarray, duration: float, count: int) -> tuple[np.ndarray, ...]:
    """Return times, positions, velocities and accelerations along straight lines, at rest at every corner; see rest_to_rest.m.

    Args:
        corners: Shape (m, n). [rad] or [m]
        duration: [s]
        count: Number of waypoints.
    """
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    steps, lengths = steps[lengths > 0.0], lengths[lengths > 0.0]
    if not len(lengths):
        raise Failure("the goal is where the arm is; a motion needs another pose")
    starts = corners[0] + np.vstack((np.zeros(corners.shape[1]), np.cumsum(steps, axis=0)))
    ends = np.concatenate(([0.0], np.cumsum(lengths))) / lengths.sum() * duration
    t = np.round(np.linspace(0.0, duration, count), 9)
    line = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(lengths) - 1)
    T = np.diff(ends)[line]
    s = np.clip((t - ends[line]) / T, 0.0, 1.0)
    q = starts[line] + (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * steps[line]
    qd = ((30 * s**2 - 60 * s**3 + 30 * s**4) / T)[:, None] * steps[line]
    qdd = ((60 * s - 180 * s**2 + 120 * s**3) / T**2)[:, None] * steps[line]
    for rates in (qd, qdd):
        rates[[0, -1]] = 0.0
    return t, q, qd, qdd


def trajectory_of(joints: Sequence[str], motion: Sequence[np.ndarray]) -> JointTrajectory:
    """Return the message of a motion, stamped by this PC's clock as planners do; the stamp is ignored."""
    message = JointTrajectory(joint_names=list(joints))
    message.header.stamp = rospy.Time.now()
    for t, q, qd, qdd in zip(*motion):
        point = JointTrajectoryPoint(positions=q.tolist(), velocities=qd.tolist(), accelerations=qdd.tolist())
        point.time_from_start = rospy.Duration.from_sec(float(t))
        message.points.append(point)
    return message


def send_by_topic(
    namespace: str, answers: Answers, virtual: Recorder, message: JointTrajectory, patience: float
) -> None:
    """Send a motion on `joint_trajectory` and wait until the twin is at its goal; Failure with the planner's sentence."""
    publisher = rospy.Publisher(f"{namespace}/joint_trajectory", JointTrajectory, queue_size=1)
    until = time.monotonic() + ANSWER
    if not virtual.wait(publisher.get_num_connections, until):
        raise Failure(f"{namespace}/planner does not listen; {TO_DO}")
    answers.await_connection(until)
    since = virtual.table()[-1, 0]
    publisher.publish(message)
    goal = np.array(message.points[-1].positions)

    def over() -> bool:
        return answers.newest(since).startswith("no plan") or bool(np.max(np.abs(virtual.newest() - goal)) < AT_GOAL)

    if not virtual.wait(over, time.monotonic() + patience):
        said = answers.newest(since) or "nothing"
        raise Failure(f"the twin is not at the goal within {patience:g} s; the planner said: {said}")
    if answers.newest(since).startswith("no plan"):
        raise Failure(answers.newest(since))
    print(answers.newest(since), flush=True)


def send_by_action(namespace: str, message: JointTrajectory, patience: float) -> None:
    """Send a motion as a goal of `follow_joint_trajectory` and wait for its result; see send_by_action.m."""
    action = f"{namespace}/follow_joint_trajectory"
    client = actionlib.SimpleActionClient(action, FollowJointTrajectoryAction)
    if not client.wait_for_server(rospy.Duration.from_sec(ANSWER)):
        raise Failure(f"{action} does not answer; {TO_DO}")
    client.send_goal(FollowJointTrajectoryGoal(trajectory=message))
    if not client.wait_for_result(rospy.Duration.from_sec(patience)):
        client.cancel_goal()
        raise Failure(f"no result within {patience:g} s; cancelled")
    result = client.get_result()
    print(result.error_string, flush=True)
    if client.get_state() != GoalStatus.SUCCEEDED:
        raise Failure(f"{result.error_string} (error code {result.error_code})")


def draw_figure8(chain: Sequence[Joint], q: np.ndarray, file: Path) -> None:
    """Draw the tool's planned path (the paper's Figure 8)."""
    solver = PyKDL.ChainFkSolverPos_recursive(to_kdl(chain))
    path = []
    for row in q:
        positions, frame = PyKDL.JntArray(len(row)), PyKDL.Frame()
        for number, value in enumerate(row):
            positions[number] = float(value)
        solver.JntToCart(positions, frame)
        path.append([frame.p.x(), frame.p.y(), frame.p.z()])
    figure = Figure()
    axes = figure.add_subplot(projection="3d")
    axes.plot(*np.array(path).T, color="#ff3fa4")
    axes.set(title="The planned reaching task", xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    FigureCanvasAgg(figure).print_png(str(file))


def draw_figure9(joints: Sequence[str], virtual: np.ndarray, physical: np.ndarray, file: Path) -> None:
    """Draw the joints of both arms over time (the paper's Figure 9)."""
    figure = Figure(figsize=(9.0, 5.4))
    axes = figure.add_subplot()
    for number, joint in enumerate(joints, start=1):
        for table, style, name in ((virtual, "-", "virtual"), (physical, "--", "physical")):
            axes.plot(
                table[:, 0] - virtual[0, 0], table[:, number], style, color=f"C{number - 1}", label=f"{joint} {name}"
            )
    axes.set(title="Joint angles of the virtual and the physical arm", xlabel="time [s]", ylabel="joint angle [rad]")
    axes.legend(ncols=2, fontsize=7)
    FigureCanvasAgg(figure).print_png(str(file))


def run(options: argparse.Namespace) -> None:
    """Do the task; Failure with a sentence."""
    namespace = "/" + options.namespace.strip("/")
    # as twin.connect calls MATLAB's node
    rospy.init_node("matlab", disable_signals=True)
    model = parse_urdf(rospy.get_param(f"{namespace}/robot_description"))
    chain = chain_joints(model, model.get_root(), options.tip)
    moving = [joint for joint in chain if joint.type != "fixed"]
    joints = [joint.name for joint in moving]
    if len(options.goal) != len(joints):
        raise Failure(f"the goal has {len(options.goal)} values; expected {len(joints)}, for {', '.join(joints)}")
    goal = np.array(from_wire(options.goal, [joint.type == "prismatic" for joint in moving]))
    virtual = Recorder(f"{namespace}/twin/joint_states", joints)
    physical = Recorder(f"{namespace}/physical/joint_states", joints)
    answers = Answers(namespace) if options.by == "topic" else None
    start = virtual.newest()
    physical.newest()
    motion = rest_to_rest(np.array([start, goal]), options.duration, options.count)
    options.output.mkdir(parents=True, exist_ok=True)
    draw_figure8(chain, motion[1], options.output / "figure8.png")
    np.savetxt(options.output / "motion.csv", np.column_stack(motion), fmt="%.17g", delimiter=",")
    clock = f"{time.time():.3f} by this PC's clock"
    print(f"sending {options.count} waypoints at {clock}; nothing moves before a person approves", flush=True)
    message = trajectory_of(joints, motion)
    if answers is None:
        send_by_action(namespace, message, options.patience)
    else:
        send_by_topic(namespace, answers, virtual, message, options.patience)
    # the arm is a few hundredths of a second behind the twin
    arrived = physical.wait(lambda: np.max(np.abs(physical.newest() - goal)) < AT_GOAL, time.monotonic() + ANSWER)
    virtual.stop()
    physical.stop()
    for name, recorder in (("virtual", virtual), ("physical", physical)):
        np.savetxt(options.output / f"{name}.csv", recorder.table(), fmt="%.17g", delimiter=",")
    draw_figure9(joints, virtual.table(), physical.table(), options.output / "figure9.png")
    print(f"{len(virtual.table())} samples of the twin, {len(physical.table())} of the arm in {options.output}")
    if not arrived:
        raise Failure("the twin is at the goal, the arm is not; see rosrun construction_twin twin status")


def main() -> int:
    """Run the task; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--namespace", default="/kr120", help="of the robot [/kr120]")
    parser.add_argument("--by", choices=("action", "topic"), default="action", help="how the motion is sent [action]")
    parser.add_argument(
        "--goal", type=float, nargs="+", default=[55.0, -50.0, 75.0, 40.0, 60.0, -70.0], help="joint values [deg, mm]"
    )
    parser.add_argument("--tip", default="tool0", help="the arm's last link [tool0]")
    parser.add_argument("--duration", type=float, default=75.2, help="of the motion [s]")
    parser.add_argument("--count", type=int, default=1500, help="number of waypoints")
    parser.add_argument("--patience", type=float, default=600.0, help="longest wait for approval and motion [s]")
    parser.add_argument("--output", type=Path, default=Path("reaching_task"), help="folder for recordings and figures")
    try:
        run(parser.parse_args(rospy.myargv()[1:]))
    except Failure as error:
        print(f"reaching_task: {error}", file=sys.stderr, flush=True)
        return 1
    finally:
        rospy.signal_shutdown("done")
    return 0


if __name__ == "__main__":
    sys.exit(main())

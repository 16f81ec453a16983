"""mock_rsi: the mock KR C4 as a node. Talks to the gateway by RSI only; its topics and services are for tests."""

from __future__ import annotations

import gc
import json
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from queue import SimpleQueue

import rospy
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse

from construction_twin.errors import ConfigurationError, ConstructionTwinError
from construction_twin.ros.diagnostics import ERROR, OK, NodeDiagnostics
from construction_twin.ros.joint_stream import JointPublisher, now_ns
from construction_twin.ros.node import run_node
from construction_twin.ros.params import read_parameters, robot_from_parameters
from construction_twin.rsi.mock import MockRsi, MockSettings, build_controller, gateway_address, joint_angles
from construction_twin.srv import StallJoint, StallJointRequest, StallJointResponse
from construction_twin.units import degrees

#: Cycles between two reports on `~status`, 0.5 s.
_STATUS_CYCLES = 125


class MockRsiNode:
    """ROS around a MockRsi. The 4 ms loop runs in the main thread and hands what is to be published to another one."""

    def __init__(self):
        self._settings = read_parameters(MockSettings)
        self._robot = robot_from_parameters()
        self._controller = build_controller(self._settings, self._robot)
        gateway = gateway_address(self._settings)
        self._mock = MockRsi(self._controller, gateway, self._settings.restart_after, self._observe, rospy.loginfo)
        self._outbox: SimpleQueue[tuple[int, tuple[float, ...], dict | None] | None] = SimpleQueue()
        self._cycle = 0
        self._reported: tuple[int, bool] | None = None
        self._joints = JointPublisher("~joint_states", self._robot.joint_names)
        self._status = rospy.Publisher("~status", String, queue_size=5, latch=True)
        self._diagnostics = NodeDiagnostics(self._robot.name, self._report)
        rospy.Service("~restart", Trigger, self._on_restart)
        rospy.Service("~stall", StallJoint, self._on_stall)

    def run(self) -> None:
        """Run the controller until shutdown."""
        stop = threading.Event()
        rospy.on_shutdown(stop.set)
        # a full collection over every imported module takes longer than a cycle, and a thread keeps the interpreter for 5 ms
        gc.freeze()
        sys.setswitchinterval(0.0005)
        publisher = threading.Thread(target=self._publish, name="publisher", daemon=True)
        publisher.start()
        try:
            self._mock.run(stop)
        finally:
            self._outbox.put(None)
            publisher.join(1.0)

    # -- in the loop

    def _observe(self, mock: MockRsi) -> None:
        state = self._controller.session, self._controller.running
        due = self._cycle % _STATUS_CYCLES == 0 or state != self._reported
        self._cycle += 1
        self._reported = state
        self._outbox.put((now_ns(), self._controller.measured, self._snapshot() if due else None))

    def _snapshot(self) -> dict:
        controller = self._controller
        return {
            "state": "running" if controller.running else "stopped",
            "reason": controller.reason,
            "flag": controller.flag,
            "session": controller.session,
            "ipoc": controller.ipoc,
            "delay": controller.delay,
            "stat": controller.stat,
            "start_pose_deg": degrees(controller.start_pose),
            "applied_deg": degrees(controller.applied),
            "correction_lower_deg": degrees(controller.correction_lower),
            "correction_upper_deg": degrees(controller.correction_upper),
            "correction_monitor_deg": degrees(controller.correction_monitor),
            "stalled": [self._robot.joint_names[index] for index in sorted(controller.servo.stalled)],
            "counters": self._mock.counters,
            "config": self._settings.model_dump(exclude={"ethernet_xml"}),
            "ethernet": asdict(controller.config.layout),
        }

    # -- in other threads

    def _publish(self) -> None:
        for stamp, angles, status in iter(self._outbox.get, None):
            self._joints.publish(stamp, joint_angles(self._robot, angles))
            if status is not None:
                self._status.publish(json.dumps(status))

    def _report(self) -> tuple[int, str, dict]:
        controller = self._controller
        if controller.running:
            return OK, f"RSI session {controller.session} running", self._mock.counters
        return ERROR, f"RSI stopped: {controller.reason}", self._mock.counters

    def _on_restart(self, _request) -> TriggerResponse:
        return TriggerResponse(*self._ask(self._controller.restart, "a new RSI session starts where the arm stands"))

    def _on_stall(self, request: StallJointRequest) -> StallJointResponse:
        def stall() -> None:
            if request.joint not in self._robot.joint_names:
                raise ConfigurationError("joint", request.joint, f"one of {', '.join(self._robot.joint_names)}")
            axis = self._robot.axes[self._robot.joint_names.index(request.joint)].rsi
            self._controller.stall(axis, request.stalled)

        return StallJointResponse(
            *self._ask(stall, f"{request.joint} is {'stalled' if request.stalled else 'released'}")
        )

    def _ask(self, action: Callable[[], None], done: str) -> tuple[bool, str]:
        try:
            self._mock.request(action)
        except ConstructionTwinError as error:
            return False, str(error)
        except TimeoutError:
            return False, "the controller's loop did not answer within 1 s"
        rospy.loginfo(done)
        return True, done


def main() -> None:
    """Run the node."""
    run_node("mock_rsi", MockRsiNode)

"""mock_rsi: the mock controller as a node. Talks to the gateway only, as its make does; its topics and services are for tests."""

from __future__ import annotations

import gc
import json
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from queue import SimpleQueue

import rospy
from std_msgs.msg import String

from construction_twin.core.errors import ConfigurationError, RequestRefused
from construction_twin.core.units import to_wire
from construction_twin.mock.faults import KINDS, Fault
from construction_twin.mock.network import MockRsi
from construction_twin.mock.program import MockSettings, build_controller, gateway_address
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, Diagnosis
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.srv import InjectFault, InjectFaultRequest

#: Between two reports on `~status` [s].
_STATUS_PERIOD = 0.5


class MockRsiNode:
    """ROS around a MockRsi. Its loop runs in the main thread and hands what is to be published to another one."""

    def __init__(self, settings: MockSettings, robot: RobotModel, node_io: shell.NodeIO):
        self._settings, self._robot = settings, robot
        self._controller, after = build_controller(settings, robot), settings.restart_after
        callbacks = self._observe, rospy.loginfo
        self._mock = MockRsi(self._controller, gateway_address(settings), after, *callbacks, settings.fault_seed)
        #: For the publishing thread: ROS time [ns], the true axis angles [rad], [m], and the status where it is due.
        self._outbox: SimpleQueue[tuple[int, tuple[float, ...], dict | None] | None] = SimpleQueue()
        self._cycle = 0
        self._status_cycles = round(_STATUS_PERIOD / self._controller.config.period)
        self._reported: tuple[int, bool, int, bool, bool] | None = None
        self._missed = 0
        self._joints, self._status = node_io.publishers["~joint_states"], node_io.publishers["~status"]

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
        missed = self._controller.counters["missed"]
        # the first and the last of replies missed in a row, too
        controller = self._controller
        refuses = bool(controller.refusals.present)
        state = controller.session, controller.running, self._mock.faults.changes, missed != self._missed, refuses
        self._missed = missed
        due = self._cycle % self._status_cycles == 0 or state != self._reported
        self._cycle += 1
        self._reported = state
        if not due and not self._joints.has_subscribers:
            return
        # a node that reacts to the packet may be quicker than this thread
        stamp = now_ns() - (time.monotonic_ns() - mock.sent_at)
        self._outbox.put((stamp, self._controller.true_position, self._snapshot(stamp) if due else None))

    def _snapshot(self, stamp: int) -> dict:
        controller, linear = self._controller, self._robot.linear
        return {
            "state": "running" if controller.running else "stopped",
            "reason": controller.reason,
            "last_refusal": controller.refusals.last,
            "flag": controller.flag,
            "session": controller.session,
            "ipoc": controller.stamp,
            "delay": controller.missed,
            "controller": controller.status.status_fields(),
            "start_pose_deg": to_wire(controller.start_pose, linear),
            "applied_deg": to_wire(controller.applied, linear),
            "correction_lower_deg": to_wire(controller.correction_lower, linear),
            "correction_upper_deg": to_wire(controller.correction_upper, linear),
            "stamp": stamp,
            "faults": self._mock.faults.active,
            "tool": self._tool(),
            "stop_ramp": self._ramp(),
            "counters": self._mock.counters,
            "config": self._settings.model_dump(exclude={"ethernet_xml"}),
            "ethernet": asdict(controller.config.layout),
        }

    def _ramp(self) -> dict | None:
        """Return the last emergency stop's distance and time to rest; None before one, and in the next session."""
        ramp = self._controller.ramp
        if ramp is None:
            return None
        period = self._controller.config.period
        return {"time": ramp.cycles * period, "distance_deg": to_wire(ramp.distance, self._robot.linear)}

    def _tool(self) -> dict | None:
        tool = self._controller.tool
        return None if tool is None else {"outputs": dict(tool.outputs), "inputs": dict(tool.inputs)}

    # -- in other threads

    def _publish(self) -> None:
        for stamp, angles, status in iter(self._outbox.get, None):
            self._joints.publish(stamp, self._robot.from_axes(angles))
            if status is not None:
                self._status.publish(json.dumps(status))

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        controller = self._controller
        protocol = controller.terms.protocol
        values = self._mock.counters | {"last_refusal": controller.refusals.last}
        if not controller.running:
            return Diagnosis(ERROR, f"{protocol} stopped: {controller.reason}", values)
        running, refused = f"{protocol} session {controller.session} running", controller.refusals.present
        if refused:
            return Diagnosis(WARN, f"{running}, replies are refused: {refused}", values)
        return Diagnosis(OK, running, values)

    def on_inject(self, request: InjectFaultRequest) -> Outcome:
        """Switch a fault on or off."""
        faults = self._mock.faults

        def inject() -> str:
            fault = self._fault(request)
            return faults.inject(fault) if request.on else faults.end(fault)

        return Outcome(True, self._ask(inject), fields=self.active_faults(request))

    def active_faults(self, _request: InjectFaultRequest) -> dict[str, object]:
        """Return the field of every answer about faults: the active ones."""
        return {"active": self._mock.faults.active}

    def _fault(self, request: InjectFaultRequest) -> Fault:
        names, axes = self._robot.joint_names, self._robot.axes
        if request.joint and request.joint not in names:
            raise ConfigurationError(request.fault, request.joint, f"one of {', '.join(names)}")
        axis = axes[names.index(request.joint)] if request.joint else None
        kind, values = KINDS.get(request.fault), tuple(request.value)
        if kind is not None and kind.shift and axis is not None:
            values = tuple(axis.sign * value for value in values)
        elif kind is not None and not kind.lasting and len(values) == len(axes):
            values = self._robot.to_axes(values)
        return Fault(request.fault, axis.name if axis else "", values, request.direction, request.duration)

    def _ask(self, action: Callable[[], str]) -> str:
        """Run an act in the loop and return its sentence; RequestRefused after a time-out."""
        try:
            done = self._mock.request(action)
        except TimeoutError as error:
            raise RequestRefused("the controller's loop did not answer within 1 s") from error
        rospy.loginfo(done)
        return done


INTERFACE = shell.Interface(
    diagnose=MockRsiNode.diagnose,
    publishes=(shell.PosePublication("~joint_states"), shell.Publication("~status", String, queue_size=5, latch=True)),
    serves=(shell.Served("~inject", InjectFault, MockRsiNode.on_inject, refused=MockRsiNode.active_faults),),
)


def check(settings: MockSettings, robot: RobotModel, *_: object) -> None:
    """Check that there can be such a controller; see `NodeShell`."""
    build_controller(settings, robot)


NODE = shell.NodeShell("mock_rsi", MockSettings, MockRsiNode, INTERFACE, check)
main = NODE.run

"""The whole chain in one process on a simulated clock: exact, reproducible, as fast as the processor allows.

Executor, gate, twin, bridge, gateway and mock controller are the same objects that the nodes run; only sockets and clocks are
replaced, by a queue of events in integer nanoseconds. This is where exact figures are asserted (docs/architecture.md, law 6).
`scenario_run.py` carries out the scenarios of config/scenarios on it.
"""

from __future__ import annotations

import heapq
import itertools
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.evaluation.recording import FeedbackStream, PlayedPlan, Recording, Stream
from construction_twin.execution.approval import Approval
from construction_twin.execution.executor import Executor, ExecutorState
from construction_twin.execution.segment_run import ToolOrder
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.gateway import Gateway
from construction_twin.link.bridge import StateCheck
from construction_twin.link.gateway_status import GatewayAnswer, GatewayStatus, read
from construction_twin.link.observations import LinkState
from construction_twin.link.supervisor import LinkSupervisor
from construction_twin.link.tool_link import ToolLink
from construction_twin.mock.controller import MockController
from construction_twin.mock.faults import FaultBoard, ImpairedLine
from construction_twin.monitor.gate import Gate
from construction_twin.monitor.settings import REPLAN, GateSettings
from construction_twin.monitor.states import SyncEvent, SyncState, Transition
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, StateProperties
from construction_twin.review.plan_under_review import Verdict
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.servo.model import ServoModel
from construction_twin.twin.virtual_robot import KinematicBackend, TwinBackend, VirtualRobot

#: Simulated time begins here [ns]: stamps as large as real ones, so that rounding is as real.
EPOCH = 1_790_000_000 * NANOSECONDS
#: The supervisor is asked this often [ns], as in the bridge.
POLL = 20_000_000
#: The bridge's `max_state_age` [s].
MAX_STATE_AGE = 0.1


@dataclass(frozen=True)
class SimulatedLink:
    """Delays of the simulated network and the controller's phase.

    Attributes:
        command_delay, state_delay: Return the travel time of the next message [ns]. A command does not overtake another: MQTT runs
            over TCP.
        phase: Offset of the controller's clock against the executor's grid [ns].
        drift_ppm: By how much the executor's clock is faster than the controller's.
    """

    command_delay: Callable[[], int] = lambda: 300_000
    state_delay: Callable[[], int] = lambda: 300_000
    phase: int = 1_700_000
    drift_ppm: float = 0.0


class SimulatedChain:
    """One robot, its twin and everything between them.

    Args:
        planner: Makes a plan from a pose to another [rad]: asked when the gate closes during a plan and the policy is to re-plan.
        backend: What simulates the twin.
        servos: What the gate knows of the arm's servos; None: nothing.
        restart_after: A controller that has stopped starts a new RSI session after this time [s]; 0: it stays stopped.

    Attributes:
        requests: What is done between two cycles of the controller, as `MockRsi.request` has it done.
        observe: Called in every cycle of the controller, when its packet leaves.
    """

    def __init__(
        self,
        robot: RobotModel,
        config: GatewayConfig,
        controller: MockController,
        gate: GateSettings = GateSettings(),
        link: SimulatedLink = SimulatedLink(),
        planner: Callable[[tuple[float, ...], tuple[float, ...]], Plan] | None = None,
        restart_after: float = 0.0,
        backend: TwinBackend = KinematicBackend(),
        servos: ServoModel | None = None,
    ):
        self.robot = robot
        self.now = EPOCH
        self.controller = controller
        #: The arm's faults, and those of the datagrams between it and the gateway.
        self.faults = FaultBoard(controller, 0)
        self.requests: list[Callable[[], object]] = []
        self.observe: Callable[[], None] = lambda: None
        self.gateway = Gateway(config, "simulation")
        self.executor = Executor(robot)
        #: How long the arm trails the setpoints, as the executor knows it [s]; nan: unknown.
        self.trails = np.nan
        self.verdicts: list[Verdict] = []
        self.codec = JointStringCodec.of(robot, config.decimals)
        self.gate = Gate(MotionLimits.of(robot), self.codec, gate, EPOCH, servos)
        #: Changes of the gate's state, oldest first.
        self.transitions: list[Transition] = []
        self.planner = planner
        self.twin = VirtualRobot(None, robot.linear)
        self.backend = backend
        ids = map(str, itertools.count(1))
        self.supervisor = LinkSupervisor(config, lambda: next(ids))
        #: What the gateway answered [rad]: (IPOC, correction).
        self.corrections: list[tuple[int, tuple[float, ...]]] = []
        self.twin_poses: list[tuple[int, tuple[float, ...]]] = []
        self.feedback: list[tuple[int, tuple[float, ...], int, int]] = []
        #: What the gate let through.
        self.commands: list[tuple[int, tuple[float, ...]]] = []
        #: Where the gate expected the servos to have the arm [rad].
        self.expected: list[tuple[int, tuple[float, ...]]] = []
        #: Where the arm really was at the beginning of each of the controller's cycles [rad].
        self.measured: list[tuple[int, tuple[float, ...]]] = []
        self.commands_sent = 0
        self.state_check = StateCheck(MAX_STATE_AGE)
        self.states_refused: Counter[str] = Counter()
        self._link = link
        self._reader, self._encoder = config.make.reader(config), config.make.encoder(config)
        self._tool_link = ToolLink(lambda: next(ids))
        #: What each answered telegram told the tool's outputs: (stamp of the target [ns], values).
        self.switched: list[tuple[int, tuple[bool, ...]]] = []
        self._played = 0
        if config.tool is not None:
            self.gateway.trace = lambda ipoc, session, state, stamp, position, lost: setattr(self, "_played", stamp)
        self._session = ""
        self._restart_after = round(restart_after * NANOSECONDS)
        self._stopped_at: int | None = None
        # when the controller's open cycle ends
        self._ends = 0
        self._command_arrival = 0
        self._first_cycle = EPOCH + CYCLE_NS + link.phase
        self._controller_cycles = 0
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self.supervisor.inputs.on_connection(True)
        self._at(EPOCH + CYCLE_NS, self._execute)
        self._at(self._first_cycle, self._control)
        self._at(EPOCH, self._supervise)

    def run_until(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Let simulated time pass until `condition` holds; return False when it did not within `timeout` [s]."""
        deadline = self.now + round(timeout * NANOSECONDS)
        while not condition():
            if self.now > deadline:
                return False
            self.now, _, action = heapq.heappop(self._events)
            action()
        return True

    def run_for(self, duration: float) -> None:
        """Let `duration` [s] of simulated time pass."""
        end = self.now + round(duration * NANOSECONDS)
        self.run_until(lambda: self.now >= end, duration + 1.0)

    def repeat(self, period: int, action: Callable[[], None]) -> None:
        """Call `action` every `period` [ns] from now on."""

        def again() -> None:
            self._at(self.now + period, again)
            action()

        self._at(self.now + period, again)

    @property
    def ready(self) -> bool:
        """True when commands flow and the executor waits for a plan."""
        return self.supervisor.state is LinkState.ARMED and self.executor.state is ExecutorState.IDLE

    def play(self, plan: Plan) -> None:
        """Put a plan under review and approve it, in the scene it was made for."""
        self.executor.on_scene(plan.scene)
        self.executor.offer(plan)
        approval = Approval(self.executor, self.verdicts.append, nullcontext(), lambda: Moment("c0ffee00", self.now))
        approval.review(plan.id, plan.hash, True, "simulation")

    def recording(self) -> Recording:
        """Return what a bag of this run would hold."""
        stamps, poses = map(np.array, zip(*self.twin_poses))
        received, measured, seq, command_stamps = map(np.array, zip(*self.feedback))
        plan, names = self.executor.plan, self.robot.joint_names
        played = (
            ()
            if plan is None
            else (PlayedPlan(plan.id, self.executor.plan_start, plan.trajectory.duration, self.executor.outcome),)
        )
        return Recording(
            robot=f"/{self.robot.name}",
            joint_names=names,
            twin=Stream(stamps, poses, stamps),
            physical=Stream(received, measured, received),
            feedback=FeedbackStream(received, measured, received, seq, command_stamps),
            plans=played,
            command=_stream(self.commands),
            expected=_stream(self.expected),
        )

    # -- events

    def _at(self, time: int, action: Callable[[], None]) -> None:
        heapq.heappush(self._events, (time, next(self._order), action))

    def _execute(self) -> None:
        """One cycle of executor, gate, twin and the bridge's sending half."""
        stamp = self.now
        self._at(stamp + CYCLE_NS, self._execute)
        gate = self.gate
        self.executor.on_sync(gate.state, gate.is_agreed(stamp), gate.policy, gate.held_stamp)
        last = gate.comparison.last
        if last is not None:
            self.executor.limit.on_lag(last.round_trip, last.servo_lag)
            self.trails = last.round_trip + np.nan_to_num(last.servo_lag)
        # a disk that takes everything at once
        self.executor.engagement.written = self.executor.engagement.present
        theta_next = self.executor.step(stamp, stamp)
        for order in self.executor.pop_orders():
            self._at(stamp + self._link.command_delay(), lambda order=order: self._switch(order))
        command = None if theta_next is None else gate.pass_next(stamp, theta_next, stamp)
        self._note_transitions()
        if command is not None:
            self.commands.append((stamp, command))
        if command is not None and self.twin.execute(stamp, command):
            self._send(stamp, command)
        if self.twin.pose is not None:
            simulated = self.backend.cycle(self.twin.pose)
            self.twin_poses.append((stamp, simulated))
            self.executor.on_twin(stamp, self.twin.pose, stamp)
            self.gate.on_twin(stamp, simulated)

    def _note_transitions(self) -> None:
        """What the monitor does about each change: note it, and ask for a new plan, which then waits for review."""
        for change in self.gate.pop_transitions():
            self.transitions.append(change)
            asked = change.source is SyncState.IN_SYNC and self.executor.state is ExecutorState.PLAYING
            if asked and self.gate.policy == REPLAN and self.planner is not None:
                goal = tuple(self.executor.plan.trajectory.positions[-1].tolist())
                if self.gate.fire(SyncEvent.REPLAN_ASKED, "the planner was asked", self.now):
                    self.executor.offer(self.planner(self.gate.held, goal))
                    self.transitions += self.gate.pop_transitions()

    def _send(self, stamp: int, command: tuple[float, ...]) -> None:
        if not self.supervisor.on_command(command, stamp):
            return
        self.commands_sent += 1
        payload = self.codec.encode(command)
        properties = CommandProperties(self.supervisor.session, self.commands_sent, stamp)
        arrival = max(stamp + self._link.command_delay(), self._command_arrival)
        self._command_arrival = arrival
        self._at(arrival, lambda: self.gateway.on_command(payload, properties, arrival))

    def _control(self) -> None:
        """One cycle of the controller."""
        self._controller_cycles += 1
        elapsed = round(self._controller_cycles * self.gateway.config.cycle_ns * (1.0 + self._link.drift_ppm * 1e-6))
        self._ends = self._first_cycle + elapsed
        self._at(self._ends, self._control)
        for action in self.requests:
            action()
        self.requests.clear()
        self._follow_session()
        self.faults.tick()
        packet = self.controller.begin_cycle()
        self.measured.append((self.now, self.controller.measured))
        self.observe()
        self.gateway.poll(self.now)
        if packet is not None:
            self._carry(self.faults.to_pc, packet, self._answer)

    def _follow_session(self) -> None:
        """Restart a controller that has stopped, when that is due, as `MockRsi` does."""
        controller = self.controller
        if controller.running:
            self._stopped_at = None
            return
        if self._stopped_at is None:
            self._stopped_at = self.now
        due = self._restart_after and self.now - self._stopped_at >= self._restart_after
        if due and not controller.needs_person:
            controller.restart()

    def _carry(self, line: ImpairedLine, data: bytes, deliver: Callable[[bytes], None]) -> None:
        """Carry a datagram: at once, or as the line's faults have it."""
        if not line.active:
            deliver(data)
            return
        line.send(data, self.now)

        def arrive() -> None:
            for underway in line.pop_arrived(self.now):
                deliver(underway.data)
            coming = line.next_arrival()
            if coming is not None:
                self._at(coming, arrive)

        arrive()

    def _answer(self, packet: bytes) -> None:
        """What the gateway makes of a packet, and its answer."""
        telegram = self._reader.parse(packet)
        self.gateway.controller.datagram = packet
        tool = self.gateway.tool
        if tool is not None and self._reader.tool is not None:
            tool.on_reading(self._reader.tool(packet))
        correction = self.gateway.on_telegram(telegram, "controller", self.now)
        if correction is not None:
            self.corrections.append((telegram.controller_ms, correction))
            stop, switched = True if self.gateway.ends_program else None, ()
            if tool is not None:
                switched = tool.channels(self.gateway.ends_program)
                self.switched.append((self._played, switched))
            reply = self._encoder.encode(correction, telegram.controller_ms, stop, switched)
            self._carry(self.faults.to_controller, reply, self._take_reply)
        if tool is not None and self.gateway.pop_change():
            status = self.gateway.status()
            self._at(self.now + self._link.state_delay(), lambda: self._hear_tool(status))
        message = self.gateway.state_message(self.now)
        if message is not None:
            self._at(self.now + self._link.state_delay(), lambda: self._receive(*message))

    def _take_reply(self, reply: bytes) -> None:
        self.controller.receive(reply, self.now <= self._ends)

    def _switch(self, order: ToolOrder) -> None:
        """What the bridge makes of an order, and the gateway's answer."""
        session = self.supervisor.session
        if order.switch is None:
            self.gateway.on_control(self._tool_link.void(session), self.now)
            return
        armed = "" if self.supervisor.state is LinkState.ARMED else self.supervisor.reason
        switch = order.switch
        control = self._tool_link.switch(order.id, switch.output, switch.value, order.stamp, session, armed)
        if control is not None:
            answer = self.gateway.on_control(control, self.now)
            told = GatewayAnswer(id=control.id, verb=control.verb, ok=answer.ok, reason=answer.reason)
            self._tool_link.on_answer(told)
        self._tell_tool()

    def _hear_tool(self, status: dict) -> None:
        self._tool_link.on_status(read(GatewayStatus, status))
        self._tell_tool()

    def _tell_tool(self) -> None:
        self.executor.on_tool(self._tool_link.state_report(""), self.now)

    def _receive(self, payload: bytes, properties: StateProperties) -> None:
        try:
            self.state_check.accept(properties.seq, properties.stamp, self.now)
        except PayloadError as error:
            self.states_refused[error.reason] += 1
            return
        q = self.codec.decode(payload)
        if not self.twin.follow(self.now, q):
            self.twin.assume_pose(q)
        self.supervisor.inputs.on_pose(q, self.now)
        self.gate.on_physical(q, properties.command_stamp, self.now, seq=properties.seq)
        watch = self.gate.servo_watch
        if watch is not None and watch.expected:
            self.expected.append((self.now, watch.expected))
        self._note_transitions()
        self.feedback.append((self.now, q, properties.seq, properties.command_stamp))

    def _supervise(self) -> None:
        self._at(self.now + POLL, self._supervise)
        self.gate.watch(self.now)
        self._note_transitions()
        self.supervisor.inputs.on_status(read(GatewayStatus, self.gateway.status()), self.now)
        control = self.supervisor.poll(self.now)
        if control is not None:
            answer = self.gateway.on_control(control, self.now)
            told = GatewayAnswer(id=control.id, ok=answer.ok, reason=answer.reason)
            self.supervisor.on_answer(told, self.now)
        if self.supervisor.session != self._session:
            if self._session:
                self.executor.restart("new command session", self.now)
                self.gate.restart("new command session", self.now)
                self._note_transitions()
                if self.supervisor.state is not LinkState.MIRROR:
                    self.twin.restart()
                    self.backend.restart()
            self._session = self.supervisor.session
        mirrors = self.supervisor.state is LinkState.MIRROR
        self.gate.set_mirrored(mirrors, self.now)
        if mirrors:
            self.twin.begin_mirror(MotionLimits.of(self.robot))
        else:
            self.twin.end_mirror()
        self.executor.on_link(self.supervisor.state is LinkState.ARMED, self.supervisor.reason)


def _stream(samples: list[tuple[int, tuple[float, ...]]]) -> Stream | None:
    if not samples:
        return None
    stamps, poses = map(np.array, zip(*samples))
    return Stream(stamps, poses, stamps)

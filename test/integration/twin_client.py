"""One robot as its users see it: topics, services and `/diagnostics`, with waits on conditions. For the integration tests.

A test runs in the robot's namespace (`ns` of its <test> tag). Angles in rad unless a name says otherwise; times in s.
"""

from __future__ import annotations

import json
import time
import unittest
import xmlrpc.client
from collections.abc import Callable, Sequence
from contextlib import contextmanager

import numpy as np
import rosgraph
import rospy
from construction_twin.msg import Execution, Link, Plan, Rehearsal, Sync
from construction_twin.srv import InjectFault, PlanToJoints, PlanToJointsResponse, ReviewPlan, ReviewPlanResponse
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse

from construction_twin.core.units import CYCLE, format_allowance, from_wire
from construction_twin.gateway.trace import read_trace
from construction_twin.review.rehearsal_report import RehearsalReport
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.nodes.rsi_gateway import config_of_link
from construction_twin.ros.shared.params import robot_file, robot_from_parameters
from construction_twin.scenario.judge import trace_excesses

#: The home pose and two more, far enough for a motion of seconds, on the wire's grid [deg].
HOME = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
LEFT = (30.0, -75.0, 70.0, 20.0, 70.0, -40.0)
RIGHT = (-30.0, -80.0, 80.0, -20.0, 75.0, 30.0)
#: A motion that ended at a pose has come this close to it on every joint [rad], [m]; rounding to 3 decimals alone is 8.73e-6.
FINAL_ERROR = 1e-5
#: Bound of the average error without lag at 3 decimals [rad]; and the bound on a busy machine, where one reply in twenty may be
#: late by a whole cycle at the task's speed.
BOUND, DISTURBED = 1.0e-5, 2.0e-4
#: A rehearsal is there after this time, on two cores that run everything else too [s].
REHEARSED = 40.0


class Stream:
    """Keeps every message of a topic while the ``with`` block runs; entered when the first one is there.

    Args:
        kind: Message class.
    """

    def __init__(self, topic: str, kind: type = JointState):
        self.messages: list = []
        self._topic, self._kind = topic, kind
        self._subscriber: rospy.Subscriber | None = None

    def __enter__(self) -> Stream:
        self._subscriber = rospy.Subscriber(self._topic, self._kind, self.messages.append, tcp_nodelay=True)
        wait(lambda: self.messages, f"a message on {self._subscriber.resolved_name}")
        return self

    def __exit__(self, *_) -> None:
        self._subscriber.unregister()

    def positions(self, since: int = 0) -> np.ndarray:
        """Return the positions of the messages from number `since` on, shape (k, n) [rad]."""
        return np.array([message.position for message in self.messages[since:]])

    def wait_for_more(self, count: int, timeout: float = 20.0) -> None:
        """Wait for `count` further messages."""
        wanted = len(self.messages) + count
        wait(
            lambda: len(self.messages) >= wanted, f"{count} more messages on {self._subscriber.resolved_name}", timeout
        )

    def at_rest(self, count: int = 50) -> bool:
        """Return whether the last `count` positions are identical."""
        last = self.positions(-count)
        return len(last) == count and bool((last == last[0]).all())

    def assert_still(self, count: int = 200) -> None:
        """Check that the next `count` positions are one, in every bit."""
        since = len(self.messages)
        self.wait_for_more(count)
        positions = self.positions(since)
        np.testing.assert_array_equal(positions, np.broadcast_to(positions[0], positions.shape))

    def moved(self, angle_deg: float) -> bool:
        """Return whether a joint of the newest message is more than `angle_deg` away from the first one's [deg]."""
        first, last = self.messages[0].position, self.messages[-1].position
        return bool(np.rad2deg(np.abs(np.subtract(last, first)).max()) > angle_deg)


@contextmanager
def case(what: str):
    """Name the case that fails. Of a failure inside unittest's `subTest` rosunit reports the number only, no reason."""
    try:
        yield
    except AssertionError as error:
        raise AssertionError(f"{what}: {error}") from error


def wait(condition: Callable[[], object], what: str, timeout: float = 20.0, period: float = 0.01) -> None:
    """Wait until `condition`, asked every `period` [s], holds; AssertionError naming `what` if it does not within `timeout` [s]."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline or rospy.is_shutdown():
            raise AssertionError(f"waited {timeout:g} s in vain for {what}")
        time.sleep(period)


class TwinClient:
    """Listens to one robot's states and calls its services.

    Attributes:
        link, sync, execution: The newest of each; None before the first one.
        syncs: Every change of the sync state since the start.
        links: Every change of the link's state since the start.
        plans: Every plan since the start.
    """

    def __init__(self):
        self.robot = robot_from_parameters()
        self.decimals = rospy.get_param("gateway/decimals")
        #: The controller's cycle [s].
        self.period = rospy.get_param("gateway/cycle", 4) / 1000
        self._limits = config_of_link(self.robot, rospy.get_param("gateway"), needs_file=False).limits
        self._trace = rospy.get_param("~gateway_trace", "")
        self.link = self.sync = self.execution = None
        self.syncs: list[Sync] = []
        self.links: list[Link] = []
        self.plans: list[Plan] = []
        self._mock: dict = {}
        self._mock_at = 0.0
        self._diagnostics: dict[str, dict[str, str]] = {}
        rospy.Subscriber("link", Link, self._on_link)
        rospy.Subscriber("sync", Sync, self._on_sync)
        rospy.Subscriber("execution", Execution, self._on_execution)
        rospy.Subscriber("plan", Plan, self.plans.append)
        rospy.Subscriber("mock_rsi/status", String, self._on_mock)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics)

    # -- states

    def wait(self, condition: Callable[[], object], what: str, timeout: float = 20.0) -> None:
        """Wait as the function `wait`; the error tells the robot's states too."""
        try:
            wait(condition, what, timeout)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.describe()}") from None

    def wait_until_ready(self, timeout: float = 40.0) -> None:
        """Wait until a plan could be approved: armed, in sync, idle."""
        self.wait(
            lambda: self.armed() and self.in_sync() and self.idle(), "link ARMED, sync IN_SYNC, execution IDLE", timeout
        )

    def start_over(self, timeout: float = 40.0) -> None:
        """Wait until a plan could be approved; what waits for a person's reset is reset."""
        asked = 0.0

        def ready() -> bool:
            nonlocal asked
            if self._needs_a_person() and time.monotonic() - asked > 1.0:
                asked = time.monotonic()
                print(f"reset at a test's begin, {self.call('reset').message}: {self.describe()}", flush=True)
            return self.armed() and self.in_sync() and self.idle()

        self.wait(ready, "link ARMED, sync IN_SYNC, execution IDLE, resets included", timeout)

    def _needs_a_person(self) -> bool:
        link, sync = self.link and self.link.state, self.sync and self.sync.state
        return link == Link.NEEDS_RESET or sync in (Sync.STOPPED, Sync.FAULT)

    def armed(self) -> bool:
        """Return whether commands flow to the arm."""
        return self.link is not None and self.link.state == Link.ARMED

    def in_sync(self) -> bool:
        """Return whether the gate is open."""
        return self.sync is not None and self.sync.state == Sync.IN_SYNC and self.sync.agreed

    def idle(self) -> bool:
        """Return whether the executor repeats the twin's pose."""
        return self.execution is not None and self.execution.state == Execution.IDLE

    def describe(self) -> str:
        """Return the robot's states as one sentence."""
        states = {"link": self.link, "sync": self.sync, "execution": self.execution}
        return ", ".join(f"{name} {state and state.text} ({state and state.reason})" for name, state in states.items())

    def diagnostics(self, node: str) -> dict[str, str]:
        """Return what a node reported last on `/diagnostics`, by key; empty before the first report."""
        return self._diagnostics.get(node, {})

    def diagnosed_nodes(self) -> set[str]:
        """Return the names of the nodes that have an entry on `/diagnostics`, relative to the robot's namespace."""
        return set(self._diagnostics)

    def gateway_counters(self) -> dict[str, str]:
        """Return the gateway's counters by name, as the bridge reports them once a second; none before it counted."""
        return {pair.key: pair.value for pair in self.link.gateway_counters}

    def mock_counter(self, name: str) -> int:
        """Return one of the mock controller's counters, from a report that is sent after this call."""
        asked = time.monotonic()
        self.wait(lambda: self._mock_at > asked, "a report on mock_rsi/status")
        return self._mock["counters"][name]

    # -- actions

    def si(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return joint values in rad and m from deg, and mm for linear joints; nothing for nothing."""
        return from_wire(values, self.robot.linear) if values else ()

    def plan_to(
        self, goal_deg: Sequence[float], duration: float = 2.5, start_deg: Sequence[float] = ()
    ) -> PlanToJointsResponse:
        """Have a motion planned, from the twin's present pose if no other is given; AssertionError when there is no plan."""
        rospy.wait_for_service("plan_to_joints", 20.0)
        service = rospy.ServiceProxy("plan_to_joints", PlanToJoints)
        answer = service(goal=self.si(goal_deg), start=self.si(start_deg), duration=duration, source="test")
        assert answer.success, answer.message
        self.wait(lambda: self.plans and self.plans[-1].id == answer.plan_id, f"plan {answer.plan_id} on the topic")
        return answer

    def review(
        self, plan_id: str, plan_hash: str, approve: bool = True, reviewer: str = "tester", override: str | None = None
    ) -> ReviewPlanResponse:
        """Give a verdict; repeated while the plan, which travels on a topic of its own, has not reached the executor.

        Args:
            override: Hash of the rehearsal's result in spite of which it is approved; None: it is not.
        """
        service = rospy.ServiceProxy("review_plan", ReviewPlan)
        answers = []

        def answered() -> bool:
            answers.append(
                service(
                    plan_id, plan_hash, approve, reviewer, "integration test", override is not None, override or "", ""
                )
            )
            return answers[-1].success or "is not under review" not in answers[-1].message

        self.wait(answered, "the executor to know the plan", 2.0)
        return answers[-1]

    def approve(self, plan: Plan | PlanToJointsResponse) -> None:
        """Approve a plan, or that of a planner's answer."""
        named = (plan.plan_id, plan.plan_hash) if hasattr(plan, "plan_id") else (plan.id, plan.hash)
        answer = self.review(*named)
        assert answer.success, answer.message

    def start(self, goal_deg: Sequence[float], duration: float = 2.5) -> PlanToJointsResponse:
        """Plan and approve a motion; return its plan."""
        plan = self.plan_to(goal_deg, duration)
        self.approve(plan)
        return plan

    def execute(self, answer, arm: Stream) -> np.ndarray:
        """Approve a plan, wait for its end and return where the mock arm, heard by `arm`, then rests, shape (n,) [rad], [m]."""
        assert answer.success, answer.message
        self.wait(lambda: self.plans and self.plans[-1].id == answer.plan_id, "the plan")
        self.approve(answer)
        self.wait_for_outcome(answer.plan_id, "finished", answer.duration + 20.0)
        self.wait(arm.at_rest, "the arm to rest")
        return arm.positions(-1)[0]

    def go_to(self, goal_deg: Sequence[float]) -> None:
        """Move to a pose at the default speed and wait until a plan could be approved again; nothing if it is there already."""
        with Stream("physical/joint_states") as physical:
            if np.abs(physical.positions(-1)[0] - self.si(goal_deg)).max() <= FINAL_ERROR:
                return
            plan = self.start(goal_deg, duration=0.0)
            self.wait_for_outcome(plan.plan_id, "finished")
            self.assert_at(goal_deg, physical)
        self.wait_until_ready()

    def wait_for_outcome(self, plan_id: str, outcome: str, timeout: float = 20.0) -> None:
        """Wait until a plan has ended with a certain outcome."""

        def ended() -> bool:
            report = self.execution
            return report.plan_id == plan_id and report.state != Execution.PLAYING and report.outcome == outcome

        self.wait(ended, f"plan {plan_id} to be {outcome}", timeout)

    def call(self, service: str) -> TriggerResponse:
        """Call a Trigger service."""
        rospy.wait_for_service(service, 20.0)
        return rospy.ServiceProxy(service, Trigger)()

    def stall(self, joint: str, stalled: bool) -> None:
        """Block a joint of the mock arm, or release it."""
        self.inject("stall", stalled, joint=joint)

    def inject(self, fault: str, on: bool = True, **values) -> None:
        """Switch a fault of the mock controller on or off; `values` are further fields of InjectFault."""
        answer = rospy.ServiceProxy("mock_rsi/inject", InjectFault)(fault=fault, on=on, **values)
        assert answer.success, answer.message

    # -- assertions

    def assert_at(self, goal_deg: Sequence[float], *streams: Stream) -> None:
        """Wait until the streams rest with every joint within `FINAL_ERROR` of the goal."""
        goal = self.si(goal_deg)
        for stream in streams:
            self.wait(
                lambda stream=stream: stream.at_rest() and np.abs(stream.positions(-1)[0] - goal).max() <= FINAL_ERROR,
                f"the pose to rest at {goal}",
            )

    def assert_no_jump(self, twin: Stream, since: int = 0) -> None:
        """Check that every step of the twin from message `since` on keeps its velocity limits over the time between the stamps."""
        messages: list[JointState] = twin.messages[since:]
        stamps = np.array([message.header.stamp.to_nsec() for message in messages]) / 1e9
        # a mirrored pose is stamped at reception: messages come in bursts, but the steps are those of the arm's cycles
        cycles = np.maximum(np.round(np.diff(stamps) / CYCLE), 1.0)[:, None]
        steps = np.abs(np.diff([message.position for message in messages], axis=0))
        allowed = np.array(self.robot.velocity) * CYCLE + format_allowance(3) * CYCLE**2
        assert (steps <= allowed * cycles).all(), f"largest step {np.rad2deg(steps.max())} deg"

    def assert_within_limits(self, arm: Stream, missed_before: int) -> None:
        """Check that every correction the gateway has sent since it started is inside the limits, and report what the arm did.

        An arm that gets no reply in time stands still for that cycle (HOLDON 1), which happens on a busy machine. Therefore the
        gateway's own trace must be within the limits without exception. The arm must be within them if no reply was missed;
        otherwise its largest acceleration is printed.

        Args:
            arm: Of `mock_rsi/joint_states`, complete.
            missed_before: `mock_counter("missed")` at the recording's begin.
        """
        self.assert_trace_within_limits()
        missed = self.mock_counter("missed") - missed_before
        numbers = np.array([message.header.seq for message in arm.messages])
        assert (np.diff(numbers) == 1).all(), "the recording of the arm has gaps"
        velocity = np.diff(arm.positions(), axis=0) / self.period
        acceleration = np.diff(velocity, axis=0, prepend=velocity[:1]) / self.period
        allowance = np.array(self._limits.allowances(self.decimals, self.period))
        excess = (np.abs(velocity) > np.array(self.robot.velocity) + allowance * self.period).any(axis=1)
        excess |= (np.abs(acceleration) > np.array(self.robot.acceleration) + allowance).any(axis=1)
        report = (
            f"the arm left its limits in cycles {np.flatnonzero(excess)[:20]} of {len(velocity)}, {missed} replies missed; "
            f"largest accelerations {np.rad2deg(np.abs(acceleration).max(axis=0)).round(1)} deg/s^2"
        )
        assert missed or not excess.any(), report
        if excess.any():
            print(report, flush=True)

    def assert_late_replies_were_late(self) -> None:
        """Check that the mock called no more replies late than the gateway has sent later than half a cycle after its telegram.

        A mock that was held up itself leaves half a cycle for a reply; no other leaves less.
        """
        late = self.mock_counter("late_replies")
        told = self.link.header.stamp
        self.wait(lambda: self.link.header.stamp > told, "a newer report on link")
        bins, counts = self.link.reply_us_bins, self.link.reply_us_counts
        slow = sum(count for edge, count in zip((*bins, float("inf")), counts) if edge > 0.5e6 * self.period)
        print(f"{sum(counts)} replies, {slow} later than half a cycle, {late} called late", flush=True)
        assert late <= slow, f"{late} of {sum(counts)} replies were called late, but only {slow} took over half a cycle"

    def assert_trace_within_limits(self, path: str = "") -> None:
        """Check that what a gateway sent is inside the limits in every cycle.

        Args:
            path: Of a trace; by default the file that the launch argument `gateway_trace` names, and the test's private parameter
                too.
        """
        path = path or self._trace
        assert path, "give the test the private parameter gateway_trace, and the launch file the argument of this name"
        entries = read_trace(path)
        assert entries, f"{path}: the gateway has answered no telegram"
        found = trace_excesses(entries, self._limits, self.decimals, self.period)
        assert not found, f"{len(found)} of {len(entries)} cycles of the gateway: {'; '.join(map(str, found[:5]))}"

    # -- subscriptions

    def _on_link(self, message: Link) -> None:
        if self.link is None or message.state != self.link.state:
            self.links.append(message)
        self.link = message

    def _on_sync(self, message: Sync) -> None:
        if self.sync is None or message.state != self.sync.state:
            self.syncs.append(message)
        self.sync = message

    def _on_execution(self, message: Execution) -> None:
        self.execution = message

    def _on_mock(self, message: String) -> None:
        self._mock, self._mock_at = json.loads(message.data), time.monotonic()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        prefix = rospy.get_namespace().strip("/") + "/"
        for status in message.status:
            node = status.name.split(":")[0].strip("/").removeprefix(prefix)
            self._diagnostics[node] = {pair.key: pair.value for pair in status.values}


class RehearsedClient(TwinClient):
    """A client where a rehearsal is required: it approves what was rehearsed, and hears what was found.

    Attributes:
        rehearsals: What was found last, by the plan's id.
    """

    def __init__(self):
        super().__init__()
        self.rehearsals: dict[str, Rehearsal] = {}
        rospy.Subscriber("rehearsal", Rehearsal, self._on_rehearsal)

    def _on_rehearsal(self, message: Rehearsal) -> None:
        self.rehearsals[message.plan_id] = message

    def rehearsed(self, plan_id: str) -> RehearsalReport:
        """Return the rehearsal of a plan when it is there."""
        self.wait(lambda: plan_id in self.rehearsals, f"the rehearsal of plan {plan_id}", REHEARSED)
        return from_msg(RehearsalReport, self.rehearsals[plan_id])

    #: Give a verdict without waiting for the rehearsal.
    review_at_once = TwinClient.review

    def review(self, plan_id: str, plan_hash: str, approve: bool = True, **given) -> ReviewPlanResponse:
        """Give a verdict; an approval once the plan was rehearsed, and again while the executor has not heard of it."""
        if not approve or given.get("override") is not None:
            return self.review_at_once(plan_id, plan_hash, approve, **given)
        self.rehearsed(plan_id)
        answers = []

        def answered() -> bool:
            answers.append(self.review_at_once(plan_id, plan_hash, **given))
            return "was not rehearsed yet" not in answers[-1].message

        self.wait(answered, "the executor to hear of the rehearsal", 5.0)
        return answers[-1]

    def recorded(self, plan_id: str) -> dict:
        """Return the last verdict on a plan in the executor's record."""
        path = robot_file(rospy.get_param("executor/review_file"), rospy.get_param("robot/name"))
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        return [line for line in lines if line.get("plan") == plan_id and line["record"] == "verdict"][-1]


class RobotTest(unittest.TestCase):
    """Tests of one robot that follow each other: what a failed one leaves for a person must not fail the rest, too."""

    client: TwinClient
    client_class = TwinClient
    _after_a_failure = False

    @classmethod
    def setUpClass(cls):
        rospy.init_node("test")
        cls.client = cls.client_class()

    def run(self, result=None):
        """Run one test; see `unittest.TestCase`."""
        type(self)._after_a_failure = result is not None and not result.wasSuccessful()
        return super().run(result)

    def begin(self, timeout: float = 40.0) -> None:
        """Wait until a plan could be approved; only where a test has failed before, with a person's resets."""
        if self._after_a_failure:
            self.client.start_over(timeout)
        else:
            self.client.wait_until_ready(timeout)


def node_pid(name: str) -> int:
    """Return the process id of a node of this namespace; 0 when it cannot be asked."""
    caller = rospy.get_name()
    try:
        uri = rosgraph.Master(caller).lookupNode(rospy.resolve_name(name))
        return xmlrpc.client.ServerProxy(uri).getPid(caller)[2]
    except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
        return 0

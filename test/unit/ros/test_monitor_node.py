"""The monitor's node without ROS around it: in which order it speaks, by which clock, what it asks for, how it begins."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
import rospy
from construction_twin.msg import Execution, Link, Plan, Segment, Sync
from construction_twin.srv import ConfigureGateRequest
from executor_bench import ROBOT
from processes import wait_until
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from unplugged import ask

from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.monitor.gate import Gate
from construction_twin.monitor.settings import GateSettings
from construction_twin.monitor.states import SyncEvent, SyncState
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.ros.nodes import pca_monitor as module
from construction_twin.ros.shared.diagnostics import OK, Diagnosis
from construction_twin.ros.transport.joint_stream import from_time, to_time
from construction_twin.servo.model import JointServo, ServoModel

HOME = ROBOT.home
SETTINGS = {
    "threshold": 0.01,
    "threshold_linear": 0.005,
    "comparison": "aligned",
    "lag_allowance": 0.05,
    "lag_margin": 0.06,
    "feedback_timeout": 0.1,
    "agree_share": 0.8,
    "agree_time": 0.1,
    "policy": "replan",
    "give_up_time": 30.0,
    "escalate_count": 5,
    "escalate_time": 30.0,
}


class World:
    """What the node finds around itself: clocks, parameters, topics."""

    def __init__(self, monkeypatch):
        self.wall, self.steady = 1000 * NANOSECONDS, 50 * NANOSECONDS
        self.parameters: dict[str, str] = {}
        self.said: list[tuple[str, object]] = []
        self.logged: list[str] = []
        self.refused: list[tuple[str, str]] = []
        self.planned = threading.Event()
        self.patch = patch = monkeypatch.setattr
        patch(module, "now_ns", lambda: self.wall)
        patch(module.time, "monotonic_ns", lambda: self.steady)
        patch(rospy.Time, "now", lambda: to_time(self.wall))
        for level in ("loginfo", "logwarn", "logerr"):
            patch(rospy, level, lambda *words: self.logged.append(words[0] % words[1:]))
        topics = (each.topic for each in module.INTERFACE.publishes)
        self.publishers = {topic: self.topic(topic) for topic in topics} | {
            "transitions": SimpleNamespace(publish=lambda _: None)
        }
        #: What the gate knows of the arm's servos.
        self.servos: ServoModel | None = None

    def start(self, sync=None) -> module.PcaMonitorNode:
        """Return a monitor, and keep its gate; `sync` is a publisher in place of the one that notes what it is given."""
        codec = JointStringCodec.of(ROBOT, 6)
        self.gate = Gate(MotionLimits.of(ROBOT), codec, GateSettings(**SETTINGS), self.steady, self.servos)
        self.patch(module, "make_gate", lambda *_: self.gate)
        log = SimpleNamespace(add=self.report, flush=lambda: None, fault="", values=dict)
        self.patch(module, "TransitionLog", lambda *_: log)
        self.patch(module, "SpeedLimitService", lambda *_: SimpleNamespace(diagnose=lambda: Diagnosis(OK, "")))
        self.patch(rospy, "ServiceProxy", lambda *_: self.plan_to_joints)
        ports = SimpleNamespace(
            publishers=self.publishers if sync is None else self.publishers | {"sync": sync},
            parameters={module.STOPPED: self.parameters.get(module.STOPPED, "")},
            parameter_writer=lambda name: lambda value: self.parameters.update({name: value}),
            diagnostics=SimpleNamespace(refuse=lambda *said: self.refused.append(said)),
        )
        given = {"arm": "mock", "servo_model": "", "decimals": 6, "transition_file": "t"}
        node = module.PcaMonitorNode(module.Settings(**SETTINGS | given), ROBOT, ports)
        self.logged.clear()
        return node

    def change(self, node, settings: str, operator: str = "Ada"):
        """Ask for other settings."""
        request = ConfigureGateRequest(settings=settings, operator=operator)
        return ask(module.NODE, node, "configure_gate", request, lambda *said: self.refused.append(said))

    def topic(self, name: str):
        """Return a publisher."""
        return SimpleNamespace(publish=lambda *message: self.said.append((name, message[-1])))

    def report(self, change) -> None:
        """Take a transition."""
        self.said.append(("transitions", change))

    def plan_to_joints(self, **request):
        """Take a request for a plan."""
        self.request = request
        self.planned.set()
        return SimpleNamespace(success=True, message="planned")

    def pass_time(self, seconds: float = CYCLE_NS / NANOSECONDS) -> None:
        """Let both clocks run."""
        self.wall += round(seconds * NANOSECONDS)
        self.steady += round(seconds * NANOSECONDS)

    def syncs(self) -> list[str]:
        """Return the states that were published, in order."""
        return [message.text for name, message in self.said if name == "sync"]


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


def feedback(world: World, offset: float = 0.0) -> tuple:
    """Return what is heard of the arm now: stamp, pose, and that the link carries no properties."""
    return world.wall, (HOME[0] + offset, *HOME[1:]), 0, 0


def run(world: World, node, cycles: int) -> None:
    """Let the stream of a standing robot pass."""
    for _ in range(cycles):
        world.pass_time()
        node.on_twin(world.wall - CYCLE_NS, HOME)
        node.on_feedback(*feedback(world))
        node.on_next(world.wall, HOME)


def opened(world: World, session: str = "s1", sync=None):
    """Return a node whose gate is open."""
    node = world.start(sync)
    node.on_link(Link(session=session, state=Link.ARMED))
    run(world, node, 40)
    assert world.gate.state is SyncState.IN_SYNC
    return node


def syncs_of(world: World, node, angles) -> int:
    """Return how often `sync` is told while a robot follows these angles of its first joint at once, from home on [rad]."""
    world.said.clear()
    for angle in angles:
        world.pass_time()
        q = (HOME[0] + angle, *HOME[1:])
        node.on_twin(world.wall, q)
        node.on_feedback(world.wall, q, 0, 0)
        node.on_next(world.wall, q)
    return len(world.syncs())


def test_sync_is_told_at_its_rate_in_motion_and_while_the_gate_is_closed_and_less_often_at_rest(world):
    node, step = opened(world), 1e-5
    assert syncs_of(world, node, [0.0] * 250) == pytest.approx(10, abs=1)
    assert syncs_of(world, node, [step * cycle for cycle in range(250)]) == pytest.approx(50, abs=1)
    # for half a second it may go on to move
    assert syncs_of(world, node, [step * 249] * 125) == pytest.approx(25, abs=1)
    assert syncs_of(world, node, [step * 249] * 250) == pytest.approx(10, abs=1)
    world.pass_time(0.2)
    node.watch()
    assert world.gate.state is SyncState.STALE
    world.said.clear()
    for _ in range(50):
        world.pass_time(0.02)
        node.watch()
    assert len(world.syncs()) == 50


def test_settings_of_this_test_are_all_there_are():
    assert set(SETTINGS) | {"thresholds"} == set(GateSettings.model_fields)


class TestSettings:
    def test_change_at_rest_and_are_recorded(self, world):
        node = opened(world)
        world.said.clear()
        answer = world.change(node, "{agree_time: 0.2, thresholds: {joint_a3: 0.02}}")
        assert answer.success and "agree_time 0.1 -> 0.2" in answer.message
        (change,) = [change for name, change in world.said if name == "transitions"]
        assert (change.event, change.target) == (SyncEvent.CONFIGURED, SyncState.IN_SYNC)
        assert change.reason.startswith("Ada changed thresholds {} -> {'joint_a3': 0.02}") and change.at == world.wall
        assert world.gate.settings.agree_time == 0.2 and not world.planned.is_set()
        # what was changed before stays changed
        assert world.change(node, "{policy: stop}").success
        assert (world.gate.settings.agree_time, world.gate.settings.policy) == (0.2, "stop")

    def test_that_are_the_same_are_no_transition(self, world):
        node = opened(world)
        world.said.clear()
        assert world.change(node, "{policy: replan}").message == "nothing to change" and world.said == []

    @pytest.mark.parametrize(
        "settings, operator, problem",
        [
            ("{policy: hope}", "Ada", "policy"),
            ("{agree_time: 0.2, threshold: -1}", "Ada", "threshold"),
            ("{agree_time: 0.2, thresholds: {joint_a9: 0.1}}", "Ada", "joint_a9"),
            ("{decimals: 1}", "Ada", "decimals"),
            ("[1]", "Ada", "mapping"),
            ("{policy: stop}", " ", "operator"),
        ],
    )
    def test_that_make_no_sense_change_nothing_at_all(self, world, settings, operator, problem):
        node = opened(world)
        before = world.gate.settings
        world.said.clear()
        answer = world.change(node, settings, operator)
        assert not answer.success and problem in answer.message and answer.message.endswith("nothing was changed")
        assert world.gate.settings is before and world.said == []
        assert world.refused == [("configure_gate", answer.message)]

    @pytest.mark.parametrize("state", ["PLAYING", "STOPPING", "PAUSING", "PAUSED", "HELD"])
    def test_do_not_change_while_a_plan_is_being_executed(self, world, state):
        node = opened(world)
        node.on_execution(Execution(state=getattr(Execution, state), text=state, plan_id="p"))
        answer = world.change(node, "{threshold: 0.5}")
        assert not answer.success and f"plan p is {state}" in answer.message
        node.on_execution(Execution(state=Execution.IDLE, text="IDLE", plan_id="p"))
        assert world.change(node, "{threshold: 0.5}").success

    def test_are_not_even_read_unless_a_named_person_asks_at_rest(self, world, monkeypatch):
        node = opened(world)
        monkeypatch.setattr(GateSettings, "with_changes", lambda *_: pytest.fail("read the settings"))
        assert "operator" in world.change(node, "{policy: stop}", "").message
        node.on_execution(Execution(state=Execution.PLAYING, text="PLAYING", plan_id="p"))
        assert "plan p" in world.change(node, "{policy: stop}").message
        node.on_execution(Execution(state=Execution.IDLE, text="IDLE", plan_id="p"))
        node.on_link(Link(session="s1", state=Link.MIRROR))
        assert "the arm leads" in world.change(node, "{policy: stop}").message


def test_a_plan_without_points_is_refused_with_a_sentence(world):
    node = opened(world)
    node.on_plan(Plan(id="empty"))
    ((reason, sentence),) = world.refused
    assert reason == "plan" and "plan empty has no points" in sentence


class TestOrder:
    def test_the_executor_hears_of_a_hold_before_anybody_else(self, world):
        node = opened(world)
        world.said.clear()
        node.on_feedback(*feedback(world, 0.2))
        (first, sync), (second, hold), (third, change) = world.said
        assert (first, sync.text, second, third) == ("sync", "HOLDING", "hold", "transitions")
        assert " differs by " in hold.cause and from_time(hold.since) == world.wall
        assert change.target is SyncState.HOLDING and world.logged == []

    def test_why_it_holds_is_told_once_until_it_is_mended(self, world):
        node = opened(world)
        node.on_feedback(*feedback(world, 0.2))
        since = world.wall
        world.said.clear()
        world.pass_time(31.0)
        node.watch()
        assert world.syncs()[-1] == "STOPPED" and "hold" not in dict(world.said)
        node.on_link(Link(session="s2", state=Link.ARMED))
        run(world, node, 40)
        told = [message for name, message in world.said if name == "hold"]
        assert [message.cause for message in told] == [""] and from_time(told[-1].header.stamp) > since

    def test_what_is_published_last_is_the_newest(self, world):
        """A thread that is held up while it publishes keeps a newer state from overtaking it."""
        entered, go_on, order = threading.Event(), threading.Event(), []

        def slow(message: Sync) -> None:
            if message.text == "HOLDING":
                entered.set()
                go_on.wait(10.0)
            order.append(message.text)

        node = opened(world, sync=SimpleNamespace(publish=slow))
        order.clear()
        held = threading.Thread(target=node.on_feedback, args=feedback(world, 0.2))
        held.start()
        assert entered.wait(10.0)

        def give_up():
            world.pass_time(31.0)
            node.watch()

        newer = threading.Thread(target=give_up)
        newer.start()
        newer.join(0.2)
        go_on.set()
        held.join(10.0)
        newer.join(10.0)
        assert order == ["HOLDING", "STOPPED"]


class TestClocks:
    def test_a_wall_clock_set_back_does_not_make_dead_feedback_fresh(self, world):
        node = opened(world)
        world.wall -= 10 * NANOSECONDS
        world.pass_time(0.11)
        node.watch()
        assert world.syncs()[-1] == "STALE"

    @pytest.mark.parametrize("step", [-10.0, 10.0])
    def test_a_wall_clock_that_is_set_closes_nothing_while_all_is_well(self, world, step):
        node = opened(world)
        late = feedback(world)
        world.wall += round(step * NANOSECONDS)
        stamp = world.wall - round(step * NANOSECONDS)
        node.on_feedback(*late)
        for k in range(1, 50):
            world.pass_time()
            node.on_twin(stamp + (k - 1) * CYCLE_NS, HOME)
            node.on_feedback(*feedback(world))
            node.on_next(stamp + k * CYCLE_NS, HOME)
            node.watch()
        assert world.gate.state is SyncState.IN_SYNC and world.gate.violations == 0

    def test_feedback_that_waited_in_a_queue_is_not_fresh(self, world):
        node = opened(world)
        waited = feedback(world)
        world.pass_time(0.11)
        node.on_feedback(*waited)
        node.watch()
        assert world.syncs()[-1] == "STALE"

    def test_changes_are_reported_in_ros_time(self, world):
        node = opened(world)
        node.on_feedback(*feedback(world, 0.2))
        assert [change.at for name, change in world.said if name == "transitions"][-1] == world.wall


class TestReplan:
    def offer(self, node, velocity_use=(0.2, 0.1), segments=()) -> None:
        points = [JointTrajectoryPoint(positions=HOME), JointTrajectoryPoint(positions=[0.5] * 6)]
        use = {"velocity_use": velocity_use, "acceleration_use": (0.4, 0.1)}
        node.on_plan(Plan(id="p", trajectory=JointTrajectory(points=points), segments=segments, **use))

    def test_asks_for_the_same_goal_at_the_approved_pace(self, world):
        node = opened(world)
        self.offer(node)
        known = Execution(state=Execution.PLAYING, plan_id="p", moment="c0ffee00-7")
        node.on_execution(known)
        world.pass_time()
        node.on_feedback(*feedback(world, 0.2))
        assert world.planned.wait(10.0) and world.gate.state is SyncState.REPLANNING
        assert world.request["goal"] == (0.5,) * 6
        assert (world.request["speed_scale"], world.request["acceleration_scale"]) == (0.2, 0.4)
        # as of when the plan was known to be played: a stop since then voids the new one
        assert world.request["asked"] == known.moment

    def test_a_work_plan_is_planned_anew_by_whoever_gave_the_task(self, world):
        node = opened(world)
        self.offer(node, segments=[Segment(name="carry")])
        node.on_execution(Execution(state=Execution.PLAYING, plan_id="p"))
        node.on_feedback(*feedback(world, 0.2))
        assert world.gate.state is SyncState.HOLDING and not world.planned.is_set()

    @pytest.mark.parametrize("state", [Execution.PAUSING, Execution.PAUSED, Execution.STOPPING, Execution.IDLE])
    def test_what_a_person_has_halted_is_not_re_planned(self, world, state):
        node = opened(world)
        self.offer(node)
        node.on_execution(Execution(state=state, plan_id="p"))
        node.on_feedback(*feedback(world, 0.2))
        assert world.gate.state is SyncState.HOLDING and not world.planned.is_set()


class TestStopped:
    def wait_for(self, world: World, node, session: str) -> None:
        """Let the monitor watch, until the thread that it keeps the session with has done so."""

        def kept() -> bool:
            node.watch()
            return world.parameters == {"stopped_session": session}

        wait_until(kept)

    def stop(self, world: World):
        node = opened(world)
        node.on_feedback(*feedback(world, 0.2))
        world.pass_time(31.0)
        self.wait_for(world, node, "s1")
        return node

    def test_a_monitor_in_its_place_stays_stopped_until_a_person_resets(self, world):
        self.stop(world)
        world.said.clear()
        node = world.start()
        run(world, node, 40)
        node.on_link(Link(session="s1", state=Link.ARMED))
        run(world, node, 100)
        assert set(world.syncs()) == {"STOPPED"} and "command/joint_states" not in dict(world.said)
        node.on_link(Link(session="s2", state=Link.ARMED))
        run(world, node, 40)
        assert world.gate.state is SyncState.IN_SYNC

    def test_the_one_in_its_place_reads_that_at_its_start(self, world, tmp_path, monkeypatch):
        monkeypatch.setenv("ROS_HOME", str(tmp_path))
        ports = SimpleNamespace(
            publishers={each.topic: world.topic(each.topic) for each in module.INTERFACE.publishes},
            diagnostics=SimpleNamespace(refuse=lambda *said: None),
            parameters={each.name: each.default for each in module.INTERFACE.parameters} | {module.STOPPED: "s1"},
            parameter_writer=lambda name: lambda session: None,
        )
        given = {"arm": "mock", "servo_model": "", "decimals": 3, "transition_file": str(tmp_path / "t.jsonl")}
        node = module.PcaMonitorNode(module.Settings(**SETTINGS | given), ROBOT, ports)
        assert node.diagnose().sentence.startswith("STOPPED: ")

    def test_is_forgotten_with_the_session(self, world):
        node = self.stop(world)
        node.on_link(Link(session="s2", state=Link.ARMED))
        self.wait_for(world, node, "")
        opened(world)


# -- servos


def known_servos(world):
    """Return a monitor that knows the servos of an arm that answers each command two cycles later, and has judged it at rest."""
    world.servos = ServoModel(ROBOT.joint_names, (JointServo(60.0, 0.8),) * 6, CYCLE_NS)
    node = world.start()
    cycles(world, node, HOME, 120)
    assert world.gate.state is SyncState.IN_SYNC
    return node


def cycles(world, node, measured, count):
    for _ in range(count):
        world.pass_time()
        node.on_twin(world.wall - CYCLE_NS, HOME)
        answered = world.wall - 2 * CYCLE_NS if world.gate.held else 0
        node.on_feedback(world.wall, measured, world.wall // CYCLE_NS, answered)
        node.on_next(world.wall, HOME)


def test_it_publishes_where_the_servos_should_have_the_arm_and_says_that_it_judges_by_it(world):
    node = known_servos(world)
    published = [q for name, q in world.said if name == "expected/joint_states"]
    assert len(published) > 60 and published[-1] == pytest.approx(HOME, abs=1e-6)
    values = node.diagnose().values
    assert values["servo model"] == "judges" and values["compared with it"] > 0


def test_without_a_model_it_publishes_none_and_says_so(world):
    node = world.start()
    cycles(world, node, HOME, 60)
    assert [name for name, _ in world.said if name == "expected/joint_states"] == []
    assert node.diagnose().values["servo model"].startswith("none")


def test_it_publishes_expected_poses_only_with_a_model_and_an_arm():
    (topic,) = (each for each in module.INTERFACE.publishes if each.topic == "expected/joint_states")
    plain = SETTINGS | {"decimals": 3, "transition_file": "t"}
    told = [
        topic.when(module.Settings(**plain | {"arm": arm, "servo_model": file}))
        for arm, file in (("mock", "servos.yaml"), ("mock", ""), ("none", "servos.yaml"))
    ]
    assert told == [True, False, False]

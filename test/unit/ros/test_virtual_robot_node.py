"""The twin's node without ROS around it: when it repeats its pose, with which stamps, by which clock."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
import rospy
from construction_twin.msg import Link
from executor_bench import ROBOT
from unplugged import Unplugged

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.execution.executor import TWIN_TIMEOUT
from construction_twin.extensions.physics.nodes import simulated_twin
from construction_twin.ros.nodes import virtual_robot as module
from construction_twin.ros.transport import joint_stream
from construction_twin.scene.objects import Scene
from construction_twin.twin.virtual_robot import SILENCE

HOME = ROBOT.home
MS = NANOSECONDS // 1000


def node(refuse, arm: str = "mock", twin: str = "kinematic", **publish) -> module.VirtualRobotNode:
    """Return a node that publishes by calls, by topic."""
    publishers = {topic: SimpleNamespace(publish=call) for topic, call in publish.items()}
    ports = SimpleNamespace(publishers=publishers, diagnostics=SimpleNamespace(refuse=refuse))
    return module.VirtualRobotNode(module.Settings(arm=arm, twin=twin, self_collision="", drives=""), ROBOT, ports)


class World:
    """What the node finds around itself: clocks that run while it waits, and what happens at which time."""

    def __init__(self, monkeypatch):
        self.wall, self.steady = 1000 * NANOSECONDS, 52 * NANOSECONDS
        self._events: list[tuple[int, object]] = []
        self._end = 0
        # time of publication, stamp
        self.published: list[tuple[int, int]] = []
        self.cycles, self._thread = 0, threading.get_ident()
        patch = monkeypatch.setattr
        patch(joint_stream, "now_ns", lambda: self.wall)
        patch(module, "now_ns", lambda: self.wall)
        patch(joint_stream, "time", SimpleNamespace(monotonic_ns=lambda: self.steady, sleep=self.sleep))
        patch(rospy, "is_shutdown", self.is_over)
        patch(rospy, "loginfo", lambda *_: None)
        self.restarted = SimpleNamespace(clear=self.clear, set=self.wake, wait=self.wait)
        self.node = node(lambda *_: None, **{"twin/joint_states": self.publish})
        self.node._restarted = self.restarted
        self._woken = False
        # the grid that stamps the commands: nothing disturbs it
        self.offset = self.wall - self.steady
        self.node.on_link(Link(session="s1", state=Link.ARMED))
        self.node.on_physical(self.wall, HOME)

    def publish(self, stamp: int, q) -> None:
        """Take a pose of the twin."""
        assert q == HOME
        self.published.append((self.steady, stamp))

    def is_over(self) -> bool:
        """Whether the test's time is up; asked once per cycle, and by threads that other tests have left."""
        self.cycles += threading.get_ident() == self._thread
        return self.steady >= self._end

    def clear(self) -> None:
        """Forget the last wake-up."""
        self._woken = False

    def wake(self) -> None:
        """End a wait."""
        self._woken = True

    def sleep(self, seconds: float) -> None:
        """Let time pass, and happen what is to happen."""
        self.pass_time(self.steady + round(seconds * NANOSECONDS), lambda: False)

    def wait(self, seconds: float) -> None:
        """The same until somebody wakes the node."""
        self.pass_time(self.steady + round(seconds * NANOSECONDS), lambda: self._woken)

    def pass_time(self, until: int, ends) -> None:
        """Let both clocks run."""
        while self._events and self._events[0][0] <= until and not ends():
            at, event = self._events.pop(0)
            self.wall, self.steady = self.wall + max(at - self.steady, 0), max(at, self.steady)
            event()
        if not ends():
            self.wall, self.steady = self.wall + until - self.steady, until

    def command(self) -> None:
        """Take a setpoint of the stream."""
        self.node.on_command((self.steady + self.offset) // CYCLE_NS * CYCLE_NS, HOME)

    def play(self, duration: int, commands=(), **events) -> int:
        """Run the node for `duration` [ns] with commands in spans [ms], other events at their times [ms]; return the beginning."""
        began = self.steady
        for first, last in commands:
            for at in range(first * MS, last * MS, CYCLE_NS):
                # a little behind the grid, as a message is
                self._events.append((began + at + 300_000, self.command))
        self._events += [(began + int(at[1:]) * MS, event) for at, event in events.items()]
        self._events.sort(key=lambda event: event[0])
        self._end = began + duration
        self.node.run()
        return began

    def between(self, first: int, last: int) -> list[tuple[int, int]]:
        """Return what was published in a span of the monotonic clock [ns]."""
        return [one for one in self.published if first <= one[0] < last]


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


@pytest.mark.parametrize("phase", range(0, 260, 20))
def test_after_a_silence_the_pose_is_repeated_at_once_and_in_time(world, phase):
    last = 1000 + phase
    began = world.play(2 * NANOSECONDS, [(0, last)])
    silent = began + last * MS - CYCLE_NS + SILENCE
    repeated = world.between(began + last * MS, world.steady)
    assert 0 <= repeated[0][0] - silent <= 2 * CYCLE_NS
    assert [at + world.offset - stamp for at, stamp in repeated] == [0] * len(repeated)
    assert len(repeated) >= (world.steady - silent) // CYCLE_NS - 2


def test_a_new_session_wakes_it_up(world):
    restart = {
        "t1000": lambda: world.node.on_link(Link(session="s2", state=Link.ARMED)),
        "t1001": lambda: world.node.on_physical(world.wall, HOME),
    }
    began = world.play(NANOSECONDS * 11 // 10, [(0, 990)], **restart)
    assert world.between(began + 1000 * MS, began + 1012 * MS)


@pytest.mark.parametrize("session", ["s1", "s2"])
@pytest.mark.parametrize("step", [-5.0, -0.3, 0.3, 5.0])
def test_a_wall_clock_that_is_set_is_of_no_account(world, step, session):
    """Commands, a pause, commands; the wall clock is set in the middle of the first ones, a session begins in the pause."""

    def set_clock() -> None:
        world.wall += round(step * NANOSECONDS)

    def begin() -> None:
        world.node.on_link(Link(session=session, state=Link.ARMED))
        world.node.on_physical(world.wall, HOME)

    began = world.play(6 * NANOSECONDS, [(0, 2000), (4000, 6000)], t1000=set_clock, t3990=begin)
    times = [at for at, _ in world.published if at >= began]
    assert max(later - earlier for earlier, later in zip(times, times[1:])) < SILENCE + 3 * CYCLE_NS < TWIN_TIMEOUT
    # every pose of the second stream
    assert len(world.between(began + 4000 * MS, world.steady)) >= 500
    stamps = [stamp for _, stamp in world.published]
    assert stamps == sorted(set(stamps))
    assert all(abs(at + world.offset - stamp) <= CYCLE_NS for at, stamp in world.published if at >= began)


@pytest.mark.parametrize("step", [-600.0, -5.0, -0.1])
def test_commands_of_an_executor_that_began_on_a_clock_that_was_set_back_are_published_with_their_stamps(world, step):
    """The twin's own time is that of before; nothing else would ever bring twin and arm together again."""

    def restart() -> None:
        world.wall += round(step * NANOSECONDS)
        world.offset += round(step * NANOSECONDS)
        world.node.on_link(Link(session="s2", state=Link.ARMED))
        world.node.on_physical(world.wall, HOME)

    began = world.play(6 * NANOSECONDS, [(0, 2000), (4000, 5000)], t3000=restart)
    second = world.between(began + 4000 * MS + 1, began + 5000 * MS)
    assert len(second) >= 250 and all(abs(at + world.offset - stamp) <= CYCLE_NS for at, stamp in second)
    # in the silence behind them its pose goes on, on their clock, and stands still nowhere
    after = world.between(began + 5000 * MS, world.steady)
    assert all(abs(at + world.offset - stamp) <= CYCLE_NS for at, stamp in after)
    times = [at for at, _ in second + after]
    assert max(later - earlier for earlier, later in zip(times, times[1:])) < SILENCE + 3 * CYCLE_NS < TWIN_TIMEOUT


def test_commands_that_were_held_up_are_of_the_same_clock(world):
    """They are executed, and their stamps belong to the past: the pose was repeated meanwhile."""
    began = world.play(2 * NANOSECONDS, [(0, 1000)])
    world.offset -= 400 * MS
    began = world.play(2 * NANOSECONDS, [(500, 2000)])
    stamps = [stamp for _, stamp in world.published]
    assert stamps == sorted(set(stamps)) and world.between(began + 1000 * MS, world.steady)


# -- a twin with mass


class Falling:
    """A simulated arm that is a little lower in every cycle, whatever it is told."""

    def __init__(self):
        self.fault, self.contacts, self.effort, self.remarks = "", (), (1.0,) * 6, ()
        self.fallen, self.restarts, self.models = 0, 0, []

    def cycle(self, commanded):
        self.fallen += 1
        return (commanded[0] - self.fallen * 1e-3, *commanded[1:])

    def restart(self):
        self.fallen, self.restarts = 0, self.restarts + 1

    def set_model(self, model):
        self.models.append(model)


def simulates(monkeypatch, live: Falling) -> None:
    """Have the next node simulate by this."""
    monkeypatch.setattr(simulated_twin, "LiveTwin", lambda: live)


class Massive:
    """The node around it, without ROS."""

    def __init__(self, monkeypatch):
        self.told: list[tuple[str, int, tuple]] = []
        self.live, self.refused = Falling(), []
        self.built: list[Scene] = []
        self.failure = ""
        monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
        simulates(monkeypatch, self.live)
        self.node = node(
            lambda *said: self.refused.append(said),
            twin="mujoco",
            **{
                "twin/joint_states": lambda stamp, q: self.told.append(("simulated", stamp, q)),
                "twin/commanded": lambda stamp, q: self.told.append(("commanded", stamp, q)),
                "twin/effort": lambda message: self.told.append(("effort", message.header.stamp.to_nsec(), ())),
            },
        )
        self.node._simulated._build, self.node._simulated._tool_mass = self.build, {"tool": 18.0}
        self.node.on_link(Link(session="s1", state=Link.ARMED))
        # long ago: the node's thread does not wait for the next one
        self.node.on_physical(1, HOME)

    def build(self, scene: Scene, masses):
        self.masses = masses
        if self.failure:
            raise ConstructionTwinError(self.failure)
        self.built.append(scene)
        return SimpleNamespace(remarks=())

    def of(self, topic: str) -> list[tuple[int, tuple]]:
        return [(stamp, q) for name, stamp, q in self.told if name == topic]


@pytest.fixture
def massive(monkeypatch):
    return Massive(monkeypatch)


STAMPS = [1000 * NANOSECONDS + number * CYCLE_NS for number in range(50)]


def test_a_simulated_arm_that_falls_changes_nothing_of_what_is_commanded(massive):
    for stamp in STAMPS:
        massive.node.on_command(stamp, HOME)
    assert massive.of("commanded") == [(stamp, HOME) for stamp in STAMPS]
    simulated = massive.of("simulated")
    assert [stamp for stamp, _ in simulated] == STAMPS
    assert simulated[-1][1][0] == pytest.approx(HOME[0] - 0.05)
    # one cycle per command, and what is commanded is told before it is simulated
    assert massive.live.fallen == 50 and massive.told[0][0] == "commanded"
    assert massive.refused == []


def test_a_new_session_begins_the_simulation_anew(massive):
    massive.node.on_command(STAMPS[0], HOME)
    massive.node.on_link(Link(session="s2", state=Link.ARMED))
    assert massive.live.restarts == 1
    # and a command of the stream before is neither executed nor simulated
    massive.node.on_command(STAMPS[1], HOME)
    assert massive.live.fallen == 0


def test_the_simulation_goes_on_while_no_commands_come(world, monkeypatch):
    """By the clock, with the stamps of now: the world's node, with an arm that falls."""
    live, commanded = Falling(), []
    simulates(monkeypatch, live)
    publish = {
        "twin/joint_states": lambda stamp, q: world.published.append((world.steady, stamp)),
        "twin/commanded": lambda _stamp, q: commanded.append(q),
        "twin/effort": lambda _: None,
    }
    world.node = node(lambda *_: None, "none", "mujoco", **publish)
    world.node._restarted = world.restarted
    began = world.play(NANOSECONDS, [(0, 100)])
    silent = world.between(began + 400 * MS, began + NANOSECONDS)
    assert len(silent) >= 148 and live.fallen == len(world.published)
    assert set(commanded) == {HOME}


# -- a twin in Gazebo


def in_gazebo(monkeypatch) -> Unplugged:
    """The node, executing commands from home on."""
    monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
    settings = module.Settings(arm="mock", twin="gazebo", self_collision="", drives="")
    bench = Unplugged(monkeypatch, module.NODE, settings, ROBOT)
    bench.node.on_link(Link(session="s1", state=Link.ARMED))
    bench.node.on_physical(1, HOME)
    return bench


def test_what_gazebo_answers_is_the_twin_s_pose_with_the_stamp_of_the_command(monkeypatch):
    bench = in_gazebo(monkeypatch)
    sagged = tuple(value + 0.01 for value in HOME)
    for stamp in STAMPS[:3]:
        bench.node.on_command(stamp, HOME)
        assert bench.published["twin/commanded"][-1] == (stamp, HOME)
        bench.callbacks["gazebo/joint_states"](stamp, sagged)
    assert bench.published["twin/joint_states"] == [(stamp, sagged) for stamp in STAMPS[:3]]
    assert bench.published["twin/commanded"] == [(stamp, HOME) for stamp in STAMPS[:3]]
    assert bench.refused == [] and bench.diagnose().sentence == "executing"


def test_a_silent_gazebo_is_told_and_what_is_commanded_goes_on(monkeypatch):
    bench = in_gazebo(monkeypatch)
    stamps = [STAMPS[0] + number * CYCLE_NS for number in range(300)]
    for stamp in stamps:
        bench.node.on_command(stamp, HOME)
    assert [stamp for stamp, _ in bench.published["twin/commanded"]] == stamps
    assert bench.published["twin/joint_states"] == []
    report = bench.diagnose()
    assert report.level == module.WARN and report.sentence.startswith("Gazebo has answered no command for 1 s")

"""The executor's node without ROS around it: clocks that a test sets, and lists in place of topics and of the log."""

from __future__ import annotations

import json
import threading
from types import SimpleNamespace

import numpy as np
import rospy
from construction_twin.msg import Link, Scene, Sync
from construction_twin.srv import ActAsSeenRequest, ReviewPlanRequest
from executor_bench import ROBOT, SCENE, make_plan
from unplugged import ask

from construction_twin.core.errors import ProtocolError
from construction_twin.core.freshness import Moment
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.review.record import ReviewLog
from construction_twin.ros.messages.convert import plan_to_msg
from construction_twin.ros.nodes import executor as module
from construction_twin.ros.transport.joint_stream import to_time

GIVEN = {"speed_limit_deadline": 0.5, "speed_limit_silent": 0.1, "speed_limit_required": False}


class SlowLog(ReviewLog):
    """A record on a disk that may take its time."""

    def __init__(self, *given):
        super().__init__(*given)
        self.wait = lambda: None

    def append(self, record):
        self.wait()
        super().append(record)


class World:
    """What the node finds around itself: clocks, topics, services, its log."""

    def __init__(self, monkeypatch, tmp_path):
        self.wall, self.steady = 1000 * NANOSECONDS, 50 * NANOSECONDS
        self.said: list[tuple[str, object]] = []
        self.logged: list[tuple[str, str]] = []
        self.refused: list[tuple[str, str]] = []
        self.cycles = 0
        patch = monkeypatch.setattr
        patch(module, "now_ns", lambda: self.wall)
        patch(module.time, "monotonic_ns", lambda: self.steady)
        #: The robot's clock that nobody sets [ns].
        self.booted = 7_000 * NANOSECONDS
        patch(module, "present_moment", lambda: Moment("c0ffee00", self.booted))
        patch(module, "Cycles", self.grid)
        patch(rospy, "get_time", lambda: self.wall / NANOSECONDS)
        patch(rospy.Time, "now", lambda: to_time(self.wall))
        for level in ("loginfo", "logwarn", "logerr"):
            patch(rospy, level, self.logger(level))
        patch(rospy, "on_shutdown", lambda hook: None)
        patch(module, "ReviewLog", SlowLog)
        self.settings = {"arm": "mock", "review_file": str(tmp_path / "reviews.jsonl")} | GIVEN
        self.open()

    def open(self, **settings) -> None:
        """Start the node, with other settings than before."""
        self.settings |= settings
        node_io = SimpleNamespace(
            publishers={each.topic: self.topic(each.topic) for each in module.INTERFACE.publishes},
            connections=lambda topic: 1,
            diagnostics=SimpleNamespace(refuse=self.refuse),
        )
        self.node = module.ExecutorNode(module.Settings(**self.settings), ROBOT, node_io)
        self.executor, self.log = self.node.executor, self.node._log
        self.logged.clear()

    def refuse(self, *said: str) -> None:
        """Count what is refused."""
        self.refused.append(said)

    def receive(self, topic: str, message) -> None:
        """Let a message come in, as `Subscriber` hands it on."""
        (heard,) = (each for each in module.INTERFACE.subscribes if each.topic == topic)
        try:
            heard.handler(self.node, message)
        except ProtocolError as error:
            self.refuse(error.reason, str(error))

    def ask(self, service: str, request=None):
        """Return the answer of a service."""
        return ask(module.NODE, self.node, service, request, self.refuse)

    def offer(self, plan) -> None:
        """Let a plan come in."""
        self.receive("plan", plan_to_msg(plan, "base_link", np.zeros((len(plan.trajectory.times), 3))))

    def review(self, plan, approve: bool = True, reviewer: str = "Ada", reason: str = "", moment: str = ""):
        """Give a verdict; return the answer."""
        return self.ask(
            "review_plan", ReviewPlanRequest(plan.id, plan.hash, approve, reviewer, reason, False, "", moment)
        )

    def logger(self, level: str):
        """Return a log function that says which thread called it."""
        return lambda *words: self.logged.append((threading.current_thread().name, words[0] % words[1:]))

    def topic(self, name: str):
        """Return a publisher."""
        return SimpleNamespace(publish=lambda *message: self.publish(name, message))

    def publish(self, name: str, message: tuple) -> None:
        """Take what is published on a topic."""
        self.said.append((name, message))

    def grid(self):
        """Let all clocks run; the twin follows at once and the monitor is content."""
        for _ in range(self.cycles):
            self.wall, self.steady = self.wall + CYCLE_NS, self.steady + CYCLE_NS
            self.booted += CYCLE_NS
            if self.speaks:
                self.node.on_sync(Sync(state=Sync.IN_SYNC, agreed=True, policy="replan"))
            yield self.wall, 0
            setpoints = [message for name, message in self.said if name == "next/joint_states"]
            self.node.on_twin(*(setpoints[-1] if setpoints else (self.wall, ROBOT.home)))

    def run(self, cycles: int, speaks: bool = True) -> World:
        """Run some cycles, while the monitor speaks or not."""
        self.cycles, self.speaks = cycles, speaks
        self.node.run()
        return self

    def waiting(self):
        """Put a plan under review; return it."""
        self.node.on_link(Link(state=Link.ARMED, session="s"))
        self.node.on_scene(Scene(hash=SCENE))
        self.run(5)
        plan = make_plan(asked_ns=self.booted)
        self.executor.offer(plan)
        return plan

    def playing(self) -> World:
        """Play a plan."""
        plan = self.waiting()
        assert self.review(plan).success
        return self.run(50)

    def shown(self, age: float = 0.0) -> str:
        """Return the moment that a screen had received so long ago [s]."""
        return str(Moment("c0ffee00", self.booted - round(age * NANOSECONDS)))

    def from_screen(self, plan, moment: str, approve: bool = True):
        """Give a verdict as console_node does; return the answer."""
        return self.review(plan, approve, "kr120-reviewer-ada", moment=moment)

    def resume_from_screen(self, moment: str):
        """Resume as console_node does; return the answer."""
        return self.ask("~act_as_seen", ActAsSeenRequest("resume", "ada", moment))

    def slow_disk(self, seconds: float, wall: float | None = None) -> None:
        """Let every record take so long, while the wall clock goes on by `wall` [s] in its place."""

        def wait() -> None:
            self.booted += round(seconds * NANOSECONDS)
            self.wall += round((seconds if wall is None else wall) * NANOSECONDS)

        self.log.wait = wait

    def states(self) -> list[str]:
        """Return what was published on `execution`."""
        return [message[0].text for name, message in self.said if name == "execution"]


def records(folder) -> list[dict]:
    """Return the lines of the review record in a folder."""
    return [json.loads(line) for line in (folder / "reviews.jsonl").read_text().splitlines()]

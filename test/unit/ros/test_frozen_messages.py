"""What travels stays as it was at commit 95d0454d: JSON byte for byte, ROS messages field for field, for wide values.

`test/data/frozen_messages.json` was written by the code of that commit (`poses`, `plan` and `work list` by that of 1af7777a,
`view` and `poses` again with version 6 of the view): the first cases in full, and one SHA-256 over all of them.
What may change here is how the code is called, never what is expected.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import genpy
import pytest
from construction_twin.msg import Execution, Link, Plan, Signal, Sync, ToolSwitch, WorkTask, WorkTasks
from construction_twin.msg import SceneObject as SceneObjectMsg
from construction_twin.msg import Segment as SegmentMsg
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import Point
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment
from construction_twin.core.motion_errors import PlanningError
from construction_twin.core.records import dumped
from construction_twin.core.reports import ExecutionReport, LinkReport, SyncReport, WorkReport
from construction_twin.execution.states import ExecutorState
from construction_twin.link.remote_trajectory import Joints
from construction_twin.link.remote_view import ClosestView, PoseView, Seen, ViewWriter
from construction_twin.link.tool_link import tool_report
from construction_twin.mqtt.client import Broker
from construction_twin.robot.segments import Segment, segments_content
from construction_twin.ros.messages.convert import segment_to_msg, trajectory_from_msg
from construction_twin.ros.messages.records import from_msg, to_msg
from construction_twin.ros.messages.tool import tool_report_from_msg, tool_report_to_msg
from construction_twin.ros.nodes import executor as executor_node
from construction_twin.ros.nodes import mqtt_planner, mqtt_review
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.views.scene_view import scene_view
from construction_twin.views.snapshot import Snapshot
from construction_twin.views.texts import status_lines
from construction_twin.views.work_texts import list_lines, show_lines

FROZEN = Path(__file__).parents[2] / "data/frozen_messages.json"
#: Cases per kind of message, and how many of them are kept in full.
CASES, KEPT = 300, 4
NOW = 1_795_369_597_396_012_345
JOINTS = Joints(("track", "joint_a1"), (True, False))
TEXTS = ("", "a", "ä → ✓", 'say "no"', "two\nlines", "back\\slash", "</script>", "p1", "\U0001f9f1", "x" * 300)
NUMBERS = (0.0, -0.0, 1.0, -1.0, 1e-12, 0.1 + 0.2, math.pi, 1e300, 123456.7890123456, 5e-324)
ODD = (math.nan, math.inf, -math.inf)
WHOLE = (0, 1, 2, 7, 255)


class Wide:
    """Values from all over their ranges, the same in each run."""

    def __init__(self, seed: int):
        self.random = random.Random(seed)

    def text(self) -> str:
        return self.random.choice(TEXTS)

    def texts(self, most: int = 3) -> list[str]:
        return [self.text() for _ in range(self.random.randint(0, most))]

    def names(self, most: int = 4) -> list[str]:
        return [f"name_{k}_{self.text()}"[:64] for k in range(self.random.randint(0, most))]

    def number(self, odd: bool = True) -> float:
        return self.random.choice(NUMBERS + ODD if odd else NUMBERS)

    def numbers(self, most: int = 7) -> list[float]:
        return [self.number() for _ in range(self.random.randint(0, most))]

    def whole(self) -> int:
        return self.random.choice(WHOLE)

    def flag(self) -> bool:
        return self.random.random() < 0.5

    def time(self) -> genpy.Time:
        return genpy.Time(
            self.random.choice((0, 1, 1_795_369_597)), self.random.choice((0, 1, 396_012_345, 999_999_999))
        )

    def execution(self) -> Execution:
        state = self.random.choice(list(ExecutorState))
        message = Execution(
            state=state.value, text=state.name, plan_id=self.text(), plan_start=self.time(), duration=self.number(False),
            outcome=self.random.choice(("", "finished", "stopped", "held", "dropped")), reason=self.text(), rate=self.number(),
            speed_limit=self.number(), segment=self.random.choice((-1, 0, 1, 2)), segment_name=self.text(),
            at_boundary=self.flag(), wants_scene=self.flag(), expected_scene=self.text(), engaged=self.flag(),
        )  # fmt: skip
        message.header.stamp = self.time()
        return message

    def sync(self) -> Sync:
        return Sync(
            state=self.whole(), text=self.text(), reason=self.text(), policy=self.text(), agreed=self.flag(),
            comparison=self.text(), name=self.texts(), error=self.numbers(), threshold=self.numbers(),
            round_trip=self.number(), servo_lag=self.number(), held_stamp=self.time(), violations=self.whole(),
        )  # fmt: skip

    def link(self) -> Link:
        counters = [KeyValue(key, str(self.whole())) for key in ("telegrams", "late_replies", "missed") if self.flag()]
        return Link(
            state=self.whole(), text=self.text(), reason=self.text(), session=self.text(), gateway_state=self.text(),
            commands_refused=self.whole(), states_refused=self.whole(), gateway_counters=counters,
            gateway_kind=self.text(), responsible=self.text(), not_checked=self.texts(),
        )  # fmt: skip

    def tool_status(self) -> dict:
        switches = [
            {"id": name, "state": self.random.choice(("armed", "fired", "void", "refused")), "reason": self.text()}
            for name in self.names()
        ]
        signals = [{name: self.flag() for name in self.names()} for _ in range(2)]
        tool = {"known": self.flag(), "name": self.text(), "outputs": signals[0], "inputs": signals[1]}
        return {"tool": tool | {"switches": switches, "reason": self.text()}} if self.random.random() < 0.9 else {}

    def signal(self) -> Signal:
        return Signal(name=self.text(), value=self.flag())

    def signals(self) -> list[Signal]:
        return [self.signal() for _ in range(self.random.randint(0, 3))]

    def segment(self) -> SegmentMsg:
        switches = [
            ToolSwitch(output=self.text(), value=self.flag(), confirm=self.signals(), timeout=self.number(False))
            for _ in range(self.random.randint(0, 2))
        ]
        return SegmentMsg(
            name=self.text(), end=self.whole(), engaged=self.flag(), requires=self.signals(), switches=switches,
            scene=self.text(), scene_after=self.text(),
        )  # fmt: skip

    def plan(self) -> Plan:
        names = [f"joint_a{k}" for k in range(1, 3)]
        points = [
            JointTrajectoryPoint(
                positions=[self.number(False) for _ in names], velocities=[self.number(False) for _ in names],
                accelerations=[self.number() for _ in names], time_from_start=genpy.Duration(k, self.whole() if k else 0),
            )
            for k in range(self.random.choice((2, 3, 6)))
        ]  # fmt: skip
        message = Plan(
            asked="c0ffee00-7", id=self.text(), source=self.text(), planner=self.text(), scene=self.text(), duration=self.number(),
            planning_time=self.number(), trajectory=JointTrajectory(joint_names=names, points=points),
            tool_path=[Point(self.number(False) % 9.0, k * k / 7.0, self.number(False) % 3.0) for k in range(len(points))],
            clearance=self.number(), clearance_time=self.number(False), clearance_between=self.texts(2),
            clearance_point=Point(self.number(False), 0.0, 1.0), velocity_use=[0.5] * self.random.choice((0, 2)),
            acceleration_use=[self.number(False)], jerk_use=[],
        )  # fmt: skip
        message.header.frame_id = self.text()
        message.header.stamp = self.time()
        if self.flag():
            message.task, message.clearance = self.text(), 0.25
            message.segments = [self.segment() for _ in range(2)]
            first, last = message.segments
            first.end, last.end = 0.5, points[-1].time_from_start.to_nsec() / 1e9
            first.scene, first.scene_after, last.scene = message.scene, "after", "after"
            for point in points:
                point.accelerations = [self.number(False) for _ in names]
            for segment in message.segments:
                segment.put = [SceneObjectMsg(name=name) for name in self.names()]
                segment.remove = [self.text() for _ in range(self.random.choice((0, 1, 30)))]
                for switch in segment.switches:
                    switch.timeout = 0.5 + self.whole()
            message.hash = hash_of(message)
        return message

    def tasks(self) -> WorkTasks:
        message = WorkTasks(
            model=self.text(), model_hash=self.text(), schedule=self.text(), engaged=self.flag(), reading=self.flag(),
            next=self.text(), reason=self.text(), notes=self.texts(),
            tasks=[self.task() for _ in range(self.random.randint(0, 3))],
        )  # fmt: skip
        message.header.stamp = self.time()
        return message

    def task(self) -> WorkTask:
        return WorkTask(
            id=self.text(), name=self.text(), element=self.text(), element_name=self.text(), state=self.text(),
            reason=self.text(), after=self.texts(), robot=self.text(), plan_id=self.text(), deviation_mm=self.number(),
            deviation_deg=self.number(), question=self.text(), answers=self.texts(), mass_kg=self.number(),
            grip=self.text(), scheduled_start=self.text(), scheduled_duration=self.number(), begun=self.time(),
            settled=self.time(), tolerance_mm=self.number(), tolerance_deg=self.number(),
        )  # fmt: skip

    def scene(self) -> Scene:
        objects = tuple(
            SceneObject(f"box_{k}", "box", (1.0, 0.1 + 0.2, 2.0), position=(self.number(False) % 50.0, 0.0, 1.0))
            for k in range(self.random.randint(0, 3))
        )
        return Scene(objects, self.random.choice((0.0, 0.01)))


def raw(message: genpy.Message) -> str:
    """Return a message as it goes over the wire, in hex after the text that a reader of it has."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    read = type(message)().deserialize(buffer.getvalue())
    return f"{read}\n{buffer.getvalue().hex()}"


def views(wide: Wide) -> str:
    """Return two views of the node after reports of all kinds."""
    node = mqtt_planner.MqttPlanner(
        mqtt_planner.Settings(
            host="127.0.0.1", port=1, max_trajectory_bytes=4096, view_rate=25.0, max_pose_age=0.25
        ),
        "kr120", JOINTS, Broker("127.0.0.1", 1), SimpleNamespace(is_connected=lambda: False),
        ViewWriter("kr120", "cafe", JOINTS), None, None,
    )  # fmt: skip
    node.listen(mqtt_planner.Poses(None, None), lambda: True)
    shown = []
    for _ in range(2):
        if wide.flag():
            node.on_sync(wide.sync())
        if wide.flag():
            node.on_link(wide.link())
        node.on_execution(wide.execution())
        shown.append(node.publish_view().decode())
    return "\n".join(shown)


def poses(wide: Wide) -> str:
    """Return a view of poses and of what is closest to the arm."""
    where = [
        PoseView(wide.number(False) % 1e9, wide.whole() / 7.0, tuple(wide.number(False) for _ in JOINTS.names))
        for _ in range(2)
    ]
    near = ClosestView(wide.number(), (wide.text(), wide.text()), (0.1, wide.number(False), 1.0), wide.whole() / 7.0)
    seen = Seen(where[0] if wide.flag() else None, where[1], closest=near if wide.flag() else None, plan=wide.text())
    return ViewWriter("kr120", "cafe", JOINTS).write(NOW, seen, Moment("c0ffee00", 81_234_567_890)).decode()


def plan_payload(wide: Wide) -> str:
    """Return what a tablet gets to see of a plan."""
    return mqtt_review.plan_view(wide.plan()).to_json(3).decode()


def work_list(wide: Wide) -> str:
    """Return what a terminal shows of the tasks."""
    work = from_msg(WorkReport, wide.tasks())
    return "\n".join([*list_lines(work), *(line for task in work.tasks for line in show_lines(work, task))])


def execution_message(wide: Wide) -> str:
    """Return what the executor publishes of itself."""
    names = [SimpleNamespace(name=wide.text()) for _ in range(3)]
    plan = SimpleNamespace(id=wide.text(), segments=names, trajectory=SimpleNamespace(duration=wide.number(False)))
    said = executor_node.ExecutionFields(
        wide.random.choice(list(ExecutorState)), wide.text(), wide.whole() * 10**9 + 7, wide.text(), wide.flag(),
        wide.number(), wide.random.choice((-1, 0, 1, 2)), wide.flag(), wide.text(), wide.flag(),
    )  # fmt: skip
    return raw(
        to_msg(
            executor_node.execution_report(said, plan if wide.flag() else None, wide.number(), wide.number(), NOW),
            Execution,
        )
    )


def tool_message(wide: Wide) -> str:
    """Return what the bridge publishes of a gateway's status, and what the executor reads of that."""
    message = tool_report_to_msg(tool_report(wide.tool_status()), genpy.Time(7, 8))
    read = tool_report_from_msg(message)
    switches = {id: (switch.state.name, switch.reason) for id, switch in read.switches.items()}
    return f"{raw(message)}\n{(read.known, read.tool, tuple(read.outputs), dict(read.inputs), switches, read.reason)}"


def screen(wide: Wide) -> str:
    """Return what a terminal shows of the three reports."""
    executing = wide.execution()
    facts = (
        from_msg(LinkReport, wide.link()),
        from_msg(SyncReport, wide.sync()),
        from_msg(ExecutionReport, executing),
    )
    snapshot = Snapshot("kr120", NOW / 1e9, JOINTS.names, JOINTS.linear, *facts)
    progress = facts[2].progress(executing.plan_start.to_sec() + 1.0)
    return "\n".join([*status_lines(snapshot), *snapshot.not_ready(), repr(progress)])


def followed(wide: Wide) -> str:
    """Return what the work node reads of the executor."""
    read = from_msg(ExecutionReport, wide.execution())
    return repr((read.plan_id, read.playing, read.ended, read.segment, read.at_boundary, read.wants_scene, read.reason))


def hash_of(message: Plan) -> str:
    """Return the hash of a work plan, when it can have one."""
    trajectory = trajectory_from_msg(message.trajectory)
    segments = tuple(from_msg(Segment, segment) for segment in message.segments)
    content = segments_content(trajectory.content_hash(), message.task, segments)
    return hashlib.sha256(content.encode()).hexdigest()


KINDS: dict[str, Callable[[Wide], str]] = {
    "view": views,
    "poses": poses,
    "plan": plan_payload,
    "work list": work_list,
    "execution": execution_message,
    "tool": tool_message,
    "screen": screen,
    "followed": followed,
    "segment": lambda wide: raw(segment_to_msg(from_msg(Segment, wide.segment()))),
    "tasks": lambda wide: dumped(from_msg(WorkReport, wide.tasks())).decode(),
    "scene": lambda wide: dumped(scene_view(wide.scene(), "kr120/base_link")).decode(),
}


def made(kind: str) -> Iterator[str]:
    """Make the cases of a kind; an error is a case too."""
    for seed in range(CASES):
        try:
            yield KINDS[kind](Wide(seed))
        except (ValueError, OverflowError, PayloadError, PlanningError, KeyError) as error:
            yield f"{type(error).__name__}: {error}"


def frozen(kind: str) -> dict:
    """Return what is kept of a kind."""
    cases = list(made(kind))
    return {"first": cases[:KEPT], "all": hashlib.sha256("\0".join(cases).encode()).hexdigest()}


@pytest.fixture
def still(monkeypatch):
    """Clocks that stand."""
    monkeypatch.setattr(mqtt_planner.time, "monotonic", lambda: 1000.0)
    monkeypatch.setattr(mqtt_planner, "now_ns", lambda: NOW)
    monkeypatch.setattr(mqtt_planner, "present", lambda: Moment("c0ffee00", 81_234_567_890))
    monkeypatch.setattr(mqtt_planner.rospy.Time, "now", lambda: genpy.Time(7, 8))


@pytest.mark.parametrize("kind", KINDS)
def test_what_travels_is_what_it_was(kind, still):
    assert frozen(kind) == json.loads(FROZEN.read_text())[kind]

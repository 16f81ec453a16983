"""What consoles are told beside `view`, and the files that they get, without ROS master and broker."""

from __future__ import annotations

import hashlib
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from construction_twin.msg import (
    Execution,
    Hold,
    Link,
    Plan,
    Segment,
    Sync,
    WorkTask,
    WorkTasks,
)
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import Point
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import PoseUnknownError
from construction_twin.core.freshness import parse_moment
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.nodes import feed as module
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.nodes.feed import ARM, EXPECTED, TWIN, ConsoleFeed, deployment_of
from construction_twin.extensions.console.private_files import PrivateFiles
from construction_twin.extensions.console.remote_view import ViewWriter
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.ros.transport.joint_stream import to_time
from construction_twin.ros.transport.latest_pose import StampedPose
from construction_twin.scene.mesh_file import binary_stl, parse_mesh
from construction_twin.scene.objects import Scene, SceneObject

TOPICS = Topics("twin", "kr120")
JOINTS = Joints(("joint_a1", "track"), (False, True))
STARTED = {"arm": "mock", "broker": "b:1", "rsi": "r:2", "gateway": True, "gateway_kind": "rsi"}
CORNERS = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=float)
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\n"


class Client:
    """In place of the connection: remembers what is published."""

    def __init__(self):
        self.published: list[tuple[str, object, int, bool]] = []
        self.refused: list[str] = []
        # happens before the next message is taken
        self.meanwhile = None

    def publish(self, topic, payload, qos=0, retain=False):
        meanwhile, self.meanwhile = self.meanwhile, None
        if meanwhile is not None:
            meanwhile()
        self.published.append((topic, json.loads(payload) if payload else None, qos, retain))

    def is_connected(self):
        return True

    def refuse(self, reason, sentence):
        self.refused.append(reason)

    def newest(self, topic):
        return next((content for name, content, _, _ in reversed(self.published) if name == topic), None)


@pytest.fixture
def clock(monkeypatch):
    """Clocks that the test sets."""
    made = SimpleNamespace(steady=1000.0, wall=1_764_000_000.0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: made.steady))
    monkeypatch.setattr(module, "now_ns", lambda: round(made.wall * NANOSECONDS))
    return made


@pytest.fixture
def broker():
    return Client()


def feed(
    broker: Client,
    files: PrivateFiles | None = None,
    started: dict | None = STARTED,
    poses: dict | None = None,
    **others,
) -> ConsoleFeed:
    connection = Connection(Broker("127.0.0.1", 1), broker, TOPICS, broker.refuse)
    writer = ViewWriter("kr120", "cafe", JOINTS)
    others |= {"deployment": deployment_of(started, "/kr120"), "files": files}
    return ConsoleFeed("base_link", connection, writer, poses or {}, **others)


def scene(folder) -> Scene:
    path = folder / "wedge.obj"
    path.write_text(OBJ)
    return Scene(
        (
            SceneObject("floor", "box", (4.0, 4.0, 0.1), (0.0, 0.0, -0.05), fixed=True),
            SceneObject(
                "wedge", "mesh", (1.0, 1.0, 2.0), (1.0, 0.0, 0.0), mesh=str(path), link="tool0", touch=("link_6",)
            ),
        ),
        0.02,
    )


def message(given: Scene):
    return scene_to_msg(given, rospy.Time(1), "kr120/twin/base_link")


def told(made: ConsoleFeed, broker: Client, **changes) -> dict[str, dict]:
    """Return the status line, by topic, with reports that have just come; None: that one stays away."""
    reports = {"link": Link(text="ARMED"), "sync": Sync(text="IN_SYNC"), "execution": Execution(text="IDLE")} | changes
    for name, report in reports.items():
        if report is not None:
            getattr(made, f"on_{name}")(report)
    made.publish_status_line()
    return {line["topic"]: line for line in broker.newest(TOPICS.screen)}


def test_the_scene_is_retained_with_its_meshes_by_digest_and_their_files_are_there_before(tmp_path, broker):
    given, private = scene(tmp_path), tmp_path / "private"
    feed(broker, PrivateFiles(private, "kr120")).on_scene(message(given))
    (topic, told_scene, qos, retained) = broker.published[0]
    assert (topic, qos, retained) == ("twin/kr120/scene", 1, True)
    assert (told_scene["hash"], told_scene["frame"], told_scene["padding"]) == (given.hash, "base_link", 0.02)
    floor, wedge = told_scene["objects"]
    assert (floor["shape"], floor["size"], floor["mesh"], floor["link"]) == ("box", [4.0, 4.0, 0.1], "", "")
    assert (wedge["size"], wedge["position"], wedge["orientation"]) == (
        [1.0, 1.0, 2.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    )
    assert (wedge["mesh"], wedge["link"], wedge["touch"]) == (
        hashlib.sha256(OBJ.encode()).hexdigest(),
        "tool0",
        ["link_6"],
    )
    contents = (private / "mesh" / f"{wedge['mesh']}.stl").read_bytes()
    vertices, triangles = parse_mesh("wedge", "wedge.stl", contents, (1.0, 1.0, 1.0))
    np.testing.assert_array_equal(vertices[triangles], CORNERS)
    assert contents == binary_stl(CORNERS)


def test_a_scene_whose_meshes_cannot_be_written_or_read_is_refused_and_not_told(tmp_path, broker):
    (tmp_path / "private").write_text("a file")
    made = feed(broker, PrivateFiles(tmp_path / "private", "kr120"))
    made.on_scene(message(scene(tmp_path)))
    changed = message(scene(tmp_path))
    changed.hash = "0" * 64
    made.on_scene(changed)
    assert broker.refused == ["scene", "scene"] and broker.published == []


def test_tasks_are_retained_and_what_is_not_placed_has_no_deviation(broker):
    tasks = [
        WorkTask(id="t1", state="done", deviation_mm=1.5, deviation_deg=0.25, element="e1"),
        WorkTask(id="t2", state="asks", deviation_mm=float("nan"), deviation_deg=float("nan"), answers=["in_grip"]),
    ]
    made = feed(broker)
    made.on_tasks(WorkTasks(model="wall.ifc", schedule="model", next="", reason="t2 asks first", tasks=tasks))
    document = broker.newest("twin/kr120/work/tasks")
    first, second = document["tasks"]
    assert (document["model"], document["engaged"]) == ("wall.ifc", False)
    assert (first["deviation_mm"], second["deviation_mm"], second["deviation_deg"]) == (1.5, None, None)
    assert set(first) == set(WorkTask.__slots__)
    assert set(document) == set(WorkTasks.__slots__) - {"header", "said"} | {"stamp"}
    work = told(made, broker)["work"]
    assert (work["state"], work["who"]) == ("asks", "operator") and work["sentence"].endswith(": t2 asks first")


def test_the_status_line_is_sent_on_change_and_once_a_second(broker, clock):
    made = feed(broker)
    for _ in range(100):
        told(made, broker)
        clock.steady += 0.04
    lines = [entry for entry in broker.published if entry[0] == TOPICS.screen]
    assert len(lines) == 4 and lines[0][2:] == (1, False)
    clock.steady += 0.3
    told(made, broker, sync=Sync(text="HOLDING", reason="joint_a3"))
    assert [line["topic"] for line in broker.newest(TOPICS.screen)[:2]] == ["startup", "sync"]
    assert [topic for topic, *_ in broker.published if topic != TOPICS.messages] == [TOPICS.screen] * 5


def test_why_the_arm_holds_comes_first_and_a_plan_that_could_not_be_approved_waits(broker, clock):
    made = feed(broker, plan=lambda: "p1")
    made.on_hold(Hold(cause="last comparable feedback is 0.300 s old", since=rospy.Time(5)))
    waits = Execution(text="IDLE", approval_obstacle="not in sync")
    held = told(made, broker, sync=Sync(text="STALE", reason="silence"), execution=waits)
    assert next(iter(held)) == "cause" and "is 0.300 s old, since " in held["cause"]["sentence"]
    assert held["execution"]["state"] == "NOT_YET" and held["execution"]["sentence"].endswith(": not in sync")
    clock.steady += 1.0
    assert "cause" not in told(made, broker, sync=None), "a monitor that is silent says nothing of the present"
    made.on_hold(Hold())
    clock.steady += 1.0
    mended = told(made, broker)
    assert "cause" not in mended and mended["execution"]["state"] == "REVIEW"


def plan(name: str, rows: int = 3, ends: tuple[float, ...] = ()) -> Plan:
    """Return a plan of one second per waypoint, whose tool goes along x."""
    points = [JointTrajectoryPoint(time_from_start=rospy.Duration(k)) for k in range(rows)]
    path = [Point(float(k), 0.0, 1.0) for k in range(rows)]
    trajectory = JointTrajectory(points=points)
    return Plan(id=name, trajectory=trajectory, tool_path=path, segments=[Segment(end=end) for end in ends])


def playing(name: str, state: str = "PLAYING") -> Execution:
    return Execution(text=state, plan_id=name)


def test_the_path_of_what_is_played_is_retained_until_it_has_ended(broker):
    made = feed(broker)
    made.on_plan(plan("p1"))
    assert broker.published == []
    made.on_execution(playing("p1"))
    path = {"plan_id": "p1", "times": [0.0, 1.0, 2.0], "tool_path": [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [2.0, 0.0, 1.0]]}
    assert broker.published == [(TOPICS.path, path, 1, True)]
    # another plan may be under review meanwhile, and the executor reports each change of its rate
    made.on_plan(plan("p2"))
    for state in ("PAUSING", "PAUSED", "HELD", "AT_BOUNDARY", "PLAYING", "STOPPING"):
        made.on_execution(playing("p1", state))
    assert len(broker.published) == 1
    made.on_execution(playing("p1", "IDLE"))
    assert broker.published[1:] == [(TOPICS.path, None, 1, True)]


def test_a_new_connection_gets_everything_again_and_a_farewell_takes_it_away(tmp_path, broker, clock):
    made = feed(broker)
    made.on_scene(message(scene(tmp_path)))
    told(made, broker)
    broker.published.clear()
    made.republish_retained()
    clock.steady += 0.3
    told(made, broker)
    assert [topic for topic, *_ in broker.published] == [TOPICS.scene, TOPICS.messages, TOPICS.screen]
    made.publish_offline()
    assert broker.published[-2:] == [(TOPICS.scene, None, 1, True), (TOPICS.messages, None, 1, True)]


# -- view


def reports(made: ConsoleFeed, clock) -> None:
    made.on_sync(
        Sync(text="IN_SYNC", reason="agree", agreed=True, error=[0.1, 0.2], threshold=[1.0, 1.0], servo_lag=0.01)
    )
    made.on_link(Link(text="ARMED", gateway_state="following", gateway_kind="rsi"))
    execution = Execution(text="PLAYING", plan_id="p1", duration=10.0, rate=1.0, speed_limit=1.0)
    execution.header.stamp = execution.plan_start = to_time(round(clock.wall * NANOSECONDS))
    made.on_execution(execution)


class Stream:
    """In place of a LatestPose; None: nothing was heard."""

    def __init__(self, pose: StampedPose | None = None):
        self.pose = pose

    def newest(self, oldest: float) -> StampedPose:
        if self.pose is None:
            raise PoseUnknownError("twin/joint_states", math.inf, oldest)
        return self.pose


def test_the_view_shows_what_is_known(broker, clock):
    stamp = round((clock.wall - 0.01) * NANOSECONDS)
    poses = (((0.5, 1.5), 999.99), ((0.4, 1.4), 999.98), ((0.401, 1.399), 999.97))
    made = feed(
        broker, poses=dict(zip((TWIN, ARM, EXPECTED), (Stream(StampedPose(pose, stamp, at)) for pose, at in poses)))
    )
    reports(made, clock)
    clock.steady += 0.04
    clock.wall += 2.5
    message = json.loads(made.publish_view())
    assert message["twin"] == {"stamp": 1_763_999_999.99, "age": 0.05, "positions": [0.5, 1.5]}
    assert message["arm"] == {"stamp": 1_763_999_999.99, "age": 0.06, "positions": [0.4, 1.4]}
    assert message["expected"] == {"stamp": 1_763_999_999.99, "age": 0.07, "positions": [0.401, 1.399]}
    assert (message["sync"]["state"], message["sync"]["age"], message["link"]["state"]) == ("IN_SYNC", 0.04, "ARMED")
    assert (message["execution"]["state"], message["execution"]["progress"]) == ("PLAYING", 0.25)
    assert broker.published[-1] == (TOPICS.view, message, 0, False)


def test_what_is_old_is_shown_as_not_known(broker, clock):
    there = [True]
    made = feed(broker, poses={TWIN: Stream(), ARM: Stream(), EXPECTED: Stream()}, executor_is_there=lambda: there[0])

    def view() -> dict:
        return json.loads(made.publish_view())

    reports(made, clock)
    clock.steady += 1.0
    message = view()
    assert message["twin"] is message["arm"] is message["expected"] is message["sync"] is None
    assert message["link"]["age"] == 1.0
    clock.steady += 3.0
    assert view()["link"] is None and view()["execution"]["state"] == "PLAYING"
    there[0] = False
    assert view()["execution"] is None, "its node is gone"


def test_the_view_has_what_only_a_console_shows(broker, clock):
    made = feed(broker, plan=lambda: "p7")

    def view() -> dict:
        return json.loads(made.publish_view())

    made.on_link(Link(text="ARMED", gateway_counters=[KeyValue("telegrams", "9"), KeyValue("late_replies", "3")]))
    made.on_sync(Sync(text="IN_SYNC", round_trip=0.0321))
    made.on_hold(Hold(cause="joint_a3 differs", since=rospy.Time(7)))
    boundary = Execution(text="AT_BOUNDARY", segment=1, segment_name="carry", at_boundary=True, engaged=True)
    boundary.approval_obstacle, boundary.overridable = "not in sync", True
    made.on_execution(boundary)
    message = view()
    assert message["plan"] == "p7"
    assert (message["link"]["round_trip_ms"], message["link"]["late"]) == (32.1, 3)
    assert message["hold"] == {"cause": "joint_a3 differs", "since": 7.0}
    assert (message["approval_obstacle"], message["overridable"]) == ("not in sync", True)
    parse_moment(message["moment"])
    assert message["execution"]["segment"] == {"number": 1, "name": "carry", "at_boundary": True}
    assert made.is_engaged()
    made.on_link(Link(text="ARMED", gateway_counters=[KeyValue("telegrams", "9")]))
    made.on_execution(Execution(text="IDLE", segment=-1))
    assert view()["link"]["late"] == 0 and view()["execution"]["segment"] is None
    made.on_link(Link(text="GATEWAY_OFFLINE"))
    assert view()["link"]["late"] is None
    clock.steady += 10.0
    assert view()["hold"] is None, "what is silent is not the present"

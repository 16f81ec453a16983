"""What consoles are told beside `view`, and the files that they get, without ROS master and broker."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from xml.etree import ElementTree

import genpy
import numpy as np
import pytest
import rospy
from construction_twin.msg import (
    Execution,
    Hold,
    Link,
    Plan,
    Rehearsal,
    Review,
    Segment,
    SpeedChange,
    Sync,
    WorkTask,
    WorkTasks,
)
from geometry_msgs.msg import Point
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.reports import ExecutionReport
from construction_twin.core.sentences import Sentence
from construction_twin.mqtt.messages import Topics
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.ros.shared.console_feed import PATH_POINTS, ConsoleFeed, deployment_of
from construction_twin.ros.shared.pose_judge import PoseJudge
from construction_twin.ros.shared.private_files import PrivateFiles, shown_urdf
from construction_twin.scene.mesh_file import binary_stl, parse_mesh
from construction_twin.scene.objects import Scene, SceneObject

ROOT = Path(__file__).resolve().parents[3]
TOPICS = Topics("twin", "kr120")
STARTED = {"arm": "mock", "broker": "b:1", "rsi": "r:2", "gateway": True, "gateway_kind": "rsi"}
CORNERS = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=float)
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\n"


class Broker:
    """In place of the connection: remembers what is published."""

    def __init__(self):
        self.published: list[tuple[str, object, int, bool]] = []
        self.refused: list[str] = []
        # happens before the next message is taken
        self.meanwhile = None

    def publish(self, topic, payload, qos, retain):
        meanwhile, self.meanwhile = self.meanwhile, None
        if meanwhile is not None:
            meanwhile()
        self.published.append((topic, json.loads(payload) if payload else None, qos, retain))

    def refuse(self, reason, sentence):
        self.refused.append(reason)

    def newest(self, topic):
        return next((content for name, content, _, _ in reversed(self.published) if name == topic), None)


@pytest.fixture
def broker():
    return Broker()


def feed(broker: Broker, files: PrivateFiles | None = None, started: dict | None = STARTED) -> ConsoleFeed:
    return ConsoleFeed(TOPICS, "base_link", broker.publish, broker.refuse, deployment_of(started, "/kr120"), files)


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


def told(made: ConsoleFeed, broker: Broker, now: float, **changes) -> dict[str, dict]:
    reports = {"link": Link(text="ARMED"), "sync": Sync(text="IN_SYNC"), "execution": Execution(text="IDLE")} | changes
    made.publish_status_line(reports["link"], reports["sync"], reports["execution"], now)
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


def test_a_scene_that_comes_during_the_welcome_is_the_one_that_stays(tmp_path, broker):
    given = scene(tmp_path)
    newer = Scene(given.objects[:1], 0.03)
    made = feed(broker)
    made.on_scene(message(given))
    broker.meanwhile = lambda: made.on_scene(message(newer))
    made.publish_retained()
    assert broker.newest(TOPICS.scene)["hash"] == newer.hash


def test_a_scene_whose_meshes_cannot_be_written_or_read_is_refused_and_not_told(tmp_path, broker):
    (tmp_path / "private").write_text("a file")
    made = feed(broker, PrivateFiles(tmp_path / "private", "kr120"))
    made.on_scene(message(scene(tmp_path)))
    changed = message(scene(tmp_path))
    changed.hash = "0" * 64
    made.on_scene(changed)
    assert broker.refused == ["scene", "scene"] and broker.published == [] and made.scene is None


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
    assert set(document) == set(WorkTasks.__slots__) - {"header"} | {"stamp"}
    work = told(made, broker, 10.0)["work"]
    assert (work["state"], work["who"]) == ("asks", "operator") and work["sentence"].endswith(": t2 asks first")


def test_the_status_line_is_sent_on_change_and_once_a_second(broker):
    made = feed(broker)
    for step in range(100):
        told(made, broker, 10.0 + step * 0.04)
    lines = [entry for entry in broker.published if entry[0] == TOPICS.screen]
    assert len(lines) == 4 and lines[0][2:] == (1, False)
    told(made, broker, 14.3, sync=Sync(text="HOLDING", reason="joint_a3"))
    assert [line["topic"] for line in broker.newest(TOPICS.screen)[:2]] == ["startup", "sync"]
    assert [topic for topic, *_ in broker.published if topic != TOPICS.messages] == [TOPICS.screen] * 5


def test_what_the_start_waits_for_is_told_where_it_is_known(tmp_path, broker):
    made = feed(broker)
    assert told(made, broker, 10.0)["startup"]["waits_for"] == "the first pose of the arm"
    made.note_poses(twin=True, arm=True)
    assert told(made, broker, 11.0)["startup"]["waits_for"] == "the scene"
    made.on_scene(message(scene(tmp_path)))
    made.note_poses(twin=False, arm=False)
    assert told(made, broker, 12.0)["startup"]["state"] == "ready", "what has come has come"
    silent = told(made, broker, 13.0, link=None)
    assert (silent["link"]["state"], silent["startup"]["waits_for"]) == ("", "the bridge")
    assert "startup" not in told(feed(broker, started=None), broker, 10.0)
    assert "startup" not in told(feed(broker, started={"arm": "mock"}), broker, 10.0)


def test_why_the_arm_holds_comes_first_and_a_plan_that_could_not_be_approved_waits(broker):
    made = feed(broker)
    made.on_plan(Plan(id="p1"))
    made.on_hold(Hold(cause=str(Sentence("reason.gate.feedback_old", age=0.3)), since=rospy.Time(5)))
    made.on_approval_obstacle(String("not in sync"))
    held = told(made, broker, 10.0, sync=Sync(text="STALE", reason="silence"))
    assert next(iter(held)) == "cause" and held["cause"]["said"]["key"] == "reason.holds.because"
    assert (held["execution"]["words"], held["execution"]["reason"]) == ("execution.NOT_YET", "not in sync")
    assert (made.approval_obstacle, made.hold.since) == ("not in sync", 5 * 10**9)
    assert "cause" not in told(made, broker, 11.0, sync=None), "a monitor that is silent says nothing of the present"
    made.on_hold(Hold())
    made.on_approval_obstacle(String())
    mended = told(made, broker, 12.0)
    assert "cause" not in mended and mended["execution"]["words"] == "execution.REVIEW"


def test_the_plan_under_review_is_known_until_it_is_decided_or_void(broker):
    made = feed(broker)
    made.on_plan(Plan(id="p1"))
    assert made.plan == "p1" and told(made, broker, 10.0)["execution"]["who"] == "reviewer"
    made.on_review(Review(plan_id="p1"))
    assert made.plan == ""
    made.on_link(Link(session="one"))
    made.on_plan(Plan(id="p2"))
    made.on_link(Link(session="one"))
    made.on_link(Link(session=""))
    assert made.plan == "p2"
    made.on_link(Link(session="two"))
    assert made.plan == ""


def test_an_approval_names_the_engine_of_the_rehearsal_and_what_it_found(broker):
    made = feed(broker)

    def approved(name: str, at: int) -> dict:
        made.on_review(Review(Header(stamp=rospy.Time(at)), name, f"hash of {name}", True, "ada", ""))
        return broker.newest(TOPICS.messages)[-1]["line"]

    made.on_rehearsal(Rehearsal(plan_id="p1", plan_hash="hash of p1", state="passed", engine="MuJoCo 4.0.0"))
    made.on_rehearsal(Rehearsal(plan_id="p2", plan_hash="of another", state="passed", engine="MuJoCo 4.0.0"))
    made.on_rehearsal(Rehearsal(plan_id="p3", plan_hash="hash of p3", state="broken"))
    line = approved("p1", 1)
    assert line["values"] == {"person": "ada", "engine": "MuJoCo 4.0.0", "found": "passed"}
    assert line["sentence"] == "ada approved a plan. Its rehearsal (MuJoCo 4.0.0): passed"
    # one of another hash, one of which no engine is known, and none
    for at, name in enumerate(("p2", "p3", "p4"), 2):
        assert approved(name, at)["sentence"] == "ada approved a plan."


def plan(name: str, rows: int = 3, ends: tuple[float, ...] = ()) -> Plan:
    """Return a plan of one second per waypoint, whose tool goes along x."""
    points = [JointTrajectoryPoint(time_from_start=rospy.Duration(k)) for k in range(rows)]
    path = [Point(float(k), 0.0, 1.0) for k in range(rows)]
    trajectory = JointTrajectory(points=points)
    return Plan(id=name, trajectory=trajectory, tool_path=path, segments=[Segment(end=end) for end in ends])


def playing(name: str, state: str = "PLAYING") -> ExecutionReport:
    return ExecutionReport(state, "", name)


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


def test_a_node_that_is_started_in_a_motion_tells_its_path_whatever_it_hears_first(broker):
    made = feed(broker)
    made.on_execution(playing("p1"))
    made.on_plan(plan("p2"))
    assert broker.published == []
    made.on_plan(plan("p1"))
    assert broker.newest(TOPICS.path)["plan_id"] == "p1"


def test_a_long_path_is_thinned_and_keeps_the_ends_of_its_segments(broker):
    made = feed(broker)
    made.on_plan(plan("p1", 2001, (777.0, 2000.0)))
    made.on_execution(playing("p1"))
    path = broker.newest(TOPICS.path)
    assert len(path["times"]) == PATH_POINTS + 1 and 777.0 in path["times"] and path["times"][-1] == 2000.0
    assert [point[0] for point in path["tool_path"]] == path["times"]


def test_a_plan_whose_tool_path_is_not_that_of_its_waypoints_has_no_path(broker):
    made, odd = feed(broker), plan("p1")
    odd.tool_path.pop()
    made.on_plan(odd)
    made.on_execution(playing("p1"))
    assert broker.published == []


def test_a_new_connection_gets_everything_again_and_a_farewell_takes_it_away(tmp_path, broker):
    made = feed(broker)
    made.on_scene(message(scene(tmp_path)))
    told(made, broker, 10.0)
    broker.published.clear()
    made.publish_retained()
    told(made, broker, 10.3)
    assert [topic for topic, *_ in broker.published] == [TOPICS.scene, TOPICS.messages, TOPICS.screen]
    made.publish_offline()
    assert broker.published[-2:] == [(TOPICS.scene, None, 1, True), (TOPICS.messages, None, 1, True)]


# -- the robot's model


def urdf(mesh: str) -> str:
    shape = f'<geometry><mesh filename="{mesh}"/></geometry>'
    box = '<geometry><box size="1 1 1"/></geometry>'
    return (
        f'<?xml version="1.0" encoding="utf-8"?><robot name="r"><link name="a"><visual>{shape}</visual><visual>{box}</visual>'
        f"<collision>{shape}</collision></link></robot>"
    )


def test_a_urdf_names_its_meshes_by_digest_and_has_no_collision_shapes(tmp_path):
    mesh = tmp_path / "arm.STL"
    mesh.write_bytes(binary_stl(CORNERS))
    name = hashlib.sha256(mesh.read_bytes()).hexdigest() + ".stl"
    shown = shown_urdf(urdf(f"file://{mesh}"), "/private/mesh/")
    link = ElementTree.fromstring(shown.text).find("link")
    assert [tag.tag for tag in link] == ["visual", "visual"] and shown.problems == ()
    assert link.find("visual/geometry/mesh").get("filename") == f"/private/mesh/{name}"
    assert shown.meshes == {name: mesh.read_bytes()}


@pytest.mark.parametrize("name", ["missing.stl", "arm.step", "package://nowhere_at_all/arm.stl"])
def test_a_shape_whose_mesh_cannot_be_used_is_left_out_and_named(tmp_path, name):
    (tmp_path / "arm.step").write_text("x")
    shown = shown_urdf(urdf(name if "://" in name else str(tmp_path / name)), "/private/mesh/")
    assert len(shown.problems) == 1 and name in shown.problems[0] and shown.meshes == {}
    assert len(ElementTree.fromstring(shown.text).findall("link/visual")) == 1


def test_the_robot_and_the_building_are_written_into_a_folder_of_their_own(tmp_path):
    mesh = tmp_path / "arm.stl"
    mesh.write_bytes(binary_stl(CORNERS))
    files = PrivateFiles(tmp_path / "private", "kr120")
    assert files.write_robot(urdf(str(mesh))) == ()
    files.write_building(b"glTF")
    found = sorted(path.relative_to(tmp_path / "private").as_posix() for path in (tmp_path / "private").rglob("*.*"))
    assert found[:2] == ["kr120/building.glb", "kr120/robot.urdf"] and found[2].startswith("mesh/") and len(found) == 3
    files.drop_building()
    files.drop_building()
    assert not (tmp_path / "private/kr120/building.glb").exists()
    with pytest.raises(ConfigurationError):
        files.write_robot("<robot")


# -- poses that are dragged


def test_a_pose_judge_that_knows_too_little_says_so():
    kr120 = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
    judge = PoseJudge(kr120, "", lambda: Scene())
    with pytest.raises(ConfigurationError, match="self_collision"):
        judge.judge((1.0, 0.0, 1.0), np.eye(3), kr120.home)
    assert judge.closest(kr120.home) is None
    blind = PoseJudge(kr120, "/some.yaml", lambda: None)
    with pytest.raises(ConfigurationError, match="scene"):
        blind.judge((1.0, 0.0, 1.0), np.eye(3), kr120.home)
    assert blind.closest(kr120.home) is None


def test_who_has_set_the_speed_limit_is_among_the_messages(broker):
    made = feed(broker)
    made.on_speed_change(SpeedChange(stamp=genpy.Time(7), person="dora", limit=0.6, before=0.3, whose="bob"))
    ((message,),) = [content for topic, content, *_ in broker.published if topic == TOPICS.messages]
    assert message["line"]["values"] == {"person": "dora", "percent": "60", "before": "30"}
    assert (message["line"]["words"], message["at"], message["until"]) == ("person.raised", 7.0, 7.0)

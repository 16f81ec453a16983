"""The planner node's work plans: what plan_work publishes and refuses, the way back, and nothing else while engaged."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
import tf2_ros
import yaml
from bridge_bench import Client
from construction_twin.msg import Engagement, Review, Signal, ToolSwitch, WorkSegment
from construction_twin.srv import (
    PlanCartesianRequest,
    PlanToJointsRequest,
    PlanToPoseRequest,
    PlanTrajectoryRequest,
    PlanWorkRequest,
    PlanWorkResponse,
)
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from launch_files import twin_in_tf
from planning_cell import HOME, LEFT, RIGHT, ROBOT, ROOT, standing
from scene_samples import box_triangles, write_stl
from std_srvs.srv import TriggerRequest
from tf2_msgs.msg import TFMessage
from unplugged import Subscriber, Unplugged, over_the_wire

from construction_twin.extensions.console.nodes import endpoint, requests
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.planning import requests as plan_requests
from construction_twin.planning.timing import time_path
from construction_twin.replay import failure
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.robot.motion_errors import SceneError
from construction_twin.ros.messages import convert
from construction_twin.ros.messages.scene_convert import object_to_msg, scene_to_msg
from construction_twin.ros.nodes import planner as module
from construction_twin.ros.nodes.planner import NODE, Settings
from construction_twin.ros.shared import frames
from construction_twin.ros.shared.frames import Frames
from construction_twin.ros.transport import subscriber
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.scene_change import SceneChange

HELD = SceneObject("block", "box", (0.3, 0.3, 0.3), (0.0, 0.0, 0.25), link="tool0")
BLOCK = standing(HELD, RIGHT)
SCENE = Scene((BLOCK,), 0.01)


class Bench:
    """The node without ROS: its topics and services as calls, its messages through the wire format."""

    def __init__(self, monkeypatch, tf_prefix: str = "", tf: tf2_ros.Buffer | None = None):
        self.pose = tuple(HOME)
        tf = tf2_ros.Buffer(debug=False) if tf is None else tf
        values = yaml.safe_load((ROOT / "config/planner.yaml").read_text())
        values |= {"self_collision": str(ROOT / "config/kr120_self_collision.yaml"), "tf_prefix": tf_prefix, "seed": 1}
        values |= {"max_waypoints": 600}
        patch = monkeypatch.setattr
        patch(module, "neighbour_obstacles", lambda *_: None)
        patch(plan_requests, "VERDICT_TIME", 0.0)
        patch(module, "caller_of", lambda _: "a caller")
        patch(module, "listen_to_frames", lambda robot, prefix, *_: Frames(robot, prefix, tf))
        patch(module.rospy, "resolve_name", lambda name: f"/kr120/{name}")
        patch(module.rospy.Time, "now", staticmethod(lambda: rospy.Time(7)))
        unplugged = Unplugged(monkeypatch, NODE, Settings(**values), ROBOT, lambda *_: self.pose)
        self.node, self.services, self.callbacks = unplugged.node, unplugged.services, unplugged.callbacks
        self.published, self._unplugged = unplugged.published, unplugged
        self.show(SCENE)

    @property
    def refused(self) -> Counter[str]:
        return Counter(reason for reason, _ in (*self._unplugged.refused, *self._unplugged.counted))

    def show(self, scene: Scene) -> None:
        self.callbacks["scene"](scene_to_msg(scene, rospy.Time(6), "base_link"))

    def work(self, segments: list[WorkSegment], task: str = "task-1") -> PlanWorkResponse:
        return self.services["plan_work"](over_the_wire(PlanWorkRequest(task=task, source="work", segments=segments)))

    def engage(self, end: float, path=None) -> None:
        trajectory = motion(HOME, RIGHT) if path is None else path
        self.callbacks["engagement"](
            over_the_wire(
                Engagement(
                    engaged=True, plan_id="p0", task="task-1", segment="carry", reason="stopped by a person",
                    trajectory=convert.trajectory_to_msg(trajectory), end=end, requires=[Signal("held", True)],
                    scenes=[SCENE.hash],
                )
            )
        )  # fmt: skip


def motion(begin, end):
    return time_path(np.array([begin, end]), ROBOT, speed_scale=0.5)


def segment(name: str, begin, end, put=(), remove=(), **fields) -> WorkSegment:
    return WorkSegment(
        name=name, trajectory=convert.trajectory_to_msg(motion(begin, end)), put=list(map(object_to_msg, put)),
        remove=list(remove), **fields,
    )  # fmt: skip


def task() -> list[WorkSegment]:
    close = ToolSwitch(output="vacuum", value=True, confirm=[Signal("held", True)], timeout=2.0)
    open_ = ToolSwitch(output="vacuum", value=False, confirm=[Signal("held", False)], timeout=2.0)
    held = [Signal("held", True)]
    return [
        segment("fetch", HOME, RIGHT, put=[HELD], engaged=True, switches=[close]),
        segment("carry", RIGHT, LEFT, remove=["block"], engaged=True, requires=held, switches=[open_]),
        segment("leave", LEFT, HOME),
    ]


@pytest.fixture
def bench(monkeypatch) -> Bench:
    return Bench(monkeypatch)


def test_a_task_is_published_as_one_plan_for_review_with_its_segments_and_what_they_do_to_the_scene(bench):
    answer = bench.work(task())
    assert answer.success and "waiting for review" in answer.message, answer.message
    (message,) = bench.published["plan"]
    plan = convert.plan_from_msg(message)
    assert (answer.plan_id, answer.plan_hash, answer.duration) == (plan.id, plan.hash, plan.trajectory.duration)
    assert (plan.task, plan.source, plan.planner) == ("task-1", "work", "work")
    assert [(each.name, each.engaged) for each in plan.segments] == [("fetch", True), ("carry", True), ("leave", False)]
    assert plan.segments[-1].end == plan.trajectory.duration
    changes = list(map(convert.change_from_msg, message.segments))
    assert changes == [SceneChange((HELD,)), SceneChange((), ("block",)), SceneChange()]
    # whoever applies them to the scene gets the hashes that the approval covers
    scene = SCENE
    for each, change in zip(plan.segments, changes):
        assert each.scene == scene.hash
        scene = change.apply(scene)
        assert each.scene_after == scene.hash
    assert bench.published["plan_outcome"][-1].plan_id == plan.id


def test_while_engaged_only_the_way_back_is_planned(bench):
    path = motion(HOME, RIGHT)
    bench.engage(0.8 * path.duration)
    bench.pose = tuple(path.sample(0.8 * path.duration)[0])
    wanted = (
        "left in 'carry' of task task-1 .stopped by a person.: only the way back.*plan_way_back.*release_engagement"
    )
    asked = [
        ("plan_to_joints", PlanToJointsRequest(goal=list(LEFT))),
        ("plan_to_pose", PlanToPoseRequest()),
        ("plan_cartesian", PlanCartesianRequest()),
        ("plan_trajectory", PlanTrajectoryRequest(path=str(ROOT / "benchmarks/problems/free.csv"))),
        ("plan_trajectory", PlanTrajectoryRequest(trajectory=convert.trajectory_to_msg(path))),
        ("plan_work", PlanWorkRequest(task="t", segments=task())),
    ]
    assert {name for name, _ in asked} | {"plan_way_back"} == set(bench.services)
    for name, request in asked:
        answer = bench.services[name](request)
        assert not answer.success and re.search(wanted, answer.message), (name, answer.message)
    bench.callbacks["joint_trajectory"](convert.trajectory_to_msg(path))
    assert not bench.published["plan"] and bench.refused["EngagedError"] == 7
    answer = bench.services["plan_way_back"](TriggerRequest())
    assert answer.success, answer.message
    plan = convert.plan_from_msg(bench.published["plan"][0])
    assert (plan.planner, plan.task, plan.segments[0].requires[0].name) == ("way back", "task-1", "held")
    assert "carry" in plan.source and "stopped by a person" in plan.source
    np.testing.assert_array_equal(plan.trajectory.positions[[0, -1]], [bench.pose, HOME])


def test_a_motion_comes_as_a_message_or_from_a_file_and_not_from_both(bench, tmp_path):
    file = tmp_path / "path.csv"
    names = ",".join(f"{name}_rad" for name in ROBOT.joint_names)
    file.write_text("\n".join([names, *(",".join(map(repr, np.asarray(q).tolist())) for q in (HOME, RIGHT))]))
    request = PlanTrajectoryRequest(path=str(file))
    assert bench.services["plan_trajectory"](request).success
    (plan,) = bench.published["plan"]
    assert plan.source == str(file) and np.allclose(plan.trajectory.points[-1].positions, RIGHT)
    file.write_text(file.read_text().replace(repr(float(RIGHT[0])), "9.0"))
    answer = bench.services["plan_trajectory"](request)
    assert not answer.success and "line 3: joint_a1 is 9 rad" in answer.message
    request.trajectory = convert.trajectory_to_msg(motion(HOME, RIGHT))
    assert "expected one of them" in bench.services["plan_trajectory"](request).message


def refused_motion(bench, joint):
    answer = bench.services["plan_to_joints"](PlanToJointsRequest(goal=[joint, *LEFT[1:]]))
    outcome = bench.published["plan_outcome"][-1]
    assert not answer.success and outcome.message == answer.message
    return outcome


def test_a_failure_that_cannot_be_written_as_json_is_answered_all_the_same(bench):
    bench.show(SCENE)
    outcome = refused_motion(bench, math.nan)
    assert "joint_a1 is nan" in outcome.message and outcome.request == ""


def test_a_failure_comes_with_its_request_whose_mesh_is_read_where_it_is_saved(bench, tmp_path):
    mesh = tmp_path / "wall.stl"
    write_stl(mesh, box_triangles((0.2, 0.2, 0.2)))
    wall = SceneObject("wall", "mesh", position=(4.0, 0.0, 0.5), mesh=str(mesh))
    bench.show(Scene((wall,)))
    mesh.unlink()
    outcome = refused_motion(bench, 0.1)
    assert "expected a readable file" in outcome.message and str(mesh) in outcome.request
    with pytest.raises(SceneError, match="expected a readable file"):
        failure("plan", outcome.message, {}, **json.loads(outcome.request))


def test_once_it_is_free_any_motion_is_planned_and_there_is_no_way_back(bench):
    answer = bench.services["plan_way_back"](TriggerRequest())
    assert not answer.success and "not left inside an engaged segment" in answer.message
    bench.engage(1.0)
    bench.callbacks["engagement"](Engagement())
    assert bench.work(task()).success
    assert not bench.services["plan_way_back"](TriggerRequest()).success


def test_without_the_scene_s_publisher_nothing_is_planned_until_a_scene_comes(bench, monkeypatch):
    def send():
        return bench.services["plan_to_joints"](PlanToJointsRequest(goal=list(LEFT)))

    monkeypatch.setattr(module, "SCENE_TIMEOUT", 0.0)
    with monkeypatch.context() as silent:
        silent.setattr(Subscriber, "get_num_connections", lambda _: 0)
        answer = send()
        assert not answer.success and "the scene node is not running" in answer.message
    assert not send().success and bench.refused == {"NoSceneError": 2}
    bench.show(SCENE)
    assert send().success


class TestAMotionThatIsSentAgain:
    """It keeps its place in the review for as long as its plan waits there, whichever way it comes."""

    @pytest.fixture(params=["topic", "service", "mqtt"])
    def send(self, request, bench, monkeypatch):
        """Return what sends a motion to joint values and returns the id of its plan."""

        def by_topic(goal) -> str:
            bench.callbacks["joint_trajectory"](over_the_wire(convert.trajectory_to_msg(motion(bench.pose, goal))))
            return bench.published["plan_outcome"][-1].plan_id

        def by_service(goal) -> str:
            answer = bench.services["plan_to_joints"](over_the_wire(PlanToJointsRequest(goal=list(goal))))
            assert answer.success and answer.plan_hash == bench.published["plan"][-1].hash, answer.message
            return answer.plan_id

        def planner(**fields):
            return bench.services["plan_trajectory"](over_the_wire(PlanTrajectoryRequest(**fields)))

        client, numbers = Client(), itertools.count(step=10)
        planner.resolved_name = "plan_trajectory"
        monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
        monkeypatch.setattr(endpoint, "time", SimpleNamespace(monotonic=lambda: next(numbers)))
        joints = Joints(tuple(ROBOT.joint_names), tuple(ROBOT.linear))
        connection = Connection(Broker("127.0.0.1", 1), client, Topics("twin", "kr120"), None)
        desk = requests.ConsoleRequests(joints, {}, planner, connection, 4096, lambda: False, lambda: False)

        def by_mqtt(goal) -> str:
            motion = {"id": str(next(numbers)), "units": {"angle": "rad", "length": "m", "time": "s"}}
            motion |= {"joint_names": ROBOT.joint_names, "points": [{"positions": list(q)} for q in (HOME, goal)]}
            message = SimpleNamespace(topic="twin/kr120/trajectory", payload=json.dumps(motion).encode(), retain=False)
            (served,) = (each for each in connection.endpoints if each.topic == message.topic)
            served.on_message(message)
            desk.queue.run()
            answer = json.loads(client.published[-1][1])
            assert (answer["ok"], answer["id"]) == (True, motion["id"]), answer
            return answer["plan_id"]

        return {"topic": by_topic, "service": by_service, "mqtt": by_mqtt}[request.param]

    def test_is_answered_with_the_plan_that_waits_and_publishes_no_other(self, bench, send):
        plan = send(RIGHT)
        assert plan and [send(RIGHT) for _ in range(5)] == [plan] * 5
        assert [each.id for each in bench.published["plan"]] == [plan] and Unplugged.diagnose().values["repeated"] == 5
        outcomes = bench.published["plan_outcome"]
        assert len(outcomes) == 6 and "still waiting for review" in outcomes[-1].message
        # what another motion has replaced waits no more
        assert len({plan, send(LEFT), send(RIGHT)}) == len(bench.published["plan"]) == 3
        bench.show(Scene((), 0.01))
        assert send(RIGHT) and len(bench.published["plan"]) == 4

    @pytest.mark.parametrize("approved", [True, False])
    def test_is_a_new_plan_once_its_plan_was_decided_or_voided(self, bench, send, approved):
        plan = send(RIGHT)
        bench.callbacks["review"](Review(plan_id="another", approved=approved))
        assert send(RIGHT) == plan
        bench.callbacks["review"](Review(plan_id=plan, approved=approved))
        again = send(RIGHT)
        assert again != plan and [each.id for each in bench.published["plan"]] == [plan, again]
        assert send(RIGHT) == again


def test_a_motion_is_another_plan_for_another_sender_and_from_another_pose(bench):
    def sent(source: str) -> str:
        return bench.services["plan_to_joints"](PlanToJointsRequest(goal=list(LEFT), source=source)).plan_id

    plans = [sent("Ada"), sent("Bob"), sent("Ada")]
    bench.pose = tuple(np.add(HOME, 1e-3))
    plans.append(sent("Ada"))
    assert plans == [each.id for each in bench.published["plan"]] and len(set(plans)) == 4


def test_a_task_that_is_asked_for_again_is_a_new_plan_which_the_node_work_waits_for(bench):
    assert bench.work(task()).plan_id != bench.work(task()).plan_id


#: The arm with mass hangs lower than it is told to [rad].
SAGGED = np.array(HOME) + [0.0, 0.03, 0.02, 0.0, 0.0, 0.0]
#: What is on each stream of poses.
STREAMS = {"twin/commanded": HOME, "twin/joint_states": SAGGED, "twin/effort": SAGGED}


@pytest.mark.parametrize("twin", ["mujoco", "gazebo"])
def test_a_goal_at_the_tool_is_where_the_tool_is_commanded_to_be_although_the_simulated_arm_sags(monkeypatch, twin):
    """By the launch file's own word on what each tree of tf is made of."""
    receive = {}

    def subscribe(topic, _kind, take, **_):
        receive[topic] = take
        return SimpleNamespace(resolved_name=topic, impl=SimpleNamespace(connections=[]))

    chain, tip = Chain(ROBOT), ROBOT.tip_link
    with monkeypatch.context() as patch:
        patch.setattr(subscriber.rospy, "Subscriber", subscribe)
        patch.setattr(frames.rospy.Time, "now", staticmethod(lambda: rospy.Time(7)))
        buffer = tf2_ros.Buffer(debug=False)
        patch.setattr(frames.tf2_ros, "Buffer", lambda: buffer)
        frames.FrameListener(lambda *said: pytest.fail(str(said)))
        trees = ("robot_state_publisher", "twin", twin_in_tf(f"twin:={twin}")), ("display", "simulated", "twin/effort")
        for node, tree, topic in trees:
            pose = chain.forward(STREAMS[topic])
            prefix = f"kr120/{tree}"
            transforms = [
                placed("world", f"{prefix}/{ROBOT.base_link}", Pose(np.zeros(3), np.eye(3))),
                placed(f"{prefix}/{ROBOT.base_link}", f"{prefix}/{tip}", pose),
            ]
            message = TFMessage(transforms)
            message._connection_header = {"callerid": f"/kr120/{node}"}
            receive["/tf_static"](message)
    bench = Bench(monkeypatch, "kr120/twin", buffer)
    bench.show(Scene((), 0.01))
    wanted = product(chain.forward(HOME), Pose(np.array([0.0, 0.0, 0.05]), np.eye(3)))
    for frame in (tip, f"kr120/twin/{tip}"):
        request = PlanToPoseRequest()
        request.goal.header.frame_id = frame
        request.goal.pose.position.z, request.goal.pose.orientation.w = 0.05, 1.0
        answer = bench.services["plan_to_pose"](over_the_wire(request))
        assert answer.success, answer.message
        plan = convert.trajectory_from_msg(bench.published["plan"][-1].trajectory)
        reached = chain.forward(plan.positions[-1])
        assert np.allclose(reached.position, wanted.position, atol=1e-4)
    request.goal.header.frame_id = f"kr120/simulated/{tip}"
    answer = bench.services["plan_to_pose"](over_the_wire(request))
    assert not answer.success and "no transform from frame 'kr120/simulated/tool0'" in answer.message


def placed(parent: str, child: str, pose: Pose) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.transform.translation = Vector3(*pose.position)
    message.transform.rotation = Quaternion(*rotation_to_quaternion(pose.rotation))
    return message

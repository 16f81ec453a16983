"""The planning pipeline: scenes that come, change and cannot be used; tool paths and waypoints in the scene; what asks for them."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import yaml
from construction_twin.msg import CartesianWaypoint
from construction_twin.srv import PlanToJointsRequest
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as PoseMsg
from planning_cell import CHAIN, HOME, LEFT, QUICK, REQUEST, RIGHT, ROBOT, SELF_COLLISION, WALL, Clock, solver
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment
from construction_twin.core.share import share_file
from construction_twin.extensions.planners.waypoint_file import read_waypoints
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.ik_branch import CartesianPathError
from construction_twin.planning.pipeline import NoSceneError, PlanningPipeline, SceneChangedError
from construction_twin.planning.planner import PlannerSettings
from construction_twin.planning.recheck import CollisionError
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.planning.waypoints import WaypointsError, WaypointTimesError, from_points
from construction_twin.robot.motion_errors import PlanningError, SceneError
from construction_twin.ros.nodes import planner
from construction_twin.ros.nodes.planner import plan_request, tool_waypoints, trajectory_waypoints
from construction_twin.scene.objects import Scene, SceneObject

EMPTY, WALLED = Scene(padding=0.01), Scene((WALL,), 0.01)


def pipeline(scene: Scene | None = EMPTY, clock=None, **changes) -> PlanningPipeline:
    settings = PlannerSettings(**(QUICK | changes))
    made = PlanningPipeline(ROBOT, solver(), settings, SELF_COLLISION, clock or Clock(), "/kr120/scene")
    if scene is not None:
        made.set_scene(scene)
    return made


def test_what_is_not_given_is_as_shipped_and_the_same_each_time():
    values = yaml.safe_load(share_file("config/planner.yaml").read_text())
    assert PlannerSettings.shipped().model_dump().items() <= values.items()
    plans = []
    for _ in range(2):
        plain = PlanningPipeline(ROBOT, self_collision=SELF_COLLISION)
        plain.set_scene(Scene((WALL,)))
        plans.append(plain.to_joints(RIGHT, LEFT))
    assert plans[0].hash == plans[1].hash and plans[0].id != plans[1].id
    assert plans[0].asked == Moment("00000000", 0)


def test_without_a_scene_nothing_is_planned():
    with pytest.raises(NoSceneError, match="no scene was received on /kr120/scene"):
        pipeline(None).to_joints(HOME, LEFT, REQUEST)
    with pytest.raises(NoSceneError):
        pipeline(None).wait_for_scene(0.0)


def test_without_ros_a_missing_scene_is_no_matter_of_nodes():
    with pytest.raises(NoSceneError, match="give the pipeline one with set_scene"):
        PlanningPipeline(ROBOT, self_collision=SELF_COLLISION).to_joints(HOME, LEFT)


def test_a_scene_that_comes_later_is_waited_for():
    made = pipeline(None)
    timer = threading.Timer(0.02, made.set_scene, [EMPTY])
    timer.start()
    made.wait_for_scene(10.0)
    assert made.to_joints(HOME, LEFT, REQUEST).scene == EMPTY.hash
    timer.join()


def test_every_plan_is_made_in_the_latest_scene():
    made = pipeline()
    assert made.to_joints(RIGHT, LEFT, REQUEST).planner == "direct"
    made.set_scene(WALLED)
    around = made.to_joints(RIGHT, LEFT, REQUEST)
    assert (around.planner, around.scene) == ("RRTConnect", WALLED.hash)
    made.set_scene(EMPTY)
    assert made.to_joints(RIGHT, LEFT, REQUEST).planner == "direct"


class EditingClock(Clock):
    """Calls something at its n-th look: in the middle of planning."""

    def __init__(self, look: int):
        super().__init__()
        self.look = look
        self.edit = lambda: None

    def __call__(self) -> float:
        now = super().__call__()
        if round(now * 1e3) == self.look:
            self.edit()
        return now


@pytest.mark.parametrize("look", [1, 2, 3, 4])
def test_a_scene_that_changes_while_planning_drops_the_plan(look):
    clock = EditingClock(look)
    made = pipeline(EMPTY, clock)
    clock.edit = lambda: made.set_scene(WALLED)
    with pytest.raises(SceneChangedError, match="the scene changed while planning") as caught:
        made.to_joints(RIGHT, LEFT, REQUEST)
    values = caught.value.args[0].values
    assert (values["before"], values["now"]) == (EMPTY.hash[:8], WALLED.hash[:8])
    assert made.to_joints(RIGHT, LEFT, REQUEST).scene == WALLED.hash


def test_the_same_scene_sent_again_drops_nothing():
    clock = EditingClock(2)
    made = pipeline(EMPTY, clock)
    clock.edit = lambda: made.set_scene(Scene(padding=0.01))
    assert made.to_joints(RIGHT, LEFT, REQUEST).scene == EMPTY.hash


def test_after_a_scene_that_cannot_be_used_nothing_is_planned_until_the_next():
    made = pipeline()
    made.refuse_scene(SceneError("the scene's hash", "a", "b"))
    made.wait_for_scene(0.0)
    with pytest.raises(SceneError, check=lambda error: error.where == "the scene's hash"):
        made.to_joints(HOME, LEFT, REQUEST)
    made.set_scene(EMPTY)
    assert made.to_joints(HOME, LEFT, REQUEST).scene == EMPTY.hash


def test_a_scene_that_becomes_unusable_while_planning_drops_the_plan():
    clock = EditingClock(2)
    made = pipeline(EMPTY, clock)
    clock.edit = lambda: made.refuse_scene(SceneError("the scene's hash", "a", "b"))
    with pytest.raises(SceneChangedError):
        made.to_joints(HOME, LEFT, REQUEST)


def test_an_object_on_a_link_that_does_not_exist_is_said():
    carried = SceneObject("tool", "sphere", (0.1,), link="link_9")
    with pytest.raises(SceneError, check=lambda error: error.value == "link_9"):
        pipeline(Scene((carried,))).to_joints(HOME, LEFT, REQUEST)


def test_a_tool_path_is_checked_in_the_scene():
    start = CHAIN.forward(HOME)
    down = [ToolWaypoint(Pose(start.position + (0.0, 0.0, -0.2), start.rotation))]
    plan = pipeline().along(HOME, down, 0.2, REQUEST)
    assert (plan.planner, plan.scene) == ("cartesian", EMPTY.hash)
    np.testing.assert_allclose(CHAIN.forward(plan.trajectory.positions[-1]).position, down[0].pose.position, atol=1e-4)
    assert plan.planning_time > 0.0 and len(plan.report.clearance.between) == 2
    block = SceneObject("block", "sphere", (0.1,), tuple(start.position + (0.0, 0.0, -0.25)))
    with pytest.raises(
        CartesianPathError,
        check=lambda error: error.cause.between == ("link_6", "block"),
    ) as caught:
        pipeline(Scene((block,))).along(HOME, down, 0.2, REQUEST)
    assert 0.0 < caught.value.fraction < 1.0


def waypoints(*rows):
    return from_points(ROBOT, ROBOT.joint_names, rows)


def test_waypoints_are_checked_in_the_scene():
    plan = pipeline().through(RIGHT, waypoints(RIGHT, HOME, LEFT), REQUEST)
    assert (plan.planner, plan.scene) == ("waypoints", EMPTY.hash)
    with pytest.raises(CollisionError, match="touches wall \\(at .* s\\)"):
        pipeline(WALLED).through(RIGHT, waypoints(RIGHT, LEFT), REQUEST)


def test_the_speed_scale_of_the_settings_is_the_default_for_all():
    slow, fast = pipeline(speed_scale=0.2), pipeline(speed_scale=1.0)
    ways = waypoints(RIGHT, HOME, LEFT)
    assert (
        slow.through(RIGHT, ways, REQUEST).trajectory.duration
        > 1.5 * fast.through(RIGHT, ways, REQUEST).trajectory.duration
    )


# -- from messages


@pytest.fixture
def now(monkeypatch) -> Moment:
    """The moment at which requests arrive."""
    monkeypatch.setattr(planner, "present_moment", lambda: NOW)
    return NOW


NOW = Moment("c0ffee00", 9 * 10**9)


def test_zero_and_empty_mean_the_default(now):
    asked = plan_request(PlanToJointsRequest())
    assert (asked.asked, asked.source) == (now, "request")
    assert (asked.duration, asked.speed_scale, asked.acceleration_scale, asked.waypoints) == (None,) * 4
    full = PlanToJointsRequest(duration=2.0, speed_scale=0.5, acceleration_scale=0.25, waypoints=9, source="me")
    asked = plan_request(full, "/a.csv")
    assert (asked.duration, asked.speed_scale, asked.acceleration_scale, asked.waypoints) == (2.0, 0.5, 0.25, 9)
    assert asked.source == "me" and plan_request(PlanToJointsRequest(), "/a.csv").source == "/a.csv"


def test_a_request_may_say_how_old_it_is_but_not_that_it_comes_from_the_future(now):
    for then in (Moment("c0ffee00", 5 * 10**9), now):
        assert plan_request(PlanToJointsRequest(asked=str(then))).asked == then
    for asked in (Moment("c0ffee00", now.at + 10**9), Moment("deadbeef", 1)):
        with pytest.raises(
            PlanningError,
            match=f"asked for at {asked}, expected a moment of this computer before {now};",
        ):
            plan_request(PlanToJointsRequest(asked=str(asked)))
    with pytest.raises(PayloadError, match=r"found '4\.0' as moment"):
        plan_request(PlanToJointsRequest(asked="4.0"))


def test_a_tool_path_is_converted_from_its_frame_to_the_base():
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    base_T_frame = Pose(np.array([1.0, 0.0, 0.0]), quarter)
    msg = CartesianWaypoint(PoseMsg(Point(0.5, 0.0, 2.0), Quaternion(0, 0, 0, 1)), True, Point(0.2, 0.1, 0.0), 0.05)
    line = CartesianWaypoint(pose=msg.pose)
    first, second = tool_waypoints([msg, line], base_T_frame)
    np.testing.assert_allclose(first.pose.position, [1.0, 0.5, 2.0], atol=1e-15)
    np.testing.assert_allclose(first.via, [0.9, 0.2, 0.0], atol=1e-15)
    np.testing.assert_allclose(first.pose.rotation, quarter, atol=1e-15)
    assert first.blend == 0.05 and second.via is None and second.blend == 0.0


def test_a_trajectory_message_s_joints_are_put_in_order():
    names = list(reversed(ROBOT.joint_names))
    msg = JointTrajectory(joint_names=names, points=[JointTrajectoryPoint(positions=q[::-1]) for q in (RIGHT, HOME)])
    np.testing.assert_array_equal(trajectory_waypoints(msg, ROBOT).positions, [RIGHT, HOME])
    msg.points[1].positions = [1.0]
    with pytest.raises(WaypointsError, check=lambda error: error.row == 1):
        trajectory_waypoints(msg, ROBOT)


def test_a_file_is_read_and_a_missing_one_is_named(tmp_path):
    path = tmp_path / "path.csv"
    rows = "\n".join(",".join(repr(float(value)) for value in q) for q in (RIGHT, HOME))
    path.write_text(",".join(f"{name}_rad" for name in ROBOT.joint_names) + "\n" + rows + "\n")
    np.testing.assert_array_equal(read_waypoints(str(path), ROBOT).positions, [RIGHT, HOME])
    with pytest.raises(PlanningError, match="absent.csv cannot be read"):
        read_waypoints(str(tmp_path / "absent.csv"), ROBOT)
    with pytest.raises(PlanningError, match=r"the file is 'path\.csv'; expected an absolute path"):
        read_waypoints("path.csv", ROBOT)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PlanningError, match="cannot be read"):
        read_waypoints(str(path), ROBOT)


def test_times_that_break_a_limit_are_replaced_only_where_that_is_allowed_and_the_plan_says_why():
    near = np.add(HOME, 0.1)
    points = from_points(ROBOT, ROBOT.joint_names, [HOME, near], times=[0.0, 0.2])
    with pytest.raises(WaypointTimesError, match="has an acceleration of"):
        pipeline().through(HOME, points, REQUEST)
    plan = pipeline().through(HOME, points, REQUEST, retime=True)
    assert plan.planner.startswith("waypoints, timed anew (point 1 (on the path to it, ")
    assert "has an acceleration of" in plan.planner and plan.trajectory.duration > 0.2
    assert plan.planner == f"waypoints, timed anew ({plan.retimed})"
    # what holds its limits is kept
    kept = pipeline().through(
        HOME, from_points(ROBOT, ROBOT.joint_names, [HOME, LEFT], times=[0.0, 30.0]), REQUEST, retime=True
    )
    assert (kept.planner, kept.retimed, kept.trajectory.duration) == ("waypoints", "", 30.0)


def test_a_turn_of_wrapped_angles_is_noted_with_its_size():
    there, wrapped = HOME.copy(), HOME.copy()
    there[5], wrapped[5] = np.radians([179.0, -179.0])
    note = "A6 turns by 358 deg between point 1 and point 2: wrapped angles?"
    points = from_points(ROBOT, ROBOT.joint_names, [HOME, there, wrapped])
    assert pipeline().through(HOME, points, REQUEST).planner == f"waypoints ({note})"
    timed = from_points(ROBOT, ROBOT.joint_names, [HOME, there, wrapped], times=[0.0, 30.0, 60.0], velocities=None)
    assert pipeline().through(HOME, timed, REQUEST, retime=True).planner.startswith(f"waypoints ({note})")
    goal = from_points(ROBOT, ROBOT.joint_names, [wrapped])
    assert "A6 turns by 358 deg on the way to point 0" in pipeline().through(there, goal, REQUEST).planner
    half = from_points(ROBOT, ROBOT.joint_names, [HOME, there, HOME])
    assert pipeline().through(HOME, half, REQUEST).planner == "waypoints"


def test_many_points_whose_times_were_rounded_are_kept_by_the_last_check_too():
    x = np.linspace(0.0, 1.0, 4000)
    rows = HOME + np.outer(x**3 * (10.0 - 15.0 * x + 6.0 * x**2), np.full(6, 0.3))
    points = from_points(ROBOT, ROBOT.joint_names, rows, times=np.floor(x * 1.3e9) / 1e9)
    plan = pipeline(max_waypoints=4000).through(HOME, points, REQUEST, retime=True)
    assert (plan.planner, len(plan.trajectory.times)) == ("waypoints", 4000)
    assert max(plan.report.usage.jerk) < 1.0


def test_a_place_that_is_wrong_is_refused_whatever_the_times():
    points = from_points(ROBOT, ROBOT.joint_names, [np.add(HOME, 0.1), LEFT], times=[0.0, 0.05])
    with pytest.raises(WaypointsError, match="expected within"):
        pipeline().through(HOME, points, REQUEST, retime=True)

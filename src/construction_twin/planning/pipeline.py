"""From a request to a checked plan: every kind of motion, one request at a time, in a scene that is still the latest at its end.

Joint vectors in the order of `RobotModel.joint_names`, SI; poses of the robot's tip in its base frame.
"""

from __future__ import annotations

import functools
import inspect
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import BPoly, PPoly

from construction_twin.core.clock import MONOTONIC, Clock
from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import InverseKinematics, inverse_kinematics
from construction_twin.planning.cartesian import plan_cartesian
from construction_twin.planning.curves import JointCurve
from construction_twin.planning.limit_usage import SAME_POINT, sampled_usage
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.planning.recheck import CollisionError, recheck
from construction_twin.planning.request_limits import distinct
from construction_twin.planning.timing import time_curve, time_path
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.planning.waypoints import (
    Waypoints,
    WaypointTimesError,
    asked_path,
    plan_waypoints,
    time_asked,
    wrapped_note,
)
from construction_twin.planning.work_plan import joined, plan_work
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.executed_path import LARGEST_ENTRY, WAY_BACK_TOLERANCE, ExecutedPath
from construction_twin.robot.motion_errors import PlanningError, SceneError
from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Signal
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision, sample_self_collision


class RetimedCollisionError(CollisionError):
    """A motion whose times were replaced touches something; `where` names points of the sender, who knows no others."""

    def __init__(self, between: tuple[str, str], where: str, why: str):
        self.why = why
        super().__init__(between, where)

    def _sentence(self, **values: str) -> Sentence:
        return Sentence(
            "{first} touches {second} ({where}), or comes closer than the padding, on the curve through the points; use more "
            "points there, or choose another way. The motion was timed anew, because {why}",
            **values,
            why=self.why,
        )


class NoSceneError(PlanningError):
    """The scene is unknown, so planning is refused."""

    def __init__(self, source: str):
        super().__init__(
            Sentence("no scene was received on {source}; the scene node is not running, start it", source=source)
            if source
            else "there is no scene; give the pipeline one with set_scene, an empty one where nothing stands near the arm"
        )


class SceneChangedError(PlanningError):
    """The scene has changed since planning began."""

    def __init__(self, planned: str, present: str):
        before, now = planned[:8], present[:8]
        super().__init__(
            Sentence("the scene changed while planning, from {before} to {now}; ask again", before=before, now=now)
        )


#: Name of the planner in the plan, and of its one segment.
WAY_BACK = "way back"
#: Pace of the way back, as a fraction of the pace of the way there; where it goes straight to the path, of the velocity limits.
PACE, ENTRY_SPEED = 0.25, 0.05
#: Spacing of the waypoints, and the least distance of two along the way there [s].
SPACING, CLOSEST = 0.02, 1e-4


def way_back(path: ExecutedPath, present: JointValues, robot: RobotModel) -> Trajectory:
    """Return the motion from where the arm is back along a path to its beginning: its positions at other times, slowly.

    Beside the path by more than a quarter of `WAY_BACK_TOLERANCE`, it goes straight to the nearest point first, and rests there.
    PlanningError where it is too far from the path, at its beginning, or not possible.
    """
    pose = np.array(present, dtype=float)
    if path.trajectory.joint_names != tuple(robot.joint_names):
        names = {"found": ", ".join(path.trajectory.joint_names), "joints": ", ".join(robot.joint_names)}
        raise PlanningError(Sentence("the executed path is one of {found}; expected {joints}", **names))
    entry = path.nearest_point(pose)
    if entry.distance > LARGEST_ENTRY:
        values = {"away": Quantity(entry.distance, "rad"), "most": Quantity(LARGEST_ENTRY, "rad")}
        far = Sentence("a joint is {away} (or mm) beside the executed path, at most {most}; free it by hand", **values)
        raise PlanningError(far)
    begin, there = path.trajectory.positions[0], path.trajectory.sample(entry.time)[0]
    if np.max(np.abs(pose - begin)) <= SAME_POINT:
        raise PlanningError(Sentence("the arm is at the beginning of the engaged segments; nothing to go back to"))
    at_begin = np.max(np.abs(there - begin)) <= SAME_POINT
    parts = []
    if entry.distance > WAY_BACK_TOLERANCE / 4 or at_begin:
        parts.append(time_path(np.array([pose, there]), robot, speed_scale=ENTRY_SPEED))
    if not at_begin:
        parts.append(_reversed(path.trajectory, entry.time, robot))
    return joined(parts)[0]


def _reversed(trajectory: Trajectory, begin: float, robot: RobotModel) -> Trajectory:
    """Return the motion from rest at a time along a trajectory back to its beginning, at `PACE` at most."""
    times = np.append(trajectory.times[trajectory.times < begin - CLOSEST], begin)[::-1]
    q, qd, qdd, _ = trajectory.sample_many(times)
    pieces = BPoly.from_derivatives(begin - times, np.stack((q, -qd, qdd), axis=1))
    curve = JointCurve(PPoly.from_bernstein_basis(pieces))
    motion = time_curve(curve, robot, top_speed=PACE, spacing=SPACING).trajectory
    positions = motion.positions.copy()
    positions[[0, -1]] = q[0], trajectory.positions[0]
    return replace(motion, positions=positions)


@dataclass(frozen=True)
class FailedRequest:
    """A call of a method of `PlanningPipeline` that ended in an error, and the scene that it found."""

    method: str
    arguments: dict[str, Any]
    scene: Scene | None
    sentence: str


def _store_failure(plan: Callable[..., Plan]) -> Callable[..., Plan]:
    """Decorate a method of `PlanningPipeline` to store its last failed call."""
    form = inspect.signature(plan)

    @functools.wraps(plan)
    def call(self: PlanningPipeline, *args: Any, **named: Any) -> Plan:
        try:
            return plan(self, *args, **named)
        except ConstructionTwinError as error:
            arguments = dict(form.bind(self, *args, **named).arguments)
            del arguments["self"]
            self.failed = FailedRequest(plan.__name__, arguments, self._scene, str(error))
            raise

    return call


class PlanningPipeline:
    """Plans motions of one robot in the latest scene, also from several threads; PlanningError, SceneError: why there is no plan.

    Args:
        self_collision: Default: found anew by `sample_self_collision`, which takes some seconds.
        source: Topic of the scenes, for the message when there is none; "": they are given by calls.
        neighbour: Returns the space that another arm occupies now, padding included; raises when it is not known.
    """

    #: The kinds of requests.
    METHODS = ("to_joints", "to_pose", "along", "through", "work", "way_back")

    def __init__(
        self,
        robot: RobotModel,
        solver: InverseKinematics | None = None,
        settings: PlannerSettings | None = None,
        self_collision: SelfCollision | None = None,
        clock: Clock = MONOTONIC,
        source: str = "",
        neighbour: Callable[[], Iterable[Obstacle]] | None = None,
    ):
        self._robot = robot
        self._solver = solver or inverse_kinematics(Chain(robot), rng=np.random.default_rng(0), clock=clock)
        self._settings = settings or PlannerSettings.shipped()
        self._self_collision = self_collision or sample_self_collision(robot)
        self._clock = clock
        self._planner = Planner(robot, self._solver, self._settings, clock)
        self._source = source
        self._neighbour = neighbour
        # kinematics, collision worlds and OMPL are not thread-safe
        self._busy = threading.Lock()
        self._scene: Scene | None = None
        self._scene_fault: SceneError | None = None
        self._scene_changed = threading.Condition()
        self._world: CollisionWorld | None = None
        #: The last request that failed.
        self.failed: FailedRequest | None = None

    @property
    def scene(self) -> Scene | None:
        """The latest scene; None before the first, and after one that cannot be used."""
        return self._scene

    def set_scene(self, scene: Scene) -> None:
        """Use a scene from now on; a plan that is being made in another one will be refused. Returns at once."""
        with self._scene_changed:
            self._scene, self._scene_fault = scene, None
            self._scene_changed.notify_all()

    def refuse_scene(self, fault: SceneError) -> None:
        """Refuse plans until the next scene: the present one is unusable."""
        with self._scene_changed:
            self._scene, self._scene_fault = None, fault
            self._scene_changed.notify_all()

    def forget_scene(self, stale: Scene | None) -> None:
        """Drop a scene whose publisher is gone; no effect if another scene has arrived since `stale` was read."""
        with self._scene_changed:
            if self._scene is stale:
                self._scene = None

    def wait_for_scene(self, timeout: float) -> None:
        """Wait for the first scene; NoSceneError if none arrives within `timeout` [s]."""
        with self._scene_changed:
            if not self._scene_changed.wait_for(
                lambda: self._scene is not None or self._scene_fault is not None, timeout
            ):
                raise NoSceneError(self._source)

    @_store_failure
    def to_joints(self, start: JointValues, goal: JointValues, request: PlanRequest | None = None) -> Plan:
        """Plan a motion between two joint vectors; see `Planner.plan_to_joints`."""
        asked = request or PlanRequest()
        return self._in_scene(lambda world: self._planner.plan_to_joints(start, goal, asked, world))

    @_store_failure
    def to_pose(
        self, start: JointValues, pose: Pose, request: PlanRequest | None = None, configuration: str = ""
    ) -> Plan:
        """Plan a motion that brings the tip to a pose; see `Planner.plan_to_pose`."""
        asked = request or PlanRequest()
        return self._in_scene(lambda world: self._planner.plan_to_pose(start, pose, asked, world, configuration))

    @_store_failure
    def along(
        self, start: JointValues, waypoints: Sequence[ToolWaypoint], speed: float | None, request: PlanRequest
    ) -> Plan:
        """Plan a motion of the tip along lines and arcs; see `cartesian.plan_cartesian`.

        A request's duration and number of waypoints are not used, here and in `through`.
        """

        def build(world: CollisionWorld) -> Trajectory:
            bounds = self._settings.bounds
            motion = plan_cartesian(start, waypoints, self._solver, world, speed, *self._scales(request), bounds)
            return motion.trajectory

        return self._in_scene(lambda world: self._checked(build, "cartesian", request, world))

    @_store_failure
    def through(self, start: JointValues, waypoints: Waypoints, request: PlanRequest, retime: bool = False) -> Plan:
        """Plan a motion through joint waypoints made elsewhere; see `waypoints.plan_waypoints`.

        `retime`: times that need too much acceleration or jerk are replaced (`waypoints.time_asked`), and the plan says why; else
        refused. `Plan.planner` also says where wrapped angles may stand.
        """

        note = wrapped_note(waypoints, start, self._robot)
        name = f"waypoints ({note})" if note else "waypoints"

        def build(world: CollisionWorld) -> Trajectory:
            return plan_waypoints(waypoints, start, self._robot, *self._scales(request), self._settings.bounds)

        def checked(world: CollisionWorld) -> Plan:
            try:
                return self._checked(build, name, request, world, waypoints.times is not None)
            except WaypointTimesError as error:
                if not retime:
                    raise
                path = asked_path(waypoints, start, self._robot)
                return self._retimed(path, request, world, str(error), name)

        return self._in_scene(checked)

    def _retimed(self, path: Waypoints, request: PlanRequest, world: CollisionWorld, why: str, name: str) -> Plan:
        """Time a path anew through its points; RetimedCollisionError where the curve through them touches something."""
        # what was asked for is the sender's own pace, not the planner's default
        speed = 1.0 if request.speed_scale is None else request.speed_scale
        request = replace(request, speed_scale=speed, duration=None, waypoints=None)
        began = self._clock()
        timed = time_asked(path, self._robot, speed, request.acceleration_scale, self._settings.bounds)
        planning_time = self._clock() - began
        try:
            measured = recheck(timed.trajectory, self._robot, world, self._clock, timed.usage)
        except CollisionError as error:
            assert timed.passing_times is not None and error.time is not None
            rows = np.flatnonzero(distinct(path.positions))
            row = rows[np.clip(np.searchsorted(timed.passing_times, error.time), 1, len(rows) - 1)]
            raise RetimedCollisionError(error.between, path.way_to(int(row)), why) from error
        plan = request.plan(f"{name}, timed anew ({why})", planning_time, timed.trajectory, measured, world.scene.hash)
        return replace(plan, retimed=why)

    @_store_failure
    def work(self, start: JointValues, task: str, segments: Sequence[WorkSegment], request: PlanRequest) -> Plan:
        """Join the segments of a task to a work plan and check each in its scene; see `work_plan.plan_work`."""
        bounds = self._settings.bounds
        return self._in_scene(
            lambda world: plan_work(task, segments, start, request, world, bounds, self._clock)
        )  # fmt: skip

    @_store_failure
    def way_back(
        self, start: JointValues, task: str, path: ExecutedPath, requires: tuple[Signal, ...], request: PlanRequest
    ) -> Plan:
        """Plan the way back along an executed path, as a work plan of one engaged segment; see the function `way_back`."""

        def build(world: CollisionWorld) -> Plan:
            motion = way_back(path, start, self._robot)
            segment = WorkSegment(WAY_BACK, motion, True, requires)
            bounds = self._settings.bounds
            return plan_work(task, [segment], start, request, world, bounds, self._clock, WAY_BACK)

        return self._in_scene(build)

    def _scales(self, request: PlanRequest) -> tuple[float, float | None]:
        speed_scale = self._settings.speed_scale if request.speed_scale is None else request.speed_scale
        return speed_scale, request.acceleration_scale

    def _checked(
        self,
        build: Callable[[CollisionWorld], Trajectory],
        planner: str,
        request: PlanRequest,
        world: CollisionWorld,
        given_times: bool = False,
    ) -> Plan:
        began = self._clock()
        trajectory = build(world)
        planning_time = self._clock() - began
        sampled = sampled_usage(trajectory, self._robot, given_times)
        measured = recheck(trajectory, self._robot, world, self._clock, sampled)
        return request.plan(planner, planning_time, trajectory, measured, world.scene.hash)

    def _in_scene(self, build: Callable[[CollisionWorld], Plan]) -> Plan:
        with self._busy:
            plan = build(self._present_world())
            with self._scene_changed:
                present = self._scene.hash if self._scene is not None else "unknown"
            if plan.scene != present:
                raise SceneChangedError(plan.scene, present)
            return plan

    def _present_world(self) -> CollisionWorld:
        with self._scene_changed:
            scene, fault = self._scene, self._scene_fault
        if fault is not None:
            raise fault
        if scene is None:
            raise NoSceneError(self._source)
        if self._world is None:
            self._world = CollisionWorld(self._robot, scene, self._self_collision)
        elif self._world.scene.hash != scene.hash:
            self._world = self._world.with_scene(scene)
        # the other arm is not part of the scene's hash: the node `neighbour` looks where it is when the plan is to start
        return self._world if self._neighbour is None else self._world.with_neighbour(self._neighbour())

"""Motion planning in a scene: a path around what is there, timed, checked, as a plan for review.

Joint vectors in the order of `RobotModel.joint_names`, SI; poses of the robot's tip in its base frame.
"""

from __future__ import annotations

import uuid
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import pydantic
import yaml

from construction_twin.core.clock import Clock
from construction_twin.core.freshness import Moment
from construction_twin.core.limits import OUTSIDE
from construction_twin.core.sentences import Sentence
from construction_twin.core.share import share_file
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import Configuration, InverseKinematics
from construction_twin.planning.motion_validator import CornerRounding, MotionValidator
from construction_twin.planning.ompl_search import NoPathError, OmplSearch, PathQuery, ompl_planners
from construction_twin.planning.recheck import CollisionError, recheck
from construction_twin.planning.request_limits import PlanBounds, check_request
from construction_twin.planning.timing import timed_path, with_midpoints
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.motion_errors import PlanningError
from construction_twin.robot.plan import Plan, PlanReport, content_hash
from construction_twin.robot.segments import Segment
from construction_twin.robot.trajectory import Trajectory
from construction_twin.robot.urdf import read_text
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.validation import StrictModel

#: How often a path is timed, each time with corners half as wide, before another path is searched.
TIMINGS_TRIED = 3
#: The step of the check of motions is halved at most this many times. What it misses the re-check finds.
FINEST_HALVING = 2
#: A joint with a larger range is searched only half of this to either side of the motion's ends [rad].
TURN = 2.0 * np.pi
#: Most joint solutions of a goal pose that the search is given, nearest first. Straight motions are tried to all.
GOALS = 8
#: Name of the planner in a plan that is a straight line between two joint vectors.
DIRECT = "direct"


class PlannerSettings(StrictModel):
    """The planner's settings; config/planner.yaml has their values (`shipped`)."""

    planner: str
    planning_budget: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    edge_step: Annotated[float, pydantic.Field(ge=0.001, le=0.5)]
    speed_scale: Annotated[float, pydantic.Field(gt=0.0, le=1.0)]
    max_waypoints: Annotated[int, pydantic.Field(ge=2)]
    max_duration: Annotated[float, pydantic.Field(gt=0.0, le=86400.0)]
    seed: Annotated[int, pydantic.Field(ge=1, lt=2**31)]

    @pydantic.field_validator("planner")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in ompl_planners():
            raise ValueError(f"one of {', '.join(ompl_planners())}")
        return name

    @classmethod
    def shipped(cls) -> PlannerSettings:
        """Return the values of config/planner.yaml, which also holds what only the node needs."""
        values = yaml.safe_load(read_text(share_file("config/planner.yaml")))
        return cls(**{name: values[name] for name in PlannerSettings.model_fields})

    @property
    def bounds(self) -> PlanBounds:
        """Largest plan of any kind."""
        return PlanBounds(self.max_duration, self.max_waypoints)


@dataclass(frozen=True)
class PlanRequest:
    """Conditions of a request on its plan besides the ends, and its identity.

    Attributes:
        duration: [s]; None: as fast as the scales allow.
        speed_scale: Fraction of the velocity limits in (0, 1]; None: the planner's default, or 1 with a duration.
        acceleration_scale: The same of the acceleration limits; None: as the speed scale.
        waypoints: None: as `timing.time_path`.
    """

    plan_id: str = field(default_factory=lambda: str(uuid.uuid4()))
    asked: Moment = Moment("0" * 8, 0)
    source: str = "request"
    duration: float | None = None
    speed_scale: float | None = None
    acceleration_scale: float | None = None
    waypoints: int | None = None

    def plan(
        self,
        planner: str,
        planning_time: float,
        trajectory: Trajectory,
        report: PlanReport,
        scene: str,
        task: str = "",
        segments: tuple[Segment, ...] = (),
    ) -> Plan:
        """Return the plan that answers this request; `planning_time` excludes the recheck [s]."""
        return Plan(
            id=self.plan_id,
            hash=content_hash(trajectory, task, segments),
            source=self.source,
            planner=planner,
            scene=scene,
            asked=self.asked,
            planning_time=planning_time,
            trajectory=trajectory,
            report=report,
            task=task,
            segments=segments,
        )


class Planner:
    """Plans joint motions of one robot; not for use from several threads at once.

    With a planner that ends with the first path found, the same request in the same world gives the same plan.
    """

    def __init__(
        self,
        robot: RobotModel,
        solver: InverseKinematics,
        settings: PlannerSettings,
        clock: Clock,
    ):
        self._robot = robot
        self._solver = solver
        self._settings = settings
        self._clock = clock
        self._search = OmplSearch(settings.planner, clock)

    def plan_to_joints(
        self, start: JointValues, goal: JointValues, request: PlanRequest, world: CollisionWorld
    ) -> Plan:
        """Plan a motion between two joint vectors, length n [rad] or [m], or raise PlanningError."""
        began = self._clock()
        begin, end = self._joint_vector("start", start, OUTSIDE), self._joint_vector("goal", goal)
        self._check_request(request)
        _require_free(begin, world, "the start")
        _require_free(end, world, "the goal")
        return self._plan(begin, [end], request, world, began)

    def plan_to_pose(
        self, start: JointValues, pose: Pose, request: PlanRequest, world: CollisionWorld, configuration: str = ""
    ) -> Plan:
        """Plan a motion that brings the robot's tip to a pose in its base frame, or raise KinematicsError.

        Straight motions to all joint solutions, of a `configuration` (`Configuration.parse`), are tried first; a search is given
        the nearest ones that are free.
        """
        began = self._clock()
        begin = self._joint_vector("start", start, OUTSIDE)
        self._check_request(request)
        _require_free(begin, world, "the start")
        wanted = Configuration.parse(configuration) if configuration.strip() else None
        goals = [solution.q for solution in self._solver.all(pose, self._in_range(begin), wanted)]
        free = [goal for goal in goals if world.is_free(goal)]
        if not free:
            _require_free(goals[0], world, Sentence("the goal"))
        return self._plan(begin, free, request, world, began)

    def _joint_vector(self, name: str, values: JointValues, beyond: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        q = np.array(values, dtype=np.float64)
        joints = len(self._robot.joint_names)
        if q.shape != (joints,):
            names = ", ".join(self._robot.joint_names)
            raise PlanningError(f"{name} has {q.size} values; expected {joints}, one for each of {names}")
        self._robot.check_range(q, beyond)
        return q

    def _in_range(self, q: np.ndarray) -> np.ndarray:
        return np.clip(q, self._robot.lower, self._robot.upper)

    def _check_request(self, request: PlanRequest) -> None:
        speed = 1.0 if request.speed_scale is None else request.speed_scale
        acceleration = 1.0 if request.acceleration_scale is None else request.acceleration_scale
        check_request(request.duration, speed, acceleration, request.waypoints, None)
        self._settings.bounds.check(request.duration or 0.0, request.waypoints or 0)

    def _plan(
        self, start: np.ndarray, goals: list[np.ndarray], request: PlanRequest, world: CollisionWorld, began: float
    ) -> Plan:
        planner, trajectory, report = self._find(start, goals, request, world, began)
        planning_time = self._clock() - began - report.recheck_time
        return request.plan(planner, planning_time, trajectory, report, world.scene.hash)

    def _find(
        self, start: np.ndarray, goals: list[np.ndarray], request: PlanRequest, world: CollisionWorld, began: float
    ) -> tuple[str, Trajectory, PlanReport]:
        """Return which planner found a motion, the motion, and what was measured on it."""
        settings = self._settings
        validator = self._validator(world, 0)
        for goal in goals:
            if validator.free(start, goal):
                timed = self._timed(np.array([start, goal]), request, world)
                if timed is not None:
                    return DIRECT, *timed
        goals = goals[:GOALS]
        inside = self._in_range(start)
        lower, upper = self._bounds(inside, goals)
        attempt = 0
        while (left := settings.planning_budget - (self._clock() - began)) > 0.0:
            query = PathQuery(inside, goals, validator, lower, upper, settings.seed + attempt)
            try:
                path = self._search.find(query, left)
            except NoPathError as error:
                raise NoPathError(self._search.name, self._clock() - began) from error
            path[0] = start
            timed = self._timed(path, request, world)
            if timed is not None:
                return self._search.name, *timed
            # the path passed through something thinner than the step of its check: check with smaller steps
            attempt += 1
            validator = self._validator(world, attempt)
        raise NoPathError(self._search.name, self._clock() - began)

    def _validator(self, world: CollisionWorld, attempt: int) -> MotionValidator:
        """Return a check of motions with a step that is half as long at each further attempt."""
        return MotionValidator(world, world.levers, self._settings.edge_step / 2 ** min(attempt, FINEST_HALVING))

    def _bounds(self, start: np.ndarray, goals: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return the joint values to search: for a revolute joint with more than one turn, one turn around the ends."""
        lower, upper = np.array(self._robot.lower), np.array(self._robot.upper)
        ends = np.array([start, *goals])
        turns = ~np.array(self._robot.linear) & (upper - lower > TURN)
        return (
            np.where(turns, np.maximum(lower, ends.min(axis=0) - 0.5 * TURN), lower),
            np.where(turns, np.minimum(upper, ends.max(axis=0) + 0.5 * TURN), upper),
        )

    def _timed(
        self, path: np.ndarray, request: PlanRequest, world: CollisionWorld
    ) -> tuple[Trajectory, PlanReport] | None:
        """Round a path's corners, time it and check every sample; None if it touches something even with the tightest corners."""
        speed_scale = request.speed_scale
        if speed_scale is None:  # a duration already determines the speed, so the default applies only without one
            speed_scale = self._settings.speed_scale if request.duration is None else 1.0
        pace = np.array(self._robot.velocity)
        for attempt in range(TIMINGS_TRIED):
            if len(path) > 2:
                rounding = CornerRounding(self._validator(world, attempt), pace, between=attempt > 0)
                tightened = rounding.tightened(path)
                if tightened is None:
                    return None
                path = tightened
            timed = timed_path(
                path,
                self._robot,
                request.duration,
                speed_scale,
                request.acceleration_scale,
                request.waypoints,
                corner_fraction=1.0,
                bounds=self._settings.bounds,
            )
            try:
                report = recheck(timed.trajectory, self._robot, world, self._clock, timed.usage)
                return timed.trajectory, report
            except CollisionError as error:
                if len(path) == 2:
                    return None
                if request.waypoints is not None:
                    count, why = request.waypoints, str(error)
                    found = Sentence(
                        "{count} waypoints leave the path: {problem}; ask for more", count=count, problem=why
                    )
                    raise PlanningError(found) from error
                path = with_midpoints(path)
        return None


def _require_free(q: np.ndarray, world: CollisionWorld, where: str) -> None:
    contact = world.contact(q)
    if contact is not None:
        raise CollisionError(contact.between, where)

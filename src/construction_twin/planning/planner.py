"""Motion planning: a path from OMPL, timed, as a plan for review.

Joint vectors are in the order of `RobotModel.joint_names` [rad]; poses are of the robot's tip in its base frame. Knows
no obstacles of its own: what makes a joint vector valid, besides the ranges, is an argument.

OMPL keeps two things per process, not per planner: its log, which is switched off here (outcomes are results or
errors), and the seed of its random numbers, which can be set only once, before the first plan. Its time budgets run on
its own clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pydantic
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from construction_twin.errors import NoPathError, PlanningError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.robot import RobotModel
from construction_twin.planning.timing import time_path, with_midpoints
from construction_twin.plan import Plan
from construction_twin.trajectory import Trajectory

#: Planners by the name used in the configuration. The last three use their whole time budget to improve the path.
PLANNERS = {
    "RRTConnect": og.RRTConnect,
    "LBKPIECE1": og.LBKPIECE1,
    "PRM": og.PRM,
    "RRTstar": og.RRTstar,
    "BITstar": og.BITstar,
}
#: Distance between the states checked along a path, as a share of the joint space's extent.
CHECK_RESOLUTION = 0.002
#: How often a path is given twice as many points when the motion timed through them is not valid.
DENSIFY_ROUNDS = 4
#: How many paths are found before giving up on one that can be timed without touching what it must not.
PATHS_TRIED = 4

IsValid = Callable[[np.ndarray], bool]
Clock = Callable[[], float]


class PlannerSettings(pydantic.BaseModel):
    """How the planner works. The values, each explained, are in config/planner.yaml; none has a second default here.

    Attributes
    ----------
    planner : str
        A key of `PLANNERS`.
    planning_budget, simplify_budget, ik_budget : float
        [s]
    speed_scale : float
        Used by requests that give neither this nor a duration, in (0, 1].
    max_waypoints : int
        Requests for more are refused.
    seed : int
        0: different every time.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    planner: str
    planning_budget: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    simplify_budget: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    ik_budget: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    speed_scale: Annotated[float, pydantic.Field(gt=0.0, le=1.0)]
    max_waypoints: Annotated[int, pydantic.Field(ge=2)]
    seed: Annotated[int, pydantic.Field(ge=0, lt=2**32)]

    @pydantic.field_validator("planner")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in PLANNERS:
            raise ValueError(f"expected one of {', '.join(PLANNERS)}")
        return name


@dataclass(frozen=True)
class PlanRequest:
    """What is asked of a plan besides its ends, and what identifies it.

    Attributes
    ----------
    plan_id : str
        Unique id of the plan to be made.
    created_ns : int
        Time of the request [ns, ROS time].
    source : str
        Who asks, for the reviewer.
    duration : float, optional
        [s]; None: as fast as `speed_scale` allows.
    speed_scale : float, optional
        Share of the velocity and acceleration limits in (0, 1]; None: the planner's default, or 1 with a duration.
    waypoints : int, optional
        None: the default of `timing.time_path`.
    """

    plan_id: str
    created_ns: int
    source: str = "request"
    duration: float | None = None
    speed_scale: float | None = None
    waypoints: int | None = None


class Planner:
    """Plans joint motions of one robot.

    Parameters
    ----------
    robot : RobotModel
    chain : Chain
        The robot's kinematics, for goals given as poses.
    settings : PlannerSettings
    clock : callable
        Returns seconds from any fixed origin; measures planning time and ends the IK's budget.
    is_valid : callable, optional
        Tells whether the robot may be at joint angles, array, shape (n,) [rad]; asked for states within the ranges.
        Default: everything in range is valid.
    """

    def __init__(
        self, robot: RobotModel, chain: Chain, settings: PlannerSettings, clock: Clock, is_valid: IsValid | None = None
    ):
        self._robot = robot
        self._chain = chain
        self._settings = settings
        self._clock = clock
        self._is_valid = is_valid or (lambda q: True)
        self._rng = np.random.default_rng(settings.seed or None)
        ou.noOutputHandler()
        if settings.seed:
            ou.RNG.setSeed(settings.seed)

    def plan_to_joints(self, start: Sequence[float], goal: Sequence[float], request: PlanRequest) -> Plan:
        """Plan a motion between two joint vectors.

        Parameters
        ----------
        start, goal : sequence of float, length n
            [rad], order of the robot's `joint_names`.
        request : PlanRequest

        Returns
        -------
        plan : Plan

        Raises
        ------
        JointRangeError
            If start or goal is out of range.
        NoPathError
            If none was found within the budget.
        DurationError
            If the requested duration is shorter than the limits allow.
        PlanningError
            If the request does not make sense: also a goal where the arm already is (`TrajectoryError`).
        """
        began = self._clock()
        start, goal = self._joint_vector("start", start), self._joint_vector("goal", goal)
        self._check_request(start, goal, request)
        trajectory = self._find_trajectory(start, goal, request)
        return Plan(
            id=request.plan_id,
            hash=trajectory.content_hash(),
            source=request.source,
            planner=self._settings.planner,
            created_ns=request.created_ns,
            planning_time=self._clock() - began,
            trajectory=trajectory,
        )

    def plan_to_pose(self, start: Sequence[float], pose: Pose, request: PlanRequest) -> Plan:
        """Plan a motion that brings the robot's tip to a pose.

        The joint solution taken is the one the inverse kinematics reaches from `start`.

        Parameters
        ----------
        start : sequence of float, length n
            [rad], order of the robot's `joint_names`.
        pose : Pose
            Of the tip in the robot's base frame.
        request : PlanRequest

        Returns
        -------
        plan : Plan

        Raises
        ------
        KinematicsError
            If the pose cannot be reached within the ranges, or start is out of range.
        PlanningError
            See `plan_to_joints`.
        """
        start = self._joint_vector("start", start)
        solution = self._chain.inverse(
            pose, seed=start, rng=self._rng, budget_s=self._settings.ik_budget, clock=self._clock
        )
        return self.plan_to_joints(start, solution.q, request)

    def _joint_vector(self, name: str, values: Sequence[float]) -> np.ndarray:
        q = np.array(values, dtype=np.float64)
        joints = len(self._robot.joint_names)
        if q.shape != (joints,):
            names = ", ".join(self._robot.joint_names)
            raise PlanningError(f"{name} has {q.size} values; expected {joints}, one for each of {names}")
        self._robot.check_range(q)
        return q

    def _check_request(self, start: np.ndarray, goal: np.ndarray, request: PlanRequest) -> None:
        limit = self._settings.max_waypoints
        if request.waypoints is not None and request.waypoints > limit:
            raise PlanningError(f"{request.waypoints} waypoints are requested; this planner makes at most {limit}")
        for name, q in (("start", start), ("goal", goal)):
            if not self._is_valid(q):
                values = np.round(q, 6).tolist()
                raise PlanningError(f"the {name} {values} rad is in range but not allowed; choose another")

    def _find_trajectory(self, start: np.ndarray, goal: np.ndarray, request: PlanRequest) -> Trajectory:
        for _ in range(PATHS_TRIED):
            trajectory = self._timed(self._find_path(start, goal), request)
            if trajectory is not None:
                return trajectory
        raise NoPathError(self._settings.planner, self._settings.planning_budget)

    def _find_path(self, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return a valid polyline from start to goal, shape (m, n); its ends are start and goal to the last bit."""
        setup = self._setup(start, goal)
        if not setup.solve(self._settings.planning_budget) or not setup.haveExactSolutionPath():
            raise NoPathError(self._settings.planner, self._settings.planning_budget)
        setup.simplifySolution(self._settings.simplify_budget)
        states = setup.getSolutionPath().getStates()
        path = np.array([[state[joint] for joint in range(len(start))] for state in states])
        path[0], path[-1] = start, goal
        # OMPL's shortcuts are random and may miss the best of all
        if setup.getSpaceInformation().checkMotion(states[0], states[-1]):
            return path[[0, -1]]
        return path

    def _setup(self, start: np.ndarray, goal: np.ndarray) -> og.SimpleSetup:
        joints = range(len(start))
        bounds = ob.RealVectorBounds(len(start))
        for joint in joints:
            bounds.setLow(joint, self._robot.lower[joint])
            bounds.setHigh(joint, self._robot.upper[joint])
        space = ob.RealVectorStateSpace(len(start))
        space.setBounds(bounds)
        setup = og.SimpleSetup(space)
        setup.setStateValidityChecker(lambda state: bool(self._is_valid(np.array([state[joint] for joint in joints]))))
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(CHECK_RESOLUTION)
        setup.setPlanner(PLANNERS[self._settings.planner](information))
        ends = space.allocState(), space.allocState()
        for state, q in zip(ends, (start, goal)):
            for joint in joints:
                state[joint] = float(q[joint])
        setup.setStartAndGoalStates(*ends)
        return setup

    def _timed(self, path: np.ndarray, request: PlanRequest) -> Trajectory | None:
        """Time a path; None if the curve through its points cuts a corner it must not, however dense they are."""
        speed_scale = request.speed_scale
        if speed_scale is None:  # a duration says how fast; the default only replaces a missing answer to that question
            speed_scale = self._settings.speed_scale if request.duration is None else 1.0
        for _ in range(DENSIFY_ROUNDS + 1):
            trajectory = time_path(path, self._robot, request.duration, speed_scale, request.waypoints)
            if self._passes_only_valid(trajectory):
                return trajectory
            path = with_midpoints(path)
        return None

    def _passes_only_valid(self, trajectory: Trajectory) -> bool:
        extent = np.linalg.norm(np.array(self._robot.upper) - self._robot.lower)
        length = np.sum(np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1))
        count = max(len(trajectory.times), math.ceil(length / (CHECK_RESOLUTION * extent))) + 1
        positions = trajectory.sample_many(np.linspace(0.0, trajectory.duration, count))[0]
        return all(self._is_valid(q) for q in positions)

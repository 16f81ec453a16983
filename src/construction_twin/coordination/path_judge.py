"""The watch's verdicts on our plans: may they start, may they continue? No ROS; times in s, `Claim.since` in ns."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from construction_twin.coordination.conflict import Claim, Conflict, OwnPath, gives_way
from construction_twin.coordination.path_sweep import PlanPosition
from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.execution.states import ACTIVE, ExecutorState
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.scene.neighbour import Neighbour, Obstacle
from construction_twin.scene.objects import Scene

#: Pairs of copies that one check compares beyond the horizon: this takes about 0.01 s.
BUDGET = 500_000


@dataclass(frozen=True)
class Judgement:
    """A verdict on one plan.

    Attributes:
        time: As in `Conflict.msg`: time until the conflict, 0 if unknown, -1 without a conflict [s].
    """

    blocked: bool
    time: float
    sentence: str


@dataclass(frozen=True)
class Others:
    """The other arm at the time of one check.

    Attributes:
        claim: None: it follows no plan, or this is not known.
        unknown: Why its pose is unknown, so that its whole reach is used; empty: the pose is known.
        complete: Whether the obstacles contain its path to the end, not only until beyond our horizon.
    """

    obstacles: Collection[Obstacle]
    claim: Claim | None = None
    unknown: str = ""
    complete: bool = True


class PathJudge:
    """Keeps the results of each plan's path from one check to the next.

    Args:
        robot: Ours; its name decides if both plans began at the same time.
        padding: Distance below which a plan may not start or go on, on top of our scene's padding [m].
    """

    def __init__(self, robot: RobotModel, neighbour: str, padding: float, step: float, horizon: float):
        self._robot = robot
        self._neighbour = neighbour
        self._padding = padding
        self._horizon = horizon
        self._bare = Neighbour(robot.name, robot, Pose(np.zeros(3), np.eye(3)), step)
        self._arm = self._bare
        self._scene = ""
        self._paths: dict[str, OwnPath] = {}
        self._at = PlanPosition("", 0)

    def waiting(self, plan: Plan, scene: Scene | None, others: Others) -> Judgement:
        """Judge a plan that waits for review: its whole path must have been compared before it may start.

        Raises:
            SceneError: If what our arm carries cannot be used.
        """
        return self._judge(plan, scene, others, Claim(0, self._robot.name), None, 0.0)

    def followed(
        self, plan: Plan, scene: Scene | None, others: Others, started: int, poses: Iterable[np.ndarray]
    ) -> Judgement:
        """Judge the plan that is played, from our arm's present pose: up to the horizon at once, the rest over the next checks.

        Args:
            started: Stamp of its first setpoint, 0 before [ns].
            poses: Each of shape (n,). Of our arm, commanded and measured; empty: unknown.
        """
        return self._judge(plan, scene, others, Claim(started, self._robot.name), tuple(poses), self._horizon)

    def forget(self, kept: Collection[str]) -> None:
        """Forget all plans except those with the given ids."""
        self._paths = {plan_id: path for plan_id, path in self._paths.items() if plan_id in kept}

    def _judge(
        self, plan: Plan, scene: Scene | None, others: Others, own: Claim, poses: tuple | None, horizon: float
    ) -> Judgement:
        if scene is None:
            return Judgement(True, 0.0, Sentence("reason.neighbour.no_scene"))
        path = self._path(plan, scene)
        row = self._present_row(path, poses) if own.since and poses is not None else 0
        check = path.check(others.obstacles, self._padding + scene.padding, row, horizon, BUDGET)
        lost = bool(own.since) and not poses
        if check.conflict is None:
            if (check.fraction < 1.0 or not others.complete) and (poses is None or lost):
                return Judgement(True, 0.0, self._so_far(check.fraction, others))
            return Judgement(False, -1.0, Sentence("reason.neighbour.free"))
        # without our own position on the path, the time until the conflict is unknown
        conflict = Conflict(0.0, check.conflict.between) if lost else check.conflict
        blocked = gives_way(conflict, own, others.claim, self._horizon)
        return Judgement(blocked, conflict.time, self._sentence(conflict, others, blocked))

    def _present_row(self, path: OwnPath, poses: tuple[np.ndarray, ...]) -> int:
        """Return our arm's row on a plan: the smaller of the measured and the commanded one, never less than before."""
        known = self._at.row if self._at.plan_id == path.plan.id else 0
        found = [path.row_of(pose, known) for pose in poses]
        self._at = PlanPosition(path.plan.id, min((known if row is None else row for row in found), default=known))
        return self._at.row

    def _path(self, plan: Plan, scene: Scene) -> OwnPath:
        if scene.hash != self._scene:
            self._arm = self._bare.carrying(scene.objects)
            self._scene, self._paths = scene.hash, {}
        if plan.id not in self._paths:
            self._paths[plan.id] = OwnPath(plan, self._arm)
        return self._paths[plan.id]

    def _so_far(self, fraction: float, others: Others) -> str:
        key = "reason.neighbour.checking" if others.complete else "reason.neighbour.checking_first_part"
        return Sentence(key, percent=round(min(fraction, 0.99) * 100.0), neighbour=self._neighbour)

    def _sentence(self, conflict: Conflict, others: Others, blocked: bool) -> str:
        mine, theirs = conflict.between
        seconds, neighbour = conflict.time, self._neighbour
        if others.unknown:
            unknown = others.unknown
            key = "reason.neighbour.whole_reach"
            return Sentence(key, mine=mine, neighbour=neighbour, seconds=seconds, unknown=unknown)
        contact = Sentence("reason.neighbour.too_close", mine=mine, theirs=theirs, seconds=seconds)
        if not blocked:
            return Sentence("reason.neighbour.gives_way", contact=contact, neighbour=neighbour)
        return Sentence(f"reason.neighbour.{'stands' if others.claim is None else 'follows_plan'}", contact=contact)


#: Plans kept: the one followed, the one under review, and a few that were replaced while another one ran.
_KEPT = 8


class PlanBook:
    """The plans of one arm and their states.

    Attributes:
        started: Stamp of the first setpoint of the plan that is followed [ns]; 0: it has not begun.
    """

    def __init__(self):
        self.started = 0
        self._plans: dict[str, Plan] = {}
        self._waiting = ""
        self._state: ExecutorState | None = None
        self._followed = ""

    def on_plan(self, plan: Plan) -> None:
        """Take a new plan; it replaces the one that waits."""
        self._plans[plan.id] = plan
        self._waiting = plan.id
        for name in [*self._plans][:-_KEPT]:
            if name != self._followed:
                del self._plans[name]

    def on_execution(self, state: int, plan_id: str, started: int) -> None:
        """Take the executor's state, as in `Execution.msg`; raises ValueError for an unknown state."""
        self._state = ExecutorState(state)
        self._followed, self.started = plan_id, started
        if plan_id and plan_id == self._waiting:
            self._waiting = ""

    def on_verdict(self, plan_id: str, approved: bool) -> None:
        """Take a verdict: a plan that was rejected or withdrawn waits no longer."""
        if plan_id == self._waiting and not approved:
            self._waiting = ""

    def waiting(self) -> Plan | None:
        """Return the plan that waits for review."""
        return self._plans.get(self._waiting)

    def followed(self) -> Plan | None:
        """Return the approved plan that has not ended; None for an arm that follows no plan.

        Raises:
            PlanUnknownError: If the arm's plan is not known.
        """
        if self._state is None:
            raise PlanUnknownError(Sentence("reason.neighbour.executor_silent"))
        if self._state not in ACTIVE:
            return None
        if self._followed not in self._plans:
            raise PlanUnknownError(Sentence("reason.neighbour.earlier_plan", plan=self._followed))
        return self._plans[self._followed]


class PlanUnknownError(ConstructionTwinError):
    """The path that an arm follows is not known."""

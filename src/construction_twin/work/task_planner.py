"""From a job to a work plan, by the process that its recipe names: what all processes have alike. The process plans the motions.

Every segment of the plan begins and ends at rest, is checked at each 4 ms sample and between them in the scene that the segments
before it leave, and lasts a whole number of cycles. Joint vectors in the order of `RobotModel.joint_names`, SI; poses in the
robot's base_link. Not for use from several threads at once. Knows no ROS; time and randomness are arguments.
"""

from __future__ import annotations

import numpy as np

from construction_twin.core.clock import Clock
from construction_twin.core.motion_errors import KinematicsError
from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import TaskPlanningError
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import InverseKinematics
from construction_twin.planning.planner import Planner, PlannerSettings
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.tool import ToolFile
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision
from construction_twin.work.contacts import Shapes, tool_objects
from construction_twin.work.jobs import TaskMotions, WorkJob
from construction_twin.work.motions import Failed, Search, TaskLimits, Worlds
from construction_twin.work.process import process_of
from construction_twin.work.recipes import Recipes


class TaskPlanner:
    """Plans tasks of one robot with one tool.

    The same job from the same pose in the same scene gives the same plan, unless a budget runs out.

    Args:
        clock: Returns seconds from any fixed origin.
    """

    def __init__(
        self,
        robot: RobotModel,
        solver: InverseKinematics,
        settings: PlannerSettings,
        self_collision: SelfCollision,
        tool: ToolFile,
        recipes: Recipes,
        clock: Clock,
        limits: TaskLimits = TaskLimits(),
    ):
        self._robot, self._solver, self._tool, self._recipes = robot, solver, tool, recipes
        self._self_collision, self._clock, self._limits = self_collision, clock, limits
        self._settings = settings
        budget = min(settings.planning_budget, limits.free_budget)
        self._planner = Planner(robot, solver, settings.model_copy(update={"planning_budget": budget}), clock)
        self._shapes = Shapes()
        self._world: CollisionWorld | None = None

    def plan(
        self,
        job: WorkJob,
        start: JointValues,
        scene: Scene,
        held: Pose | None = None,
    ) -> TaskMotions:
        """Plan a task.

        Args:
            start: Length n. Where the arm stands.
            held: ``tool0_T_element`` of an element that is in the grip already, as `TaskMotions.tool0_T_element` of the plan that
                gripped it: the rest of the task is planned.
        """
        began = self._clock()
        name, recipe = self._recipes.of(job)
        process = process_of(recipe.process)
        q = np.array(start, dtype=float)
        search = Search(
            job, name, recipe, q, scene, held, began, self._robot, self._solver, self._planner, self._settings,
            self._tool, self._limits, self._clock, Worlds(self._world_of), self._shapes,
        )  # fmt: skip
        process.check(search)
        self._check_tool(job, scene)
        self._check_start(job, q, search.worlds.of(scene))
        try:
            return process.plan(search)
        except Failed as failed:
            raise TaskPlanningError(job.task, failed.reason, failed.stage, failed.method) from failed

    def _world_of(self, scene: Scene) -> CollisionWorld:
        if self._world is None:
            self._world = CollisionWorld(self._robot, scene, self._self_collision)
        else:
            self._world = self._world.with_scene(scene)
        return self._world

    def _check_tool(self, job: WorkJob, scene: Scene) -> None:
        """Refuse a scene without the tool."""
        present = {item.name: item for item in scene.objects}
        for item in tool_objects(self._tool, self._robot.tip_link):
            found = present.get(item.name)
            if found is None or found.contents() != item.contents():
                raise TaskPlanningError(
                    job.task,
                    Sentence(
                        "the tool's {body} is not in the scene; put the tool into the scene first"
                        if found is None
                        else "the tool's {body} is in the scene, but not as the tool file has it; put the tool into the scene "
                        "first",
                        body=repr(item.name),
                    ),
                )

    def _check_start(self, job: WorkJob, start: np.ndarray, world: CollisionWorld) -> None:
        try:
            self._robot.check_range(start)
        except KinematicsError as error:
            raise TaskPlanningError(job.task, Sentence("the arm's pose: {problem}", problem=str(error))) from error
        contact = world.contact(start)
        if contact is not None:
            one, other = contact.between
            raise TaskPlanningError(
                job.task,
                Sentence(
                    "where the arm stands {first} touches {second}, or is closer than the padding",
                    first=one,
                    second=other,
                ),
            )

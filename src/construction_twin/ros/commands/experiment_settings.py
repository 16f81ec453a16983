"""What the experiment node is given, checked as a whole: by the node, and by `preflight` before anything starts."""

from __future__ import annotations

from typing import Annotated

import pydantic

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import from_wire
from construction_twin.robot.description import RobotModel

_Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]


class ExperimentSettings(pydantic.BaseModel):
    """Private parameters; see config/experiment.yaml. `results_dir` is an absolute path."""

    model_config = pydantic.ConfigDict(extra="forbid")

    results_dir: Annotated[str, pydantic.Field(pattern=r"^[/~]")]
    goals_deg: Annotated[list[list[pydantic.FiniteFloat]], pydantic.Field(min_length=1)]
    duration: _Positive
    waypoints: Annotated[int, pydantic.Field(ge=2)]
    timeout: _Positive
    topics: Annotated[list[str], pydantic.Field(min_length=1)]


def check_goals(settings: ExperimentSettings, robot: RobotModel) -> None:
    """Check that the robot could be at every goal.

    Raises:
        ConstructionTwinError: For a goal with another number of joints.
        JointRangeError: For one outside of a joint's range.
    """
    joints = len(robot.joint_names)
    for goal in settings.goals_deg:
        if len(goal) != joints:
            raise ConstructionTwinError(
                f"a goal in ~goals_deg has {len(goal)} values; {robot.name} has {joints} joints"
            )
        robot.check_range(from_wire(goal, robot.linear))

"""From an approved plan to setpoints every 4 ms: start, pause, resume, stop, hold and speed limit.

In: an approved plan, the twin's pose, reports of gate, link, scene and neighbour, speed limits. Out: one setpoint per cycle,
the executor's state and the outcome of each plan. May import ``core``, ``robot``, ``physics`` (the record of a
rehearsal), ``review`` and ``monitor``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.execution.approval import Approval as Approval
    from construction_twin.execution.conflict_verdicts import ConflictVerdicts as ConflictVerdicts
    from construction_twin.execution.engagement import Engagement as Engagement
    from construction_twin.execution.executor import Executor as Executor
    from construction_twin.execution.executor import TwinPose as TwinPose
    from construction_twin.execution.goal_states import GoalState as GoalState
    from construction_twin.execution.joint_tolerances import ToleranceRequest as ToleranceRequest
    from construction_twin.execution.joint_tolerances import Tolerances as Tolerances
    from construction_twin.execution.play_rate import PlayRate as PlayRate
    from construction_twin.execution.playback import StopForecaster as StopForecaster
    from construction_twin.execution.states import ExecutorEvent as ExecutorEvent
    from construction_twin.execution.states import ExecutorState as ExecutorState
    from construction_twin.execution.stopping import StoppingForecast as StoppingForecast
    from construction_twin.execution.tracking import Tracking as Tracking
    from construction_twin.execution.trajectory_goals import TrajectoryGoal as TrajectoryGoal
    from construction_twin.execution.trajectory_goals import TrajectoryGoals as TrajectoryGoals
    from construction_twin.execution.way_back import check_way_back as check_way_back
    from construction_twin.execution.way_back import scene_problem as scene_problem
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

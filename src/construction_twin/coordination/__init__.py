"""Two arms in one cell: whether the paths of both meet, and which arm gives way.

In: plans, poses, executions and scenes of both arms. Out: a verdict for the plan that waits and for the one that is played. May
import ``core``, ``robot``, ``kinematics``, ``scene``, ``planning`` and ``execution``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.coordination.conflict import Claim as Claim
    from construction_twin.coordination.conflict import Conflict as Conflict
    from construction_twin.coordination.conflict import OwnPath as OwnPath
    from construction_twin.coordination.conflict import PathCheck as PathCheck
    from construction_twin.coordination.conflict import braking_horizon as braking_horizon
    from construction_twin.coordination.conflict import gives_way as gives_way
    from construction_twin.coordination.path_judge import Judgement as Judgement
    from construction_twin.coordination.path_judge import Others as Others
    from construction_twin.coordination.path_judge import PathJudge as PathJudge
    from construction_twin.coordination.path_sweep import PathSweep as PathSweep
    from construction_twin.coordination.path_sweep import PlanPosition as PlanPosition
    from construction_twin.coordination.plan_book import PlanBook as PlanBook
    from construction_twin.coordination.plan_book import PlanUnknownError as PlanUnknownError
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

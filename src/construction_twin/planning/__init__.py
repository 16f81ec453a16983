"""From a goal to a plan: path search, tool paths, time scaling, and the check of what was made.

In: joint goals, poses, tool paths, waypoint files; a scene and the present pose. Out: a plan that was checked
against ranges and limits at every 4 ms sample and against the scene there and in between, or a typed error that names the cause.
May import ``core``, ``robot``, ``kinematics`` and ``scene``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.planning.cartesian import CartesianMotion as CartesianMotion
    from construction_twin.planning.cartesian import plan_cartesian as plan_cartesian
    from construction_twin.planning.limit_usage import cycle_times as cycle_times
    from construction_twin.planning.limit_usage import sampled_usage as sampled_usage
    from construction_twin.planning.ompl_search import OmplSearch as OmplSearch
    from construction_twin.planning.path_search import PathQuery as PathQuery
    from construction_twin.planning.path_search import PathSearch as PathSearch
    from construction_twin.planning.pipeline import PlanningPipeline as PlanningPipeline
    from construction_twin.planning.planner import Planner as Planner
    from construction_twin.planning.planner import PlannerSettings as PlannerSettings
    from construction_twin.planning.planner import PlanRequest as PlanRequest
    from construction_twin.planning.recheck import check_free as check_free
    from construction_twin.planning.recheck import check_limits as check_limits
    from construction_twin.planning.request_limits import PlanBounds as PlanBounds
    from construction_twin.planning.timing import minimum_duration as minimum_duration
    from construction_twin.planning.timing import time_curve as time_curve
    from construction_twin.planning.timing import time_path as time_path
    from construction_twin.planning.tool_path import ToolPath as ToolPath
    from construction_twin.planning.tool_path import ToolWaypoint as ToolWaypoint
    from construction_twin.planning.waypoint_file import format_plan as format_plan
    from construction_twin.planning.waypoint_file import format_waypoints as format_waypoints
    from construction_twin.planning.waypoint_file import parse_waypoints as parse_waypoints
    from construction_twin.planning.waypoints import Waypoints as Waypoints
    from construction_twin.planning.waypoints import from_points as from_points
    from construction_twin.planning.waypoints import plan_waypoints as plan_waypoints
    from construction_twin.planning.waypoints import retime_waypoints as retime_waypoints
    from construction_twin.planning.work_plan import plan_work as plan_work
    from construction_twin.planning.work_segment import WorkSegment as WorkSegment
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

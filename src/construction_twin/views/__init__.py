"""What a person sees in terminal and rviz: command line, dashboard, start-up report, ghosts, colours and texts.

In: records of the other folders, arguments of a command line. Out: texts, pictures in the terminal, marker records, requests.
Draws and asks, but never decides what may move. May import ``core``, ``robot``, ``kinematics``, ``scene``, ``physics`` (the
record of a rehearsal), ``monitor`` and ``link``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.views.dashboard import render as render
    from construction_twin.views.goals import joint_goal as joint_goal
    from construction_twin.views.goals import pose_goal as pose_goal
    from construction_twin.views.marker_goal import MarkerGoal as MarkerGoal
    from construction_twin.views.preview import PlanPicture as PlanPicture
    from construction_twin.views.preview import Preview as Preview
    from construction_twin.views.reachability import PoseVerdict as PoseVerdict
    from construction_twin.views.reachability import Reach as Reach
    from construction_twin.views.reachability import judge_pose as judge_pose
    from construction_twin.views.roslaunch_call import RoslaunchCall as RoslaunchCall
    from construction_twin.views.roslaunch_call import argument_problem as argument_problem
    from construction_twin.views.roslaunch_call import known_arguments as known_arguments
    from construction_twin.views.snapshot import Snapshot as Snapshot
    from construction_twin.views.startup import Deployment as Deployment
    from construction_twin.views.startup import StartUp as StartUp
    from construction_twin.views.texts import caller_line as caller_line
    from construction_twin.views.texts import plan_lines as plan_lines
    from construction_twin.views.texts import scene_lines as scene_lines
    from construction_twin.views.texts import waiting_plan as waiting_plan
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

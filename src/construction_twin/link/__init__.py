"""The bridge's side of the link: who may command, mirror mode, speed limits, and review by MQTT.

In: the gateway's status and states, requests of people, the gate's command stream. Out: the link's state, sessions, control
messages for the gateway, plans and verdicts as JSON. May import ``core``, ``mqtt`` and ``gateway``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.link.bare_supervisor import BareSupervisor as BareSupervisor
    from construction_twin.link.goal_request import GoalRequest as GoalRequest
    from construction_twin.link.goal_request import IkRequest as IkRequest
    from construction_twin.link.goal_request import parse_ik as parse_ik
    from construction_twin.link.goal_request import parse_plan_request as parse_plan_request
    from construction_twin.link.remote_review import PlanBoard as PlanBoard
    from construction_twin.link.remote_review import PlanView as PlanView
    from construction_twin.link.remote_review import ReviewRequest as ReviewRequest
    from construction_twin.link.remote_review import SegmentView as SegmentView
    from construction_twin.link.remote_review import parse_review as parse_review
    from construction_twin.link.remote_trajectory import TrajectoryRequest as TrajectoryRequest
    from construction_twin.link.remote_trajectory import parse_trajectory as parse_trajectory
    from construction_twin.link.remote_view import PoseView as PoseView
    from construction_twin.link.remote_view import Seen as Seen
    from construction_twin.link.remote_view import Shown as Shown
    from construction_twin.link.remote_view import ViewWriter as ViewWriter
    from construction_twin.link.speed_forwarder import SpeedForwarder as SpeedForwarder
    from construction_twin.link.states import LinkEvent as LinkEvent
    from construction_twin.link.states import LinkState as LinkState
    from construction_twin.link.supervisor import LinkSupervisor as LinkSupervisor
    from construction_twin.link.tool_link import ToolLink as ToolLink
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

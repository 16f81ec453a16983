"""Conversion between ROS messages and the library's records, in both directions, without any logic.

In: messages, or records. Out: the other of the two, or a typed error for a message that does not fit. May import the library
and ``ros.transport``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.ros.messages.convert import change_from_msg as change_from_msg
    from construction_twin.ros.messages.convert import plan_from_msg as plan_from_msg
    from construction_twin.ros.messages.convert import plan_to_msg as plan_to_msg
    from construction_twin.ros.messages.convert import pose_from_msg as pose_from_msg
    from construction_twin.ros.messages.convert import pose_from_transform_msg as pose_from_transform_msg
    from construction_twin.ros.messages.convert import segment_to_msg as segment_to_msg
    from construction_twin.ros.messages.convert import trajectory_from_msg as trajectory_from_msg
    from construction_twin.ros.messages.convert import trajectory_to_msg as trajectory_to_msg
    from construction_twin.ros.messages.joint_goals import trajectory_goal as trajectory_goal
    from construction_twin.ros.messages.plan_requests import plan_request as plan_request
    from construction_twin.ros.messages.scene_convert import object_from_msg as object_from_msg
    from construction_twin.ros.messages.scene_convert import object_to_msg as object_to_msg
    from construction_twin.ros.messages.scene_convert import scene_from_msg as scene_from_msg
    from construction_twin.ros.messages.scene_convert import scene_to_msg as scene_to_msg
    from construction_twin.ros.messages.tool import order_to_msg as order_to_msg
    from construction_twin.ros.messages.tool import tool_report_from_msg as tool_report_from_msg
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

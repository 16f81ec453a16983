"""Publishers and subscribers of the 250 Hz path, packed poses, and the 4 ms cycle.

In: joint positions and stamps. Out: the same over ROS, with the caller id of the publisher checked. May import ``core`` and
rospy; no other part of ``ros``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.ros.transport.cycle import Cycles as Cycles
    from construction_twin.ros.transport.goal_server import GoalServer as GoalServer
    from construction_twin.ros.transport.joint_stream import JointPublisher as JointPublisher
    from construction_twin.ros.transport.joint_stream import JointSubscriber as JointSubscriber
    from construction_twin.ros.transport.joint_stream import from_time as from_time
    from construction_twin.ros.transport.joint_stream import now_ns as now_ns
    from construction_twin.ros.transport.joint_stream import to_time as to_time
    from construction_twin.ros.transport.latest_pose import LatestPose as LatestPose
    from construction_twin.ros.transport.persistent_service import PersistentService as PersistentService
    from construction_twin.ros.transport.publisher import Publisher as Publisher
    from construction_twin.ros.transport.publisher import Sink as Sink
    from construction_twin.ros.transport.subscriber import Subscriber as Subscriber
    from construction_twin.ros.transport.subscriber import caller_of as caller_of
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

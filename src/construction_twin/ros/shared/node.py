"""What every node does around its own work: start, turn a typed error into one sentence, end."""

from __future__ import annotations

import sys
from collections.abc import Callable

import rospy

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.realtime import release_realtime, request_realtime


def run_node(name: str, start: Callable[[], object]) -> None:
    """Initialise ROS, build the node, serve until shutdown.

    The private parameter ``~realtime_priority``, where a node has one, applies to all its threads.

    Parameters
    ----------
    name : str
        Default node name.
    start : callable
        Builds the node; its result is kept alive. A result with a `run` method is run in the main thread.
    """
    rospy.init_node(name)
    try:
        node = start()
        rospy.on_shutdown(release_realtime)
        rospy.loginfo(request_realtime(rospy.get_param("~realtime_priority", 0)))
        if hasattr(node, "run"):
            node.run()
        else:
            rospy.spin()
    except ConstructionTwinError as error:
        rospy.logfatal("%s cannot run: %s", rospy.get_name(), error)
        sys.exit(1)
    except rospy.ROSInterruptException:
        return

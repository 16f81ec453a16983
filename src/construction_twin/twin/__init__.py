"""The virtual robot: what it does with a command, and how it follows the arm in mirror mode.

In: commands that passed the gate; in mirror mode the measured pose of the arm. Out: the twin's pose and its stamp. May import
``core``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.twin.backend import KinematicBackend as KinematicBackend
    from construction_twin.twin.backend import TwinBackend as TwinBackend
    from construction_twin.twin.gazebo import GazeboTwin as GazeboTwin
    from construction_twin.twin.mirror import MirrorTwin as MirrorTwin
    from construction_twin.twin.virtual_robot import TwinClock as TwinClock
    from construction_twin.twin.virtual_robot import VirtualRobot as VirtualRobot
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

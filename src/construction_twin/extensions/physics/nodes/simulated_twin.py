"""The twin with mass as the backend of `virtual_robot`: what it carries and what stands around it comes from `scene`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import rospy

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.worker import Worker
from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.known_mass import element_masses, tool_mass
from construction_twin.extensions.physics.live_twin import LiveTwin
from construction_twin.extensions.physics.mass import payload_of
from construction_twin.extensions.physics.process import PROGRAM
from construction_twin.msg import Scene, WorkTasks
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.scene_convert import scene_from_msg


class SimulatedTwin:
    """A LiveTwin whose models are built for each scene, in a process of their own.

    Attributes:
        scene: Hash of the simulated scene.
        scene_fault: Why the newest scene is not simulated; empty: it is.
    """

    def __init__(self, settings, robot: RobotModel, refuse: Callable[[str, str], None]):
        self.twin = LiveTwin()
        arm = {"robot": robot, "payload": tuple(settings.payload)}
        arm |= {name: getattr(settings, name) for name in ("self_collision", "drives")}
        #: Takes `scene`, and `masses` of bodies that the arm carries; returns the arm in it, and may take its time.
        self._build = partial(Worker(PROGRAM).ask, "build", arm=arm)
        self._refuse = refuse
        self.scene, self.scene_fault = "", ""
        #: Of the elements that are to be placed, and of the tool [kg].
        self._masses: dict[str, float] = {}
        self._tool_mass = tool_mass(settings.tool)

    def on_scene(self, message: Scene) -> None:
        """Build the arm in a scene, and go on in it. In rospy's thread of this connection, which may wait."""
        if message.hash == self.scene:
            # of a scene between that could not be simulated nothing is left
            self.scene_fault = ""
            return
        try:
            scene = scene_from_msg(message)
            model = self._build(scene=scene, masses=self._masses | self._tool_mass)
        except ConstructionTwinError as error:
            # the simulation goes on in the scene before
            self.scene_fault = str(error)
            self._refuse("scene", str(error))
            return
        self.twin.set_model(model)
        self.scene, self.scene_fault = scene.hash, ""
        rospy.loginfo("simulates scene %s", scene.hash[:12])
        for remark in model.remarks:
            rospy.loginfo("%s", remark)

    def on_tasks(self, message: WorkTasks) -> None:
        """Store what elements weigh, for the next scene: in that the arm carries one."""
        self._masses = element_masses(message.tasks)


def check(settings, robot: RobotModel) -> None:
    """Check payload and drives; see `NodeShell`."""
    payload_of(settings.payload, "payload")
    read_drives(settings.drives, robot)

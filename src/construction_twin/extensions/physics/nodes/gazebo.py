"""gazebo: makes the world of the arm in the present scene, and becomes Gazebo's server, which roslaunch starts again when it ends.

It commands nothing: the plugin in the server (gazebo/) hears `twin/commanded` and answers `virtual_robot` as the node `gazebo_arm`.
"""

from __future__ import annotations

import os
import shlex
import shutil
from pathlib import Path
from queue import Empty, Queue

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.files import write_atomically
from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.gazebo_world import check_serial, world_of
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.diagnostics import ERROR, WARN, Diagnosis
from construction_twin.ros.shared.node_shell import Interface, NodeIO, NodeShell, Shared, Subscription
from construction_twin.ros.shared.params import PrivateSettings, ros_home
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene

#: How often the main thread looks whether this process is to end [s].
_AWAKE = 0.5


class Settings(PrivateSettings):
    """Private parameters, given in launch/bringup.launch.

    Attributes:
        gzserver: Words that start Gazebo's server; the world's file is put behind them.
    """

    gzserver: str
    drives: str
    realtime: int = pydantic.Field(ge=0, le=99)


class GazeboNode:
    """A scene in; it becomes the server that simulates it."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: NodeIO):
        self._bodies, self._drives = RobotBodies(robot), read_drives(settings.drives, robot)
        self._priority, self._server = settings.realtime, find_gzserver(settings.gzserver)
        #: For the world and its meshes.
        self._folder = (ros_home() / "construction_twin" / f"{robot.name}_gazebo").absolute()
        self._refuse = node_io.diagnostics.refuse
        self._scenes: Queue[Scene] = Queue()
        self._fault = ""

    def on_scene(self, message: SceneMsg) -> None:
        """Take a scene."""
        try:
            self._scenes.put(scene_from_msg(message))
        except ConstructionTwinError as error:
            self._refuse("scene", str(error))

    def run(self) -> None:
        """Become the server of the first scene that can be simulated, in the main thread."""
        while not rospy.is_shutdown():
            try:
                scene = self._scenes.get(timeout=_AWAKE)
                while not self._scenes.empty():
                    scene = self._scenes.get()
                path = self._write(scene)
            except Empty:
                continue
            except (ConstructionTwinError, OSError) as error:
                self._fault = str(error)
                self._refuse("world", str(error))
                continue
            if rospy.is_shutdown():
                return
            rospy.loginfo("Gazebo simulates scene %s: %s", scene.hash[:12], path)
            rospy.signal_shutdown("becomes Gazebo's server")
            os.execvp(self._server[0], [*self._server, str(path)])

    def _write(self, scene: Scene) -> Path:
        world = world_of(self._bodies, scene, self._drives, self._folder, self._priority)
        for name, contents in world.meshes.items():
            write_atomically(self._folder / name, contents)
        path = self._folder / "twin.world"
        write_atomically(path, world.sdf)
        for remark in world.remarks:
            rospy.loginfo("%s", remark)
        return path

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        if self._fault:
            return Diagnosis(ERROR, self._fault)
        return Diagnosis(WARN, "Gazebo is started when the scene is known")


def find_gzserver(words: str) -> list[str]:
    """Return the words that start Gazebo's server; ConfigurationError when there is no such program."""
    try:
        found = shlex.split(words)
    except ValueError:
        found = []
    if not found or shutil.which(found[0]) is None:
        raise ConfigurationError(
            "gzserver",
            words,
            "a program that starts Gazebo 11's server: install Gazebo 11, or make it a home: "
            "scripts/gazebo_chroot.sh make (docs/physics.md)",
        )
    return found


def check(settings: Settings, robot: RobotModel, _shared: Shared) -> None:
    """Check program, files and robot before anything starts; see `NodeShell`."""
    find_gzserver(settings.gzserver)
    if settings.drives:
        read_drives(settings.drives, robot)
    check_serial(RobotBodies(robot))


INTERFACE = Interface(
    diagnose=GazeboNode.diagnose, subscribes=(Subscription("scene", SceneMsg, GazeboNode.on_scene, queue_size=1),)
)
NODE = NodeShell("gazebo", Settings, GazeboNode, INTERFACE, check)
main = NODE.run

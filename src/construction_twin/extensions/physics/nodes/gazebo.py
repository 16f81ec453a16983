"""gazebo: makes the world of the arm in the present scene, has Gazebo's server simulate it, and starts it again when that ends.

It commands nothing: the plugin in the server (gazebo/) hears `twin/commanded` and answers `virtual_robot` as the node `gazebo_arm`.
"""

from __future__ import annotations

import ctypes
import shlex
import shutil
import signal
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.files import write_whole
from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.gazebo_world import GazeboWorld, check_serial, world_of
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node_shell import Interface, NodeShell, Ports, Shared, Subscription
from construction_twin.ros.shared.params import PrivateSettings, ros_home
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene

#: Between the end of a server and the next one [s].
PAUSE = 1.0
#: How long a server may take to end by itself [s]; roslaunch waits for 15 s.
ENDING = 5.0
#: How often the main thread looks whether this process is to end [s].
_AWAKE = 0.5
#: Linux: have this signal when the parent ends.
_PR_SET_PDEATHSIG = 1


class Settings(PrivateSettings):
    """Private parameters, given in launch/bringup.launch.

    Attributes:
        gzserver: Words that start Gazebo's server; the world's file is put behind them.
        realtime: SCHED_FIFO priority of the thread that simulates, where permitted; 0: none.
    """

    gzserver: str
    drives: str
    realtime: int = pydantic.Field(ge=0, le=99)


class GazeboNode:
    """A scene in, a server that simulates it.

    Args:
        make: Returns the world of a scene. Raises ConstructionTwinError.
        launch: Starts the server with a world's file.
        folder: For the world and its meshes.
    """

    def __init__(
        self,
        make: Callable[[Scene], GazeboWorld],
        launch: Callable[[Path], subprocess.Popen],
        folder: Path,
        diagnostics: NodeDiagnostics,
    ):
        self._make, self._launch, self._folder, self._diagnostics = make, launch, folder, diagnostics
        self._news = threading.Condition()
        self._present: Scene | None = None
        #: Hash of the scene of the server's start; empty: none runs.
        self._simulated = ""
        self._problem = ""
        self._ended = 0
        self._how = ""

    def on_scene(self, message: SceneMsg) -> None:
        """Take the present scene; the next start is in it."""
        try:
            scene = scene_from_msg(message)
        except ConstructionTwinError as error:
            self._diagnostics.refuse("scene", str(error))
            return
        with self._news:
            self._present = scene
            self._news.notify_all()

    def run(self) -> None:
        """Have a server run until shutdown, in the main thread: the server ends with it, whatever ends it."""
        while not rospy.is_shutdown():
            self.work(_AWAKE)

    def work(self, patience: float) -> None:
        """Have one server run to its end; return after `patience` [s] while no scene is known."""
        with self._news:
            self._news.wait_for(lambda: self._present is not None, patience)
            scene = self._present
        if scene is None:
            return
        try:
            path = self._write(scene)
        except (ConstructionTwinError, OSError) as error:
            self._problem = str(error)
            self._diagnostics.refuse("world", str(error))
            with self._news:
                # the same scene would fail the same way
                self._news.wait_for(lambda: self._present is not scene or rospy.is_shutdown(), patience)
            return
        self._problem = ""
        program = self._launch(path)
        self._simulated = scene.hash
        rospy.loginfo("Gazebo simulates scene %s: %s", scene.hash[:12], path)
        code = self._attend(program)
        self._simulated = ""
        if rospy.is_shutdown():
            return
        self._ended, self._how = self._ended + 1, _how(code)
        rospy.logerr("%s", self._ending)
        with self._news:
            self._news.wait_for(rospy.is_shutdown, PAUSE)

    def _attend(self, program: subprocess.Popen) -> int:
        """Wait for a server's end, which a shutdown asks for; return its code."""
        while True:
            try:
                return program.wait(_AWAKE)
            except subprocess.TimeoutExpired:
                if rospy.is_shutdown():
                    break
        program.send_signal(signal.SIGINT)
        try:
            return program.wait(ENDING)
        except subprocess.TimeoutExpired:
            program.kill()
            return program.wait()

    def _write(self, scene: Scene) -> Path:
        world = self._make(scene)
        for name, contents in world.meshes.items():
            write_whole(self._folder / name, contents)
        path = self._folder / "twin.world"
        write_whole(path, world.sdf)
        for remark in world.remarks:
            rospy.loginfo("%s", remark)
        return path

    @property
    def _ending(self) -> str:
        return f"Gazebo's server has ended ({self._how}), and is started again; {self._ended} times so far"

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        present, simulated = self._present, self._simulated
        values: dict[str, object] = {"simulated scene": simulated, "ended": self._ended}
        if self._problem:
            return Report(ERROR, self._problem, values)
        if not simulated:
            if self._ended:
                return Report(ERROR, self._ending, values)
            return Report(WARN, "Gazebo is started when the scene is known", values)
        if present is not None and present.hash != simulated:
            other = f"Gazebo simulates the scene of its start, {simulated[:12]}, and not the present one, {present.hash[:12]}"
            return Report(WARN, other, values)
        return Report(OK, "simulating", values)


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


def _launch(words: list[str], path: Path) -> subprocess.Popen:
    libc = ctypes.CDLL(None, use_errno=True)

    def prepare() -> None:
        # not by a pipe, as our own processes: Gazebo reads none
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)

    # a group of its own: Ctrl-C on a terminal is this node's matter
    return subprocess.Popen([*words, str(path)], stdin=subprocess.DEVNULL, process_group=0, preexec_fn=prepare)


def _how(code: int) -> str:
    return f"code {code}" if code >= 0 else signal.Signals(-code).name


def check(settings: Settings, robot: RobotModel, _shared: Shared) -> None:
    """Check program, files and robot before anything starts; see `NodeShell`."""
    find_gzserver(settings.gzserver)
    if settings.drives:
        read_drives(settings.drives, robot)
    check_serial(RobotBodies(robot))


def start(settings: Settings, robot: RobotModel, ports: Ports) -> GazeboNode:
    """Return the node with its parameters and topics."""
    bodies = RobotBodies(robot)
    drives = read_drives(settings.drives, robot)
    folder = (ros_home() / "construction_twin" / f"{robot.name}_gazebo").absolute()
    words = find_gzserver(settings.gzserver)
    return GazeboNode(
        lambda scene: world_of(bodies, scene, drives, folder, settings.realtime),
        lambda path: _launch(words, path),
        folder,
        ports.diagnostics,
    )


INTERFACE = Interface(
    report=GazeboNode.report, hears=(Subscription("scene", SceneMsg, GazeboNode.on_scene, queue_size=1),)
)
NODE = NodeShell("gazebo", Settings, start, INTERFACE, check)
main = NODE.run

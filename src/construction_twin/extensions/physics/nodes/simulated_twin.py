"""The twin with mass as the backend of `virtual_robot`: what it carries and what stands around it comes from `scene`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np
import rospy

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.worker import Worker
from construction_twin.extensions.physics.arm import Servo, SimulatedArm, is_broken
from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.known_mass import element_masses, tool_mass
from construction_twin.extensions.physics.mass import check_serial, payload_of
from construction_twin.extensions.physics.model import PhysicsModel
from construction_twin.extensions.physics.process import PROGRAM
from construction_twin.msg import Scene, WorkTasks
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.scene.collision_bodies import RobotBodies


class LiveTwin:
    """An arm with mass that follows the commands, one cycle per command; before the first model it is at the commanded pose.

    Models are built elsewhere; `set_model` may be called from any thread. The same cycles in the same models give the same bytes.

    Attributes:
        effort: Of the axes in the last step [N m], [N]; empty before the first model.
        contacts: Pairs of links and objects that touched at the end of the last cycle, and that the planner would have refused.
        diverged: How often the state became useless and was begun anew.
    """

    def __init__(self, servo: Servo = Servo(holds=True)):
        self._servo = servo
        self._arm: SimulatedArm | None = None
        self._model: PhysicsModel | None = None
        #: The newest model, until a cycle takes it.
        self._next: deque[PhysicsModel] = deque(maxlen=1)
        self.effort: tuple[float, ...] = ()
        self.contacts: tuple[tuple[str, str], ...] = ()
        self.diverged = 0

    @property
    def fault(self) -> str:
        """Why the shown pose is not simulated, or was restarted; empty: it is simulated."""
        if self._model is None and not self._next:
            return "nothing is simulated before the scene is known: the twin is at the commanded pose"
        anew = "the simulation was begun anew at the commanded pose, because its numbers had become useless"
        return f"{anew}: {self.diverged} times so far" if self.diverged else ""

    def set_model(self, model: PhysicsModel) -> None:
        """Continue in another model from the next cycle on, with the pose, speed and servo state of that moment."""
        self._next.append(model)

    def restart(self) -> None:
        """Forget where the arm is: the next cycle begins at rest, at the pose that is commanded then."""
        self._arm, self.effort, self.contacts = None, (), ()

    def cycle(self, commanded: tuple[float, ...]) -> tuple[float, ...]:
        """Advance one cycle towards the commanded pose; return the simulated one at its end, both of shape (n,)."""
        self._enter_model(commanded)
        arm = self._arm
        if arm is None:
            return commanded
        arm.cycle(np.array(commanded))
        if is_broken(arm.data):
            self.diverged += 1
            self.restart()
            return commanded
        self.effort = tuple(arm.torque.tolist())
        self.contacts = _touching(arm) if arm.data.ncon else ()
        return tuple(arm.q.tolist())

    def _enter_model(self, commanded: tuple[float, ...]) -> None:
        """Switch to the newest model, at the commanded pose or in the state of the arm before."""
        if self._next:
            before, model = self._arm, self._next.pop()
            self._model = model
            self._arm = SimulatedArm(model, commanded if before is None else before.q, self._servo)
            if before is not None:
                self._arm.continue_from(before)
                mujoco.mj_forward(model.model, self._arm.data)
        elif self._arm is None and self._model is not None:
            self._arm = SimulatedArm(self._model, commanded, self._servo)


def _touching(arm: SimulatedArm) -> tuple[tuple[str, str], ...]:
    physics, contact = arm.physics, arm.data.contact
    # from the margin on MuJoCo lists what comes near
    near = contact.geom[contact.dist <= 0.0]
    wrong = near[physics.unplanned[near[:, 0], near[:, 1]]]
    pairs = {(physics.owners[first], physics.owners[second]) for first, second in wrong.tolist()}
    return tuple(sorted(pairs))


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
    """Check payload, drives and robot; see `NodeShell`."""
    check_serial(RobotBodies(robot))
    payload_of(settings.payload, "payload")
    read_drives(settings.drives, robot)

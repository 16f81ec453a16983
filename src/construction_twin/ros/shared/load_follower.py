"""Has the torque watch expect what the arm carries in the present scene, while models are made elsewhere."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import rospy

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.monitor.load_belief import LoadBelief
from construction_twin.monitor.torque_watch import InverseDynamics, TorqueWatch
from construction_twin.msg import Scene as SceneMsg
from construction_twin.msg import WorkTasks
from construction_twin.physics.known_mass import body_of, carried_part
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.diagnostics import NodeDiagnostics
from construction_twin.ros.shared.element_masses import element_masses
from construction_twin.scene.objects import Scene


@dataclass(frozen=True)
class Loads:
    """How the monitor learns what torques an arm needs for what it carries.

    Attributes:
        build: Returns the torques of the arm that carries what it does in a scene, with masses of bodies (`physics.known_mass`)
            [kg], and what of it is an estimate, one sentence each. May take its time. Raises ConstructionTwinError.
        masses: What the tool weighs [kg].
    """

    build: Callable[[Scene, Mapping[str, float]], tuple[InverseDynamics, tuple[str, ...]]]
    masses: Mapping[str, float]


class LoadFollower:
    """Scenes and masses in; the watch expects the torques of what the arm carries, and counts none while that is not known.

    Args:
        lock: The node's, under which it touches the gate.

    Attributes:
        problem: Why there is no model of the newest load; empty: there is, or it is being made.
    """

    def __init__(self, loads: Loads, watch: TorqueWatch, lock: threading.Lock, diagnostics: NodeDiagnostics):
        self._loads, self._watch, self._lock, self._diagnostics = loads, watch, lock, diagnostics
        self._belief = LoadBelief()
        self._scene: Scene | None = None
        self._masses: dict[str, float] = {}
        self.problem: str = Sentence("reason.gate.load_awaited")
        #: One model at a time, of the newest scene and masses: two threads bring them.
        self._loading = threading.Lock()
        self._note()

    def on_scene(self, message: SceneMsg) -> None:
        """Take what the arm carries; waits for the model."""
        with self._loading:
            try:
                self._scene = scene_from_msg(message)
            except ConstructionTwinError as error:
                self._diagnostics.refuse("scene", str(error))
                return
            self._follow()

    def on_tasks(self, message: WorkTasks) -> None:
        """Take what elements weigh; waits for the model."""
        with self._loading:
            self._masses = element_masses(message)
            self._follow()

    def on_execution(self, active: bool, at_boundary: bool, expected_scene: str) -> None:
        """Take where a plan stands, see `LoadBelief.on_execution`; under the lock."""
        self._belief.on_execution(active, at_boundary, expected_scene)
        self._note()

    def _follow(self) -> None:
        """Have the model carry what the arm does in the newest scene; meanwhile torques do not count."""
        scene = self._scene
        if scene is None:
            return
        carried = carried_part(scene)
        bodies = {body_of(item.name) for item in carried.objects}
        masses = {body: mass for body, mass in {**self._masses, **self._loads.masses}.items() if body in bodies}
        load = carried.objects, masses
        with self._lock:
            self._belief.on_scene(scene.hash, load)
            self._note()
            if self._belief.is_modelled:
                self.problem = ""
                return
        try:
            dynamics, remarks = self._loads.build(carried, masses)
        except ConstructionTwinError as error:
            self.problem = Sentence("reason.gate.load_unknown", problem=str(error))
            self._diagnostics.refuse("load", str(error))
            return
        with self._lock:
            self._watch.believe(dynamics)
            self._belief.on_model(load)
            self._note()
        self.problem = ""
        rospy.loginfo("expects torques of the arm with its payload and: %s", ", ".join(sorted(bodies)) or "nothing")
        for remark in remarks:
            rospy.loginfo("%s", remark)

    def _note(self) -> None:
        """Let torques count while what the arm carries is known; under the lock."""
        self._watch.count(self._belief.counts)

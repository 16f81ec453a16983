"""ROS shell of the scene: edits in, the scene and its markers out; watches the twin's present pose. Moves nothing."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
import rosgraph
import rospy
from visualization_msgs.msg import MarkerArray

from construction_twin import msg, srv
from construction_twin.core.errors import ConfigurationError, PayloadError, PoseUnknownError
from construction_twin.core.extensions import ExtensionAbsent, import_extension
from construction_twin.core.files import read_file, write_atomically
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import SceneError
from construction_twin.ros.messages.convert import pose_from_msg
from construction_twin.ros.messages.scene_convert import object_from_msg, scene_markers, scene_to_msg
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.frames import FRAMES, listen_to_frames
from construction_twin.ros.shared.params import ros_home
from construction_twin.ros.transport.publisher import AnyPublisher
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject, product, relative
from construction_twin.scene.scene_change import SceneChange
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.validation import StrictModel, wrong_value

#: Oldest pose of the twin that counts as its present one; longest wait for it and for a transform [s].
_PATIENCE = 1.0
#: How often the present pose is checked [s].
CHECK_PERIOD = 0.2
#: For MoveIt, if its message types are installed. The queue is long: a dropped message may be the one that took something away.
PLANNING_SCENE = shell.Publication("planning_scene", "moveit_msgs/PlanningScene", queue_size=50, latch=True)
#: roslaunch's id of this run.
_RUN = "/run_id"


#: Largest file [bytes]: tens of thousands of objects.
_LARGEST = 32 * 2**20


class _File(StrictModel):
    """The scene after the last edit of one run that began with one scene."""

    run: Annotated[str, pydantic.Field(min_length=1)]
    start: str
    hash: str
    padding: float
    objects: tuple[dict[str, Any], ...]


_OBJECTS = pydantic.TypeAdapter(tuple[SceneObject, ...])


@dataclass(frozen=True)
class SceneFile:
    """The file of one run's edits of the scene that it began with; that of another run is ignored."""

    path: Path
    run: str
    start: Scene

    def load(self) -> Scene:
        """Return the scene after the last edit of this run; the start if there was none."""
        try:
            contents = read_file(self.path, _LARGEST)
        except FileNotFoundError:
            return self.start
        except OSError as error:
            raise self._wrong(str(error.strerror), "a file that can be read") from error
        try:
            found = _File.model_validate_json(contents)
        except pydantic.ValidationError as error:
            wrong = wrong_value(error, _File.model_json_schema())
            expected = f"a scene as the scene node writes it: {wrong.expected}"
            raise self._wrong(f"{wrong.key}: {wrong.value!r:.200}", expected) from error
        if found.run != self.run:
            return self.start
        if found.start != self.start.hash:
            expected = f"edits of {self.start.hash[:12]}, the one given now"
            raise self._wrong(f"edits of a scene that began as {found.start[:12]}", expected)
        try:
            scene = Scene(_OBJECTS.validate_python(found.objects), found.padding)
        except (SceneError, pydantic.ValidationError) as error:
            raise self._wrong(str(error), "objects that can be used") from error
        if scene.hash != found.hash:
            raise self._wrong(f"contents with the hash {scene.hash[:12]}", f"{found.hash[:12]}, which it names")
        return scene

    def save(self, scene: Scene) -> None:
        """Write the scene, as a whole or not at all."""
        contents = {"run": self.run, "start": self.start.hash, "hash": scene.hash, "padding": scene.padding}
        contents["objects"] = _OBJECTS.dump_python(scene.objects, mode="json")
        try:
            write_atomically(self.path, json.dumps(contents, indent=1) + "\n")
        except OSError as error:
            expected = "a file that can be written: an edit that would not survive a restart is refused"
            raise SceneError(str(self.path), error.strerror, expected) from error

    def _wrong(self, found: str, expected: str) -> SceneError:
        to_do = f"{expected}; look at the scene, move the file away and start again: the scene then begins as given"
        return SceneError(f"the scene's edits in {self.path}", found, to_do)


#: A base that overlaps an object by less than this stands on it [m].
STANDS_ON = 1e-3
#: Random poses, besides home, in all of which a link must touch an object.
POSES = 100


@dataclass(frozen=True)
class LastingContact:
    """An object that stands in the world, and a link that touches it whatever the joints do.

    `distance` at home and `margin` of a moving link [m]; a base, which no joint `moves`, is not checked.
    """

    name: str
    link: str
    distance: float
    margin: float
    moves: bool

    @property
    def sentence(self) -> str:
        """What it is, what follows from it, and what to do."""
        if not self.moves:
            return (
                f"object {self.name!r} and link {self.link!r} overlap by {-self.distance * 1e3:.1f} mm; no "
                "joint moves the link, so this is not checked. If they do not overlap in the cell, correct "
                f"the object's position or size, or raise the arm; if they do, add `touch: [{self.link}]` to "
                "the object"
            )
        found = f"{'overlap' if self.distance < 0.0 else 'are apart'} by {abs(self.distance) * 1e3:.1f} mm"
        return (
            f"object {self.name!r} and link {self.link!r} {found}, expected {self.margin * 1e3:.1f} mm of clearance, in every pose "
            "of the arm: nothing can be planned. Move the object, raise the arm or lower `padding`; if they may touch, add "
            f"`touch: [{self.link}]` to the object"
        )


def lasting_contacts(world: CollisionWorld) -> list[LastingContact]:
    """Return the contacts of a world that no motion ends, those of the base first.

    A pair of which the object names the link in `touch` is meant, and not among them.
    """
    found = [
        LastingContact(item.name, link, distance, 0.0, False)
        for item, link in world.unchecked_pairs()
        if (distance := world.distance(world.robot.home, link, item.name)) < -STANDS_ON
    ]
    standing = {item.name: item for item in world.scene.objects if not item.link}
    names = set(world.scene.names)
    touching = (contact.between for contact in world.contacts(world.robot.home))
    pairs = [(first, second) for first, second in touching if first not in names and second in standing]
    poses = np.random.default_rng(0).uniform(world.robot.lower, world.robot.upper, (POSES, len(world.robot.home)))
    for q in poses:
        if not pairs:
            break
        still = {contact.between for contact in world.contacts(q)}
        pairs = [pair for pair in pairs if pair in still]
    for link, name in pairs:
        margin = world.scene.padding + standing[name].padding
        found.append(LastingContact(name, link, world.distance(world.robot.home, link, name), margin, True))
    return found


class Settings(StrictModel):
    """Private parameters, given in launch/bringup.launch; `scene` ``none`` or empty: no objects, no padding."""

    scene: str
    self_collision: str
    tf_prefix: str


class SceneNode:
    """ROS around a CollisionWorld: edits in, the scene and its markers out."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: shell.NodeIO):
        self._robot = robot
        self._prefix = settings.tf_prefix.rstrip("/")
        start = read_scene(settings.scene)
        self._file = _scene_file(start, node_io.parameters[_RUN])
        scene = self._file.load()
        if scene.hash != start.hash:
            rospy.logwarn("scene %s: goes on after the edits of this run, from %s", scene.hash[:12], self._file.path)
        self._world = CollisionWorld(self._robot, scene, read_self_collision(settings.self_collision, self._robot))
        # one edit or check at a time: the world works in buffers of its own
        self._busy = threading.Lock()
        self._touching: dict[tuple[str, str], None] = {}
        self._lasting: list[str] = []
        self._shown: set[str] = set()
        self._state = Diagnosis(WARN, "the twin's present pose is not known yet")
        self._edits = 0
        self._diagnostics = node_io.diagnostics
        self._frames = listen_to_frames(self._robot, self._prefix, _PATIENCE, self._diagnostics.refuse)
        self._scene_publisher, self._marker_publisher = node_io.publishers["scene"], node_io.publishers["scene_markers"]
        self._planning_scene = self._for_moveit(node_io.publishers.get(PLANNING_SCENE.topic))
        self._twin = node_io.poses["twin/joint_states"]
        with self._busy:
            for sentence in self._new_lasting_contacts():
                rospy.logwarn("%s", sentence)
            self._publish_scene()

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        return self._state

    # -- edits: each returns the scene as it would be, and what was done

    def add(self, request: srv.AddObjectRequest) -> tuple[Scene, str]:
        """Add an object."""
        item = object_from_msg(request.object)
        if item.link:
            raise SceneError(f"object {item.name!r} link", item.link, "an empty one; attach it once it is in the scene")
        if self._frames.tf_name(request.frame_id) != self._frames.base:
            item = item.moved(product(self._frames.in_base(request.frame_id, rospy.Time(0)), item.pose))
        known = item.name in self._world.scene.names
        scene = self._world.scene.add(item, request.replace)
        return scene, f"{'replaced' if known else 'added'} {item.shape} {item.name!r}"

    def attach(self, request: srv.AttachObjectRequest) -> tuple[Scene, str]:
        """Let a link carry an object."""
        link = request.link or self._robot.tip_link
        if request.use_pose:
            pose = pose_from_msg(request.pose)
        else:
            q = self._twin.pose(_PATIENCE, _PATIENCE)
            pose = relative(self._world.link_pose(q, link), self._world.object_pose(q, request.name))
        return self._world.scene.attach(request.name, link, pose, request.touch), f"{link} carries {request.name!r}"

    def detach(self, request: srv.DetachObjectRequest) -> tuple[Scene, str]:
        """Put down what a link carries."""
        name = request.name
        item: SceneObject = self._world.scene.get(name)
        if not item.link:  # refused with its own sentence, whether or not the twin's pose is known
            return self._world.scene.detach(name, item.pose), ""
        pose = self._world.object_pose(self._twin.pose(_PATIENCE, _PATIENCE), name)
        return self._world.scene.detach(name, pose), f"put down {name!r}"

    def change(self, request: srv.EditSceneRequest) -> tuple[Scene, str]:
        """Change several objects at once, from the scene that is named."""
        scene = self._world.scene
        cleared = [item.name for item in scene.objects if request.clear and not item.fixed]
        remove = [*cleared, *(name for name in request.remove if name not in cleared)]
        wanted = SceneChange(tuple(map(object_from_msg, request.put)), tuple(remove))
        return wanted.apply_checked(scene, request.before, request.after), str(wanted)

    def present_hash(self, _request) -> dict[str, object]:
        """Return the field of every answer about the scene: the present one's hash."""
        return {"hash": self._world.scene.hash}

    def edit(self, change: Callable[[SceneNode, Any], tuple[Scene, str]], request: Any) -> Outcome:
        """Change the scene as a whole or not at all."""
        with self._busy:
            scene, sentence = change(self, request)
            world = self._world.with_scene(scene)
            # saved before it is published: a node that is started anew must not forget what others plan with
            self._file.save(scene)
            self._world = world
            self._edits += 1
            lasting = self._new_lasting_contacts()
            self._find_contacts()
            self._publish_scene()
            if self._touching:
                sentence += f"; in contact (padding included) at the present pose: {self._contact_text()}"
            sentence = "; ".join([sentence, *lasting])
            rospy.loginfo("scene %s: %s", scene.hash[:12], sentence)
            return Outcome(True, sentence, fields={"hash": scene.hash})

    def _new_lasting_contacts(self) -> list[str]:
        """Return sentences on new contacts that no motion of the arm ends."""
        before, self._lasting = self._lasting, [contact.sentence for contact in lasting_contacts(self._world)]
        return [sentence for sentence in self._lasting if sentence not in before]

    def check(self) -> None:
        """Check the present pose; show where a contact begins or ends."""
        with self._busy:
            before = self._touching
            self._find_contacts()
            if self._touching != before:
                self._publish_markers()

    def _find_contacts(self) -> None:
        values = {"scene": self._world.scene.hash, "objects": len(self._world.scene.objects), "edits": self._edits}
        values |= {f"lasting contact {number}": sentence for number, sentence in enumerate(self._lasting, 1)}
        self._touching = {}
        try:
            q = self._twin.pose(_PATIENCE)
        except (PoseUnknownError, PayloadError) as error:
            self._state = Diagnosis(WARN, str(error), values)
            return
        self._touching = {contact.between: None for contact in self._world.contacts(q)}
        clearance = self._world.clearance(q)
        values |= {"clearance": f"{clearance.distance:.4f}", "clearance between": " and ".join(clearance.between)}
        if self._touching:
            where = "in contact (padding included) at the present pose"
            self._state = Diagnosis(WARN, f"{where}: {self._contact_text()}", values)
        elif self._lasting:
            self._state = Diagnosis(WARN, self._lasting[0], values)
        else:
            self._state = Diagnosis(OK, "the present pose is free of contact", values)

    def _contact_text(self) -> str:
        return ", ".join(f"{first} and {second}" for first, second in self._touching)

    def _publish_scene(self) -> None:
        self._scene_publisher.publish(scene_to_msg(self._world.scene, rospy.Time.now(), self._frames.base))
        if self._planning_scene is not None:
            self._planning_scene.publish(self._world.scene, rospy.Time.now())
        self._publish_markers()

    def _for_moveit(self, publisher: AnyPublisher | None) -> Any:
        if publisher is None:
            rospy.loginfo("planning_scene is not published without moveit_msgs")
            return None
        try:
            moveit = import_extension("planners.nodes.planning_scene")
        except ExtensionAbsent as error:
            rospy.loginfo("planning_scene is not published: %s", error)
            return None
        return moveit.PlanningScenePublisher(moveit.moveit_types(), self._robot, self._world.self_collision, publisher)

    def _publish_markers(self) -> None:
        names = set(self._world.scene.names)
        touching = {name for pair in self._touching for name in pair}
        gone, self._shown = sorted(self._shown - names), names
        markers = scene_markers(self._world.scene, gone, touching, self._robot.base_link, self._prefix)
        self._marker_publisher.publish(markers)


def _scene_file(start: Scene, run: str) -> SceneFile:
    """Return the file of this run's edits: one per node and ROS master, so that two masters of one user do not meet in it."""
    if not run:
        raise ConfigurationError(_RUN, run, "the id of this run, as roscore and roslaunch set it")
    name = re.sub(r"\W+", "_", f"{rosgraph.get_master_uri()} {rospy.get_name()}")
    return SceneFile(ros_home() / f"{name}_edits.json", run, start)


def _edit(change: Callable[[SceneNode, Any], tuple[Scene, str]]) -> Callable[[SceneNode, Any], Outcome]:
    return lambda node, request: node.edit(change, request)


INTERFACE = shell.Interface(
    diagnose=SceneNode.diagnose,
    parameters=(shell.SharedParameter(_RUN, ""),),
    publishes=(
        shell.Publication("scene", msg.Scene, queue_size=1, latch=True),
        shell.Publication("scene_markers", MarkerArray, queue_size=1, latch=True),
        PLANNING_SCENE,
    ),
    polls=(shell.PolledPose("twin/joint_states"),),
    listeners=FRAMES,
    serves=(
        shell.Served("add_object", srv.AddObject, _edit(SceneNode.add), refused=SceneNode.present_hash),
        shell.Served("attach_object", srv.AttachObject, _edit(SceneNode.attach), refused=SceneNode.present_hash),
        shell.Served("detach_object", srv.DetachObject, _edit(SceneNode.detach), refused=SceneNode.present_hash),
        shell.Served("edit_scene", srv.EditScene, _edit(SceneNode.change), refused=SceneNode.present_hash),
    ),
    timers=(shell.NodeTimer(lambda _settings: CHECK_PERIOD, SceneNode.check),),
)


def check(settings: Settings, robot: RobotModel, *_: object) -> None:
    """Check the files: objects by names of links and objects that exist, with meshes that can be used; see `NodeShell`."""
    read_self_collision(settings.self_collision, robot)
    RobotBodies(robot).place_all(read_scene(settings.scene))


NODE = shell.NodeShell("scene", Settings, SceneNode, INTERFACE, check)
main = NODE.run

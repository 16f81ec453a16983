"""gazebo: makes the world of the arm in the present scene, and becomes Gazebo's server, which roslaunch starts again when it ends.

It commands nothing: the plugin in the server (gazebo/) hears `twin/commanded` and answers `virtual_robot` as the node `gazebo_arm`.
The world is SDF 1.7, from the planner's records, in the root of the URDF's tree; SI. The plugin calculates with the chain that
stands in its element, a text that `gazebo/arm_control.hpp` reads.
"""

from __future__ import annotations

import itertools
import math
import os
import shlex
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Queue
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio
import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.files import write_atomically
from construction_twin.extensions.physics.drive import ArmDrives, read_drives
from construction_twin.extensions.physics.mass import (
    FRICTION,
    GRAVITY,
    STEP,
    MassProperties,
    check_serial,
    combined,
    of_link,
    of_object,
)
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.description import RobotModel
from construction_twin.robot.packages import Packages
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.diagnostics import ERROR, WARN, Diagnosis
from construction_twin.ros.shared.node_shell import Interface, NodeIO, NodeShell, Shared, Subscription
from construction_twin.ros.shared.params import ros_home
from construction_twin.scene.collision_bodies import Body, RobotBodies, mesh_triangles
from construction_twin.scene.objects import Scene
from construction_twin.validation import StrictModel

#: How often the main thread looks whether this process is to end [s].
_AWAKE = 0.5
#: The library that the world names.
PLUGIN = "libconstruction_twin_gazebo.so"
#: Red, green, blue of what has no looks of its own.
_GREY = (0.6, 0.6, 0.62)

Element = ElementTree.Element


@dataclass(frozen=True)
class GazeboWorld:
    """A world, the STL files in its folder by name, and what is an estimate, one sentence each."""

    sdf: str
    meshes: Mapping[str, bytes]
    remarks: tuple[str, ...]


def world_of(bodies: RobotBodies, scene: Scene, drives: ArmDrives, folder: Path, priority: int = 0) -> GazeboWorld:
    """Return the world of an arm in a scene; `folder` is absolute, `priority` of SCHED_FIFO, 0: none."""
    return _Builder(bodies, scene, drives, folder).build(priority)


class _Builder:
    """The steps of one world, in the order of `build`."""

    def __init__(self, bodies: RobotBodies, scene: Scene, drives: ArmDrives, folder: Path):
        check_serial(bodies)
        self._bodies, self._scene, self._drives, self._folder = bodies, scene, drives, folder
        self._own = (*bodies.bodies, *bodies.place_all(scene))
        self._meshes: dict[str, bytes] = {}
        self._remarks: list[str] = []
        self._visuals = _visuals(bodies)

    def build(self, priority: int) -> GazeboWorld:
        root = ElementTree.Element("sdf", version="1.7")
        world = _add(root, "world", name="construction_twin")
        physics = _add(world, "physics", name="cycles", type="ode", default="true")
        _add(physics, "max_step_size", STEP)
        # as fast as it is commanded: the plugin waits for commands
        _add(physics, "real_time_factor", 1)
        _add(physics, "real_time_update_rate", 0)
        # all equations of a chain of heavy links at once: the iterating solver lets them drift apart
        _add(_add(_add(physics, "ode"), "solver"), "type", "world")
        _add(world, "gravity", 0, 0, -GRAVITY)
        light = _add(world, "light", name="sun", type="directional")
        _add(light, "diffuse", 0.8, 0.8, 0.8, 1)
        _add(light, "direction", -0.4, 0.3, -0.9)
        # links that no joint moves are seen only: nothing but the arm could touch them, and its links do not
        base = [one for one in self._own if not one.joint and one.item is None]
        self._add_shapes(_static(world, f"{_name(self._bodies.robot.name)}_base"), base, self._visuals.get(0), False)
        for number, one in enumerate(each for each in self._own if each.item is not None and not each.joint):
            self._add_shapes(_static(world, f"{_name(one.owner)}_{number}"), [one])
        self._add_arm(world, priority)
        ElementTree.indent(root)
        text = '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
        return GazeboWorld(text, self._meshes, tuple(dict.fromkeys(self._remarks)))

    def _add_arm(self, world: Element, priority: int) -> None:
        arm = _add(world, "model", name=_name(self._bodies.robot.name))
        model = self._bodies.model
        data = model.createData()
        pinocchio.forwardKinematics(model, data, pinocchio.neutral(model))
        drive = self._drives
        each = zip(drive.torque, drive.armature, drive.damping, drive.friction)
        drives = dict(zip(self._bodies.robot.joint_names, each))
        self._remarks += drive.remarks
        lines = [_numbers((0.0, 0.0, -GRAVITY))]
        before = "world"
        for index in range(1, model.njoints):
            name = model.names[index]
            link = _add(arm, "link", name=f"moved_by_{name}")
            _add(link, "pose", *_pose(data.oMi[index]))
            properties = self._mass_of(index)
            inertial = _add(link, "inertial")
            _add(inertial, "mass", properties.mass)
            _add(inertial, "pose", *properties.centre, 0, 0, 0)
            inertia = _add(inertial, "inertia")
            for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
                _add(inertia, f"i{'xyz'[row]}{'xyz'[column]}", properties.inertia[row, column])
            own = [one for one in self._own if one.joint == index]
            self._add_shapes(link, [one for one in own if one.item is None], self._visuals.get(index))
            self._add_shapes(link, [one for one in own if one.item is not None])
            axis = np.array(data.joints[index].S, dtype=float).ravel()
            slides = bool(np.any(axis[:3]))
            axis = axis[:3] if slides else axis[3:]
            joint = _add(arm, "joint", name=name, type="prismatic" if slides else "revolute")
            _add(joint, "parent", before)
            _add(joint, "child", link.get("name"))
            # without limits: Gazebo's stops break where an axis turns more than once, and commands are inside theirs
            about = _add(joint, "axis")
            _add(about, "xyz", *axis)
            limit = _add(about, "limit")
            _add(limit, "lower", -1e16)
            _add(limit, "upper", 1e16)
            before = link.get("name", "")
            torque, *rest = drives[name]
            placement, moment = model.jointPlacements[index], properties.inertia
            products = moment[0, 1], moment[0, 2], moment[1, 2]
            given = (math.inf if torque is None else torque, *rest)
            numbers = (*placement.translation, *placement.rotation.ravel(), *axis, properties.mass, *properties.centre)
            lines.append(f"{name} {int(slides)} {_numbers((*numbers, *np.diag(moment), *products, *given))}")
        plugin = _add(arm, "plugin", name="twin", filename=PLUGIN)
        _add(plugin, "chain", "\n" + "\n".join(lines) + "\n")
        _add(plugin, "realtime", priority)

    def _mass_of(self, index: int) -> MassProperties:
        """Return what a joint moves by itself: its link, and what is carried there."""
        link, remarks = of_link(self._bodies, index)
        self._remarks += remarks
        parts = [link]
        objects = (one for one in self._own if one.joint == index and one.item is not None)
        for owner, placed in itertools.groupby(objects, key=lambda one: one.owner):
            pieces = list(placed)
            part = of_object(pieces)
            parts.append(part.at(pieces[0].placement))
            self._remarks.append(f"mass of {owner} is an estimate from its volume: {part.mass:.1f} kg")
        return combined(parts)

    def _add_shapes(
        self, link: Element, own: Iterable[Body], looks: Iterable[Element] | None = (), touchable: bool = True
    ) -> None:
        """Add collisions and visuals: the same where a link has no visuals of its own."""
        for number, one in enumerate(own):
            geometry = self._geometry(one, f"{_name(one.owner)}_{number}")
            if touchable and not self._may_touch(one):
                collision = _add(link, "collision", name=f"{_name(one.owner)}_{number}")
                _add(collision, "pose", *_pose(one.placement))
                collision.append(geometry)
                ode = _add(_add(_add(collision, "surface"), "friction"), "ode")
                _add(ode, "mu", FRICTION)
                _add(ode, "mu2", FRICTION)
            if not looks:
                visual = _add(link, "visual", name=f"seen_{_name(one.owner)}_{number}")
                _add(visual, "pose", *_pose(one.placement))
                visual.append(geometry)
                material = _add(visual, "material")
                _add(material, "ambient", *_GREY, 1)
                _add(material, "diffuse", *_GREY, 1)
        for element in looks or ():
            link.append(element)

    def _may_touch(self, one: Body) -> bool:
        """Return whether an object may touch something: Gazebo, which excepts bodies alone, then leaves out all its contacts."""
        return bool(one.item and one.item.touch) or any(
            one.owner in item.touch for item in self._scene.objects if item.name != one.owner
        )

    def _geometry(self, one: Body, name: str) -> Element:
        geometry, shape = ElementTree.Element("geometry"), one.geometry
        if isinstance(shape, coal.Box):
            _add(_add(geometry, "box"), "size", *(2.0 * np.array(shape.halfSide).ravel()))
        elif isinstance(shape, coal.Sphere):
            _add(_add(geometry, "sphere"), "radius", shape.radius)
        elif isinstance(shape, (coal.Cylinder, coal.Capsule)):
            cylinder = _add(geometry, "cylinder")
            _add(cylinder, "radius", shape.radius)
            # SDF 1.7 has no capsules: their ends are flat
            _add(cylinder, "length", 2.0 * shape.halfLength)
        else:
            file = f"{len(self._meshes)}_{name}.stl"
            self._meshes[file] = _stl(shape)
            _add(_add(geometry, "mesh"), "uri", f"file://{self._folder / file}")
        return geometry


def _visuals(bodies: RobotBodies) -> dict[int, list[Element]]:
    """Return the visuals of the URDF by the joint that moves them."""
    root, packages = ElementTree.fromstring(bodies.robot.urdf), Packages()
    frames = bodies.model.frames
    visuals: dict[int, list[Element]] = {}
    for link in root.iter("link"):
        name = link.get("name", "")
        for number, visual in enumerate(link.iterfind("visual")):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            frame = frames[bodies.model.getFrameId(name, pinocchio.FrameType.BODY)]
            origin = visual.find("origin")
            attributes = {} if origin is None else origin.attrib
            xyz, rpy = (np.array(attributes.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
            placement = frame.placement * pinocchio.SE3(pinocchio.rpy.rpyToMatrix(*rpy), xyz)
            element = ElementTree.Element("visual", name=f"looks_{_name(name)}_{number}")
            _add(element, "pose", *_pose(placement))
            file = packages.file(mesh.get("filename", ""), f"URDF link {name} visual mesh")
            drawn = _add(_add(element, "geometry"), "mesh")
            _add(drawn, "uri", f"file://{file}")
            _add(drawn, "scale", *mesh.get("scale", "1 1 1").split())
            visuals.setdefault(frame.parentJoint, []).append(element)
    return visuals


def _static(world: Element, name: str) -> Element:
    """Return the link of a new model that stays where it is."""
    model = _add(world, "model", name=name)
    _add(model, "static", "true")
    return _add(model, "link", name="link")


def _stl(shape: coal.CollisionGeometry) -> bytes:
    """Return a mesh, or the hull of a shape's corners, as a binary STL file."""
    import trimesh  # for these shapes alone

    if isinstance(shape, coal.BVHModelBase):
        mesh = trimesh.Trimesh(*mesh_triangles(shape), process=False)
    else:
        mesh = trimesh.convex.convex_hull(np.array(shape.points(), dtype=float))
    return trimesh.exchange.stl.export_stl(mesh)


def _add(parent: Element, tag: str, *content: object, **attributes: str) -> Element:
    made = ElementTree.SubElement(parent, tag, attributes)
    if content:
        made.text = " ".join(str(float(one)) if isinstance(one, (float, np.floating)) else str(one) for one in content)
    return made


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _pose(placement: pinocchio.SE3) -> tuple[float, ...]:
    return (*placement.translation, *pinocchio.rpy.matrixToRpy(placement.rotation))


def _name(name: str) -> str:
    """Return a name that SDF takes: it reserves `__` around names and `::` inside."""
    return "".join(one if one.isalnum() else "_" for one in name).strip("_") or "unnamed"


class Settings(StrictModel):
    """Private parameters, given in launch/bringup.launch.

    Attributes:
        gzserver: Words that start Gazebo's server; the world's file is put behind them.
    """

    gzserver: str
    drives: str
    realtime: int = pydantic.Field(ge=0, le=99)


class GazeboNode:
    """ROS around a Gazebo server: waits for a scene, then becomes that server."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: NodeIO):
        self._bodies, self._drives = RobotBodies(robot), read_drives(settings.drives, robot)
        self._priority, self._server = settings.realtime, find_gzserver(settings.gzserver)
        #: For the world and its meshes.
        self._folder = (ros_home() / "construction_twin" / f"{robot.name}_gazebo").absolute()
        self._refuse = node_io.diagnostics.refuse
        self._scenes: Queue[Scene] = Queue()
        self._fault = ""

    def on_scene(self, message: SceneMsg) -> None:
        """Queue a scene."""
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

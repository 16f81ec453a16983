"""The world of the twin in Gazebo 11 (SDF 1.7): the arm, what it carries and what stands around it, from the planner's records.

The world is the root of the URDF's tree; SI. The plugin (gazebo/) moves the arm; it calculates with the chain that stands in its
element, a text that `gazebo/arm_control.hpp` reads.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.physics.drive import ArmDrives
from construction_twin.extensions.physics.mass import (
    FRICTION,
    GRAVITY,
    STEP,
    MassProperties,
    combined,
    of_link,
    of_object,
)
from construction_twin.robot.packages import Packages
from construction_twin.scene.collision_bodies import Body, RobotBodies, mesh_triangles
from construction_twin.scene.objects import Scene

#: The library that the world names.
PLUGIN = "libconstruction_twin_gazebo.so"
#: Red, green, blue of what has no colour of its own: links, what they carry, what stands around.
_LINK, _CARRIED, _AROUND = (0.6, 0.6, 0.62), (0.2, 0.45, 0.8), (0.75, 0.74, 0.7)

Element = ElementTree.Element


@dataclass(frozen=True)
class GazeboWorld:
    """A world, and what it needs beside it.

    Attributes:
        meshes: Files that it names, to be written into its folder: name and contents (STL).
        remarks: What is an estimate, one sentence each.
    """

    sdf: str
    meshes: Mapping[str, bytes]
    remarks: tuple[str, ...]


def world_of(bodies: RobotBodies, scene: Scene, drives: ArmDrives, folder: Path, priority: int = 0) -> GazeboWorld:
    """Return the world of an arm in a scene, its meshes in an absolute folder; `priority`: SCHED_FIFO, 0: none."""
    return _Builder(bodies, scene, drives, folder).build(priority)


def check_serial(bodies: RobotBodies) -> None:
    """Raise a ConfigurationError for an arm with a joint that follows another: the plugin knows one serial chain."""
    names = [name for index, name in enumerate(bodies.model.names) if index and name not in bodies.robot.joint_names]
    if names:
        expected = (
            "an arm of which no joint follows another: Gazebo moves one serial chain; twin:=mujoco moves this one"
        )
        raise ConfigurationError("URDF", ", ".join(names), expected)


class _Builder:
    """Builds one world, in the order of `build`."""

    def __init__(self, bodies: RobotBodies, scene: Scene, drives: ArmDrives, folder: Path):
        check_serial(bodies)
        self._bodies, self._scene, self._drives, self._folder = bodies, scene, drives, folder
        self._own = (*bodies.bodies, *bodies.place_all(scene))
        self._meshes: dict[str, bytes] = {}
        self._remarks: list[str] = []
        self._looks = _looks(bodies)

    def build(self, priority: int) -> GazeboWorld:
        """Return the world; `priority`: of the thread that simulates."""
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
        self._add_scenery(world)
        self._add_base(world)
        for number, one in enumerate(each for each in self._own if each.item is not None and not each.joint):
            model = _add(world, "model", name=f"{_name(one.owner)}_{number}")
            _add(model, "static", "true")
            self._add_shapes(_add(model, "link", name="link"), [one], _AROUND)
        self._add_arm(world, priority)
        ElementTree.indent(root)
        text = '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
        return GazeboWorld(text, self._meshes, tuple(dict.fromkeys(self._remarks)))

    def _add_scenery(self, world: Element) -> None:
        light = _add(world, "light", name="sun", type="directional")
        _add(light, "pose", 0, 0, 10, 0, 0, 0)
        _add(light, "diffuse", 0.8, 0.8, 0.8, 1)
        _add(light, "direction", -0.4, 0.3, -0.9)
        _add(light, "cast_shadows", "false")
        drawn = _add(world, "scene")
        _add(drawn, "ambient", 0.5, 0.5, 0.5, 1)
        _add(drawn, "background", 0.8, 0.87, 0.94, 1)
        _add(drawn, "shadows", "false")
        camera = _add(_add(world, "gui"), "camera", name="user")
        _add(camera, "pose", 3.4, -3.2, 2.0, 0, 0.17, 2.3)

    def _add_base(self, world: Element) -> None:
        """Add the links that no joint moves. They are seen only: nothing but the arm could touch them, and its links do not."""
        model = _add(world, "model", name=f"{_name(self._bodies.robot.name)}_base")
        _add(model, "static", "true")
        own = [one for one in self._own if not one.joint and one.item is None]
        self._add_shapes(_add(model, "link", name="base"), own, _LINK, self._looks.get(0), touchable=False)

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
            self._add_shapes(link, [one for one in own if one.item is None], _LINK, self._looks.get(index))
            self._add_shapes(link, [one for one in own if one.item is not None], _CARRIED)
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
        self,
        link: Element,
        own: Iterable[Body],
        colour: tuple[float, ...],
        looks: list[Element] | None = None,
        touchable: bool = True,
    ) -> None:
        """Add what can be touched, and what is seen: the same, where a link has no looks of its own."""
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
                _add(material, "ambient", *colour, 1)
                _add(material, "diffuse", *colour, 1)
        for element in looks or ():
            link.append(element)

    def _may_touch(self, one: Body) -> bool:
        """Return whether an object may touch something: Gazebo knows no exceptions pair by pair, so it then touches nothing."""
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


def _looks(bodies: RobotBodies) -> dict[int, list[Element]]:
    """Return the visuals of the URDF by the joint that moves them; a mesh that is not found is an error, as in a collision."""
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

"""The surroundings of the arm: obstacles, tools, workpieces. A scene is immutable: every change makes a new one with a new hash.

Metres; poses in the robot's base_link, or in the link that carries the object.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from construction_twin.core.files import read_file
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import quaternion_to_rotation, rotation_to_quaternion, rpy_to_quaternion
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.tool import ToolFile

#: A quaternion whose norm differs from 1 by more than the first value is refused, by more than the second it is normalised. A
#: normalised one is not changed again, so that a scene sent as a message keeps its hash.
_QUATERNION_REFUSED, _QUATERNION_EXACT = 1e-3, 1e-12
#: Before the name of a shape of the tool.
TOOL = "tool/"
#: Largest coordinate, size and padding [m]: the distances of Coal overflow with numbers far beyond the size of a hall.
_FARTHEST = 1e4
#: Numbers in `SceneObject.size` for each shape, and what they are.
SIZES = {
    shape: (count, f"{order} [m], above 0, at most {_FARTHEST:g}")
    for shape, count, order in (
        ("box", 3, "x y z"),
        ("cylinder", 2, "radius length"),
        ("sphere", 1, "radius"),
        ("mesh", 3, "scale x y z"),
    )
}
_NEAR = f"x y z [m], at most {_FARTHEST:g}"
_PADDING = f"0 or more [m], at most {_FARTHEST:g}"
_UNIT = "a unit quaternion x y z w"
_MESH_SUFFIXES = (".stl", ".obj")
#: Largest mesh file [bytes]: enough for the triangles that `mesh_file` takes.
_LARGEST_MESH = 32 * 2**20
#: Most names that an error lists.
_MOST_NAMES = 30


def product(a_T_b: Pose, b_T_c: Pose) -> Pose:
    """Return ``a_T_c``."""
    return Pose(a_T_b.position + a_T_b.rotation @ b_T_c.position, a_T_b.rotation @ b_T_c.rotation)


def relative(a_T_b: Pose, a_T_c: Pose) -> Pose:
    """Return ``b_T_c``."""
    return Pose(a_T_b.rotation.T @ (a_T_c.position - a_T_b.position), a_T_b.rotation.T @ a_T_c.rotation)


def names_text(names: Iterable[str]) -> str:
    """Return names of objects as a text; beyond a few they are counted."""
    known = sorted(names)
    return str(known) if len(known) <= _MOST_NAMES else f"{len(known)} objects"


def read_mesh_file(name: str, mesh: str) -> bytes:
    """Return the contents of an object's mesh file, which `mesh_file` parses."""
    path = Path(mesh)
    where = f"object {name!r} mesh"
    if not path.is_absolute() or path.suffix.lower() not in _MESH_SUFFIXES:
        raise SceneError(where, mesh, "the absolute path of an STL or OBJ file")
    try:
        return read_file(path, _LARGEST_MESH)
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        raise SceneError(where, mesh, f"a readable file ({getattr(error, 'strerror', error)})") from error


@dataclass(frozen=True)
class SceneObject:
    """One body. The fields are those of ``msg/SceneObject``, checked.

    Attributes:
        size: [m] box: x, y, z; cylinder (about its z axis, centred): radius, length; sphere: radius; mesh: scale x, y, z.
        position, quaternion: In the base_link, or in `link` [m]; x, y, z, w.
        padding: Distance to keep from it [m], added to the scene's own.
        mesh: Absolute path of an STL or OBJ file.
        link: Link that carries it; "": it stands in the world.
        touch: Links and objects that may touch it, besides the link that carries it; a link stands for what it carries, too. Enough
            if one of two objects names the other.
        fixed: It stays when the scene is cleared. No part of the hash.
        mesh_digest: SHA-256 of the mesh file.
    """

    name: str
    shape: str
    size: tuple[float, ...] = ()
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    padding: float = 0.0
    mesh: str = ""
    link: str = ""
    touch: tuple[str, ...] = ()
    fixed: bool = False
    mesh_digest: str = field(default="", init=False, repr=False)

    def __post_init__(self):
        if not self.name.strip():
            raise SceneError("an object's name", self.name, "a name that is not empty")
        if self.shape not in SIZES:
            raise self._wrong("shape", self.shape, f"one of {list(SIZES)}")
        size = self.size or ((1.0, 1.0, 1.0) if self.shape == "mesh" else ())
        count, meaning = SIZES[self.shape]
        self._set("size", self._numbers("size", size, count, meaning, lambda value: 0 < value <= _FARTHEST))
        self._set("position", self._numbers("position", self.position, 3, _NEAR, lambda value: abs(value) <= _FARTHEST))
        self._set("quaternion", self._unit_quaternion())
        (padding,) = self._numbers("padding", (self.padding,), 1, _PADDING, lambda value: 0 <= value <= _FARTHEST)
        self._set("padding", padding)
        self._set("touch", tuple(sorted(set(self.touch))))
        if (self.shape == "mesh") != bool(self.mesh):
            raise self._wrong("mesh", self.mesh, "a file for the shape mesh, nothing for the others")
        if self.mesh:
            self._set("mesh_digest", hashlib.sha256(read_mesh_file(self.name, self.mesh)).hexdigest())

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _wrong(self, key: str, value: object, expected: str) -> SceneError:
        return SceneError(f"object {self.name!r} {key}", value, expected)

    def _numbers(self, key: str, values: Iterable, count: int, expected: str, allowed=lambda value: True) -> tuple:
        try:
            numbers = tuple(map(float, values))
        except (TypeError, ValueError) as error:
            raise self._wrong(key, values, f"{count} numbers: {expected}") from error
        if len(numbers) != count or not all(math.isfinite(number) and allowed(number) for number in numbers):
            raise self._wrong(key, numbers, f"{count} finite numbers: {expected}")
        # adding 0.0 turns -0.0 into 0.0: they are equal, but would give different hashes
        return tuple(number + 0.0 for number in numbers)

    def _unit_quaternion(self) -> tuple:
        values = self._numbers("orientation", self.quaternion, 4, _UNIT)
        norm = math.hypot(*values)
        if abs(norm - 1.0) > _QUATERNION_REFUSED:
            raise self._wrong("orientation", values, "a quaternion x y z w of length 1")
        return values if abs(norm - 1.0) <= _QUATERNION_EXACT else tuple(value / norm for value in values)

    @cached_property
    def pose(self) -> Pose:
        """Pose of the object in the base_link, or in the link that carries it; its arrays are read-only."""
        pose = Pose(np.array(self.position), quaternion_to_rotation(self.quaternion))
        for values in (pose.position, pose.rotation):
            values.flags.writeable = False
        return pose

    def moved(self, pose: Pose, link: str = "", touch: Iterable[str] = ()) -> SceneObject:
        """Return the same body elsewhere: at `pose` in `link`, or in the base_link when that is empty."""
        x, y, z = map(float, pose.position)
        qx, qy, qz, qw = map(float, rotation_to_quaternion(pose.rotation))
        return replace(self, position=(x, y, z), quaternion=(qx, qy, qz, qw), link=link, touch=tuple(touch))

    def contents(self) -> dict:
        """Return the object's part of the scene's hash; a mesh enters by its contents, not by its file name."""
        keys = ("name", "shape", "size", "position", "quaternion", "padding", "link", "touch")
        return {**{key: getattr(self, key) for key in keys}, "mesh": self.mesh_digest}


@dataclass(frozen=True)
class Scene:
    """Everything the arm must not touch, besides itself: objects in any order, and the distance kept from each [m]."""

    objects: tuple[SceneObject, ...] = ()
    padding: float = 0.0

    def __post_init__(self):
        if not 0.0 <= self.padding <= _FARTHEST:
            raise SceneError("the scene's padding", self.padding, _PADDING)
        object.__setattr__(self, "padding", float(self.padding) + 0.0)
        object.__setattr__(self, "objects", tuple(self.objects))
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise SceneError("an object's name", name, "a name that no other object of the scene has")
            seen.add(name)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the contents, 64 hexadecimal digits: the version that plans and approvals refer to."""
        objects = sorted((item.contents() for item in self.objects), key=lambda contents: contents["name"])
        text = json.dumps({"padding": self.padding, "objects": objects}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the objects, in their order."""
        return tuple(item.name for item in self.objects)

    def get(self, name: str) -> SceneObject:
        """Return the object of that name; SceneError: there is none."""
        for item in self.objects:
            if item.name == name:
                return item
        raise SceneError("an object's name", name, f"one of the scene's {names_text(self.names)}")

    def add(self, item: SceneObject, replace_existing: bool = False) -> Scene:
        """Return the scene with one more object, or with another one in the place of the one of that name.

        An object that takes the place of a fixed one is fixed, too.
        """
        if item.name not in self.names:
            return replace(self, objects=(*self.objects, item))
        if not replace_existing:
            expected = "one that is not in the scene yet, or a request to replace it"
            raise SceneError("an object's name", item.name, expected)
        return self._with(replace(item, fixed=self.get(item.name).fixed))

    def attach(self, name: str, link: str, pose: Pose, touch: Iterable[str] = ()) -> Scene:
        """Return the scene with the object carried by a link at `pose` in it; `touch` replaces the present one."""
        if not link:
            raise SceneError(f"object {name!r} link", link, "the link that shall carry it")
        return self._with(self.get(name).moved(pose, link, touch))

    def detach(self, name: str, pose: Pose) -> Scene:
        """Return the scene with a carried object standing at `pose` in the base_link."""
        item = self.get(name)
        if not item.link:
            expected = "a link that carries it; it stands in the world already"
            raise SceneError(f"object {name!r} link", item.link, expected)
        return self._with(item.moved(pose))

    def without(self, names: Iterable[str]) -> Scene:
        """Return the scene without the objects of those names; others may touch them no more: a later one of a name is another."""
        gone = frozenset(names)
        kept = [item for item in self.objects if item.name not in gone]
        # what forgets nothing is not made anew: its mesh would be read again
        forgotten = (
            item if gone.isdisjoint(item.touch) else replace(item, touch=tuple(set(item.touch) - gone)) for item in kept
        )
        return replace(self, objects=tuple(forgotten))

    def _with(self, changed: SceneObject) -> Scene:
        return replace(self, objects=tuple(changed if item.name == changed.name else item for item in self.objects))


def tool_objects(tool: ToolFile, link: str) -> tuple[SceneObject, ...]:
    """Return a tool's shapes as objects of the scene that a link carries, ``tool/<shape>``."""
    found = []
    for name, shape in tool.tool.shapes.items():
        x, y, z, w = map(float, rpy_to_quaternion(shape.rpy_deg))
        mesh = str((tool.folder / shape.mesh).resolve()) if shape.mesh else ""
        found.append(SceneObject(
            f"{TOOL}{name}", shape.shape, shape.size, shape.position, (x, y, z, w), mesh=mesh, link=link, touch=tool.tool.touch
        ))  # fmt: skip
    return tuple(found)

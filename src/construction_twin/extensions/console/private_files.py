"""The files that a console serves after login: the robot's model, the scene's meshes, the building.

    <folder>/mesh/<digest>.<suffix>      shared by all robots; the name is the SHA-256 of the original file
    <folder>/<robot>/robot.urdf, building.glb

A file is written whole or not at all; what is there already under its digest is not written again.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from xml.etree import ElementTree

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file, write_atomically
from construction_twin.robot.packages import Packages
from construction_twin.scene.mesh_file import binary_stl, parse_mesh
from construction_twin.scene.objects import Scene, read_mesh_file

#: Largest mesh file [bytes].
_LARGEST = 64 * 2**20
#: What a browser's loaders read.
SUFFIXES = (".stl", ".dae", ".obj", ".glb")


def _read(path: Path) -> tuple[str, bytes]:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ConfigurationError(str(path), f"a mesh that ends in {suffix!r}", f"one of {', '.join(SUFFIXES)}")
    try:
        contents = read_file(path, _LARGEST)
    except OSError as error:
        raise ConfigurationError(str(path), error.strerror, "a readable mesh file") from error
    return hashlib.sha256(contents).hexdigest() + suffix, contents


#: Where the meshes are, relative to a robot's model.
MESHES = "../mesh/"


class PrivateFiles:
    """Writes them for one robot; ConfigurationError where the folder takes no files."""

    def __init__(self, folder: Path, robot: str):
        self._folder = folder
        self._robot = robot

    def write_robot(self, urdf: str) -> tuple[str, ...]:
        """Write the robot's model without collision shapes, and its meshes; return why shapes are left out."""
        try:
            # bytes, because the XML parser refuses an encoding declaration in a str
            robot = ElementTree.fromstring(urdf.encode())
        except ElementTree.ParseError as error:
            raise ConfigurationError("robot_description", str(error), "a URDF") from error
        packages, problems = Packages(), []
        for link in robot.iter("link"):
            for collision in link.findall("collision"):
                link.remove(collision)
            for visual in link.findall("visual"):
                mesh = visual.find("geometry/mesh")
                if mesh is None:
                    continue
                try:
                    path = packages.file(mesh.get("filename", ""), f"URDF link {link.get('name')} visual mesh")
                    name, contents = _read(path)
                except ConfigurationError as error:
                    problems.append(str(error))
                    link.remove(visual)
                    continue
                if not (self._folder / "mesh" / name).exists():
                    self._write(f"mesh/{name}", contents)
                mesh.set("filename", MESHES + name)
        self._write(f"{self._robot}/robot.urdf", ElementTree.tostring(robot, encoding="unicode"))
        return tuple(problems)

    def write_scene(self, scene: Scene) -> None:
        """Write the meshes of a scene, as binary STL in the files' own units."""
        for item in scene.objects:
            name = f"mesh/{item.mesh_digest}.stl"
            if item.mesh and not (self._folder / name).exists():
                contents = read_mesh_file(item.name, item.mesh)
                vertices, triangles = parse_mesh(f"object {item.name!r} mesh", item.mesh, contents, (1.0, 1.0, 1.0))
                self._write(name, binary_stl(vertices[triangles]))

    def write_building(self, glb: bytes) -> None:
        """Write the building model."""
        self._write(f"{self._robot}/building.glb", glb)

    def drop_building(self) -> None:
        """Delete the building model of an earlier start."""
        try:
            (self._folder / self._robot / "building.glb").unlink(missing_ok=True)
        except OSError as error:
            raise self._refused(error) from error

    def _write(self, name: str, contents: str | bytes) -> None:
        try:
            write_atomically(self._folder / name, contents)
        except OSError as error:
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> ConfigurationError:
        found = f"{error.filename or self._folder}: {error.strerror}"
        return ConfigurationError("private", found, "a folder that files can be written into")

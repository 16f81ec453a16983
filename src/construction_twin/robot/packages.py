"""ROS packages as rospack finds them, by package.xml below ROS_PACKAGE_PATH: for ``$(find pkg)`` and ``package://``."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import rospkg

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.share import NAME, share_folder


class Packages:
    """The packages of the environment that the program was started in. The folders are searched at the first question."""

    def __init__(self) -> None:
        self._rospack = rospkg.RosPack()

    def folder(self, name: str, where: str) -> Path:
        """Return a package's folder."""
        try:
            return Path(self._rospack.get_path(name))
        except rospkg.ResourceNotFound as error:
            if name == NAME:
                # installed by pip: no folder of ROS_PACKAGE_PATH holds it
                return share_folder()
            searched = os.pathsep.join(error.ros_paths or ()) or "which names no folder"
            raise ConfigurationError(
                where,
                f"no ROS package {name!r}",
                (
                    f"one below a folder of ROS_PACKAGE_PATH ({searched}); source the workspace that holds it, or "
                    "add its folder"
                ),
            ) from error
        except (ElementTree.ParseError, AttributeError) as error:
            # AttributeError: rospkg's, of a package.xml without a name
            raise ConfigurationError(
                where, f"a package.xml that cannot be read ({error})", "well-formed ones below ROS_PACKAGE_PATH"
            ) from error

    def file(self, uri: str, where: str) -> Path:
        """Return the file that a URDF names: ``package://<package>/<path>``, ``file:///<path>`` or an absolute path."""
        scheme, separator, rest = uri.partition("://")
        if not separator:
            path = Path(uri)
        elif scheme == "package":
            name, _, inside = rest.partition("/")
            path = self.folder(name, f"{where} {uri}") / inside
        elif scheme == "file":
            path = Path(unquote(rest))
        else:
            path = Path()
        if not path.is_absolute():
            raise ConfigurationError(
                where, uri, "package://<package>/<path>, file:///<path> or a path relative to the URDF"
            )
        if not path.is_file():
            raise ConfigurationError(where, uri, f"a file; there is no {path}")
        return path


def with_mesh_files(urdf: str) -> str:
    """Return a URDF whose collision meshes are named by absolute paths, those of COLLADA files scaled by their unit.

    Pinocchio looks for ``package://`` directly in ROS_PACKAGE_PATH only, so it misses every package of a repository of several. Of
    COLLADA it ignores unit and up axis; rviz and the page apply the unit.
    """
    robot = ElementTree.fromstring(urdf)
    packages = Packages()
    meshes = [
        (link.get("name"), mesh) for link in robot.iter("link") for mesh in link.iterfind("collision/geometry/mesh")
    ]
    for link, mesh in meshes:
        where = f"URDF link {link} collision mesh"
        path = packages.file(mesh.get("filename", ""), where)
        mesh.set("filename", str(path))
        if path.suffix.lower() == ".dae":
            unit = _collada_unit(path, where)
            mesh.set("scale", " ".join(repr(unit * float(part)) for part in mesh.get("scale", "1 1 1").split()))
    return ElementTree.tostring(robot, encoding="unicode") if meshes else urdf


def _collada_unit(path: Path, where: str) -> float:
    """Return the unit of a COLLADA file [m]."""
    try:
        for _, element in ElementTree.iterparse(path):
            tag = element.tag.rpartition("}")[2]
            if tag == "unit":
                return float(element.get("meter", 1.0))
            if tag == "asset":
                break
    except (ElementTree.ParseError, ValueError) as error:
        raise ConfigurationError(where, f"{path} ({error})", "a well-formed COLLADA file") from error
    return 1.0

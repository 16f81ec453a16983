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
            raise ConfigurationError(where, uri, "package://<package>/<path>, file:///<path> or an absolute path")
        if not path.is_file():
            raise ConfigurationError(where, uri, f"a file; there is no {path}")
        return path


def with_mesh_files(urdf: str) -> str:
    """Return a URDF whose collision meshes are named by absolute paths.

    Pinocchio looks for ``package://`` directly in ROS_PACKAGE_PATH only, so it misses every package of a repository of several.
    """
    robot = ElementTree.fromstring(urdf)
    packages = Packages()
    meshes = [
        (link.get("name"), mesh) for link in robot.iter("link") for mesh in link.iterfind("collision/geometry/mesh")
    ]
    for link, mesh in meshes:
        where = f"URDF link {link} collision mesh"
        mesh.set("filename", str(packages.file(mesh.get("filename", ""), where)))
    return ElementTree.tostring(robot, encoding="unicode") if meshes else urdf
